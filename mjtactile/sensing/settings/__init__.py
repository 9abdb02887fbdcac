"""Tuned parameters of the sensing pipeline, each with its meaning and source.

There is one frozen class per stage and one module per subpackage. `Settings` holds one of each;
`DEFAULTS` is used wherever no other settings are given:

    SensingPipeline(design, settings=DEFAULTS.override({"zero.touch_min": 0.03}))

The `source` of a parameter names the benchmark used to fit it or the quantity that bounds it. The
benchmark `bench touch` fits on indentations with seeds below 1000, which are excluded from its own
table. A parameter without a source is tuned by hand; docs/reference/parameters.md lists the effect
of half and twice the value. Recordings keep the settings in their header. Purely numerical
parameters (steps, tolerances) stay with their code.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from mjtactile.core.design import SensorDesign
from mjtactile.core.errors import InputError
from mjtactile.core.renamed import setting_hint
from mjtactile.sensing.settings.force import InverseSettings, PriorSettings
from mjtactile.sensing.settings.force_filters import (
    ContactDetectionSettings,
    FiducialSettings,
    GasFilterSettings,
    ModelErrorSettings,
)
from mjtactile.sensing.settings.image import (
    CandidateSettings,
    EdgeSettings,
    ExhaustiveDetectionSettings,
    GammaSettings,
    MarkerSettings,
    ProfileSettings,
    TrackingSettings,
)
from mjtactile.sensing.settings.pose import (
    IdentitySettings,
    LocateSettings,
    NeighborSmoothingSettings,
    PoseDisambiguationSettings,
    ReferenceSettings,
    SmoothnessSettings,
    SurfaceSettings,
)
from mjtactile.sensing.settings.touch import (
    ContactShapeSettings,
    MaterialSettings,
    PatchSettings,
    SlipSettings,
    SqueezeSettings,
)
from mjtactile.sensing.settings.tunable_parameter import as_numbers as as_numbers
from mjtactile.sensing.settings.tunable_parameter import check, number


@dataclass(frozen=True)
class Settings:
    """Parameters of all stages."""

    min_detected: float = number(
        0.6, "fraction of detected markers below which the shape is unreliable", high=1.0
    )
    markers: MarkerSettings = field(default_factory=MarkerSettings)
    candidates: CandidateSettings = field(default_factory=CandidateSettings)
    tracking: TrackingSettings = field(default_factory=TrackingSettings)
    edges: EdgeSettings = field(default_factory=EdgeSettings)
    profiles: ProfileSettings = field(default_factory=ProfileSettings)
    identity: IdentitySettings = field(default_factory=IdentitySettings)
    reference: ReferenceSettings = field(default_factory=ReferenceSettings)
    surface: SurfaceSettings = field(default_factory=SurfaceSettings)
    prior: PriorSettings = field(default_factory=PriorSettings)
    inverse: InverseSettings = field(default_factory=InverseSettings)
    fiducials: FiducialSettings = field(default_factory=FiducialSettings)
    model_error: ModelErrorSettings = field(default_factory=ModelErrorSettings)
    gas_filter: GasFilterSettings = field(default_factory=GasFilterSettings)
    zero: ContactDetectionSettings = field(default_factory=ContactDetectionSettings)
    patches: PatchSettings = field(default_factory=PatchSettings)
    contact_shape: ContactShapeSettings = field(default_factory=ContactShapeSettings)
    slip: SlipSettings = field(default_factory=SlipSettings)
    squeeze: SqueezeSettings = field(default_factory=SqueezeSettings)
    material: MaterialSettings = field(default_factory=MaterialSettings)
    locate: LocateSettings = field(default_factory=LocateSettings)
    neighbor_smoothing: NeighborSmoothingSettings = field(default_factory=NeighborSmoothingSettings)
    smoothness: SmoothnessSettings = field(default_factory=SmoothnessSettings)
    pose_disambiguation: PoseDisambiguationSettings = field(
        default_factory=PoseDisambiguationSettings
    )
    exhaustive_detection: ExhaustiveDetectionSettings = field(
        default_factory=ExhaustiveDetectionSettings
    )
    gamma: GammaSettings = field(default_factory=GammaSettings)

    def override(self, values: Mapping[str, Any]) -> Settings:
        """Return these settings with new values for fields named like "zero.touch_sd". Raises
        InputError for an unknown name, and for a value of the wrong type or out of range."""
        result = self
        for path, value in values.items():
            stage, _, name = path.rpartition(".")
            owner = getattr(result, stage, None) if stage else result
            is_stage = dataclasses.is_dataclass(owner)
            known = [f.name for f in dataclasses.fields(owner)] if is_stage else []
            if name not in known or dataclasses.is_dataclass(getattr(owner, name)):
                if known and stage:
                    choices = [f"{stage}.{key}" for key in known]
                else:
                    choices = [f.name for f in dataclasses.fields(self)]
                problem = f"unknown setting{setting_hint(path)}"
                raise InputError(problem, source="settings", field=path, choices=choices)
            value = check(owner, stage, name, value)
            changed = replace(owner, **{name: value})  # type: ignore[type-var]  # it is a dataclass
            result = replace(result, **{stage: changed}) if stage else changed
        return result

    def for_mesh(self, design: SensorDesign, mesh: tuple[int, int]) -> Settings:
        """Return these settings for a sensor simulated with `mesh` vertices along x and y."""
        frame = design.frame
        cell = frame.length / (mesh[0] - 1) * frame.width / (mesh[1] - 1)
        spacing = max(math.sqrt(cell), self.contact_shape.mesh_spacing)
        return replace(self, contact_shape=replace(self.contact_shape, mesh_spacing=spacing))

    def to_dict(self) -> dict[str, Any]:
        """Return all parameters by names like "zero.touch_sd"."""
        flat: dict[str, Any] = {}
        for name, value in dataclasses.asdict(self).items():
            if isinstance(value, dict):
                flat |= {f"{name}.{key}": item for key, item in value.items()}
            else:
                flat[name] = value
        return flat


DEFAULTS = Settings()
