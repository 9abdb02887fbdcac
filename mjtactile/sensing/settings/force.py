"""Parameters of sensing/force: markers to tractions."""

from __future__ import annotations

from dataclasses import dataclass

from mjtactile.sensing.settings.tunable_parameter import GAUGED, SEEN, number

_BARS = "bench uncertainty: fitted to scenes with seeds below 1000, which its table excludes"


FACE = "plates of 30 to 80 mm, tests/physics/test_wide_faces.py"


@dataclass(frozen=True)
class PriorSettings:
    """Settings of the traction prior, before any image is processed (sensing/force/prior.py)."""

    pressure_sd: float = number(
        4e3, "standard deviation of the contact pressure without earlier images, Pa"
    )
    background: float = number(0.03, "fraction of it that nodes without estimated pressure keep")
    pressure_limit: float = number(
        20e3,
        "maximum pressure of a node, Pa; more is a spike that no object causes",
        "a membrane of 28 N/m bent around 3 mm",
    )
    friction: float = number(0.8, "prior ratio of shear to pressure")
    correlation: float = number(
        2e-3, "correlation length of the pressure, m: a fraction of an object's size"
    )
    softening: float = number(1e-3, "smoothing length of the previously estimated pressure, m")


@dataclass(frozen=True)
class InverseSettings:
    """Tractions from markers (sensing/force/inverse_fem.py, sensing/force/slopes.py)."""

    spans: tuple[int, int] = number(
        (14, 10), "intervals of the membrane spline along x and y", low=4, high=40
    )
    marker_floor: float = number(
        8e-6,
        "marker position error that their covariance does not contain, m",
        "coarseness of the membrane spline",
    )
    excess: float = number(
        0.6,
        "mean squared residual of a marker over its variance, above which its weight decreases",
        "bench touch: force, centroid",
    )
    slope_excess: float = number(0.5, "the same for slopes", "bench touch: force, centroid")
    slope_model_sd: float = number(
        0.01, "slope error next to an edge, which the membrane spline cannot follow", "bench touch"
    )
    slope_sd_max: float = number(0.1, "maximum standard deviation of a slope that is used")
    slope_off_max: float = number(
        0.6,
        "maximum deviation of a used slope from the prediction; more is the wrong solution "
        "of the ellipse",
    )
    slopes_cell: float = number(20e-6, "membrane area per marker, m^2, above which slopes are used")
    drift_gas: float = number(
        2e-4,
        "relative standard deviation of the gas amount since it was measured; the zero tracks it",
        "0.06 K, or 0.2 hPa of ambient pressure",
    )
    drift_camera: float = number(
        3e-6,
        "standard deviation of the camera position since then, m",
        "10 K on 10 mm of a plastic housing",
    )
    drift_rotation: float = number(
        3e-5, "standard deviation of the camera direction since then, rad", "one 50th of a pixel"
    )
    drift_zoom: float = number(
        0.01, "standard deviation of the image scale", "a warmed lens; bench camera-faults"
    )
    drift_size: float = number(
        0.2,
        "standard deviation of the circle radii, px",
        "gamma, clipping: 0.1 px and more; bench camera-faults",
    )
    drift_levels: float = number(
        0.5,
        "standard deviation of the same, px, for a change of the level inside over that "
        "outside by a factor of e",
        "clipped blacks: 0.1 px for a fifth; bench camera-faults",
        low=0.0,
    )
    drift_walk: float = number(
        1e-3,
        "random walk of the camera as a fraction of all these standard deviations, 1/sqrt(s)",
        "a lens that changes by 1 % in ten minutes while it warms; bench camera-faults",
        low=0.0,
    )
    drift_jitter: float = number(
        0.003,
        "standard deviation of a common change of the circle radii from image to image, px",
        "a tenth of the noise of one circle: flicker, JPEG; bench camera-faults",
        low=0.0,
    )
    changed_min: float = number(
        4.0,
        "deviation of a mode from earlier images, in standard deviations, above which the "
        "camera has changed",
        "bench camera-faults: zoom, gamma",
    )
    same_bulge: float = number(
        250.0,
        "deviation from the reference pressure, Pa, at which an image has half the weight "
        "for the camera: the bulge of the model is 1.4 % off",
        "examples/firmer_in_the_air.py",
    )
    same_load: float = number(
        0.2,
        "load on the membrane, N, at which an image has half the weight for the camera, for "
        "the same reason",
        "a hold of 20 s at 0.9 N, then a release: 0.016 N otherwise",
    )
    displaced_shift: float = number(
        3e-4,
        "standard deviation of the camera position after a displacement, m",
        "some pixels; bench camera-faults",
    )
    displaced_rotation: float = number(
        0.01,
        "standard deviation of the camera direction after a displacement, rad",
        "the same; bench camera-faults",
    )
    displaced_min: float = number(
        6.0,
        "mean squared drift over its variance, above which a displaced camera is tested",
        "bench camera-faults: image shifts of 0.5 px and more have 9, grasps 3",
    )
    dent_fraction: float = number(
        0.03,
        "standard deviation of the volume of a dent between the markers, relative to that volume",
        "bench touch",
    )
    posterior_fraction: tuple[float, float, float, float] = number(
        (0.006, 0.3, 0.25, 0.006),
        "fraction of the predicted variance of shear, normal force, tilt and spin: contacts "
        "are smoother than the prior, and nearly all markers measure shear",
        "bench uncertainty, without contact; " + _BARS,
    )
    informative_pressure: float = number(
        100.0, "minimum pressure, Pa, for an estimate of the stiffness from the bulge"
    )
    rest_power: float = number(
        1.6,
        "power of the bulge height in the stiffness correction at rest",
        "the height is proportional to the stiffness to a power between -1 and -1/3",
    )
    young_sd: float = number(
        0.06,
        "relative standard deviation of the membrane stiffness; a bulge unlike that of the "
        "file is attributed to it or to the pre-stretch",
        "batch-to-batch variation of mixed silicone and of its thickness "
        "(models/randomization/default.toml)",
    )
    pre_stretch_sd: float = number(
        0.005,
        "standard deviation of the pre-stretch",
        "0.2 mm on a frame of 40 mm (models/randomization/default.toml)",
    )
    cold_load: float = number(
        0.3,
        "estimated load without earlier images, N, above which the camera is assumed "
        "unchanged since the references",
        "bench uncertainty: objects already in contact; a changed camera then costs accuracy",
    )
    overlooked_load: float = number(
        0.05,
        "maximum estimated load, N, with which a light touch may be overlooked",
        "bench uncertainty",
    )
    overlooked_misfit: float = number(
        0.5,
        "mean squared misfit of the markers over their variance, above which such a touch is "
        "searched for",
        "bench uncertainty: 99 % of images without contact are below 0.44, such touches above 0.6",
    )
    overlooked_rise: float = number(
        1.7,
        "minimum ratio to the misfit of the previous image, and to that of the new estimate",
        "bench uncertainty: 2 to 5 for such touches",
        low=1.0,
    )
    overlooked_excess: float = number(
        10.0,
        "mean `excess` of all markers, above which it is searched for, too",
        "almost without load, all markers should fit",
    )
    face_load: float = number(
        0.2,
        "minimum force for the test for a wide face, N",
        "from 0.5 N on, plates of 0.3 N were 3 standard deviations too low",
        low=0.0,
    )
    face_area: float = number(
        0.5,
        "force over gauge pressure, as a fraction of the frame's area, above which the contact "
        "reaches the outermost markers, wherever the estimated tractions are",
        FACE,
    )
    face_flat: float = number(
        3.0,
        "root mean square deviation of the markers under a wide face from a plane, relative to "
        "their standard deviation: more is another shape",
        FACE,
    )
    face_correlation: float = number(
        4e-3, "correlation length of the deviation from the tractions of a plane, m", FACE
    )
    face_fraction: float = number(
        0.1,
        "standard deviation of the contact pressure under a wide face, relative to that of a plane",
        FACE,
    )
    face_floor: tuple[float, float, float] = number(
        (1e-4, 1e-4, 2e-5), "error of a marker's position under a plane without friction, m", FACE
    )
    face_sunk: float = number(
        5e-5, "depth below the frame, m, at which a wide face rests on it", FACE, low=0.0
    )
    face_change: float = number(
        10.0,
        "negative logarithm of the prior probability that the camera changes in an image under "
        "load",
        "one change in 20 000 images",
        low=0.0,
    )
    gained_max: float = number(
        0.01,
        "relative increase of the gas in a sealed chamber that contradicts a shape",
        "3 K of warming in an image",
        low=0.0,
    )
    gap_max: float = number(
        0.03,
        "fraction of the force that the measured and the estimated pressure may differ by",
        "a wide face under 16 markers",
    )
    remembered_images: int = number(
        15,
        "number of unexplained images after which the earlier state is discarded",
        "half a second",
    )
    overload_min: float = number(
        1.0, "minimum last force, N, for an overload when the markers no longer fit any shape", SEEN
    )
    excess_max: float = number(
        80.0,
        "mean `excess` of all markers above which no smooth load explains them",
        "bench uncertainty: up to 71 for a cube's corner",
    )
    misfit_max: float = number(
        50.0,
        "mean squared misfit of the markers over their variance, above which the shape is "
        "not explained",
        "bench touch",
    )


