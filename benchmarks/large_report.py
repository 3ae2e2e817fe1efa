"""What the report of an experiment of 10,000 runs costs in memory and time, beside loading its table with pandas."""

from __future__ import annotations

import csv
import json
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import psutil  # type: ignore[import-untyped]

from benchmarks.table import Row, print_table

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

_PROGRAM = str(Path(sys.executable).with_name("robot-runner"))
_RUNS = 10_000
#: Samples of power: the demo has as many in its 15 runs, so that the two reports differ in the number of runs alone.
_SAMPLES = 285_000
_BYTES_BOUND = 700e6
_DEADLINE = 900.0  # s a report
_EVERY = 0.02  # s between two looks at the memory
_LOADING = "import sys, pandas; pandas.read_csv(sys.argv[1])"
_RUN = re.compile(r'"run":"r_\d+"')


class Cost(NamedTuple):
    """What a command took.

    Attributes:
        seconds: real time.
        peak: the largest sum of resident memory of the process and those that it started, bytes.
    """

    seconds: float
    peak: int


def make_experiment(demo: Path, root: Path, *, runs: int = _RUNS, samples: int = _SAMPLES) -> None:
    """Make an experiment of many runs from those of the demo, each with its records in the journal and its samples."""
    shutil.copytree(demo, root, ignore=shutil.ignore_patterns("runs", "report", "journal.jsonl"))
    with (demo / "run_table.csv").open(encoding="utf-8", newline="") as file:
        table = list(csv.DictReader(file))
    repetitions = [str(number) for number in range(1, -(-runs // len(table)) * 5 + 1)]
    _write_table(root / "run_table.csv", table, runs)
    manifest = json.loads((demo / "manifest.json").read_text(encoding="utf-8"))
    manifest["design"]["factors"]["Repetition"] = repetitions
    (root / "manifest.json").write_text(json.dumps(manifest), encoding="utf-8")
    _write_journal(demo / "journal.jsonl", root / "journal.jsonl", [row["run_id"] for row in table], runs)
    _write_runs(demo / "runs", root / "runs", [row["run_id"] for row in table], runs, samples)


def _write_table(path: Path, table: Sequence[dict[str, str]], runs: int) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        rows = csv.DictWriter(file, list(table[0]))
        rows.writeheader()
        for place in range(runs):
            row = table[place % len(table)]
            repetition = int(row["Repetition"]) + 5 * (place // len(table))
            shift = (place * 0.6180339887 % 1 - 0.5) / 10  # so that no two runs are alike
            energy = float(row["Energy"]) + 40 * shift
            rows.writerow(row | {"run_id": f"r_{place + 1}", "Repetition": str(repetition), "Energy": f"{energy!r}"})


def _write_journal(source: Path, path: Path, run_ids: Sequence[str], runs: int) -> None:
    lines = source.read_text(encoding="utf-8").splitlines()
    parsed = [(line, json.loads(line)) for line in lines]
    of_run = {run_id: [line for line, record in parsed if record.get("run") == run_id] for run_id in run_ids}
    first = next(place for place, (_, record) in enumerate(parsed) if "run" in record)
    with path.open("w", encoding="utf-8") as file:
        file.writelines(f"{line}\n" for line in lines[:first])
        for place in range(runs):
            named = f'"run":"r_{place + 1}"'
            file.writelines(_RUN.sub(named, line) + "\n" for line in of_run[run_ids[place % len(run_ids)]])
        file.writelines(f"{line}\n" for line, record in parsed[first:] if "run" not in record)


def _write_runs(source: Path, target: Path, run_ids: Sequence[str], runs: int, samples: int) -> None:
    for place in range(runs):
        for path in sorted((source / run_ids[place % len(run_ids)]).glob("*/*")):
            copy = target / f"r_{place + 1}" / path.parent.name / path.name
            copy.parent.mkdir(parents=True, exist_ok=True)
            if path.name in {"samples.csv", "trajectory.csv"}:
                copy.write_text("".join(_thinned(path.read_text(encoding="utf-8"), samples // runs)), encoding="utf-8")
            else:
                shutil.copyfile(path, copy)


def _thinned(text: str, most: int) -> Iterator[str]:
    heading, *rows = text.splitlines(keepends=True)
    yield heading
    yield from rows[:: max(1, -(-len(rows) // most))]


def cost_of(command: Sequence[str]) -> Cost:
    """Execute a command and watch the memory of its process and of those that it starts.

    Raises:
        subprocess.CalledProcessError: it failed.
    """
    begun = time.perf_counter()
    process = psutil.Popen(list(command), stdout=subprocess.DEVNULL)
    peak = 0
    while process.poll() is None:
        peak = max(peak, _resident(process))
        if time.perf_counter() - begun > _DEADLINE:
            process.kill()
        time.sleep(_EVERY)
    if process.returncode:
        raise subprocess.CalledProcessError(process.returncode, list(command))
    return Cost(time.perf_counter() - begun, peak)


def _resident(process: psutil.Process) -> int:
    """Return the resident memory of a process and its children, bytes; shared pages count in each."""
    total = 0
    try:
        for each in (process, *process.children(recursive=True)):
            total += each.memory_info().rss
    except psutil.NoSuchProcess:
        pass  # it ended while it was looked at
    return total


def main() -> None:
    """Print the figures."""
    with tempfile.TemporaryDirectory() as scratch:
        subprocess.run([_PROGRAM, "demo", "--folder", scratch], stdout=subprocess.DEVNULL, timeout=300, check=True)
        demo, large = Path(scratch) / "basic_experiment", Path(scratch) / "large"
        make_experiment(demo, large)
        floor = cost_of([sys.executable, "-c", _LOADING, str(large / "run_table.csv")])
        rows = []
        for name, folder in (("15 runs", demo), (f"{_RUNS:,} runs", large)):
            for what, options in (("page, tables, figures", ()), ("JSON", ("--format", "json"))):
                cost = cost_of([_PROGRAM, "report", str(folder), *options])
                rows.append(
                    Row(
                        f"{name}, {_SAMPLES:,} samples: {what}",
                        f"{cost.peak / 1e6:.0f} MB, {cost.seconds:.0f} s",
                        f"{floor.peak / 1e6:.0f} MB (pandas.read_csv)",
                        f"{cost.peak / floor.peak:.1f}",
                        f"{_BYTES_BOUND / 1e6:.0f} MB",
                    )
                )
    print_table("Memory of a report, that of all its processes", rows)


if __name__ == "__main__":
    main()
