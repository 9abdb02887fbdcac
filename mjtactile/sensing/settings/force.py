"""Numbers of sensing/force: markers to tractions."""

from __future__ import annotations

from dataclasses import dataclass

from mjtactile.sensing.settings.tunable_parameter import GAUGED, SEEN, TRIED, number

_BARS = "bench uncertainty: fitted to scenes of seeds below 1000, which its table leaves out"


@dataclass(frozen=True)
class PriorSettings:
    """Settings of the traction prior, before any image is processed (sensing/force/prior.py)."""

    pressure_sd: float = number(4e3, "Pa, of contact before anything is known", TRIED)
    background: float = number(
        0.03, "share of it that a node keeps when nothing was felt there", TRIED
    )
    pressure_limit: float = number(
        20e3,
        "Pa; more on one node is a spike that no object makes",
        "a sheet of 28 N/m bent around 3 mm",
    )
    friction: float = number(0.8, "ratio of shear to pressure", TRIED)
    correlation: float = number(
        2e-3, "m, over which pressures go together: a fraction of an object's size", TRIED
    )
    softening: float = number(1e-3, "m, over which the pressures found before are smeared", TRIED)


@dataclass(frozen=True)
class InverseSettings:
    """Tractions from markers (sensing/force/inverse_fem.py, sensing/force/slopes.py)."""

    spans: tuple[int, int] = number(
        (14, 10), "intervals of the sheet's spline along x and y", TRIED, low=4, high=40
    )
    marker_floor: float = number(
        8e-6,
        "m, what the markers' covariance does not know of",
        "as coarse as the sheet's splines are",
    )
    excess: float = number(
        0.6,
        "mean square of a marker's noise over its sd, from which on it counts less",
        "bench touch: force, centroid",
    )
    slope_excess: float = number(0.5, "the same of a slope", "bench touch: force, centroid")
    slope_model_sd: float = number(
        0.01, "what the sheet's splines cannot follow of slopes next to an edge", "bench touch"
    )
    slope_sd_max: float = number(0.1, "slopes known worse are left out", TRIED)
    slope_off_max: float = number(
        0.6, "and those farther off what is expected: the other of an ellipse's two", TRIED
    )
    slopes_cell: float = number(
        20e-6, "m^2 of sheet to a marker; where it is more, slopes are worth their time", TRIED
    )
    drift_gas: float = number(
        2e-4,
        "sd of the amount of gas since it was measured; the zero follows it",
        "0.06 K, or 0.2 hPa of weather",
    )
    drift_camera: float = number(
        3e-6, "m, sd of the camera's place since then", "10 K in 10 mm of a plastic housing"
    )
    drift_rotation: float = number(3e-5, "rad, sd of its direction", "a 50th of a pixel")
    drift_zoom: float = number(
        0.01, "sd of the picture's scale", "a lens warmed; bench camera-faults"
    )
    drift_size: float = number(
        0.2, "px, sd of circles' radii", "gamma, clipping: 0.1 px and more; bench camera-faults"
    )
    drift_levels: float = number(
        0.5,
        "px, sd of that for a level inside over that outside that is e times what it was",
        "clipped blacks: 0.1 px for a fifth; bench camera-faults",
        low=0.0,
    )
    drift_walk: float = number(
        1e-3,
        "1/sqrt(s), of all these sds, that a camera changes while it is watched",
        "a lens that warms by 1 % in ten minutes; bench camera-faults",
        low=0.0,
    )
    drift_jitter: float = number(
        0.003,
        "px, sd of circles' radii, alike for all, from image to image",
        "a tenth of one circle's noise: flicker, JPEG; bench camera-faults",
        low=0.0,
    )
    changed_min: float = number(
        4.0,
        "sd of a mode beyond what images before have told, from which on the camera has changed",
        "bench camera-faults: zoom, gamma",
    )
    same_bulge: float = number(
        250.0,
        "Pa off the reference's pressure, at which an image tells half as much of the camera: the "
        "model's bulge is 1.4 % off",
        "examples/firmer_in_the_air.py",
    )
    same_load: float = number(
        0.2,
        "N on the sheet, at which an image tells half as much of the camera, for the same reason",
        "a hold of 20 s at 0.9 N, let go: 0.016 N otherwise",
    )
    knock_shift: float = number(
        3e-4, "m, sd of the camera's place once it was knocked", "some pixels; bench camera-faults"
    )
    knock_rotation: float = number(
        0.01, "rad, sd of its direction then", "the same; bench camera-faults"
    )
    knock_min: float = number(
        6.0,
        "mean square of the drift found over its variance, from which on it was knocked",
        "bench camera-faults: knocks of 0.5 px and more have 9, grasps 3",
    )
    dent_fraction: float = number(
        0.03, "sd of the volume of a dent between the markers, of that volume", "bench touch"
    )
    posterior_fraction: tuple[float, float, float, float] = number(
        (0.006, 0.3, 0.25, 0.006),
        "of the predicted variance of shear, normal force, tilt and spin: contacts are smoother "
        "than the prior says, and nearly all markers see shear",
        "bench uncertainty, while nothing touches; " + _BARS,
    )
    informative_pressure: float = number(
        100.0, "Pa; below, the bulge is too small to tell the stiffness", TRIED
    )
    rest_power: float = number(
        1.6,
        "of the bulge's height, with which the stiffness is corrected at rest",
        "the height goes with the stiffness to a power between -1 and -1/3",
    )
    young_sd: float = number(
        0.06,
        "sd of the sheet's stiffness, a share, by which a bulge that is not the file's is put down "
        "to it or to the pre-stretch",
        "mixed silicone from batch to batch, and its thickness (models/randomization/default.toml)",
    )
    pre_stretch_sd: float = number(
        0.005,
        "sd of the pre-stretch",
        "0.2 mm of a frame of 40 (models/randomization/default.toml)",
    )
    cold_load: float = number(
        0.3,
        "N found without a history, from which on the camera is taken to be as at the references",
        "bench uncertainty: bodies held from before; a camera that changed then costs accuracy",
    )
    overlooked_load: float = number(
        0.05, "N found, up to which a light touch may have been overlooked", "bench uncertainty"
    )
    overlooked_misfit: float = number(
        0.5,
        "mean square of the markers' misfit over their sd, from which on one is looked for",
        "bench uncertainty: 99 % of images without contact are below 0.44, such touches above 0.6",
    )
    overlooked_rise: float = number(
        1.7,
        "times that of the image before, and of what is then found",
        "bench uncertainty: 2 to 5 in such touches",
        low=1.0,
    )
    overlooked_excess: float = number(
        10.0, "mean `excess` of all markers, from which on too", "next to nothing, all should fit"
    )
    remembered_images: int = number(
        15, "images that nothing explains after which what was before is forgotten", "half a second"
    )
    overload_min: float = number(
        1.0, "N, before the markers fit no shape any more, that are said to be too much", SEEN
    )
    excess_max: float = number(
        80.0,
        "mean `excess` of all markers above which nothing smooth explains them",
        "bench uncertainty: a cube's corner has up to 71",
    )
    misfit_max: float = number(
        50.0,
        "mean square of the markers' misfit over their sd above which the shape is not explained",
        "bench touch",
    )


