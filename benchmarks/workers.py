"""What several runs at the same time gain over one after another: runs that wait, and simulated missions."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

from benchmarks.table import Row, print_table
from robot_runner.core.config.preparation import prepare_or_refuse
from robot_runner.core.execution.notices import SilentObserver
from robot_runner.core.execution.orchestrator import execute_experiment

#: How many simulated missions; more are more precise, and none is shorter than another.
MISSIONS = 60
#: Eight workers and four rounds: what begins and ends them is small beside it.
WAITING, SECONDS = 32, 2.0

WAITS = """
from robot_runner import ExperimentConfig, Factor, RunTableModel

class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "waiting"
    results_output_path = {folder!r}
    workers = {workers}
    claims = []

    def launch_mission(self, context):
        context.clock.sleep({seconds})

    def create_run_table(self):
        return RunTableModel([Factor("Run", range({runs}))])
"""

DRIVES = """
from robot_runner import ExperimentConfig, Factor, RunTableModel
from robot_runner.plugins.profilers import Ina219
from robot_runner.plugins.systems import BasicTurtlebot3

class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "driving"
    results_output_path = {folder!r}
    workers = {workers}
    robot = "simulated"
    plugins = [BasicTurtlebot3(task="Video"), Ina219()]

    def create_run_table(self):
        return RunTableModel([Factor("Run", range({runs}))], seed=1)
"""


def executed(body: str, workers: int, runs: int) -> float:
    """Return how long the runs of a config take with so many workers, s."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "config.py"
        path.write_text(body.format(folder=folder, workers=workers, runs=runs, seconds=SECONDS), encoding="utf-8")
        experiment = prepare_or_refuse(path)
        started = time.perf_counter()
        finished = execute_experiment(experiment, SilentObserver())
        seconds = time.perf_counter() - started
    if finished.done_count != runs:
        raise SystemExit(f"{runs - finished.done_count} of {runs} runs are not done")
    return seconds


def gain(figure: str, body: str, workers: int, runs: int, bound: str) -> Row:
    """Return how much faster several workers are than one."""
    one, several = executed(body, 1, runs), executed(body, workers, runs)
    return Row(figure, f"{several:.1f} s", f"{one:.1f} s (one worker)", f"{one / several:.2f}", bound)


def main() -> None:
    """Print the figures."""
    rows = [
        gain(f"{WAITING} runs that wait for {SECONDS:g} s, eight workers", WAITS, 8, WAITING, ">= 7.6"),
        gain(f"{MISSIONS} simulated missions, two workers", DRIVES, 2, MISSIONS, ">= 1.85 with two cores"),
    ]
    print_table("Several runs at the same time", rows)


if __name__ == "__main__":
    main()
