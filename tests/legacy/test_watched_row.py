"""The row of a run tells which of its treatments a callback has looked at, and is a dict for all else."""

from __future__ import annotations

import copy
import importlib
import json
import pickle
from typing import TYPE_CHECKING, Any

import pytest

from robot_runner.core.design.factor import Factor
from robot_runner.core.design.listed_runs import ListedRun, ListedRunTableModel
from robot_runner.core.design.watched_combination import WatchedCombination
from robot_runner.legacy.run_data import WatchedRow, unwatched
from robot_runner.legacy.run_tables import EarlierDesign

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

CELLS = {"__run_id": "run_0", "size": 10, "language": "c", "seconds": " "}


def as_keywords(**given: Any) -> dict[str, Any]:
    return given


def pandas() -> Any:
    """Import it in the test that needs it: other tests of this room fork their process many times."""
    return importlib.import_module("pandas")


@pytest.fixture
def read() -> list[str]:
    return []


@pytest.fixture
def row(read: list[str]) -> WatchedRow:
    combination = WatchedCombination({"size": 10, "language_": "c"}, read.append)
    return WatchedRow(CELLS, {"size": "size", "language": "language_"}, combination)


@pytest.mark.parametrize(
    "look",
    [
        dict,
        copy.copy,
        copy.deepcopy,
        json.dumps,
        str,
        lambda row: {**row},
        lambda row: {"more": 1} | row,
        lambda row: row | {"more": 1},
        lambda row: dict.fromkeys("x") | row,
        {}.update,
        lambda row: [row[name] for name in row],
        lambda row: list(row.values()),
        lambda row: (row.get("size"), row.pop("language")),
        "%(size)s %(language)s".__mod__,
        "{size} {language}".format_map,
        lambda row: as_keywords(**row),
        lambda row: pickle.loads(pickle.dumps(row)),  # noqa: S301 - its own
        lambda row: pandas().DataFrame([row]),
        lambda row: pandas().Series(row),
    ],
)
def test_whatever_takes_the_whole_row_has_read_each_treatment(
    row: WatchedRow, read: list[str], look: Callable[[WatchedRow], Any]
) -> None:
    taken = look(row)
    assert sorted(read) == ["language_", "size"]
    if isinstance(taken, dict):
        assert type(taken) is dict
        assert CELLS.items() <= taken.items() or len(taken) < len(CELLS)


def test_what_is_written_or_asked_for_by_its_name_reads_nothing_else(row: WatchedRow, read: list[str]) -> None:
    row["seconds"] = 1.5
    row.update(more=2)
    assert (row["__run_id"], "language" in row, len(row)) == ("run_0", True, 5)
    assert unwatched(row) == {**CELLS, "seconds": 1.5, "more": 2}
    assert read == []
    assert row["size"] == 10
    assert read == ["size"]


def test_a_factor_that_counts_runs_is_none_that_has_to_be_read(read: list[str]) -> None:
    names = ["run_number", "runs_per_variation", "nr_of_runs", "rep", "Iterations", "runtime", "report", "speed"]
    treatments = [range(1, 4), range(30), [1], ["r1", "r2"], ["0", "1"], *([[1, 2]] * 3)]
    assert counting(dict(zip(names, treatments, strict=True))) == tuple(names[:5])
    combination = WatchedCombination(dict.fromkeys(names, 1), read.append)
    WatchedRow(dict.fromkeys(names, 1), {name: name for name in names}, combination, names[:5])
    assert read == names[:5]


@pytest.mark.parametrize("treatments", [[100, 1000], [1, 10, 100], ["few", "many"], [1, 1.2], [2, 3]])
def test_a_factor_that_is_only_called_like_a_counter_has_to_be_read(treatments: list[Any]) -> None:
    assert counting({"iterations": treatments, "run_number": [1, 2]}) == ("run_number",)


def counting(factors: dict[str, Sequence[Any]]) -> tuple[str, ...]:
    made = [Factor(name, treatments) for name, treatments in factors.items()]
    run = ListedRun("run_0", {factor.name: factor.treatments[0] for factor in made})
    return EarlierDesign(ListedRunTableModel(made, [run]), {name: name for name in factors}, (*factors,), ()).counting
