"""How long `robot-runner --help` takes beside the start of the interpreter itself."""

from __future__ import annotations

import statistics
import subprocess
import sys
import time
from pathlib import Path

from benchmarks.table import Row, print_table

_HELP = [str(Path(sys.executable).with_name("robot-runner")), "--help"]
_INTERPRETER = [sys.executable, "-c", "pass"]
_TIMES = 20
_BOUND = 3


def main() -> None:
    """Time both in turn, so that a busy moment of the machine meets the two alike."""
    _seconds(_HELP)  # fills the disk cache, and writes the byte code after an installation
    pairs = [(_seconds(_HELP), _seconds(_INTERPRETER)) for _ in range(_TIMES)]
    help_time, floor = (statistics.median(times) * 1000 for times in zip(*pairs, strict=True))
    row = Row(
        f"robot-runner --help, median of {_TIMES}",
        f"{help_time:.0f} ms",
        f"{floor:.0f} ms (interpreter's own start)",
        f"{help_time / floor:.1f}",
        str(_BOUND),
    )
    print_table("Start of the command line", [row])


def _seconds(command: list[str]) -> float:
    begun = time.perf_counter()
    subprocess.run(command, stdout=subprocess.DEVNULL, timeout=60, check=True)
    return time.perf_counter() - begun
