"""The preview of samples that are being taken: a few a second, and never a reason for a run to fail."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from robot_runner.measuring import live_samples
from robot_runner.measuring.live_samples import LiveSamples
from robot_runner.measuring.quality import Column

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


def sample(time: float, power: float | None = 7.5) -> list[Column]:
    return [Column("time_s", [time]), Column("power_W", [power])]


def test_a_sample_now_and_then_is_written_until_it_is_closed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    now = [100.0]
    monkeypatch.setattr(live_samples.time, "monotonic", lambda: now[0])
    live = LiveSamples(tmp_path / "samples.csv")
    asked = []
    for place in range(60):  # 30 a second, for two seconds
        now[0] = 100.0 + place / 30
        live.show(lambda place=place: asked.append(place) or sample(place / 30, None if place > 40 else 7.5))
    text = (tmp_path / ".samples.csv.live").read_text()
    assert text == "time_s,power_W\n0.0,7.5\n0.5,7.5\n1.0,7.5\n1.5,\n"
    assert asked == [0, 15, 30, 45], "columns are made for nothing"
    live.close()
    live.close()
    assert list(tmp_path.iterdir()) == []


def test_what_fails_is_left(tmp_path: Path) -> None:
    asked: list[int] = []

    def fail() -> list[Column]:
        asked.append(1)
        raise RuntimeError("no columns of one reading")

    live = LiveSamples(tmp_path / "samples.csv")
    live.show(fail)
    live.show(fail)
    assert len(asked) == 1
    elsewhere = LiveSamples(tmp_path / "no" / "such" / "samples.csv")
    elsewhere.show(lambda: sample(0.0))


@pytest.mark.long
@pytest.mark.filterwarnings("ignore:.*multi-threaded:DeprecationWarning")
def test_a_polled_meter_and_this_computer_are_seen_while_a_run_lasts(
    robot_runner: Callable, write_config: Callable[..., Path], tmp_path: Path
) -> None:
    pytest.importorskip("psutil")
    write_config(
        """
        plugins = [PsUtil(host="localhost", rate_hz=20), Fan()]

        def launch_mission(self, context):
            end = time.monotonic() + 20
            live = context.run_path / "PsUtil" / ".samples.csv.live", context.run_path / "Fan" / ".samples.csv.live"
            while not all(each.exists() and len(each.read_text().splitlines()) > 2 for each in live):
                assert time.monotonic() < end, list(context.run_path.rglob("*"))
                context.clock.sleep(0.05)
            Path("seen").write_text("".join(each.read_text().splitlines()[0] for each in live))
        """,
        head=HEAD,
        table=TABLE,
    )
    answer = robot_runner("run", "config.py", "--only", "r_1")
    assert answer.code == 0, answer.err
    assert (tmp_path / "seen").read_text() == "time_s,cpu_percent,memory_percenttime_s,speed_rpm"
    run = tmp_path / "results" / "trial" / "runs" / "r_1"
    assert [path.name for path in run.rglob(".*")] == [], "previews are left"
    assert (run / "Fan" / "samples.csv").exists()


HEAD = """\
import time
from pathlib import Path
from robot_runner import *
from robot_runner.plugins import Column, PolledProfiler
from robot_runner.plugins.profilers import PsUtil


class Meter:
    def read(self):
        return 1200.0

    def close(self):
        pass


class Fan(PolledProfiler[float]):
    def open(self, context):
        return Meter()

    def columns(self, sampling):
        return [Column("speed_rpm", list(sampling.readings))]

    def values(self, sampling):
        return {}


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "trial"
    results_output_path = Path("results")
"""
TABLE = """\
    def create_run_table(self):
        return RunTableModel([Factor("Task", ["A", "B"])], data_columns=["CPU"])
"""
