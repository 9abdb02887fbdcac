"""Exploration loop: touch the most uncertain surface area, fuse, and repeat until a stop
criterion."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from mjtactile.core.design import SensorDesign
from mjtactile.core.errors import InputError, SimulationError
from mjtactile.explore.compliance_map import ComplianceMap
from mjtactile.explore.meshing import mesh_of
from mjtactile.explore.next_best_touch import Aim, Mesh, next_aim
from mjtactile.explore.object_size import Sizes, rivals, size_information_gain, sizes
from mjtactile.explore.patch_from_touch import Pressed, patch_from_press
from mjtactile.explore.surface_fusion import fuse, shares
from mjtactile.explore.surface_patch import Patch
from mjtactile.explore.surface_posterior import SurfacePosterior
from mjtactile.recording.files import to_json

_PLAN_EDGE = 1.5e-3  # triangle edge during exploration, m
_EDGE = 0.8e-3  # triangle edge of the result, m
_IN_VAIN = 6  # limit of successive touches without contact

Say = Callable[[str], None]


class Bench(Protocol):
    """Device that touches the object: a stage or a gripper."""

    @property
    def design(self) -> SensorDesign: ...

    @property
    def flags(self) -> Mapping[str, str]: ...

    def reaches(self, aim: Aim) -> bool:
        """Return True if the sensor can reach the position."""
        ...

    def touch(self, aim: Aim, force: float) -> tuple[Pressed, ...]:
        """Touch the position up to a force, N, and retract."""
        ...


@dataclass(frozen=True)
class ExplorationGoal:
    """Stop criteria: number of `touches`, or surface `accuracy`, m. The accuracy is the root mean
    square of the surface's own standard deviation. `force` is the contact force of a touch, N."""

    touches: int = 12
    accuracy: float = 0.0
    force: float = 0.3


@dataclass(frozen=True, eq=False)
class ExplorationResult:
    """Result of an exploration. `outcome`: "accurate", "touches" (the requested number), "nothing
    left", "nothing there" or "interrupted". `families` holds the probability of each shape
    model."""

    patches: tuple[Patch, ...]
    surface: SurfacePosterior
    families: Mapping[str, float]
    mesh: Mesh
    sizes: Sizes
    stiffness: ComplianceMap
    outcome: str
    tried: int
    flags: Mapping[str, str] = field(default_factory=dict)
    failures: tuple[str, ...] = ()

    def summary(self) -> dict[str, Any]:
        """The JSON of `mjtactile explore`; unknown is NaN here and null there."""
        return {
            "outcome": self.outcome,
            "touches": self.tried,
            "patches": len(self.patches),
            "surface_sd_mm": 1e3 * self.mesh.error(),
            "surface_sd_worst_mm": 1e3 * float(self.mesh.sd.max()),
            "body": self.surface.family.name,
            "body_probabilities": dict(self.families),
            "size_mm": 1e3 * self.sizes.mean,
            "size_sd_mm": 1e3 * self.sizes.sd,
            "size_interval_mm": 1e3 * self.sizes.interval,
            "area_mm2": 1e6 * float(self.mesh.areas().sum()),
            "volume_mL": 1e6 * volume(self.mesh),
            **self.stiffness.summary(),
            "touched": [_row(patch) for patch in self.patches],
            "failures": list(self.failures),
            "flags": dict(self.flags),
        }


def _row(patch: Patch) -> dict[str, Any]:
    return {
        "place_mm": 1e3 * patch.middle,
        "normal": patch.normal,
        "kind": patch.kind,
        "force_N": patch.force,
        "gave_way_mm_per_N": 1e3 * patch.compliance,
        "gave_way_sd_mm_per_N": 1e3 * patch.compliance_sd,
    }


def volume(mesh: Mesh) -> float:
    """Return the volume of a closed mesh, m^3."""
    a, b, c = (mesh.vertices[mesh.triangles[:, k]] for k in range(3))
    return float(np.einsum("ni,ni->", a, np.cross(b, c)) / 6)


