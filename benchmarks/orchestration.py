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
from robot_runner.core.execution.notices import AttemptFinished, Notice, SilentObserver
from robot_runner.core.execution.orchestrator import execute_experiment

if TYPE_CHECKING:
    from collections.abc import Iterator

ROUNDS = 7
RUNS = 100
LONG = 10_000
BOUND = 3.5
BOUND_OF_LONG = 1.2

WITHOUT_CALLBACKS = """
from robot_runner import ExperimentConfig, Factor, RunTableModel

class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "without_callbacks"
    results_output_path = {folder!r}

    def create_run_table(self):
        return RunTableModel([Factor("Run", range({runs}))])
"""

#: All ten events, in a config and in a plugin; SEMI, so that `continue` is one of them.
EMPTY_CALLBACKS = """
from robot_runner import ExperimentConfig, Factor, OperationType, RunTableModel
from robot_runner.plugins import Profiler

class Everything(Profiler):
    def before_experiment(self, context): pass
    def before_run(self, context): pass
    def start_run(self, context): pass
    def start_measurement(self, context): pass
    def launch_mission(self, context): pass
    def stop_measurement(self, context): pass
    def stop_run(self, context): pass
    def populate_run_data(self, context): pass
    def continue_experiment(self, context): pass
    def after_experiment(self, context): pass

class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "empty_callbacks"
    results_output_path = {folder!r}
    operation_type = OperationType.SEMI
    plugins = [Everything()]

    def before_experiment(self, context): return True
    def before_run(self, context): pass
    def start_run(self, context): pass
    def start_measurement(self, context): pass
    def launch_mission(self, context): pass
    def stop_measurement(self, context): pass
    def stop_run(self, context): pass
    def populate_run_data(self, context): return {{"Energy": 1.0}}
    def continue_experiment(self, context): return True
    def after_experiment(self, context): pass

    def create_run_table(self):
        return RunTableModel([Factor("Run", range({runs}))], data_columns=["Energy"])
"""

#: As Experiment Runner's `config-create` writes it, but for the treatments and the folder.
EXPERIMENT_RUNNER = """
from EventManager.Models.RunnerEvents import RunnerEvents
from EventManager.EventSubscriptionController import EventSubscriptionController
from ConfigValidator.Config.Models.RunTableModel import RunTableModel
from ConfigValidator.Config.Models.FactorModel import FactorModel
from ConfigValidator.Config.Models.RunnerContext import RunnerContext
from ConfigValidator.Config.Models.OperationType import OperationType
from ProgressManager.Output.OutputProcedure import OutputProcedure as output

from typing import Dict, List, Any, Optional
from pathlib import Path
from os.path import dirname, realpath


class RunnerConfig:
    ROOT_DIR = Path(dirname(realpath(__file__)))
    name: str = "experiment_runner"
    results_output_path: Path = ROOT_DIR / "experiments"
    operation_type: OperationType = OperationType.AUTO
    time_between_runs_in_ms: int = 0

    def __init__(self):
        EventSubscriptionController.subscribe_to_multiple_events([
            (RunnerEvents.BEFORE_EXPERIMENT, self.before_experiment),
            (RunnerEvents.BEFORE_RUN       , self.before_run       ),
            (RunnerEvents.START_RUN        , self.start_run        ),
            (RunnerEvents.START_MEASUREMENT, self.start_measurement),
            (RunnerEvents.INTERACT         , self.interact         ),
            (RunnerEvents.STOP_MEASUREMENT , self.stop_measurement ),
            (RunnerEvents.STOP_RUN         , self.stop_run         ),
            (RunnerEvents.POPULATE_RUN_DATA, self.populate_run_data),
            (RunnerEvents.AFTER_EXPERIMENT , self.after_experiment )
        ])
        self.run_table_model = None
        output.console_log("Custom config loaded")

    def create_run_table_model(self) -> RunTableModel:
        factor1 = FactorModel("example_factor1", list(range({runs})))
        self.run_table_model = RunTableModel(factors=[factor1], data_columns=['avg_cpu', 'avg_mem'])
        return self.run_table_model

    def before_experiment(self) -> None:
        output.console_log("Config.before_experiment() called!")

    def before_run(self) -> None:
        output.console_log("Config.before_run() called!")

    def start_run(self, context: RunnerContext) -> None:
        output.console_log("Config.start_run() called!")

    def start_measurement(self, context: RunnerContext) -> None:
        output.console_log("Config.start_measurement() called!")

    def interact(self, context: RunnerContext) -> None:
        output.console_log("Config.interact() called!")

    def stop_measurement(self, context: RunnerContext) -> None:
        output.console_log("Config.stop_measurement called!")

    def stop_run(self, context: RunnerContext) -> None:
        output.console_log("Config.stop_run() called!")

    def populate_run_data(self, context: RunnerContext) -> Optional[Dict[str, Any]]:
        output.console_log("Config.populate_run_data() called!")
        return None

    def after_experiment(self) -> None:
        output.console_log("Config.after_experiment() called!")

    # ================================ DO NOT ALTER BELOW THIS LINE ================================
    experiment_path: Path = None
"""

