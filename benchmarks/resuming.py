"""How long it takes to resume a large table half of whose runs are done, beside a fresh start of the same size."""

from __future__ import annotations

import multiprocessing
import time
from concurrent.futures import ProcessPoolExecutor
from typing import TYPE_CHECKING, Any

from benchmarks.orchestration import scratch
from benchmarks.table import Row, print_table
from robot_runner.core.config.preparation import prepare_or_refuse
from robot_runner.core.execution.notices import AttemptStarted, Notice, SilentObserver
from robot_runner.core.execution.orchestrator import execute_experiment
from robot_runner.core.execution.resumption import Resumption
from robot_runner.core.storage.cells import RunStatus
from robot_runner.core.storage.journal import Journal
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.run_table_reading import read_run_table
from robot_runner.core.storage.run_table_rows import write_run_table
from robot_runner.core.storage.table_columns import TableLayout
from robot_runner.core.storage.table_schema import read_schema

if TYPE_CHECKING:
    from pathlib import Path

_SIZES = (100_000, 1_000_000)
_TIMES = 3
_BOUND = 1.5
_RUNS_BETWEEN_TABLES = 30_000  # as it comes to where a table of a million rows takes 2 s to write

CONFIG = """
from robot_runner import ExperimentConfig, Factor, RunProcess, RunTableModel

class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "large"
    results_output_path = {folder!r}
    run_process = RunProcess.IN_PROCESS

    def populate_run_data(self, context):
        return {{"Energy": 877.5, "CPU": 16.5}}

    def create_run_table(self):
        return RunTableModel(
            [Factor("Task", ["a", "b", "c", "d"]), Factor("Repetition", range({rows} // 4))],
            data_columns=["Energy", "CPU"], shuffle=True, seed=1,
        )
"""


class FirstRun(SilentObserver):
    """Remembers when the first run started."""

    started: float | None = None

    def notice(self, notice: Notice) -> None:
        """Take the time of the first attempt."""
        if self.started is None and isinstance(notice, AttemptStarted):
            self.started = time.perf_counter()


def seconds_to_first_run(config: Path, only: str) -> float:
    """Execute one run; return how long it takes from loading the config until that run starts, in seconds."""
    observer = FirstRun()
    began = time.perf_counter()
    execute_experiment(prepare_or_refuse(config), observer, resumption=Resumption(only=(only,)))
    if observer.started is None:
        raise SystemExit("no run was executed")
    return observer.started - began


def finish_half(root: Path) -> None:
    """Bring a folder in which `r_1` was executed to where half of the runs are done, each with what `r_1` left."""
    folder = ExperimentFolder(root)
    rows = read_run_table(folder.run_table, TableLayout.of_schema(read_schema(folder.schema)))
    first = rows.row(0)
    stamps: dict[str, Any] = {name: first[name] for name in rows.layout.stamps}
    measures: dict[str, Any] = {name: first[name] for name in rows.layout.measures}
    lines = [
        line for line in folder.journal.read_text(encoding="utf-8").splitlines(keepends=True) if '"run":"r_1"' in line
    ]
    with folder.journal.open("a", encoding="utf-8") as journal:
        for number in range(2, len(rows) // 2 + 1):
            rows.record(f"r_{number}", status=RunStatus.DONE, stamps=stamps, measures=measures)
            if number % _RUNS_BETWEEN_TABLES == 0:
                journal.write('{"kind":"table_written","at":"2026-01-31T12:00:00.250Z"}\n')
            journal.writelines(line.replace('"run":"r_1"', f'"run":"r_{number}"') for line in lines)
    write_run_table(folder.run_table, rows)
    with Journal(folder.journal) as closing:
        closing.append("table_written")


def measured(folder: Path, size: int) -> tuple[float, float]:
    """Return how long a fresh start takes and how long resuming does, the best of several, in seconds."""
    fresh: list[float] = []
    for number in range(_TIMES):
        config = _config(folder / f"{size}_{number}", size)
        fresh.append(_in_fresh_process(seconds_to_first_run, config, "r_1"))
    _in_fresh_process(finish_half, config.parent / "large")
    resumed = [_in_fresh_process(seconds_to_first_run, config, f"r_{size - number}") for number in range(_TIMES)]
    return min(fresh), min(resumed)


def main() -> None:
    """Print the figures."""
    rows = []
    with scratch() as folder:
        for size in _SIZES:
            fresh, resumed = measured(folder, size)
            rows.append(
                Row(f"{size:,} rows", f"{resumed:.2f} s", f"{fresh:.2f} s", f"{resumed / fresh:.2f}", f"{_BOUND} x")
            )
    print_table(f"Resuming a table half done until its first run starts, beside a fresh start (best of {_TIMES})", rows)


def _config(folder: Path, size: int) -> Path:
    folder.mkdir()
    config = folder / "config.py"
    config.write_text(CONFIG.format(folder=str(folder), rows=size), encoding="utf-8")
    return config


def _in_fresh_process(function: Any, *arguments: Any) -> Any:
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as process:
        return process.submit(function, *arguments).result()


if __name__ == "__main__":
    main()
