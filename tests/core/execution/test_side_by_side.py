"""Several runs are in flight at once where nothing that they claim keeps them apart, and nothing else changes."""

from __future__ import annotations

import itertools
from datetime import datetime
from typing import TYPE_CHECKING, Any
from unittest.mock import Mock

import pytest

from robot_runner.core.config.preparation import prepare
from robot_runner.core.errors import ExecutionError
from robot_runner.core.execution.experiment_status import read_status
from robot_runner.core.execution.left_processes import RunsElsewhere
from robot_runner.core.execution.notices import AttemptStarted, FindingsNoticed
from robot_runner.core.execution.side_by_side import SideBySide

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

EIGHT = """
    def create_run_table(self):
        return RunTableModel([Factor("Speed", [1, 2, 3, 4])], repetitions=2, seed=7, data_columns=["Energy"])
"""
WAITING = """
claims = []
def launch_mission(self, context):
    import time
    print(f"{context.run_id} waits")
    time.sleep(0.3)
def populate_run_data(self, context): return {"Energy": context.run_seed + context.combination["Speed"]}
"""
#: Has a mission last until something is so, in the process of its run.
UNTIL = """
def until(is_so):
    import time
    deadline = time.monotonic() + 60
    while not is_so():
        assert time.monotonic() < deadline
        time.sleep(0.01)
"""
#: The first missions of a kind last until as many have begun, as a busy machine begins one long after another.
TOGETHER = (
    UNTIL
    + """
claims = []
def launch_mission(self, context):
    print(f"{context.run_id} waits")
    kind, most = ("measured", 4) if context.repetition else ("warm-up", 2)
    folder = Path(__file__).parent
    (folder / f"{kind} {context.run_id}").touch()
    RobotRunnerConfig.until(lambda: len(list(folder.glob(f"{kind} *"))) >= most)
def populate_run_data(self, context): return {"Energy": context.run_seed + context.combination["Speed"]}
"""
)


def spans(executed: Any) -> dict[tuple[str, int], tuple[float, float]]:
    """Return when each attempt began and ended, s."""
    begun, ended = {}, {}
    for record in executed.journal("attempt_started", "attempt_finished"):
        moments = begun if record["kind"] == "attempt_started" else ended
        moments[record["run"], record["attempt"]] = datetime.fromisoformat(record["at"]).timestamp()
    return {key: (begun[key], ended[key]) for key in ended}


def most_in_flight(executed: Any) -> int:
    moments = spans(executed).values()
    return max(sum(begun <= at < ended for begun, ended in moments) for at, _ in moments)


def overlap(one: tuple[float, float], other: tuple[float, float]) -> bool:
    return one[0] < other[1] and other[0] < one[1]


def test_as_many_runs_are_in_flight_as_there_are_workers_and_each_says_where(execute: Callable[..., Any]) -> None:
    executed = execute(TOGETHER, table=EIGHT, workers=4)
    assert [row["status"] for row in executed.table] == ["Done"] * 8
    assert most_in_flight(executed) == 4
    places = [(record["place"], record.get("slot", 1)) for record in executed.journal("attempt_started")]
    assert set(places) == {(f"slot {number}", number) for number in (1, 2, 3, 4)}
    assert {row["run_id"]: executed.log(row["run_id"]) for row in executed.table} == {
        f"r_{number}": f"r_{number} waits\n" for number in range(1, 9)
    }
    assert not list(executed.folder.glob("current_log*"))


def test_one_worker_is_what_it_was(execute: Callable[..., Any]) -> None:
    executed = execute(WAITING, table=EIGHT)
    assert most_in_flight(executed) == 1
    assert not any({"place", "slot"} & set(record) for record in executed.journal("attempt_started"))


def test_a_config_that_declares_no_claims_has_the_machine_to_itself(
    execute: Callable[..., Any], tmp_path: Path
) -> None:
    executed = execute(WAITING.replace("claims = []", ""), table=EIGHT, workers=4)
    assert most_in_flight(executed) == 1
    preparation = prepare(tmp_path / "config.py", {"workers": "4"})
    told = next(str(finding) for finding in preparation.findings if "idle" in finding.problem)
    assert "3 workers of 4 will be idle" in told
    assert "host:localhost is claimed by config" in told
    assert "say claims = []" in told


def test_a_run_that_the_orchestrator_executes_itself_is_alone(execute: Callable[..., Any], tmp_path: Path) -> None:
    body = f"run_process = RunProcess.IN_PROCESS\n{WAITING}"
    executed = execute(body, table=EIGHT, workers=4)
    assert most_in_flight(executed) == 1
    findings = prepare(tmp_path / "config.py", {"workers": "4"}).findings
    assert any("IN_PROCESS" in finding.problem and "idle" in finding.problem for finding in findings)


