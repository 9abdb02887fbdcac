"""Parameters of sensing/touch: from tractions to contact properties."""

from __future__ import annotations

from dataclasses import dataclass

from mjtactile.sensing.settings.tunable_parameter import PRESSED, number

_PRESSED = "bench uncertainty: fitted to scenes with seeds below 1000"


@dataclass(frozen=True)
class PatchSettings:
    """Settings of contact patch detection (sensing/touch/patches.py)."""

    smoothing: float = number(0.6, "standard deviation of the pressure smoothing, nodes")
    separate_fraction: float = number(
        0.8,
        "pressure below which patches are separate, fraction of the geometric mean of gas "
        "pressure and peak",
    )
    area_disc: float = number(
        1e-6, "area at which the estimate equals that of the uniform disc, m^2", _PRESSED
    )
    area_power: float = number(1.6, "exponent of the area in that of the uniform disc", _PRESSED)
    area_pressure: float = number(
        3.5e3, "pressure of the membrane tension around a ball of medium size, Pa", _PRESSED
    )
    area_blend: float = number(
        0.7, "exponent that combines the two area estimates; the smaller one dominates", _PRESSED
    )
    core_fraction: float = number(
        0.03, "fraction of the peak pressure; lower pressure is ignored for the centroid"
    )
    min_fraction: float = number(0.1, "minimum fraction of the total force that a patch carries")


_SHAPES = "bench shape: shapes with seeds below 1000, which its table excludes"


_CALIBRATED_SPACING = 1.25e-3  # m
_CALIBRATED = "bench shape, calibrated on shapes with seeds 2000 to 2059: "


@dataclass(frozen=True)
class ContactShapeSettings:
    """Settings of the contact shape estimation (sensing/contact_shape)."""

    spacing: float = number(1.3e-3, "node spacing of the quasi-static membrane, m", _SHAPES)
    membrane_sd: float = number(
        16e-6,
        "standard deviation of the marker height error of the quasi-static membrane, m",
        "bench quasistatic",
    )
    mesh_spacing: float = number(
        1.25e-3,
        "vertex spacing of a simulated membrane, m; above the default, model errors grow",
        _CALIBRATED + "with this spacing",
    )
    noise_min: float = number(
        2.0,
        "minimum factor on the height variance; model errors of neighbouring markers are "
        "correlated",
        _SHAPES,
        low=1.0,
    )
    area_sd: float = number(
        0.01,
        "relative standard deviation of the area of a round shape due to the membrane model",
        _CALIBRATED + "68 % of the errors are within it",
    )
    area_by_node: float = number(0.8, "the same, times the number of touching nodes", _CALIBRATED)
    rim_in: float = number(
        0.72,
        "inward offset of a sharp rim from the fitted, rounded rim, in rounding radii",
        _CALIBRATED + "minimum area error",
    )
    rim_slope: float = number(
        1.15, "outward offset per membrane slope at the rim, in rounding radii", _CALIBRATED
    )
    rim_sd: float = number(
        0.25,
        "standard deviation of the rim position, in rounding radii",
        _CALIBRATED + "68 % of the errors are within it",
    )
    curvature_by_node: float = number(
        2.2,
        "relative standard deviation of the curvature error of the membrane model, times "
        "touching nodes",
        _CALIBRATED + "maximum likelihood of the errors",
    )
    size_by_node: float = number(4.0, "the same for the radius or half side of a face", _CALIBRATED)
    area_light: float = number(
        1.0, "ratio of the contact area to that of the membrane model, at light contact", _SHAPES
    )
    area_stretched: float = number(
        0.4, "increase of that ratio per relative increase of the membrane tension", _SHAPES
    )
    stretched_max: float = number(
        0.1, "maximum relative increase of the tension that counts", _SHAPES
    )
    friction: float = number(
        1.016, "force of a sticking membrane over that of the model", _CALIBRATED
    )
    force_sd: float = number(
        2e-3,
        "standard deviation of the normal force due to membrane and friction model, N",
        _SHAPES,
    )
    force_fraction: float = number(
        0.012, "the same as a fraction of the force, times the misfit where it exceeds one", _SHAPES
    )
    frame_fraction: float = number(
        6.0,
        "the same as a multiple of the force close to the frame, where the membrane is below it",
        _SHAPES,
        low=0.0,
    )
    position_sd: float = number(
        4e-4, "standard deviation of the force position, m, times the root of that misfit", _SHAPES
    )
    position_sd_sharp: float = number(
        4e-5, "the same for edges and for several shapes, m", _CALIBRATED
    )
    torque_sd: float = number(7e-6, "standard deviation of the torque, N m", _CALIBRATED)
    shear_above: tuple[float, float] = number(
        (0.35e-3, 1.1e-3),
        "height of the shear above the pressure, for blunt and for other shapes, m: shear "
        "raises the membrane on one side, and pressure with it",
        _CALIBRATED + "slope of the torque error over the shear in drags",
    )
    shear_above_fraction: float = number(
        0.6, "standard deviation as a fraction of that height", _CALIBRATED + "remaining error"
    )
    tip_curvature: float = number(
        190.0, "curvature in both directions above which a shape may be a corner, 1/m", _SHAPES
    )
    tip_light: float = number(
        0.2, "force below which corners appear blunter, with the root of the force, N", _SHAPES
    )
    tip_fraction: float = number(
        0.07, "relative standard deviation of the force on a corner due to the models", _SHAPES
    )
    motion_time: float = number(
        0.25, "time over which the motion is estimated, s", "seven images at 30 Hz"
    )
    motion_sd: float = number(
        1e-5,
        "standard deviation of the shape position over the rubber, added to the fit's, m",
        _SHAPES,
    )
    misfit_max: float = number(
        12.0,
        "maximum misfit, mean square of the height residuals over their standard deviation; "
        "above, no shape explains the markers",
        PRESSED,
    )
    force_min: float = number(0.03, "minimum force for a shape estimate, N", _SHAPES)
    check_force: float = number(
        1.4,
        "force ratio to the last full evaluation, up or down, that triggers the next one",
        _SHAPES,
        low=1.0,
    )
    check_images: int = number(
        15, "number of images after which all shape models are evaluated, except in a hold", PRESSED
    )
    misfit_asks: float = number(
        1.5, "misfit above which all shape models are searched again", PRESSED
    )
    misfit_one: float = number(
        0.7, "misfit below which contact at two places is treated as one shape", _SHAPES
    )
    log_shape: float = number(
        3.0, "minimum gain in log evidence for each additional shape", PRESSED
    )
    log_lost: float = number(
        4.0,
        "deficit in log evidence at which a shape model is dropped",
        _CALIBRATED + "with 6, 20 % more time and no additional kind",
    )
    log_again: float = number(
        0.25,
        "weight of the log evidence of an image after the first of a contact episode; model "
        "errors repeat",
        _CALIBRATED
        + "the value from 0.12 to 1 that identifies most kinds, with the highest probability",
    )
    ball_ratio: float = number(
        1.5, "maximum ratio of the two curvatures at which a smooth shape has a radius", PRESSED
    )

    @property
    def mesh_ratio(self) -> float:
        """Ratio of the vertex spacing to that of the calibration, at least 1."""
        return max(1.0, self.mesh_spacing / _CALIBRATED_SPACING)


