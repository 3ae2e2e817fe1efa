"""Several runs are in flight, and something dies or is told to end: each run is told, none is lost, values stay."""

from __future__ import annotations

import csv
import json
import os
import random
import signal
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import pytest
from tests.process.conftest import wait_until

from robot_runner.core.storage.outliving import process_stat

if TYPE_CHECKING:
    from pathlib import Path

Start = Callable[..., Any]

TABLE = """
    def create_run_table(self):
        return RunTableModel([Factor("Speed", [1, 2, 3])], repetitions=2, seed=7, data_columns=["Energy"])
"""
#: The first three runs move until they are told to stop, and end once TOGETHER of them were; not so the second time.
MOVING = """
claims = []
workers = 3
grace_in_s = 120
def launch_mission(self, context):
    import os, time
    print(f"{context.run_id}, attempt {context.attempt}")
    if context.run_number <= 3 and context.attempt == 1:
        self.flag("pid", context).write_text(str(os.getpid()))
        time.sleep(3600)
def stop_run(self, context):
    import time
    self.flag("stopped", context).touch()
    while len(list(Path(__file__).parent.glob("stopped_*"))) < TOGETHER: time.sleep(0.01)
def populate_run_data(self, context): return {"Energy": context.run_seed}
def flag(self, name, context): return Path(__file__).parent / f"{name}_{context.run_id}"
"""


def begun(start: Start, write_config: Callable[..., Path], *, together: int = 1) -> Any:
    """Return an experiment of which three runs move, and none ends before so many were told to."""
    experiment = start(config=write_config(MOVING.replace("TOGETHER", str(together)), table=TABLE))
    for number in (1, 2, 3):
        experiment.wait_for(f"pid_r_{number}")
        wait_until(lambda n=number: pid_of(experiment, f"r_{n}"), "the run has told its process")
    return experiment


def pid_of(experiment: Any, run: str) -> int | None:
    text = (experiment.config.parent / f"pid_{run}").read_text()
    return int(text) if text else None


def resumes(start: Start, experiment: Any, *arguments: str) -> Any:
    again = start("", *arguments, config=experiment.config)
    assert again.end() == 0, again.output
    assert again.statuses == ["Done"] * 6
    assert again.nobody_is_left()
    return again


def without_stamps(table: Iterable[dict[str, str]]) -> list[dict[str, str]]:
    return [{name: cell for name, cell in row.items() if not name.endswith("_at")} for row in table]


@pytest.mark.long
def test_told_to_end_all_that_are_in_flight_are_closed_and_the_experiment_resumes(
    start: Start, write_config: Callable[..., Path], robot_runner: Callable[..., Any]
) -> None:
    experiment = begun(start, write_config, together=3)
    lines = [line.strip() for line in robot_runner("status", experiment.folder).out.splitlines()]
    for slot in (1, 2, 3):
        assert any(line.endswith(f"slot {slot}: r_{slot}, launch_mission") for line in lines), lines
    experiment.send(signal.SIGINT)
    assert experiment.end() == 130, "else the second is told once the first has ended, which waits for the others"
    assert experiment.statuses == ["-"] * 6
    assert all(f"Interrupted: closing r_{number}" in experiment.output for number in (1, 2, 3))
    resumes(start, experiment, "--workers", "2")


@pytest.mark.long
def test_killed_the_orchestrator_leaves_no_run_and_each_log_is_its_own_runs(
    start: Start, write_config: Callable[..., Path]
) -> None:
    experiment = begun(start, write_config, together=3)
    experiment.send(signal.SIGKILL)
    assert experiment.nobody_is_left(), "each keeper notices that it is alone"
    assert all((experiment.config.parent / f"stopped_r_{number}").exists() for number in (1, 2, 3))
    again = resumes(start, experiment)
    for number in (1, 2, 3):
        earlier = again.folder / "earlier_attempts" / f"r_{number}" / "1" / "log.txt"
        printed = earlier.read_text()
        assert printed.startswith(f"r_{number}, attempt 1\n")
        assert printed.count(", attempt ") == 1
        assert (again.folder / "runs" / f"r_{number}" / "log.txt").read_text() == f"r_{number}, attempt 2\n"


@pytest.mark.long
@pytest.mark.parametrize("whom", ["run", "keeper"])
def test_one_that_dies_takes_no_other_with_it(start: Start, write_config: Callable[..., Path], whom: str) -> None:
    experiment = begun(start, write_config)
    run = pid_of(experiment, "r_2")
    os.kill(run if whom == "run" else int(process_stat(run)[1]), signal.SIGKILL)
    ended = experiment.folder / "journal.jsonl"
    wait_until(lambda: '"kind":"attempt_finished"' in ended.read_text(), "the end of the run that died is kept")
    first = next(json.loads(line) for line in ended.read_text().splitlines() if "attempt_finished" in line)
    assert (first["run"], first["status"]) == ("r_2", "failed")
    assert f"the run's {'process' if whom == 'run' else 'keeper'} was killed by SIGKILL" in first["failure"]
    assert all(process_stat(pid_of(experiment, name))[0] != "Z" for name in ("r_1", "r_3")), "they live"
    experiment.send(signal.SIGINT)
    assert experiment.end() == 130
    assert experiment.nobody_is_left()
    resumes(start, experiment, "--workers", "3")


def killed_at_random(start: Start, config: Path, chance: random.Random, longest: float) -> None:
    """Execute an experiment to its end whose orchestrator is killed again and again."""
    for _ in range(5):
        experiment = start("", "--workers", str(chance.choice([2, 3, 4])), config=config)
        time.sleep(chance.uniform(0.5, 1.0) * longest)
        if experiment.process.poll() is not None:
            break
        with suppress(ProcessLookupError):  # it has ended since
            experiment.send(signal.SIGKILL)
        experiment.end()
    final = start("", "--workers", "3", config=config)
    assert final.end() == 0, final.output
    assert final.nobody_is_left()


BRIEF = """
claims = []
def launch_mission(self, context):
    import time
    time.sleep(0.2 + context.run_seed % 7 / 20)
def populate_run_data(self, context): return {"Energy": context.run_seed / context.combination["Speed"]}
"""


@pytest.mark.long
def test_killed_at_random_and_resumed_the_table_is_that_of_one_worker(
    start: Start, write_config: Callable[..., Path]
) -> None:
    table = TABLE.replace("repetitions=2", "repetitions=5")
    alone = start(config=write_config(BRIEF, table=table))
    assert alone.end() == 0
    expected = without_stamps(alone.table)
    config = write_config(BRIEF.replace("claims", 'results_output_path = "others"\nclaims'), table=table, name="b.py")
    killed_at_random(start, config, random.Random(1), 3.0)  # noqa: S311 - for a test
    with (config.parent / "others/trial/run_table.csv").open(encoding="utf-8", newline="") as file:
        rows = without_stamps(csv.DictReader(file))
    assert rows == expected
    assert [row["status"] for row in rows] == ["Done"] * 15