PORTS = """\
from pathlib import Path
from robot_runner import *
from robot_runner.plugins import System

class Lamp(System):
    def __init__(self, port, *, name=None):
        super().__init__(name=name)
        self.port = port
    def claims(self, robot):
        return [f"serial:{self.port}"]
    def launch_mission(self, context):
        import time
        context.share(port=self.port)
        begun, deadline = Path(__file__).with_name(f"begun {self.port}"), time.monotonic() + 60
        begun.touch()
        while len(list(begun.parent.glob("begun *"))) < 2:  # until one begins that has another claim
            assert time.monotonic() < deadline
            time.sleep(0.01)
        time.sleep(0.2)

class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "trial"
    results_output_path = "results"
    claims = []
    plugins = [Lamp(treatment("Port"))]
"""


def test_runs_with_one_claim_never_overlap_and_others_do(execute: Callable[..., Any]) -> None:
    table = """
    def create_run_table(self):
        return RunTableModel([Factor("Port", ["a", "b"])], repetitions=3, randomise=False)
    """.replace(", randomise=False", "")
    executed = execute("", head=PORTS, table=table, workers=3)
    port = {row["run_id"]: row["Port"] for row in executed.table}
    moments = {run: span for (run, _), span in spans(executed).items()}
    pairs = list(itertools.combinations(moments, 2))
    assert not any(overlap(moments[one], moments[other]) for one, other in pairs if port[one] == port[other])
    assert any(overlap(moments[one], moments[other]) for one, other in pairs if port[one] != port[other])


def test_what_a_failed_run_leads_to_is_the_same_with_several_in_flight(execute: Callable[..., Any]) -> None:
    body = """
    claims = []
    attempts = 2
    def launch_mission(self, context):
        import time
        if context.combination["Speed"] == 2 and context.attempt == 1:
            raise RuntimeError("the wheel slipped")
        if context.combination["Speed"] == 3:
            raise RuntimeError("the wheel is gone")
        time.sleep(0.1)
    def populate_run_data(self, context): return {"Energy": context.run_seed}
    """
    executed = execute(body, table=EIGHT, workers=4)
    statuses = {row["Speed"]: row["status"] for row in executed.table}
    assert statuses == {"1": "Done", "2": "Done", "3": "Failed", "4": "Done"}
    attempts = [record["run"] for record in executed.journal("attempt_started")]
    assert sorted(map(attempts.count, set(attempts))) == [1, 1, 1, 1, 2, 2, 2, 2]
    assert executed.finished.failed_count == 2


def test_stop_begins_no_more_runs_and_lets_those_in_flight_end(execute: Callable[..., Any]) -> None:
    body = f"""{UNTIL}
claims = []
on_failure = FailurePolicy.STOP
def launch_mission(self, context):
    folder, journal = Path(__file__).parent, context.experiment_folder / "journal.jsonl"
    (folder / f"begun {{context.run_id}}").touch()
    if context.run_id == "r_1":
        RobotRunnerConfig.until(lambda: len(list(folder.glob("begun *"))) == 3)
        raise RuntimeError("enough")
    RobotRunnerConfig.until(lambda: "attempt_finished" in journal.read_text())
"""
    executed = execute(body, table=EIGHT, workers=3)
    assert [row["status"] for row in executed.table] == ["Failed", "Done", "Done", *["-"] * 5]
    assert executed.finished.stopped_by == "on_failure"


#: The first run fails once the second one waits for something before it begins.
ONE_FAILS = f"""{UNTIL}
claims = []
on_failure = FailurePolicy.STOP
def launch_mission(self, context):
    waits = Path(__file__).parent / "waits"
    journal = context.experiment_folder / "journal.jsonl"
    RobotRunnerConfig.until(lambda: waits.exists() or '"waiting","at"' in journal.read_text())
    raise RuntimeError("enough")
"""
TURN = """\
from pathlib import Path
from robot_runner import *

class Turn(Condition):
    is_outside = True
    def __str__(self):
        return "it is its turn"
    def watch(self, context, opened):
        is_first = context.run_id == "r_1"
        if not is_first: (Path(__file__).parent / "waits").touch()
        return lambda: Look(is_first, "another one's")

class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "trial"
    results_output_path = Path("results")
"""


