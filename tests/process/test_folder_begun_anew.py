"""A folder is removed while its experiment waits, and the experiment is begun anew at the same place."""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from typing import Any

import pytest
from tests.process.conftest import wait_until

from robot_runner.core.storage.journal import read_journal
from robot_runner.core.storage.outliving import is_stopped

Start = Callable[..., Any]

WAITING = """
operator_steps = [OperatorStep("place the robot", first=True)]
def populate_run_data(self, context): return {"Energy": 1.5}
"""


def records(experiment: Any) -> list[str]:
    return [record["kind"] for record in read_journal(experiment.folder / "journal.jsonl")]


def stop_and_remove(experiment: Any) -> None:
    """Stop an experiment, so that it writes nothing meanwhile, and remove its folder; it stays stopped."""
    experiment.send(signal.SIGSTOP)
    wait_until(lambda: is_stopped(experiment.process.pid), "it is stopped")
    shutil.rmtree(experiment.folder)


@pytest.mark.long
def test_the_first_execution_ends_and_leaves_the_second_its_answers_and_its_journal(start: Start) -> None:
    first = start(WAITING)
    wait_until(lambda: "waiting" in records(first), "it waits for a person")
    stop_and_remove(first)
    second = start(config=first.config)
    wait_until(lambda: "waiting" in records(second), "the other one waits, too")
    first.send(signal.SIGCONT)
    assert first.end() == 2
    assert f"executed by process {second.process.pid}" in first.output
    (kept,) = first.folder.glob("journal.jsonl.removed-*")
    assert "waiting" in kept.read_text()
    command = [sys.executable, "-m", "robot_runner", "continue", str(second.config)]
    subprocess.run(command, check=True, capture_output=True)
    assert second.end() == 0, second.output
    assert second.statuses == ["Done"] * 4
    assert records(second).count("attempt_finished") == 4


@pytest.mark.long
def test_an_execution_whose_folder_is_removed_while_it_waits_says_so(start: Start) -> None:
    experiment = start(WAITING)
    wait_until(lambda: "waiting" in records(experiment), "it waits for a person")
    shutil.rmtree(experiment.folder)
    assert experiment.end() == 2
    assert "the experiment's folder was removed while it was executed" in experiment.output


KEEPS_RAW_DATA = """
claims = []
def launch_mission(self, context):
    here = Path(__file__).parent
    (here / f"{context.run_id}.moves").touch()
    import time
    while context.run_id != "r_1" and not (here / "gone").exists(): time.sleep(0.01)
def populate_run_data(self, context):
    context.run_folder.mkdir(parents=True, exist_ok=True)
    (context.run_folder / "raw.csv").write_text(context.run_id)
    return {"Energy": 1.5}
"""


@pytest.mark.long
@pytest.mark.parametrize("workers", [1, 2])
def test_a_folder_that_is_removed_and_that_runs_in_flight_make_anew_ends_the_execution(
    start: Start, workers: int
) -> None:
    first = start(KEEPS_RAW_DATA, "--workers", str(workers))
    for number in range(2, 2 + workers):  # r_1 is done, and r_2 is in flight; with two workers r_3, too
        first.wait_for(f"r_{number}.moves")
    stop_and_remove(first)
    (first.config.parent / "gone").touch()
    first.send(signal.SIGCONT)
    assert first.end() == 1, first.output
    assert "the experiment's folder was removed while it was executed" in first.output
    assert first.nobody_is_left()
    again = start(config=first.config)
    assert again.end() == 0, again.output
    assert again.statuses == ["Done"] * 4
    assert records(again).count("attempt_finished") == 4
    assert {each.parent.name for each in again.folder.glob("runs/*/raw.csv")} == {"r_1", "r_2", "r_3", "r_4"}
