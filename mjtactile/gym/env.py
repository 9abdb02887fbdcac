"""`mjtactile/Grasp-v0`: grasp, lift, hold for two seconds and set down.

The observation is the fingers' camera data. A step is a camera period. As in the control loop, the
world continues during the computation. An action takes effect one period after its images. The same
supervisor and limits act between action and gripper.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import Any, ClassVar

import gymnasium
import numpy as np

from mjtactile.core.errors import DeviceError, InputError, SimulationError
from mjtactile.core.fidelity_levels import disabled_effects
from mjtactile.core.flags import merge_flags
from mjtactile.core.not_copyable import NotCopyable
from mjtactile.core.option_requirements import require_effects
from mjtactile.core.policy import command_from_action, fraction_released
from mjtactile.core.scenario import Scenario
from mjtactile.core.signature_checks import above, validated
from mjtactile.core.task import load_task
from mjtactile.core.types import Array
from mjtactile.gym.observation_space import show, space_of
from mjtactile.recording.observer import Observer, Observers
from mjtactile.recording.policy_data import REWARDS
from mjtactile.rig.domain_randomization import NONE
from mjtactile.rig.finger import Rig
from mjtactile.rig.registry import SIMULATES, build_rig, request_of
from mjtactile.runtime.cycle import ControlCycle
from mjtactile.runtime.grasp_scoring import GraspScore
from mjtactile.runtime.perception_threads import Perceivers
from mjtactile.runtime.session import Session
from mjtactile.runtime.set_down import ENDS
from mjtactile.runtime.supervisor import Supervisor
from mjtactile.runtime.task_scoring import TaskScorer
from mjtactile.runtime.uncertain_force_monitor import UncertainForceMonitor
from mjtactile.sim.fast_reset import Restart, movable

RANDOM = "random"
"""Object name for a random object, different for each seed."""
PROGRESS = {
    "approach": (0.0, 0.2),
    "close": (0.2, 0.2),
    "regulate": (0.4, 0.1),
    "lift": (0.5, 0.5),
    "hold": (1.0, 0.5),
    "lower": (1.5, 0.5),
    "release": (2.0, 0.5),
    "done": (2.5, 0.0),
}
"""Progress of a grasp at the start of a phase, and its increase during the phase.

