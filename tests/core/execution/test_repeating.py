"""An experiment is repeated until it is precise; whatever kills it, it goes on with the same plan."""

from __future__ import annotations

import csv
import os
import signal
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import pytest
from tests.conftest import written_config
from tests.core.execution.conftest import RecordingObserver
from tests.long_cases import soak_but

from robot_runner.cli.excluding import exclude_runs
from robot_runner.cli.extension import ExtensionRequest, extend_experiment
from robot_runner.core.config.preparation import prepare, prepare_or_refuse
from robot_runner.core.design.asking import Decision, Told
from robot_runner.core.design.extended_design import Additions
from robot_runner.core.execution import progress_manager, recovered_table
from robot_runner.core.execution.experiment_status import read_status
from robot_runner.core.execution.notices import NextDecided
from robot_runner.core.execution.orchestrator import execute_experiment
from robot_runner.core.execution.processes import forked
from robot_runner.core.execution.resumption import Resumption
from robot_runner.core.storage.journal import Journal, read_journal
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.manifest import read_manifest

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from robot_runner.core.errors import Finding

Execute = Callable[..., Any]

TABLE = """\
    def create_run_table(self):
        return RunTableModel(
            [Factor("Task", ["Video", "Network"])],
            repetitions=3, shuffle=True, seed=1, data_columns=[Measure("Energy", "J")],
        )
"""
#: The values of a run depend on its seed alone, so that an interrupted experiment yields the same table.
NOISY = """
run_process = RunProcess.IN_PROCESS
repeat_until = Precision("Energy", half_width="5 %", at_most={at_most})

def populate_run_data(self, context):
    from random import Random
    mean = 100 if context.combination["Task"] == "Video" else 80
    return {{"Energy": mean + Random(context.run_seed).gauss(0, {spread})}}
"""


def executed_until(config: Path, step: int) -> int:
    """Execute an experiment in a process that is killed at this step after its first decision to repeat.

    Returns:
        how it ended.
    """
    if process := forked():
        return os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])
    steps: list[str] = []

    def dying(function: Callable[..., Any], is_step: Callable[..., bool]) -> Callable[..., Any]:
        def called(*given: Any, **named: Any) -> Any:
            if steps or is_step(given):
                if len(steps) == step:
                    os.kill(os.getpid(), signal.SIGKILL)
                steps.append(function.__name__)
            return function(*given, **named)

        return called

    try:
        Journal.append = dying(Journal.append, lambda given: given[1] == "repeated")  # type: ignore[method-assign]
        recovered_table.write_run_table = dying(recovered_table.write_run_table, lambda _: False)
        progress_manager.write_manifest = dying(progress_manager.write_manifest, lambda _: False)
        resume(config)
    finally:
        os._exit(99)


def noisy(spread: float = 3.0, at_most: int = 12) -> str:
    return NOISY.format(spread=spread, at_most=at_most)


def resume(config: Path, **asked: Any) -> tuple[Any, RecordingObserver]:
    observer = RecordingObserver()
    return execute_experiment(prepare_or_refuse(config), observer, resumption=Resumption(**asked)), observer


def rows_of(config: Path) -> list[dict[str, str]]:
    with (config.parent / "results" / "trial" / "run_table.csv").open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def planned(rows: list[dict[str, str]]) -> list[tuple[str, ...]]:
    return [tuple(row[name] for name in ("run_id", "status", "Task", "Repetition", "Energy")) for row in rows]


def problems(findings: Any) -> list[str]:
    return [finding.problem for finding in findings]


