"""Several robots take turns: each run takes a free one, each combination each robot equally often."""

from __future__ import annotations

from collections import Counter
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest
from tests.long_cases import soak_but

from robot_runner import ConfigError, Robots
from robot_runner.core.config.preparation import prepare
from robot_runner.core.design.factor import Factor
from robot_runner.core.design.run_table_model import RunTableModel
from robot_runner.core.events.measure import ROBOT
from robot_runner.core.execution.durations import Durations, TimeLeft
from robot_runner.core.execution.resumption import Resumption
from robot_runner.core.execution.side_by_side import _Turns
from robot_runner.core.execution.task import AttemptStatus
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.manifest import read_manifest
from robot_runner.core.storage.run_table_rows import RunTableRows
from robot_runner.core.storage.table_columns import TableLayout
from robot_runner.core.storage.table_schema import read_schema

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

HEAD = """\
from pathlib import Path
from robot_runner import *

class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "trial"
    results_output_path = "results"
    robot = Robots("simulated://alice", "simulated://bob")
    broken = ""
    def populate_run_data(self, context): return {"Energy": context.run_seed}
    def launch_mission(self, context):
        import time
        print(context.robot)
        time.sleep(0.3 if context.robot.endswith("alice") else 0.05)
        if context.robot.endswith(self.broken or "nobody"):
            raise RuntimeError("the wheel is gone.")
"""
TABLE = """
    def create_run_table(self):
        return RunTableModel([Factor("Speed", [1, 2])], repetitions=4, seed=7, data_columns=["Energy"])
"""


def shares(executed: Any) -> Counter[tuple[str, str]]:
    return Counter((row["Speed"], row["Robot"]) for row in executed.table)


@pytest.mark.long
def test_each_combination_is_executed_equally_often_on_each_robot_however_fast_it_is(
    execute: Callable[..., Any],
) -> None:
    executed = execute(head=HEAD, table=TABLE)
    assert set(shares(executed).values()) == {2}
    assert len(shares(executed)) == 4
    for row in executed.table:
        assert executed.log(row["run_id"]) == f"simulated://{row['Robot']}\n"
    manifest = read_manifest(executed.folder / "manifest.json")
    assert manifest["robots"] == {"alice": "simulated://alice", "bob": "simulated://bob"}
    assert {record["place"] for record in executed.journal("attempt_started")} == {"alice", "bob"}
    # Which robot it was comes from no sensor, though the robots are simulated.
    origins = {each.name: each.origin for each in read_schema(executed.folder / "run_table.schema.json")}
    assert origins["Robot"] == "measured"


def test_which_robot_it_was_is_not_doubtful_where_all_that_was_measured_is(execute: Callable[..., Any]) -> None:
    told = "        context.broker.doubt_run(context.owner, 'it was dark', '')\n"
    head = HEAD.replace("        import time\n", f"{told}        import time\n").replace("0.3", "0")
    executed = execute(
        head=f"{head}\n    quality_columns = True\n", table=TABLE.replace("repetitions=4", "repetitions=1")
    )
    assert {(row["Energy.quality"], row["Robot.quality"]) for row in executed.table} == {
        ("doubtful: it was dark", "good")
    }


@pytest.mark.long
def test_an_experiment_that_goes_on_counts_what_each_robot_has_done(execute: Callable[..., Any]) -> None:
    from robot_runner.core.config.preparation import prepare_or_refuse
    from robot_runner.core.execution.notices import SilentObserver
    from robot_runner.core.execution.orchestrator import execute_experiment

    executed = execute("on_failure = FailurePolicy.STOP", head=HEAD, table=TABLE, broken="bob")
    assert executed.finished.failed_count == 1
    experiment = prepare_or_refuse(executed.config)
    execute_experiment(experiment, SilentObserver(), resumption=Resumption(accept_changes=True))
    assert set(shares(executed).values()) == {2}
    assert [row["status"] for row in executed.table] == ["Done"] * 8


@pytest.mark.long
def test_the_manifest_names_every_robot_that_ever_took_turns(execute: Callable[..., Any]) -> None:
    from robot_runner.core.config.preparation import prepare_or_refuse
    from robot_runner.core.execution.notices import SilentObserver
    from robot_runner.core.execution.orchestrator import execute_experiment

    executed = execute("on_failure = FailurePolicy.STOP", head=HEAD, table=TABLE, broken="bob")
    config = executed.config
    config.write_text(config.read_text().replace("simulated://bob", "simulated://carol"))
    execute_experiment(prepare_or_refuse(config), SilentObserver(), resumption=Resumption(accept_changes=True))
    assert {row["Robot"] for row in executed.table} == {"alice", "carol"}
    robots = read_manifest(executed.folder / "manifest.json")["robots"]
    assert robots == {name: f"simulated://{name}" for name in ("alice", "bob", "carol")}


