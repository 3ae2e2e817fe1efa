from __future__ import annotations

import re
import signal
from collections.abc import Callable
from itertools import chain, pairwise, repeat
from typing import TYPE_CHECKING, Any

import pytest
from tests.conftest import HEAD
from tests.core.execution.conftest import execute_in
from tests.long_cases import soak_but

from robot_runner.core.errors import ExecutionError
from robot_runner.core.execution import processes, run_facts
from robot_runner.core.execution.processes import children

if TYPE_CHECKING:
    from pathlib import Path

    from tests.core.execution.conftest import Executed

Execute = Callable[..., Any]

LISTENING = """
def before_experiment(self, context):
    self.note("before_experiment")
    return True
def before_run(self, context): self.note("before_run")
def start_run(self, context): self.note("start_run")
def start_measurement(self, context): self.note("start_measurement")
def launch_mission(self, context): self.note("launch_mission")
def stop_measurement(self, context): self.note("stop_measurement")
def stop_run(self, context): self.note("stop_run")
def populate_run_data(self, context):
    self.note("populate_run_data")
    return {"Energy": 1.5}
def continue_experiment(self, context):
    self.note("continue")
    return True
def after_experiment(self, context): self.note("after_experiment")
def note(self, event):
    with (Path(__file__).parent / "heard.txt").open("a") as file:
        print(event, file=file)
"""


#: For runs that are an interpreter each.
ONE_RUN = '    def create_run_table(self): return RunTableModel([Factor("Task", ["Video"])], data_columns=["Energy"])'
THREE_RUNS = ONE_RUN.replace(", data_columns", ", repetitions=3, data_columns")


#: An interpreter for each run takes long, and what becomes of an attempt is for the orchestrator to say.
each_fork = pytest.mark.parametrize(
    "run_process", soak_but({"fork", "in_process"}, ["fork", "spawn", "in_process"]), indirect=True
)