_SLID = "bench slip: tuned on its cases with seeds below 2000 and from 3000 on"


@dataclass(frozen=True)
class SlipSettings:
    """Settings of slip detection (sensing/touch/slip.py)."""

    evidence: float = number(
        5.0, "patch displacement that indicates slip, standard deviations", _SLID
    )
    evidence_uneven: float = number(
        10.0, "the same while the shear is so nonuniform that the center may stick", _SLID
    )
    even: float = number(
        0.34, "spread over mean of shear over pressure, maximum for a sliding contact", _SLID
    )
    uniform_rotation: float = number(
        0.36, "the same along circles, for a contact that rotates on the spot and slides", _SLID
    )
    rolls: float = number(
        1.2, "spread above which the center certainly sticks: a patch that moves then rolls", _SLID
    )
    sticks: float = number(0.6, "spread above which the center may stick", _SLID)
    recent: float = number(
        0.12, "time within which a detected slip started, s", "four images at 30 Hz; " + _SLID
    )
    baseline: float = number(
        0.28, "duration of the baseline before the slip, s", "eight images at 30 Hz; " + _SLID
    )
    min_before: int = number(2, "minimum number of images in the baseline")
    follows: float = number(
        0.27, "patch displacement due to partial slip, fraction of that of the rubber", _SLID
    )
    lean: float = number(
        1.28e-4,
        "displacement of a patch of `noise_size` when shear over normal force changes by 1, m",
        _SLID,
    )
    lean_power: float = number(
        4.0, "exponent of the rms extent of the patch along the shear in that displacement", _SLID
    )
    noise: float = number(
        20e-6, "standard deviation of the center of a patch of `noise_size` under 1 N, m", _SLID
    )
    noise_size: float = number(4e-3, "radius of gyration at which that value holds, m", _SLID)
    noise_size_power: float = number(
        0.66, "exponent of the radius of gyration in that value", _SLID
    )
    noise_force_power: float = number(-0.6, "exponent of the normal force in that value", _SLID)
    min_displacement: float = number(
        1.2e-4, "minimum displacement over the rubber that counts as slip, m", _SLID
    )
    min_load: float = number(
        0.2,
        "minimum shear over normal force of a slip; less means rolling, or friction below "
        "that of dry contacts",
        _SLID,
    )
    shape_speed: float = number(
        3e-3, "minimum slip speed of a known shape along the shear, over the rubber, m/s", _SLID
    )
    shape_spin: float = number(
        0.5,
        "minimum rotation rate of a slip about the normal of the shape, over the rubber, rad/s",
        _SLID,
    )
    shape_sure: float = number(6.0, "minimum of these speeds in standard deviations", _SLID)
    incipient: float = number(0.7, "fraction of the friction limit above which slip is incipient")
    min_force: float = number(
        0.05, "minimum force, N; below, the patch and its shear are too uncertain"
    )
    gap: float = number(0.2, "time without an image after which the history is discarded, s")
    core_fraction: float = number(
        0.03,
        "fraction of the peak pressure; lower pressure is ignored for the contact position",
        high=0.9,
    )


