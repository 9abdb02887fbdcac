"""What the supported valve boards understand: newline-terminated ASCII, one reply for each command.

- `ctrlp`: in the style of Ctrl-P, the open pressure controller (https://ctrl-p.cbteeple.com): `command;argument;…`, a
  command without its last argument asks; kPa. Its public firmware lacks heartbeat, seal and vent: see docs/hardware.md.
- `relay`: a minimal board with two relays a channel (supply, vent), no pressure sensor.
- `regulator`: a proportional pressure regulator with a sensor; mbar.

A new board is a new row here. In the templates: `{channel}`, `{pressure}` in the board's unit, `{ms}`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Dialect:
    """Each command is a template; its reply must repeat the command's first word(s) and match the expected value.

    `identify` is asked until a reply matches `identity` (a regular expression with groups `name`, `version`);
    `version_min` is the oldest firmware that is known to work. `read` replies match `reading` with groups `state`
    (one of `states`) and `pressure` (none: no sensor). `unit` Pa of one pressure unit; `open` and `limit` None: the
    board cannot regulate, `connect` joins the chamber to its fixed supply.
    """

    name: str
    identify: str
    identity: str
    version_min: tuple[int, int]
    unit: float
    units: str | None
    limit: str | None
    heartbeat: str
    open: str | None
    connect: str | None
    close: str
    vent: str
    read: str
    reading: str
    states: Mapping[str, bool]
    error: str
    decimals: int = 3


_CTRLP = Dialect(
    name="ctrlp", identify="version", identity=r"version;(?P<name>ctrl-p);(?P<version>\d+\.\d+)", version_min=(2, 0),
    unit=1000.0, units="units;kPa", limit="maxp;{channel};{pressure}", heartbeat="heartbeat;{ms}",
    open="set;{channel};{pressure}", connect=None, close="close;{channel}", vent="vent;{channel}", read="read;{channel}",
    reading=r"read;{channel};(?P<pressure>-?\d+\.\d+);(?P<state>open|closed|vent)",
    states={"open": True, "closed": False, "vent": True}, error=r"error;(?P<reason>.*)")

_RELAY = Dialect(
    name="relay", identify="V", identity=r"V (?P<name>relay) (?P<version>\d+\.\d+)", version_min=(1, 0), unit=1.0, units=None,
    limit=None, heartbeat="H {ms}", open=None, connect="R{channel} S", close="R{channel} C", vent="R{channel} V",
    read="R{channel}", reading=r"R{channel} (?P<state>[SCV])", states={"S": True, "C": False, "V": True},
    error=r"\?(?P<reason>.*)")

_REGULATOR = Dialect(
    name="regulator", identify="ID?", identity=r"ID (?P<name>regulator) (?P<version>\d+\.\d+)", version_min=(1, 0), unit=100.0,
    units="UNIT mbar", limit="MAX {channel} {pressure}", heartbeat="WD {ms}", open="SP {channel} {pressure}", connect=None,
    close="CL {channel}", vent="VT {channel}", read="PV {channel}",
    reading=r"PV {channel} (?P<pressure>-?\d+\.\d+) (?P<state>[OCV])", states={"O": True, "C": False, "V": True},
    error=r"ERR (?P<reason>.*)", decimals=2)

DIALECTS: Mapping[str, Dialect] = {dialect.name: dialect for dialect in (_CTRLP, _RELAY, _REGULATOR)}
