"""Snapshot and restoration of the complete state of a simulated world.

MuJoCo's data and model arrays and every mutable attribute of the run-time objects are copied.
Arrays are restored in place. Views of them and addresses held by kernels stay valid.
"""

from __future__ import annotations

import copy
from collections import deque
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np

from mjtactile.sim.scenes.world import World


class Snapshot:
    """The state of `world`, and of the other objects that belong to it, now."""

    def __init__(self, world: World, *others: Any):
        self._world = world
        self._data = copy.copy(world.data)
        self._undo: list[Callable[[], None]] = []
        self._seen: set[int] = {id(world.model), id(world.data)}
        for name in dir(world.model):
            if not name.startswith("_") and isinstance(getattr(world.model, name), np.ndarray):
                self._keep_array(getattr(world.model, name))
        for thing in (world, *others):
            self._keep(thing)

    def restore(self) -> None:
        """Go back to it; the world must not be moving."""
        mujoco.mj_copyData(self._world.data, self._world.model, self._data)
        for undo in self._undo:
            undo()

    def _keep(self, thing: Any) -> None:
        """Record the undo action that restores `thing` and its contents to the current state."""
        if id(thing) in self._seen:
            return
        if isinstance(thing, np.ndarray):
            self._keep_array(thing)
        elif isinstance(thing, np.random.Generator):
            self._seen.add(id(thing))
            state = copy.deepcopy(thing.bit_generator.state)
            self._undo.append(lambda: setattr(thing.bit_generator, "state", copy.deepcopy(state)))
        elif isinstance(thing, (list, deque, dict, set)):
            self._keep_container(thing)
        elif isinstance(thing, tuple):
            for part in thing:
                self._keep(part)
        elif type(thing).__module__.startswith("mjtactile.") and hasattr(thing, "__dict__"):
            self._keep_object(thing)

    def _keep_array(self, array: np.ndarray) -> None:
        self._seen.add(id(array))
        if not array.flags.writeable or array.dtype == object:
            return
        was = array.copy()
        self._undo.append(lambda: np.copyto(array, was))

    def _keep_container(self, thing: Any) -> None:
        self._seen.add(id(thing))
        was = thing.copy()

        def undo() -> None:
            thing.clear()
            thing.update(was) if isinstance(thing, (dict, set)) else thing.extend(was)

        self._undo.append(undo)
        for part in was.values() if isinstance(was, dict) else was:
            self._keep(part)

    def _keep_object(self, thing: Any) -> None:
        self._seen.add(id(thing))
        was = dict(vars(thing))

        def undo() -> None:
            vars(thing).clear()
            vars(thing).update(was)

        self._undo.append(undo)
        for value in was.values():
            self._keep(value)