CONFIGS = {
    "(a) no callbacks": WITHOUT_CALLBACKS,
    "(b) empty callbacks for all ten events, in a config and a plugin": EMPTY_CALLBACKS,
    "(c) Experiment Runner's own config, as it is": EXPERIMENT_RUNNER,
}


class Stopwatch(SilentObserver):
    """Notes when each run had ended."""

    def __init__(self) -> None:
        self.ended: list[float] = []

    def notice(self, notice: Notice) -> None:
        if isinstance(notice, AttemptFinished):
            self.ended.append(time.perf_counter())

    def seconds_per_run(self, first: int, last: int) -> float:
        """Return the mean of the runs after run `first` up to run `last`."""
        return (self.ended[last - 1] - self.ended[first - 1]) / (last - first)


@contextmanager
def scratch() -> Iterator[Path]:
    """Yield a folder on the disk of the working directory: the system's temporary one may be in memory."""
    with tempfile.TemporaryDirectory(dir=Path.cwd(), prefix=".benchmark-") as folder:
        yield Path(folder)


def executed(config: str, runs: int, run_process: str = "fork") -> tuple[Stopwatch, float]:
    """Execute an experiment; return when its runs had ended, and the seconds that the whole took for each run."""
    with scratch() as folder:
        path = folder / "RunnerConfig.py"
        path.write_text(config.format(folder=str(folder), runs=runs), encoding="utf-8")
        experiment = prepare_or_refuse(path, {"run_process": run_process})
        stopwatch = Stopwatch()
        started = time.perf_counter()
        finished = execute_experiment(experiment, stopwatch)
        seconds = time.perf_counter() - started
        if finished.done_count != runs:
            sys.exit(f"{finished.done_count} of {runs} runs were done: {finished.failures[:1]}")
        return stopwatch, seconds / runs


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


def rows_of_configs() -> Iterator[Row]:
    """Measure each config and the floor in turn, so that all see the same noise, and yield a row for each config."""
    for config in CONFIGS.values():
        executed(config, 3)  # imports what it needs: the floor's process is as large as theirs
    floors: list[float] = []
    measured: dict[str, list[float]] = {name: [] for name in CONFIGS}
    for _ in range(ROUNDS):
        floors.append(floor(RUNS))
        for name, config in CONFIGS.items():
            measured[name].append(executed(config, RUNS)[0].seconds_per_run(1, RUNS))
    for name, seconds in measured.items():
        ratio = statistics.median(each / least for each, least in zip(seconds, floors, strict=True))
        yield Row(
            name,
            f"{statistics.median(seconds) * 1e3:.2f} ms a run",
            f"{statistics.median(floors) * 1e3:.2f} ms",
            f"{ratio:.2f}",
            f"{BOUND:g}",
        )


def main() -> None:
    """Print the figures."""
    rows = list(rows_of_configs())
    in_process = statistics.median(executed(WITHOUT_CALLBACKS, 1000, "in_process")[1] for _ in range(3))
    stopwatch, _ = executed(EMPTY_CALLBACKS, LONG)
    early, late = stopwatch.seconds_per_run(100, 1100), stopwatch.seconds_per_run(LONG - 1000, LONG)
    rows += [
        Row(
            f"(b), the last 1,000 of {LONG:,} runs, beside 1,000 from run 100 on",
            f"{late * 1e3:.2f} ms a run",
            f"{early * 1e3:.2f} ms",
            f"{late / early:.2f}",
            f"{BOUND_OF_LONG:g}",
        ),
        Row("in the orchestrator's process, no callbacks", f"{in_process * 1e3:.3f} ms a run", "", "", "0.3 ms"),
    ]
    print_table("Orchestration: a fresh process a run, each run flushed to disk", rows)


if __name__ == "__main__":
    main()
