"""The profiler that records a video of each run, on the run's clock."""

from __future__ import annotations

import json
import re
import signal
import time
from bisect import bisect_right
from collections.abc import Iterable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import ClassVar

from robot_runner.core.errors import Finding, PluginError, did_you_mean
from robot_runner.core.events.context import Clock, RobotRunnerContext
from robot_runner.core.plugin import Circumstances, Profiler
from robot_runner.measuring.measured_machine import clock_details, machine_clock
from robot_runner.measuring.meter_process import MeterProcess
from robot_runner.measuring.parameter_checks import check_numbers
from robot_runner.measuring.series import within
from robot_runner.meters.video_recording import Recording, frame_times, missing_programs, take_still, without_secrets

_VIDEO, _FRAMES, _STILLS, _ERRORS = "video.mkv", "frames.csv", "stills.json", "stderr.txt"
_LOOK = f"Look at {_VIDEO} and {_ERRORS} in its folder."
#: By how much the wall clock may be set during a recording, s, before frames are reported as misplaced.
_CLOCK_STEP = 0.05
#: A shorter time without a frame is not reported, s.
_GAP = 1.0
#: How long ffmpeg may take to complete the file, s.
_GRACE = 10.0
#: The largest number of phases with a still: a researcher would not look at more.
_MOST_STILLS = 8


