"""Which treatments lose more runs, or values, is said: the mean of what is left may look better than all would."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest
from tests.analysis.experiment_folders import Folder

from robot_runner.analysis import analyse, compare, load_results, meta_analyse
from robot_runner.analysis.report.material import Material
from robot_runner.analysis.report.threats_section import threats_of
from robot_runner.core.storage.journal import Journal

if TYPE_CHECKING:
    from pathlib import Path

    from robot_runner.analysis.statistics.outcome import ExperimentStatistics

TIMEOUT = 60
#: Planner B is the slower one, and its slow runs are those that are broken off.
DURATIONS = {"A": [20, 30, 40, 50, 55, 65], "B": [20, 30, 62, 70, 80, 90]}
PLACES = [(planner, seconds) for planner, several in DURATIONS.items() for seconds in several]


def threats(root: Path) -> tuple[ExperimentStatistics, dict[str, str]]:
    results = load_results(root)
    statistics = analyse(results)
    return statistics, {each.title: each.text for each in threats_of(Material(results, statistics))}


def folder(root: Path, *, is_failed: bool) -> Path:
    rows = [(planner, seconds if seconds <= TIMEOUT else None) for planner, seconds in PLACES]
    late = {place: "Failed" for place, (_, seconds) in enumerate(PLACES) if seconds > TIMEOUT}
    factors, statuses = {"Planner": list(DURATIONS)}, late if is_failed else {}
    return Folder(root / "timeouts", factors, rows, {"Duration": "s"}, statuses=statuses).write()


@pytest.mark.parametrize(
    ("is_failed", "title"), [(True, "Runs failed"), (False, "Duration has missing values")], ids=["failed", "missing"]
)
def test_treatments_that_lose_more_runs_are_named(tmp_path: Path, is_failed: bool, title: str) -> None:
    statistics, told = threats(folder(tmp_path, is_failed=is_failed))
    means = {each.label: each.mean for each in statistics.measure("Duration").by_treatment}
    assert means == {"A": pytest.approx(39.0), "B": pytest.approx(25.0)}  # it looks faster
    assert " By Planner: B 4 of 6 runs, A 1 of 6 runs. Means are of the others" in told[title]
    assert [each for each in statistics.warnings if "By Planner: B 4 of 6 runs" in each]


def test_comparisons_with_other_experiments_say_how_many_runs_failed(tmp_path: Path) -> None:
    one = folder(tmp_path / "one", is_failed=True)
    rows = [(planner, seconds + 0.5) for planner, seconds in PLACES]
    other = Folder(tmp_path / "all", {"Planner": list(DURATIONS)}, rows, {"Duration": "s"}, day="2026-02-01").write()
    [note] = [each for each in compare(one, other).notes if "failed" in each]
    assert note.startswith("Of timeouts, 5 of 12 runs failed: means are of the others")
    assert [each for each in meta_analyse(one, other).findings if "5 of 12 runs failed" in each.problem]


def test_attempts_that_were_repeated_until_they_succeeded_are_counted_by_treatment(tmp_path: Path) -> None:
    rows = [(planner, min(seconds, 50 + place) * 1.0) for place, (planner, seconds) in enumerate(PLACES)]
    made = Folder(tmp_path / "again", {"Planner": list(DURATIONS)}, rows, {"Duration": "s"})
    made.write()
    with Journal(made.files.journal) as journal:
        for place in (7, 8, 9, 10):  # of each, one attempt ran into the timeout
            for attempt, status in ((2, "failed"), (3, "done")):
                which: dict[str, Any] = {"run": made.run_id(place), "attempt": attempt}
                ended: dict[str, Any] = {
                    "status": status,
                    "seconds": 60.0,
                    "stamps": {},
                    "measures": {},
                    "failure": None,
                }
                journal.append("attempt_started", **which)
                journal.append("attempt_finished", **which, is_last=status == "done", **ended)
    statistics, told = threats(made.root)
    assert (
        " By Planner: B 4 of 6 runs, A 0 of 6 runs. Means are of the attempts that"
        in (told["Runs took more than one attempt"])
    )
    assert [each for each in statistics.warnings if each.startswith("Runs were repeated after attempts that failed.")]


def test_nothing_is_said_where_as_many_runs_failed_with_each_treatment(tmp_path: Path) -> None:
    rows = [(planner, float(place)) for place, planner in enumerate("AABBAABB")]
    statuses = {0: "Failed", 2: "Failed"}
    root = Folder(tmp_path / "even", {"Planner": ["A", "B"]}, rows, {"Duration": "s"}, statuses=statuses).write()
    assert "By Planner" not in threats(root)[1]["Runs failed"]


def test_a_value_that_many_runs_share_at_the_end_of_the_range_may_be_a_timeout(tmp_path: Path) -> None:
    rows = [(planner, min(seconds + place / 10, TIMEOUT)) for place, (planner, seconds) in enumerate(PLACES)]
    root = Folder(tmp_path / "limit", {"Planner": list(DURATIONS)}, rows, {"Duration": "s"}).write()
    statistics, told = threats(root)
    assert told["Duration may have a limit"].startswith(
        "5 of 12 runs have the largest value, 60.00 s. By Planner: B 4 of 6 runs, A 1 of 6 runs. Where that is a limit"
    )
    assert [each for each in statistics.warnings if each.startswith("Duration may have a limit")]


def test_of_values_at_a_limit_those_runs_are_counted_that_have_a_value(tmp_path: Path) -> None:
    rows = [(planner, min(seconds + place / 10, TIMEOUT)) for place, (planner, seconds) in enumerate(PLACES)]
    without: list[tuple[str, float | None]] = [
        ("B", None),
        ("C", None),
    ]  # the time to detect where no fault was injected
    root = Folder(tmp_path / "limit", {"Planner": [*DURATIONS, "C"]}, [*rows, *without], {"Duration": "s"}).write()
    assert threats(root)[1]["Duration may have a limit"].startswith(
        "5 of 12 runs have the largest value, 60.00 s. By Planner: B 4 of 6 runs, A 1 of 6 runs. Where that is a limit"
    )


def test_measured_durations_that_hardly_differ_at_the_end_of_the_range_may_be_a_timeout(tmp_path: Path) -> None:
    late = {place: TIMEOUT + place / 1000 for place, (_, seconds) in enumerate(PLACES) if seconds > TIMEOUT}
    rows = [(planner, late.get(place, seconds + place / 10)) for place, (planner, seconds) in enumerate(PLACES)]
    root = Folder(tmp_path / "limit", {"Planner": list(DURATIONS)}, rows, {"Duration": "s"}).write()
    statistics, told = threats(root)
    assert told["Duration may have a limit"].startswith(
        "5 of 12 runs have nearly the largest value, 60.01 s. By Planner: B 4 of 6 runs, A 1 of 6 runs. Where that is a"
    )
    assert [each for each in statistics.warnings if each.startswith("Duration may have a limit")]


@pytest.mark.parametrize(
    ("unit", "values"),
    [
        ("s", [30 + place % 7 / 100 for place in range(6)] + [60 + place % 5 / 100 for place in range(6)]),
        ("m", [5.0, 15.5, 21.0, 33.0, 39.5, 44.0, 51.0, 60.001, 60.002, 60.003]),
        ("s", [5.0, 15.5, 21.0, 33.0, 39.5, 44.0, 51.0, 58.0, 60.002, 60.003]),
    ],
    ids=["as close elsewhere", "no time", "two runs"],
)
def test_values_that_hardly_differ_are_no_limit_otherwise(tmp_path: Path, unit: str, values: list[float]) -> None:
    rows = [("AB"[place % 2], value) for place, value in enumerate(values)]
    root = Folder(tmp_path / "none", {"Planner": ["A", "B"]}, rows, {"Duration": unit}).write()
    assert not [title for title in threats(root)[1] if "limit" in title]


@pytest.mark.parametrize("name", ["Success", "Reach.Success"])
def test_missions_that_did_not_succeed_are_counted_by_treatment(tmp_path: Path, name: str) -> None:
    rows = [(planner, min(seconds, TIMEOUT), str(seconds <= TIMEOUT)) for planner, seconds in PLACES]
    measures, factors = {"Duration": "s", name: ""}, {"Planner": list(DURATIONS)}
    root = Folder(tmp_path / "success", factors, rows, measures, types={name: "boolean"}).write()
    statistics, told = threats(root)
    assert told["Missions did not succeed"].startswith(
        f"{name} is no in 5 of 12 runs. By Planner: B 4 of 6 runs, A 1 of 6 runs. Their durations, energies and"
    )
    assert [each for each in statistics.warnings if each.startswith("Missions did not succeed: ")]


def test_missions_that_did_not_succeed_are_counted_where_success_has_no_column(tmp_path: Path) -> None:
    rows = [(planner, min(seconds, TIMEOUT)) for planner, seconds in PLACES]
    folder = Folder(tmp_path / "success", {"Planner": list(DURATIONS)}, rows, {"Duration": "s"})
    folder.write()
    ended: dict[str, Any] = {"attempt": 1, "is_last": True, "status": "done", "seconds": 3.0, "stamps": {}}
    with Journal(folder.files.journal) as journal:
        for place, (_, seconds) in enumerate(PLACES):
            success = {"value": seconds <= TIMEOUT, "owner": "Reach", "origin": "measured"}
            run = folder.run_id(place)
            journal.append("attempt_finished", run=run, **ended, measures={"Success": success}, failure=None)
    assert threats(folder.root)[1]["Missions did not succeed"].startswith(
        "Success is no in 5 of 12 runs. By Planner: B 4 of 6 runs, A 1 of 6 runs. Their durations, energies and"
    )


@pytest.mark.parametrize("measures", [{"Duration": "s", "Success": ""}, {"Success": ""}], ids=["all", "nothing else"])
def test_missions_that_all_succeeded_or_of_which_nothing_else_is_known_are_no_threat(
    tmp_path: Path, measures: dict[str, str]
) -> None:
    rows = [(planner, *[seconds][: len(measures) - 1], str(len(measures) == 2)) for planner, seconds in PLACES]
    factors = {"Planner": list(DURATIONS)}
    root = Folder(tmp_path / "success", factors, rows, measures, types={"Success": "boolean"}).write()
    assert "Missions did not succeed" not in threats(root)[1]


@pytest.mark.parametrize("values", [[1, 2, 3, 3, 2, 3] * 2, [0.0] * 5 + [1.5, 2.5, 3.5], [1.5, 2.5, 3.5, 4.5]])
def test_counts_zeros_and_values_of_their_own_have_no_limit(tmp_path: Path, values: list[float]) -> None:
    rows = [("AB"[place % 2], value) for place, value in enumerate(values)]
    root = Folder(tmp_path / "none", {"Planner": ["A", "B"]}, rows, {"Duration": "s"}).write()
    assert not [title for title in threats(root)[1] if "limit" in title]


REPEATED = "Repetitions have the same values"


def test_runs_that_are_one_execution_again_are_told_as_their_p_values_are_too_small(tmp_path: Path) -> None:
    scenes = {"A": [0.71828182845, 0.14159265358, 0.41421356237], "B": [0.61803398874, 0.73205080756, 0.23606797749]}
    rows = [(policy, values[place % 3]) for place in range(12) for policy, values in scenes.items()]
    root = Folder(tmp_path / "again", {"Policy": ["A", "B"]}, rows, {"Return": "1"}).write()
    statistics, told = threats(root)
    assert told[REPEATED].startswith(
        "18 of 24 runs have, to the last digit, the Return of an earlier run of their combination. Where"
    )
    assert [each for each in statistics.warnings if each.startswith(REPEATED)]


@pytest.mark.parametrize(
    "values",
    [
        [0.71828182845, 0.14159265358, 0.41421356237, 0.61803398874, 0.73205080756, 0.23606797749],  # no two are equal
        [12.31, 12.32, 12.31, 12.31, 12.32, 12.32],  # a coarse sensor
        [10 / 3, 11 / 3, 10 / 3, 10 / 3, 11 / 3, 11 / 3],  # means of few answers
        [2.707692308, 4.644444444, 2.707692308, 2.707692308, 4.644444444, 4.644444444],  # durations on the simulator
        [3.9000000000000004, 3.9, 3.9000000000000004, 3.9000000000000004, 4.1, 4.1],  # times in steps
    ],
)
def test_values_that_come_twice_by_chance_are_no_repeated_execution(tmp_path: Path, values: list[float]) -> None:
    rows = [("A", value) for value in values] + [("B", value + 1) for value in values]
    root = Folder(tmp_path / "chance", {"Policy": ["A", "B"]}, rows, {"Return": "1"}).write()
    assert REPEATED not in threats(root)[1]