def test_a_gate_is_not_awaited_any_more_once_no_more_runs_begin(execute: Callable[..., Any]) -> None:
    gate = "gates = [Gate(Turn(), timeout_s=1, on_timeout=GatePolicy.WAIT)]"
    executed = execute(f"{ONE_FAILS}{gate}", head=TURN, table=EIGHT, workers=2)
    assert [row["status"] for row in executed.table] == ["Failed", *["-"] * 7]
    assert executed.finished.stopped_by == "on_failure"
    last = [each for each in executed.journal("gate") if each["run"] == "r_2"][-1]
    assert (last["state"], last["problem"]) == ("interrupted", "no more runs begin")


def test_nobody_is_asked_for_a_step_any_more_once_no_more_runs_begin(execute: Callable[..., Any]) -> None:
    step = 'operator_steps = [OperatorStep("place it", before={"Speed": [2, 3, 4]})]'
    executed = execute(f"{ONE_FAILS}{step}", table=EIGHT, workers=2)
    assert [row["status"] for row in executed.table] == ["Failed", *["-"] * 7]
    assert executed.finished.stopped_by == "on_failure"
    assert executed.journal("operator_step") == []


def test_no_rest_is_kept_once_no_more_runs_begin(execute: Callable[..., Any]) -> None:
    body = ONE_FAILS.replace("    waits =", "    if context.run_id != 'r_1': return\n    waits =")
    body = body.replace('\'"waiting","at"\' in', '\'"attempt_finished","at"\' in')
    executed = execute(body, table=EIGHT, workers=2, time_between_runs_in_ms=1_000_000)
    assert [row["status"] for row in executed.table] == ["Failed", "Done", *["-"] * 6]
    assert executed.finished.seconds < 500


def test_what_warms_up_is_over_before_anything_is_measured(execute: Callable[..., Any]) -> None:
    table = EIGHT.replace("repetitions=2,", "repetitions=2, warm_up=WarmUp(2),")
    executed = execute(TOGETHER, table=table, workers=4)
    warm = [record["run"] for record in executed.journal("attempt_started") if record["repetition"] == 0]
    moments = {run: span for (run, _), span in spans(executed).items()}
    assert len(warm) == 2
    last = max(moments[run][1] for run in warm)
    assert all(moments[run][0] >= last for run in set(moments) - set(warm))
    assert most_in_flight(executed) == 4


#: Tells when as many runs as there are places are at the same step: a busy machine starts one long after another.
GATHERED = """
def gathered(run_id, places):
    folder = Path(__file__).parent / f"gathered by {places}"
    folder.mkdir(exist_ok=True)
    (folder / run_id).touch()
    wanted = -(-len(list(folder.iterdir())) // places) * places
    return lambda: len(list(folder.iterdir())) >= wanted
"""


@pytest.mark.long
def test_each_place_rests_and_gates_are_awaited_side_by_side(execute: Callable[..., Any]) -> None:
    head = PORTS.replace(
        "class Lamp",
        GATHERED
        + """
class Company(Condition):
    is_outside = True
    def __str__(self):
        return "four are waiting at once"
    def watch(self, context, opened):
        are_four = gathered(context.run_id, 4)
        return lambda: Look(are_four(), "waiting")

class Lamp""",
    ).replace("""    plugins = [Lamp(treatment("Port"))]\n""", "    gates = [Gate(Company(), timeout_s=60)]\n")
    executed = execute(WAITING, head=head, table=EIGHT, workers=4, time_between_runs_in_ms=300)
    assert [row["status"] for row in executed.table] == ["Done"] * 8
    waits = [record for record in executed.journal("gate") if record["state"] == "open"]
    assert len(waits) == 8


@pytest.mark.long
def test_values_of_simulated_runs_do_not_depend_on_the_number_of_workers(execute: Callable[..., Any]) -> None:
    head = (
        PORTS.replace(
            "from robot_runner.plugins import System",
            """
from robot_runner.plugins.profilers import Ina219
from robot_runner.plugins.systems import BasicTurtlebot3
""",
        ).partition("class Lamp")[0]
        + GATHERED
        + """
SHORT = dict(sleep_s=0.5, drive_s=2.0, task_s=1.0, rotate_s=2.0)

class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "trial"
    results_output_path = "results"
    robot = "simulated"
    plugins = [BasicTurtlebot3(speed=treatment("Speed"), task="Video", **SHORT), Ina219()]
"""
    )
    table = """
    def create_run_table(self):
        return RunTableModel([Factor("Speed", [0.1, 0.2])], repetitions=2, seed=3)
    """
    tables = []
    gathering = """
    def start_run(self, context):
        import time
        are_all, deadline = gathered(context.run_id, self.workers), time.monotonic() + 60
        while not are_all():
            assert time.monotonic() < deadline
            time.sleep(0.01)
    """
    for workers in (1, 2, 4):
        executed = execute(gathering, head=head, table=table, workers=workers, results_output_path=f"results{workers}")
        rows = [{name: cell for name, cell in row.items() if not name.endswith("_at")} for row in executed.table]
        tables.append(rows)
        assert most_in_flight(executed) == workers
        samples = sorted(path.relative_to(executed.folder) for path in executed.folder.glob("runs/*/Ina219/*"))
        tables.append([(str(path), (executed.folder / path).read_bytes()) for path in samples])
    assert tables[0] == tables[2] == tables[4]
    assert tables[1] == tables[3] == tables[5]
    assert all(row["Energy"] for row in tables[0])


