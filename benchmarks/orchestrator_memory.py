"""How much memory the orchestrator of a large experiment has when its first run begins, and after many runs."""

from __future__ import annotations

import os
import signal
import sys
from pathlib import Path

from benchmarks.orchestration import scratch
from benchmarks.resuming import CONFIG
from benchmarks.table import Row, print_table
from robot_runner.core.config.preparation import prepare_or_refuse
from robot_runner.core.execution.notices import AttemptStarted, Notice, SilentObserver
from robot_runner.core.execution.orchestrator import execute_experiment

ROWS, RUNS = 1_000_000, 100_000
MOST = 1.2
_MEGABYTE = 1e6


class Watching(SilentObserver):
    """Remembers the memory when the first run begins, and ends the experiment after so many runs."""

    def __init__(self, runs: int) -> None:
        self.begun = 0
        self.at_start = self.at_end = 0.0
        self._runs = runs

    def notice(self, notice: Notice) -> None:
        """Count the attempts."""
        if not isinstance(notice, AttemptStarted):
            return
        self.begun += 1
        if self.begun == 1:
            self.at_start = resident_megabytes()
        elif self.begun == self._runs + 1:
            self.at_end = resident_megabytes()
            os.kill(os.getpid(), signal.SIGINT)


def resident_megabytes() -> float:
    """Return how much memory this process has that is in use."""
    pages = int(Path("/proc/self/statm").read_text(encoding="utf-8").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / _MEGABYTE


def main(rows: int = ROWS, runs: int = RUNS) -> int:
    """Print both and their ratio; return 1 where it is above the house's."""
    with scratch() as folder:
        config = folder / "config.py"
        config.write_text(CONFIG.format(folder=str(folder), rows=rows), encoding="utf-8")
        watching = Watching(runs)
        execute_experiment(prepare_or_refuse(config), watching)
    ratio = watching.at_end / watching.at_start
    end, start = (f"{megabytes:.0f} MB" for megabytes in (watching.at_end, watching.at_start))
    after = Row(f"after {runs:,} runs", end, start, f"{ratio:.2f}", f"{MOST} x")
    print_table(f"Memory of the orchestrator of {rows:,} rows, beside that when its first run begins", [after])
    return 0 if ratio <= MOST else 1


if __name__ == "__main__":
    sys.exit(main(*map(int, sys.argv[1:])))