def explore(
    bench: Bench,
    wanted: ExplorationGoal,
    *,
    known: Sequence[Patch] = (),
    begun: int = 0,
    say: Say = lambda _: None,
    keep: Callable[[Patch], None] = lambda _: None,
    stopped: Callable[[], bool] = lambda: False,
) -> ExplorationResult:
    """Explore an object.

    Args:
        bench: Device that touches the object.
        wanted: Stop criteria.
        known: Patches from earlier touches.
        begun: Number of these earlier touches.
        say: Callback that receives a line for each touch.
        keep: Callback that receives each new patch.
        stopped: Callback between touches; True stops the exploration.

    Returns:
        The result, also after a stop.
    """
    patches = list(known)
    believed: Sequence[SurfacePosterior] = fuse(patches)
    tried: list[Aim] = []
    failures: list[str] = []
    vain = 0
    outcome = "touches"
    while begun + len(tried) < wanted.touches:
        mesh = mesh_of(believed[0], _PLAN_EDGE)
        if patches and mesh.error() <= wanted.accuracy:
            outcome = "accurate"
        elif vain >= _IN_VAIN and not patches:
            outcome = "nothing there"
        elif stopped():
            outcome = "interrupted"
        if outcome != "touches":
            break
        aim = next_aim(
            mesh, patches, tried, bench.reaches, size_information_gain(mesh, believed[0])
        )
        if aim is None:
            outcome = "nothing left"
            break
        tried.append(aim)
        try:
            felt = bench.touch(aim, wanted.force)
        except SimulationError as error:
            failures.append(str(error))
            felt = ()
        new = [patch for one in felt if (patch := patch_from_press(one, bench.design)) is not None]
        for patch in new:
            keep(patch)
        patches += new
        vain = 0 if new else vain + 1
        believed = _with(new, patches, believed)
        say(_line(begun + len(tried), new, believed[0]))
    if not patches:
        outcome = outcome if outcome == "interrupted" else "nothing there"
    return explored(patches, outcome, begun + len(tried), bench.flags, failures)


def _with(
    new: Sequence[Patch], patches: Sequence[Patch], before: Sequence[SurfacePosterior]
) -> Sequence[SurfacePosterior]:
    """Return the updated surface hypotheses."""
    return fuse(patches, before) if new else before


def explored(
    patches: Sequence[Patch],
    outcome: str,
    tried: int,
    flags: Mapping[str, str],
    failures: Sequence[str] = (),
) -> ExplorationResult:
    """Patches as a result."""
    believed = fuse(patches)
    counting = rivals(believed)
    meshes = [mesh_of(one, _PLAN_EDGE if number else _EDGE) for number, one in enumerate(counting)]
    mesh = meshes[0]
    return ExplorationResult(
        tuple(patches),
        believed[0],
        {
            one.family.name: float(share)
            for one, share in zip(believed, shares(believed), strict=True)
        },
        mesh,
        sizes(meshes, counting, patches),
        ComplianceMap.of(patches, mesh),
        outcome,
        tried,
        dict(flags),
        tuple(failures),
    )


def _line(number: int, new: Sequence[Patch], surface: SurfacePosterior) -> str:
    felt = ", ".join(f"{patch.kind} at {patch.force:.2f} N" for patch in new) or "nothing felt"
    doubt = f"surface sd {1e3 * mesh_of(surface, _PLAN_EDGE).error():.2f} mm"
    return f"touch {number}: {felt}; {surface.family.name}, {doubt}"


class PatchStore:
    """File with the patches of an exploration, one line each. Each patch is written immediately, so
    that an abort loses no data."""

    def __init__(self, path: Path):
        self.path = path

    def write(self, patch: Patch) -> None:
        """Add a patch."""
        with self.path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(to_json(patch.to_dict())) + "\n")

    def read(self) -> list[Patch]:
        """The patches that are there; a line that was cut off while it was written is left out."""
        lines = self.path.read_text(encoding="utf-8").splitlines()
        patches = []
        for number, line in enumerate(lines):
            try:
                patches.append(Patch.from_dict(json.loads(line)))
            except (ValueError, KeyError, TypeError) as error:
                if number + 1 == len(lines):
                    break
                raise InputError(
                    f"line {number + 1} is not a patch: {error}", source=self.path
                ) from error
        return patches