`reward="progress"` pays the increase over the episode's maximum so far, with contact on all fingers
except while closing and releasing. An object that was never held earns no release.
"""
_DEFAULTS = vars(Scenario())
_RESET: Any = {"source": "Grasp-v0: reset"}
_TOUCHLESS = ("approach", "close", "release", "done")
_AFTER_HOLDING = ("release", "done")


@validated(time_limit=above(0, math.inf))
class GraspEnv(NotCopyable, gymnasium.Env[Any, Array]):
    """Environment with one grasp per episode.

    Actions: speed of opening, force limit and lift speed, each in [-1, 1]
    (`mjtactile.command_from_action`). Seeds are those of `grasp` and `evaluate`: the same placement
    and noise.

    Args:
        object: Option of `mjtactile grasp`; so are `sensor`, `rig`, `randomization`, `effects`,
            `accuracy`.
        observation: "wrench", "markers" or "image".
        time_limit: Time limit of an episode, s.
        reward: "outcome", at the end only, or "progress", in addition for contact and phases
            reached: for learning from scratch.
        render_mode: None, or "rgb_array": the cameras' images.
        scenario: Replacement for all of these names, which are then not given. Its own seed,
            controller and time limit are ignored.
        task: Task: a shipped name, or FILE.toml.

    Raises:
        InputError: A name does not exist, or the options cannot be combined.
    """

    REMEDY = "create another environment and reset it with the same seed"
    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["rgb_array"], "render_fps": 30}

    def __init__(
        self,
        object: str = "egg",
        sensor: str = "dense",
        rig: str = "sim",
        randomization: str = NONE,
        observation: str = "wrench",
        effects: str = "auto",
        accuracy: str = "",
        time_limit: float = 20.0,
        render_mode: str | None = None,
        scenario: Scenario | None = None,
        task: str = "lift",
        reward: str = "outcome",
    ):
        modes = self.metadata["render_modes"]
        if reward not in ("outcome", "progress"):
            raise _refusal(f"{reward!r}", "reward", ["outcome", "progress"])
        if render_mode not in (None, *modes):
            raise _refusal(f"{render_mode!r}", "render_mode", modes)
        self.render_mode = render_mode
        self._kind = observation
        self._limit = time_limit
        self._pays_progress = reward == "progress"
        self._max_progress = 0.0
        world: Any = {"object": object, "sensor": sensor, "rig": rig, "task": task}
        levels: Any = {"randomization": randomization, "effects": effects, "accuracy": accuracy}
        given = [name for name in (world | levels) if (world | levels)[name] != _DEFAULTS[name]]
        if scenario is not None and given:
            text = "is already in the scenario; use dataclasses.replace to change it"
            raise InputError(text, source="Grasp-v0", field=given[0])
        self.scenario = scenario or Scenario(**world, **levels)
        self._session: Session | None = None
        self._restart: Restart | None = None
        self._cycle: Any = None  # before the first reset
        self._over = True
        self._build(0)
        designs = [finger.design for finger in self._rig.fingers]
        effects_on = self._rig.scene.effects
        self._left_out = dict.fromkeys(disabled_effects(effects_on), False)
        try:
            options = {"observation": observation, "render_mode": render_mode}
            require_effects(effects_on, "Grasp-v0", **options)
        except InputError:
            self.close()
            raise
        self.observation_space = space_of(observation, designs)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (3,), np.float32)
        metadata = {**self.metadata, "render_fps": round(1 / self._rig.period)}
        self.metadata = metadata  # pyright: ignore[reportAttributeAccessIssue]
        self._markers = designs[0].markers.count

    # -- Gymnasium --------------------------------------------------------------------------------

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start the episode of `seed` (None: the generator's next), inflated and without
        contact."""
        self._require_open()
        if seed is not None and (not isinstance(seed, int | np.integer) or seed < 0):
            text = f"{seed!r} is not a whole number of at least 0"
            raise InputError(text, **_RESET, field="seed")
        if options is not None and not (isinstance(options, Mapping) and not options):
            text = f"{options!r} has no effect; object and task are arguments of the environment"
            raise InputError(text, **_RESET, field="options", choices=["None"])
        super().reset(seed=None if seed is None else int(seed))
        self._seed = int(self.np_random.integers(2**31)) if seed is None else int(seed)
        if self._restart is None:
            self._build(self._seed)
        else:
            self._restart.again(self._seed)
            for perception, state in zip(self._session.perceptions, self._states, strict=True):  # type: ignore[union-attr]
                perception.state = state  # type: ignore[attr-defined]
        rig = self._rig
        self._score = GraspScore(rig.scene, TaskScorer.of(self._scenario_of(self._seed), rig))
        rig.scene.after_each_step_batch(self._score.after_step_batch, self._score.due)
        self._over = False
        self._max_progress = 0.0
        assert self._session is not None
        names = [finger.name for finger in rig.fingers]
        perceivers = Perceivers(self._session.perceptions, names, threads=0)
        self._uncertain = UncertainForceMonitor(names)
        observer = Observers([_CycleObserver(self._score), self._uncertain])
        self._cycle = ControlCycle.start(rig, perceivers, Supervisor(rig.period), observer)
        self._start = self._cycle.now
        self._update()
        self._opening = max(self._seen.gripper.opening, 1e-6)
        return self._shown(), self._info()

    def step(self, action: Array) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Step by one camera period with `action`. Call `reset` after the end of an episode."""
        self._require_open()
        if self._over:
            text = "no episode has started" if self._cycle is None else "the episode has ended"
            raise gymnasium.error.ResetNeeded(f"{text}: call reset()")
        rig = self._rig
        cycle = self._cycle
        deadline = cycle.now + rig.period
        requested = command_from_action(self._seen, action)
        rig.clock.advance_towards(deadline)
        sent = cycle.send(requested)
        self._score.send(sent.phase)
        outcome = ""
        try:
            rig.clock.wait_until(deadline)
            self._update()
        except (SimulationError, DeviceError) as error:
            outcome = "dropped" if self._score.lost else "error"
            self._problem = " ".join(str(error).split())
        outcome = outcome or self._outcome()
        is_late = rig.clock.now() - self._start >= self._limit - rig.period / 2
        truncated = outcome == "error" or (not outcome and is_late)
        self._over = bool(outcome) or truncated
        info = self._info() | ({"outcome": outcome or "out of time"} if self._over else {})
        reward = REWARDS.get(outcome, 0.0) + (self._progress() if self._pays_progress else 0.0)
        return self._shown(), reward, bool(outcome) and outcome != "error", truncated, info

    def render(self) -> Array | None:
        """Return the cameras' images side by side (h, w, 3), uint8; None without a render mode."""
        self._require_open()
        if self.render_mode is None or self._cycle is None:
            return None
        grey = np.concatenate([image.pixels for image in self._cycle.images], axis=1)
        return np.repeat(grey[..., None], 3, axis=2)

    def close(self) -> None:
        """Close the simulation."""
        if self._session is not None:
            self._session.rig.close()
            self._session = None

    def _require_open(self) -> None:
        if self._session is None:
            raise InputError("is closed: create another one", source="Grasp-v0")

    # -- inside --------------------------------------------------------------------------------

    @property
    def _rig(self) -> Rig:
        assert self._session is not None, "the environment is closed"
        return self._session.rig

    def _scenario_of(self, seed: int) -> Scenario:
        """Return the scenario of an episode. A "random" object is that of the seed."""
        name = self.scenario.object
        name = f"{name}:{seed}" if name == RANDOM else name
        return replace(self.scenario, seed=seed, object=name)

    def _build(self, seed: int) -> None:
        """Build a new world and take the references. Keep its state for a fast reset."""
        self.close()
        scenario = self._scenario_of(seed)
        if request_of(scenario)[0] not in SIMULATES:  # before a device is opened
            text = f"the rig {self.scenario.rig!r} is not a simulated rig"
            raise _refusal(text, "rig", SIMULATES)
        rig = build_rig(scenario)
        if rig.touch_is_synthetic:  # a thread would cost more than it saves
            rig.clock.step_in_turn()  # pyright: ignore[reportAttributeAccessIssue]
        self._session = Session(rig, threads=0, contact_shapes=self.scenario.contact_shapes or None)
        self._session.take_references()
        is_plain = load_task(self.scenario.task).is_plain and self.scenario.object != RANDOM
        if self.scenario.randomization == NONE and is_plain and movable(rig.scene):
            self._restart = Restart(rig, seed)
            self._states = [perception.state for perception in self._session.perceptions]  # type: ignore[attr-defined]

    def _update(self) -> None:
        """Take the current images, estimate the touches and store the controller's observation."""
        self._problem = ""
        self._cycle.read_sensors()
        self._seen = self._cycle.observe()
        if self._cycle.failure is not None:
            raise self._cycle.failure

    def _shown(self) -> Any:
        return show(self._kind, self._seen, self._cycle.images, self._markers)

    def _progress(self) -> float:
        """Return the increase of the grasp progress by the newest step."""
        phase = self._cycle.last.phase
        touched = all(touch.touching for touch in self._seen.touch)
        if phase not in PROGRESS or not (touched or phase in _TOUCHLESS):
            return 0.0
        if phase in _AFTER_HOLDING and self._max_progress < PROGRESS["lower"][0]:
            return 0.0  # an empty gripper that was raised also goes through lowering and release
        start, increase = PROGRESS[phase]
        progress = start + increase * min(max(self._fraction_of(phase), 0.0), 1.0)
        gain = max(progress - self._max_progress, 0.0)
        self._max_progress += gain
        return gain

    def _fraction_of(self, phase: str) -> float:
        """Return the completed fraction of the phase."""
        goal = self._seen.goal
        gripper = self._seen.gripper
        if phase == "approach":
            return 1 - gripper.opening / self._opening
        if phase in ("lift", "lower"):
            raised = gripper.lift_height / goal.lift_height
            return raised if phase == "lift" else 1 - raised
        last = self._cycle.last
        if phase == "hold":
            return last.memory.get("phase_time", 0.0) / max(goal.hold_time, 1e-9)
        if phase == "release":
            return fraction_released(last)
        return 0.0

    def _outcome(self) -> str:
        """Return the outcome of the episode; "" while it continues."""
        if self._score.crushed_at is not None:
            return "crushed"
        if self._score.lost or self._cycle.last.memory.get("gone"):
            return "dropped"
        if self._cycle.last.phase in ENDS or self._cycle.supervisor.is_over:
            return self._score.outcome()
        return ""

    def _info(self) -> dict[str, Any]:
        """Return ground truth and seed, which no observation may contain."""
        score = self._score
        rig = self._rig
        found = {
            "peak_force_true_N": score.peak_force,
            "hold_force_true_N": score.hold_force,
            "slip_mm_true": 1e3 * score.slip,
            "break_force_N": rig.scene.object.break_force,
        }
        randomized: Mapping[str, Any] = rig.randomized
        return {
            "seed": self._seed,
            "time_s": self._seen.time - self._start,
            "phase": self._cycle.last.phase,
            "force_normal_true_N": np.array(score.forces()),
            **{k: v for k, v in found.items() if math.isfinite(v)},
            **self._left_out,
            **({"randomized": dict(randomized)} if randomized else {}),
            "flags": merge_flags((rig.flags(), self._uncertain.flags)),
            **({"problem": self._problem} if self._problem else {}),
        }


class _CycleObserver(Observer):
    """Observer that reports the image times to the score."""

    def __init__(self, score: GraspScore):
        self._score = score

    def on_images(self) -> None:
        self._score.start_cycle()


def _refusal(text: str, field: str, choices: Collection[str]) -> InputError:
    return InputError(text, source="Grasp-v0", field=field, choices=choices)
