"""Parameters of `mjtactile detect-circles` beyond touch sensing: joint smoothing of circles in
photos."""

from __future__ import annotations

from dataclasses import dataclass

from mjtactile.sensing.settings.tunable_parameter import SEEN, TRIED, number

_PHOTOGRAPHS = "photographs of flat boards of dots; " + SEEN


@dataclass(frozen=True)
class LocateSettings:
    """Circles in photographs (sensing/pose/circles_from_images.py)."""

    min_shared_radius: float = number(
        6.0,
        "median semi-minor axis below which circles share depth, px",
        "edge processing in a camera exceeds its noise there; " + _PHOTOGRAPHS,
    )
    ground_distance: float = number(
        3.0, "distance from a dark circle's edge at which the background is sampled, px", TRIED
    )
    inside_fraction: float = number(
        0.4, "radius at which a bright circle is sampled, relative to its size", TRIED
    )
    clipped_level: float = number(
        0.98,
        "minimum level of a clipped pixel, relative to the camera's range",
        "one of three averaged channels may not be clipped",
    )
    clipped_fraction: float = number(
        0.5, "fraction of clipped pixels above which the image is overexposed", "most"
    )
    size_sd: float = number(
        0.3,
        "standard deviation of the position of a clipped edge, px",
        "photographs of known boards show 0.1 to 0.45",
    )


@dataclass(frozen=True)
class NeighborSmoothingSettings:
    """Settings of the shared elongation of circles (sensing/pose/neighbor_smoothing.py)."""

    min_circles: int = number(40, "circles", "a second-order field needs many")
    max_scatter: float = number(
        4.0,
        "maximum scatter of consistent circles over the predicted standard deviation",
        "maximum effect of a real camera (sharpening, demosaicing, compression); " + _PHOTOGRAPHS,
    )
    min_median_weight: float = number(0.5, "minimum median weight of consistent circles", TRIED)
    outlier_scatters: float = number(4.0, "deviation at which weights decrease, in scatters", TRIED)
    min_weight: float = number(0.1, "weight below which a circle keeps its own elongation", TRIED)


@dataclass(frozen=True)
class SmoothnessSettings:
    """Settings of the depth smoothing over circles (sensing/surface/depth_smoothing.py, Eq.
    V10)."""

    circle_range: tuple[int, int] = number(
        (40, 500),
        "minimum and maximum number of circles",
        "few do not determine the smoothness; the cost grows with the cube",
    )
    common_fraction: float = number(
        0.33,
        "part of a depth's standard deviation that is common to all and therefore remains",
        "camera processing, blur errors; " + SEEN,
    )
    gross_scatters: float = number(
        5.0,
        "deviation from a second-order surface at which initial weights decrease, in scatters",
        TRIED,
    )
    outlier_scatters: float = number(
        4.0, "deviation from the spline at which weights decrease, in scatters", TRIED
    )
    min_weight: float = number(0.1, "weight below which a circle keeps its own depth", TRIED)
    min_agreeing_fraction: float = number(0.8, "minimum fraction of consistent circles", TRIED)


@dataclass(frozen=True)
class PoseDisambiguationSettings:
    """Settings of the choice between a circle's two poses (sensing/pose/pose_disambiguation.py)."""

    plane_circles: int = number(
        9, "number of circles for a plane fit, including the circle itself", TRIED
    )
    min_circles: int = number(
        6,
        "minimum number of circles in the image for plane fits",
        "a plane has three degrees of freedom",
    )
    max_normal_sd: float = number(
        0.5,
        "maximum linearized standard deviation of a normal, rad",
        "it is infinite for a frontal circle",
    )
    max_surface_sd: float = number(
        0.15,
        "maximum standard deviation of an informative surface normal, rad",
        "simulated circles at independent depths: with 0.5, 0.75 instead of 0.85 were right",
    )
    free_circles_prior: float = number(
        4.0, "prior number of independent circles per circle on a surface", TRIED
    )
    min_surface_sd: float = number(
        0.035,
        "minimum standard deviation of a plane through neighbors on a bent surface, rad",
        "2 degrees; " + SEEN,
    )
