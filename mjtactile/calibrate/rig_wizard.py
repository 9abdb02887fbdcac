"""Interactive setup of a rig file for connected devices: ports, cameras of the fingers, opening
range and force limits. Values in the file that still work are kept, so an aborted setup can be
resumed or repeated."""

from __future__ import annotations

import contextlib
import re
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from mjtactile.core import foreign_file
from mjtactile.core.errors import DeviceError, InputError
from mjtactile.core.types import Array
from mjtactile.devices.camera.opencv import OpenCvCamera
from mjtactile.devices.camera.v4l2 import video_devices
from mjtactile.devices.discovery import SerialPort, serial_ports, servos_at, valve_board_at
from mjtactile.recording.files import write_text
from mjtactile.rig.file import UNFLIPPED, CameraConfig, RigFile, load_rig_file, rig_from_table

Ask = Callable[[str], str]
Notify = Callable[[str], None]
Place = tuple[str, int, str]
"""Section, which of the sections of that name, and field."""
_LIMITS = (
    ("gripper", "opening_min_mm", "minimum opening between the two sensors' frames, mm"),
    ("gripper", "opening_max_mm", "maximum opening, mm"),
    ("gripper", "speed_max_mm_s", "maximum speed of the opening, mm/s"),
    ("gripper", "force_max_N", "maximum force on each finger, N; no controller can exceed it"),
)
# model-specific servo keys: without them, the model's own values apply
_OF_THE_MODEL = ("torque_Nm_per_A", "position_p_gain")
_IMAGES = 5
_ATTEMPTS = 3
_ASIDE = 0.1  # fraction of the image sides: contacts closer to the center count as no corner
_CORNER = "upper right corner (seen from outside, air inlet on the right)"
_CLEARER = 2.0  # minimum ratio of the change in the finger's own image to that in any other
_T = TypeVar("_T")


def setup(
    path: Path,
    *,
    like: Path,
    ports: Sequence[str] = (),
    cameras: Sequence[str] = (),
    ask: Ask,
    notify: Notify,
) -> RigFile:
    """Create or complete the rig file `path`, starting from a copy of `like`.

    `ports` and `cameras` (streams) are additional candidates. `ask` puts a question to the user and
    returns the typed answer; "" accepts the proposed value.

    Raises InputError where something is missing or the answers end. The results up to then are in
    the file.
    """
    if not foreign_file.exists(path):
        path.write_text(like.read_text(encoding="utf-8"), encoding="utf-8")
        notify(f"{path}: created as a copy of {like.stem}")
    ports_found = _PortScan(ports, notify)
    for step in (_bus, _valves):
        _write(path, step(load_rig_file(path), ports_found, ask, notify))
    _write(path, _cameras(load_rig_file(path), cameras, ask, notify))
    _limits(path, ask, notify)
    return load_rig_file(path)


class _PortScan:
    """Serial ports of the computer, scanned once on first use."""

    def __init__(self, more: Sequence[str], notify: Notify):
        self._more = more
        self._notify = notify
        self._ports = None

    def with_(self, description: str, has: Callable[[SerialPort], bool]) -> list[SerialPort]:
        if self._ports is None:
            self._ports = serial_ports(self._more, notify=self._notify)
        if found := [port for port in self._ports if has(port)]:
            return found
        seen = [
            f"{port.path} ({port.problem or '; '.join(port.answers) or 'nobody answers'})"
            for port in self._ports
        ]
        raise InputError(
            f"no serial port with {description} was found: check power and cable; ports found: "
            f"{', '.join(seen) or 'no port at all'}",
            field="setup",
            choices=["connect it and run again", "--port PATH"],
        )


