"""Parameters of sensing/image: pixels to ellipses."""

from __future__ import annotations

from dataclasses import dataclass

from mjtactile.sensing.settings.tunable_parameter import SEEN, number

_MONTE_CARLO = "Monte Carlo: covariance compared with the scatter of fits to simulated noise"


@dataclass(frozen=True)
class CandidateSettings:
    """Settings of the search for marker candidates (sensing/image/candidates.py)."""

    cells: int = number(
        60,
        "approximate number of cells of the threshold grid along the shorter image side",
        low=4,
        high=400,
    )
    half_from: float = number(
        4.0,
        "minimum radius, px, from which half the resolution is searched",
        "half resolution shows enough there, in less than half the time",
    )
    margins: tuple[float, float] = number(
        (3.0, 24.0),
        "minimum and maximum of the threshold below the neighborhood, in grey levels of 256",
        "initially 4, independent of the noise; " + SEEN,
    )
    noise: float = number(
        4.0, "threshold due to noise, in median differences of neighboring pixels"
    )
    smallest: float = number(
        0.7, "minimum radius of a border before the fit, relative to the requested minimum radius"
    )


@dataclass(frozen=True)
class EdgeSettings:
    """Settings of the ellipse fit by pixels, for small or strongly blurred markers. See
    sensing/image/edge_fit.py, sensing/image/edge_bands.py."""

    small_radius: float = number(
        7.0,
        "mean radius, px, times a blur of more than 1 px, below which the edge curvature "
        "matters beyond the first order",
    )
    sharpest: float = number(
        0.55,
        "minimum fitted blur, px; less blur was confused with size",
        "smoothing and the pixel area give 0.69 without any blur",
    )
    outlier_residuals: float = number(
        4.0, "residual at which the weight of a pixel decreases, in rms residuals of the marker"
    )
    outlier_fraction: float = number(
        0.1,
        "minimum residual of an outlier pixel, relative to the contrast",
        "effects of lens or camera sharpening that the model does not contain; " + SEEN,
    )
    covariance_factor: float = number(
        4.3, "factor on the covariance: smoothed noise is not white", _MONTE_CARLO
    )
    neighbour_margin: float = number(
        1.5, "excluded margin around another marker, px: most of its blurred edge"
    )
    max_size_ratio: float = number(4.0, "maximum size ratio of a neighboring marker")
    min_distance_fraction: float = number(
        0.7,
        "minimum distance of another marker, relative to its radius; less is the marker "
        "itself or its background",
    )


@dataclass(frozen=True)
class ProfileSettings:
    """Ellipses from profiles across their edges (sensing/image/ellipse_fit.py)."""

    step: float = number(
        0.75,
        "spacing of samples along a profile, px, for blur up to `start_blur`; more blur "
        "increases it",
        low=0.1,
        high=10.0,
    )
    start_blur: float = number(1.1, "initial blur, px; see `step`")
    spacing: float = number(2.0, "arc length between profiles, px", "at first 1; " + SEEN)
    level_outlier: float = number(
        2.5, "bound on the level of a profile, in spreads of the marker's levels"
    )
    outlier_offsets: float = number(
        6.0, "offset at which the weight of a profile decreases, in mean offsets"
    )
    outlier_min: float = number(0.08, "minimum offset of an outlier profile, px")
    max_blur_variance: float = number(
        3.0, "bound on the blur variance of a profile, relative to the median of the image"
    )
    covariance_factor: float = number(
        1.08,
        "factor on the covariance: rounding, interpolation and noise of the blur",
        _MONTE_CARLO,
    )
    motion_sd_fraction: float = number(
        0.5, "relative uncertainty of the motion correction: motion blur is not Gaussian"
    )
    sharpest: float = number(
        0.3,
        "minimum blur, px; less is at most the pixel area",
        "the standard deviation of a pixel's area is 0.29 px",
    )


