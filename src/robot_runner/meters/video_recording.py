"""Videos through ffmpeg: record them with the wall clock's time of each frame, read these times, take stills."""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from robot_runner.core.errors import PluginError
from robot_runner.core.secret_names import without_secret_settings

FFMPEG, FFPROBE = "ffmpeg", "ffprobe"
#: Instead of an encoder: keeps the camera's encoding.
COPY = "copy"
_TEST_PICTURE = "lavfi:"
#: The length of a cluster of Matroska, ms: a kill costs at most the last one, as complete clusters can be played.
_CLUSTER = 500
_WIDTH = 480
_PATIENCE = 60.0


@dataclass(frozen=True, slots=True)
class Recording:
    """The settings of a video recording.

    Attributes:
        device: a device file of Video4Linux, an address such as `rtsp://camera/stream`, a file, or `lavfi:` and one of
            ffmpeg's sources.
        encoder: ffmpeg's name of an encoder, or `copy`.
        size: width x height to request from a device; None for its default.
        rate: frames a second to request from a device; None for its default.
    """

    device: str
    encoder: str
    size: str | None = None
    rate: float | None = None

    def command(self, video: Path, epoch: int) -> list[str]:
        """Return the command that records until it gets SIGINT.

        The timestamp of a frame in the file is the wall clock's time of its arrival less `epoch`: so the file alone
        has the times of all frames, even if a kill has cut it off.

        Args:
            video: the file to write, Matroska.
            epoch: the beginning of the video, s since 1970.
        """
        return [
            *(FFMPEG, "-nostdin", "-hide_banner", "-loglevel", "warning", "-y"),
            *self._input(),
            *("-map", "0:v:0", "-an", "-copyts", "-output_ts_offset", str(-epoch)),
            *self._encoding(),
            *("-f", "matroska", "-flush_packets", "1", "-cluster_time_limit", str(_CLUSTER)),
            *("-progress", "pipe:1", "-stats_period", "0.2", str(video)),
        ]

    def _input(self) -> list[str]:
        stamped = ["-use_wallclock_as_timestamps", "1"]
        if self.device.startswith(_TEST_PICTURE):
            # In real time like a camera, with a finer time base than one tick a frame, to which times would be rounded.
            source = f"{self.device.removeprefix(_TEST_PICTURE)},realtime,settb=1/1000000"
            return [*stamped, "-f", "lavfi", "-i", source]
        if self.device.startswith("rtsp"):
            return [*stamped, "-rtsp_transport", "tcp", "-i", self.device]
        asked = ["-video_size", self.size] if self.size else []
        asked += ["-framerate", f"{self.rate:g}"] if self.rate else []
        kind = ["-f", "v4l2"] if self.device.startswith("/dev/") else []
        return [*stamped, *kind, *asked, "-i", self.device]

    def _encoding(self) -> list[str]:
        if self.encoder == COPY:
            return ["-c:v", "copy"]
        passed = ["-fps_mode", "passthrough"] if _version() >= (5, 1) else ["-vsync", "passthrough"]
        fast = ["-preset", "ultrafast", "-tune", "zerolatency"] if self.encoder.startswith("libx26") else []
        # A key frame a second: a still is found by decoding from the key frame before it.
        keys = ["-force_key_frames", "expr:gte(t,n_forced)"]
        return [*passed, "-c:v", self.encoder, *fast, *keys, "-pix_fmt", "yuv420p"]


@cache
def _version() -> tuple[int, int]:
    """Return the first two numbers of ffmpeg's version; a build from its repository counts as the newest."""
    done = _execute([FFMPEG, "-hide_banner", "-version"])
    found = re.search(r"ffmpeg version n?(\d+)\.(\d+)", done)
    return (int(found[1]), int(found[2])) if found else (99, 0)


def missing_programs() -> list[str]:
    """Return the missing ones of ffmpeg's programs."""
    return [program for program in (FFMPEG, FFPROBE) if shutil.which(program) is None]


def without_secrets(text: str) -> str:
    """Return a text without the logins in its addresses, and without the passwords that are settings there.

    Example:
        >>> without_secrets("rtsp://lab:secret@camera/stream: refused")
        'rtsp://...@camera/stream: refused'
        >>> without_secrets("rtsp://camera/user=lab&password=secret&channel=1")
        'rtsp://camera/user=lab&password=...&channel=1'
    """
    return without_secret_settings(re.sub(r"://[^/\s]*@", "://...@", text), "...")


def frame_times(video: Path) -> list[float]:
    """Return the time of each frame in a video, s, in the order shown; a `PluginError` says that it is no video."""
    asked = ("-select_streams", "v:0", "-show_entries", "packet=pts_time", "-of", "csv=p=0")
    said = _execute([FFPROBE, "-loglevel", "error", *asked, str(video)])
    found = (line.strip().strip(",") for line in said.splitlines())
    return sorted(float(time) for time in found if time and time != "N/A")


def take_still(video: Path, at: float, still: Path) -> None:
    """Write the frame at a time of a video as JPEG, 480 pixels wide.

    Args:
        video: the video.
        at: the time in the video, s; no earlier than the first frame.
        still: the file to write.

    Raises:
        PluginError: there is no such frame.
    """
    # By default seeking is relative to the first frame.
    seek = ("-seek_timestamp", "1", "-ss", f"{at:.3f}")
    scaled = ("-frames:v", "1", "-vf", f"scale={_WIDTH}:-2", "-q:v", "4", "-update", "1")
    _execute(
        [FFMPEG, "-nostdin", "-hide_banner", "-loglevel", "error", "-y", *seek, "-i", str(video), *scaled, str(still)]
    )
    if not still.is_file():
        raise PluginError(f"there is no frame at {at:.3f} s", where=str(video), fix="Look at the video.")


def _execute(command: Sequence[str]) -> str:
    try:
        done = subprocess.run(  # noqa: S603 - our own words, and a path
            command,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=_PATIENCE,
            check=False,
            text=True,
            errors="replace",
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise PluginError(f"{command[0]} cannot be executed: {error}", where=command[0], fix="Install it.") from error
    if done.returncode:
        said = next(iter(done.stderr.strip().splitlines()[::-1]), f"exit code {done.returncode}")
        raise PluginError(f"{command[0]}: {said}", where=command[-1], fix="Look at the video.")
    return done.stdout
