"""`robot-runner extend`, called as a user calls it."""

from __future__ import annotations

import csv
from typing import TYPE_CHECKING

import pytest
from tests.conftest import TABLE

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

MEASURING = """
run_process = RunProcess.IN_PROCESS

def launch_mission(self, context):
    context.combination["Task"]

def populate_run_data(self, context):
    return {"Energy": context.run_number}
"""


def rows(folder: Path) -> list[dict[str, str]]:
    with (folder / "results/trial/run_table.csv").open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


@pytest.mark.long
def test_a_study_is_extended_and_executed(
    robot_runner: Callable, write_config: Callable[..., Path], tmp_path: Path
) -> None:
    def call(*words: str, code: int = 0) -> str:
        answer = robot_runner(*words)
        assert answer.code == code, answer.out + answer.err
        return str(answer.out + answer.err)

    write_config(MEASURING)
    call("config.py")
    write_config(MEASURING, table=TABLE.replace("repetitions=2", "repetitions=3"))
    for options in ((), ("--accept-changes",)):
        refused = call("config.py", *options, code=2)
        assert "the config plans more than the run table has: 3 repetitions of each combination instead of 2" in refused
        assert "Add these runs: robot-runner extend config.py. Or undo the change." in refused
        assert "nothing was executed" not in refused
    assert "warning: " in (planned := call("plan", "config.py"))
    assert "the config plans more than the run table has" in planned
    assert "6 runs: Task (2) x 3 repetitions" in planned
    told = call("extend", "config.py", "--treatments", "Task=Audio,Idle", "--seed", "4")
    assert "Batch     2: 8 runs, r_5 to r_12\n" in told
    assert "In total  12 runs, 3 repetitions of each combination\n" in told
    assert "Order     randomised among themselves from seed 4\n" in told
    assert "Next      execute them: robot-runner config.py\n" in told
    assert "5 of 12" not in call("status", "config.py")
    assert "4 of 12 runs done, 8 to do" in call("status", "config.py")
    assert "Batches  2, of 4 and 8 runs: the experiment was extended" in call("status", "config.py")
    planned = call("plan", "config.py")
    assert "Runs       12 runs in 2 batches of 4 and 8: Task (4) x 3 repetitions" in planned
    assert "as written; batch 2 randomised among themselves from seed 4" in planned
    assert "All 12 runs are done" in call("config.py")
    assert [row["status"] for row in rows(tmp_path)] == ["Done"] * 12
    assert "Place    run 5 of 12, randomised from seed 4, in batch 2\n" in call("explain", "results/trial", "r_5")


@pytest.mark.long
def test_a_dry_run_tells_how_to_add_just_these_runs(
    robot_runner: Callable, write_config: Callable[..., Path], tmp_path: Path
) -> None:
    write_config(MEASURING)
    robot_runner("config.py")
    shown = robot_runner("extend", "config.py", "--repetitions", "4", "--dry-run")
    assert shown.code == 0
    assert (
        "Written   nothing: the same command without --dry-run adds these runs, in this order with --seed " in shown.out
    )
    assert len(rows(tmp_path)) == 4
    seed = shown.out.rstrip().rpartition(" ")[2]
    added = robot_runner("extend", "config.py", "--repetitions", "4", "--seed", seed)
    assert added.out.splitlines()[:5] == shown.out.splitlines()[:5]


@pytest.mark.long
def test_the_order_of_a_batch_of_a_design_is_that_of_the_design(
    robot_runner: Callable, write_config: Callable[..., Path], tmp_path: Path
) -> None:
    table = """
    def create_run_table(self):
        from robot_runner.designs import Blocks

        factors = [Factor("Day", ["Mon", "Tue"]), Factor("Task", ["Video", "Network"])]
        design = Blocks("Day")
        return RunTableModel(factors, repetitions=2, shuffle=True, seed=4, design=design, data_columns=["Energy"])
"""
    write_config(MEASURING, table=table)
    assert robot_runner("config.py").code == 0
    more = ("extend", "config.py", "--repetitions", "3", "--treatments", "Day=Wed")
    for order in (("--seed", "9"), ("--as-written",)):
        refused = robot_runner(*more, *order)
        assert (refused.code, refused.out) == (2, "")
        assert "the design puts the new runs in order itself: randomised from the first seed, 4" in refused.err
    shown = robot_runner(*more, "--dry-run").out
    assert "Order     randomised among themselves from seed 4\n" in shown
    assert "Written   nothing: the same command without --dry-run adds these runs, in this order\n" in shown
    added = robot_runner(*more, "--json")
    assert (added.json["shuffle"], added.json["seed"]) == (True, 4)
    assert [row["Day"] for row in rows(tmp_path)[4:]] == ["Wed", "Wed"]


