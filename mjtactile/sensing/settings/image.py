"""Numbers of sensing/image: pixels to ellipses."""

from __future__ import annotations

from dataclasses import dataclass

from mjtactile.sensing.settings.tunable_parameter import SEEN, TRIED, number

_MONTE_CARLO = "Monte Carlo: the covariance against the scatter of fits to simulated noise"


@dataclass(frozen=True)
class CandidateSettings:
    """Settings of the search for marker candidates (sensing/image/candidates.py)."""

    cells: int = number(
        60,
        "cells of the threshold's grid along the image's shorter side, about",
        TRIED,
        low=4,
        high=400,
    )
    half_from: float = number(
        4.0,
        "px; where nothing smaller counts, half the resolution is looked at",
        "half resolution shows enough there, in less than half the time",
    )
    margins: tuple[float, float] = number(
        (3.0, 24.0),
        "grey levels of 256 darker than its neighbourhood: the least, and the most that noise can "
        "ask for",
        "at first 4, whatever the noise; " + SEEN,
    )
    noise: float = number(
        4.0, "times the median difference of neighbours: the margin that noise asks for", TRIED
    )
    smallest: float = number(
        0.7,
        "of the smallest radius asked for: what a border may look like before it is fitted",
        TRIED,
    )


@dataclass(frozen=True)
class EdgeSettings:
    """Ellipses from the image itself, for small or much blurred markers (sensing/image/edge_fit.py,
    sensing/image/edge_bands.py)."""

    small_radius: float = number(
        7.0,
        "px, times a blur of more than 1 px; below this mean radius the edge's curvature is felt "
        "beyond the first order",
        TRIED,
    )
    sharpest: float = number(
        0.55,
        "px; a blur fitted below it was taken for size",
        "softening and the pixel's own square make 0.69 of no blur at all",
    )
    outlier_residuals: float = number(
        4.0, "times the marker's rms residual: where a pixel's weight falls off", TRIED
    )
    outlier_fraction: float = number(
        0.1,
        "of the contrast: no pixel nearer than that is an outlier",
        "a lens or a camera's sharpening that the model does not know; " + SEEN,
    )
    covariance_factor: float = number(
        4.3, "factor on the covariance: softened noise is not white", _MONTE_CARLO
    )
    neighbour_margin: float = number(
        1.5, "px around another marker that are left out: most of its blurred rim", TRIED
    )
    max_size_ratio: float = number(
        4.0, "times a marker's size: what is larger is no marker that stands beside it", TRIED
    )
    min_distance_fraction: float = number(
        0.7, "of the other's radius; what is nearer is the marker itself, or what it lies on", TRIED
    )


@dataclass(frozen=True)
class ProfileSettings:
    """Ellipses from profiles across their edges (sensing/image/profile_fit.py)."""

    step: float = number(
        0.75,
        "px between samples along a profile, for blur up to `start_blur`; more blur stretches it",
        TRIED,
        low=0.1,
        high=10.0,
    )
    start_blur: float = number(1.1, "px, see `step`; the blur to start from", TRIED)
    spacing: float = number(2.0, "px of arc between profiles", "at first 1; " + SEEN)
    level_outlier: float = number(
        2.5, "times the spread of a marker's levels, at which a profile's level is bounded", TRIED
    )
    outlier_offsets: float = number(
        6.0, "times the mean offset: where a profile's weight falls off", TRIED
    )
    outlier_min: float = number(0.08, "px; no profile nearer than that is an outlier", TRIED)
    max_blur_variance: float = number(
        3.0, "times the image's middle blur variance, at which a profile's is bounded", TRIED
    )
    covariance_factor: float = number(
        1.08,
        "factor on the covariance: rounding, interpolation and the blur's own noise",
        _MONTE_CARLO,
    )
    motion_sd_fraction: float = number(
        0.5, "share of the correction for motion that is in doubt: motion is no Gaussian", TRIED
    )
    sharpest: float = number(
        0.3,
        "px; blur as low as that is the pixel's own square at most",
        "the square's sd is 0.29 px",
    )


