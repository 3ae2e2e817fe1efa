"""Where the frames of a video come from."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from robot_runner_onboard.errors import TaskError
from robot_runner_onboard.opencv import opencv

if TYPE_CHECKING:
    from typing import Any, Protocol

    class Camera(Protocol):
        """What frames can be taken from."""

        def frame(self) -> Any: ...

        def close(self) -> None: ...


__all__ = ["DeviceCamera", "SyntheticCamera", "opened_camera"]

#: How far the pattern of the synthetic camera moves from frame to frame, in pixels.
_SHIFT = 8


class DeviceCamera:
    """A camera of the robot's computer, through OpenCV.

    Args:
        device: its number, its device file, or anything else that OpenCV opens, such as a file or a stream.
        width: of a frame, in pixels.
        height: of a frame, in pixels.
        rate: frames a second.

    Raises:
        TaskError: it cannot be opened, or takes no frames of this size.
    """

    def __init__(self, device: str, width: int, height: int, rate: float) -> None:
        cv2 = opencv()
        self._device = device
        self._capture = cv2.VideoCapture(int(device) if device.isdigit() else device)
        if not self._capture.isOpened():
            raise TaskError(f"there is no camera {device}: set video/device to its number or file")
        self._capture.set(cv2.CAP_PROP_FRAME_WIDTH, width)
        self._capture.set(cv2.CAP_PROP_FRAME_HEIGHT, height)
        self._capture.set(cv2.CAP_PROP_FPS, rate)
        taken_height, taken_width = self.frame().shape[:2]
        if (taken_width, taken_height) != (width, height):
            self.close()
            problem = f"camera {device} takes {taken_width}x{taken_height} instead of {width}x{height}"
            raise TaskError(f"{problem}: set video/width and video/height to what it can do")

    def frame(self) -> Any:
        """Wait for the next frame and return it.

        Raises:
            TaskError: none comes.
        """
        is_there, frame = self._capture.read()
        if not is_there:
            raise TaskError(f"camera {self._device} delivers no frame")
        return frame

    def close(self) -> None:
        """Let go of the camera."""
        self._capture.release()


class SyntheticCamera:
    """A moving pattern at the rate of a camera, to try everything without one.

    Args:
        width: of a frame, in pixels.
        height: of a frame, in pixels.
        rate: frames a second.

    Raises:
        TaskError: NumPy, which comes with OpenCV, is not installed.
    """

    def __init__(self, width: int, height: int, rate: float) -> None:
        opencv()
        import numpy as np  # noqa: PLC0415 - comes with OpenCV, without which nothing is recorded

        columns = np.arange(width, dtype=np.uint32)
        rows = np.arange(height, dtype=np.uint32)[:, None]
        self._pattern = np.stack([columns + rows, columns ^ rows, columns - rows], axis=2).astype(np.uint8)
        self._roll = np.roll
        self._rate = rate
        self._count = 0
        self._begun = time.monotonic()

    def frame(self) -> Any:
        """Wait for the next frame and return it."""
        time.sleep(max(0.0, self._begun + self._count / self._rate - time.monotonic()))
        self._count += 1
        return self._roll(self._pattern, self._count * _SHIFT, axis=1)

    def close(self) -> None:
        """Do nothing: there is nothing to let go of."""


def opened_camera(source: str, device: str, width: int, height: int, rate: float) -> Camera:
    """Return the camera of this source: `camera` or `synthetic`.

    Raises:
        TaskError: it cannot be opened.
    """
    if source == "synthetic":
        return SyntheticCamera(width, height, rate)
    return DeviceCamera(device, width, height, rate)
