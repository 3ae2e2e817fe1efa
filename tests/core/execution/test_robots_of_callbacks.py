"""A robot that a callback commands by itself (`open_robot`) is claimed, so that nobody else commands it meanwhile."""

from __future__ import annotations

import inspect
import os
import signal
import subprocess
import sys
from contextlib import ExitStack, contextmanager, nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, cast

import pytest

from robot_runner.core.config.claims import Claims
from robot_runner.core.config.preparation import prepare_or_refuse
from robot_runner.core.errors import LinkError
from robot_runner.core.execution.callback_claims import claims_of_run
from robot_runner.core.execution.local_places import places_of
from robot_runner.core.links import commanded_topics
from robot_runner.core.links.commanded_topics import tell_commanded
from robot_runner.core.links.connect import open_robot
from robot_runner.core.links.graph_names import full_name
from robot_runner.core.links.robot_claims import RobotClaims
from robot_runner.core.storage.claim_locks import HeldClaims, claim_holders
from robot_runner.ros.graph_links import GraphLinkKind
from robot_runner.testing import FakeClock, FakeRobotLink

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from robot_runner.core.execution.task import RunTask

BOB = "robot:domain 7/bob"
TWIST = "geometry_msgs/Twist"


class Telling(FakeRobotLink):
    """A link that tells what it commands, as all links to a graph do."""

    def __init__(self, graph: str, namespace: str) -> None:
        super().__init__(FakeClock())
        self._graph, self._namespace = graph, namespace

    def publish(self, topic: str, message_type: str, message: Any, **qos: Any) -> None:
        tell_commanded(full_name(self._namespace, topic), message_type, self._graph)
        super().publish(topic, message_type, message, **qos)


@contextmanager
def driving(robot: str, namespace: str = "", topic: str = "cmd_vel") -> Iterator[None]:
    with open_robot(robot, namespace=namespace) as (link, _):
        link.publish(topic, "geometry_msgs/Twist", {})
        yield


#: A config's own copy of it: a fresh interpreter, which executes a run, has not loaded this test.
HEAD = f"""\
from __future__ import annotations
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from robot_runner import *
from robot_runner.core.links.commanded_topics import tell_commanded
from robot_runner.core.links.graph_names import full_name
from robot_runner.plugins import open_robot
from robot_runner.ros.graph_links import GraphLinkKind
from robot_runner.testing import FakeClock, FakeRobotLink

HERE = Path(__file__).parent

{inspect.getsource(Telling)}
{inspect.getsource(driving)}
GraphLinkKind.open_clock = lambda *_, **__: FakeClock()
GraphLinkKind.open = lambda _, name, clock, namespace="": Telling(name.graph, namespace)

class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "trial"
    results_output_path = HERE
    event_deadline_in_s = 60
"""
TABLE = """
    def create_run_table(self):
        return RunTableModel([Factor("Place", ["hall", "lab"])], repetitions=1, seed=7)
"""
OPENS = """
    robot = "simulated"
    def launch_mission(self, context):
        with driving("ros2:domain=7,namespace=bob"), driving("dds:domain=7", namespace="/bob/"):
            pass
"""
HOLDING = """
import sys
from pathlib import Path
from robot_runner.core.storage.claim_locks import HeldClaims
with HeldClaims([sys.argv[1]], "other", Path("/results/other")):
    print("held", flush=True)
    sys.stdin.read()
"""


@pytest.fixture(autouse=True)
def _no_graph(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.setenv("ROBOT_RUNNER_LOCKS", "")
    monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)
    monkeypatch.delenv("ROS_MASTER_URI", raising=False)
    monkeypatch.setattr(GraphLinkKind, "open_clock", lambda *_, **__: FakeClock())
    monkeypatch.setattr(GraphLinkKind, "open", lambda _, name, clock, namespace="": Telling(name.graph, namespace))


