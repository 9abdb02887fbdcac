"""Names and formats of a Linux computer's video devices, from the kernel, without starting them.

Structures and requests: linux/videodev2.h, https://docs.kernel.org/userspace-api/media/v4l/.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

_ENUM_FMT = 0xC0405602
_ENUM_FRAMESIZES = 0xC02C564A
_ENUM_FRAMEINTERVALS = 0xC034564B
# V4L2_BUF_TYPE_VIDEO_CAPTURE; V4L2_FRMSIZE_TYPE_DISCRETE, which is V4L2_FRMIVAL_TYPE_DISCRETE
_CAPTURE = 1
_DISCRETE = 1
_ENTRIES_MAX = 64  # entries of a list, in case that a driver never ends it

Ioctl = Callable[[int, int, bytearray], object]


@dataclass(frozen=True)
class VideoDevice:
    """Camera with its most stable `path` for opening it.

    `device` is its kernel name (/dev/videoN), `name` that of its maker, and `serial` its serial
    number ("" if none). `formats` are (fourcc, width, height, largest rate in Hz).
    """

    path: str
    device: str
    name: str
    serial: str
    formats: tuple[tuple[str, int, int, float], ...]


def video_devices(root: Path = Path("/")) -> list[VideoDevice]:
    """List all devices that send images; `root`: root of the file system."""
    found = []
    folders = (root / "sys/class/video4linux").glob("video*")
    for folder in sorted(folders, key=lambda path: (len(path.name), path.name)):
        if _read_text(folder / "index") != "0":  # a camera's second node, for its metadata
            continue
        device = root / "dev" / folder.name
        formats = tuple(formats_of(device))
        name = _read_text(folder / "name")
        serial = _read_text((folder / "device").resolve().parent / "serial")
        path = _stable_path(root, device)
        found.append(VideoDevice(path, str(device), name, serial, formats))
    return found


def formats_of(device: Path, ioctl: Ioctl = fcntl.ioctl) -> Iterator[tuple[str, int, int, float]]:
    """Return the formats of a device; empty if it cannot be opened or is not a camera."""
    with contextlib.suppress(OSError):
        descriptor = os.open(device, os.O_RDWR | os.O_NONBLOCK)
        try:
            for code in _codes(descriptor, ioctl):
                name = code.to_bytes(4, "little").decode("ascii", "replace").strip()
                for width, height in _sizes(descriptor, code, ioctl):
                    yield name, width, height, _largest_rate(descriptor, code, width, height, ioctl)
        finally:
            os.close(descriptor)


def _entries(
    descriptor: int, request: int, size: int, head: tuple[int, ...], ioctl: Ioctl
) -> Iterator[bytes]:
    """Yield the kernel's answers for index 0, 1, … to the last; `head` follows the index."""
    for index in range(_ENTRIES_MAX):
        data = bytearray(struct.pack(f"{1 + len(head)}I", index, *head).ljust(size, b"\0"))
        try:
            ioctl(descriptor, request, data)
        except OSError:
            return
        yield bytes(data)


def _codes(descriptor: int, ioctl: Ioctl) -> Iterator[int]:
    for data in _entries(descriptor, _ENUM_FMT, 64, (_CAPTURE,), ioctl):
        yield struct.unpack_from("I", data, 44)[0]


def _sizes(descriptor: int, code: int, ioctl: Ioctl) -> Iterator[tuple[int, int]]:
    for data in _entries(descriptor, _ENUM_FRAMESIZES, 44, (code,), ioctl):
        kind, width, height = struct.unpack_from("3I", data, 8)
        # a range (minimum, maximum and step of the width, then of the height): use its maximum
        if kind != _DISCRETE:
            _, width, _, _, height = struct.unpack_from("5I", data, 12)
        yield width, height
        if kind != _DISCRETE:
            return


def _largest_rate(descriptor: int, code: int, width: int, height: int, ioctl: Ioctl) -> float:
    rates = [0.0]
    for data in _entries(descriptor, _ENUM_FRAMEINTERVALS, 52, (code, width, height), ioctl):
        # the interval, or the minimum of a range of intervals
        numerator, denominator = struct.unpack_from("2I", data, 20)
        rates.append(denominator / numerator if numerator else 0.0)
    return max(rates)


def _stable_path(root: Path, device: Path) -> str:
    """Return a persistent device name: by serial number, or else by socket."""
    for folder in ("by-id", "by-path"):
        for link in sorted((root / "dev/v4l" / folder).glob("*")):
            if link.resolve() == device.resolve():
                return str(link)
    return str(device)


def _read_text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return ""