def test_status_and_notices_tell_of_places(execute: Callable[..., Any]) -> None:
    executed = execute(WAITING, table=EIGHT, workers=2)
    started = [notice.task for notice in executed.notices if isinstance(notice, AttemptStarted)]
    assert {task.place for task in started} == {"slot 1", "slot 2"}
    status = read_status(executed.folder)
    assert status.done == 8
    assert status.in_flight == ()


def test_where_the_end_of_one_run_fails_the_others_are_ended_all_the_same() -> None:
    ended: list[str] = []

    def steps(name: str) -> Iterator[None]:
        try:
            yield
        finally:
            ended.append(name)
            if name == "second":
                raise OSError("no disk")

    side = SideBySide.__new__(SideBySide)
    side._busy = [Mock(steps=steps(name)) for name in ("first", "second", "third")]
    for each in side._busy:
        next(each.steps)
    with pytest.raises(OSError, match="no disk"):
        side._let_go()
    assert set(ended) == {"first", "second", "third"}


KILLED_ELSEWHERE = RunsElsewhere("cluster tcp://scheduler:8786", 0.4)


def test_runs_that_may_go_on_elsewhere_are_told_of_and_awaited_before_one_is_begun_here(
    execute: Callable[..., Any], tmp_path: Path
) -> None:
    mark = tmp_path / "results" / "trial" / ".probe-0123456789abcdef"
    mark.parent.mkdir(parents=True)
    mark.write_bytes(KILLED_ELSEWHERE.content())
    mark.with_name(f"{mark.name}-fedcba9876543210").touch()
    executed = execute("")
    assert executed.finished.done_count == 4
    told = [str(each) for notice in executed.notices if isinstance(notice, FindingsNoticed) for each in notice.findings]
    assert told[0].startswith(
        "cluster tcp://scheduler:8786: an earlier execution was killed; its runs may go on there for 0.4 s, and none "
        "is begun before that"
    )
    began, first = (
        datetime.fromisoformat(executed.journal(kind)[0]["at"]) for kind in ("experiment_started", "attempt_started")
    )
    assert (first - began).total_seconds() >= 0.4
    assert not list(mark.parent.glob(".probe-*"))


def test_who_interrupts_that_wait_has_the_next_session_wait_as_well(
    execute: Callable[..., Any], tmp_path: Path
) -> None:
    mark = tmp_path / "results" / "trial" / ".probe-0123456789abcdef"
    mark.parent.mkdir(parents=True)
    mark.write_bytes(RunsElsewhere("cluster tcp://scheduler:8786", 600.0).content())
    executed = execute("def before_experiment(self): import os, signal; os.kill(os.getpid(), signal.SIGINT)")
    assert executed.finished.interrupted
    assert not executed.journal("attempt_started")
    assert mark.exists()


def test_nobody_waits_where_nothing_is_left_to_execute(execute: Callable[..., Any]) -> None:
    folder = execute("").folder
    mark = folder / ".probe-0123456789abcdef"
    mark.write_bytes(RunsElsewhere("cluster tcp://scheduler:8786", 600.0).content())
    assert execute("").finished.done_count == 4


def test_places_that_come_and_go_are_told_where_nothing_is_in_flight_as_none_of_them_suits() -> None:
    run, place, told = Mock(run_id="r_1"), Mock(is_unavailable=False), []

    def advance(*, is_idle: bool = False) -> list[str]:
        told.append(is_idle)
        if len(told) > 2:
            raise ExecutionError("nobody offers it", where="cluster", fix="")
        return []

    place.claimed.return_value = None
    parameters = Mock(robots={}, cluster="tcp://scheduler:8786", gates=[], operator_steps=[], hosts={})
    ongoing = Mock(is_ending=False, experiment=Mock(parameters=parameters))
    ongoing.experiment.model.design_facts = {}
    ongoing.progress.pending.return_value = iter([run])
    places = Mock(all=[place], descriptors=[0], due=None, advance=advance)
    with pytest.raises(ExecutionError, match="nobody offers it"):
        SideBySide(ongoing, places, lambda *_: frozenset()).execute(is_cleared=False)
    assert told == [True] * 3
