"""Parameters of sensing/pose and sensing/shape: ellipses to circles in space, circles to a
surface."""

from __future__ import annotations

from dataclasses import dataclass

from mjtactile.sensing.settings.tunable_parameter import TRIED, number

_BULGE = (
    "100 simulated sensors with individual stiffness (30 %), pre-stretch (0.02), lens (3 %, "
    "6 px, k1 0.04), camera and pressure (tests/physics/test_rest_shape.py)"
)


@dataclass(frozen=True)
class IdentitySettings:
    """Settings of the assignment of circles to markers (sensing/pose/marker_matching.py)."""

    gate: float = number(
        0.6,
        "maximum distance of a circle from the expected marker position, relative to the pitch",
        TRIED,
    )
    displacement_tolerance: float = number(
        0.45,
        (
            "maximum deviation of a displacement from the neighbors', relative to the pitch; "
            "more is a wrong match"
        ),
        TRIED,
    )
    neighbours: int = number(8, "number of nearest markers for comparison", TRIED, high=64)
    height_weight: float = number(
        1e10,
        "inverse variance of heights for the choice between a circle's two normals, 1/m^2",
        "heights accurate to 10 um",
    )
    shift_resolution: float = number(
        5.0,
        "parts of a pitch: circles agree on a common offset if theirs differ by less than one part",
        TRIED,
    )


@dataclass(frozen=True)
class ReferenceSettings:
    """Acceptance limits of flat and rest references (sensing/pose/flat_reference.py,
    sensing/force/rest_shape_check.py)."""

    radius_range: float = number(
        0.1, "maximum relative deviation of a marker's size from the sensor file", TRIED
    )
    residual_max: float = number(
        2.0,
        "maximum rms residual, px; beyond it, lens, layout or identity is wrong, not the pose",
        TRIED,
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
        (
            "standard deviation of heights, m: splines compared with the finer mesh of a real "
            "membrane"
        ),
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

    roughness: float = number(3e3, "expected rms gradient of the Laplacian, 1/m^2", TRIED)
    laplacian: float = number(300.0, "expected rms Laplacian, 1/m", TRIED)
    markers_min: int = number(4, "minimum number of markers for a surface with status ok", TRIED)
    slope_model_sd: float = number(
        4e-3,
        "standard deviation of a slope's misfit next to a contact edge, which a cubic spline "
        "cannot follow",
        TRIED,
    )
    slope_sd_max: float = number(
        0.02,
        (
            "maximum standard deviation of a slope that is used; heights are more informative "
            "than worse slopes"
        ),
        TRIED,
    )
    outlier_sd: float = number(
        6.0,
        "deviation of an outlier marker from the prediction of the others, in standard "
        "deviations, if it is also ...",
        TRIED,
    )
    outlier_min: float = number(1.2e-3, "... at least this distance, m", TRIED)
    outliers_leave: float = number(0.8, "minimum fraction of the markers that is kept", TRIED)
