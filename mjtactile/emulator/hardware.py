"""Emulated devices and their connection to the world: jaws, lift and chambers."""

from __future__ import annotations

import math
import threading

from mjtactile.core import scaled_clock
from mjtactile.emulator.faults import Faults
from mjtactile.emulator.mechanism import GearedJaws, Jaw
from mjtactile.emulator.servo import EmulatedServo
from mjtactile.emulator.servo_bus import ServoBus
from mjtactile.emulator.shared_memory import FAULTS_TO_WORLD, SharedState
from mjtactile.emulator.valve import ValveFirmware, ValvePort
from mjtactile.rig.file import EmulatorConfig, RigFile

_TICK = 0.003  # update interval of the world's state, s


class EmulatedHardware:
    """Servo bus and valve board of `rig_file` until `close`, with or without a world."""

    def __init__(self, rig_file: RigFile, shared: SharedState, faults: Faults):
        emulator = rig_file.emulator or EmulatorConfig()
        self._rig_file = rig_file
        self._shared = shared
        self.faults = faults
        self.servos: dict[int, EmulatedServo] = {}
        self._jaws = self._build_jaws()
        self._lift = self._build_lift()
        shared["goal"] = math.nan
        zeros = {
            valve.channel: emulator.as_built_sensor(valve.finger).valve_zero
            for valve in rig_file.valves
        }
        self.bus = ServoBus(self.servos, faults, usb_latency=emulator.usb_latency)
        self.firmware = ValveFirmware(self, faults, zeros=zeros, sensors=emulator.valve_sensors)
        self.valve = ValvePort(self.firmware) if rig_file.valves else None
        self._stop = scaled_clock.Event()
        self._thread = threading.Thread(target=self._run, name="hardware", daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self.unplug()

    def unplug(self) -> None:
        """Disconnect both USB ports."""
        self.bus.close()
        if self.valve is not None:
            self.valve.close()

    # -- chambers, as the valve board moves them

    def connect(self, channel: int, supply_gauge: float) -> None:
        self._shared[f"supply_{channel}"] = supply_gauge
        self._shared[f"open_{channel}"] = 1.0

    def seal(self, channel: int) -> None:
        self._shared[f"open_{channel}"] = 0.0

    def pressure(self, channel: int) -> float:
        return self._shared[f"pressure_{channel}"]

    # -- inside

    def _build_servo(self, servo_id: int, model: str, angle: float) -> EmulatedServo:
        emulator = self._rig_file.emulator or EmulatorConfig()
        self.servos[servo_id] = EmulatedServo(
            servo_id,
            model,
            angle=angle,
            baud=self._rig_file.bus.baud,
            torque_fraction=emulator.torque_fraction,
            firmware=emulator.servo_firmware,
            trip=emulator.watchdog,
        )
        return self.servos[servo_id]

    def _build_jaws(self) -> GearedJaws:
        jaws = []
        configs = self._rig_file.gripper.servos
        for config in configs:
            jaw = Jaw(EmulatedServo(config.id, config.model), config, str(self._rig_file.path))
            angle = jaw.angle(self._shared["opening"] / len(configs))
            jaw.servo = self._build_servo(config.id, config.model, angle)
            jaws.append(jaw)
        emulator = self._rig_file.emulator or EmulatorConfig()
        return GearedJaws(jaws, emulator.backlash)

    def _build_lift(self) -> EmulatedServo | None:
        lift = self._rig_file.lift
        return None if lift.kind != "servo" else self._build_servo(lift.id, lift.model, 0.0)

    def _run(self) -> None:
        last = scaled_clock.monotonic()
        while not self._stop.wait(_TICK):
            now = scaled_clock.monotonic()
            self._tick(now, now - last)
            last = now

    def _tick(self, now: float, period: float) -> None:
        shared = self._shared
        self._inject_faults()
        if not self.bus.is_busy():
            for servo in self.servos.values():
                servo.check_watchdog(now)
        goal, force = self._jaws.drive(shared["opening"])
        shared["force"] = force
        shared["goal"] = math.nan if goal is None else goal
        if self._lift is not None:
            drive = self._lift.drive()
            per_rad = self._rig_file.lift.per_rad
            shared["lift_goal"] = drive.goal * per_rad if drive.torque_max > 0 else math.nan
            self._lift.follow_load(shared["lift_height"] / per_rad, 0.0, 0.0, period)
        self._jaws.follow_load(shared["opening"], shared["speed"], shared["grip_force"], period)
        self.firmware.tick(now, period)

    def _inject_faults(self) -> None:
        """Apply the faults that occur in a servo or in the world, not in a reply."""
        for kind, act in (
            ("servo_overload", lambda s: s.raise_error(0x20)),
            ("servo_overheat", lambda s: s.heat(95.0)),
            ("servo_brown_out", lambda s: s.brown_out()),
        ):
            servo = self.servos.get(int(self.faults.get(kind)))
            if servo is not None:
                self.faults.set(kind, 0)
                act(servo)
        for kind in FAULTS_TO_WORLD:
            self._shared[kind] = self.faults.get(kind)