@dataclass(frozen=True)
class FiducialSettings:
    """The camera by circles that do not move (sensing/force/camera_drift_estimator.py)."""

    fewest: int = number(
        4,
        "fiducials seen, below which the camera is an unknown again",
        "eleven modes, three a circle",
    )
    floor: float = number(
        0.002,
        "px, sd of a fiducial's place and radius that the image stages do not know of",
        "bench camera-faults: fiducials at rest",
    )
    glass_size: float = number(
        0.2,
        "px, sd of the radius of a fiducial on the pane: its blur is another than the markers'",
        "gamma of 1.3 at 2 px of blur against 0.7",
    )
    picture: float = number(3.0, "px, sd of the picture's middle", "a lens that was pushed aside")
    gas_lost: float = number(
        0.02,
        "sd of the amount of gas that no gauge measures, once markers show more drift than a known "
        "camera has",
        "a leak; bench fiducials",
    )
    still: float = number(
        0.02, "px of a fiducial's motion that are none", "bench camera-faults: 0.005 px of noise"
    )
    axial: float = number(
        0.25,
        "of a camera's motion aside, that it moves along its axis: what shows all larger is a lens",
        "bench camera-faults: zoom",
    )
    curve_fraction: float = number(
        0.3,
        "of how growth goes with levels, that it may go by more or less where markers are",
        "bench fiducials: clipped whites",
        low=0.0,
    )
    curve_left: float = number(
        0.02,
        "of what circles grew, that markers of the same level may have grown by more or less",
        "bench fiducials: gamma",
        low=0.0,
    )
    outlier: float = number(
        9.0,
        "times the middle misfit, at which a fiducial counts half: dirt",
        "dust of half a radius",
    )


