"""The numbers of the sensing chain that were fitted or judged, not derived: what each is, and where it comes from.

One frozen class a stage; `Settings` holds one of each, `DEFAULTS` is what everything uses that is not told otherwise:

    Chain(design, settings=DEFAULTS.override({"zero.touch_least": 0.03}))

A number's `source` names the benchmark that it was fitted with (`bench touch`: presses with seeds below 1000, which its own
table leaves out), what bounds it, or "trial": it was chosen by trying, and on what was not written down. Recordings keep the
settings in their header. Numbers of the numerics alone (steps, tolerances) stay with their code.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from mjtactile.core.errors import InputError


def _number(default: Any, meaning: str, source: str) -> Any:
    return field(default=default, metadata={"meaning": meaning, "source": source})


_BULGE = ("100 simulated sensors, each with its own stiffness (30 %), pre-stretch (0.02), lens (3 %, 6 px, k1 0.04), camera and "
          "pressure (tests/physics/test_rest_shape.py)")


@dataclass(frozen=True)
class MarkerSettings:
    """Which ellipses are to be trusted (sensing/image/markers.py)."""

    room: float = _number(6.0, "px, semi-minor axis from which on profiles have room", "trial")
    blurred: float = _number(7.5, "times the blur, below which profiles have no room either", "trial")
    too_blurred: float = _number(2.8, "times the blur, below which radius, blur and level cannot be told apart", "trial")
    wide: float = _number(0.3, "of a marker's size: the blur to start from where it was taken for size", "trial")
    unsure: float = _number(5.0, "times the blur; a larger marker knows its own", "trial")
    blur_spread: float = _number(1.15, "factor of one marker's blur over the image's", "trial")
    motion: float = _number(0.06, "px of motion that are no noise", "trial")
    covered: float = _number(0.08, "of the contrast: what a fit leaves over where part of the edge is not the marker's",
                             "trial")
    some: int = _number(5, "markers that say how large markers are", "trial")
    alike: float = _number(0.5, "log of size by which one may differ from their median", "trial")
    close: float = _number(3.0, "px between two edges, or an edge and the image's border, that disturb a fit", "trial")


@dataclass(frozen=True)
class IdentitySettings:
    """Which circle is which marker (sensing/pose/identity.py)."""

    gate: float = _number(0.6, "of the pitch: a circle farther from where a marker is expected is not that marker", "trial")
    inconsistent: float = _number(0.45, "of the pitch: a displacement farther off the neighbours' is a wrong match", "trial")


@dataclass(frozen=True)
class ReferenceSettings:
    """Which flat and resting membranes are believed (sensing/pose/reference.py, sensing/force/bulge.py, sensing/chain.py)."""

    radius_range: float = _number(0.1, "share by which a marker's size may be off the sensor file's", "trial")
    residual_most: float = _number(2.0, "px rms; beyond it, lens, layout or identity is wrong, not the pose", "trial")
    stiffness_off_most: float = _number(3.0, "factor on the sensor file's stiffness",
                                        "cast rubber varies by a factor of 1.5 from batch to batch")
    bulge_misfit_most: float = _number(
        5.0, "mean square misfit of the bulge's shape over its variance", _BULGE + ": the worst that nothing touched had "
        "3.7, and 1.0 where the lens was measured; what presses with 0.06 N gives 9 and more where the lens is right")
    bulge_floor: float = _number(15e-6, "m, of heights: the splines against the finer mesh of a real membrane", _BULGE)
    lens_share: float = _number(0.03, "sd of each smooth mode of wrong heights, as a share of them", _BULGE)
    lens_share_measured: float = _number(0.003, "the same where the lens was measured", _BULGE)
    lens_rest: float = _number(0.003, "sd of what is not smooth, a share too ...", _BULGE)
    lens_rest_per_px: float = _number(0.3, "... and how it grows with the residual of the flat membrane, 1/px", _BULGE)


@dataclass(frozen=True)
class SurfaceSettings:
    """The smoothing spline through the markers (sensing/shape/surface.py)."""

    roughness: float = _number(3e3, "1/m^2, rms gradient of the Laplacian to expect", "trial")
    laplacian: float = _number(300.0, "1/m, rms Laplacian to expect", "trial")
    markers_least: int = _number(4, "fewer markers give a surface whose status is not ok", "trial")
    slope_model_sd: float = _number(4e-3, "sd of a slope's misfit next to the edge of a contact, where a cubic spline cannot "
                                    "follow", "trial")
    slope_sd_most: float = _number(0.02, "a slope known worse says less than the heights do, and is left out", "trial")
    outlier_sd: float = _number(6.0, "sd by which a marker off what the others predict is left out, if it is also ...", "trial")
    outlier_least: float = _number(1.2e-3, "... that far off, m", "trial")
    outliers_leave: float = _number(0.8, "share of the markers that is always kept", "trial")


@dataclass(frozen=True)
class PriorSettings:
    """What is believed of tractions before an image is seen (sensing/force/prior.py)."""

    pressure_sd: float = _number(4e3, "Pa, of contact before anything is known", "trial")
    background: float = _number(0.03, "share of it that a node keeps when nothing was felt there", "trial")
    pressure_most: float = _number(20e3, "Pa; more on one node is a spike that no object makes",
                                   "a sheet of 28 N/m bent around 3 mm")
    friction: float = _number(0.8, "ratio of shear to pressure", "trial")
    correlation: float = _number(2e-3, "m, over which pressures go together: a fraction of an object's size", "trial")
    softening: float = _number(1e-3, "m, over which the pressures found before are smeared", "trial")


@dataclass(frozen=True)
class InverseSettings:
    """Tractions from markers (sensing/force/inverse.py, sensing/force/slopes.py)."""

    spans: tuple[int, int] = _number((14, 10), "intervals of the sheet's spline along x and y", "trial")
    marker_floor: float = _number(8e-6, "m, what the markers' covariance does not know of",
                                  "as coarse as the sheet's splines are")
    excess: float = _number(0.6, "mean square of a marker's noise over its sd, from which on it counts less",
                            "bench touch: force, centroid")
    slope_excess: float = _number(0.5, "the same of a slope", "bench touch: force, centroid")
    slope_model_sd: float = _number(0.01, "what the sheet's splines cannot follow of slopes next to an edge", "bench touch")
    slope_sd_most: float = _number(0.1, "slopes known worse are left out", "trial")
    slope_off_most: float = _number(0.6, "and those farther off what is expected: the other of an ellipse's two", "trial")
    slopes_cell: float = _number(20e-6, "m^2 of sheet to a marker; where it is more, slopes are worth their time", "trial")
    drift_gas: float = _number(2e-4, "sd of the amount of gas since it was measured; the zero follows it",
                               "0.06 K, or 0.2 hPa of weather")
    drift_camera: float = _number(3e-6, "m, sd of the camera's place since then", "10 K in 10 mm of a plastic housing")
    dent_share: float = _number(0.03, "sd of the volume of a dent between the markers, of that volume", "bench touch")
    posterior_share: float = _number(0.17, "of the predicted variance: contacts are smoother than the prior says",
                                     "bench touch: chi-square")
    shear_share: float = _number(0.1, "of that for shear and its torque, which nearly all markers see", "bench touch: chi-square")
    model_share: float = _number(0.006, "of the force: stiffness, discretisation", "bench touch")
    share_cell: float = _number(12e-6, "m^2 of sheet to a marker; where it is more, that share of the normal force grows with it",
                                "bench touch")
    informative_pressure: float = _number(100.0, "Pa; below, the bulge is too small to tell the stiffness", "trial")
    misfit_most: float = _number(50.0, "mean square of the markers' misfit over their sd above which the shape is not explained",
                                 "bench touch")


@dataclass(frozen=True)
class ZeroSettings:
    """Is there a touch, and the zero that follows the weather while there is none (sensing/force/zero.py)."""

    touch_sd: float = _number(5.0, "sd of the noise that a force, or its level, must exceed to be a touch", "trial")
    touch_least: float = _number(0.02, "N that it must exceed too", "trial")
    blend: float = _number(0.5, "of the newest image in the level", "trial")
    jump_sd: float = _number(4.0, "sd; a larger change is no noise: the level follows at once", "trial")
    pull_most: float = _number(0.15, "N; nothing pulls on the membrane, so more than this says that the zero is lost", "trial")
    drift_most: float = _number(30.0, "mean square of the drift found over its variance: the same by the shape", "trial")
    release: float = _number(0.6, "of the threshold, below which a touch ends", "trial")
    noise_first: float = _number(0.01, "N of noise believed at first, or what is predicted where that is less", "trial")
    memory_images: int = _number(30, "images over which the noise is learnt", "trial")
    quiet: float = _number(0.5, "s without touch before the zero follows", "trial")
    follow: float = _number(4.0, "s, time constant of the zero", "trial")
    drift_rate: float = _number(2e-4, "1/s, fastest change of the gas that is weather and no touch", "0.06 K/s")


@dataclass(frozen=True)
class PatchSettings:
    """Where something touches (sensing/touch/patches.py)."""

    smoothing: float = _number(0.6, "sd of the smoothing, in nodes", "trial")
    separate_share: float = _number(0.8, "of the geometric mean of gas pressure and peak; patches are apart where pressure falls "
                                    "below it", "trial")
    area_middle: float = _number(50e-6, "m^2 at which an area is that of its uniform disc", "bench touch")
    area_power: float = _number(-0.35, "how their ratio goes with the area", "bench touch")
    area_cell: float = _number(12e-6, "m^2 of sheet to a marker for which that holds", "bench touch")
    sparse_power: float = _number(0.3, "sparser markers blur larger areas", "bench touch")
    area_factor: tuple[float, float] = _number((0.7, 1.7), "least and most of that ratio", "a face pressed at its rim, a ball")
    core_share: float = _number(0.03, "of the peak: pressure below it does not count for the centroid", "trial")
    least_share: float = _number(0.1, "of the whole force: a patch that carries less is no patch", "trial")


@dataclass(frozen=True)
class SlipSettings:
    """Whether the object slips (sensing/touch/slip.py)."""

    incipient: float = _number(0.7, "share of the friction limit from which on slip begins", "trial")
    slipping: float = _number(0.95, "share of it that is slip", "trial")
    memory: float = _number(0.05, "s, over which the patch's velocity is averaged", "trial")
    moved: float = _number(2.5e-4, "m over the material: more than noise makes of a patch that sticks", "trial")
    speed: float = _number(4e-3, "m/s, the same of its velocity", "trial")
    least_used: float = _number(0.4, "share of the friction limit below which a wandering patch is taken for rolling or for a "
                                "changed load", "trial")
    least_force: float = _number(0.05, "N; below, neither the patch nor its shear are known well enough", "trial")
    forget: float = _number(1.0, "s, in which the point that the patch stuck to is forgotten while shear is low", "trial")


@dataclass(frozen=True)
class Settings:
    """All stages' numbers."""

    fewest_seen: float = _number(0.4, "share of the markers below which the shape is a guess", "trial")
    markers: MarkerSettings = MarkerSettings()
    identity: IdentitySettings = IdentitySettings()
    reference: ReferenceSettings = ReferenceSettings()
    surface: SurfaceSettings = SurfaceSettings()
    prior: PriorSettings = PriorSettings()
    inverse: InverseSettings = InverseSettings()
    zero: ZeroSettings = ZeroSettings()
    patches: PatchSettings = PatchSettings()
    slip: SlipSettings = SlipSettings()

    def override(self, values: Mapping[str, Any]) -> Settings:
        """These settings with others for fields named like "zero.touch_sd". Raises InputError for a name that does not exist,
        and for a value that is not of the field's kind."""
        result = self
        for path, value in values.items():
            stage, _, name = path.rpartition(".")
            owner = getattr(result, stage, None) if stage else result
            known = [f.name for f in dataclasses.fields(owner)] if dataclasses.is_dataclass(owner) else []
            if name not in known or dataclasses.is_dataclass(getattr(owner, name)):
                choices = [f"{stage}.{key}" for key in known] if known and stage else [f.name for f in dataclasses.fields(self)]
                raise InputError("unknown setting", source="settings", field=path, choices=choices)
            if not _alike(value, getattr(owner, name)):
                raise InputError(f"{value!r} is not like {getattr(owner, name)!r}", source="settings", field=path)
            changed = replace(owner, **{name: value})  # type: ignore[type-var]  # it is a dataclass
            result = replace(result, **{stage: changed}) if stage else changed
        return result

    def to_dict(self) -> dict[str, Any]:
        """All numbers by names like "zero.touch_sd"."""
        flat: dict[str, Any] = {}
        for name, value in dataclasses.asdict(self).items():
            flat |= {f"{name}.{key}": item for key, item in value.items()} if isinstance(value, dict) else {name: value}
        return flat


def _alike(value: Any, default: Any) -> bool:
    """Whether a value may stand for the default: finite, a whole number for one, as many for several."""
    if isinstance(default, tuple):
        return isinstance(value, tuple) and len(value) == len(default) and all(map(_alike, value, default))
    whole = isinstance(value, int) and not isinstance(value, bool)
    return whole or (isinstance(default, float) and isinstance(value, float) and math.isfinite(value))


DEFAULTS = Settings()