class LabCamera(Profiler):
    """Records a video of each run, from before the mission until after it, with the time of each frame.

    `video.mkv` can be played even if the run or ffmpeg was killed; `frames.csv` has the time of each frame in the video
    and on the run's clock. Stills of each phase of the mission, or of its beginning, middle and end, are kept beside it
    and shown in the report.

    Args:
        device: a device file (`/dev/video0`), an address (`rtsp://camera/stream`), a file, or `lavfi:` and a source of
            ffmpeg's own, such as `lavfi:testsrc2`.
        name: distinguishes several cameras; None for the class's name.
        size: width x height to request from a device, such as `1280x720`; None for its default.
        rate_hz: frame rate to request from a device, Hz; None for its default.
        encoder: ffmpeg's name of an encoder; `copy` keeps what the camera encoded, which costs this machine next to
            nothing.
        startup_s: how long to wait for the first frame, s.

    Raises:
        PluginError: the device is empty, the size is malformed, or a number is not positive.

    Example:
        >>> LabCamera(device="rtsp://camera/stream", encoder="copy").device
        'rtsp://camera/stream'
    """

    needs: ClassVar[str] = "ffmpeg (Debian, Ubuntu: sudo apt install ffmpeg), and a camera."
    bytes_per_run: int = 25_000_000  # a mission of 95 s at 2 Mbit/s

    def __init__(
        self,
        device: str = "/dev/video0",
        *,
        name: str | None = None,
        size: str | None = None,
        rate_hz: float | None = None,
        encoder: str = "libx264",
        startup_s: float = 10.0,
    ) -> None:
        super().__init__(name=name)
        if not isinstance(device, str) or not device or device.startswith("-"):
            number = device if isinstance(device, int) else 0  # as OpenCV names it
            raise PluginError(f"device is {device!r}", where=self.name, fix=f"Name one: device='/dev/video{number}'.")
        if size is not None and not (isinstance(size, str) and re.fullmatch(r"\d+x\d+", size)):
            raise PluginError(f"size is {size!r}", where=self.name, fix="Give width x height: size='1280x720'.")
        check_numbers(self.name, startup_s=startup_s, rate_hz=1.0 if rate_hz is None else rate_hz)
        self.device = device
        self.startup_s = startup_s
        self.recording = Recording(device, encoder, size, rate_hz)
        self._process: MeterProcess | None = None
        self._clock: Clock | None = None
        self._forget()

    def claims(self, robot: str | None) -> Iterable[str]:
        """Return a claim of the camera, which other users of this machine see."""
        del robot
        return (f"device:camera {without_secrets(self.device)}",)

    def check(self, circumstances: Circumstances) -> Iterable[Finding]:
        """Return errors if ffmpeg or the device is missing."""
        del circumstances
        where = f"plugin {self.name}"
        missing = missing_programs()
        if missing:
            fix = "Install it (Debian, Ubuntu: sudo apt install ffmpeg)."
            yield Finding.error(where, f"{' and '.join(missing)} cannot be found", fix)
        path = Path(self.device)
        if self.device.startswith("/dev/") and not path.exists():
            there = sorted(str(each) for each in path.parent.glob("video*"))
            fix = did_you_mean(self.device, there) if there else "Plug the camera in."
            yield Finding.error(where, f"there is no {self.device}", fix)

    def start_run(self, context: RobotRunnerContext) -> None:
        """Discard the video of the run before."""
        del context
        self._forget()

    def start_measurement(self, context: RobotRunnerContext) -> None:
        """Start ffmpeg and wait for the first frame; a `PluginError` says that none comes, and why."""
        folder, clock = context.raw_data_folder, machine_clock(context)
        self._clock, self._epoch = clock, int(time.time())
        self._offset = clock.now() - time.time()
        self._write_facts(context, complete=False)
        command = self.recording.command(folder / _VIDEO, self._epoch)
        self._process = process = MeterProcess(command, output=None, folder=folder, clock=clock)
        if process.wait(lambda: _has_frame(process), seconds=self.startup_s):
            return
        was_running = process.is_running
        ending, self._process = process.stop(signal.SIGINT, grace=_GRACE), None
        self._hide_secrets(folder)
        said = without_secrets(ending.complaint)
        silent = f"no frame came within {self.startup_s:g} s"
        ended = silent if was_running else f"ffmpeg ended with code {ending.exit_code}"
        problem = f"{without_secrets(self.device)}: {ended}{f': {said}' if said else ''}"
        raise PluginError(problem, where=self.name, fix="Look at the camera: ffplay shows what ffmpeg can see.")

    def stop_run(self, context: RobotRunnerContext) -> None:
        """End the video, later than `stop_measurement`, so that it also shows what happens right after the mission."""
        process, self._process = self._process, None
        if process is None or self._clock is None:
            return
        was_running = process.is_running
        ending = process.stop(signal.SIGINT, grace=_GRACE)
        folder = context.raw_data_folder
        self._hide_secrets(folder)
        said = f": {without_secrets(ending.complaint)}" if ending.complaint else ""
        if not was_running:
            self._problems.append(f"the video ends before the run: ffmpeg ended with code {ending.exit_code}{said}")
        elif ending.was_killed:
            killed = "ffmpeg did not complete the video and had to be killed"
            self._problems.append(f"{killed}: its last half second is missing")
        step = self._clock.now() - time.time() - self._offset
        if abs(step) > _CLOCK_STEP:
            problem = f"the wall clock was set by {-step:+.2f} s while the video was recorded"
            self._problems.append(f"{problem}: frames are misplaced by up to as much on the run's clock")
        self._read_frames(context)

    def populate_run_data(self, context: RobotRunnerContext) -> None:
        """Report gaps in the video of the mission, and keep stills."""
        for problem in (*self._problems, *self._gaps(context)):
            context.warn(problem, fix=_LOOK)
        try:
            stills = list(self._stills(context))
        except PluginError as error:
            context.warn(f"a still cannot be taken: {error.problem}", fix=_LOOK)
            return
        if stills:
            path = context.raw_data_folder / _STILLS
            path.write_text(json.dumps(stills, indent=2) + "\n", encoding="utf-8")

    def _forget(self) -> None:
        self._clock = None
        self._epoch, self._offset = 0, 0.0
        self._frames: list[float] = []
        self._problems: list[str] = []

    def _read_frames(self, context: RobotRunnerContext) -> None:
        """Write the time of each frame in the video and on the run's clock."""
        folder = context.raw_data_folder
        try:
            self._frames = frame_times(folder / _VIDEO)
        except PluginError as error:
            self._problems.append(f"the video cannot be read: {error.problem}")
            return
        rows = (f"{number},{at:.3f},{self._on_run_clock(at):.6f}" for number, at in enumerate(self._frames))
        (folder / _FRAMES).write_text("\n".join(["frame,video_s,run_s", *rows]) + "\n", encoding="ascii")
        self._write_facts(context, complete=True)

    def _on_run_clock(self, at: float) -> float:
        return at + self._epoch + self._offset

    def _write_facts(self, context: RobotRunnerContext, *, complete: bool) -> None:
        """Write the video's offset from the run's clock: before the recording, so that a killed run has it, too."""
        facts = {
            "device": without_secrets(self.device),
            "run_s_at_video_0": self._epoch + self._offset,
            "utc_at_video_0": self._epoch,
            "frames": len(self._frames) if complete else None,
            **clock_details(context),
        }
        path = context.raw_data_folder / "video.json"
        path.write_text(json.dumps(facts, indent=2) + "\n", encoding="utf-8")

    @staticmethod
    def _hide_secrets(folder: Path) -> None:
        path = folder / _ERRORS
        text = path.read_text(encoding="utf-8", errors="replace")
        path.write_text(without_secrets(text), encoding="utf-8")

    def _gaps(self, context: RobotRunnerContext) -> Iterator[str]:
        """Yield a problem if the video has no frames for parts of the mission."""
        window = context.times.window(self._clock)
        if window is None or self._clock is None:
            return
        times = [self._on_run_clock(at) for at in self._frames]
        edges = (window.start, *times[within(times, window)], window.end)
        unseen = [later - sooner for sooner, later in pairwise(edges) if later - sooner > _GAP]
        if unseen:
            yield f"the video has no frame for {sum(unseen):.1f} s of the mission's {window.duration:.1f} s"

    def _stills(self, context: RobotRunnerContext) -> Iterator[dict[str, object]]:
        """Take a still of each phase, in its middle, or of the mission's beginning, middle and end."""
        window = context.times.window(self._clock)
        if window is None or not self._frames:
            return
        phases = [
            (phase.name, (phase.window.start + phase.window.end) / 2) for phase in context.times.phases(self._clock)
        ]
        middle = (window.start + window.end) / 2
        three = [("beginning", window.start), ("middle", middle), ("end", window.end)]
        folder = context.raw_data_folder
        for number, (label, at) in enumerate((phases or three)[:_MOST_STILLS], start=1):
            file = f"still-{number}.jpg"
            before = bisect_right(self._frames, at - self._epoch - self._offset)
            take_still(folder / _VIDEO, self._frames[max(0, before - 1)], folder / file)
            yield {"label": label, "file": file, "since_start_s": round(at - window.start, 3)}


def _has_frame(process: MeterProcess) -> bool:
    counts = (record.text.partition("=") for record in process.records)
    return any(key.strip() == "frame" and value.strip() not in {"", "0"} for key, _, value in counts)
