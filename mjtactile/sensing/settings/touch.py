"""Parameters of sensing/touch: from tractions to contact properties."""

from __future__ import annotations

from dataclasses import dataclass

from mjtactile.sensing.settings.tunable_parameter import PRESSED, TRIED, number

_PRESSED = "bench uncertainty: fitted to scenes of seeds below 1000"


@dataclass(frozen=True)
class PatchSettings:
    """Settings of contact patch detection (sensing/touch/patches.py)."""

    smoothing: float = number(0.6, "sd of the smoothing, in nodes", TRIED)
    separate_fraction: float = number(
        0.8,
        "of the geometric mean of gas pressure and peak; patches are apart where pressure falls "
        "below it",
        TRIED,
    )
    area_disc: float = number(1e-6, "m^2 at which an area is that of its uniform disc", _PRESSED)
    area_power: float = number(1.6, "how it goes with the disc's", _PRESSED)
    area_pressure: float = number(
        3.5e3, "Pa, of the sheet's tension around a ball of middling size", _PRESSED
    )
    area_blend: float = number(
        0.7, "power of the means by which the smaller of the two areas counts", _PRESSED
    )
    core_fraction: float = number(
        0.03, "of the peak: pressure below it does not count for the centroid", TRIED
    )
    min_fraction: float = number(
        0.1, "of the whole force: a patch that carries less is no patch", TRIED
    )


_PRESSED_SHAPES = "bench shape: bodies of seeds below 1000, which its table leaves out"


_CALIBRATED = "bench shape's bodies of seeds 2000 to 2059, on which it is calibrated: "


@dataclass(frozen=True)
class ContactShapeSettings:
    """Settings of the contact shape estimation (sensing/contact_shape)."""

    spacing: float = number(1.3e-3, "m, between the film's nodes", _PRESSED_SHAPES)
    film_sd: float = number(
        16e-6, "m, of a marker's height that the film does not know of", "bench quasistatic"
    )
    noise_min: float = number(
        2.0,
        "of the heights' variance: what the film leaves is alike in neighbouring markers",
        _PRESSED_SHAPES,
        low=1.0,
    )
    area_sd: float = number(
        0.01,
        "of the area of what is round, that the film does not know of",
        _CALIBRATED + "where 68 % are within it",
    )
    area_by_node: float = number(
        0.8, "the same, over the film's nodes that touch", _CALIBRATED + "the same"
    )
    rim_in: float = number(
        0.72,
        "times the rounding of a face's rim, by which a sharp one is further in than that is found",
        _CALIBRATED + "least errors of area",
    )
    rim_slope: float = number(
        1.15,
        "of that, what the slope of the sheet at the rim makes of it: the steeper, the further out",
        _CALIBRATED + "the same",
    )
    rim_stuck: float = number(
        10.7,
        "of that, by how much more than in the middle a sheet bears that sticks",
        _CALIBRATED + "the same",
    )
    rim_sd: float = number(
        0.25, "of that, as sd, of where a rim is", _CALIBRATED + "where 68 % are within it"
    )
    curvature_by_node: float = number(
        2.2,
        "over the film's nodes that touch: share of a curvature that film and simulated sheet have "
        "wrong, as sd",
        _CALIBRATED + "where the likelihood of their errors is best",
    )
    size_by_node: float = number(
        4.0, "the same of a face's radius or half side", _CALIBRATED + "the same"
    )
    area_light: float = number(
        1.0,
        "area of a sheet of one tension over that of the film's, in a light touch",
        _PRESSED_SHAPES,
    )
    area_stretched: float = number(
        0.65, "by how much that grows with the share by which the tension has", _PRESSED_SHAPES
    )
    stretched_max: float = number(0.1, "of that share: more does not count", _PRESSED_SHAPES)
    friction: float = number(
        1.024,
        "force of a sheet that sticks over that of the film, which slides, in the middle",
        _PRESSED_SHAPES,
    )
    friction_aside: tuple[float, float] = number(
        (0.2, 0.5),
        "what comes to it by the squares of how far off the middle it presses along x and y, in "
        "halves of the frame",
        _PRESSED_SHAPES,
    )
    force_sd: float = number(
        2e-3, "N, of the normal force, that film and friction leave", _PRESSED_SHAPES
    )
    force_fraction: float = number(
        0.012, "the same, of the force, times the misfit where that is above one", _PRESSED_SHAPES
    )
    frame_fraction: float = number(
        6.0,
        "times the force that presses the sheet lower than its frame, close beside it, the same",
        _PRESSED_SHAPES,
        low=0.0,
    )
    place_sd: float = number(
        4e-4, "m, of where it acts, times the root of that misfit", _PRESSED_SHAPES
    )
    place_sd_sharp: float = number(
        4e-5, "m, the same of edges and of several bodies", _CALIBRATED + "the same"
    )
    torque_sd: float = number(7e-6, "N m, of its torque", _CALIBRATED + "the same")
    shear_above: tuple[float, float] = number(
        (0.35e-3, 1.1e-3),
        "m, over the height of the pressure, where shear acts on what is blunt and on what is not: "
        "it draws the sheet up on one side, and pressure with it",
        _CALIBRATED + "slope of the torque's error with the shear in drags",
    )
    shear_above_fraction: float = number(0.6, "of that, as sd", _CALIBRATED + "what it leaves")
    tip_curvature: float = number(
        190.0, "1/m; what is more curved both ways may be a corner", _PRESSED_SHAPES
    )
    tip_light: float = number(
        0.2, "N; below it corners seem blunter, with the root of the force", _PRESSED_SHAPES
    )
    tip_fraction: float = number(
        0.07, "of its force, that film and friction leave", _PRESSED_SHAPES
    )
    motion_time: float = number(0.25, "s, over which its motion is told", "seven images at 30 Hz")
    motion_sd: float = number(
        1e-5, "m, of a body's place over the rubber, beside its fit's", _PRESSED_SHAPES
    )
    misfit_max: float = number(
        12.0, "mean square of the heights over their sd, above which no body explains", PRESSED
    )
    force_min: float = number(0.03, "N; less says nothing of a shape", _PRESSED_SHAPES)
    check_force: float = number(
        1.4,
        "times the force of the last look, up or down, from which on there is more to be told",
        _PRESSED_SHAPES,
        low=1.0,
    )
    check_images: int = number(15, "after which all families are looked at in any case", PRESSED)
    misfit_asks: float = number(
        1.5, "mean square of what is left, above which all families are looked for again", PRESSED
    )
    misfit_one: float = number(
        0.7, "the same: what is below it, at two places, is one body nevertheless", _PRESSED_SHAPES
    )
    log_body: float = number(3.0, "of the log of evidence, that one body more must gain", PRESSED)
    log_lost: float = number(
        4.0,
        "of the log of evidence, by which a family is behind that is not looked at any more",
        _CALIBRATED + "with 6, a fifth more time and no kind more",
    )
    log_again: float = number(
        0.25,
        "of the log of evidence of an image, that counts after the first of a press: what the film "
        "has wrong comes again",
        _CALIBRATED + "of 0.12 to 1 the one that names most kinds, and most surely",
    )
    ball_ratio: float = number(
        1.5, "of two curvatures, below which a smooth body has a radius", PRESSED
    )