def test_all_combinations_are_repeated_until_all_means_are_precise(execute: Execute) -> None:
    executed = execute(noisy(), table=TABLE)
    rows = executed.table
    added = executed.journal("repeated")
    assert executed.finished.done_count == len(rows) == 6 + 2 * len(added) > 6
    for repetition in range(1, len(rows) // 2 + 1):
        assert {row["Task"] for row in rows if row["Repetition"] == str(repetition)} == {"Video", "Network"}
    assert {row["Task"] for row in rows[6::2]} == {"Video", "Network"}, "the order is randomised within repetitions"
    assert "batch" not in rows[0], "what is added by the rule is planned, and no batch"
    notices = [notice for notice in executed.notices if isinstance(notice, NextDecided)]
    assert [notice.added for notice in notices] == [2] * len(added) + [0]
    assert [notice.run_count for notice in notices][-1] == len(rows)
    judged = [*added, *executed.journal("judged")]
    precise = [all(each["is_precise"] for each in record["precision"]) for record in judged]
    assert precise == [False] * (len(precise) - 4) + [True] * 4, "it has to remain precise for three more repetitions"
    assert "(2 of 2 means precise, 3 of 4 looks in a row): once more, 2 runs" in notices[-2].told
    manifest = read_manifest(executed.folder / "manifest.json")
    assert manifest["repeat_until"]["least"] == 3
    assert manifest["design"]["repetitions"] == len(rows) // 2
    status = read_status(executed.folder)
    assert status.repeated.endswith("at least 3, at most 12 repetitions")
    assert "(2 of 2 means precise)" in status.precision[0]
    _, again = resume(executed.config)
    assert [notice.added for notice in again.notices if isinstance(notice, NextDecided)] == [0]
    assert planned(rows_of(executed.config)) == planned(rows)


def test_at_most_is_the_end_and_is_told(execute: Execute) -> None:
    executed = execute(noisy(spread=40, at_most=5), table=TABLE)
    assert len(executed.table) == 10
    (told,) = [each for each in problems(executed.finished.findings) if "not as precise as wanted" in each]
    assert told.startswith("not as precise as wanted after 5 repetitions, which is at_most. Energy: ± ")


def test_of_several_rules_each_is_told_with_its_own_at_most(execute: Execute) -> None:
    longer = 'repeat_until = [Precision("Energy", half_width=0.001, at_most=5, of="differences"), Precision('
    executed = execute(
        noisy(spread=40, at_most=4).replace("repeat_until = Precision(", longer).replace("=4)", "=4)]"), table=TABLE
    )
    assert len(executed.table) == 10
    told = [each for each in problems(executed.finished.findings) if "not as precise as wanted" in each]
    assert [each.partition(". ")[0] for each in told] == [
        "not as precise as wanted after 5 repetitions, which is at_most",
        "not as precise as wanted after 5 repetitions, and at_most is 4",
    ]


@pytest.mark.parametrize(
    ("returned", "told"),
    [
        ("{'Energy': 7.0}", "Energy of Video: all 3 values are 7, so that nothing tells their spread"),
        ("{'Energy': None}", "Energy: Video: no run has a value of Energy"),
        ("{'Energy': 'much'}", "which is not a number"),
        ("{'Energy': context.repetition - 2.0}", "the mean is 0, of which 5 % is not a width"),
    ],
)
def test_what_no_repetition_makes_precise_is_told_and_not_repeated(execute: Execute, returned: str, told: str) -> None:
    body = noisy().replace(noisy()[noisy().index("    from random") :], f"    return {returned}\n")
    unit = "" if "much" in returned else "J"  # a measure with a unit takes no text
    executed = execute(body, table=TABLE.replace('"J"', repr(unit)))
    assert len(executed.table) == 6
    assert any(told in each for each in problems(executed.finished.findings))


@pytest.mark.long
def test_killed_at_any_step_of_a_repetition_it_goes_on_as_if_nothing_had_happened(tmp_path: Path) -> None:
    whole = tmp_path / "whole"
    whole.mkdir()
    resume(written_config(whole, noisy(), table=TABLE))
    expected = planned(rows_of(whole / "config.py"))
    config = written_config(tmp_path, noisy(), table=TABLE)
    for step in range(6):  # before the record, after it, in the table, in the manifest, in the first new run
        assert executed_until(config, step) == -signal.SIGKILL
    finished, _ = resume(config)
    assert finished.todo_count == 0
    assert planned(rows_of(config)) == expected
    records = list(read_journal(config.parent / "results" / "trial" / "journal.jsonl", kinds={"repeated"}))
    assert [record["repetition"] for record in records] == list(range(4, len(expected) // 2 + 1))
    assert ["base" in record for record in records] == [True] + [False] * (len(records) - 1)


def test_failed_and_excluded_runs_have_no_value_and_do_not_stop_it(execute: Execute) -> None:
    failing = noisy().replace(
        "    mean =", "    if context.run_id == 'r_2': raise RuntimeError('no battery')\n    mean ="
    )
    executed = execute(failing, table=TABLE)
    known = executed.journal("repeated")[0]["precision"][0]["known"]
    assert sorted(each["n"] for each in known) == [2, 3]
    assert executed.finished.failed == ("r_2",)
    before = len(executed.table)
    loud = max((row for row in executed.table if row["Energy"]), key=lambda row: abs(float(row["Energy"]) - 90))
    exclude_runs(ExperimentFolder(executed.folder), [loud["run_id"]], "the robot was carried")
    resume(executed.config)
    assert len(rows_of(executed.config)) >= before
    last = list(read_journal(executed.folder / "journal.jsonl", kinds={"judged"}))[-1]["precision"][0]
    of = {each["of"]: each["n"] for each in last["known"]}
    values = [row for row in rows_of(executed.config) if row["status"] == "Done" and not row["excluded"]]
    assert of == {task: sum(row["Task"] == task for row in values) for task in of}


def test_doubtful_values_count_unless_the_plan_leaves_them_out(execute: Execute, tmp_path: Path) -> None:
    limited = TABLE.replace('Measure("Energy", "J")', 'Measure("Energy", "J", high=99.0)')
    executed = execute(noisy(at_most=4), table=limited)
    (known, *_) = executed.journal("judged")[0]["precision"]
    assert {each["n"] for each in known["known"]} == {len(executed.table) // 2}
    planned_so = 'analysis = AnalysisPlan("Energy", doubtful=Doubtful.LEAVE_OUT)\n' + noisy(at_most=4)
    folder = tmp_path / "without"
    folder.mkdir()
    config = written_config(folder, planned_so, table=limited)
    resume(config)
    (record,) = read_journal(folder / "results" / "trial" / "journal.jsonl", kinds={"judged"})
    plausible = [row["Task"] for row in rows_of(config) if float(row["Energy"]) <= 99]
    found = {each["of"]: each.get("n", 0) for each in record["precision"][0]["known"]}
    assert found == {task: plausible.count(task) for task in ("Video", "Network")}
    assert found["Video"] < found["Network"] == 4


class Hearing:
    """Decides on nothing, and keeps what it was told."""

    measures = ("Energy",)

    def __init__(self) -> None:
        self.told: dict[str, Told] = {}

    def may_add(self, runs: object) -> bool:
        return True

    def ask(self, told: Sequence[Told]) -> Decision:
        self.told = {each.run.run_id: each for each in told}
        return Decision(name="end", in_words="nothing")


LIMITED = """
analysis = AnalysisPlan("Energy", doubtful=Doubtful.LEAVE_OUT)
def populate_run_data(self, context):
    context.combination["Task"]
    return {"Energy": {1: 50.0, 2: 150.0, 3: None}.get(context.run_number, 7.0)}
"""


def test_a_doubtful_value_that_the_plan_leaves_out_is_no_failure_and_its_run_counts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    hearing = Hearing()
    monkeypatch.setattr("robot_runner.core.execution.deciding.asking_of", lambda *_: hearing)
    table = TABLE.replace('Measure("Energy", "J")', 'Measure("Energy", "J", high=99.0)')
    resume(written_config(tmp_path, LIMITED, table=table))
    told = hearing.told
    assert [dict(told[run].values) for run in ("r_1", "r_2", "r_3")] == [{"Energy": 50.0}, {}, {}]
    assert [told[run].is_excluded for run in ("r_1", "r_2", "r_3")] == [False, True, False]
    assert [told[run].is_doubtful for run in ("r_1", "r_2", "r_3")] == [False, True, False]


def test_what_is_left_is_told_as_the_least_for_as_long_as_repetitions_may_follow(tmp_path: Path) -> None:
    failing = "    if context.run_id == 'r_2': raise RuntimeError('no battery')\n    mean ="
    config = written_config(tmp_path, noisy(30.0, at_most=4).replace("    mean =", failing), table=TABLE)
    resume(config, only=("r_1", "r_3"))
    status = read_status(tmp_path / "results" / "trial")
    assert (status.todo, status.left_is_least) == (4, True)
    resume(config)
    status = read_status(tmp_path / "results" / "trial")
    assert (status.run_count, status.failed) == (8, 1)
    assert status.seconds_left is not None, "of the run that failed"
    assert not status.left_is_least, "no repetition follows on the fourth"


def test_a_part_of_the_runs_is_not_repeated_and_a_redone_run_is_judged_anew(execute: Execute, tmp_path: Path) -> None:
    config = written_config(tmp_path, noisy(), table=TABLE)
    resume(config, only=("Task=Video",))
    assert len(rows_of(config)) == 6
    resume(config)
    count = len(rows_of(config))
    assert count > 6
    _, observer = resume(config, redo=("r_1",))
    assert any(isinstance(notice, NextDecided) for notice in observer.notices)


def test_where_chosen_runs_are_the_last_that_were_planned_it_is_told_that_more_may_follow(tmp_path: Path) -> None:
    config = written_config(tmp_path, noisy(), table=TABLE)
    finished, _ = resume(config, only=("Task=Video",))
    assert not [each for each in finished.findings if "--only" in each.where], "runs are left, and that is told"
    finished, _ = resume(config, skip=("Task=Video",))
    (found,) = [each for each in finished.findings if "--only" in each.where]
    assert found.problem.endswith("it is not decided how often it is repeated until it is precise")
    assert read_status(tmp_path / "results" / "trial").follows == "how often it is repeated until it is precise"
    resume(config)
    assert not read_status(tmp_path / "results" / "trial").follows


@pytest.mark.long
def test_an_extended_experiment_goes_on_until_all_is_precise(execute: Execute) -> None:
    executed = execute(noisy(at_most=20), table=TABLE)
    count = len(executed.table)
    preparation = prepare(executed.config, is_for_here=False)
    assert preparation.experiment is not None
    added = Additions(treatments={"Task": ["Audio"]})
    extension = extend_experiment(preparation.experiment, ExtensionRequest(added=added, seed=3))
    assert len(extension.runs) == count // 2, "as many repetitions as the others have by now"
    text = executed.config.read_text(encoding="utf-8")
    executed.config.write_text(text.replace("gauss(0, 3.0)", "gauss(0, 6.0)"), encoding="utf-8")
    resume(executed.config, accept_changes=True)
    rows = rows_of(executed.config)
    repeated = [row for row in rows if int(row["Repetition"]) > count // 2]
    assert repeated, "the third task is not precise after as many repetitions"
    assert len(rows) == 3 * int(rows[-1]["Repetition"])
    assert {row["batch"] for row in repeated} == {"2"}
    assert planned(rows)[:count] == planned(executed.table)[:count]


def test_a_table_that_was_written_by_hand_is_not_repeated_and_that_is_told(tmp_path: Path) -> None:
    config = written_config(tmp_path, noisy(), table=TABLE)
    folder = tmp_path / "results" / "trial"
    folder.mkdir(parents=True)
    rows = [f"hand_{task}_{number},{task}" for number in range(4) for task in ("Video", "Network")]
    (folder / "run_table.csv").write_text("\n".join(["run_id,Task", *rows, ""]), encoding="utf-8")
    finished, _ = resume(config)
    assert len(rows_of(config)) == 8
    assert any(
        "written by hand and is executed as it is: nothing is repeated" in each for each in problems(finished.findings)
    )


def test_a_grown_table_that_was_lost_comes_back(execute: Execute) -> None:
    executed = execute(noisy(), table=TABLE)
    rows = planned(executed.table)
    for name in ("run_table.csv", "manifest.json"):
        (executed.folder / name).unlink()
    resume(executed.config)
    assert planned(rows_of(executed.config)) == rows


@pytest.mark.long
@pytest.mark.parametrize("process", soak_but({"FORK"}, ["FORK", "SPAWN"]))
def test_added_runs_are_executed_in_processes_of_their_own(execute: Execute, process: str) -> None:
    body = noisy(spread=30, at_most=4).replace("IN_PROCESS", process)
    assert execute(body, table=TABLE.replace('["Video", "Network"]', '["Video"]')).finished.done_count == 4


def test_each_session_warms_up_also_where_it_begins_with_a_repetition(execute: Execute) -> None:
    warm = TABLE.replace("repetitions=3,", "repetitions=3, warm_up=WarmUp(1, each_session=True),")
    executed = execute(noisy(spread=30, at_most=3), table=warm)
    text = executed.config.read_text(encoding="utf-8")
    executed.config.write_text(text.replace("at_most=3", "at_most=4"), encoding="utf-8")
    resume(executed.config, accept_changes=True)
    begun = [record["run"] for record in read_journal(executed.folder / "journal.jsonl", kinds={"attempt_started"})]
    assert begun[7] == "w_1", "the probe and the warm-up of a session that begins with an added run"
    assert len(begun) == 7 + 3
    (change,) = read_manifest(executed.folder / "manifest.json")["repeat_until_changes"]
    assert change["was"]["rules"][0]["at_most"] == 3


def test_validation_names_what_does_not_fit(tmp_path: Path) -> None:
    body = """
    repeat_until = [
        Precision("Enrgy", half_width="2 %", at_most=30), Precision("Energy", half_width="1 V", at_most=3)
    ]
    """
    with_two = TABLE.replace("repetitions=3", "repetitions=2")
    found: tuple[Finding, ...] = prepare(written_config(tmp_path, body, table=with_two)).findings
    told = {finding.problem for finding in found if "repeat_until" in finding.where}
    assert told == {
        "2 repetitions cannot show the spread, on which precision depends",
        "there is no measure 'Enrgy'",
        "half_width is '1 V', and Energy has J",
    }
    wrong = prepare(written_config(tmp_path, "repeat_until = '2 %'", table=TABLE)).findings
    assert [finding.fix for finding in wrong if "repeat_until" in finding.where] == [
        "It must be Precision(...), or a list of them, in the config file; from outside, none."
    ]
    off = prepare(written_config(tmp_path, body, table=with_two), {"repeat_until": "none"})
    assert off.experiment is not None
    assert off.experiment.parameters.repeat_until == ()
