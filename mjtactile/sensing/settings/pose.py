"""Numbers of sensing/pose and sensing/shape: ellipses to circles in space, circles to a surface."""

from __future__ import annotations

from dataclasses import dataclass

from mjtactile.sensing.settings.tunable_parameter import TRIED, number

_BULGE = (
    "100 simulated sensors, each with its own stiffness (30 %), pre-stretch (0.02), lens (3 %, 6 "
    "px, k1 0.04), camera and pressure (tests/physics/test_rest_shape.py)"
)


@dataclass(frozen=True)
class IdentitySettings:
    """Settings of the assignment of circles to markers (sensing/pose/marker_matching.py)."""

    gate: float = number(
        0.6,
        "of the pitch: a circle farther from where a marker is expected is not that marker",
        TRIED,
    )
    displacement_tolerance: float = number(
        0.45, "of the pitch: a displacement farther off the neighbours' is a wrong match", TRIED
    )
    neighbours: int = number(8, "nearest markers that a marker is compared with", TRIED, high=64)
    height_weight: float = number(
        1e10,
        "1/m^2, one over the variance of heights that a circle's two normals are judged by",
        "heights known to 10 um",
    )
    shift_resolution: float = number(
        5.0,
        "parts of a pitch: circles whose offsets are nearer than one agree on a common one",
        TRIED,
    )


@dataclass(frozen=True)
class ReferenceSettings:
    """Acceptance limits of flat and rest references (sensing/pose/flat_reference.py,
    sensing/force/rest_shape_check.py)."""

    radius_range: float = number(
        0.1, "share by which a marker's size may be off the sensor file's", TRIED
    )
    residual_max: float = number(
        2.0, "px rms; beyond it, lens, layout or identity is wrong, not the pose", TRIED
    )
    stiffness_off_max: float = number(
        3.0,
        "factor on the sensor file's stiffness",
        "cast rubber varies by a factor of 1.5 from batch to batch",
    )
    bulge_misfit_max: float = number(
        5.0,
        "mean square misfit of the bulge's shape over its variance",
        _BULGE + ": the worst that nothing touched had 3.7, and 1.0 where the lens was measured; "
        "what presses with 0.06 N gives 9 and more where the lens is right",
    )
    bulge_floor: float = number(
        15e-6, "m, of heights: the splines against the finer mesh of a real membrane", _BULGE
    )
    lens_fraction: float = number(
        0.03, "sd of each smooth mode of wrong heights, as a share of them", _BULGE
    )
    lens_fraction_measured: float = number(0.003, "the same where the lens was measured", _BULGE)
    lens_rest: float = number(0.003, "sd of what is not smooth, a share too ...", _BULGE)
    lens_rest_per_px: float = number(
        0.3, "... and how it grows with the residual of the flat membrane, 1/px", _BULGE
    )


@dataclass(frozen=True)
class SurfaceSettings:
    """The smoothing spline through the markers (sensing/surface/surface.py)."""

    roughness: float = number(3e3, "1/m^2, rms gradient of the Laplacian to expect", TRIED)
    laplacian: float = number(300.0, "1/m, rms Laplacian to expect", TRIED)
    markers_min: int = number(4, "fewer markers give a surface whose status is not ok", TRIED)
    slope_model_sd: float = number(
        4e-3,
        "sd of a slope's misfit next to the edge of a contact, where a cubic spline cannot follow",
        TRIED,
    )
    slope_sd_max: float = number(
        0.02, "a slope known worse says less than the heights do, and is left out", TRIED
    )
    outlier_sd: float = number(
        6.0,
        "sd by which a marker off what the others predict is left out, if it is also ...",
        TRIED,
    )
    outlier_min: float = number(1.2e-3, "... that far off, m", TRIED)
    outliers_leave: float = number(0.8, "share of the markers that is always kept", TRIED)
