"""The task "video": a camera to a file, by OpenCV."""

from __future__ import annotations

import argparse
import sys
from contextlib import closing
from functools import partial
from typing import TYPE_CHECKING

from robot_runner_onboard.cameras import opened_camera
from robot_runner_onboard.channel import serve
from robot_runner_onboard.video_files import FrameFile

if TYPE_CHECKING:
    from typing import Callable

    from robot_runner_onboard.cameras import Camera
    from robot_runner_onboard.channel import Channel

__all__ = ["record"]


def record(channel: Channel, open_camera: Callable[[], Camera], open_file: Callable[[], FrameFile]) -> str:
    """Record until told to end.

    Raises:
        TaskError: camera or file cannot be opened, or the camera falls silent.
    """
    with closing(open_camera()) as camera, closing(open_file()) as file:
        file.add(camera.frame())
        channel.ready()
        while not channel.is_over():
            file.add(camera.frame())
    return file.summary()


def _main() -> int:
    parser = argparse.ArgumentParser(prog="video")
    parser.add_argument("--source", choices=["camera", "synthetic"], required=True)
    parser.add_argument("--device", required=True)
    parser.add_argument("--width", type=int, required=True)
    parser.add_argument("--height", type=int, required=True)
    parser.add_argument("--rate", type=float, required=True)
    parser.add_argument("--file", required=True)
    given = parser.parse_args()
    open_camera = partial(opened_camera, given.source, given.device, given.width, given.height, given.rate)
    open_file = partial(FrameFile, given.file, given.width, given.height, given.rate)
    return serve(partial(record, open_camera=open_camera, open_file=open_file))


if __name__ == "__main__":
    sys.exit(_main())
