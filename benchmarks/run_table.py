"""What a run table of a million rows (2 factors, 2 measures) costs, beside a bare list of dicts."""

from __future__ import annotations

import csv
import gc
import multiprocessing
import random
import tempfile
import time
import tracemalloc
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any

from benchmarks.table import Row, print_table
from robot_runner.core.design.factor import Factor
from robot_runner.core.design.run_table_model import RunTableModel
from robot_runner.core.storage.cells import RunStatus
from robot_runner.core.storage.run_table_reading import read_run_table
from robot_runner.core.storage.run_table_rows import RunTableRows, write_run_table
from robot_runner.core.storage.table_columns import TableLayout

if TYPE_CHECKING:
    from collections.abc import Callable

    from robot_runner.core.design.run_table_model import RunTable

_SIDE = 1000  # treatments of each of the two factors
_TIMES = 3
_RECORDED = 20_000


def plan(*, shuffle: bool) -> tuple[RunTable, TableLayout]:
    """Plan a million runs."""
    factors = [Factor("Load", range(_SIDE)), Factor("Task", [f"task {number}" for number in range(_SIDE)])]
    model = RunTableModel(factors, data_columns=["CPU", "Energy"], shuffle=shuffle)
    return model.plan(), TableLayout.of_model(model, ["CPU", "Energy"])


def make(*, shuffle: bool = False) -> RunTableRows:
    """Make the run table as it is before the first run."""
    return RunTableRows.of_plan(*plan(shuffle=shuffle))


def make_bare() -> list[dict[str, Any]]:
    """Make the same as a list of dicts, which knows nothing of types, seeds or time stamps."""
    tasks = [f"task {number}" for number in range(_SIDE)]
    pairs = ((load, task) for load in range(_SIDE) for task in tasks)
    return [
        {"run_id": f"r_{number}", "status": "-", "Load": load, "Task": task, "CPU": None, "Energy": None}
        for number, (load, task) in enumerate(pairs, start=1)
    ]


def made(make_table: Callable[[], object]) -> float:
    """Return how long it takes, in seconds."""
    begun = time.perf_counter()
    table = make_table()
    seconds = time.perf_counter() - begun
    del table
    return seconds


def made_randomised() -> float:
    """Return how long it takes with the order randomised, in seconds."""
    return made(lambda: make(shuffle=True))


def bytes_per_row(make_table: Callable[[], object]) -> float:
    """Return the memory that the table holds."""
    tracemalloc.start()
    table = make_table()
    gc.collect()
    held, _ = tracemalloc.get_traced_memory()
    del table
    return held / _SIDE**2


def written_and_read(*, has_stamps: bool = False) -> tuple[float, float]:
    """Return how long it takes to write a table with all its measures, and to read it back with types, in seconds.

    Args:
        has_stamps: whether all eight time stamps are filled as well.
    """
    table, layout = plan(shuffle=False)
    rows = RunTableRows.of_plan(table, layout)
    draw = random.Random(1).random
    for number in range(1, len(rows) + 1):
        hour, minute, second = number // 3600 % 24, number // 60 % 60, number % 60
        stamp = f"2026-01-31T{hour:02}:{minute:02}:{second:02}.250Z"
        stamps = dict.fromkeys(layout.stamps, stamp) if has_stamps else None
        measures = {"CPU": draw() * 100, "Energy": draw() * 900}
        rows.record(f"r_{number}", status=RunStatus.DONE, stamps=stamps, measures=measures)
    with _scratch() as folder:
        path = Path(folder) / "run_table.csv"
        begun = time.perf_counter()
        write_run_table(path, rows)
        written = time.perf_counter()
        found = read_run_table(path, layout)
        read = time.perf_counter()
    last = len(rows) - 1
    if found.row(last) != rows.row(last) or len(found) != len(rows):
        raise SystemExit("What was read is not what was written.")
    return written - begun, read - written


