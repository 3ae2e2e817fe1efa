"""Which runs were executed, and which of them out of the table's order."""

from __future__ import annotations

from itertools import combinations, permutations
from typing import TYPE_CHECKING, Any

from robot_runner.core.storage.executed_runs import done_runs, executed_order, moved_runs, unrecorded_runs
from robot_runner.core.storage.journal import Journal

if TYPE_CHECKING:
    from pathlib import Path

ENDED: dict[str, Any] = {"seconds": 1.0, "failure": None, "measures": {}, "stamps": {}}
TABLE = ["r_1", "r_2", "r_3", "r_4", "r_5"]


def test_the_fewest_runs_are_named_that_had_to_change_places() -> None:
    for executed in permutations(TABLE):
        moved = moved_runs(TABLE, executed)
        stayed = [run for run in executed if run not in moved]
        assert stayed == sorted(stayed)
        more = [chosen for chosen in combinations(executed, len(stayed) + 1) if list(chosen) == sorted(chosen)]
        assert more == []


def test_runs_that_are_still_to_do_or_stand_in_no_table_moved_nowhere() -> None:
    assert moved_runs(TABLE, ["r_2", "x_9", "r_4"]) == ()
    assert moved_runs(TABLE, []) == ()


def test_the_last_attempt_counts_and_warm_up_runs_do_not(tmp_path: Path) -> None:
    with Journal(tmp_path / "journal.jsonl") as journal:
        for run, repetition in (("w_1", 0), ("r_1", 1), ("r_2", 1), ("w_1", 0), ("r_1", 1), ("r_3", 1)):
            journal.append("attempt_started", run=run, attempt=1, repetition=repetition)
            status = "failed" if run == "r_2" else "done"
            journal.append("attempt_finished", run=run, attempt=1, status=status, **ENDED)
        journal.append("attempt_finished", run="r_3", attempt=2, status="interrupted", **ENDED)
    assert executed_order(tmp_path / "journal.jsonl") == ["r_2", "r_1", "r_3"]
    assert done_runs(tmp_path / "journal.jsonl") == {"w_1", "r_1"}
    assert executed_order(tmp_path / "nowhere.jsonl") == []


def test_runs_are_missing_in_the_journal_that_are_done_by_the_table_and_by_nobodys_hand() -> None:
    done, by_hand = ["r_1", "r_2", "r_3"], [{"run": "r_2", "column": "status"}, {"run": "r_3", "column": "Energy"}]
    manifest: dict[str, Any] = {"design": {"source": "config"}, "table_deviations": by_hand}
    assert unrecorded_runs(done, {"r_1"}, manifest) == ["r_3"]
    own_table: dict[str, Any] = {"design": {"source": "run_table.csv"}}
    assert unrecorded_runs(done, {"r_1"}, own_table) == [], "an earlier version did not note what was done in it"
    own_table["design"]["done_before"] = ["r_2"]
    assert unrecorded_runs(done, {"r_1"}, own_table) == ["r_3"]