@dataclass(frozen=True)
class MarkerSettings:
    """Settings of the acceptance of ellipses (sensing/image/fit_validation.py,
    sensing/image/ellipse_fit.py)."""

    profile_min_radius: float = number(6.0, "minimum semi-minor axis for profiles, px")
    profile_min_blurs: float = number(7.5, "minimum semi-minor axis for profiles, in blurs")
    min_blurs: float = number(
        2.8,
        "minimum semi-minor axis, in blurs; below it, radius, blur and level cannot be separated",
    )
    start_blur_fraction: float = number(
        0.3, "initial blur where blur was confused with size, relative to the marker size"
    )
    sure_blurs: float = number(
        5.0, "semi-minor axis above which a marker determines its own blur, in blurs"
    )
    blur_spread: float = number(1.15, "maximum ratio of a marker's blur to that of the image")
    min_motion: float = number(0.06, "minimum motion blur that is not noise, px")
    covered_fraction: float = number(
        0.08, "residual, relative to the contrast, above which part of the edge is covered"
    )
    min_peers: int = number(5, "minimum number of markers for their typical size")
    size_log_tolerance: float = number(
        0.5, "maximum deviation of the log of a marker's size from the median"
    )
    min_edge_distance: float = number(
        3.0, "minimum distance between two edges, or between an edge and the image border, px"
    )
    min_border_axes: float = number(0.15, "minimum axis ratio of a border")
    min_flawed_axes: float = number(0.4, "minimum axis ratio of a border with glare or dirt")
    max_flawed_misfit: float = number(
        0.6, "maximum distance of such a border from its own ellipse, relative to its size"
    )
    max_border_misfit: float = number(
        1.2, "maximum distance of a border from its own ellipse, px, plus ..."
    )
    border_misfit_fraction: float = number(0.2, "... this fraction of its semi-minor axis")
    border_misfit_fraction_cut: float = number(
        0.4, "the same for a border that the image border cuts"
    )
    min_contrast: float = number(5.0, "minimum contrast of a trusted marker, in residuals")
    min_contrast_any: float = number(2.0, "minimum contrast of any marker, in residuals")
    max_shape_sd: float = number(
        0.1, "maximum standard deviation of a trusted shape, relative to the semi-minor axis"
    )
    max_shape_sd_any: float = number(
        0.5, "maximum standard deviation of any marker's shape, relative to the semi-minor axis"
    )
    max_residual: float = number(0.15, "maximum residual of an ellipse, relative to the contrast")
    covered_residuals: float = number(
        5.0,
        "minimum residual for `covered_fraction`, in median residuals of the image",
        "compressed photographs increase the residual of every marker",
    )
    max_lost_weight: float = number(
        0.25, "maximum fraction of the robust weight lost to glare or dirt"
    )
    sharper_ratio: float = number(
        0.7, "ratio to the blur of the image, below which a fit may have confused blur with size"
    )
    max_shape_change: float = number(
        0.25,
        "maximum change from the candidate's shape, relative to the semi-minor axis (plus "
        "`max_border_misfit`)",
    )
    max_move: float = number(
        0.3, "maximum displacement from the candidate, relative to the semi-minor axis (plus 1 px)"
    )
    min_fit_axes: float = number(0.1, "minimum axis ratio of a fit")
    shrunk_fraction: float = number(
        0.5, "minimum radius of any marker, relative to the requested minimum radius"
    )


_FOLLOWED = "egg grasps at 15 and 30 Hz, and the first 20 sequences of `bench tracking`"


@dataclass(frozen=True)
class TrackingSettings:
    """Settings of marker tracking from the previous image without a search
    (sensing/image/tracking.py)."""

    images_between_searches: int = number(
        15, "number of consecutive images without a search", "half a second at 30 Hz"
    )
    max_gap: float = number(
        0.15,
        "maximum time between two images, s; positions are not predicted over a longer time",
        "two images at 15 Hz",
    )
    position_tolerance: float = number(
        1.2,
        "maximum deviation of a marker from its predicted position, px; a fit finds an edge "
        "up to two away",
        _FOLLOWED,
    )
    shape_tolerance: float = number(0.7, "maximum change of its shape, px", _FOLLOWED)
    contrast_tolerance: float = number(
        0.15, "maximum change of a contrast, relative to the minimum contrast", _FOLLOWED
    )
    max_residual: float = number(
        1.7, "maximum ratio to the median residual of the image", _FOLLOWED
    )
    max_lost_weight: float = number(0.02, "maximum lost fraction of the robust weight", _FOLLOWED)