@pytest.mark.long
@pytest.mark.parametrize("again", soak_but({"warm-up runs"}, ["done runs", "excluded runs", "warm-up runs"]))
def test_runs_that_are_executed_again_take_turns_again(execute: Callable[..., Any], again: str) -> None:
    from robot_runner.cli.excluding import exclude_runs
    from robot_runner.core.config.preparation import prepare_or_refuse
    from robot_runner.core.execution.notices import SilentObserver
    from robot_runner.core.execution.orchestrator import execute_experiment

    table = TABLE.replace("seed=7", "seed=7, warm_up=WarmUp(2, each_session=True)")
    executed = execute(head=HEAD.replace("0.3 if", "0.01 if"), table=table if again == "warm-up runs" else TABLE)
    if again == "excluded runs":
        exclude_runs(ExperimentFolder(executed.folder), ["Speed=1"], "the floor was wet")
    redo = ("r_1",) if again == "warm-up runs" else ("Speed=1",)
    execute_experiment(prepare_or_refuse(executed.config), SilentObserver(), resumption=Resumption(redo=redo))
    measured = [row for row in executed.table if row["run_id"].startswith("r_")]
    assert set(Counter((row["Speed"], row["Robot"]) for row in measured).values()) == {2}
    warming_up = [record["place"] for record in executed.journal("attempt_started") if record["run"].startswith("w_")]
    assert Counter(warming_up) == ({"alice": 2, "bob": 2} if again == "warm-up runs" else {})


@pytest.mark.long
def test_a_robot_that_fails_again_and_again_is_set_aside_and_its_runs_go_to_the_other(
    execute: Callable[..., Any],
) -> None:
    executed = execute("attempts = 2", head=HEAD, table=TABLE, broken="bob")
    assert [row["status"] for row in executed.table] == ["Done"] * 8
    assert {row["Robot"] for row in executed.table} == {"alice"}
    began = executed.journal("attempt_started")
    of_bobs = {record["run"] for record in began if record["place"] == "bob"}
    tried = {tuple(each["place"] for each in began if each["run"] == run) for run in of_bobs}
    assert (len(of_bobs), tried) == (3, {("bob", "bob", "alice")}), "all attempts are made where the run began"
    (told,) = [str(finding) for finding in executed.finished.findings if finding.where == "robot bob"]
    assert "3 runs in a row failed on it" in told
    assert ".. It takes part" not in told
    assert "the wheel is gone" in told
    assert [record["place"] for record in executed.journal("set_aside")] == ["bob"]


def test_a_robot_that_fails_one_treatment_takes_no_more_than_its_share_of_that() -> None:
    """It fails sooner than others drive, and succeeds in between: it would take, and lose, most of these runs."""
    model = RunTableModel([Factor("Speed", [1, 2])], repetitions=4, data_columns=[])
    rows = RunTableRows.of_plan(model.plan(), TableLayout.of_model(model, (ROBOT,)))
    alice, bob = SimpleNamespace(name="alice"), SimpleNamespace(name="bob")
    turns, task = _Turns(), SimpleNamespace(combination={"Speed": 1}, repetition=1)
    turns.plan(rows, range(len(rows)))
    for status, is_lost in (("FAILED", False), ("INTERRUPTED", False), ("FAILED", True), ("FAILED", False)):
        assert turns.choose(task, [bob], 2) is bob
        turns.begin(task, bob)
        outcome = SimpleNamespace(status=AttemptStatus[status], is_lost=is_lost)
        turns.end(SimpleNamespace(), task, bob, outcome, 1)
    assert turns.choose(task, [bob], 2) is None
    assert turns.choose(task, [alice, bob], 2) is alice


@pytest.mark.long
def test_a_robot_that_fails_now_and_then_takes_its_share_of_further_repetitions_alone(
    execute: Callable[..., Any],
) -> None:
    head = HEAD.replace("if context.robot.ends", "if context.repetition in {7, 8, 10, 11, 14} and context.robot.ends")
    head = head.replace('"Energy": context.run_seed', '"Energy": context.run_seed % 97').replace("0.3 if", "0.05 if")
    table = TABLE.replace("[1, 2]", "[1]").replace("repetitions=4", "repetitions=5")
    until = 'repeat_until = Precision("Energy", half_width="0.1 %", at_most=16)'
    executed = execute(until, head=head, table=table, broken="bob")
    assert shares(executed) == {("1", "alice"): 8, ("1", "bob"): 8}
    assert {row["Robot"] for row in executed.table if row["status"] == "Failed"} == {"bob"}