@dataclass(frozen=True)
class FiducialSettings:
    """The camera by circles that do not move (sensing/force/camera_drift_estimator.py)."""

    min_visible: int = number(
        4,
        "minimum number of visible fiducials; with fewer, the camera is unknown again",
        "eleven modes, three values per circle",
    )
    floor: float = number(
        0.002,
        "standard deviation of position and radius of a fiducial beyond the image covariance, px",
        "bench camera-faults: fiducials at rest",
    )
    glass_size: float = number(
        0.2,
        "standard deviation of the radius of a fiducial on the glass, px: its blur differs "
        "from that of the markers",
        "gamma of 1.3 at 2 px of blur instead of 0.7",
    )
    center_sd: float = number(
        3.0, "standard deviation of the image center, px", "a lens displaced sideways"
    )
    gas_lost: float = number(
        0.02,
        "relative standard deviation of the gas amount without a pressure sensor, once the "
        "markers show more drift than a known camera has",
        "a leak; bench fiducials",
    )
    still: float = number(
        0.02,
        "motion of a fiducial that is only noise, px",
        "bench camera-faults: 0.005 px of noise",
    )
    axial: float = number(
        0.25,
        "axial motion of a camera relative to its lateral motion: a uniform scale change is "
        "due to the lens",
        "bench camera-faults: zoom",
    )
    curve_fraction: float = number(
        0.3,
        "relative uncertainty of the growth per level where the markers are",
        "bench fiducials: clipped whites",
        low=0.0,
    )
    curve_left: float = number(
        0.02,
        "relative uncertainty of the growth of markers with the same level",
        "bench fiducials: gamma",
        low=0.0,
    )
    outlier: float = number(
        9.0,
        "ratio to the median misfit at which a fiducial has half weight: dirt",
        "dust of half a radius",
    )


