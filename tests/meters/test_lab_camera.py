"""The lab camera on ffmpeg's own test picture, over a real RTSP stream, and when processes are killed."""

from __future__ import annotations

import csv
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress
from typing import TYPE_CHECKING

import pytest
from tests.meters.rehearsed import InRealTime, problems
from tests.meters.rtsp_server import RtspServer
from tests.waiting import wait_until

from robot_runner.core.errors import PluginError
from robot_runner.core.events.context import SystemClock
from robot_runner.core.storage.outliving import process_stat
from robot_runner.meters.video_recording import frame_times, take_still
from robot_runner.plugins import Circumstances
from robot_runner.plugins.profilers import LabCamera
from robot_runner.testing import ProfilerContract, make_context, rehearse

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from robot_runner.core.events.context import RobotRunnerContext

PICTURE = "lavfi:testsrc2=size=160x120:rate=25"

needs_ffmpeg = pytest.mark.skipif(
    shutil.which("ffmpeg") is None or shutil.which("ffprobe") is None,
    reason="ffmpeg is not installed (on Debian: apt install ffmpeg)",
)


@pytest.mark.long
@needs_ffmpeg
class TestLabCamera(InRealTime, ProfilerContract):
    robot = None
    is_repeatable = False
    measuring_seconds = 0.3

    def make_plugin(self) -> LabCamera:
        return LabCamera(PICTURE)


def filmed(folder: Path, camera: LabCamera, mission: Callable[[RobotRunnerContext], None]) -> RobotRunnerContext:
    context = make_context(folder, camera, robot=None, clock=SystemClock())
    try:
        rehearse(context, camera, mission=lambda: mission(context))
    finally:
        context.resources.close()
    return context


def rows(context: RobotRunnerContext) -> list[dict[str, float]]:
    with (context.raw_data_folder / "frames.csv").open(encoding="ascii") as file:
        return [{name: float(value) for name, value in row.items()} for row in csv.DictReader(file)]


@pytest.mark.long
@needs_ffmpeg
def test_each_frame_is_placed_on_the_clock_of_the_run(tmp_path: Path) -> None:
    context = filmed(tmp_path, LabCamera(PICTURE), lambda _: time.sleep(1.5))
    assert problems(context) == []
    frames = rows(context)
    assert context.window is not None
    within = [frame for frame in frames if context.window.start <= frame["run_s"] <= context.window.end]
    assert len(within) > 15  # of 37: a busy machine may drop some
    gaps = {round(frame["run_s"] - frame["video_s"], 3) for frame in frames}
    assert len(gaps) == 1
    facts = json.loads((context.raw_data_folder / "video.json").read_text())
    assert gaps == {round(facts["run_s_at_video_0"], 3)}
    assert facts["frames"] == len(frames)


