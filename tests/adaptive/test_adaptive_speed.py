"""The example finds the most economical speed of the simulated robot in a quarter of a scan's runs, killed twice."""

from __future__ import annotations

import csv
import os
import signal
import subprocess
import time
from pathlib import Path
from random import Random

import pytest
from tests.command_line import PROGRAM

from robot_runner.core.config.preparation import prepare_or_refuse
from robot_runner.core.execution.notices import SilentObserver
from robot_runner.core.execution.orchestrator import execute_experiment
from robot_runner.core.storage.journal import read_journal
from robot_runner.core.storage.layout import ExperimentFolder

EXAMPLE = Path(__file__).parents[2] / "examples" / "designs" / "adaptive_speed.py"
#: The least that is found may be so much above the least of the scan.
MARGIN = 1.03
_PATIENCE_S = 240.0


def written(folder: Path, name: str, *changes: tuple[str, str]) -> Path:
    """Return the example with another name in a folder of the test's own, changed."""
    named = f'"{name}"\n    results_output_path = {str(folder)!r}'
    text = EXAMPLE.read_text(encoding="utf-8").replace('"adaptive_speed"', named)
    for before, now in changes:
        assert before in text
        text = text.replace(before, now)
    path = folder / f"{name}.py"
    path.write_text(text, encoding="utf-8")
    return path


def files_of(config: Path) -> ExperimentFolder:
    return ExperimentFolder(config.parent / config.stem)


def executed(config: Path) -> list[dict[str, str]]:
    """Execute what is left of an experiment, and return the rows of its run table."""
    finished = execute_experiment(prepare_or_refuse(config), SilentObserver())
    assert (finished.failures, finished.todo_count) == ((), 0)
    with files_of(config).run_table.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def kill_after(config: Path, runs: int, moment: float) -> None:
    """Execute an experiment, and kill the orchestrator some time after so many further runs have ended."""
    already = ended(config)
    with subprocess.Popen([str(PROGRAM), str(config)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        deadline = time.monotonic() + _PATIENCE_S
        while ended(config) < already + runs:
            assert process.poll() is None, "it ended before it was killed"
            assert time.monotonic() < deadline
            time.sleep(0.05)
        time.sleep(moment)
        os.kill(process.pid, signal.SIGKILL)
        assert process.wait() == -signal.SIGKILL


def ended(config: Path) -> int:
    journal = files_of(config).journal
    return sum(1 for _ in read_journal(journal, kinds={"attempt_finished"})) if journal.exists() else 0


def economy(rows: list[dict[str, str]]) -> dict[str, float]:
    """Return the mean energy per metre of each speed."""
    found: dict[str, list[float]] = {}
    for row in rows:
        found.setdefault(row["Speed"], []).append(float(row["EnergyPerMetre"]))
    return {speed: sum(values) / len(values) for speed, values in found.items()}


def search_and_scan(folder: Path, step: float, kills: tuple[int, int], seed: int) -> tuple[int, int]:
    """Search with two kills and scan, compare what both found, and return how many runs each had."""
    count = round(0.2 / step) + 1
    of_range, turns = ("step=0.005", f"step={step}"), ("rotate_s=15", "rotate_s=3")  # where it turns to is all the same
    search = written(
        folder,
        "search",
        of_range,
        ("runs = 10", f"runs = {count // 4}\n    start = {count // 8}"),
        ("runs=self.runs", f"runs=self.runs, start=self.start, seed={seed}"),
        ("confirm = 5", "confirm = 2"),
        turns,
    )
    text = EXAMPLE.read_text(encoding="utf-8")
    design = text[text.index("            design=Optimise(") : text.index("        )\n\n    def populate_run_data")]
    speeds = f"[round(0.02 + {step} * number, 4) for number in range({count})]"
    scan = written(folder, "scan", turns, (design, ""), ('Range(0.02, 0.22, step=0.005, unit="m/s")', speeds))
    draw = Random(seed)  # noqa: S311 - reproducible, not secret
    for runs in kills:
        kill_after(search, runs, draw.uniform(0.0, 1.0))
    rows = executed(search)
    searched = [row for row in rows if row["batch"] == "1"]
    assert all(row["status"] == "Done" for row in rows)
    assert len({row["Speed"] for row in searched}) == len(searched), "no speed is tried twice"
    decided = [record["name"] for record in read_journal(files_of(search).journal, kinds={"decided"})]
    assert len(decided) == len(set(decided)), "nothing is decided twice"
    scanned = economy(executed(scan))
    found = economy(searched)
    best = min(found, key=lambda speed: found[speed])
    assert scanned[best] <= MARGIN * min(scanned.values())
    assert {row["Speed"] for row in rows if row["batch"] == "2"} == {"0.02", best}
    return len(searched), len(scanned)


@pytest.mark.long
def test_a_quarter_of_a_scans_runs_finds_the_most_economical_speed_though_killed_twice(tmp_path: Path) -> None:
    searched, scanned = search_and_scan(tmp_path, step=0.0125, kills=(2, 1), seed=1)
    assert 4 * searched <= scanned
    assert scanned == 17


@pytest.mark.soak
@pytest.mark.parametrize("seed", range(5))
def test_the_whole_example_does_so_from_any_seed(tmp_path: Path, seed: int) -> None:
    draw = Random(1000 + seed)  # noqa: S311 - reproducible, not secret
    kills = (draw.randint(1, 4), draw.randint(1, 4))
    assert search_and_scan(tmp_path, step=0.005, kills=kills, seed=seed) == (10, 41)
