"""Parameters of sensing/force: camera, model error, gas and contact from image to image."""

from __future__ import annotations

from dataclasses import dataclass

from mjtactile.sensing.settings.tunable_parameter import GAUGED, SCENES, number


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
        SCENES,
        low=0.0,
    )
    lateral: tuple[float, float, float, float] = number(
        (0.018, 0.0, 0.07, 0.029),
        "fraction of the shear of all nodes, in any direction",
        SCENES,
        low=0.0,
    )
    sharp: tuple[float, float, float, float] = number(
        (0.002, 0.004, 0.009, 0.005),
        "fraction of the force, for each unit of the markers' mean `excess`: features "
        "sharper than the splines",
        SCENES,
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
    sharp_max: float = number(20.0, "maximum of that excess", SCENES)
    outside: tuple[float, float, float, float] = number(
        (0.18, 0.15, 0.8, 0.5),
        "fraction of the load beyond the outermost markers, and of a quarter of the load "
        "next to them",
        SCENES,
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
        SCENES,
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
        SCENES,
        low=0.0,
    )
    drag: float = number(
        120.0,
        "drag of a moving membrane: shear per N/m of stiffness, s/m^2",
        "the simulated rubber has 81; " + SCENES,
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
    measured_rate: float = number(
        1e-6,
        "the same with a pressure sensor, which measures the weather: drift of its zero, 1/s",
        "6 Pa per minute",
    )
    offset_fraction: float = number(
        0.1, "fraction of that speed at which the offset of each marker follows"
    )
