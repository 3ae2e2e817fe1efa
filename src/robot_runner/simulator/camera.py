"""A camera on a simulated robot, rendered off screen by MuJoCo: EGL, or OSMesa where there is no EGL."""

from __future__ import annotations

import importlib
import math
import os
from collections.abc import Callable
from typing import Any

import numpy as np

from robot_runner.core.errors import LinkError
from robot_runner.simulator.physics_library import mujoco
from robot_runner.simulator.sensors import PublishedTopic, header
from robot_runner.simulator.simulated_clock import SimulatedClock
from robot_runner.simulator.turtlebot3_parameters import Turtlebot3Parameters

Scene = Callable[[], tuple[mujoco.MjModel, mujoco.MjData]]

#: Computed only while there are subscribers: a picture costs a thousand times as much as a laser scan.
CAMERA_TOPICS = ("camera/image_raw", "camera/camera_info")
#: MuJoCo's ways to render off screen, tried in this order: https://mujoco.readthedocs.io/en/stable/programming/
_WAYS = ("egl", "osmesa")
_VARIABLE = "MUJOCO_GL"
_FRAME = "camera_optical_frame"
_MOST_GEOMS = 10_000
#: Colours of the floor, walls, bodies and wheels, red to alpha 0..1: those of the report's pages.
_FLOOR, _WALL, _BODY, _WHEEL = (0.86, 0.88, 0.91, 1), (0.62, 0.68, 0.75, 1), (0.1, 0.45, 0.85, 1), (0.12, 0.14, 0.17, 1)


class Camera:
    """Renders pictures of a camera of the model, given by its number there.

    `scene` returns the model and its state at this moment; a model without colours is painted with ours.
    """

    def __init__(self, scene: Scene, number: int, parameters: Turtlebot3Parameters, *, is_painted: bool) -> None:
        self._scene = scene
        self._number = number
        self._width, self._height = parameters.camera_width, parameters.camera_height
        self._is_painted = is_painted
        self._renderer: _Renderer | None = None

    def open(self) -> _Renderer:
        """Return the renderer, started by the first call; raise a `LinkError` if nothing here renders off screen."""
        if self._renderer is None:
            model, _ = self._scene()
            if self._is_painted:
                paint(model)
            self._renderer = _opened(model, self._number, self._width, self._height)
        return self._renderer

    def image(self, now_ns: int) -> dict[str, Any]:
        """Return a sensor_msgs/Image."""
        renderer = self.open()
        _, data = self._scene()
        return {
            "header": header(now_ns, _FRAME),
            "height": self._height,
            "width": self._width,
            "encoding": "rgb8",
            "is_bigendian": 0,
            "step": 3 * self._width,
            "data": renderer.pixels(data).tobytes(),
        }

    def info(self, now_ns: int) -> dict[str, Any]:
        """Return a sensor_msgs/CameraInfo of an ideal pinhole camera, with the field names of ROS 2."""
        model, _ = self._scene()
        focal = self._height / 2 / math.tan(math.radians(float(model.cam_fovy[self._number])) / 2)
        x, y = self._width / 2, self._height / 2
        return {
            "header": header(now_ns, _FRAME),
            "height": self._height,
            "width": self._width,
            "distortion_model": "plumb_bob",
            "d": [0.0] * 5,
            "k": [focal, 0.0, x, 0.0, focal, y, 0.0, 0.0, 1.0],
            "r": [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
            "p": [focal, 0.0, x, 0.0, 0.0, focal, y, 0.0, 0.0, 0.0, 1.0, 0.0],
            "binning_x": 0,
            "binning_y": 0,
            "roi": {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False},
        }


def camera_topics(clock: SimulatedClock, camera: Camera, rate: int) -> dict[str, PublishedTopic]:
    """Return the topics of a camera by their names; nothing is rendered without subscribers."""
    image, info = CAMERA_TOPICS
    return {
        image: PublishedTopic(
            clock, "sensor_msgs/Image", rate, lambda: camera.image(clock.now_ns), prepare=camera.open
        ),
        info: PublishedTopic(clock, "sensor_msgs/CameraInfo", rate, lambda: camera.info(clock.now_ns)),
    }


def paint(model: mujoco.MjModel) -> None:
    """Give one of our worlds its colours, which have no effect on physics."""
    model.vis.headlight.ambient[:], model.vis.headlight.diffuse[:] = (0.45,) * 3, (0.6,) * 3
    kinds = mujoco.mjtGeom
    wheel, box, cylinder = map(int, (kinds.mjGEOM_ELLIPSOID, kinds.mjGEOM_BOX, kinds.mjGEOM_CYLINDER))
    for place in range(model.ngeom):
        name, kind = model.geom(place).name, int(model.geom_type[place])
        is_wall = kind in {box, cylinder} and not name
        colour = _FLOOR if name == "floor" else _WALL if is_wall else _WHEEL if kind == wheel else _BODY
        model.geom_rgba[place] = colour


class _Renderer:
    """Renders one camera of one model in its own graphics context."""

    def __init__(self, context: Any, model: mujoco.MjModel, number: int, width: int, height: int) -> None:
        self._graphics = context
        self._model = model
        self._graphics.make_current()
        model.vis.global_.offwidth = max(model.vis.global_.offwidth, width)
        model.vis.global_.offheight = max(model.vis.global_.offheight, height)
        self._context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._context)
        self._scene = mujoco.MjvScene(model, maxgeom=_MOST_GEOMS)
        self._options, self._area = mujoco.MjvOption(), mujoco.MjrRect(0, 0, width, height)
        self._camera = mujoco.MjvCamera()
        self._camera.type, self._camera.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, number
        self._pixels = np.empty((height, width, 3), dtype=np.uint8)

    def pixels(self, data: mujoco.MjData) -> np.ndarray[Any, np.dtype[np.uint8]]:
        """Return the camera's picture, rows from the top, shape (height, width, 3)."""
        self._graphics.make_current()
        everything = int(mujoco.mjtCatBit.mjCAT_ALL)
        mujoco.mjv_updateScene(self._model, data, self._options, None, self._camera, everything, self._scene)
        mujoco.mjr_render(self._area, self._scene, self._context)
        mujoco.mjr_readPixels(self._pixels, None, self._area, self._context)
        return self._pixels[::-1]


def _opened(model: mujoco.MjModel, number: int, width: int, height: int) -> _Renderer:
    """Return a renderer by the first way that works here, or by the one in `MUJOCO_GL` if that is set."""
    given = os.environ.get(_VARIABLE)
    reasons = []
    for way in (given,) if given in _WAYS else _WAYS:
        os.environ[_VARIABLE] = way  # MuJoCo's library reads it, too, when a context is made
        try:
            graphics = importlib.import_module(f"mujoco.{way}").GLContext(width, height)
            return _Renderer(graphics, model, number, width, height)
        except Exception as error:  # noqa: BLE001 - each graphics library has its own errors
            reasons.append(f"{way}: {' '.join(str(error).split()) or type(error).__name__}")
        finally:
            _restore(given)
    problem = f"the camera cannot be rendered on this machine ({'; '.join(reasons)})"
    fix = "Install EGL or OSMesa (Debian: apt install libegl1 libgl1-mesa-dri, or libosmesa6)."
    raise LinkError(problem, where="the simulated robot's camera", fix=fix)


def _restore(given: str | None) -> None:
    if given is None:
        os.environ.pop(_VARIABLE, None)
    else:
        os.environ[_VARIABLE] = given
