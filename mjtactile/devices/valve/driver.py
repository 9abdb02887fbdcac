"""`BoardValve`: one channel of a valve board as the rig's valve; `connect_valves` connects all
boards of a rig."""

from __future__ import annotations

from collections.abc import Sequence

from mjtactile.core import scaled_clock
from mjtactile.core.errors import DeviceError
from mjtactile.core.types import ValveState
from mjtactile.devices.valve.board import ValveBoard, ValveReading
from mjtactile.rig.file import ValveConfig

__all__ = ["BoardValve", "ValveBoard", "connect_valves"]
_SETTLE_TIME = 1.5  # time for the chamber to reach the setpoint, s
_SETTLE_POLL = 0.02  # polling interval of the pressure, s
# pressure deviation of a stuck valve: as a fraction of the setpoint, and minimum, Pa
_SETTLE_FRACTION = 0.25
_SETTLE_FLOOR = 120.0


class BoardValve:
    """One channel of a board as the rig's valve."""

    def __init__(self, board: ValveBoard, config: ValveConfig):
        self.board = board
        self.config = config
        self._goal: float | None = None
        self._goal_time = 0.0

    def state(self) -> ValveState:
        """Return the valve's state and pressure. Raises DeviceError for a silent board, or a
        pressure that does not follow."""
        reading = self.board.reading(self.config.channel)
        if reading.fault:
            raise DeviceError(f"valve {self.config.finger} vented by itself: {reading.fault}")
        self._check_moves(reading)
        return ValveState(
            reading.is_open,
            reading.gauge_pressure,
            reading.time,
            scaled_clock.monotonic() - reading.time,
        )

    def open(self, supply_gauge: float) -> None:
        """Connect to a supply of `supply_gauge` Pa; 0 vents. Raises DeviceError beyond the rig
        file's limits."""
        config = self.config
        if not 0 <= supply_gauge <= config.pressure_max:
            raise DeviceError(
                f"valve {config.finger}: {supply_gauge:g} Pa is outside 0 to "
                f"{config.pressure_max:g} Pa, the maximum of the rig file"
            )
        if supply_gauge == 0:
            self.board.vent(config.channel)
        else:
            if not self.board.has_sensors:
                self._check_supply(supply_gauge)
            self.board.set(config.channel, supply_gauge)
        self._goal = supply_gauge
        self._goal_time = scaled_clock.monotonic()

    def close(self) -> None:
        """Seal the chamber after its pressure has reached the setpoint. Raises DeviceError for a
        valve that does not move."""
        while self._goal is not None and not self._has_moved(
            self.board.measure(self.config.channel)
        ):
            self._check_moves(self.board.measure(self.config.channel))
            scaled_clock.sleep(_SETTLE_POLL)
        self.board.seal(self.config.channel)
        self._goal = None

    def regulate_pressure(self, gauge_pressure: float | None) -> None:
        """Set the sensor reading `gauge_pressure`, Pa, that the board shall maintain.

        None: seal the chamber, if it was maintained. The heartbeat's thread sends it to the
        board.
        """
        if gauge_pressure is None:
            self.board.aim(self.config.channel, None)
            self._goal = None
            return
        if self._goal is None:
            self._goal_time = scaled_clock.monotonic()
        self._goal = min(max(gauge_pressure, 0.0), self.config.pressure_max)
        self.board.aim(self.config.channel, self._goal)

    def _check_supply(self, supply_gauge: float) -> None:
        fixed = self.config.supply_gauge or 0.0
        if abs(fixed - supply_gauge) > 0.05 * fixed:
            raise DeviceError(
                f"valve {self.config.finger}: {supply_gauge:g} Pa was requested, but its "
                f"supply has {fixed:g} Pa and a board without a sensor cannot change that"
            )

    def _has_moved(self, reading: ValveReading) -> bool:
        """Return True if the chamber has reached the setpoint, or if its pressure is unknown."""
        if self._goal is None or reading.gauge_pressure is None:
            return True
        return abs(reading.gauge_pressure - self._goal) <= max(
            _SETTLE_FRACTION * abs(self._goal), _SETTLE_FLOOR
        )

    def _check_moves(self, reading: ValveReading) -> None:
        if self._has_moved(reading):
            self._goal_time = scaled_clock.monotonic()  # the settling time starts again
        elif scaled_clock.monotonic() - self._goal_time >= _SETTLE_TIME:
            raise DeviceError(
                f"valve {self.config.finger} is stuck: {self._goal:g} Pa was set {_SETTLE_TIME:g} "
                f"s ago, the chamber has {reading.gauge_pressure:.0f} Pa"
            )


def connect_valves(
    configs: Sequence[ValveConfig], hold: float = 0.0
) -> tuple[list[ValveBoard], list[BoardValve]]:
    """Connect every board once and return the valves in the order of `configs`.

    Chambers stay sealed for `hold` s when the host is lost. Raises DeviceError.
    """
    boards: dict[str, ValveBoard] = {}
    try:
        for config in configs:
            if config.port not in boards:
                boards[config.port] = ValveBoard(
                    [c for c in configs if c.port == config.port], hold
                )
    except BaseException:
        for board in boards.values():
            board.close(quiet=True)
        raise
    return list(boards.values()), [BoardValve(boards[config.port], config) for config in configs]