@dataclass(frozen=True)
class ModelErrorSettings:
    """Settings of the model error that the wrench's posterior leaves out
    (sensing/force/model_error.py).

    Each has values for shear, normal force, tilt and spin.
    """

    share: tuple[float, float, float, float] = number(
        (0.001, 0.0125, 0.0, 0.0), "of the force, for each `cell` to a marker", _BARS, low=0.0
    )
    lateral: tuple[float, float, float, float] = number(
        (0.018, 0.0, 0.07, 0.029), "of all nodes' shear, whichever way", _BARS, low=0.0
    )
    sharp: tuple[float, float, float, float] = number(
        (0.002, 0.004, 0.009, 0.005),
        "of the force, for each of the markers' mean `excess`: sharper than the splines",
        _BARS,
        low=0.0,
    )
    caught: tuple[float, float, float, float] = number(
        (0.025, 0.0, 0.06, 0.05),
        "of all nodes' shear, times the root of that excess beyond one: edges and corners that "
        "catch the sheet",
        "bench uncertainty: 64 instead of 111 of 5556 touches beyond five sd, with the same median "
        "standard deviation",
        low=0.0,
    )
    sharp_max: float = number(20.0, "that excess at most", _BARS)
    outside: tuple[float, float, float, float] = number(
        (0.18, 0.15, 0.8, 0.5),
        "of the load beyond the outermost markers, and of a quarter of that beside them",
        _BARS,
        low=0.0,
    )
    change: tuple[float, float, float, float] = number(
        (0.15, 0.25, 0.38, 0.45),
        "of the change since the last image: forces come and go within a few ms",
        _BARS,
        low=0.0,
    )
    lag: float = number(
        2.5,
        "of the change since the last image, times the images by which the camera's pictures lag: "
        "rounding hides most of a long lag",
        "bench camera-faults: noise reduction of 30 to 80 % on eggs of other seeds",
        low=0.0,
    )
    burst: tuple[float, float, float, float] = number(
        (0.03, 0.2, 0.5, 0.05),
        "of a change that is most of the force, the first image of a tap: what comes that fast "
        "drags where it presses",
        _BARS,
        low=0.0,
    )
    drag: float = number(
        120.0,
        "s/m^2, of shear per N/m of stiffness of a sheet that moves",
        "the simulated rubber has 81; " + _BARS,
        low=0.0,
    )
    lever: float = number(
        3e-3, "m, between those of forces and those of torques", "a marker's pitch"
    )
    cell: float = number(12e-6, "m^2 of sheet to a marker", "`dense`")


