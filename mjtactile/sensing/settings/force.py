"""Parameters of sensing/force: markers to tractions."""

from __future__ import annotations

from dataclasses import dataclass

from mjtactile.sensing.settings.tunable_parameter import SCENES, SEEN, number

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
        "bench uncertainty, without contact; " + SCENES,
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
    face_size_max: float = number(
        2.5,
        "maximum common deviation of the circle sizes from the membrane under a wide face without "
        "a pressure sensor, in standard deviations of `drift_jitter`: the plane's height is wrong",
        "plates of 35 to 70 mm: errors above 10 % have 2.7 to 6.5, others up to 2.6",
        low=0.0,
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
