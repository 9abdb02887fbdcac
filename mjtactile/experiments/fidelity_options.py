"""Scene settings from `--accuracy` and `--effects`: active effects, mesh and time step."""

from __future__ import annotations

from typing import Any

from mjtactile.core.design import SensorDesign
from mjtactile.sim.effects.catalog import choose, parse, quasistatic_is_valid
from mjtactile.sim.effects.fidelity import DEFAULT_FORCE_ERROR, Fidelity
from mjtactile.sim.scenes.objects import load_object
from mjtactile.sim.sensor.effect_switches import set_design


def effects_of(
    design: SensorDesign, object_name: str, accuracy: str, overrides: str
) -> tuple[str, float, list[dict[str, Any]]]:
    """Return object, required force error, N, and a row per effect. Raises InputError."""
    grasped = load_object(object_name)
    membranes = bool(accuracy) and quasistatic_is_valid(design, grasped, overrides)
    fidelity = _fidelity(accuracy, membranes)
    requested = _force_error(fidelity)
    if fidelity is None:
        chosen = choose(design, grasped, force_error=requested, overrides=overrides)
        return grasped.name, requested, chosen.summary()
    switched = fidelity.with_effects(overrides)
    rows = choose(design, grasped, force_error=requested, overrides=switched).summary()
    for row in rows:
        if row["effect"] in parse(fidelity.effects) and row["effect"] not in parse(overrides):
            row["why"] = (
                f"the quasi-static membrane is sufficient: {1e3 * fidelity.force_error:.2g} mN"
            )
    return grasped.name, requested, rows


def simulation_of(
    design: SensorDesign, accuracy: str, overrides: str, mesh: tuple[int, int] | None = None
) -> tuple[SensorDesign, dict[str, Any]]:
    """Return the sensor with its effects, and effects, mesh and time step of its world. `mesh`
    replaces that of the required accuracy."""
    fidelity = _fidelity(accuracy)
    effects = choose(design, force_error=_force_error(fidelity), overrides=overrides).on
    how = {} if fidelity is None else {"mesh": fidelity.mesh, "timestep": fidelity.timestep}
    if mesh is not None:
        how["mesh"] = mesh
    return set_design(design, effects), {"effects": effects} | how


def _fidelity(accuracy: str, membranes: bool = False) -> Fidelity | None:
    return Fidelity.parse(accuracy, membranes=membranes) if accuracy else None


def _force_error(fidelity: Fidelity | None) -> float:
    return DEFAULT_FORCE_ERROR if fidelity is None else fidelity.asked
