"""Exploration loop: touch the most uncertain surface area, fuse, and repeat until a stop."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from mjtactile.core import foreign_file
from mjtactile.core.design import SensorDesign
from mjtactile.core.errors import InputError, SimulationError
from mjtactile.core.flags import Flags
from mjtactile.explore.compliance_map import ComplianceMap
from mjtactile.explore.meshing import mesh_of
from mjtactile.explore.next_best_touch import Aim, Mesh, next_aim
from mjtactile.explore.object_size import Sizes, rivals, size_information_gain, sizes
from mjtactile.explore.patch_from_touch import Pressed, patch_from_press
from mjtactile.explore.surface_fusion import fuse, shares
from mjtactile.explore.surface_patch import Patch
from mjtactile.explore.surface_posterior import SurfacePosterior
from mjtactile.recording.files import to_json

_LARGEST = 1 << 27  # maximum size of a file of patches, bytes
_PLAN_EDGE = 1.5e-3  # triangle edge during exploration, m
_EDGE = 0.8e-3  # triangle edge of the result, m
_MAX_MISSED = 6  # successive touches without contact


class Bench(Protocol):
    """Device that touches the object: a stage or a gripper."""

    @property
    def design(self) -> SensorDesign: ...

    @property
    def flags(self) -> Flags: ...

    def is_reachable(self, aim: Aim) -> bool:
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
    """Result of an exploration. `outcome`: "accurate", "touches" (the requested number), "no points
    left", "no contact" or "interrupted". `families` holds the probability of each shape
    model."""

    patches: tuple[Patch, ...]
    surface: SurfacePosterior
    families: Mapping[str, float]
    mesh: Mesh
    sizes: Sizes
    stiffness: ComplianceMap
    outcome: str
    tried: int
    flags: Flags = field(default_factory=dict)
    failures: tuple[str, ...] = ()

    def summary(self) -> dict[str, Any]:
        """Return the JSON object of `mjtactile explore`; unknown values are NaN here, null in the
        file."""
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
            "touched": [
                {
                    "place_mm": 1e3 * patch.center,
                    "normal": patch.normal,
                    "kind": patch.kind,
                    "force_N": patch.force,
                    "gave_way_mm_per_N": 1e3 * patch.compliance,
                    "gave_way_sd_mm_per_N": 1e3 * patch.compliance_sd,
                }
                for patch in self.patches
            ],
            "failures": list(self.failures),
            "flags": self.flags,
        }


def volume(mesh: Mesh) -> float:
    """Return the volume of a closed mesh, m^3."""
    a, b, c = (mesh.vertices[mesh.triangles[:, k]] for k in range(3))
    return float(np.einsum("ni,ni->", a, np.cross(b, c)) / 6)


def explore(
    bench: Bench,
    goal: ExplorationGoal,
    *,
    known: Sequence[Patch] = (),
    completed: int = 0,
    notify: Callable[[str], None] = lambda _: None,
    keep: Callable[[Patch], None] = lambda _: None,
    stopped: Callable[[], bool] = lambda: False,
) -> ExplorationResult:
    """Explore an object by touches until the goal or a stop.

    Args:
        bench: Device that touches the object.
        goal: Stop criteria.
        known: Patches from earlier touches.
        completed: Number of these earlier touches.
        notify: Callback that receives a line for each touch.
        keep: Callback that receives each new patch.
        stopped: Callback between touches; True stops the exploration.
    """
    patches = list(known)
    hypotheses: Sequence[SurfacePosterior] = fuse(patches)
    targets: list[Aim] = []
    failures: list[str] = []
    missed = 0
    outcome = "touches"
    while completed + len(targets) < goal.touches:
        mesh = mesh_of(hypotheses[0], _PLAN_EDGE)
        if patches and mesh.error() <= goal.accuracy:
            outcome = "accurate"
        elif missed >= _MAX_MISSED and not patches:
            outcome = "no contact"
        elif stopped():
            outcome = "interrupted"
        if outcome != "touches":
            break
        gain = size_information_gain(mesh, hypotheses[0])
        aim = next_aim(mesh, patches, targets, bench.is_reachable, gain)
        if aim is None:
            outcome = "no points left"
            break
        targets.append(aim)
        contacts: tuple[Pressed, ...] = ()
        try:
            contacts = bench.touch(aim, goal.force)
        except SimulationError as error:
            failures.append(str(error))
        new = [patch for contact in contacts if (patch := patch_from_press(contact, bench.design))]
        for patch in new:
            keep(patch)
        patches += new
        missed = 0 if new else missed + 1
        hypotheses = fuse(patches, hypotheses) if new else hypotheses
        notify(_line(completed + len(targets), new, hypotheses[0]))
    if not patches and outcome != "interrupted":
        outcome = "no contact"
    return explored(patches, outcome, completed + len(targets), bench.flags, failures)


def explored(
    patches: Sequence[Patch], outcome: str, tried: int, flags: Flags, failures: Sequence[str] = ()
) -> ExplorationResult:
    """Return the result with these patches."""
    hypotheses = fuse(patches)
    names = [surface.family.name for surface in hypotheses]
    likely = rivals(hypotheses)
    meshes = [mesh_of(surface, _PLAN_EDGE if k else _EDGE) for k, surface in enumerate(likely)]
    return ExplorationResult(
        tuple(patches),
        hypotheses[0],
        dict(zip(names, shares(hypotheses).tolist(), strict=True)),
        meshes[0],
        sizes(meshes, likely, patches),
        ComplianceMap.of(patches, meshes[0]),
        outcome,
        tried,
        flags,
        tuple(failures),
    )


def _line(index: int, new: Sequence[Patch], surface: SurfacePosterior) -> str:
    contacts = ", ".join(f"{patch.kind} at {patch.force:.2f} N" for patch in new) or "no contact"
    sd = f"surface sd {1e3 * mesh_of(surface, _PLAN_EDGE).error():.2f} mm"
    return f"touch {index}: {contacts}; {surface.family.name}, {sd}"


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
        """Read the stored patches; an incomplete last line is left out."""
        try:
            lines = foreign_file.read_text(self.path, _LARGEST, "a list of patches").splitlines()
        except UnicodeDecodeError as error:
            raise InputError(f"is not a list of patches: {error}", source=self.path) from error
        patches = []
        for index, line in enumerate(lines):
            try:
                patches.append(Patch.from_dict(json.loads(line)))
            except (ValueError, KeyError, TypeError, RecursionError) as error:
                if index + 1 == len(lines):
                    break
                raise InputError(
                    f"line {index + 1} is not a patch: {error}", source=self.path
                ) from error
        return patches
