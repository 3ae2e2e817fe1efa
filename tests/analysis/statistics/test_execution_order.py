"""The order of execution is what the journal knows, where time stamps cannot tell it."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import pytest
from tests.analysis.made_experiment import make_experiment

from robot_runner.analysis import analyse, load_results
from robot_runner.analysis.recomputing.fact_finding import facts_of_study
from robot_runner.analysis.statistics.execution_order import execution_order

if TYPE_CHECKING:
    from pathlib import Path

    from robot_runner.analysis.statistics.outcome import MeasureStatistics
    from robot_runner.core.storage.layout import ExperimentFolder

RUNS = 20
PLAN: dict[str, object] = {"measures": ["Energy"], "covariates": ["elapsed"]}


def set_back(folder: ExperimentFolder) -> None:
    """Set the clock back by an hour before the second half of the runs."""
    for path in (folder.journal, folder.run_table):
        lines = path.read_text(encoding="utf-8").splitlines()
        later = [line.replace("T12:", "T11:") if _is_late(line) else line for line in lines]
        path.write_text("".join(f"{line}\n" for line in later), encoding="utf-8")


def _is_late(line: str) -> bool:
    found = re.search(r'(?:"run": ?"|^)r_(\d+)', line)
    return found is not None and int(found[1]) > RUNS // 2


def made(root: Path, plan: dict[str, object] | None = None) -> ExperimentFolder:
    """Return an experiment whose energy rises from run to run, and whose clock was set back half-way."""
    values = iter(float(place) for place in range(RUNS))
    folder = make_experiment(
        root / "made", values=lambda *_: {"Energy": next(values)}, repetitions=RUNS // 2, analysis=plan
    )
    set_back(folder)
    return folder


def test_a_drift_is_looked_for_over_the_order_of_the_journal_where_the_clock_was_set_back(tmp_path: Path) -> None:
    drift = analyse(load_results(made(tmp_path).root)).measure("Energy").drift
    assert drift is not None
    assert drift.correlation == pytest.approx(1.0, abs=0.01)
    assert drift.run_ids == tuple(f"r_{number}" for number in range(1, RUNS + 1))
    assert "order of execution" in drift.warning


@pytest.mark.parametrize("hour", ["T11:", "T13:"])
def test_the_order_of_the_journal_counts_where_a_machine_that_executed_runs_has_another_time(
    tmp_path: Path, hour: str
) -> None:
    values = iter(float(place) for place in range(RUNS))
    folder = make_experiment(
        tmp_path / "made", values=lambda *_: {"Energy": next(values)}, repetitions=RUNS // 2, analysis=PLAN
    )
    assert not [each for each in of_energy(folder).not_computed if "clock" in each.why]
    for path in (folder.journal, folder.run_table):  # the stamps of a run's own events, and not those of its attempt
        lines = path.read_text(encoding="utf-8").splitlines()
        told = [line.replace("T12:", hour) if re.search(r'"kind": ?"event"|^r_', line) else line for line in lines]
        both = [
            line if "before_run" in line or _is_late(line) else other for line, other in zip(lines, told, strict=True)
        ]
        path.write_text("".join(f"{line}\n" for line in both), encoding="utf-8")
    order = execution_order(load_results(folder.root))
    assert (list(order.places), order.has_times) == (list(range(1, RUNS + 1)), False)
    assert [each for each in of_energy(folder).not_computed if "clock" in each.why]


def test_the_order_of_the_journal_counts_where_runs_lack_time_stamps(tmp_path: Path) -> None:
    folder = made(tmp_path)
    text = folder.run_table.read_text(encoding="utf-8")
    folder.run_table.write_text(re.sub(r"(\br_3,Done.*?)2026[^,]*Z", r"\1", text), encoding="utf-8")
    drift = analyse(load_results(folder.root)).measure("Energy").drift
    assert drift is not None
    assert "order of execution" in drift.warning


def test_seconds_since_the_first_run_are_not_known_where_the_clock_was_set_back(tmp_path: Path) -> None:
    found = analyse(load_results(made(tmp_path, PLAN).root)).measure("Energy")
    assert [each for each in found.not_computed if "the clock was set" in each.why]


def test_seconds_since_the_first_run_are_not_known_where_the_clock_was_set_forward(tmp_path: Path) -> None:
    values = iter(float(place) for place in range(RUNS))
    folder = make_experiment(
        tmp_path / "made", values=lambda *_: {"Energy": next(values)}, repetitions=RUNS // 2, analysis=PLAN
    )
    assert not [each for each in of_energy(folder).not_computed if "the clock was set" in each.why]
    with folder.journal.open("a", encoding="utf-8") as file:  # its stamps alone show nothing odd
        file.write('{"kind":"clock_set","at":"2026-01-31T22:00:00.000Z","seconds":3600.0}\n')
    assert [each for each in of_energy(folder).not_computed if "the clock was set" in each.why]


def of_energy(folder: ExperimentFolder) -> MeasureStatistics:
    return analyse(load_results(folder.root)).measure("Energy")


def test_scripts_have_the_order_of_the_journal(tmp_path: Path) -> None:
    results = load_results(made(tmp_path).root)
    source = facts_of_study(results, results.folder).source
    assert (source.stamp, source.places) == ("", ())  # that of the table
