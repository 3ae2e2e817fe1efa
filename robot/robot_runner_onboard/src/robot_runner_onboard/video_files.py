"""Where the frames of a video go to."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

from robot_runner_onboard.errors import TaskError
from robot_runner_onboard.opencv import opencv

if TYPE_CHECKING:
    from typing import Any

__all__ = ["FrameFile", "JpegFile", "provide_folder"]


def provide_folder(path: str) -> str:
    """Make the folder of a file and return the file's full path.

    Raises:
        TaskError: there can be no such folder.
    """
    full = os.path.abspath(os.path.expanduser(path))
    try:
        os.makedirs(os.path.dirname(full), exist_ok=True)
    except OSError as error:
        raise TaskError(f"{full} cannot be written ({error.strerror}): set video/file") from error
    return full


class FrameFile:
    """An AVI file of JPEG pictures, which OpenCV encodes by itself on every computer.

    Args:
        path: of the file; it is overwritten.
        width: of a frame, in pixels.
        height: of a frame, in pixels.
        rate: frames a second that a player is to show.

    Raises:
        TaskError: it cannot be written.
    """

    def __init__(self, path: str, width: int, height: int, rate: float) -> None:
        cv2 = opencv()
        self.path = provide_folder(path)
        self.count = 0
        self._size = width, height
        self._writer = cv2.VideoWriter(self.path, cv2.VideoWriter_fourcc(*"MJPG"), rate, self._size)
        if not self._writer.isOpened():
            raise TaskError(f"{self.path} cannot be written: set video/file to an .avi file")

    def add(self, frame: Any) -> None:
        """Encode and write a frame: blue, green and red, as OpenCV has it.

        Raises:
            TaskError: it is not as large as the first one was; OpenCV would leave it out without a word.
        """
        height, width = frame.shape[:2]
        if (width, height) != self._size:
            raise TaskError(f"the pictures changed from {self._size[0]}x{self._size[1]} to {width}x{height}")
        self._writer.write(frame)
        self.count += 1

    def close(self) -> None:
        """Finish the file; closing twice does nothing."""
        self._writer.release()

    def summary(self) -> str:
        """Return what is in the closed file.

        Raises:
            TaskError: nothing came to be in it, as when the disk is full.
        """
        width, height = self._size
        return _summary(self.path, self.count, f"{width}x{height}")


class JpegFile:
    """Pictures that are JPEG already, one after the other (.mjpeg), as players take them; OpenCV is not needed."""

    def __init__(self, path: str) -> None:
        self.path = provide_folder(os.path.splitext(path)[0] + ".mjpeg")
        self.count = 0
        try:
            self._file = open(self.path, "wb")  # noqa: SIM115 - it is closed by `close`
        except OSError as error:
            raise TaskError(f"{self.path} cannot be written ({error.strerror}): set video/file") from error

    def add(self, picture: bytes) -> None:
        """Write a picture.

        Raises:
            TaskError: it cannot be written.
        """
        try:
            self._file.write(picture)
        except OSError as error:
            raise TaskError(f"{self.path} cannot be written: {error.strerror}") from error
        self.count += 1

    def close(self) -> None:
        """Finish the file; closing twice does nothing.

        Raises:
            TaskError: it cannot be written.
        """
        try:
            self._file.close()
        except OSError as error:
            raise TaskError(f"{self.path} cannot be written: {error.strerror}") from error

    def summary(self) -> str:
        """Return what is in the closed file.

        Raises:
            TaskError: nothing is.
        """
        return _summary(self.path, self.count, "JPEG")


def _summary(path: str, count: int, what: str) -> str:
    size = os.path.getsize(path)
    if count and not size:
        raise TaskError(f"{path} stayed empty: look whether the disk is full")
    return f"{count} frames, {what}, {size / 1e6:.1f} MB in {path}"