@pytest.fixture
def left_is_of_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have the time left be how many runs are to come, divided by how many go on at the same time."""
    monkeypatch.setattr(
        Durations, "left", lambda each: TimeLeft(0.0, sum(each._left.values()) / each.places, is_least=False)
    )


@pytest.mark.long
@pytest.mark.usefixtures("left_is_of_runs")
def test_the_time_left_counts_the_robots_that_are_left_and_the_runs_that_they_execute_again(
    execute: Callable[..., Any],
) -> None:
    executed = execute(head=HEAD, table=TABLE, broken="bob")
    records = executed.journal("set_aside", "attempt_started")
    place = next(place for place, record in enumerate(records) if record["kind"] == "set_aside")
    left = [record["left"]["others"] for record in records[place + 1 :]]
    assert left == [float(number) for number in reversed(range(len(left)))]


@pytest.mark.long
@pytest.mark.usefixtures("left_is_of_runs")
@pytest.mark.parametrize(("claims", "others"), [("[]", 3.5), ("['device:the only lift']", 7.0)])
def test_the_time_left_is_that_of_one_robot_where_all_runs_claim_the_same(
    execute: Callable[..., Any], claims: str, others: float
) -> None:
    executed = execute(f"claims = {claims}", head=HEAD.replace("0.3 if", "0.01 if"), table=TABLE)
    assert executed.journal("attempt_started")[0]["left"]["others"] == others


@pytest.mark.long
@pytest.mark.usefixtures("left_is_of_runs")
def test_the_time_left_remains_that_of_one_robot_where_another_one_is_set_aside(execute: Callable[..., Any]) -> None:
    head = HEAD.replace('"simulated://bob")', '"simulated://bob", "simulated://carol")').replace("0.3 if", "0.01 if")
    executed = execute("claims = ['device:the only lift']", head=head, table=TABLE, broken="bob")
    records = executed.journal("set_aside", "attempt_started")
    place = next(place for place, record in enumerate(records) if record["kind"] == "set_aside")
    left = [record["left"]["others"] for record in records[place + 1 :]]
    assert left == [float(number) for number in reversed(range(len(left)))]


@pytest.mark.long
def test_a_robot_that_fails_in_one_further_repetition_after_another_is_set_aside(execute: Callable[..., Any]) -> None:
    head = HEAD.replace("if context.robot.ends", "if context.repetition > 5 and context.robot.ends")
    head = head.replace('"Energy": context.run_seed', '"Energy": context.run_seed % 97')
    table = TABLE.replace("[1, 2]", "[1]").replace("repetitions=4", "repetitions=5")
    until = 'repeat_until = Precision("Energy", half_width="0.1 %", at_most=12)'
    executed = execute(until, head=head, table=table, broken="bob")
    (aside,) = executed.journal("set_aside")
    assert aside["place"] == "bob"
    failed = [record["run"] for record in executed.journal("attempt_finished") if record["status"] == "failed"]
    assert len(failed) == 3
    assert [row["status"] for row in executed.table] == ["Done"] * 12
    assert {row["Robot"] for row in executed.table if row["run_id"] in failed} == {"alice"}


@pytest.mark.long
def test_the_last_robot_is_never_set_aside(execute: Callable[..., Any]) -> None:
    executed = execute(head=HEAD.replace('or "nobody"', 'or ""'), table=TABLE)
    assert executed.finished.failed_count == 8
    assert len(executed.journal("set_aside")) == 1


@pytest.mark.long
def test_what_cannot_take_turns_is_refused_with_all_findings(write_config: Callable[..., Path]) -> None:
    with pytest.raises(ConfigError) as refused:
        Robots("ros2://alice", "ros2://alice")
    assert "2 robots would be called 'alice'" in str(refused.value)
    with pytest.raises(ConfigError, match="fewer than two"):
        Robots("ros2://alice")
    mixed = HEAD.replace('"simulated://bob"', '"rosbridge://bob:9090"')
    findings = prepare(write_config(head=mixed, table=TABLE)).findings
    assert any("simulated and real robots take turns" in finding.problem for finding in findings)
    looked_for = HEAD.replace('"simulated://bob"', 'bob="auto"')
    findings = prepare(write_config(head=looked_for, table=TABLE)).findings
    assert any("bob would be looked for" in finding.problem for finding in findings)


def test_a_factor_that_is_called_as_the_column_of_robots_is_refused_with_how_it_could_choose_one(
    write_config: Callable[..., Path],
) -> None:
    crossed = TABLE.replace('Factor("Speed", [1, 2])', 'Factor("Robot", ["alice", "bob"])')
    assert crossed != TABLE
    (finding,) = [each for each in prepare(write_config(head=HEAD, table=crossed)).findings if each.is_error]
    assert finding.where == "robot"
    assert "the factor 'Robot' does not choose which one executes a run" in finding.problem
    assert "namespace=treatment('Robot')" in finding.fix


def test_one_robot_is_refused_that_is_named_twice_over_two_links_or_addresses(
    write_config: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "7")
    for first, second, robot in (
        ("dds://alice", "dds:domain=7,namespace=/alice", "domain 7/alice"),
        ("rosbridge://localhost:9090", "rosbridge://127.0.0.1", "rosbridge localhost:9090"),
        ("ros2://alice", "ros2:namespace=/alice", "domain 7/alice"),
        ("ros2://alice", "ros2://alice/", "domain 7/alice"),
        ("ros2://alice", "ros2:namespace=alice", "domain 7/alice"),
        ("ros2://alice", "dds://alice", "domain 7/alice"),
        ("ros2://alice", "ros2:domain=8,namespace=/alice", ""),
        ("ros2://alice", "ros2", ""),
    ):
        head = HEAD.replace('"simulated://alice", "simulated://bob"', f'a="{first}", b="{second}", c="dds://carol"')
        findings = prepare(write_config(head=head, table=TABLE), looks_at_graph=False).findings
        told = [each.problem for each in findings if each.is_error and "one robot" in each.problem]
        problem = f"a and b are one robot ({robot}), which two runs would drive at the same time"
        assert told == ([problem] if robot else [])


def test_a_whole_graph_and_a_robot_on_it_are_refused_as_robots_that_take_turns(
    write_config: Callable[..., Path],
) -> None:
    head = HEAD.replace('"simulated://alice", "simulated://bob"', 'a="dds:domain=7", b="ros2:domain=7,namespace=alice"')
    findings = prepare(write_config(head=head, table=TABLE), looks_at_graph=False).findings
    told = [each.problem for each in findings if each.is_error and "includes" in each.problem]
    assert told == ["a (domain 7) includes b (domain 7/alice), which two runs would drive at the same time"]


@pytest.mark.parametrize(("warm_up", "told"), [("1", 1), ("2", 0), ('WarmUp(1, per="Speed")', 1)])
def test_fewer_warm_up_runs_than_robots_are_a_warning(
    write_config: Callable[..., Path], warm_up: str, told: int
) -> None:
    found = prepare(write_config(head=HEAD, table=TABLE.replace("seed=7", f"seed=7, warm_up={warm_up}"))).findings
    assert ["measure without having warmed up" in finding.problem for finding in found] == [True] * told


@pytest.mark.parametrize(
    ("body", "told"),
    [
        ("plugins = [PsUtil(host='localhost')]", "1 robot of 2 will be idle, as two runs with one claim never overlap"),
        ("run_process = RunProcess.IN_PROCESS", "executes one run at a time, and other robots are idle"),
    ],
)
def test_that_only_one_robot_can_drive_at_a_time_is_a_warning(
    write_config: Callable[..., Path], body: str, told: str
) -> None:
    head = HEAD.replace("import *\n", "import *\nfrom robot_runner.plugins.profilers import PsUtil\n", 1)
    found = [each for each in prepare(write_config(body, head=head, table=TABLE)).findings if told in each.problem]
    assert [each.where.rpartition(".")[2] for each in found] == ["robot"]


def test_robots_may_be_the_blocks_of_the_analysis(write_config: Callable[..., Path]) -> None:
    plan = 'analysis = AnalysisPlan(measures=["Energy"], blocks="Robot")'
    assert prepare(write_config(plan, head=HEAD, table=TABLE)).findings == ()
    alone = prepare(
        write_config(
            plan, head=HEAD.replace('Robots("simulated://alice", "simulated://bob")', '"simulated"'), table=TABLE
        )
    )
    assert [finding.problem for finding in alone.findings] == [
        "there is no factor 'Robot' whose treatments could be blocks"
    ]
