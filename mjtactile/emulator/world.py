"""Process behind the emulated hardware: one simulated grasp in real time, and its cameras.

`mjtactile.emulator.app` starts `python -m mjtactile.emulator.world DESCRIPTOR`. It reads options
from the first line of stdin. It writes one JSON line to stdout when it is ready. It ends when its
stdin closes. All other data pass through `SharedState`.
"""

from __future__ import annotations

import json
import math
import queue
import random
import sys
import threading
from dataclasses import replace
from typing import Any

import cv2
import numpy as np

from mjtactile.core import process, scaled_clock
from mjtactile.core.errors import MjtactileError
from mjtactile.core.scenario import Scenario
from mjtactile.core.types import FINGERS
from mjtactile.emulator.mjpeg_server import StreamServer
from mjtactile.emulator.options import EmulatorOptions
from mjtactile.emulator.shared_memory import SharedState
from mjtactile.rig.as_built_sensor import camera_pose, marker_radii, true_design
from mjtactile.rig.domain_randomization import SampledWorld
from mjtactile.rig.file import EmulatorConfig, load_sim_rig
from mjtactile.sim import ground_truth
from mjtactile.sim.mujoco_log import route_warnings
from mjtactile.sim.rendering.image_faults import FaultyImage
from mjtactile.sim.rendering.renderer import Effects, Renderer
from mjtactile.sim.rig import build_sim_rig

# maximum lag behind the clock, s; a larger lag is skipped instead of recovered
_BEHIND_MAX = 0.02
_RENDER_PAUSE = 3e-4  # pause after each step for the rendering thread, s
_BACKDRIVE_FORCE = 0.05  # gear friction of servos without torque, N
_GEAR_SLACK = 1e-4  # change of opening over which that friction builds up, m
_TOUCH_FORCE = 1e-3  # contact threshold, N
_STILL_SPEED = 0.01  # speed limit of an object at rest, m/s and rad/s
_FALL_SPEED_MAX = 0.5  # speed limit of a lift without torque, which turns its gears, m/s
_LEAK_TIME = 0.15  # time constant of a puncture, s
# gain of the camera image; at 13 times white, black markers are also white
_DARK = 0.03
_GLARE = 20.0


