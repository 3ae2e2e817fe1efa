"""The parameters of the tasks' node, for ROS 1 and ROS 2 alike, and the workers that they ask for."""

from __future__ import annotations

import math
import sys
from typing import TYPE_CHECKING

from robot_runner_onboard.errors import TaskError

if TYPE_CHECKING:
    from typing import Any, Callable, Mapping, Sequence

__all__ = ["PARAMETERS", "task_commands"]

#: Each with its default value, whose type it keeps. The picture's size is the five megapixels of the paper.
PARAMETERS = {
    "network/address": "",
    "network/rate": 0.0,
    "video/source": "camera",
    "video/device": "0",
    "video/topic": "camera/image_raw/compressed",
    "video/width": 2592,
    "video/height": 1944,
    "video/rate": 15.0,
    "video/file": "~/.ros/robot_runner_video.avi",
}

_SOURCES = ("camera", "topic", "synthetic")


def task_commands(given: Mapping[str, Any], topic_recorder: Sequence[str]) -> dict[str, Callable[[], list[str]]]:
    """Return by the name of each task what returns its worker's argument list, or raises `TaskError`.

    Args:
        given: a value for each of `PARAMETERS`.
        topic_recorder: the beginning of the command that records a camera's topic.

    Example:
        >>> commands = task_commands(dict(PARAMETERS, **{"network/address": "http://server/"}), [])
        >>> commands["network"]()[3:]
        ['--address', 'http://server/', '--rate', '0.0']
    """
    return {
        "computation": lambda: _worker("computation"),
        "video": lambda: _video(given, topic_recorder),
        "network": lambda: _network(given),
    }


def _worker(module: str, **options: object) -> list[str]:
    return [sys.executable, "-m", "robot_runner_onboard." + module, *_options(options)]


def _options(options: Mapping[str, object]) -> list[str]:
    return [word for name, value in options.items() for word in ("--" + name, str(value))]


def _network(given: Mapping[str, Any]) -> list[str]:
    address = str(given["network/address"])
    if not address.startswith(("http://", "https://")):
        raise TaskError(f"network/address is {address!r}: set it to one that begins with http:// or https://")
    rate = _number(given, "network/rate", may_be_zero=True)
    return _worker("network", address=address, rate=rate)


def _video(given: Mapping[str, Any], topic_recorder: Sequence[str]) -> list[str]:
    source = given["video/source"]
    if source not in _SOURCES:
        raise TaskError(f"video/source is {source!r}: set it to {', '.join(_SOURCES[:-1])} or {_SOURCES[-1]}")
    rate, file = _number(given, "video/rate"), given["video/file"]
    if source == "topic":
        return [*topic_recorder, *_options({"topic": given["video/topic"], "rate": rate, "file": file})]
    width, height = int(_number(given, "video/width")), int(_number(given, "video/height"))
    return _worker(
        "video", source=source, device=given["video/device"], width=width, height=height, rate=rate, file=file
    )


def _number(given: Mapping[str, Any], name: str, may_be_zero: bool = False) -> float:
    value = given[name]
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
    if not is_number or value < 0 or (value == 0 and not may_be_zero):
        raise TaskError(f"{name} is {value!r}: set it to a number above 0")
    return float(value)