@contextmanager
def held_by_another(claim: str = BOB) -> Iterator[subprocess.Popen[str]]:
    with subprocess.Popen(
        [sys.executable, "-c", HOLDING, claim], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == "held\n"
        yield other
        other.kill()


def of_experiment(claimed: tuple[str, ...] = (), *, is_run: bool = False, name: str = "trial") -> RobotClaims:
    return RobotClaims(
        name,
        Path("/results", name),
        claimed=lambda: claimed,
        declared=["host:localhost"],
        goes_on=lambda _: False,
        tell=lambda _: None,
        is_run=is_run,
    )


@pytest.mark.long
@pytest.mark.parametrize(
    ("robot", "claim"),
    [
        ("ros2://bob", "robot:domain 0/bob"),
        ("dds:namespace=/bob/", "robot:domain 0/bob"),
        ("ros2", "robot:domain 0/bob"),  # any robot of its graph
        ("ros1:namespace=bob", "robot:master localhost:11311/bob"),
        ("rosbridge://127.0.0.1:9090", "robot:rosbridge localhost:9090"),
        ("rosbridge+tls://localhost:9090", "robot:rosbridge localhost:9090"),
    ],
)
def test_a_robot_that_another_experiment_has_is_refused_however_it_is_named(robot: str, claim: str) -> None:
    with held_by_another(claim) as other, of_experiment():
        with pytest.raises(LinkError) as refused, driving(robot):
            raise AssertionError("it was not refused")
        assert f"in use by the experiment 'other' in /results/other (process {other.pid}" in refused.value.problem
        assert refused.value.where == f"open_robot('{robot}')"
        assert refused.value.fix.startswith("Name it in the config: claims = ['host:localhost', 'robot:")
        other.kill()
        other.wait()
        with driving(robot):  # a killed process leaves no claim
            pass


@pytest.mark.long
def test_outside_of_an_experiment_nothing_is_claimed_or_refused() -> None:
    with held_by_another(), driving("ros2:domain=7,namespace=bob"), open_robot("simulated"):
        pass
    with driving("ros2:domain=8,namespace=bob"):
        assert claim_holders_elsewhere("robot:domain 8/bob") == ""


def claim_holders_elsewhere(claim: str) -> str:
    """Return the experiment that another process finds to hold a claim: who looks at its own lock loses it."""
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        os.write(writer, "".join(each.experiment for each in claim_holders([claim]).values()).encode())
        os._exit(0)
    os.close(writer)
    os.waitpid(child, 0)
    with os.fdopen(reader) as said:
        return said.read()


def test_a_simulated_robot_is_not_claimed(tmp_path: Path) -> None:
    with of_experiment(), driving("simulated"):
        assert not (tmp_path / "state").exists()


def test_what_was_claimed_beforehand_is_not_in_the_way_nor_are_its_files_opened() -> None:
    own = "robot:domain 7/alice"
    with HeldClaims([own], "trial", Path("/results/trial")), of_experiment((own,)):
        for robot in (
            "ros2:domain=7,namespace=alice",
            "dds:domain=7,namespace=alice",
            "ros2:domain=7,namespace=alice/arm",
        ):
            with driving(robot):
                pass
        with driving("ros2:domain=7", topic="/alice/cmd_vel"):
            pass
        with driving("ros2:domain=7"):  # the whole graph, with that robot
            assert claim_holders_elsewhere("robot:domain 7") == "trial"
        assert claim_holders_elsewhere(own) == "trial"


def test_a_claim_is_held_until_the_last_link_of_a_callback_is_closed_and_in_a_run_until_that_ends() -> None:
    with of_experiment(), ExitStack() as first:
        first.enter_context(driving("ros2:domain=7,namespace=bob"))
        with driving("dds:domain=7,namespace=bob/arm"), driving("dds:domain=7,namespace=bob"):
            first.close()
            assert claim_holders_elsewhere(BOB) == "trial"
        assert claim_holders_elsewhere(BOB) == ""
        with of_experiment(is_run=True, name="run"):
            with driving("ros2:domain=7,namespace=bob"):
                pass
            assert claim_holders_elsewhere(BOB) == "run"
        assert claim_holders_elsewhere(BOB) == ""


@pytest.mark.long
def test_who_only_looks_at_a_robot_or_a_world_is_in_nobodys_way_and_is_not_refused() -> None:
    """A camera that two runs share, the graph of the robots of others, a simulator that is asked to put a box."""
    with held_by_another(), of_experiment(is_run=True):
        for robot in ("ros2:domain=7,namespace=bob", "ros2:domain=7"):
            with open_robot(robot) as (link, _):
                link.subscribe("odom", "nav_msgs/Odometry", lambda _: None)
                link.topics()
            with driving("ros2:domain=7", topic="/carol/cmd_vel"):  # beside bob, by a link to the whole graph
                pass
        assert claim_holders_elsewhere("robot:domain 7/carol") == "trial"
        assert claim_holders_elsewhere("robot:domain 7") == ""


def test_a_robot_that_an_absolute_name_reaches_over_the_link_to_another_is_claimed_as_well() -> None:
    with held_by_another(), of_experiment(("robot:domain 7/alice",)):
        with (
            pytest.raises(LinkError, match="in use by"),
            driving("ros2:domain=7,namespace=alice", topic="/bob/cmd_vel"),
        ):
            pass
        with driving("ros2:domain=7,namespace=alice", topic="/carol/arm/cmd_vel"):
            assert claim_holders_elsewhere("robot:domain 7/carol/arm") == "trial"
        with driving("ros2:domain=7,namespace=alice", topic="/cmd_vel"):  # of which robot is not told by its name
            assert claim_holders_elsewhere("robot:domain 7") == ""


@pytest.mark.long
def test_what_is_refused_is_told_to_no_standby_and_what_the_run_itself_reaches_is_not_looked_at(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    heard: list[str] = []
    monkeypatch.setattr(commanded_topics, "_listeners", [lambda each: heard.append(each.topic)])
    with held_by_another(), of_experiment():
        with pytest.raises(LinkError, match="in use by"), driving("ros2:domain=7,namespace=bob"):
            pass
        assert heard == []
        tell_commanded("/bob/cmd_vel", TWIST, "ros2:domain=7")
        assert heard == ["/bob/cmd_vel"]


def test_a_link_that_is_closed_after_its_run_has_ended_harms_nothing() -> None:
    with ExitStack() as late:
        with of_experiment(is_run=True):
            late.enter_context(driving("ros2:domain=7,namespace=bob"))
        assert claim_holders_elsewhere(BOB) == ""


def test_a_robot_that_cannot_be_reached_is_claimed_by_nobody(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise LinkError("nobody answers")

    monkeypatch.setattr(GraphLinkKind, "open", fail)
    with of_experiment():
        with pytest.raises(LinkError, match="nobody answers"), driving("ros2:domain=7,namespace=bob"):
            pass
        assert claim_holders_elsewhere(BOB) == ""


@pytest.mark.long
def test_where_others_cannot_be_kept_out_it_is_said_and_the_robot_is_reached(
    monkeypatch: pytest.MonkeyPatch, execute: Callable[..., Any], tmp_path: Path
) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "file"))
    executed = execute(OPENS, head=HEAD, table=TABLE)
    told = [each["problem"] for each in executed.journal("finding")]
    assert [each.partition(":")[0] for each in told] == ["other experiments that claim robot"] * 2, told
    assert executed.finished.done_count == 2


@pytest.mark.long
@pytest.mark.parametrize("process", ["fork", "spawn", "in_process"])
def test_runs_one_after_another_reach_the_same_robot_twice_each(
    process: str, execute: Callable[..., Any], tmp_path: Path
) -> None:
    executed = execute(OPENS, head=HEAD, table=TABLE, run_process=process)
    assert executed.finished.failures == ()
    assert claim_holders_elsewhere(BOB) == ""
    assert [each.name for each in (tmp_path / "state").rglob("robot*bob")] == ["robot%3Adomain%207%2Fbob"]


@pytest.mark.long
def test_of_two_runs_in_flight_one_reaches_the_robot_and_the_other_fails_with_what_to_do(
    execute: Callable[..., Any],
) -> None:
    body = """
    robot = "simulated"
    workers = 2
    def launch_mission(self, context):
        import time
        mine = HERE / "opened"
        while context.run_number == 2 and not mine.exists(): time.sleep(0.01)
        with driving("ros2:domain=7,namespace=bob"):
            mine.touch()
        while context.run_number == 1 and not (HERE / "refused").exists(): time.sleep(0.01)
    def stop_run(self, context):
        if context.run_number == 2: (HERE / "refused").touch()
    """
    executed = execute(body, head=HEAD, table=TABLE)
    (failure,) = executed.finished.failures
    assert "r_2" in str(failure)
    assert f"{BOB} is in use by the experiment 'trial'" in str(failure)
    assert "claims = ['robot:domain 7/bob']" in executed.log("r_2")


@pytest.mark.long
def test_runs_with_the_claim_wait_for_each_other(execute: Callable[..., Any]) -> None:
    body = f"{OPENS}\n    workers = 2\n    claims = ['robot:ros2:domain=7,namespace=bob']"
    executed = execute(body, head=HEAD, table=TABLE)
    assert executed.finished.failures == ()


@pytest.mark.long
@pytest.mark.parametrize(("claims", "is_refused"), [([], True), ([BOB], False)])
def test_a_robot_of_several_that_take_turns_is_not_reached_beside_its_own_run(
    write_config: Callable[..., Path], claims: list[str], *, is_refused: bool
) -> None:
    body = f"""
    robot = Robots("dds:domain=7,namespace=alice", "dds:domain=7,namespace=bob")
    claims = {claims}
    def launch_mission(self, context): pass
    """
    config = write_config(body, head=HEAD, table=TABLE)
    experiment = prepare_or_refuse(config, looks_at_graph=False)
    (place, *_) = places_of(experiment, Claims(experiment.parameters, (), experiment.events), [{}]).all
    task = cast("RunTask", SimpleNamespace(combination={"Place": "lab"}))
    with held_by_another(), claims_of_run(place.experiment, task, lambda *_: None), ExitStack() as opened:
        opened.enter_context(driving("dds:domain=7,namespace=alice"))
        with pytest.raises(LinkError, match="in use by") if is_refused else nullcontext():
            opened.enter_context(driving("dds:domain=7,namespace=bob"))


@pytest.mark.long
def test_what_a_callback_of_the_orchestrator_has_opened_its_runs_may_reach_and_others_may_not(
    execute: Callable[..., Any],
) -> None:
    body = """
    def before_experiment(self):
        self.link = driving("ros2:domain=7,namespace=bob")
        self.link.__enter__()
    def launch_mission(self, context):
        with driving("dds:domain=7,namespace=bob"): pass
        import subprocess, sys
        asked = "from robot_runner.core.storage.claim_locks import claim_holders; print(claim_holders(['%s']))"
        print(subprocess.run([sys.executable, "-c", asked % "robot:domain 7/bob"], capture_output=True, text=True))
    def after_experiment(self):
        self.link.__exit__(None, None, None)
    """
    executed = execute(body, head=HEAD, table=TABLE)
    assert executed.finished.failures == ()
    assert "experiment='trial'" in executed.log("r_1")
    assert f"pid={os.getpid()}" in executed.log("r_1")
    assert claim_holders_elsewhere(BOB) == ""


@pytest.mark.long
@pytest.mark.parametrize("process", ["fork", "in_process"])
def test_a_link_that_the_orchestrator_leaves_open_is_closed_before_others_may_have_its_robot(
    process: str, execute: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    held: list[str] = []
    monkeypatch.setattr(Telling, "close", lambda _: held.append(claim_holders_elsewhere(BOB)))
    body = """
    def before_experiment(self):
        global link
        link = driving("ros2:domain=7,namespace=bob")
        link.__enter__()
    """
    head = HEAD.replace("GraphLinkKind.open", "GraphLinkKind._unused")  # this test's own, which it looks at
    executed = execute(body, head=head, table=TABLE, run_process=process)
    assert executed.finished.done_count == 2
    assert held == ["trial"]
    assert claim_holders_elsewhere(BOB) == ""


@pytest.mark.long
def test_a_run_that_is_killed_leaves_no_claim(execute: Callable[..., Any]) -> None:
    body = """
    robot = "simulated"
    attempts = 2
    def launch_mission(self, context):
        import os
        with driving("ros2:domain=7,namespace=bob"):
            if context.attempt == 1: os.kill(os.getpid(), 9)
    """
    executed = execute(body, head=HEAD, table=TABLE)
    assert executed.finished.done_count == 2
    assert signal.SIGKILL.name in str(executed.journal())
