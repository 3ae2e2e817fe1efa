"""What executing a run costs beside its floor: fork, wait, and one line flushed to disk."""

from __future__ import annotations

import os
import statistics
import sys
import tempfile
import time
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from benchmarks.table import Row, print_table
from robot_runner.core.config.preparation import prepare_or_refuse
from robot_runner.core.execution.notices import SilentObserver
from robot_runner.core.execution.orchestrator import execute_experiment

if TYPE_CHECKING:
    from collections.abc import Iterator

CONFIG = """
from robot_runner import ExperimentConfig, Factor, RunTableModel

class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "empty"
    results_output_path = {folder!r}

    def start_run(self, context): pass
    def launch_mission(self, context): pass
    def populate_run_data(self, context): return {{"Energy": 1.0}}

    def create_run_table(self):
        return RunTableModel([Factor("Run", range({runs}))], data_columns=["Energy"])
"""


@contextmanager
def scratch() -> Iterator[Path]:
    """Yield a folder on the disk of the working directory: the system's temporary one may be in memory."""
    with tempfile.TemporaryDirectory(dir=Path.cwd(), prefix=".benchmark-") as folder:
        yield Path(folder)


def seconds_per_run(runs: int, run_process: str) -> float:
    """Execute an experiment with empty callbacks."""
    with scratch() as folder:
        config = folder / "config.py"
        config.write_text(CONFIG.format(folder=str(folder), runs=runs), encoding="utf-8")
        experiment = prepare_or_refuse(config, {"run_process": run_process})
        started = time.perf_counter()
        finished = execute_experiment(experiment, SilentObserver())
        seconds = time.perf_counter() - started
        if finished.done_count != runs:
            sys.exit(f"{finished.done_count} of {runs} runs were done: {finished.failures[:1]}")
        return seconds / runs


def floor(runs: int) -> float:
    """Fork, wait, and append one line to a file that is flushed, with the same modules in memory."""
    with scratch() as folder, (folder / "journal").open("ab", buffering=0) as file:
        started = time.perf_counter()
        for _ in range(runs):
            pid = os.fork()
            if pid == 0:
                os._exit(0)
            os.waitpid(pid, 0)
            file.write(b"x" * 200 + b"\n")
            os.fsync(file.fileno())
        return (time.perf_counter() - started) / runs


def main() -> None:
    """Print the figures."""
    floors, forks = [], []
    for _ in range(5):  # in turn, so that both see the same noise
        floors.append(floor(300))
        forks.append(seconds_per_run(300, "fork"))
    lowest, forked = statistics.median(floors), statistics.median(forks)
    ratio = statistics.median(fork / least for fork, least in zip(forks, floors, strict=True))
    hundred = statistics.median(seconds_per_run(100, "fork") for _ in range(5))
    in_process = statistics.median(seconds_per_run(1000, "in_process") for _ in range(3))
    thousands = seconds_per_run(10_000, "fork")
    print_table(
        "Orchestration, empty callbacks, each run flushed to disk",
        [
            Row(
                "fresh process a run, 300 runs",
                f"{forked * 1e3:.2f} ms a run",
                f"{lowest * 1e3:.2f} ms",
                f"{ratio:.2f}",
                "2",
            ),
            Row(
                "at 10,000 runs, beside 100 runs",
                f"{thousands * 1e3:.2f} ms a run",
                f"{hundred * 1e3:.2f} ms",
                f"{thousands / hundred:.2f}",
                "1.2",
            ),
            Row("in-process, 1,000 runs", f"{in_process * 1e3:.3f} ms a run", "", "", "0.3 ms"),
        ],
    )


if __name__ == "__main__":
    main()
