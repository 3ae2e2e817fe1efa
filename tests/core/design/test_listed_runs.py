"""Runs that are listed one by one are planned as they are listed."""

from __future__ import annotations

import pytest

from robot_runner.core.design.factor import Factor
from robot_runner.core.design.listed_runs import ListedRun, ListedRunTableModel
from robot_runner.core.errors import DesignError

TASK = Factor("Task", ["Video", "Network"])


def test_listed_runs_are_numbered_from_1_as_all_others() -> None:
    runs = [ListedRun(f"run_{at}", {"Task": task}) for at, task in enumerate(["Network", "Video", "Network"])]
    plan = ListedRunTableModel([TASK], runs).plan()
    assert [(run.run_id, run.number) for run in plan] == [("run_0", 1), ("run_1", 2), ("run_2", 3)]
    assert plan[-1].number == 3


def test_listed_runs_keep_their_treatments_and_repetitions() -> None:
    listed = [("b", "Network", 1), ("a", "Video", 1), ("c", "Network", 2)]
    runs = [ListedRun(run_id, {"Task": task}, repetition) for run_id, task, repetition in listed]
    plan = ListedRunTableModel([TASK], runs).plan(seed=7)
    assert [(run.run_id, run.combination["Task"], run.repetition) for run in plan] == listed
    assert all(run.combination["Task"] in TASK.treatments for run in plan)


def test_its_runs_are_never_too_many_to_be_planned() -> None:
    factors = [Factor(f"F{number}", ["off", "on"]) for number in range(200)]
    model = ListedRunTableModel(factors, [ListedRun("one", {factor.name: "on" for factor in factors})])
    assert not model.is_too_large
    assert [run.run_id for run in model.plan()] == ["one"]


def test_ids_that_two_runs_share_but_for_case_or_that_name_no_folder_are_refused_at_once():
    listed = [ListedRun(run_id, {"Task": "Video"}) for run_id in ("a", "A", "b", "c", "../c")]
    with pytest.raises(DesignError) as refused:
        ListedRunTableModel([TASK], listed)
    problems = [finding.problem for finding in refused.value.findings]
    assert problems == ["2 runs have the id 'a'", "a run cannot have the id '../c'"]