_SLID = "bench slip: tuned on its cases with seeds below 2000, which its table leaves out"


@dataclass(frozen=True)
class SlipSettings:
    """Settings of slip detection (sensing/touch/slip.py)."""

    evidence: float = number(5.0, "sd of a wandering patch that are slip", _SLID)
    evidence_uneven: float = number(
        12.0, "that are, while the shear is so uneven that the middle seems to stick", _SLID
    )
    even: float = number(
        0.35, "spread over mean of shear over pressure in a contact that slides", _SLID
    )
    uniform_rotation: float = number(
        0.42, "the same along circles, of a contact that turns on the spot and slides", _SLID
    )
    rolls: float = number(
        1.2, "of one whose middle sticks for sure: what goes anywhere there rolls", _SLID
    )
    sticks: float = number(0.6, "of one whose middle seems to stick", _SLID)
    recent: float = number(
        0.12, "s, in which what is said to be a slip began", "four images at 30 Hz; " + _SLID
    )
    baseline: float = number(
        0.28, "s before it, from which it is counted", "eight images at 30 Hz; " + _SLID
    )
    min_before: int = number(2, "images that a baseline needs", TRIED)
    follows: float = number(
        0.35, "of the rubber's own way: how far partial slip takes the patch", _SLID
    )
    lean: float = number(
        1.28e-4,
        "m that a patch of `noise_size` goes when shear over normal force changes by 1",
        _SLID,
    )
    lean_power: float = number(4.0, "how that goes with the patch's sd along the shear", _SLID)
    noise: float = number(20e-6, "m, sd of the centre of a patch of `noise_size` under 1 N", _SLID)
    noise_size: float = number(4e-3, "m, the radius of gyration for which that holds", _SLID)
    noise_size_power: float = number(0.66, "how it goes with that radius", _SLID)
    noise_force_power: float = number(-0.6, "how it goes with the normal force", _SLID)
    min_displacement: float = number(6e-5, "m over the material: less is no slip", _SLID)
    min_load: float = number(
        0.2,
        "shear over normal force: what slips below it rolls, or is as smooth as nothing dry",
        _SLID,
    )
    body_speed: float = number(
        3e-3, "m/s of a known body along the shear, over the rubber: less is no slip", _SLID
    )
    body_spin: float = number(
        0.5, "rad/s of it about its normal, over the rubber: less is no slip", _SLID
    )
    body_sure: float = number(6.0, "sd of these speeds, that they must be above", _SLID)
    incipient: float = number(0.7, "share of the friction limit from which on slip begins", TRIED)
    min_force: float = number(
        0.05, "N; below, neither the patch nor its shear are known well enough", TRIED
    )
    gap: float = number(0.2, "s without an image, after which the past does not count", TRIED)
    core_fraction: float = number(
        0.03,
        "of the peak: pressure below it does not count for the place of the touch",
        TRIED,
        high=0.9,
    )


