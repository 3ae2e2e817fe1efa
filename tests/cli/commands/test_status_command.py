from __future__ import annotations

import json
import os
import shutil
import time
from dataclasses import replace
from typing import TYPE_CHECKING

import pytest
from tests.conftest import written_config

from robot_runner.cli.commands.status import _as_json
from robot_runner.cli.findings import grouped
from robot_runner.cli.main import main
from robot_runner.core.errors import Finding
from robot_runner.core.execution.experiment_status import read_status
from robot_runner.core.execution.places import InFlight
from robot_runner.core.storage.lock import ExperimentLock

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

pytestmark = pytest.mark.filterwarnings("ignore:.*multi-threaded:DeprecationWarning")

HALF = """\
def launch_mission(self, context):
    context.warn("the sun was in the camera", fix="Draw the curtains.")
    if context.combination["Task"] == "Video":
        raise ValueError("the camera is off")

def populate_run_data(self, context):
    return {"Energy": 1.5}
"""


@pytest.fixture(scope="module")
def executed_half(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a config that was executed; each test gets a copy."""
    folder = tmp_path_factory.mktemp("half")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        assert main(["run", str(written_config(folder, HALF))]) == 1
    return folder


@pytest.fixture
def half_done(executed_half: Path, tmp_path: Path) -> Path:
    shutil.copytree(executed_half, tmp_path, dirs_exist_ok=True)
    return tmp_path / "results" / "trial"


@pytest.mark.parametrize("target", ["config.py", "results/trial", "./results/trial/"])
def test_it_is_named_by_its_folder_or_its_config(robot_runner: Callable, half_done: Path, target: str) -> None:
    answer = robot_runner("status", target)
    assert answer.code == 0
    assert answer.out.startswith("trial ")
    assert "2 of 4 runs done, 2 failed, 0 to do" in answer.out
    assert "not being executed" in answer.out
    assert "✗ r_1, r_3: launch_mission of config: ValueError: the camera is off" in answer.out
    assert "! config: the sun was in the camera (in r_1, r_2, r_3, r_4)" in answer.out
    assert half_done.exists()


def test_json_holds_everything(robot_runner: Callable, half_done: Path) -> None:
    facts = robot_runner("status", "config.py", "--json").json
    assert facts.pop("started_at").endswith("Z")
    assert facts.pop("finished_at").endswith("Z")
    assert len(facts.pop("findings")) == 4
    assert 0 < facts.pop("seconds_left") < 30, "of the two that failed, as the two others took"
    reason = "launch_mission of config: ValueError: the camera is off"
    assert facts.pop("bad_values") == {}
    assert [facts.pop(name) for name in ("warm_ups", "warm_ups_done", "batches")] == [0, 0, []]
    assert [each["is_whole"] for each in facts.pop("sessions")] == [True]
    assert (facts.pop("gates"), facts.pop("gate_seconds")) == ([], 0.0)
    assert facts == {
        "experiment_name": "trial",
        "folder": str(half_done),
        "holder": None,
        "is_waiting_for_user": False,
        "waiting_for": None,
        "run_count": 4,
        "done": 2,
        "failed": 2,
        "todo": 0,
        "current_run": None,
        "current_event": None,
        "in_flight": [],
        "left_is_least": False,
        "failures": [f"r_1: {reason}", f"r_3: {reason}"],
        "excluded": {},
        "is_paused": False,
        "pause_is_requested": False,
        "is_imported": False,
        "is_of_older_tool": False,
        "lacks_plan": False,
        "order": "",
        "precision": [],
        "repeated": "",
        "decided": "",
        "follows": "",
    }


@pytest.mark.long
def test_all_sessions_are_told_and_not_the_last_alone(robot_runner: Callable, half_done: Path) -> None:
    first = robot_runner("status", "config.py", "--json").json
    robot_runner("run", "config.py", "--only", "r_3")
    facts = robot_runner("status", half_done, "--json").json
    assert [each["started_at"] for each in facts["sessions"]] == [first["started_at"], facts["started_at"]]
    assert facts["sessions"][1]["selection"] == {"only": ["r_3"]}
    told = " ".join(robot_runner("status", half_done).out.split())
    assert f"Started {first['started_at']} Resumed {facts['started_at']}" in told
    assert "Chosen --only r_3" in told


def test_what_an_older_tool_has_half_done_is_no_experiment_that_was_never_executed(
    robot_runner: Callable, tmp_path: Path
) -> None:
    folder = tmp_path / "experiments" / "older"
    folder.mkdir(parents=True)
    rows = "__run_id,__done,size\nrun_0,DONE,1\nrun_1,DONE,2\nrun_2,TODO,3\n"
    (folder / "run_table.csv").write_text(rows, encoding="utf-8")
    answer = robot_runner("status", folder)
    assert answer.code == 0
    assert "2 of 3 runs done, 1 to do" in answer.out
    assert "another tool began it" in answer.out
    assert robot_runner("status", folder, "--json").json["bad_values"] == {}
    refused = robot_runner("exclude", folder, "run_0", "--reason", "x")
    assert (refused.code, "another tool executed this experiment" in refused.err) == (2, True)


def test_parameters_that_were_set_lead_to_the_folder(robot_runner: Callable, write_config: Callable[..., Path]) -> None:
    write_config("def populate_run_data(self, context): return {'Energy': 1.5}")
    setting = ["--set", "experiment_name=other"]
    assert robot_runner("run", "config.py", *setting).code == 0
    assert "other" in robot_runner("status", "config.py", *setting).out
    refused = robot_runner("status", "config.py")
    assert refused.code == 2
    assert "Execute it: robot-runner config.py, or name the folder of another one: results/other" in refused.err


def test_an_experiment_that_was_never_executed_is_told_how(
    robot_runner: Callable, write_config: Callable[..., Path]
) -> None:
    write_config()
    answer = robot_runner("status", "config.py")
    assert answer.code == 2
    assert "never executed" in answer.err
    assert "fix: Execute it: robot-runner config.py" in answer.err


def test_a_folder_of_experiments_names_them(robot_runner: Callable, half_done: Path) -> None:
    assert robot_runner("status", "results").out == robot_runner("status", "results/trial").out, "the only one in it"
    shutil.copytree(half_done, half_done.with_name("other"))
    answer = robot_runner("status", "results")
    assert answer.code == 2
    assert "fix: Name the experiment's own folder: results/other, results/trial." in answer.err


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        (["reslts"], "Did you mean 'results'?"),
        (["results/trial", "--set", "attempts=2"], "--set is for config files"),
        (["."], "there is no experiment here"),
    ],
)
def test_what_is_no_experiment_is_refused(
    robot_runner: Callable, half_done: Path, words: list[str], problem: str
) -> None:
    answer = robot_runner("status", *words)
    assert answer.code == 2
    assert problem in answer.err
    assert half_done.exists()


def test_a_missing_run_table_hides_nothing_that_was_executed(robot_runner: Callable, half_done: Path) -> None:
    before = robot_runner("status", "config.py", "--json").json
    (half_done / "run_table.csv").unlink()
    facts = robot_runner("status", "config.py", "--json").json
    assert {name: facts[name] for name in ("run_count", "done", "failed", "todo")} == {
        name: before[name] for name in ("run_count", "done", "failed", "todo")
    }
    assert "the run table is missing; the journal has what was executed" in robot_runner("status", "config.py").out


def test_json_holds_each_run_that_is_executed_as_facts(half_done: Path) -> None:
    status = replace(read_status(half_done), in_flight=(InFlight("r_2", "alice", "start_run"),))
    assert _as_json(status)["in_flight"] == [{"run": "r_2", "place": "alice", "event": "start_run"}]


def test_all_runs_in_flight_are_named_where_a_pause_or_a_stop_awaits_them(half_done: Path) -> None:
    idle = read_status(half_done)
    assert (idle.moment_of_pause, idle.closed_first) == ("before the next run", "")
    one = replace(idle, in_flight=(InFlight("r_2"),))
    assert (one.moment_of_pause, one.closed_first) == ("after r_2", "r_2 is closed first, and is to be done again")
    two = replace(idle, in_flight=(InFlight("r_2", "alice"), InFlight("r_4", "bob")))
    assert two.moment_of_pause == "after r_2 and r_4"
    assert two.closed_first == "r_2 and r_4 are closed first, and are to be done again"


@pytest.mark.long
@pytest.mark.parametrize("words", [["status"], ["stop"], ["exclude", "r_1", "--reason", "x"]])
@pytest.mark.parametrize("target", ["results/trial", "config.py"])
def test_an_experiment_whose_manifest_is_lost_is_not_taken_for_that_of_another_tool(
    robot_runner: Callable, half_done: Path, words: list[str], target: str
) -> None:
    (half_done / "manifest.json").unlink()
    command, *more = words
    answer = robot_runner(command, target, *more)
    assert answer.code == 2
    assert "manifest.json is missing, and the journal is there" in answer.err
    assert "robot-runner run" in answer.err
    robot_runner("run", "config.py")
    assert robot_runner("status", target).code == 0


def test_of_an_experiment_that_just_begins_it_is_said_who_begins_it(robot_runner: Callable, half_done: Path) -> None:
    (half_done / "manifest.json").unlink()  # it is written once the journal is there
    with ExperimentLock(half_done / ".lock"):
        answer = robot_runner("status", "config.py")
    assert answer.code == 2
    assert f"the experiment is being begun by process {os.getpid()}" in answer.err
    assert "Wait a moment" in answer.err


def test_a_session_that_has_ended_is_not_broken_off_while_its_process_ends(
    robot_runner: Callable, half_done: Path
) -> None:
    robot_runner("run", "config.py", "--only", "r_3")
    with ExperimentLock(half_done / ".lock"):
        told = robot_runner("status", "config.py").out
    assert "Sessions" in told
    assert "broken off" not in told


def test_an_order_of_rows_that_was_changed_by_hand_is_told_as_that(robot_runner: Callable, half_done: Path) -> None:
    table = half_done / "run_table.csv"
    heading, *rows = table.read_text("utf-8").splitlines()
    table.write_text("\n".join([heading, *reversed(rows)]) + "\n", "utf-8")
    robot_runner("run", "config.py")
    told = " ".join(robot_runner("status", "config.py").out.split())
    assert "run_table.csv: the rows were put into another order by hand" in told


def test_the_command_that_is_offered_can_be_pasted(
    robot_runner: Callable, write_config: Callable[..., Path], tmp_path: Path
) -> None:
    write_config().rename(tmp_path / "my study.py")
    assert "fix: Execute it: robot-runner 'my study.py'" in robot_runner("status", "my study.py").err


@pytest.mark.long
def test_a_session_does_not_last_until_somebody_excludes_a_run(robot_runner: Callable, half_done: Path) -> None:
    before = robot_runner("status", "config.py", "--json").json["sessions"]
    time.sleep(0.01)  # the stamps of the journal have milliseconds
    assert robot_runner("exclude", "config.py", "r_2", "--reason", "the door was open").code == 0
    assert robot_runner("status", "config.py", "--json").json["sessions"] == before


def test_a_missing_schema_hides_nothing_that_was_executed(robot_runner: Callable, half_done: Path) -> None:
    (half_done / "run_table.schema.json").unlink()
    told = robot_runner("status", "config.py").out
    assert "2 of 4 runs done, 2 failed, 0 to do" in told
    assert "the schema of the run table is missing" in told


@pytest.mark.parametrize("kept_lines", [0, 3], ids=["no journal", "its beginning"])
def test_what_is_not_known_is_not_called_done(robot_runner: Callable, half_done: Path, kept_lines: int) -> None:
    (half_done / "run_table.csv").unlink()
    journal = half_done / "journal.jsonl"
    lines = journal.read_text(encoding="utf-8").splitlines(keepends=True)
    journal.write_text("".join(lines[:kept_lines]), encoding="utf-8")
    told = robot_runner("status", "config.py").out
    assert "not being executed; `robot-runner run` with its config resumes it" in told
    assert ("0 of 4 runs done, 4 to do" if kept_lines else "0 done; how many are planned is not known") in told
    beyond = [line for line in lines if '"kind":"experiment_started"' not in line]
    journal.write_text("".join(beyond), encoding="utf-8")
    assert "2 done, 2 failed; how many are planned is not known" in robot_runner("status", "config.py").out


@pytest.mark.long
def test_runs_that_are_executed_again_are_not_counted_twice(robot_runner: Callable, half_done: Path) -> None:
    told = robot_runner("run", "config.py", "--redo", "r_2", "--only", "r_2", "--plain").out
    assert ", 1 of them done before" in told


def test_runs_that_the_run_table_does_not_have_yet_are_counted_in_the_order_of_the_plan(half_done: Path) -> None:
    journal = half_done / "journal.jsonl"
    lines = journal.read_text(encoding="utf-8").splitlines()
    (done,) = [line for line in lines if '"kind":"attempt_finished"' in line and '"run":"r_2"' in line]
    (begun,) = [line for line in lines if '"kind":"attempt_started"' in line and '"run":"r_2"' in line]
    added = [
        {"run": run, "combination": {"Task": "Network"}, "repetition": 3, "block": 3} for run in ("r_5", "r_6", "r_7")
    ]
    grown = json.dumps(
        {"kind": "repeated", "at": "2030-01-01T00:00:00.000Z", "repetition": 3, "runs": added, "precision": []},
        separators=(",", ":"),
    )
    later = [begun.replace('"r_2"', '"r_5"'), begun.replace('"r_2"', '"r_6"')]
    later += [done.replace('"r_2"', '"r_6"'), done.replace('"r_2"', '"r_5"'), begun.replace('"r_2"', '"r_7"')]
    journal.write_text("\n".join([*lines, grown, *later, ""]), encoding="utf-8")
    for lost in ("", "run_table.csv"):
        (half_done / lost).unlink() if lost else None
        status = read_status(half_done)
        assert (status.run_count, status.done, status.failed, status.todo) == (7, 4, 2, 1), lost
        assert not status.order, lost


def test_what_is_found_in_warm_up_runs_and_in_others_is_told_once() -> None:
    found = [Finding.warning(f"{run}, gate", "the door is open") for run in ("w_1", "r_1")]
    assert grouped(found, None) == [("gate: the door is open (in w_1, r_1)", "")]