_PROBED = (
    "bench material: tuned on the shipped objects and on objects with seeds below 4000, "
    "which its table excludes"
)


@dataclass(frozen=True)
class SqueezeSettings:
    """The object's own size between the fingers (sensing/touch/squeeze.py)."""

    patch_fraction: float = number(
        0.8,
        "radius of the surface fit over the equivalent radius of the contact; excludes the "
        "lift-off zone",
        _PROBED,
    )
    patch_radius: tuple[float, float] = number(
        (0.003, 0.006),
        "minimum and maximum of that radius, m",
        "at least the marker pitch, and at most the range of a paraboloid; " + _PROBED,
    )
    width_sd: float = number(
        20e-6, "standard deviation of a width between images, m", "9 x 9 markers of 1 mm"
    )
    tilt_fraction: float = number(
        0.4, "standard deviation of the width correction for tilted faces, fraction", _PROBED
    )
    nodes_min: int = number(
        8,
        "minimum number of surface grid nodes inside the contact",
        "six coefficients are fitted",
        low=6,
    )


@dataclass(frozen=True)
class MaterialSettings:
    """Settings of material classification (sensing/touch/material.py)."""

    force_min: float = number(0.35, "minimum measured force for a result, N", _PROBED)
    shrunk_enough: float = number(
        2e-3,
        "change in width that is sufficient without that force, m",
        "a paste never reaches `force_min`; " + _PROBED,
    )
    force_traced: float = number(0.05, "minimum force at which the width is tracked, N", _PROBED)
    force_estimate: float = number(
        0.1, "minimum force at which the contact is wide enough to measure the width, N", _PROBED
    )
    peak_fraction: float = number(
        0.7, "minimum peak force of the first load, fraction of the strongest one", _PROBED
    )
    gap: float = number(4.0, "number of images without contact that separates two touches", _PROBED)
    pressing: float = number(
        0.4, "fraction of the median closing speed below which the jaws have stopped", _PROBED
    )
    opened: float = number(
        3e-4, "opening motion of the jaws at the start of the release, m", _PROBED
    )
    gentle_fraction: float = number(
        0.6,
        "maximum force for the fit of the curve, fraction of the peak",
        "a flowing material has flowed only little by then; " + _PROBED,
    )
    samples_min: int = number(5, "minimum number of images of the load, and of the hold", _PROBED)
    unseen_max: float = number(
        1.5e-3, "maximum deformation before the first width measurement, m", "80 N/m"
    )
    stiffening_prior: float = number(
        0.3, "residual per stiffening of 1/N: the prior is mild stiffening", _PROBED
    )
    solid_compliance: float = number(
        0.12e-3, "compliance below which an object is solid, m/N", "8 kN/m; an eraser has 5 kN/m"
    )
    set_fraction: float = number(
        0.35, "permanent fraction of the deformation above which an object is amorphous", _PROBED
    )
    set_fraction_sd: float = number(
        0.08, "standard deviation of that limit among real materials", _PROBED
    )
    sure: float = number(0.6, "minimum probability of a reported class", _PROBED)
    width_bias: float = number(
        40e-6,
        "apparent change in width of a rigid object with force, m",
        "bending at sharp edges; " + _PROBED,
    )
    area_fraction_sd: float = number(
        0.3,
        "relative standard deviation of the contact area",
        "bench uncertainty: half of all loads are off by more than 20 to 35 %",
    )
    released_fraction: float = number(
        0.5, "fraction of the maximum force below which release and load are compared", _PROBED
    )
    released_force: float = number(0.15, "minimum of that force, N", _PROBED)
    relaxed_min: float = number(
        0.04, "minimum drop of the force for a relaxation time, fraction", _PROBED
    )
    relaxed_sd: float = number(
        3.0, "minimum of that drop in standard deviations of the force", _PROBED
    )
    early: float = number(
        0.5, "time after the jaws stop in which the flow speed is measured, s", _PROBED
    )