class EmulatedWorld:
    """Simulated grasp of `options`, driven by the commands in `shared`."""

    def __init__(self, options: EmulatorOptions, shared: SharedState):
        emulator = options.rig_file.emulator or EmulatorConfig()
        file = load_sim_rig("sim")
        file = replace(
            file,
            fingers=tuple(
                replace(finger, sensor=options.finger_design(finger.name))
                for finger in file.fingers
            ),
        )
        rig = build_sim_rig(
            Scenario(object=options.object_name, sensor=options.design, seed=options.seed),
            file=file,
            sampled=SampledWorld(as_built=emulator.as_built),
        )
        self.scene = rig.scene
        self.simulated = rig.simulated
        self._shared = shared
        self._travel = options.rig_file.lift.travel
        self._cameras = Cameras(options, shared)
        self.streams = self._cameras.streams
        self._fall_speed = 0.0
        self._rest_opening: float | None = None
        # -1 for a soft object, which has no joint
        joint = int(self.scene.model.body("object/object").jntadr[0])
        self._object_joint = None if joint < 0 else self.scene.data.joint(joint)
        self._cached_pose: Any = None
        self._image_period = 1 / options.rig_file.cameras[0].rate
        self._next_frame = 0.0
        self._flagged: set[str] = set()
        self._stop = scaled_clock.Event()
        self._thread = threading.Thread(target=self._run, name="world", daemon=True)
        self._publish()

    def start(self) -> None:
        self._thread.start()

    def close(self) -> None:
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join()
        self._cameras.close()

    def _run(self) -> None:
        """Step the simulation in real time."""
        start = scaled_clock.monotonic()
        try:
            while not self._stop.is_set():
                behind = scaled_clock.monotonic() - start - self.scene.time
                if behind < self.scene.timestep:
                    self._stop.wait(self.scene.timestep - behind)
                    continue
                if behind > _BEHIND_MAX:
                    start += behind
                    self._shared["lost"] += behind
                self._step()
                self._stop.wait(_RENDER_PAUSE)
        except MjtactileError as error:
            print(f"emulator: {error}", file=sys.stderr, flush=True)
            self._shared["failed"] = 1

    def _step(self) -> None:
        scene = self.scene
        shared = self._shared
        self._drive_jaws(shared["goal"], shared["force"])
        self._lift(shared["lift_goal"])
        for number, sensor in enumerate(scene.sensors, 1):
            if shared[f"open_{number}"]:
                scene.sensors[number - 1].open_valve(shared[f"supply_{number}"])
            elif sensor.valve_is_open:
                scene.sensors[number - 1].close_valve()
        leaking = scene.sensors[0]
        if shared["puncture"] and not leaking.valve_is_open:
            leaking.open_valve(leaking.gauge_pressure * (1 - scene.timestep / _LEAK_TIME))
            leaking.close_valve()
        scene.step()
        self._hold_resting_object()
        self._publish()
        if scene.time >= self._next_frame:
            self._next_frame += self._image_period
            self._report_flags()
            self._publish_forces()
            self._cameras.expose([scene.marker_poses(i) for i in range(len(scene.sensors))])

    def _report_flags(self) -> None:
        """Print each new flag of reduced simulation accuracy once; no device can report it."""
        for kind in self.scene.flags.keys() - self._flagged:
            print(
                f"emulator: warning ({kind}): {self.scene.flags[kind]}", file=sys.stderr, flush=True
            )
        self._flagged |= self.scene.flags.keys()

    def _drive_jaws(self, goal: float, force: float) -> None:
        """Drive the jaws to the opening; without torque, gear friction holds them."""
        opening = self.scene.opening
        if not math.isnan(goal) and force > 0:
            self._rest_opening = None
            self.scene.set_finger_target(max(goal, 0.0), max(force, _BACKDRIVE_FORCE))
            return
        rest = opening if self._rest_opening is None else self._rest_opening
        rest = min(max(rest, opening - _GEAR_SLACK), opening + _GEAR_SLACK)
        self._rest_opening = rest
        self.scene.set_finger_target(max(rest, 0.0), _BACKDRIVE_FORCE)

    def _hold_resting_object(self) -> None:
        """Fix an object at rest while the jaws are not driven and no membrane is in contact.

        Friction of simulated contacts creeps: an egg on its end would fall over within minutes.
        """
        fingers = range(1, len(self.scene.sensors) + 1)
        is_undisturbed = self._rest_opening is not None and all(
            abs(self._shared[f"contact_{finger}"]) < _TOUCH_FORCE for finger in fingers
        )
        joint = self._object_joint
        if joint is None or not is_undisturbed or np.abs(joint.qvel).max() > _STILL_SPEED:
            self._cached_pose = None
            return
        if self._cached_pose is None:
            self._cached_pose = joint.qpos.copy()
        joint.qpos[:] = self._cached_pose
        joint.qvel[:] = 0.0

    def _lift(self, goal: float) -> None:
        """Move the lift to the requested height, m; without torque (NaN) it falls."""
        if not math.isnan(goal):
            self._fall_speed = 0.0
            self.scene.set_lift_target(min(max(goal, 0.0), self._travel))
            return
        self._fall_speed = min(self._fall_speed + 9.81 * self.scene.timestep, _FALL_SPEED_MAX)
        self.scene.set_lift_target(0.0, max(self._fall_speed, 1e-3))

    def _publish(self) -> None:
        scene = self.scene
        shared = self._shared
        shared["time"] = scene.time
        shared["opening"] = scene.opening
        shared["speed"] = scene.opening_speed
        shared["grip_force"] = scene.grip_force
        shared["lift_height"] = scene.lift_height
        shared["object_height"] = scene.data.body("object/object").xpos[2]
        for number, sensor in enumerate(scene.sensors, 1):
            shared[f"pressure_{number}"] = sensor.gauge_pressure

    def _publish_forces(self) -> None:
        """Publish the true normal force on each membrane, once per image."""
        for finger in range(len(self.scene.sensors)):
            self._shared[f"contact_{finger + 1}"] = -ground_truth.contact_force(self.scene, finger)[
                2
            ]