@pytest.mark.long
def test_a_new_factor_says_what_the_runs_so_far_count_as(
    robot_runner: Callable, write_config: Callable[..., Path], tmp_path: Path
) -> None:
    write_config(MEASURING)
    robot_runner("config.py")
    answer = robot_runner("extend", "config.py", "--factor", "Floor=carpet:wood,tiles", "--as-written", "--json")
    assert answer.code == 0
    assert answer.json["defaults"] == {"Floor": "carpet"}
    assert answer.json["run_count"] == 12
    assert answer.json["order"] == "as written"
    assert [run["combination"]["Floor"] for run in answer.json["new_runs"]] == ["wood", "tiles"] * 4
    assert [row["Floor"] for row in rows(tmp_path)] == ["carpet"] * 4 + ["wood", "tiles"] * 4
    told = robot_runner("explain", "results/trial", "r_1", "Floor").out
    assert "Assumed     the factor was added with batch 2, and runs before count as having had this treatment\n" in told
    assert "Assumed" not in robot_runner("explain", "results/trial", "r_5", "Floor").out
    robot_runner("config.py")
    assert "Warm" not in robot_runner("status", "config.py").out


@pytest.mark.long
@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--treatments", "Task"], "'Task' is not of the form FACTOR=T1,T2"),
        (["--factor", "=a:b"], "'=a:b' is not of the form NAME=DEFAULT:T1,T2"),
        (["--treatments", "Task=A", "--treatments", "Task=B"], "'Task' is given twice"),
        (["--seed", "-1", "--repetitions", "3"], "-1 is not a seed"),
        (["--treatments", "Tsk=Audio"], "Did you mean 'Task'?"),
        (["--repetitions", "1"], "1 is fewer than the 2 repetitions that there are"),
        ([], "there is nothing to add: the run table has 2 repetitions of each combination"),
    ],
)
def test_what_cannot_be_added_is_refused_with_what_to_do(
    robot_runner: Callable, write_config: Callable[..., Path], words: list[str], told: str
) -> None:
    write_config(MEASURING)
    robot_runner("config.py")
    answer = robot_runner("extend", "config.py", *words)
    assert answer.code == 2
    assert told in answer.err
    assert answer.out == ""


@pytest.mark.long
def test_warm_up_runs_are_shown_by_the_plan_the_screen_and_the_status(
    robot_runner: Callable, write_config: Callable[..., Path]
) -> None:
    write_config(MEASURING, table=TABLE.replace("repetitions=2", 'repetitions=2, warm_up=WarmUp(1, per="Task")'))
    planned = robot_runner("plan", "config.py").out
    assert planned.splitlines()[1].split() == ["w_1", "Video", "warm-up"]
    assert "Runs      4 runs: Task (2) x 2 repetitions\n" in planned
    assert "Warm-up   w_1, w_2 (1 warm-up run for each treatment of Task): executed and kept, not analysed\n" in planned
    assert "Warm-up" in robot_runner("check", "config.py").out
    assert "run 1 of 6 (w_1) starts: Task=Video, warm-up\n" in robot_runner("config.py").out
    assert "2 of these are warm-up runs, 2 done: kept, and not analysed" in robot_runner("status", "config.py").out
    assert (
        "Warm-up  the run was executed and kept, and is not analysed\n"
        in robot_runner("explain", "results/trial", "w_2").out
    )
