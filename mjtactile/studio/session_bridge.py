"""`SessionBridge`: snapshots of a session and requests to it. The session's thread writes, the
viewer's thread reads, and neither waits.

It observes a run. The session's own thread handles requests to the world (a valve, a pull). It does
so after a cycle's images, while simulated time is stopped, like a controller's command.
"""

from __future__ import annotations

import math
import queue
import threading
import time as wall
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mjtactile.core import signals
from mjtactile.core.errors import DeviceError, Interrupted, SimulationError
from mjtactile.core.flags import Flags
from mjtactile.core.scenario import Scenario
from mjtactile.core.types import Array, Image, Surface
from mjtactile.recording.observer import Observer
from mjtactile.runtime.controller import LoadedController
from mjtactile.runtime.cycle import Cycle
from mjtactile.runtime.session import Session
from mjtactile.studio.manual_control import ManualControl, ManualGoal
from mjtactile.studio.snapshot import FingerSnapshot, History, Pose, SessionState, StudioSnapshot

RED_BUTTON = "the red button was pressed"
_PAUSED = 0.02  # period of checks during a pause, s

Task = Callable[[Session], None]


class RestartRequested(SimulationError):
    """Request for another run: the present world is abandoned."""

    def __init__(self) -> None:
        super().__init__("another run was requested", step=0, time=0.0)


@dataclass(frozen=True)
class ChamberReadings:
    """Gauge pressures, Pa, and temperatures, K, of simulated chambers, one per finger."""

    pressure: tuple[float, ...] = ()
    temperature: tuple[float, ...] = ()


class SessionBridge(Observer):
    """Observer of `run_grasp`; `take_over` wraps the controller of `scenario`."""

    def __init__(
        self, scenario: Scenario | None = None, notify: Callable[[str], None] = lambda _: None
    ):
        self.scenario = scenario or Scenario()
        self.session: Session | None = None
        self.latest: StudioSnapshot | None = None
        self.history = History()
        self.last_message = ""
        self.outcome = ""
        self.runs = 0
        self.paused = False
        self.fastest = 1.0
        """Maximum ratio of simulated to wall-clock time (inf: no limit)."""
        self.restart = threading.Event()
        self.closed = threading.Event()
        self.pull: Array | None = None
        """Wrenches (bodies, 6) of the mouse on MuJoCo bodies from now on, N and N m."""
        self._manual_goal: ManualGoal | None = None
        self._manual: ManualControl | None = None
        self._single = False
        self._halted = False
        self._flagged: set[str] = set()
        """Kinds of flags that were already reported."""
        self._gas = ChamberReadings()
        self._notify = notify
        self._tasks: queue.SimpleQueue[Task] = queue.SimpleQueue()
        self._pace: tuple[float, float] | None = None

    # called by the session's thread

    def start(self, session: Session) -> None:
        """Start a session, and reset the state of the previous one."""
        self.session = session
        self.latest = None
        self.outcome = ""
        self._pace = None
        self._halted = False
        self._flagged = set()
        self.history.clear()
        self.runs += 1

    def take_over(self, controller: LoadedController) -> LoadedController:
        """Return the controller, wrapped so that manual control can override it."""
        self._manual = ManualControl(controller)
        self._manual.manual_goal = self._manual_goal
        return self._manual

    def add_reference(
        self, stage: str, images: Sequence[Sequence[Image]], gauge_pressure: Sequence[float | None]
    ) -> None:
        self.last_message = ""  # clears the message that the reference is being taken
        if self._halted:  # no motion has started that the supervisor could reverse
            raise DeviceError(RED_BUTTON)
        if self.restart.is_set() or self.closed.is_set():
            raise RestartRequested

    def message(self, text: str) -> None:
        self.last_message = text
        self._notify(text)

    def note(self, **facts: Any) -> None:
        """Report each kind of simulation flag once."""
        flags: Flags = facts.get("flags", {})
        for kind in flags.keys() - self._flagged:
            self.message(f"warning ({kind}): {flags[kind]}")
        self._flagged |= flags.keys()

    def on_images(self) -> None:
        """Handle requests while simulated time is stopped, and wait during a pause.

        Raises RestartRequested after a request for another run.
        """
        self._work()
        while self.paused and not self._single:
            self._leave()
            wall.sleep(_PAUSED)
            self._work()
            self._pace = None
            if interrupted():  # the loop ends the run in order, and a pause would hold it up
                self.paused = False
        self._single = False
        self._leave()
        scene = None if self.session is None else self.session.rig.scene
        if scene is not None:
            self._gas = ChamberReadings(
                tuple(s.gauge_pressure for s in scene.sensors),
                tuple(s.temperature for s in scene.sensors),
            )

    def add(self, cycle: Cycle, view: Any = None, **truth: Any) -> None:
        """Show a cycle, and keep to the clock. Raises Restart when another run was requested."""
        number = 0 if self.latest is None else self.latest.number + 1
        snapshot = snapshot_of(cycle, self.session, view, truth, self._gas, number)
        self.history.add(snapshot)
        self.latest = snapshot
        self._leave()
        self._wait(cycle.time)

    # called by the viewer's thread

    def snapshot(self) -> StudioSnapshot | None:
        """Return the snapshot to show."""
        return self.latest

    @property
    def pulls(self) -> float:
        """Maximum pull force of the mouse, N."""
        return 0.0 if self.pull is None else float(np.linalg.norm(self.pull[:, :3], axis=1).max())

    def ask(self, task: Task) -> None:
        """Queue `task` for the session's thread, at the next stop of simulated time."""
        self._tasks.put(task)

    def step(self) -> None:
        """Run one more cycle, then pause."""
        self.paused = True
        self._single = True

    @property
    def may_pause(self) -> bool:
        """A simulated world waits. Real devices would treat the loop as stopped."""
        return self.session is None or not math.isfinite(self.session.rig.host_timeout)

    @property
    def manual_goal(self) -> ManualGoal | None:
        """Manual goal that replaces the controller's commands; None: the controller runs."""
        return self._manual_goal

    @manual_goal.setter
    def manual_goal(self, manual_goal: ManualGoal | None) -> None:
        self._manual_goal = manual_goal
        if self._manual is not None:
            self._manual.manual_goal = manual_goal

    def halt(self) -> None:
        """Start the retreat, as the red button requests."""
        self._halted = True
        self.paused = False
        if self.session is not None:
            self.session.make_safe(RED_BUTTON)

    def again(self, scenario: Scenario) -> None:
        """Abort this run and start another."""
        self.scenario = scenario
        self.restart.set()

    def _work(self) -> None:
        if (session := self.session) is None:
            return
        for _ in range(self._tasks.qsize()):
            self._try(self._tasks.get(), session)
        if (pull := self.pull) is not None:
            self._try(lambda it: _pull(it, pull), session)

    def _try(self, task: Task, session: Session) -> None:
        try:
            task(session)
        except Exception as error:  # noqa: BLE001  # the run continues; the panel shows it
            self.message(f"{type(error).__name__}: {error}")

    def _leave(self) -> None:
        """Abandon a simulated world; on a real rig, lower and open the gripper first."""
        if not (self.restart.is_set() or self.closed.is_set()):
            return
        if self.session is None or self.may_pause:
            raise RestartRequested
        self.session.make_safe(
            "Studio was closed" if self.closed.is_set() else "another run was requested"
        )

    def _wait(self, time: float) -> None:
        """Wait until the wall clock reaches the time of a simulated rig that is ahead of it."""
        if (
            self.session is None
            or self.session.rig.scene is None
            or not math.isfinite(self.fastest)
        ):
            return
        now = wall.monotonic()
        if self._pace is None or (time - self._pace[1]) / self.fastest < now - self._pace[0]:
            self._pace = (now, time)
        wall.sleep(max(0.0, self._pace[0] + (time - self._pace[1]) / self.fastest - now))


