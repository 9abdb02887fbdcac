"""Registers of an emulated servo: memory laid out by a control table, and its access rules.

Each rule names its heading in the e-manual, as in `mjtactile.emulator.servo`.
"""

from __future__ import annotations

from mjtactile.emulator import control_table as ct

RESULT_FAIL, INSTRUCTION_ERROR, CRC_ERROR, RANGE_ERROR, LENGTH_ERROR, LIMIT_ERROR, ACCESS_ERROR = (
    range(1, 8)
)
"""Errors of a status packet (Protocol 2.0, "Error")."""
TRIPPED = 0xFF  # "Bus Watchdog"


class Registers:
    """All registers of one model; the subclass implements effects and measurements."""

    def __init__(self, model: str):
        self._table = ct.control_table(model)
        self._memory = bytearray(1024)

    def get(self, name: str) -> int:
        """Return a register as an unsigned number."""
        field = self._table.fields[name]
        return int.from_bytes(self._memory[field.address : field.address + field.size], "little")

    def get_signed(self, name: str) -> int:
        """Return a register as two's complement."""
        value = self.get(name)
        bits = 8 * self._table.fields[name].size
        return value - (1 << bits) if value >> (bits - 1) else value

    def set(self, name: str, value: int) -> None:
        """Set a register from inside, without any rule."""
        field = self._table.fields[name]
        data = (int(value) & ((1 << 8 * field.size) - 1)).to_bytes(field.size, "little")
        self._memory[field.address : field.address + field.size] = data

    @property
    def id(self) -> int:
        return self.get("ID")

    @property
    def secondary_id(self) -> int:
        return self.get("Secondary(Shadow) ID")

    @property
    def baud(self) -> int:
        return ct.BAUDS[self.get("Baud Rate")]

    @property
    def alert(self) -> int:
        return 0x80 if self.get("Hardware Error Status") else 0

    @property
    def tripped(self) -> bool:
        return self.get("Bus Watchdog") == TRIPPED

    def read(self, address: int, size: int) -> tuple[int, bytes]:
        """Return error number and data in the form of a status packet.

        "Attempt to read a value in an Address that … has not been defined" is an access error
        (Protocol 2.0, "Error").
        """
        if size == 0:
            return LENGTH_ERROR, b""
        if not self._table.defined.issuperset(range(address, address + size)):
            return ACCESS_ERROR, b""
        return 0, bytes(self._memory[self._where(a)] for a in range(address, address + size))

    def write(self, address: int, data: bytes, *, ram_only: bool = False) -> int:
        """Write consecutive registers, all or none; return the status packet's error number."""
        fields, error = self._checked(address, data)
        if ram_only and any(field.address < ct.EEPROM_END for field, _ in fields):
            error = ACCESS_ERROR  # "Only the RAM area can be modified", Secondary(Shadow) ID(12)
        if not error:
            for field, value in fields:
                self._apply(field.name, value)
        return error

    def _apply(self, name: str, value: int) -> None:
        self.set(name, value)

    def _checked(self, address: int, data: bytes) -> tuple[list[tuple[ct.TableEntry, int]], int]:
        """Return the registers that a write would change, their values, and its error."""
        fields, error = self._parse(address, data)
        for field, value in fields:
            error = error or self._check(field, value)
        return fields, error

    def _where(self, address: int) -> int:
        """Return the target address of an indirect entry ("Indirect Address", "Indirect Data").

        Any other address is returned unchanged.
        """
        target = self._table.indirect.get(address)
        if target is None:
            return address
        return int.from_bytes(self._memory[target : target + 2], "little")

    def _parse(self, address: int, data: bytes) -> tuple[list[tuple[ct.TableEntry, int]], int]:
        """Return the registers that `data` covers with their new values, and the error number."""
        addresses = [self._where(a) for a in range(address, address + len(data))]
        fields = []
        start = 0
        while start < len(data):
            field = self._table.at.get(addresses[start])
            if field is None:
                return [], ACCESS_ERROR
            end = start + field.size
            if addresses[start:end] != list(range(field.address, field.address + field.size)):
                return [], LENGTH_ERROR
            fields.append((field, int.from_bytes(data[start:end], "little")))
            start = end
        return fields, 0 if fields else LENGTH_ERROR

    def _check(self, field: ct.TableEntry, value: int) -> int:
        if not field.writable:
            return ACCESS_ERROR
        if field.address < ct.EEPROM_END and self.get("Torque Enable"):
            return ACCESS_ERROR  # "ROM Lock"
        if field.name in ct.GOALS and self.tripped:
            # "Goal Value … will be changed to read-only-access … Data Range Error", Bus
            # Watchdog(98)
            return RANGE_ERROR
        if (
            field.name == "Torque Enable"
            and value
            and self.get("Hardware Error Status") & self.get("Shutdown")
        ):
            return RESULT_FAIL  # "REBOOT is the only method to reset", Shutdown(63)
        if field.choices:
            return 0 if value in field.choices else RANGE_ERROR
        low, high = self._range(field)
        bits = 8 * field.size
        signed = value - (1 << bits) if field.signed and value >> (bits - 1) else value
        return 0 if low <= signed <= high else RANGE_ERROR

    def _range(self, field: ct.TableEntry) -> tuple[int, int]:
        if field.name == "Goal Position" and self.get("Operating Mode") != 3:
            return -ct.TURNS_MAX, ct.TURNS_MAX
        return self._bound(field.low), self._bound(field.high)

    def _bound(self, bound: ct.Bound | None) -> int:
        if isinstance(bound, str):
            return -self.get(bound[1:]) if bound.startswith("-") else self.get(bound)
        assert bound is not None
        return bound