@dataclass(frozen=True)
class ExhaustiveDetectionSettings:
    """Settings of the second search of `mjtactile detect-circles` in photographs
    (sensing/image/exhaustive_detection.py)."""

    closing_size: int = number(
        17,
        "size of the closing, px: it reveals blobs with a radius up to 8 px, on the image "
        "and on smaller ones",
    )
    scale_step: int = number(3, "scale factor from one image to the next smaller one", low=2)
    min_side: int = number(60, "minimum shorter side of the smallest image, px")
    dark_fraction: float = number(
        0.5,
        "minimum darkness of a blob's pixels, relative to the maximum nearby",
        "the center of a blurred edge",
    )
    same_size_ratio: float = number(1.5, "maximum size ratio of two outlines of the same circle")
    inside_ratio: float = number(
        1.3,
        "maximum distance of a part of a circle, in radii of its ellipse, where the kernel's "
        "corner did not fit",
    )
    texture_ring: float = number(
        2.0,
        "distance from a candidate's border of the ring that shows its surroundings, px",
        "outside of the blur, and nearer than the next circle",
    )
    texture_max: float = number(
        0.4,
        "maximum range of the mean gray levels of opposite points on this ring without its ends, "
        "relative to the contrast",
        "circles in clutter: up to 0.13; two thirds of the other candidates exceed 0.4",
    )
    retry_blur: float = number(0.7, "minimum blur for repeating a failed fit, px")
    blur_sd_fraction: float = number(0.1, "relative variation of the blur over a photograph")
    grey_levels: tuple[float, float] = number(
        (0.1, 0.9), "relative levels of an edge that count as grey"
    )
    grey_fraction: float = number(
        0.05,
        "minimum fraction of grey edge pixels; with fewer, the image is only black and white",
        "pixel areas alone give 0.3 for a sharp edge",
    )
    sampled_blur: float = number(
        0.5,
        "blur that such an image receives, px",
        "0.5 to 1 give the same error; the minimum has the best uncertainties",
    )


@dataclass(frozen=True)
class GammaSettings:
    """Settings of the camera gamma estimate (sensing/image/gamma.py)."""

    min_circles: int = number(6, "minimum number of consistent circles")
    max_circles: int = number(
        24,
        "maximum number of evaluated circles",
        "more circles cost time and add less information than model errors hide",
    )
    min_radius: float = number(
        4.0, "minimum semi-minor axis, px; below it, blur and level cannot be separated"
    )
    profile_half_width: float = number(5.0, "evaluated width on both sides of an edge, px")
    start_gamma: float = number(1.5, "initial value of gamma", "between 1 and 2.2")
    start_blur: float = number(0.8, "initial value of the blur, px")
    min_blur: float = number(
        0.6,
        "minimum blur including the pixel area, px; below it, pixel corners are asymmetric "
        "enough to matter",
        "simulated circles: correct from 0.65 on, 3.3 for a true 2.2 at 0.42",
    )
    model_sd_fraction: float = number(
        0.08,
        "standard deviation due to model errors, relative to gamma",
        "simulated circles of 5 to 20 px",
    )
    misfit_sd: float = number(
        1.0,
        "standard deviation of log gamma for residuals at the edges that are twice those elsewhere",
        "JPEG of quality 50 to 95",
        low=0.0,
    )
    range: tuple[float, float] = number(
        (0.3, 4.0),
        "valid range; outside it, the cause is sharpening or clipping",
        "cameras have 1 to 2.6",
    )
    min_sds: float = number(
        3.0, "minimum reported deviation from the assumed gamma, in standard deviations, and ..."
    )
    min_log_change: float = number(0.25, "... in its logarithm", "0.05 px of size")
    size_per_log: float = number(
        0.6, "size error for a unit error of log gamma, px", "simulated circles: 0.4 to 0.6"
    )