@dataclass(frozen=True)
class ModelErrorSettings:
    """Settings of the model error that the wrench's posterior leaves out
    (sensing/force/model_error.py). Each has values for shear, normal force, tilt and spin."""

    sparse: tuple[float, float, float, float] = number(
        (0.001, 0.0125, 0.0, 0.0),
        "fraction of the force, for each `cell` per marker",
        _BARS,
        low=0.0,
    )
    lateral: tuple[float, float, float, float] = number(
        (0.018, 0.0, 0.07, 0.029),
        "fraction of the shear of all nodes, in any direction",
        _BARS,
        low=0.0,
    )
    sharp: tuple[float, float, float, float] = number(
        (0.002, 0.004, 0.009, 0.005),
        "fraction of the force, for each unit of the markers' mean `excess`: features "
        "sharper than the splines",
        _BARS,
        low=0.0,
    )
    caught: tuple[float, float, float, float] = number(
        (0.025, 0.0, 0.06, 0.05),
        "fraction of the shear of all nodes, times the root of that excess beyond one: edges "
        "and corners that catch the membrane",
        "bench uncertainty: 64 instead of 111 of 5556 contacts beyond five standard "
        "deviations, with the same median standard deviation",
        low=0.0,
    )
    sharp_max: float = number(20.0, "maximum of that excess", _BARS)
    outside: tuple[float, float, float, float] = number(
        (0.18, 0.15, 0.8, 0.5),
        "fraction of the load beyond the outermost markers, and of a quarter of the load "
        "next to them",
        _BARS,
        low=0.0,
    )
    unseen: tuple[float, float] = number(
        (0.29, 0.15),
        "standard deviation of the normal force of a contact at the outermost markers, as a "
        "fraction of the load that it carries if it extends to the frame: any part of that load "
        "is equally likely; with a pressure sensor half of it",
        "plates of 25 to 80 mm, tests/physics/test_wide_faces.py",
        low=0.0,
    )
    change: tuple[float, float, float, float] = number(
        (0.15, 0.25, 0.38, 0.45),
        "fraction of the change since the last image: forces change within a few ms",
        _BARS,
        low=0.0,
    )
    lag: float = number(
        2.5,
        "fraction of the change since the last image, times the lag of the camera in images: "
        "rounding hides most of a long lag",
        "bench camera-faults: noise reduction of 30 to 80 % on eggs with other seeds",
        low=0.0,
    )
    burst: tuple[float, float, float, float] = number(
        (0.03, 0.2, 0.5, 0.05),
        "fraction of a change that is most of the force, in the first image of a tap: fast "
        "contacts drag the membrane",
        _BARS,
        low=0.0,
    )
    drag: float = number(
        120.0,
        "drag of a moving membrane: shear per N/m of stiffness, s/m^2",
        "the simulated rubber has 81; " + _BARS,
        low=0.0,
    )
    lever: float = number(
        3e-3, "lever between force errors and torque errors, m", "a marker's pitch"
    )
    cell: float = number(12e-6, "membrane area per marker, m^2", "`dense`")