@dataclass(frozen=True)
class MarkerSettings:
    """Settings of the acceptance of ellipses (sensing/image/fit_validation.py,
    sensing/image/ellipse_fit.py)."""

    profile_min_radius: float = number(
        6.0, "px, semi-minor axis from which on profiles have room", TRIED
    )
    profile_min_blurs: float = number(
        7.5, "times the blur, below which profiles have no room either", TRIED
    )
    min_blurs: float = number(
        2.8, "times the blur, below which radius, blur and level cannot be told apart", TRIED
    )
    start_blur_fraction: float = number(
        0.3, "of a marker's size: the blur to start from where it was taken for size", TRIED
    )
    sure_blurs: float = number(5.0, "times the blur; a larger marker knows its own", TRIED)
    blur_spread: float = number(1.15, "factor of one marker's blur over the image's", TRIED)
    min_motion: float = number(0.06, "px of motion that are no noise", TRIED)
    covered_fraction: float = number(
        0.08,
        "of the contrast: what a fit leaves over where part of the edge is not the marker's",
        TRIED,
    )
    min_peers: int = number(5, "markers that say how large markers are", TRIED)
    size_log_tolerance: float = number(
        0.5, "log of size by which one may differ from their median", TRIED
    )
    min_edge_distance: float = number(
        3.0, "px between two edges, or an edge and the image's border, that disturb a fit", TRIED
    )
    min_border_axes: float = number(0.15, "least ratio of a border's axes", TRIED)
    min_flawed_axes: float = number(0.4, "the same of one with glare or dirt on it", TRIED)
    max_flawed_misfit: float = number(
        0.6, "of its size: how far such a border may be from its own ellipse", TRIED
    )
    max_border_misfit: float = number(
        1.2, "px that a border may be from its own ellipse, and ...", TRIED
    )
    border_misfit_fraction: float = number(0.2, "... of its semi-minor axis beside that", TRIED)
    border_misfit_fraction_cut: float = number(
        0.4, "the same where the image's border cuts it", TRIED
    )
    min_contrast: float = number(5.0, "times the residual: the least contrast", TRIED)
    min_contrast_any: float = number(2.0, "times it, below which there is no marker at all", TRIED)
    max_shape_sd: float = number(
        0.1, "of the semi-minor axis: the largest sd of a trusted shape", TRIED
    )
    max_shape_sd_any: float = number(0.5, "of it, above which there is no marker at all", TRIED)
    max_residual: float = number(0.15, "of the contrast: a larger residual is no ellipse's", TRIED)
    covered_residuals: float = number(
        5.0,
        "times the image's middle residual, which `covered_fraction` must exceed, too",
        "compressed photographs leave more of every marker",
    )
    max_lost_weight: float = number(0.25, "share of the robust weight lost to glare or dirt", TRIED)
    sharper_ratio: float = number(
        0.7, "of the image's blur: a fit that found less may have taken the blur for size", TRIED
    )
    max_shape_change: float = number(
        0.25,
        "of the semi-minor axis (beside `max_border_misfit`): how far the fit may move from its "
        "candidate's shape",
        TRIED,
    )
    max_move: float = number(
        0.3, "of the semi-minor axis (beside 1 px): how far it may move from its place", TRIED
    )
    min_fit_axes: float = number(0.1, "least ratio of a fit's axes", TRIED)
    shrunk_fraction: float = number(
        0.5, "of the smallest radius asked for, below which there is no marker at all", TRIED
    )


_FOLLOWED = "egg grasps at 15 and 30 Hz, and the first 20 sequences of `bench tracking`"


