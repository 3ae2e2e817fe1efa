"""A measure that neither experiment has a value of decides nothing, unless the plan names it."""

from __future__ import annotations

from typing import Any

from robot_runner.core.storage.table_columns import ColumnDescription, ColumnRole
from robot_runner.replication.run_by_run import Sameness
from robot_runner.replication.verdicts import Conclusion, ReplicationVerdict, margins_of, reached_verdict


def verdict_of(
    same: dict[str, Sameness], comparison: dict[str, Any] | None = None, **manifest: Any
) -> ReplicationVerdict:
    columns = [ColumnDescription(name=name, role=ColumnRole.MEASURE) for name in same]
    return reached_verdict(columns, manifest, same, margins_of(dict.fromkeys(same, ""), manifest, []), comparison)


def test_a_measure_without_any_value_in_both_does_not_count() -> None:
    verdict = verdict_of({"Energy": Sameness(6, 6), "Never": Sameness(0, 0)})
    assert verdict.conclusion is Conclusion.IDENTICAL
    assert verdict.sentence == "The results are identical: every value of Energy of 6 runs, to the last digit."
    assert verdict.measures[1].secondary_because == "neither experiment has a value of it"


def test_a_measure_whose_values_are_still_lacking_counts() -> None:
    verdict = verdict_of({"Energy": Sameness(6, 6), "Rare": Sameness(0, 0, lacking=1)})
    assert verdict.conclusion is Conclusion.UNDECIDED


def test_a_measure_without_values_counts_where_the_plan_names_it_or_nothing_else_is_there() -> None:
    same = {"Energy": Sameness(6, 6), "Never": Sameness(0, 0)}
    assert verdict_of(same, analysis={"measures": ["Energy", "Never"]}).conclusion is Conclusion.UNDECIDED
    assert verdict_of({"Never": Sameness(0, 0)}).conclusion is Conclusion.UNDECIDED


def test_numbers_that_only_the_replication_has_are_not_called_texts() -> None:
    differences = [{"first_mean": None, "second_mean": 3.5}, {"first_mean": None, "second_mean": None}]
    verdict = verdict_of({"Rare": Sameness(1, 0)}, {"measures": [{"first_name": "Rare", "differences": differences}]})
    assert verdict.measures[0].sentence == (
        "Rare could not be decided: it differs in 1 of 1 run, and the original has no number of it."
    )