_PROBED = (
    "bench material: tuned on the shipped objects and on bodies of seeds below 4000, which its "
    "table leaves out"
)


@dataclass(frozen=True)
class SqueezeSettings:
    """The object's own size between the fingers (sensing/touch/squeeze.py)."""

    patch_fraction: float = number(
        0.8, "of the contact's equivalent radius: away from where the sheet lifts off", _PROBED
    )
    patch_radius: tuple[float, float] = number(
        (0.003, 0.006),
        "m, least and most of that radius",
        "a marker's pitch at least, and no more than a parabola describes; " + _PROBED,
    )
    width_sd: float = number(20e-6, "m, of a width from image to image", "9 x 9 markers of 1 mm")
    tilt_fraction: float = number(0.4, "of what the faces' tilt adds to the width: its sd", _PROBED)
    nodes_min: int = number(
        8, "nodes of the surface's grid inside the contact", "six are fitted", low=6
    )


@dataclass(frozen=True)
class MaterialSettings:
    """Settings of material classification (sensing/touch/material.py)."""

    force_min: float = number(0.35, "N that must have been felt before anything is said", _PROBED)
    shrunk_enough: float = number(
        2e-3,
        "m by which a width must have changed to speak for itself",
        "a paste never pushes back with `force_min`; " + _PROBED,
    )
    force_traced: float = number(0.05, "N down to which the width is followed", _PROBED)
    force_estimate: float = number(
        0.1, "N from which on the contact is wide enough to measure the width", _PROBED
    )
    peak_fraction: float = number(
        0.7, "of the strongest press: one as strong is the first press", _PROBED
    )
    gap: float = number(4.0, "images without contact that part two touches", _PROBED)
    pressing: float = number(
        0.4, "of the usual speed at which the jaws press: slower, they have stopped", _PROBED
    )
    opened: float = number(
        3e-4, "m that the jaws have opened again where the release begins", _PROBED
    )
    gentle_fraction: float = number(
        0.6,
        "of the press's force, up to which its curve is fitted",
        "what flows has not flowed much by then; " + _PROBED,
    )
    samples_min: int = number(5, "images of the press, and of the hold", _PROBED)
    unseen_max: float = number(
        1.5e-3, "m by which an object may have given way before its width was first seen", "80 N/m"
    )
    stiffening_prior: float = number(0.3, "1/N to the residuals: stiffening is mild", _PROBED)
    solid_compliance: float = number(
        0.12e-3, "m/N; what gives way less is called solid", "8 kN/m; an eraser has 5"
    )
    set_fraction: float = number(
        0.35, "of the deformation that stays; more of it is amorphous", _PROBED
    )
    set_fraction_sd: float = number(0.08, "spread of real materials about these two", _PROBED)
    sure: float = number(0.6, "probability below which no class is named", _PROBED)
    width_bias: float = number(
        40e-6,
        "m by which the width of a rigid object seems to change with force",
        "bending at sharp edges; " + _PROBED,
    )
    area_fraction_sd: float = number(
        0.3,
        "of the contact's area: its sd",
        "bench uncertainty: half of all presses are more than 20 to 35 % off",
    )
    released_fraction: float = number(
        0.5, "of the greatest force: below it the release is compared with the press", _PROBED
    )
    released_force: float = number(0.15, "N, the same where that is more", _PROBED)
    relaxed_min: float = number(
        0.04, "share of the force that must go before a relaxation time is given", _PROBED
    )
    relaxed_sd: float = number(3.0, "sd of the force that it must exceed, too", _PROBED)
    early: float = number(
        0.5, "s after the jaws stopped, in which the speed of flow is taken", _PROBED
    )