def _bus(rig: RigFile, ports_found: _PortScan, ask: Ask, notify: Notify) -> Mapping[Place, object]:
    lift = [rig.lift.id] if rig.lift.kind == "servo" else []
    requested = [servo.id for servo in rig.gripper.servos] + lift
    with contextlib.suppress(DeviceError):
        if (
            rig.bus.port.startswith("/")
            and {*requested} <= servos_at(rig.bus.port, (rig.bus.baud,))[1].keys()
        ):
            notify(f"servos {requested} answer at {rig.bus.port}: setting kept")
            return {}
    ports = ports_found.with_("Dynamixel servos", lambda port: bool(port.servos))
    port = _choose("servo bus", ports, lambda port: port.path, ask, notify)
    if len(port.servos) < len(requested):
        raise InputError(
            f"servos {list(port.servos)} answer at {port.path}; this gripper has {len(requested)}",
            source=rig.path,
            field="gripper.servo",
            choices=["connect the missing servos", "start from another --template"],
        )
    changes: dict[Place, object] = {("bus", 0, "port"): port.path, ("bus", 0, "baud"): port.baud}
    free = sorted(port.servos)
    for number in range(len(requested)):
        is_lift = number >= len(rig.gripper.servos)
        name, section, index = "the lift", "lift", 0
        if not is_lift:
            per_rad_mm = 1e3 * rig.gripper.servos[number].per_rad
            name = f"jaw {number + 1} ({per_rad_mm:+g} mm/rad)"
            section, index = "gripper.servo", number
        chosen = _choose(
            f"servo of {name}", free, lambda servo: f"{servo}, {port.servos[servo]}", ask, notify
        )
        free.remove(chosen)
        model = port.servos[chosen]
        changes |= {(section, index, "id"): chosen, (section, index, "model"): model}
        if not is_lift and model != rig.gripper.servos[number].model:
            notify(
                f"{name} is a {model}: using the torque per ampere of its data sheet and the "
                "factory gain"
            )
            changes |= {(section, index, key): None for key in _OF_THE_MODEL}
    return changes


def _valves(
    rig: RigFile, ports_found: _PortScan, ask: Ask, notify: Notify
) -> Mapping[Place, object]:
    if not rig.valves:
        return {}
    present = rig.valves[0].port
    with contextlib.suppress(DeviceError):
        if present.startswith("/") and valve_board_at(present):
            notify(f"the valve board answers at {present}: setting kept")
            return {}
    ports = ports_found.with_("a valve board", lambda port: bool(port.board))
    port = _choose("valve board", ports, lambda port: port.path, ask, notify)
    return {("valve", index, "port"): port.path for index in range(len(rig.valves))}


def _cameras(rig: RigFile, more: Sequence[str], ask: Ask, notify: Notify) -> Mapping[Place, object]:
    with contextlib.suppress(DeviceError), contextlib.ExitStack() as stack:
        for config in rig.cameras:
            stack.enter_context(contextlib.closing(OpenCvCamera(config)))
        notify(f"cameras {', '.join(config.source for config in rig.cameras)} answer: setting kept")
        return {}
    sources = [*more, *(camera.path for camera in video_devices() if camera.formats)]
    if len(sources) < len(rig.cameras):
        raise InputError(
            f"{len(sources)} cameras were found, but the rig has {len(rig.cameras)} fingers",
            source=rig.path,
            field="camera",
            choices=["connect the missing cameras and run again", "--camera URL"],
        )
    candidates = [_with_source(rig.cameras[0], source) for source in sources]
    changes: dict[Place, object] = {}
    for index, (source, flip) in enumerate(_assigned(rig, candidates, ask, notify)):
        changes |= {("camera", index, "source"): source, ("camera", index, "flipped"): flip}
    return changes


def _with_source(config: CameraConfig, source: str) -> CameraConfig:
    """Return the camera configuration of the file with another source. A stream is not a V4L2
    device."""
    return replace(
        config,
        source=source,
        flipped=UNFLIPPED,
        **({"backend": "ffmpeg", "timestamps": "arrival"} if "://" in source else {}),
    )


def _assigned(
    rig: RigFile, cameras: Sequence[CameraConfig], ask: Ask, notify: Notify
) -> list[tuple[str, str | None]]:
    """Return each finger's camera source and the flip of its image (None: not flipped, or unknown).

    The camera is identified by the image change when the user presses the finger's membrane.
    """
    ask("Leave the membranes untouched and press Enter: ")
    flat = {camera.source: _mean_image(camera) for camera in cameras}
    found: dict[str, str | None] = {}
    while len(found) < len(rig.cameras):
        finger = rig.cameras[len(found)].finger
        ask(f"Press the membrane of the {finger} finger with a thumb, hold it and press Enter: ")
        changes = {
            camera.source: float(np.abs(_mean_image(camera) - flat[camera.source]).mean())
            for camera in cameras
            if camera.source not in found
        }
        first, *others = sorted(changes, key=lambda source: -changes[source])
        if all(changes[first] > _CLEARER * changes[other] for other in others):
            notify(f"{finger}: {first}")
            ask(f"Press the {_CORNER} of the {finger} finger, hold it and press Enter: ")
            camera = next(camera for camera in cameras if camera.source == first)
            flip = flip_of(_mean_image(camera) - flat[first])
            if flip is None:
                notify(
                    f"{finger}: the contact was not in a corner; the image is assumed to be upright"
                )
            elif flip != UNFLIPPED:
                notify(f"{finger}: the image is flipped: {flip}")
            found[first] = None if flip == UNFLIPPED else flip
        else:
            levels = ", ".join(f"{change:.1f}" for change in changes.values())
            notify(f"no image changed clearly more than the others ({levels} grey levels)")
    return list(found.items())


