"""Parameters of sensing/pose and sensing/surface: ellipses to circles in space, circles to a
surface; and of `mjtactile detect-circles`."""

from __future__ import annotations

from dataclasses import dataclass

from mjtactile.sensing.settings.tunable_parameter import SEEN, number

_BULGE = (
    "100 simulated sensors with individual stiffness (30 %), pre-stretch (0.02), lens (3 %, "
    "6 px, k1 0.04), camera and pressure (tests/physics/test_rest_shape.py)"
)


@dataclass(frozen=True)
class IdentitySettings:
    """Settings of the assignment of circles to markers (sensing/pose/marker_matching.py)."""

    gate: float = number(
        0.6, "maximum distance of a circle from the expected marker position, relative to the pitch"
    )
    displacement_tolerance: float = number(
        0.45,
        "maximum deviation of a displacement from the neighbors', relative to the pitch; "
        "more is a wrong match",
    )
    neighbours: int = number(8, "number of nearest markers for comparison", high=64)
    height_weight: float = number(
        1e10,
        "inverse variance of heights for the choice between a circle's two normals, 1/m^2",
        "heights accurate to 10 um",
    )
    shift_resolution: float = number(
        5.0,
        "parts of a pitch: circles agree on a common offset if theirs differ by less than one part",
    )


@dataclass(frozen=True)
class ReferenceSettings:
    """Acceptance limits of flat and rest references (sensing/pose/flat_reference.py,
    sensing/force/rest_equilibrium.py)."""

    radius_range: float = number(
        0.1, "maximum relative deviation of a marker's size from the sensor file"
    )
    residual_max: float = number(
        2.0, "maximum rms residual, px; beyond it, lens, layout or identity is wrong, not the pose"
    )
    stiffness_off_max: float = number(
        3.0,
        "maximum factor on the sensor file's stiffness",
        "cast rubber varies by a factor of 1.5 from batch to batch",
    )
    bulge_misfit_max: float = number(
        5.0,
        "maximum mean squared misfit of the bulge's shape over its variance",
        _BULGE
        + (
            ": at most 3.7 without contact, and 1.0 with a measured lens; a load of 0.06 N gives "
            "9 and more with the right lens"
        ),
    )
    bulge_floor: float = number(
        15e-6,
        "standard deviation of heights, m: splines compared with the finer mesh of a real membrane",
        _BULGE,
    )
    lens_fraction: float = number(
        0.03, "relative standard deviation of each smooth mode of height errors", _BULGE
    )
    lens_fraction_measured: float = number(0.003, "the same with a measured lens", _BULGE)
    lens_rest: float = number(
        0.003, "relative standard deviation of other height errors ...", _BULGE
    )
    lens_rest_per_px: float = number(
        0.3, "... and its increase with the residual of the flat membrane, 1/px", _BULGE
    )


@dataclass(frozen=True)
class SurfaceSettings:
    """The smoothing spline through the markers (sensing/surface/surface.py)."""

    roughness: float = number(3e3, "expected rms gradient of the Laplacian, 1/m^2")
    laplacian: float = number(300.0, "expected rms Laplacian, 1/m")
    markers_min: int = number(4, "minimum number of markers for a surface with status ok")
    slope_model_sd: float = number(
        4e-3,
        "standard deviation of a slope's misfit next to a contact edge, which a cubic spline "
        "cannot follow",
    )
    slope_sd_max: float = number(
        0.02,
        "maximum standard deviation of a slope that is used; heights are more informative "
        "than worse slopes",
    )
    outlier_sd: float = number(
        6.0,
        "deviation of an outlier marker from the prediction of the others, in standard "
        "deviations, if it is also ...",
    )
    outlier_min: float = number(1.2e-3, "... at least this distance, m")
    outliers_leave: float = number(0.8, "minimum fraction of the markers that is kept")


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
        3.0, "distance from a dark circle's edge at which the background is sampled, px"
    )
    inside_fraction: float = number(
        0.4, "radius at which a bright circle is sampled, relative to its size"
    )
    clipped_level: float = number(
        0.98,
        "minimum level of a clipped pixel, relative to the camera's range",
        "one of three averaged channels may not be clipped",
    )
    clipped_fraction: float = number(
        0.5, "fraction of clipped pixels above which the image is overexposed", "majority"
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
    min_median_weight: float = number(0.5, "minimum median weight of consistent circles")
    outlier_scatters: float = number(4.0, "deviation at which weights decrease, in scatters")
    min_weight: float = number(0.1, "weight below which a circle keeps its own elongation")


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
        5.0, "deviation from a second-order surface at which initial weights decrease, in scatters"
    )
    outlier_scatters: float = number(
        4.0, "deviation from the spline at which weights decrease, in scatters"
    )
    min_weight: float = number(0.1, "weight below which a circle keeps its own depth")
    min_agreeing_fraction: float = number(0.8, "minimum fraction of consistent circles")


@dataclass(frozen=True)
class PoseDisambiguationSettings:
    """Settings of the choice between a circle's two poses (sensing/pose/pose_disambiguation.py)."""

    plane_circles: int = number(9, "number of circles for a plane fit, including the circle itself")
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
        4.0, "prior number of independent circles per circle on a surface"
    )
    min_surface_sd: float = number(
        0.035,
        "minimum standard deviation of a plane through neighbors on a bent surface, rad",
        "2 degrees; " + SEEN,
    )
