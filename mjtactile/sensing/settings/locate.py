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
        "px, median semi-minor axis below which circles share depth",
        "a camera's processing of edges outweighs its noise there; " + _PHOTOGRAPHS,
    )
    ground_distance: float = number(
        3.0, "px from a dark circle's edge, where the ground is looked at", TRIED
    )
    inside_fraction: float = number(0.4, "of a bright circle's size, where it is looked at", TRIED)
    clipped_level: float = number(
        0.98,
        "of the camera's range, above which a pixel is clipped",
        "one of three averaged channels may not be",
    )
    clipped_fraction: float = number(
        0.5, "of the pixels looked at, above which the picture is overexposed", "most"
    )
    size_sd: float = number(
        0.3, "px by which a clipped edge may be off", "photographs of known boards show 0.1 to 0.45"
    )


@dataclass(frozen=True)
class NeighborSmoothingSettings:
    """Settings of the shared elongation of circles (sensing/pose/neighbor_smoothing.py)."""

    min_circles: int = number(40, "circles", "a second-order field asks for many")
    max_scatter: float = number(
        4.0,
        "scatter over predicted sd, above which they do not agree",
        "what a real camera (sharpening, demosaicing, compression) may explain; " + _PHOTOGRAPHS,
    )
    min_median_weight: float = number(0.5, "median weight below which they do not agree", TRIED)
    outlier_scatters: float = number(4.0, "times the scatter: where weights fall off", TRIED)
    min_weight: float = number(0.1, "weight below which a circle keeps its own elongation", TRIED)


@dataclass(frozen=True)
class SmoothnessSettings:
    """Settings of the depth smoothing over circles (sensing/surface/depth_smoothing.py, Eq.
    V10)."""

    circle_range: tuple[int, int] = number(
        (40, 500),
        "least and most of them",
        "few say nothing about smoothness; the cost grows with the cube",
    )
    common_fraction: float = number(
        0.33,
        "part of a depth's own sd that all share, so that it stays",
        "a camera's processing, an error of blur; " + SEEN,
    )
    gross_scatters: float = number(
        5.0, "times the scatter about a second-order surface: where first weights fall off", TRIED
    )
    outlier_scatters: float = number(
        4.0, "times the scatter about the spline: where weights fall off", TRIED
    )
    min_weight: float = number(0.1, "weight below which a circle keeps its own depth", TRIED)
    min_agreeing_fraction: float = number(0.8, "of the circles that must agree", TRIED)


@dataclass(frozen=True)
class PoseDisambiguationSettings:
    """Settings of the choice between a circle's two poses (sensing/pose/pose_disambiguation.py)."""

    plane_circles: int = number(
        9, "circles that a plane is laid through, the circle itself among them", TRIED
    )
    min_circles: int = number(
        6, "circles in the picture, for planes at all", "three are a plane's own degrees of freedom"
    )
    max_normal_sd: float = number(
        0.5, "rad, what a normal's linearised sd may be", "face-on it is infinite"
    )
    max_surface_sd: float = number(
        0.15,
        "rad, sd of a surface's normal from which on it says nothing",
        "circles each at its own depth, simulated: at 0.5 they made 0.75 right that were 0.85",
    )
    free_circles_prior: float = number(
        4.0, "circles thought beforehand to hang each as it likes, against one on a surface", TRIED
    )
    min_surface_sd: float = number(
        0.035, "rad, sd of a plane through neighbours for a bent sheet", "2 degrees; " + SEEN
    )
