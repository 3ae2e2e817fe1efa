"""Pictures of the embedded robot in its arena, rendered off screen by MuJoCo; needs EGL or OSMesa."""

from __future__ import annotations

import math
import struct
import zlib
from typing import TYPE_CHECKING

from robot_runner.simulator.camera import paint
from robot_runner.simulator.model import burger_model
from robot_runner.simulator.physics_library import mujoco
from robot_runner.simulator.turtlebot3_parameters import Turtlebot3Parameters

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

#: The viewpoint: distance in m, azimuth and elevation in degrees.
_DISTANCE, _AZIMUTH, _ELEVATION = 1.1, 140.0, -30.0


class RobotPicture:
    """Renders the robot at any place, in pictures of this width and height, pixels.

    Raises:
        Exception: this machine cannot render off screen; the type depends on its graphics library.
    """

    def __init__(self, width: int, height: int) -> None:
        parameters = Turtlebot3Parameters()
        self._model = mujoco.MjModel.from_xml_string(burger_model(parameters, (parameters.wheel_radius,) * 2))
        self._data = mujoco.MjData(self._model)
        self._height = parameters.wheel_radius
        paint(self._model)
        self._renderer = mujoco.Renderer(self._model, height, width)
        self._camera = mujoco.MjvCamera()
        self._camera.distance, self._camera.azimuth, self._camera.elevation = _DISTANCE, _AZIMUTH, _ELEVATION

    def png(self, x: float, y: float, heading: float) -> bytes:
        """Return a picture of the robot at a place in the arena (m) with a heading (rad)."""
        self._data.qpos[:7] = (x, y, self._height, math.cos(heading / 2), 0, 0, math.sin(heading / 2))
        mujoco.mj_forward(self._model, self._data)
        self._camera.lookat[:] = (x, y, 0.1)
        self._renderer.update_scene(self._data, self._camera)
        return _png(self._renderer.render())


def _png(pixels: npt.NDArray[np.uint8]) -> bytes:
    """Return pixels (height x width x 3) as PNG: https://www.w3.org/TR/png-3/."""
    height, width, _ = pixels.shape
    lines = b"".join(b"\0" + row.tobytes() for row in pixels)  # filter 0: none
    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    parts = (b"IHDR", head), (b"IDAT", zlib.compress(lines, 3)), (b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + b"".join(_chunk(*part) for part in parts)


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