def written_and_read_bare() -> tuple[float, float]:
    """Return how long `csv.DictWriter` and `csv.DictReader` take for the same rows; types are lost."""
    table = make_bare()
    draw = random.Random(1).random
    for row in table:
        row |= {"status": "Done", "CPU": draw() * 100, "Energy": draw() * 900}
    with _scratch() as folder:
        path = Path(folder) / "run_table.csv"
        begun = time.perf_counter()
        with path.open("w", encoding="utf-8", newline="") as file:
            writer = csv.DictWriter(file, table[0])
            writer.writeheader()
            writer.writerows(table)
        written = time.perf_counter()
        with path.open(encoding="utf-8", newline="") as file:
            found = list(csv.DictReader(file))
        read = time.perf_counter()
    del found
    return written - begun, read - written


def written_and_read_with_stamps() -> tuple[float, float]:
    """Return the same with all eight time stamps filled."""
    return written_and_read(has_stamps=True)


def recorded(size: int) -> float:
    """Return how long it takes to record a run in a table of this many rows, in seconds."""
    model = RunTableModel([Factor("N", range(size))])
    rows = RunTableRows.of_plan(model.plan(), TableLayout.of_model(model, ["Energy"]))
    begun = time.perf_counter()
    for number in range(_RECORDED):
        rows.record(f"r_{number * 7919 % size + 1}", status=RunStatus.DONE, measures={"Energy": 877.5})
    return (time.perf_counter() - begun) / _RECORDED


def main() -> None:
    """Print the figures; each is taken in a fresh process, ours and the bare list's in turn."""
    pairs = [(_fresh(made, make), _fresh(made, make_bare), _fresh(made_randomised)) for _ in range(_TIMES)]
    ours, bare, randomised = (min(times) for times in zip(*pairs, strict=True))
    held, held_bare = _fresh(bytes_per_row, make), _fresh(bytes_per_row, make_bare)
    files = [(_fresh(written_and_read), _fresh(written_and_read_bare)) for _ in range(_TIMES)]
    written, read = (min(times) for times in zip(*(own for own, _ in files), strict=True))
    written_full, read_full = _fresh(written_and_read_with_stamps)
    few, many = (min(_fresh(recorded, size) for _ in range(_TIMES)) for size in (100, _SIDE**2))
    written_bare, read_bare = (min(times) for times in zip(*(other for _, other in files), strict=True))
    print_table(
        f"Run table of {_SIDE**2:,} rows, 2 factors, 2 measures, beside a bare list of dicts (best of {_TIMES})",
        [
            _row("made, order as written", ours, bare, "1.3 s"),
            _row("made, order randomised", randomised, bare, "1.3 s"),
            Row("memory", f"{held:.0f} bytes a row", f"{held_bare:.0f} bytes a row", f"{held / held_bare:.2f}", "410"),
            _row("written, flushed to disk", written, written_bare, "4 s"),
            _row("read back, with types", read, read_bare, "4 s"),
            _row("written, all time stamps filled", written_full, written_bare, ""),
            _row("read back, all time stamps filled", read_full, read_bare, ""),
            Row("a run recorded", f"{many * 1e6:.1f} us", f"{few * 1e6:.1f} us (100 rows)", f"{many / few:.2f}"),
        ],
    )


def _row(figure: str, seconds: float, bare: float, bound: str) -> Row:
    return Row(figure, f"{seconds:.2f} s", f"{bare:.2f} s", f"{seconds / bare:.2f}", bound)


def _scratch() -> tempfile.TemporaryDirectory[str]:
    # On the disk of the working directory: the system's temporary folder may be in memory.
    return tempfile.TemporaryDirectory(dir=Path.cwd(), prefix=".benchmark-")


def _fresh(function: Callable[..., Any], *arguments: Any) -> Any:
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as process:
        return process.submit(function, *arguments).result()


if __name__ == "__main__":
    main()
