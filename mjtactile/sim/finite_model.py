"""Search for values of a compiled model that are not finite: MuJoCo accepts "nan" in MJCF."""

from __future__ import annotations

import mujoco
import numpy as np

from mjtactile.core.errors import InputError

_OBJECTS = {
    "body": mujoco.mjtObj.mjOBJ_BODY,
    "jnt": mujoco.mjtObj.mjOBJ_JOINT,
    "geom": mujoco.mjtObj.mjOBJ_GEOM,
    "site": mujoco.mjtObj.mjOBJ_SITE,
    "actuator": mujoco.mjtObj.mjOBJ_ACTUATOR,
    "tendon": mujoco.mjtObj.mjOBJ_TENDON,
    "eq": mujoco.mjtObj.mjOBJ_EQUALITY,
    "mesh": mujoco.mjtObj.mjOBJ_MESH,
    "flex": mujoco.mjtObj.mjOBJ_FLEX,
}
"""Elements with names, by the first word of the model's arrays."""
_DERIVED = ("invweight0", "aabb", "ipos", "iquat", "subtreemass", "rbound", "inertia")
"""Ends of the names of arrays that MuJoCo computes; the array with the cause is named first."""
_names: dict[type, list[str]] = {}


def require_finite(model: mujoco.MjModel, source: object, field: str | None = None) -> None:
    """Raise InputError that names the first element with a value that is NaN or infinite."""
    for owner in (model, model.opt):
        for name in _array_names(owner):
            values = np.asarray(getattr(owner, name))
            if not np.isfinite(values).all():
                raise InputError(_message(model, name, values), source=source, field=field)


def _array_names(owner: mujoco.MjModel | mujoco.MjOption) -> list[str]:
    """Return the names of the arrays of floating-point numbers."""
    kind = type(owner)
    if kind not in _names:
        values = {name: getattr(owner, name) for name in dir(owner) if not name.startswith("_")}
        found = [
            name
            for name, value in values.items()
            if isinstance(value, (float, np.ndarray)) and np.asarray(value).dtype.kind == "f"
        ]
        _names[kind] = sorted(found, key=lambda name: name.endswith(_DERIVED))
    return _names[kind]


def _message(model: mujoco.MjModel, name: str, values: np.ndarray) -> str:
    first = np.argwhere(~np.isfinite(np.atleast_1d(values)))[0]
    value = np.atleast_1d(values)[tuple(first)]
    kind, _, rest = name.partition("_")
    if kind not in _OBJECTS:
        return f"{name} is {value}, not finite"
    named = mujoco.mj_id2name(model, _OBJECTS[kind], int(first[0]))
    return f"{rest} of {kind} {named or int(first[0])!r} is {value}, not finite"
