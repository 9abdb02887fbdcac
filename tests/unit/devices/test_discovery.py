"""Tests of device discovery: on emulated buses, and for cameras with a kernel that answers as
documented.

This computer has no camera; structures and numbers are those of linux/videodev2.h.
"""

import errno
import json
import struct

import pytest

from mjtactile.cli import main
from mjtactile.core.errors import DeviceError
from mjtactile.devices.camera.v4l2 import formats_of, video_devices
from mjtactile.devices.discovery import serial_ports, servos_at, valve_board_at
from tests.emulated import REPLY_TIMEOUT, servo_bench, valve_bench

MODES = {
    "MJPG": [(640, 480, [(1, 30), (1, 60)]), (1280, 720, [(1, 30)])],
    "YUYV": [(640, 480, [(1, 15)])],
}


def kernel(modes=MODES, stepwise=False):
    """Return VIDIOC_ENUM_FMT, _FRAMESIZES and _FRAMEINTERVALS of a camera with these modes."""
    codes = {struct.unpack("I", name.encode())[0]: sizes for name, sizes in modes.items()}

    def ioctl(number, request, data):
        try:
            index, second = struct.unpack_from("2I", data)
            if request == 0xC0405602:  # index, type, flags, description[32], pixelformat
                assert second == 1 and len(data) == 64
                struct.pack_into("I", data, 44, list(codes)[index])
            elif request == 0xC02C564A and stepwise:
                # index, pixel_format, type, then min, max, step of width and height
                assert len(data) == 44
                ((width, height, _),) = codes[second][index : index + 1]
                struct.pack_into("7I", data, 8, 3, 16, width, 16, 8, height, 8)
            elif request == 0xC02C564A:
                struct.pack_into("3I", data, 8, 1, *codes[second][index][:2])
            else:  # index, pixel_format, width, height, type, interval
                assert request == 0xC034564B and len(data) == 52
                width, height = struct.unpack_from("2I", data, 8)
                rates = next(rates for w, h, rates in codes[second] if (w, h) == (width, height))
                struct.pack_into("3I", data, 16, 1, *rates[index])
        except (IndexError, ValueError):
            raise OSError(errno.EINVAL, "no more") from None

    return ioctl


def test_formats_of_a_camera(tmp_path):
    (tmp_path / "video0").touch()
    found = list(formats_of(tmp_path / "video0", kernel()))
    assert found == [("MJPG", 640, 480, 60.0), ("MJPG", 1280, 720, 30.0), ("YUYV", 640, 480, 15.0)]
    ranges = list(
        formats_of(tmp_path / "video0", kernel({"MJPG": MODES["MJPG"][:1]}, stepwise=True))
    )
    assert ranges == [("MJPG", 640, 480, 60.0)]
    # a regular file: the real kernel reports that it is not a camera
    assert list(formats_of(tmp_path / "video0")) == []
    assert list(formats_of(tmp_path / "video7", kernel())) == []


def test_cameras_are_listed_by_their_persistent_name(tmp_path):
    for number, index, name in (
        (0, 0, "Left camera"),
        (1, 1, "Left camera"),
        (10, 0, "Right"),
        (2, 0, "Middle"),
    ):
        folder = tmp_path / f"sys/devices/usb{number}/interface/video4linux/video{number}"
        folder.mkdir(parents=True)
        (folder / "index").write_text(f"{index}\n")
        (folder / "name").write_text(f"{name}\n")
        (folder / "device").symlink_to(folder.parents[1])
        (tmp_path / "sys/class/video4linux").mkdir(parents=True, exist_ok=True)
        (tmp_path / f"sys/class/video4linux/video{number}").symlink_to(folder)
        (tmp_path / "dev/v4l/by-id").mkdir(parents=True, exist_ok=True)
        (tmp_path / f"dev/video{number}").touch()
    (tmp_path / "sys/devices/usb0/serial").write_text("SN0001\n")
    (tmp_path / "dev/v4l/by-id/usb-Left-video-index0").symlink_to("../../video0")
    (tmp_path / "dev/v4l/by-path").mkdir()
    (tmp_path / "dev/v4l/by-path/usb-0:2").symlink_to("../../video2")
    found = [
        (camera.name, camera.path.removeprefix(f"{tmp_path}/dev/"), camera.serial)
        for camera in video_devices(tmp_path)
    ]
    assert found == [
        ("Left camera", "v4l/by-id/usb-Left-video-index0", "SN0001"),
        ("Middle", "v4l/by-path/usb-0:2", ""),
        ("Right", "video10", ""),
    ]


@pytest.mark.clock
def test_servos_and_valve_boards_answer(capsys, monkeypatch):
    # of six speeds and 21 numbers, each a reply's time: a valve board answers none of them
    monkeypatch.setattr("mjtactile.devices.discovery.BAUDS", (57_600, 1_000_000))
    monkeypatch.setattr("mjtactile.devices.discovery.IDS", range(1, 4))
    with servo_bench() as bench:
        baud, found = servos_at(bench.bus.path, [1_000_000], reply_time=REPLY_TIMEOUT / 10)
        assert (baud, found) == (1_000_000, {1: "XL330-M288", 2: "XL330-M288"})
        # WRITE, SYNC WRITE: no register is written
        assert not any(packet.code in (0x03, 0x83) for packet in bench.log)
    with valve_bench() as (port, _, _, _):
        assert valve_board_at(port.path) == "mjvalve 1.1, 2 channels, with pressure sensors"
        assert main(["devices", "--port", port.path, "--json"]) == 0
        ports = json.loads(capsys.readouterr().out)["serial_ports"]
        assert ports[-1]["answers"] == [
            "valve board: mjvalve 1.1, 2 channels, with pressure sensors"
        ]


def test_a_port_that_cannot_be_opened_is_reported(tmp_path):
    with pytest.raises(DeviceError, match="nowhere"):
        valve_board_at(str(tmp_path / "nowhere"))
    port = serial_ports([str(tmp_path / "nowhere")])[-1]
    assert port.answers == () and "nowhere" in port.problem