class FilmedLamp:
    """A camera in front of a lamp: raw video through a named pipe, white from when the lamp was lit."""

    def __init__(self, path: Path) -> None:
        os.mkfifo(path)
        self.path = path
        self.is_lit = threading.Event()
        self.lit_at: float | None = None
        self.is_over = threading.Event()
        self._thread = threading.Thread(target=self._film, daemon=True)
        self._thread.start()

    def close(self) -> None:
        self.is_over.set()
        self._thread.join(10.0)

    def _film(self) -> None:
        with suppress(BrokenPipeError), self.path.open("wb", buffering=0) as pipe:
            pipe.write(b"YUV4MPEG2 W64 H48 F25:1 Ip C420jpeg\n")
            while not self.is_over.wait(0.04):
                level = b"\xff" if self.is_lit.is_set() else b"\x00"
                if self.is_lit.is_set() and self.lit_at is None:
                    self.lit_at = SystemClock().now()  # a thread of a busy machine may be late
                pipe.write(b"FRAME\n" + level * (64 * 48) + b"\x80" * (64 * 48 // 2))


def brightness(video: Path) -> list[float]:
    """Return the mean brightness of each frame, by decoding the whole video."""
    decode = ("-fps_mode", "passthrough", "-f", "rawvideo", "-pix_fmt", "gray", "-")
    words = ["ffmpeg", "-loglevel", "error", "-i", str(video), *decode]
    pixels = subprocess.run(words, capture_output=True, check=True).stdout
    return [sum(pixels[at : at + 64 * 48]) / (64 * 48) for at in range(0, len(pixels), 64 * 48)]


@pytest.mark.long
@needs_ffmpeg
def test_what_a_frame_shows_happened_when_its_row_says(tmp_path: Path) -> None:
    lamp = FilmedLamp(tmp_path / "camera.y4m")

    def mission(_: RobotRunnerContext) -> None:
        time.sleep(1.0)
        lamp.is_lit.set()
        time.sleep(1.0)

    context = filmed(tmp_path / "results", LabCamera(str(lamp.path)), mission)
    lamp.close()
    levels = brightness(context.raw_data_folder / "video.mkv")
    frames = rows(context)
    assert len(levels) == len(frames)
    first_white = next(number for number, level in enumerate(levels) if level > 128)
    assert frames[first_white]["run_s"] == pytest.approx(lamp.lit_at, abs=0.15)


@pytest.mark.long
@needs_ffmpeg
def test_stills_are_of_the_phases_of_the_mission_else_of_its_beginning_middle_and_end(tmp_path: Path) -> None:
    middles: list[float] = []

    def with_phases(context: RobotRunnerContext) -> None:
        for name in ("navigate", "task"):
            with context.phase(name):
                begun = context.clock.now()
                time.sleep(0.4)
                middles.append((begun + context.clock.now()) / 2)

    context = filmed(tmp_path / "phases", LabCamera(PICTURE), with_phases)
    stills = json.loads((context.raw_data_folder / "stills.json").read_text())
    assert [still["label"] for still in stills] == ["navigate", "task"]
    expected = [middle - context.window.start for middle in middles]
    assert [still["since_start_s"] for still in stills] == pytest.approx(expected, abs=0.1)
    context = filmed(tmp_path / "none", LabCamera(PICTURE), lambda _: time.sleep(0.4))
    stills = json.loads((context.raw_data_folder / "stills.json").read_text())
    assert [still["label"] for still in stills] == ["beginning", "middle", "end"]
    for still in stills:
        assert (context.raw_data_folder / still["file"]).read_bytes().startswith(b"\xff\xd8")


@pytest.mark.long
@needs_ffmpeg
def test_a_still_shows_the_frame_at_its_time(tmp_path: Path) -> None:
    source = "lavfi:color=c=black:size=64x48:rate=25,drawbox=c=white:t=fill:enable='gte(t,1)'"
    context = filmed(tmp_path, LabCamera(source), lambda _: time.sleep(2.0))
    video, still = context.raw_data_folder / "video.mkv", tmp_path / "still.jpg"
    times = frame_times(video)
    for at, is_white in ((times[2], False), (times[-2], True)):
        take_still(video, at, still)
        words = ["ffmpeg", "-loglevel", "error", "-i", str(still), "-f", "rawvideo", "-pix_fmt", "gray", "-"]
        pixels = subprocess.run(words, capture_output=True, check=True).stdout
        assert (sum(pixels) / len(pixels) > 128) is is_white


def seconds_filmed(video: Path) -> float:
    """Return how much of a video can be read by now, s: however long a busy machine takes to begin it."""
    with suppress(PluginError):  # nothing was written yet
        times = frame_times(video)
        return times[-1] - times[0] if times else 0.0
    return 0.0


@needs_ffmpeg
@pytest.mark.parametrize("victim", ["ffmpeg", "run"])
def test_a_video_can_be_played_after_a_kill(tmp_path: Path, victim: str) -> None:
    script = f"""
import sys, time
from pathlib import Path
from robot_runner.core.events.context import SystemClock
from robot_runner.plugins.profilers import LabCamera
from robot_runner.testing import make_context
camera = LabCamera({PICTURE!r})
context = make_context(Path({str(tmp_path)!r}), camera, robot=None, clock=SystemClock())
camera.start_run(context)
camera.start_measurement(context)
print(camera._process.process.pid, flush=True)
time.sleep(60)
"""
    video = tmp_path / "runs" / "r_1" / "LabCamera" / "video.mkv"
    with subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        pid = int(process.stdout.readline())
        wait_until(lambda: seconds_filmed(video) > 1.0, "a second has been filmed")
        os.kill(pid if victim == "ffmpeg" else process.pid, signal.SIGKILL)
        wait_until(lambda: process_stat(pid)[:1] in ([], ["Z"]), "ffmpeg has ended")
        process.kill()
    times = frame_times(video)
    assert times[-1] - times[0] > 1.0
    facts = json.loads((tmp_path / "runs" / "r_1" / "LabCamera" / "video.json").read_text())
    assert facts["run_s_at_video_0"] + times[-1] == pytest.approx(time.monotonic(), abs=20.0)


@pytest.mark.long
@needs_ffmpeg
def test_a_camera_that_stops_costs_the_rest_of_the_video_and_not_the_run(tmp_path: Path) -> None:
    camera = LabCamera("lavfi:testsrc2=size=160x120:rate=25:duration=1")
    context = filmed(tmp_path, camera, lambda _: time.sleep(3.0))
    said = problems(context)
    assert any(problem.startswith("the video ends before the run") for problem in said)
    assert any(problem.startswith("the video has no frame for ") for problem in said)


@needs_ffmpeg
def test_a_camera_that_is_not_there_fails_the_run_before_the_robot_moves(tmp_path: Path) -> None:
    with pytest.raises(PluginError, match="ended with code") as caught:
        filmed(tmp_path, LabCamera(str(tmp_path / "nothing.mkv")), lambda _: None)
    assert "No such file" in caught.value.problem


@pytest.mark.long
@needs_ffmpeg
def test_what_the_camera_encoded_can_be_kept_as_it_is(tmp_path: Path) -> None:
    with RtspServer(tmp_path / "served") as server:
        context = filmed(tmp_path, LabCamera(server.url, encoder="copy"), lambda _: time.sleep(1.5))
    assert problems(context) == []
    assert len(rows(context)) > 15


@pytest.mark.long
@needs_ffmpeg
def test_an_address_keeps_its_password_to_itself(tmp_path: Path) -> None:
    with RtspServer(tmp_path / "served") as server:
        secret = server.url.replace("rtsp://", "rtsp://lab:hunter2@")
        context = filmed(tmp_path / "good", LabCamera(secret), lambda _: time.sleep(0.5))
        port = server.port
    with pytest.raises(PluginError) as caught:
        filmed(tmp_path / "bad", LabCamera(f"rtsp://lab:hunter2@127.0.0.1:{port}/gone"), lambda _: None)
    assert "hunter2" not in str(caught.value)
    assert problems(context) == []
    for path in [*(tmp_path / "good").rglob("*"), *(tmp_path / "bad").rglob("*")]:
        assert not path.is_file() or b"hunter2" not in path.read_bytes(), path


@pytest.mark.parametrize(
    "device",
    [
        "rtsp://lab:hunter2@camera/stream",
        "rtsp://camera:554/user=lab&password=hunter2&channel=1_stream=0.sdp",
        "http://camera/video.mjpg?usr=lab&pwd=hunter2",
    ],
)
def test_the_claim_of_a_camera_keeps_its_password_to_itself(device: str) -> None:
    """Others see it as the name of a file in /run/lock."""
    (claim,) = LabCamera(device).claims(None)
    assert "hunter2" not in claim
    assert "camera/" in claim or "camera:554/" in claim


def test_ffmpeg_that_is_missing_is_a_finding(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    (finding,) = LabCamera("rtsp://camera/stream").check(Circumstances())
    assert finding.is_error
    assert "ffmpeg" in finding.problem
    assert "apt install ffmpeg" in finding.fix


def test_a_device_that_is_missing_is_a_finding() -> None:
    found = [each for each in LabCamera("/dev/video9999").check(Circumstances()) if "video9999" in each.problem]
    assert [finding.is_error for finding in found] == [True]


@pytest.mark.parametrize(
    "wrong",
    [
        *({"device": device} for device in ("", "-y", 1)),
        *({"size": size} for size in ("big", (1280, 720))),
        *({"rate_hz": 0.0}, {"startup_s": -1.0}),
    ],
)
def test_parameters_that_cannot_be_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(PluginError):
        LabCamera(**wrong)  # type: ignore[arg-type]