def flip_of(change: Array) -> str | None:
    """Return the flip of an image, one of `FLIPS`; None if the change is in no corner.

    `change` (H, W) are the changes of grey levels by a contact at maximum x and y of the sensor. In
    an upright image, this is at the lower right.
    """
    weight = np.square(change)
    height, width = weight.shape
    right = float(weight.sum(axis=0) @ np.arange(width) / weight.sum()) / width - 0.5
    down = float(weight.sum(axis=1) @ np.arange(height) / weight.sum()) / height - 0.5
    if not min(abs(right), abs(down)) > _ASIDE:
        return None
    if right > 0:
        return UNFLIPPED if down > 0 else "top-bottom"
    return "left-right" if down > 0 else "both"


def _mean_image(config: CameraConfig) -> Array:
    """Return the mean of several current images. Raises DeviceError after repeated failures."""
    for attempts_left in reversed(range(_ATTEMPTS)):
        try:
            with contextlib.closing(OpenCvCamera(config)) as camera:
                images = []
                for _ in range(_IMAGES):
                    camera.wait_newer(camera.newest_time, 1.0)
                    images.append(camera.read().pixels.astype(float))
                return np.mean(images, axis=0)
        except DeviceError:
            if not attempts_left:
                raise
    raise AssertionError


def _limits(path: Path, ask: Ask, notify: Notify) -> None:
    """Ask for each limit, and write it as soon as it is valid."""
    for section, key, text in _LIMITS:
        while True:
            now = tomllib.loads(path.read_text(encoding="utf-8"))[section][key]
            answer = ask(f"{text} [{now:g}]: ").strip()
            try:
                _write(path, {(section, 0, key): float(answer)} if answer else {})
                break
            except InputError as error:
                notify(f"{answer}: {error}")
            except ValueError:
                notify(f"{answer!r} is not a number")


def _choose(
    description: str, items: Sequence[_T], name: Callable[[_T], str], ask: Ask, notify: Notify
) -> _T:
    """Ask the user to choose one of `items`; without a question if there is only one."""
    if len(items) == 1:
        notify(f"{description}: {name(items[0])}")
        return items[0]
    for number, item in enumerate(items, 1):
        notify(f"  {number}  {name(item)}")
    while True:
        answer = ask(f"{description}, which one? [1]: ").strip() or "1"
        if answer.isdigit() and 1 <= int(answer) <= len(items):
            return items[int(answer) - 1]
        notify(f"{answer!r} is not a number from 1 to {len(items)}")


def _write(path: Path, changes: Mapping[Place, object]) -> None:
    """Put values into the file, whose comments stay, if it is then still a good one. Raises
    InputError."""
    text = edited(path.read_text(encoding="utf-8"), changes)
    rig_from_table(tomllib.loads(text), path)
    write_text(path, text)


def edited(text: str, changes: Mapping[Place, object]) -> str:
    """Return TOML text with changed values.

    Existing lines are replaced. New lines follow the heads of their sections. None removes the
    line.
    """
    lines = text.splitlines()
    for (section, index, key), value in changes.items():
        heads = [
            i
            for i, line in enumerate(lines)
            if re.match(rf"\s*\[+\s*{re.escape(section)}\s*\]+", line)
        ]
        start = heads[index]
        end = next(
            (i for i in range(start + 1, len(lines)) if lines[i].lstrip().startswith("[")),
            len(lines),
        )
        shown = f'"{value}"' if isinstance(value, str) else f"{value!r}"
        found = next(
            (i for i in range(start + 1, end) if re.match(rf"\s*{re.escape(key)}\s*=", lines[i])),
            None,
        )
        if value is None:
            if found is not None:
                del lines[found]
        elif found is not None:
            head, _, rest = lines[found].partition("=")
            comment = re.search(r"\s+#[^\"']*$", rest)
            lines[found] = f"{head}= {shown}{comment[0] if comment else ''}"
        else:
            lines.insert(start + 1, f"{key} = {shown}")
    return "\n".join(lines) + "\n"