@dataclass(frozen=True)
class TrackingSettings:
    """Settings of marker tracking from the previous image without a search
    (sensing/image/tracking.py)."""

    images_between_searches: int = number(
        15, "images in a row without a search", "half a second at 30 Hz"
    )
    max_gap: float = number(
        0.15, "s between two images; after a longer one nothing is expected", "two images of 15 Hz"
    )
    position_tolerance: float = number(
        1.2,
        "px that a marker may be from where it was going; a fit finds its edge from two away",
        _FOLLOWED,
    )
    shape_tolerance: float = number(0.7, "px that its shape may have changed by", _FOLLOWED)
    contrast_tolerance: float = number(
        0.15, "of the least contrast: how far a contrast may have changed", _FOLLOWED
    )
    max_residual: float = number(1.7, "times the image's middle residual", _FOLLOWED)
    max_lost_weight: float = number(0.02, "share of the robust weight that is lost", _FOLLOWED)


@dataclass(frozen=True)
class ExhaustiveDetectionSettings:
    """The second look of `mjtactile detect-circles` at photographs
    (sensing/image/exhaustive_detection.py)."""

    closing_size: int = number(
        17,
        "px of the closing: blobs up to a radius of 8 px stand out, on the image and on "
        "smaller ones",
        TRIED,
    )
    scale_step: int = number(3, "from one image to the next smaller", TRIED, low=2)
    min_side: int = number(60, "px of the smallest one's shorter side", TRIED)
    dark_fraction: float = number(
        0.5,
        "of how dark the darkest place nearby is: what belongs to the blob",
        "the middle of a blurred edge",
    )
    same_size_ratio: float = number(
        1.5, "ratio of sizes up to which two outlines may be the same circle's", TRIED
    )
    inside_ratio: float = number(
        1.3,
        "of its ellipse: how far out a part of a circle may lie, where the kernel's corner did "
        "not fit",
        TRIED,
    )
    retry_blur: float = number(
        0.7, "px: a fit that failed is tried again with at least that much blur", TRIED
    )
    blur_sd_fraction: float = number(
        0.1, "of the blur: by how much it differs from place to place in a photograph", TRIED
    )
    grey_levels: tuple[float, float] = number((0.1, 0.9), "levels of an edge that are grey", TRIED)
    grey_fraction: float = number(
        0.05,
        "of an edge's pixels; with fewer grey ones it is black and white only",
        "what pixels' areas alone make of a sharp edge is 0.3",
    )
    sampled_blur: float = number(
        0.5,
        "px of blur for such a picture",
        "0.5 to 1 leave the same error; the least has the best error bars",
    )


@dataclass(frozen=True)
class GammaSettings:
    """Settings of the camera gamma estimate (sensing/image/gamma.py)."""

    min_circles: int = number(6, "circles that must agree", TRIED)
    max_circles: int = number(
        24,
        "circles that are looked at",
        "more cost time and tell no more than what is not modelled hides",
    )
    min_radius: float = number(
        4.0, "px of the semi-minor axis; below, blur and level are not told apart", TRIED
    )
    profile_half_width: float = number(5.0, "px to both sides of an edge that are looked at", TRIED)
    start_gamma: float = number(1.5, "to start from", "between 1 and 2.2")
    start_blur: float = number(0.8, "px to start from", TRIED)
    min_blur: float = number(
        0.6,
        "px, the pixel's own square included; below, its corners are lopsided enough",
        "simulated circles: right from 0.65 on, 3.3 for a true 2.2 at 0.42",
    )
    model_sd_fraction: float = number(
        0.08, "of it: sd of what is not modelled", "simulated circles of 5 to 20 px"
    )
    range: tuple[float, float] = number(
        (0.3, 4.0), "beyond it, it is no gamma but sharpening or clipping", "cameras have 1 to 2.6"
    )
    min_sds: float = number(3.0, "sd by which it must differ from what was assumed, and ...", TRIED)
    min_log_change: float = number(0.25, "... its logarithm, to be said", "0.05 px of size")
    size_per_log: float = number(
        0.6, "px of size for a unit of log gamma that is wrong", "simulated circles: 0.4 to 0.6"
    )