@pytest.fixture(params=["fork", "spawn", "in_process"], scope="module")
def run_process(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture(scope="module")
def executed(run_process: str, tmp_path_factory: pytest.TempPathFactory) -> Executed:
    """Return an experiment without a fault; nobody may change it."""
    printing = 'self.note("launch_mission"); print("mission of", context.run_id)'
    body = LISTENING.replace('self.note("launch_mission")', printing).replace("1.5", "877.5")
    folder = tmp_path_factory.mktemp("experiment")
    return execute_in(folder, body, run_process=run_process, operation_type="semi", table=THREE_RUNS)


@pytest.mark.long
def test_every_run_ends_up_done_with_its_measures(executed: Executed) -> None:
    assert executed.finished.done_count == 3
    assert [row["status"] for row in executed.table] == ["Done"] * 3
    assert [row["run_id"] for row in executed.table] == ["r_1", "r_2", "r_3"]
    assert [row["Energy"] for row in executed.table] == ["877.5"] * 3


def test_the_events_come_in_the_order_of_the_paper(executed: Executed) -> None:
    heard = (executed.config.parent / "heard.txt").read_text(encoding="utf-8").split()
    run = [
        "before_run",
        "start_run",
        "start_measurement",
        "launch_mission",
        "stop_measurement",
        "stop_run",
        "populate_run_data",
    ]
    assert heard == ["before_experiment", *[*run, "continue"] * 2, *run, "after_experiment"]


def test_each_event_is_stamped_in_its_column(executed: Executed) -> None:
    names = [name for name in executed.table[0] if name.endswith("_at") and name != "continue_at"]
    assert len(names) == 7
    for row in executed.table:
        stamps = [row[name] for name in names]
        assert all(stamp.endswith("Z") for stamp in stamps)
        assert all(earlier <= later for earlier, later in pairwise(stamps))


def test_what_before_experiment_sets_up_is_seen_in_forked_runs(execute: Execute) -> None:
    executed = execute(
        """
        def before_experiment(self, context): self.calibration = 42
        def populate_run_data(self, context): return {"Energy": self.calibration}
        """
    )
    assert [row["Energy"] for row in executed.table] == ["42"] * 4


def test_what_before_run_and_continue_set_is_seen_in_the_next_run(execute: Execute) -> None:
    experiment = execute(
        """
        operation_type = OperationType.SEMI
        runs = continued = 0
        def before_experiment(self): return True
        def before_run(self, context): self.runs += 1
        def continue_experiment(self, context):
            self.continued += 10
            return True
        def populate_run_data(self, context): return {"Energy": self.runs + self.continued}
        """
    )
    assert [row["Energy"] for row in experiment.table] == ["1", "12", "23", "34"]


@pytest.mark.long
def test_a_fresh_interpreter_that_does_not_come_to_its_first_event_is_told_as_that(execute: Execute) -> None:
    executed = execute(
        """
        event_deadline_in_s = 1
        grace_in_s = 1
        def before_run(self, context): pass
        sys.argv[0].endswith("worker.py") and time.sleep(60)
        """,
        head=f"import sys, time\n{HEAD}",
        table=ONE_RUN,
        run_process="spawn",
    )
    because = "the run's process took longer than event_deadline_in_s = 1 s to begin its first event"
    assert executed.finished.failures == (f"r_1: {because}",)


@pytest.mark.parametrize("run_process", ["fork", "in_process"])
@pytest.mark.parametrize("callback", ["before_run", "launch_mission"])
def test_a_treatment_that_a_run_changes_is_that_of_the_plan_in_the_next(
    execute: Execute, run_process: str, callback: str
) -> None:
    experiment = execute(
        f"""
        def {callback}(self, context): context.combination["Route"].append("dock")
        def populate_run_data(self, context): return {{"Length": len(context.combination["Route"])}}
        """,
        run_process=run_process,
        table="""\
    def create_run_table(self):
        return RunTableModel([Factor("Route", [["kitchen"]])], repetitions=2, data_columns=["Length"])
""",
    )
    assert [(row["Route"], row["Length"]) for row in experiment.table] == [("['kitchen']", "2")] * 2


def test_what_before_experiment_opened_is_closed_when_after_experiment_closes_it(execute: Execute) -> None:
    # A process of ours that shared the pipe would keep `cat` waiting for more.
    experiment = execute(
        """
        def before_experiment(self, context):
            import subprocess
            self.program = subprocess.Popen(["cat"], stdin=subprocess.PIPE)
        def after_experiment(self, context):
            self.program.stdin.close()
            self.program.wait(timeout=60)
        """
    )
    assert experiment.finished.done_count == 4


def test_what_callbacks_print_goes_to_the_log_of_their_run(executed: Executed) -> None:
    assert "mission of r_3" in executed.log("r_3")


def test_what_programs_started_by_callbacks_print_goes_to_the_log_as_well(execute: Execute) -> None:
    executed = execute("def launch_mission(self, context): __import__('os').system('echo from a shell')")
    assert executed.log("r_1") == "from a shell\n"


@pytest.mark.long
@each_fork
def test_an_exception_fails_the_run_and_the_experiment_goes_on(execute: Execute, run_process: str) -> None:
    executed = execute(
        """
        def launch_mission(self, context):
            if context.run_id == "r_2": raise RuntimeError("the wheel fell off")
        """,
        run_process=run_process,
        table=THREE_RUNS,
    )
    assert [row["status"] for row in executed.table] == ["Done", "Failed", "Done"]
    assert executed.finished.failures == ("r_2: launch_mission of config: RuntimeError: the wheel fell off",)
    (failure,) = executed.journal("failure")
    assert "RuntimeError: the wheel fell off" in failure["traceback"]


def test_what_opened_is_closed_in_reverse_after_a_failure(execute: Execute, run_process: str) -> None:
    executed = execute(
        LISTENING.replace('self.note("launch_mission")', "1 / 0"), run_process=run_process, on_failure="stop"
    )
    heard = (executed.config.parent / "heard.txt").read_text(encoding="utf-8").split()
    assert heard == [
        "before_experiment",
        "before_run",
        "start_run",
        "start_measurement",
        "stop_measurement",
        "stop_run",
        "after_experiment",
    ]


def test_a_failed_start_is_closed_and_nothing_after_it_is_started(execute: Execute) -> None:
    executed = execute(LISTENING.replace('self.note("start_run")', "1 / 0"), on_failure="stop")
    heard = (executed.config.parent / "heard.txt").read_text(encoding="utf-8").split()
    assert heard == ["before_experiment", "before_run", "stop_run", "after_experiment"]


def test_the_policy_can_stop_the_experiment_at_the_first_failed_run(execute: Execute) -> None:
    executed = execute("def launch_mission(self, context): raise ValueError(context.run_id)", on_failure="stop")
    assert executed.finished.stopped_by
    assert [row["status"] for row in executed.table] == ["Failed", "-", "-", "-"]


@pytest.mark.long
@each_fork
def test_a_run_is_tried_again_and_the_earlier_attempt_is_kept(execute: Execute, run_process: str) -> None:
    executed = execute(
        """
        def launch_mission(self, context):
            print("attempt", context.attempt)
            if context.run_id == "r_1" and context.attempt < 3: raise ValueError("not yet")
        """,
        run_process=run_process,
        attempts=3,
        table=ONE_RUN,
    )
    assert executed.finished.done_count == 1
    assert "attempt 3" in executed.log("r_1")
    earlier = sorted(executed.folder.glob("earlier_attempts/r_1/*/log.txt"))
    assert [path.read_text(encoding="utf-8").split()[1] for path in earlier] == ["1", "2"]


def test_a_run_that_prints_more_than_anybody_reads_is_told(execute: Execute, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run_facts, "_LARGE_LOG", 1_000_000)
    executed = execute(
        """
        def launch_mission(self, context):
            print("x" * (2_000_000 if context.run_id == "r_2" else 100))
        """,
    )
    (told,) = [each for each in executed.finished.findings if "printed" in each.problem]
    assert (told.where, told.problem) == ("r_2", "the run has printed 2 MB, which log.txt keeps")


def test_no_further_run_begins_where_before_run_finds_that_a_robot_cannot_be_stopped(execute: Execute) -> None:
    executed = execute(
        """
        attempts = 2
        def before_run(self, context):
            from robot_runner.core.links.commanded_topics import MAY_BE_MOVING
            if context.run_number == 2: raise RuntimeError(f"{MAY_BE_MOVING}: Nav has ended")
        def populate_run_data(self, context): return {"Energy": 1.0}
        """
    )
    assert [row["status"] for row in executed.table] == ["Done", "Failed", "-", "-"]
    assert executed.finished.stopped_by == "a robot that may be moving"


def test_a_failed_before_run_fails_the_run_without_starting_it(execute: Execute) -> None:
    executed = execute("def before_run(self, context): raise ValueError('no battery')", on_failure="stop")
    (failure,) = executed.finished.failures  # with the line, as there is no log of the run that has the traceback
    assert re.fullmatch(r"r_1: before_run of config: ValueError: no battery \(config\.py:\d+\)", failure)
    assert executed.table[0]["start_run_at"] == ""


def test_a_failed_before_experiment_is_an_error_that_names_the_callback(execute: Execute) -> None:
    with pytest.raises(ExecutionError) as refused:
        execute("def before_experiment(self, context): raise ValueError('no robot')")
    assert refused.value.where == "before_experiment of config"
    assert "no robot" in refused.value.problem


@pytest.mark.parametrize(
    ("returned", "problem"),
    [
        ("{'Enery': 1}", "'Enery' was not declared"),
        ("{'Energy': float('nan')}", "not a finite number"),
        ("{'Energy': [1, 2]}", "of type list"),
        ("42", "of type int"),
        ("{'Energy': 1, 'CPU': 2, 'Mem': 3}", "'CPU' was not declared; measure 'Mem' was not declared"),
    ],
)
def test_run_data_that_cannot_be_is_refused_and_the_row_does_not_shift(
    execute: Execute, returned: str, problem: str
) -> None:
    executed = execute(f"def populate_run_data(self, context): return {returned}", on_failure="stop")
    assert problem in executed.finished.failures[0]
    assert "populate_run_data of config" in executed.finished.failures[0]
    assert [row["Task"] for row in executed.table] == ["Video", "Network"] * 2


def test_a_measure_that_nobody_gave_is_missing_and_said_to_be(execute: Execute) -> None:
    executed = execute()
    assert [row["Energy"] for row in executed.table] == [""] * 4
    assert {finding.problem for finding in executed.finished.findings} == {"Energy has no value"}


@pytest.mark.long
@pytest.mark.parametrize(
    ("death", "reason"),
    [
        ("os._exit(3)", "the run's process exited with code 3"),
        ("os._exit(0)", "the run's process exited with code 0 before the run had ended"),
        ("os.kill(os.getpid(), 9)", "the run's process was killed by SIGKILL"),
        ("os.kill(os.getpid(), 40)", "the run's process was killed by signal 40"),
        ("faulthandler.disable(); os.abort()", "the run's process was killed by SIGABRT"),
        ("sys.exit(4)", "SystemExit: 4"),
    ],
)
def test_a_run_whose_process_dies_fails_with_the_cause(execute: Execute, death: str, reason: str) -> None:
    executed = execute(
        f"""
        def launch_mission(self, context):
            import faulthandler, os, sys
            if context.run_number == 1: {death}
        """
    )
    assert [row["status"] for row in executed.table] == ["Failed", "Done", "Done", "Done"]
    assert executed.finished.failures == (
        f"r_1: launch_mission{' of config' if 'SystemExit' in reason else ''}: {reason}",
    )


@pytest.mark.long
def test_a_run_that_was_killed_while_the_system_lacked_memory_says_so(
    execute: Execute, monkeypatch: pytest.MonkeyPatch
) -> None:
    kills = chain([4], repeat(5))  # one more while the first run was executed
    monkeypatch.setattr(processes, "memory_kills", lambda: next(kills))
    executed = execute(
        """
        def launch_mission(self, context):
            import os
            if context.run_number < 3: os.kill(os.getpid(), 9)
        """
    )
    killed = "launch_mission: the run's process was killed by SIGKILL"
    assert executed.finished.failures == (
        f"r_1: {killed} (meanwhile the system killed a process for lack of memory)",
        f"r_2: {killed}",
    )


def test_a_run_past_its_deadline_is_told_to_end_and_closes_what_it_opened(execute: Execute) -> None:
    executed = execute(
        """
        def launch_mission(self, context):
            import time
            if context.run_number == 1: time.sleep(60)
        def stop_run(self, context): print("closed")
        """,
        run_deadline_in_s=3,
    )
    assert executed.finished.failures == (
        "r_1: launch_mission of config: the run took longer than run_deadline_in_s = 3 s",
    )
    assert executed.log("r_1").endswith("closed\n")


def test_a_run_that_does_not_end_is_killed_after_the_grace_period(execute: Execute) -> None:
    executed = execute(
        """
        def launch_mission(self, context):
            import signal, time
            signal.signal(signal.SIGTERM, signal.SIG_IGN)
            if context.run_number == 1: time.sleep(60)
        """,
        event_deadline_in_s=3,
        grace_in_s=0.2,
    )
    assert executed.finished.failures == ("r_1: launch_mission: the event took longer than event_deadline_in_s = 3 s",)


def test_a_grandchild_that_holds_the_pipe_does_not_hold_the_experiment(execute: Execute) -> None:
    executed = execute(
        """
        def launch_mission(self, context):
            import os, time
            if os.fork() == 0:
                time.sleep(60)
        """
    )
    assert executed.finished.done_count == 4


def test_a_second_execution_of_a_finished_experiment_executes_nothing(execute: Execute) -> None:
    body = """
        def populate_run_data(self, context):
            return {"Energy": context.attempt}
        """
    execute(body)
    again = execute(body)
    assert again.finished.done_count == 4
    assert [row["Energy"] for row in again.table] == ["1"] * 4


@pytest.mark.long
def test_failed_runs_are_executed_again_when_the_experiment_is_resumed(execute: Execute) -> None:
    body = """
        def populate_run_data(self, context):
            if context.run_id == "r_2" and context.attempt == 1: raise ValueError("flaky")
            return {"Energy": context.attempt}
        """
    assert execute(body).finished.failed_count == 1
    again = execute(body)
    assert again.finished.done_count == 4
    assert [row["Energy"] for row in again.table] == ["1", "2", "1", "1"]


@pytest.mark.long
def test_the_order_of_a_resumed_experiment_is_the_recorded_one(execute: Execute) -> None:
    table = """\
    def create_run_table(self):
        return RunTableModel([Factor("N", range(20))], shuffle=True, data_columns=[])
"""
    first = execute(table=table, run_process="in_process")
    order = [row["N"] for row in first.table]
    assert sorted(order, key=int) != order
    (first.folder / "run_table.csv").unlink()
    (first.folder / "journal.jsonl").unlink()
    again = execute(table=table, run_process="in_process")
    assert [row["N"] for row in again.table] == order
    assert any("all runs are executed again" in each.problem for each in again.finished.findings)


@pytest.mark.long
def test_two_orchestrators_on_one_experiment_are_one_too_many(execute: Execute) -> None:
    body = """
        def before_run(self, context):
            import subprocess, sys
            said = subprocess.run([sys.executable, "-c", SECOND, __file__], capture_output=True, text=True)
            (Path(__file__).parent / "second.txt").write_text(said.stdout + said.stderr)
        """
    head_of_second = (
        "import sys\nfrom pathlib import Path\n"
        "from robot_runner.core.config.preparation import prepare_or_refuse\n"
        "from robot_runner.core.errors import ExecutionError\n"
        "from robot_runner.core.execution.notices import SilentObserver\n"
        "from robot_runner.core.execution.orchestrator import execute_experiment\n"
        "try: execute_experiment(prepare_or_refuse(Path(sys.argv[1])), SilentObserver())\n"
        "except ExecutionError as error: print(error)\n"
    )
    executed = execute(body.replace("SECOND", repr(head_of_second)), on_failure="stop", table=ONE_RUN)
    said = (executed.config.parent / "second.txt").read_text(encoding="utf-8")
    assert "is being executed by process" in said
    assert executed.finished.done_count == 1


@pytest.mark.long
def test_a_fresh_interpreter_that_cannot_load_the_config_says_the_cause(execute: Execute) -> None:
    head = """\
from pathlib import Path
from robot_runner import *
if (Path(__file__).parent / "second").exists(): raise RuntimeError("the camera is busy")
class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "trial"
    results_output_path = "results"
"""
    touch = "def before_experiment(self, context): (Path(__file__).parent / 'second').touch()"
    executed = execute(touch, head=head, run_process="spawn", on_failure="stop")
    (failure,) = executed.journal("failure")
    assert "RuntimeError while it was loaded: the camera is busy" in failure["problem"]
    assert executed.finished.failed_count == 1
    assert "the camera is busy" in executed.finished.failures[0], "that it exited with code 1 is not the cause"


@pytest.mark.long
def test_a_fresh_interpreter_executes_no_other_config_than_the_one_with_which_the_experiment_began(
    execute: Execute,
) -> None:
    body = """
    def before_run(self, context):
        was, is_now = {1: ("LOAD = 1", "LOAD = 1  # kg"), 2: ("LOAD = 1", "LOAD = 5")}.get(context.run_number, "  ")
        file = Path(__file__)
        file.write_text(file.read_text().replace(was, is_now, 1))
    def populate_run_data(self, context): return {"Energy": LOAD}
    """
    executed = execute(body, head=f"LOAD = 1\n{HEAD}", run_process="spawn")
    assert [row["Energy"] for row in executed.table] == ["1", "", "", ""]
    assert all("the line was 'LOAD = 1' and is 'LOAD = 5  # kg'" in each for each in executed.finished.failures)


@pytest.mark.long
def test_a_fresh_interpreter_has_the_experiment_s_name_though_the_config_makes_another_each_time(
    execute: Execute,
) -> None:
    body = """
    experiment_name = f"trial_{time.time_ns()}"
    def launch_mission(self, context): print("moved")
    def populate_run_data(self, context): return {"Energy": context.experiment_name == context.experiment_folder.name}
    """
    executed = execute(body, head=f"import time\n{HEAD}", run_process="spawn", table=ONE_RUN)
    assert [row["Energy"] for row in executed.table] == ["True"]
    assert (executed.folder / "runs" / "r_1" / "log.txt").read_text() == "moved\n"
    assert list(executed.folder.parent.iterdir()) == [executed.folder]


@pytest.mark.long
def test_a_fresh_interpreter_takes_its_library_from_python_whatever_the_folder_that_it_is_started_in_has(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("random", "statistics", "types", "queue"):  # as users name their scripts
        (tmp_path / f"{name}.py").write_text("raise SystemExit('a file of the user was imported')")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "study").mkdir()
    body = "def populate_run_data(self, context): return {'Energy': 1.0}"
    executed = execute_in(tmp_path / "study", body, run_process="spawn", table=ONE_RUN)
    assert [row["status"] for row in executed.table] == ["Done"]


def test_how_a_run_ended_is_known_where_the_end_of_children_is_ignored(execute: Execute) -> None:
    earlier = signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # inherited, or set by a callback or a library
    try:
        executed = execute("def launch_mission(self, context): context.run_number == 2 and __import__('os')._exit(3)")
    finally:
        signal.signal(signal.SIGCHLD, earlier)
    assert [row["status"] for row in executed.table] == ["Done", "Failed", "Done", "Done"]
    assert "exited with code 3" in executed.finished.failures[0]


def test_no_keeper_is_left_when_the_experiment_has_ended(execute: Execute) -> None:
    before = set(children())  # of other tests
    executed = execute("workers = 2\nclaims = []\ndef launch_mission(self, context): pass")
    assert [row["status"] for row in executed.table] == ["Done"] * 4
    assert set(children()) <= before
