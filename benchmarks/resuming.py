"""How long it takes to resume a large table: from reading it until its first run starts."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from benchmarks.orchestration import scratch
from benchmarks.table import Row, print_table
from robot_runner.core.config.preparation import prepare_or_refuse
from robot_runner.core.execution.notices import AttemptStarted, Notice, SilentObserver
from robot_runner.core.execution.orchestrator import execute_experiment
from robot_runner.core.execution.recovery import Resumption

if TYPE_CHECKING:
    from pathlib import Path

ROWS = 100_000

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


def half_done(config: Path) -> None:
    """Execute half of the runs for real."""
    only = tuple(f"r_{number}" for number in range(1, ROWS // 2 + 1))
    execute_experiment(prepare_or_refuse(config), SilentObserver(), resumption=Resumption(only=only))


def main() -> None:
    """Print the figure."""
    with scratch() as folder:
        config = folder / "config.py"
        config.write_text(CONFIG.format(folder=str(folder), rows=ROWS), encoding="utf-8")
        half_done(config)
        observer = FirstRun()
        began = time.perf_counter()
        execute_experiment(prepare_or_refuse(config), observer, resumption=Resumption(only=(f"r_{ROWS}",)))
        if observer.started is None:
            raise SystemExit("no run was executed")
        seconds = observer.started - began
    print_table(
        f"Resuming a table of {ROWS:,} rows, half of them done",
        [Row("from the start of the program's work to the first run", f"{seconds:.2f} s", bound="3 s")],
    )


if __name__ == "__main__":
    main()