@dataclass(frozen=True)
class GasFilterSettings:
    """Settings of the gas filter that uses a pressure sensor (sensing/force/gas_filter.py).
    Pressures and amounts are fractions of the absolute ambient pressure: 1e-5 is one pascal."""

    floor: float = number(
        1.5,
        "minimum standard deviation of a pressure sensor's mean, Pa, for any number of readings",
        GAUGED,
    )
    scale: float = number(
        0.005,
        "standard deviation of its scale, relative to the pressure change since rest",
        "data sheets: 1 %",
    )
    rate: float = number(
        5e-5, "prior standard deviation of the loss rate of a sealed chamber, 1/s", "5 Pa/s"
    )
    rate_time: float = number(3.0, "decay time of a rate that is not observed, s", GAUGED)
    walk: float = number(
        0.7e-5,
        "random walk of a sealed gas amount, 1/sqrt(s)",
        "bench camera-faults: shipped grasps",
    )
    rate_walk: float = number(
        1e-5, "random walk of its rate, 1/s/sqrt(s)", "bench camera-faults: shipped grasps"
    )
    rate_fraction: float = number(
        1.0, "random walk of a rate relative to its value, 1/sqrt(s)", GAUGED
    )
    open_walk: float = number(
        1e-4, "random walk of a pressure that a valve controls, 1/sqrt(s)", GAUGED
    )
    open_rate: float = number(3e-3, "random walk of its rate, 1/s/sqrt(s)", "1.4 kPa in one second")
    moving_rate: float = number(
        0.2, "standard deviation of its rate after a valve has opened, 1/s", "1 kPa in 50 ms"
    )
    drift: float = number(
        5e-5, "standard deviation of the sealed amount, in addition to that of the pressure", GAUGED
    )
    deviation_max: float = number(
        4.5, "maximum deviation of one reading, in standard deviations", GAUGED
    )
    surprise_max: float = number(
        1.7,
        "maximum deviation of the mean of several readings, in standard deviations",
        "4 standard deviations of that mean",
    )
    informative: float = number(
        4.0,
        "ratio of the prior variance to that of a reading, above which the reading is informative",
        GAUGED,
    )
    blend: float = number(0.3, "weight of the newest reading in that mean", GAUGED, high=1.0)
    shortest: float = number(0.02, "minimum duration of an unexpected change, s", GAUGED)
    moved_max: float = number(
        60.0,
        "pressure change in an image, Pa, above which the force is unknown",
        "bench camera-faults: valves, holes",
    )
    minimum: float = number(0.01, "minimum pressure of a chamber, relative to ambient", "vacuum")


@dataclass(frozen=True)
class ContactDetectionSettings:
    """Settings of contact detection, and of the zero that tracks weather without contact. See
    sensing/force/contact_detection.py."""

    touch_sd: float = number(
        5.0, "minimum force of a touch, or of its mean, in standard deviations of the noise"
    )
    touch_min: float = number(0.02, "minimum force of a touch, N")
    blend: float = number(0.5, "weight of the newest image in the mean force", high=1.0)
    jump_sd: float = number(
        4.0,
        "force change, in standard deviations, that the mean force follows at once because "
        "it is not noise",
    )
    pull_max: float = number(
        0.15, "maximum pull on the membrane, N; more means that the zero is lost"
    )
    drift_max: float = number(
        30.0, "maximum mean squared drift over its variance; more means that the zero is lost"
    )
    release: float = number(0.6, "fraction of the threshold below which a touch ends")
    noise_first: float = number(0.01, "initial noise, N, or the predicted noise if it is smaller")
    memory_images: int = number(30, "number of images over which the noise is estimated")
    quiet: float = number(0.5, "time without touch before the zero follows, s")
    follow: float = number(4.0, "time constant of the zero, s")
    smooth: float = number(0.5, "averaging time of the markers' deviation from the zero, s")
    local_max: float = number(
        0.3,
        "mean square of that mean over the markers' variance, without gas and camera motion: "
        "more is a slow touch",
    )
    slowly: float = number(
        0.05, "fraction of the speed at which the zero still follows during a slow touch"
    )
    drift_rate: float = number(
        2e-4, "maximum rate of a gas change due to weather instead of touch, 1/s", "0.06 K/s"
    )
    offset_fraction: float = number(
        0.1, "fraction of that speed at which the offset of each marker follows"
    )