class Cameras:
    """Thread that renders and streams the images; it drops one if rendering is late."""

    def __init__(self, options: EmulatorOptions, shared: SharedState):
        emulator = options.rig_file.emulator or EmulatorConfig()
        count = len(options.rig_file.cameras)
        self.streams = StreamServer(FINGERS[:count])
        seeds = np.random.default_rng(options.seed).integers(2**31, size=count)
        fingers = [
            (options.finger_design(finger), emulator.as_built_sensor(finger))
            for finger in FINGERS[:count]
        ]
        self._renderers = [
            Renderer(
                true_design(design, as_built),
                seed=int(s),
                pose=camera_pose(design, as_built),
                radius=marker_radii(true_design(design, as_built), as_built),
            )
            for s, (design, as_built) in zip(seeds, fingers, strict=True)
        ]
        self._suffered = {
            as_built.finger: FaultyImage(as_built.camera, int(s))
            for s, (_, as_built) in zip(seeds, fingers, strict=True)
        }
        self._period = 1 / options.rig_file.cameras[0].rate
        self._shared = shared
        self._rng = random.Random(options.seed)
        self._queue: queue.Queue[Any] = queue.Queue(2)
        self._last: dict[str, Any] = {}
        self._stop = scaled_clock.Event()
        self._thread = threading.Thread(target=self._run, name="images", daemon=True)
        self._thread.start()

    def expose(self, poses: list[Any]) -> None:
        """Queue the current poses for rendering."""
        try:
            self._queue.put_nowait((scaled_clock.monotonic(), poses))
        except queue.Full:
            return

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self.streams.close()

    def _run(self) -> None:
        while not self._stop.is_set():
            try:
                exposed, poses = self._queue.get(timeout=0.1)
            except queue.Empty:
                continue
            for name, renderer, (p_SM, n_S) in zip(
                self.streams.names, self._renderers, poses, strict=False
            ):
                self._send(name, renderer, p_SM, n_S)
            self._shared["image_delay"] += 0.1 * (
                scaled_clock.monotonic() - exposed - self._shared["image_delay"]
            )
            self._shared["images"] += 1

    def _send(self, name: str, renderer: Renderer, p_SM: Any, n_S: Any) -> None:
        shared = self._shared
        if shared["frames_stopped"]:
            return
        if not (shared["frames_frozen"] and name in self._last):
            gain = 1.0
            if shared["frames_dark"]:
                gain = _DARK
            elif shared["frames_saturated"]:
                gain = _GLARE
            image = renderer.render(p_SM, n_S, shared["time"], effects=Effects(gain=gain))
            self._last[name] = self._suffered[name](image).pixels
        if shared["frames_late"]:
            self._stop.wait(shared["frames_late"] / len(self._renderers))
        self.streams.publish(name, self._last[name])
        if self._rng.random() < shared["frames_duplicated"]:
            self._stop.wait(0.2 * self._period)
            self.streams.publish(name, self._last[name])


def main(descriptor: int) -> int:
    sys.setswitchinterval(1e-3)
    cv2.setNumThreads(1)  # the other core is the host's
    route_warnings()
    shared = SharedState(descriptor)
    try:
        world = EmulatedWorld(EmulatorOptions.decode(sys.stdin.readline()), shared)
    except MjtactileError as error:
        print(process.failure(error), flush=True)
        return error.exit_code
    world.start()
    cameras = {name: world.streams.url(name) for name in world.streams.names}
    print(json.dumps({"cameras": cameras, "simulated": world.simulated}), flush=True)
    sys.stdin.read()
    world.close()
    shared.close()
    return 0


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1])))
