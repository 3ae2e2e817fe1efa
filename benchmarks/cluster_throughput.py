"""How many empty runs a second two workers of a local Dask cluster execute, against `--workers 2`; in turn.

What is timed is the span from the first run's beginning to the last one's end: starting the processes is left out.
"""

from __future__ import annotations

import json
import os
import socket
import statistics
import subprocess
import sys
import tempfile
from contextlib import ExitStack, contextmanager
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

from benchmarks.table import Row, print_table

if TYPE_CHECKING:
    from collections.abc import Iterator

ROUNDS = 3
RUNS = 10_000
LEAST = 0.7
_BIN = Path(sys.executable).parent

CONFIG = """
from robot_runner import ExperimentConfig, Factor, RunTableModel

class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "empty"
    claims = []

    def create_run_table(self):
        return RunTableModel([Factor("Run", range({runs}))])
"""


def main(runs: int = RUNS, rounds: int = ROUNDS) -> int:
    """Print both throughputs and their ratio; return 1 where it is below the house's."""
    with tempfile.TemporaryDirectory() as name, _cluster(Path(name)) as address:
        config = Path(name) / "config.py"
        config.write_text(CONFIG.format(runs=runs), encoding="utf-8")
        here, there = [], []
        for _ in range(rounds):
            here.append(runs / _seconds(config, "--workers", "2"))
            there.append(runs / _seconds(config, "--cluster", address))
    ratio = statistics.median(far / near for near, far in zip(here, there, strict=True))
    load = f"load {os.getloadavg()[0]:.1f}"
    print_table(
        f"{runs:,} empty runs by two workers ({load})",
        [
            Row("--workers 2", f"{statistics.median(here):.0f} runs/s"),
            Row(
                "a local Dask cluster of two workers",
                f"{statistics.median(there):.0f} runs/s",
                "",
                f"{ratio:.2f}",
                f">= {LEAST}",
            ),
        ],
    )
    return 0 if ratio >= LEAST else 1


def _seconds(config: Path, *words: str) -> float:
    """Execute the experiment in a folder of its own; return the time from the first run to the last, s."""
    with tempfile.TemporaryDirectory() as results:
        command = [str(_BIN / "robot-runner"), "run", str(config), "--plain", "--set", f"results_output_path={results}"]
        subprocess.run([*command, *words], check=True, stdout=subprocess.DEVNULL)
        with (Path(results) / "empty" / "journal.jsonl").open(encoding="utf-8") as journal:
            records = [json.loads(line) for line in journal]
    stamps = [record["at"] for record in records if record["kind"] in {"attempt_started", "attempt_finished"}]
    return (datetime.fromisoformat(max(stamps)) - datetime.fromisoformat(min(stamps))).total_seconds()


@contextmanager
def _cluster(folder: Path) -> Iterator[str]:
    """Start a scheduler and two workers on loopback, and yield the scheduler's address."""
    with socket.create_server(("127.0.0.1", 0)) as found:
        port = found.getsockname()[1]
    address = f"tcp://127.0.0.1:{port}"
    scheduler = ["scheduler", "--host", "127.0.0.1", "--port", str(port), "--dashboard-address", "127.0.0.1:0"]
    worker = ["worker", address, "--nthreads", "1", "--no-nanny", "--no-dashboard", "--local-directory", str(folder)]
    with ExitStack() as started:
        for words in (scheduler, worker, worker):
            process = subprocess.Popen(
                [str(_BIN / "dask"), *words], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
            )
            started.callback(process.wait)
            started.callback(process.terminate)
        yield address
