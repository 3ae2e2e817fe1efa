"""Pictures of simulated robots, rendered off screen by another process, as a graphics library may block, leak or crash.

It gets poses on its standard input, and writes pictures to its standard output.
"""

from __future__ import annotations

import json
import os
import select
import struct
import subprocess
import sys
import threading
import time
from contextlib import suppress

from robot_runner.core.entry_points import named_entry_point
from robot_runner.core.errors import ExecutionError

#: Width and height, pixels: enough for a phone, rendered in 20 ms without a graphics card.
_SIZE = (480, 360)
#: The header of each answer: its length, and whether it is a picture (1) or the reason why there is none (0).
_HEAD = struct.Struct(">IB")
#: How long the first picture may take, with the imports, and each further one, s.
_FIRST, _NEXT = 30.0, 5.0
#: The shortest time between two rendered pictures, for all viewers together, s: an experiment may need the processor.
_EVERY = 0.5
_LARGEST = 4_000_000
#: MuJoCo's backends without a screen, tried in this order: https://mujoco.readthedocs.io/en/stable/programming/
_WAYS = ("egl", "osmesa")

Pose = tuple[float, float, float]


class RobotPictures:
    """Renders on request, one picture at a time; the caller waits for `wait_s` first, to limit the rate.

    Args:
        kind: how the robot is reached, as in the manifest.
    """

    def __init__(self, kind: str) -> None:
        self._kind = kind
        self._lock = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self._last: tuple[Pose, float, bytes] | None = None
        self._problem = ""

    def wait_s(self, pose: Pose) -> float:
        """Return how long to wait before the picture of a pose is asked for, s; 0 where it exists."""
        if self._last is None or self._last[0] == pose:
            return 0.0
        return max(0.0, self._last[1] + _EVERY - time.monotonic())

    def picture(self, pose: Pose) -> bytes:
        """Return a picture of the robot at a pose, as PNG.

        Raises:
            ExecutionError: this machine cannot render, which is not tried again.
        """
        with self._lock:
            if self._last is not None and self._last[0] == pose:
                return self._last[2]
            if self._problem:
                raise self._refusal()
            image = self._rendered(pose)
            self._last = (pose, time.monotonic(), image)
            return image

    def close(self) -> None:
        """End the process that renders."""
        process, self._process = self._process, None
        if process is not None:
            process.kill()
            process.wait()
            for stream in (process.stdin, process.stdout):
                if stream is not None:
                    stream.close()

    def _rendered(self, pose: Pose) -> bytes:
        if self._process is not None:
            with suppress(OSError, ValueError):  # a crashed process is started again
                return _asked(self._process, pose, _NEXT)
            self.close()
        given, problem = os.environ.get("MUJOCO_GL"), ""
        for way in (given,) if given else _WAYS:
            try:
                self._process = self._started(way)
                return _asked(self._process, pose, _FIRST)
            except (OSError, ValueError) as error:
                problem = str(error) or type(error).__name__
                self.close()
        self._problem = problem
        raise self._refusal()

    def _started(self, way: str) -> subprocess.Popen[bytes]:
        return subprocess.Popen(  # noqa: S603 - our own program
            [sys.executable, "-P", "-m", __name__, self._kind],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env={**os.environ, "MUJOCO_GL": way},
            start_new_session=True,
        )

    def _refusal(self) -> ExecutionError:
        problem = f"no picture can be rendered here: {self._problem.splitlines()[0][:200]}"
        fix = "Install the extra 'sim' and an EGL library (Debian: libegl1), or go without."
        return ExecutionError(problem, where="the robot's picture", fix=fix)


def _asked(process: subprocess.Popen[bytes], pose: Pose, patience: float) -> bytes:
    """Return the picture from the process.

    Raises:
        ValueError: there is none, with the reason; or it did not answer in time.
        OSError: the process has ended.
    """
    if process.stdin is None or process.stdout is None:
        raise ValueError("the process that renders cannot be reached")
    with suppress(BrokenPipeError):  # it may have answered why it ended
        process.stdin.write(f"{json.dumps(pose)}\n".encode())
        process.stdin.flush()
    end = time.monotonic() + patience
    length, is_picture = _HEAD.unpack(_read(process.stdout.fileno(), _HEAD.size, end))
    if length > _LARGEST:
        raise ValueError("the picture is too large")
    data = _read(process.stdout.fileno(), length, end)
    if not is_picture:
        raise ValueError(data.decode("utf-8", "replace"))
    return data


def _read(descriptor: int, count: int, end: float) -> bytes:
    got = b""
    while len(got) < count:
        ready, _, _ = select.select([descriptor], [], [], max(0.0, end - time.monotonic()))
        piece = os.read(descriptor, count - len(got)) if ready else b""
        if not piece:
            raise ValueError("the process that renders does not answer" if not ready else "the renderer has ended")
        got += piece
    return got


def _render(kind: str) -> int:
    """Be the process that renders, until its standard input ends."""
    os.nice(10)
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # graphics libraries may print to standard output

    def answer(data: bytes, *, is_picture: bool) -> None:
        answers.write(_HEAD.pack(len(data), is_picture) + data)
        answers.flush()

    point = named_entry_point("pictures", kind)
    try:
        picture = point.load()(*_SIZE) if point is not None else None
    except Exception as error:  # noqa: BLE001 - each graphics library fails in its own way
        answer(f"{type(error).__name__}: {error}".encode(), is_picture=False)
        return 1
    if picture is None:
        answer(b"there are no pictures of this kind of robot", is_picture=False)
        return 1
    for line in sys.stdin:
        try:
            answer(picture.png(*map(float, json.loads(line))), is_picture=True)
        except Exception as error:  # noqa: BLE001 - as above
            answer(f"{type(error).__name__}: {error}".encode(), is_picture=False)
    return 0


if __name__ == "__main__":
    sys.exit(_render(sys.argv[1]))
