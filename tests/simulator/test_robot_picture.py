"""The embedded robot, rendered off screen where that can be done."""

from __future__ import annotations

import ctypes.util
import struct
import zlib

import pytest

from robot_runner.core.errors import ExecutionError
from robot_runner.page.robot_pictures import RobotPictures


def pixels(png: bytes) -> tuple[int, int, bytes]:
    """Return width, height and what the picture holds."""
    assert png.startswith(b"\x89PNG\r\n\x1a\n")
    width, height = struct.unpack(">II", png[16:24])
    start = png.index(b"IDAT") + 4
    (length,) = struct.unpack(">I", png[start - 8 : start - 4])
    return width, height, zlib.decompress(png[start : start + length])


@pytest.mark.long
def test_the_robot_is_seen_where_it_is() -> None:
    if ctypes.util.find_library("EGL") is None and ctypes.util.find_library("OSMesa") is None:
        pytest.skip("neither EGL nor OSMesa is installed (Debian: apt install libegl1 libgl1-mesa-dri)")
    pictures = RobotPictures("simulated")
    try:
        first = pictures.picture((0.0, 0.0, 0.0))
        width, height, data = pixels(first)
        assert (width, height, len(data)) == (480, 360, 360 * (480 * 3 + 1))
        blue = sum(1 for at in range(1, len(data) - 2, 3) if data[at + 2] > data[at] + 60)
        assert blue > 500, "no robot is seen"
        assert pictures.wait_s((0.0, 0.0, 0.0)) == 0
        assert pictures.picture((1.0, 0.0, 1.0)) != first
    except ExecutionError as error:
        pytest.skip(f"this machine does not render: {error.problem}")
    finally:
        pictures.close()


def test_what_cannot_be_rendered_is_said_once() -> None:
    pictures = RobotPictures("ros9")
    for _ in range(2):
        with pytest.raises(ExecutionError, match="there are no pictures of this kind of robot"):
            pictures.picture((0.0, 0.0, 0.0))