@dataclass(frozen=True)
class GasFilterSettings:
    """Settings of the gas filter that uses a pressure sensor (sensing/force/gas_filter.py).

    Pressures and amounts are fractions of the absolute ambient pressure: 1e-5 is one pascal.
    """

    floor: float = number(1.5, "Pa, sd of a gauge's mean, however many readings", GAUGED)
    scale: float = number(
        0.005, "sd of its scale, of what the pressure differs from that at rest", "data sheets: 1 %"
    )
    rate: float = number(5e-5, "1/s, sd of a sealed chamber's loss before any is seen", "5 Pa/s")
    rate_time: float = number(3.0, "s, over which a rate is forgotten that is not seen", GAUGED)
    walk: float = number(
        0.7e-5, "1/sqrt(s), of a sealed amount", "bench camera-faults: shipped grasps"
    )
    rate_walk: float = number(
        1e-5, "1/s/sqrt(s), of its rate", "bench camera-faults: shipped grasps"
    )
    rate_fraction: float = number(1.0, "1/sqrt(s), of the rate that is there", GAUGED)
    open_walk: float = number(1e-4, "1/sqrt(s), of a pressure that a valve keeps", GAUGED)
    open_rate: float = number(3e-3, "1/s/sqrt(s), of its rate", "1.4 kPa in a second")
    moving_rate: float = number(0.2, "1/s, sd of its rate then", "1 kPa in 50 ms")
    drift: float = number(5e-5, "sd of what is sealed, beside the pressure's own", GAUGED)
    deviation_max: float = number(4.5, "sd by which one reading may surprise", GAUGED)
    surprise_max: float = number(1.7, "sd by which the mean of several may", "4 sd of that mean")
    telling: float = number(4.0, "of a reading's variance: what is known worse is told", GAUGED)
    blend: float = number(0.3, "of the newest reading in that mean", GAUGED, high=1.0)
    shortest: float = number(0.02, "s, in which a surprise has come about", GAUGED)
    moved_max: float = number(
        60.0,
        "Pa in an image, from which on the force is unknown",
        "bench camera-faults: valves, holes",
    )
    least: float = number(0.01, "of ambient pressure, that a chamber has at least", "vacuum")


@dataclass(frozen=True)
class ContactDetectionSettings:
    """Is there a touch, and the zero that follows the weather while there is none
    (sensing/force/contact_detection.py)."""

    touch_sd: float = number(
        5.0, "sd of the noise that a force, or its level, must exceed to be a touch", TRIED
    )
    touch_min: float = number(0.02, "N that it must exceed too", TRIED)
    blend: float = number(0.5, "of the newest image in the level", TRIED, high=1.0)
    jump_sd: float = number(
        4.0, "sd; a larger change is no noise: the level follows at once", TRIED
    )
    pull_max: float = number(
        0.15,
        "N; nothing pulls on the membrane, so more than this says that the zero is lost",
        TRIED,
    )
    drift_max: float = number(
        30.0, "mean square of the drift found over its variance: the same by the shape", TRIED
    )
    release: float = number(0.6, "of the threshold, below which a touch ends", TRIED)
    noise_first: float = number(
        0.01, "N of noise believed at first, or what is predicted where that is less", TRIED
    )
    memory_images: int = number(30, "images over which the noise is learnt", TRIED)
    quiet: float = number(0.5, "s without touch before the zero follows", TRIED)
    follow: float = number(4.0, "s, time constant of the zero", TRIED)
    smooth: float = number(
        0.5, "s, over which markers' distance from the zero is averaged for that", TRIED
    )
    local_max: float = number(
        0.3,
        "mean square over the markers' variance of what neither gas nor camera does to that mean: "
        "more is a slow touch",
        TRIED,
    )
    slowly: float = number(0.05, "of that speed at which the zero still follows then", TRIED)
    drift_rate: float = number(
        2e-4, "1/s, fastest change of the gas that is weather and no touch", "0.06 K/s"
    )
    offset_fraction: float = number(
        0.1, "of that change that a marker's own offset follows by", TRIED
    )
