"""OpenCV, imported where a picture is taken or encoded."""

from __future__ import annotations

from typing import TYPE_CHECKING

from robot_runner_onboard.errors import TaskError

if TYPE_CHECKING:
    from typing import Any

__all__ = ["opencv"]


def opencv() -> Any:
    """Return OpenCV's module.

    Raises:
        TaskError: it is not installed.
    """
    try:
        import cv2  # noqa: PLC0415 - computation and network do without
    except ImportError as error:
        raise TaskError(f"OpenCV cannot be imported ({error}): sudo apt install python3-opencv") from error
    return cv2