def interrupted() -> bool:
    """Return True if a signal requested the end of the process."""
    try:
        signals.check()
    except Interrupted:
        return True
    return False


def snapshot_of(
    cycle: Cycle,
    session: Session | None,
    view: Any,
    truth: Mapping[str, Any],
    gas: ChamberReadings,
    number: int,
) -> StudioSnapshot:
    """Return a cycle's snapshot, with the ground truth if it is available."""
    fingers = []
    count = len(cycle.touch)
    true = truth.get("force_normal_true", [math.nan] * count)
    poses = _poses(cycle, view)
    for k, (touch, image) in enumerate(zip(cycle.touch, cycle.images, strict=True)):
        finger = None if session is None else session.rig.fingers[k]
        fingers.append(
            FingerSnapshot(
                str(k) if finger is None else finger.name,
                image,
                touch,
                None if finger is None else finger.design,
                None if session is None else _rest_surface(session, k),
                poses[k],
                cycle.valves[k] if k < len(cycle.valves) else None,
                true[k],
                gas.pressure[k] if gas.pressure else math.nan,
                gas.temperature[k] if gas.temperature else math.nan,
                tracks=None
                if session is None
                else getattr(getattr(session.perceptions[k], "state", None), "tracks", None),
            )
        )
    state = SessionState(
        cycle.sent.phase,
        getattr(cycle, "state", "running"),
        getattr(cycle, "reason", ""),
        cycle.gripper.opening,
        cycle.gripper.lift_height,
        cycle.perception_ms,
    )
    return StudioSnapshot(
        number,
        cycle.time,
        tuple(fingers),
        state,
        None if view is None else (view.model, view.state),
        {} if session is None else session.flags,
    )


def _rest_surface(session: Session, finger: int) -> Surface | None:
    """Return the finger's membrane without contact, as measured by its sensing pipeline."""
    reference = getattr(getattr(session.perceptions[finger], "state", None), "reference", None)
    return None if reference is None else reference.surface


def _poses(cycle: Cycle, view: Any) -> list[Pose]:
    """Return the fingers' poses; without a scene, around the center, facing inward."""
    if view is not None:
        return [Pose(p, R) for p, R in zip(view.p_WS, view.R_WS, strict=True)]
    opening, height = np.nan_to_num([cycle.gripper.opening, cycle.gripper.lift_height]).tolist()
    poses = []
    for k in range(len(cycle.touch)):
        angle = 2 * math.pi * k / len(cycle.touch)
        inwards = np.array([math.cos(angle), math.sin(angle), 0.0])
        up = np.array([0.0, 0.0, 1.0])
        axes = np.column_stack([up, np.cross(inwards, up), inwards])
        poses.append(Pose(height * up - opening / 2 * inwards, axes))
    return poses


def _pull(session: Session, force: Array) -> None:
    if session.rig.scene is not None and session.rig.scene.data.xfrc_applied.shape == force.shape:
        session.rig.scene.data.xfrc_applied[:] = force
