"""A simulator is reset before a run and seen to be reset; one that is not fails the run and says why, in time."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
import time
from contextlib import closing

import pytest
from tests.processor_wait import ProcessorWait
from tests.ros.dds_domain import LOOPBACK, claim_domain
from tests.ros.simulators.faithful_simulator import FaithfulSimulator
from tests.waiting import PATIENCE, wait_until

from robot_runner.core.errors import LinkError, PluginError
from robot_runner.core.events.context import SystemClock
from robot_runner.core.events.early_end import RunFailed
from robot_runner.core.links.robot_name import RobotName
from robot_runner.plugins import Circumstances
from robot_runner.plugins.systems import BasicTurtlebot3, Program, Simulation
from robot_runner.ros.graph_links import DDS, GraphLinkKind
from robot_runner.ros.simulators import unpausing
from robot_runner.testing import FakeClock, FakeLinks, FakeRobotLink, Rehearsal, SystemContract, make_context

pytestmark = pytest.mark.skipif(importlib.util.find_spec("cyclonedds") is None, reason="there is no DDS")


class TestSimulationBesideTheEmbeddedRobot(SystemContract):
    def make_plugin(self) -> Simulation:
        return Simulation()


@pytest.fixture(scope="module")
def graph():
    """Two links to one graph: the experiment's, and the simulator's."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CYCLONEDDS_URI", LOOPBACK)
        name = RobotName.parse(f"dds:domain={claim_domain()}")
        own, its = DDS.open(name, SystemClock()), DDS.open(name, SystemClock())
        yield own, its
        own.close()
        its.close()


@pytest.fixture
def stage(graph, tmp_path):
    """Return what makes a simulator, and a rehearsal of a run with it."""
    own, its = graph
    begun = []

    def make(simulator, *, pace=1.0, faults=(), **parameters):
        wait_until(lambda: not own.services() and not its.services(), "those of the simulator before go")
        made = FaithfulSimulator(its, simulator, pace=pace, faults=faults)
        begun.append(made)
        plugin = Simulation(simulator, **{"timeout_s": PATIENCE, **parameters})
        context = make_context(tmp_path, plugin, robot="dds", links=FakeLinks(robot=own), clock=SystemClock())
        if "mute" not in faults:
            wait_until(lambda: {"/clock", "/odom"} <= set(own.topics()), "the simulator is discovered")
        return made, Rehearsal(context, plugin), context

    yield make
    for each in begun:
        each.close()


@pytest.mark.parametrize(
    ("simulator", "parameters"),
    [
        ("gazebo_classic_ros2", {"reset": "world"}),
        ("gazebo_classic_ros2", {"reset": "simulation"}),
        ("gz", {"world": "maze", "reset": "simulation"}),
        ("isaac", {"reset": "simulation"}),
    ],
)
def test_a_simulator_is_reset_before_the_run_paused_after_it_and_its_pace_measured(stage, simulator, parameters):
    made, rehearsal, context = stage(simulator, **parameters)
    seen = []

    def mission():
        seen.append((made.x, made.is_paused, made.time))
        time.sleep(0.4)

    made.is_paused = True  # as an earlier run left it
    wait = ProcessorWait([os.getpid()])
    rehearsal.execute(mission)
    wait.look()
    ((x, was_paused, at),) = seen
    assert x == 0.0
    assert not was_paused
    assert (at < 10.0) == (parameters["reset"] == "simulation")
    assert made.is_paused
    assert context.measures["RealTimeFactor"] == pytest.approx(1.0, abs=0.15 + wait.seconds / 0.4)
    assert 0 < context.measures["ResetDuration"] < 2.0
    rehearsal.make_safe()
    assert not made.is_paused, "it was left paused"


def test_a_robot_is_placed_where_the_treatment_has_it(stage):
    made, rehearsal, _ = stage("gazebo_classic_ros2", robot="burger", start=(0.7, 0.0, 1.0), is_placed=True)
    rehearsal.execute(lambda: None)
    assert made.told[:4] == ["unpause", "reset", "unpause", "place"]
    assert (made.x, made.yaw) == (pytest.approx(0.7), pytest.approx(1.0))


@pytest.mark.parametrize(
    ("faults", "parameters", "problem"),
    [
        (["keeps pose"], {"reset": "simulation"}, r"did not reset: .*stands at \(1\.500"),
        (["keeps time"], {"reset": "simulation"}, "time was not reset"),
        (["time back"], {"reset": "world"}, "took the simulator's time back from 10"),
        (["mute"], {"reset": "world"}, "no topic '/odom'|nothing came on /odom"),
    ],
)
def test_a_simulator_that_does_not_reset_fails_the_run_within_its_deadline(stage, faults, parameters, problem):
    _, rehearsal, _ = stage("gazebo_classic_ros2", faults=faults, **(parameters | {"timeout_s": 1.5}))
    begun = time.monotonic()
    with pytest.raises(LinkError, match=problem) as raised:
        rehearsal.execute(lambda: None)
    assert raised.value.fix
    assert time.monotonic() - begun < 10.0


def test_a_simulator_that_refuses_says_why(stage):
    _, rehearsal, _ = stage("isaac", faults=["refuses"])
    with pytest.raises(LinkError, match="refuses the request: not now"):
        rehearsal.execute(lambda: None)


def test_services_that_are_not_there_are_named_with_what_offers_them(tmp_path):
    plugin = Simulation("gz", world="maze", timeout_s=0.1)
    link = FakeRobotLink(FakeClock(), services={"/world/other/pause": {}})
    context = make_context(tmp_path, plugin, robot="dds", links=FakeLinks(robot=link))
    with pytest.raises(LinkError, match="no service '/world/maze/control'") as raised:
        plugin.start_run(context)
    assert "ros_gz_interfaces/ControlWorld" in raised.value.fix


def test_a_slow_simulator_makes_the_run_doubtful(stage):
    _, rehearsal, context = stage("gz", world="maze", pace=0.5, reset="none")
    wait = ProcessorWait([os.getpid()])
    rehearsal.execute(lambda: time.sleep(1.3))
    wait.look()
    assert context.measures["LowestRealTimeFactor"] == pytest.approx(0.5, abs=0.1 + wait.seconds)
    doubts = [str(fields) for kind, fields in context.broker.records if kind in {"doubt_run", "finding", "doubt"}]
    assert any("real-time factor fell to 0." in each for each in doubts)


def test_time_that_goes_back_during_the_mission_fails_the_run(tmp_path):
    plugin = Simulation("gz", world="maze", reset="none", pauses=False)
    link = FakeRobotLink(FakeClock(), services={"/world/maze/control": {"success": True}})
    link.known_topics["/clock"] = "rosgraph_msgs/Clock"
    context = make_context(tmp_path, plugin, robot="dds", links=FakeLinks(robot=link))
    plugin.start_run(context)
    link.deliver("/clock", {"clock": {"sec": 90, "nanosec": 0}})
    link.deliver("/clock", {"clock": {"sec": 80, "nanosec": 0}})  # before the mission anybody may reset it
    plugin.launch_mission(context)
    link.deliver("/clock", {"clock": {"sec": 81, "nanosec": 0}})
    with pytest.raises(RunFailed, match=r"went back from 81\.000 s to 1\.000 s during the mission"):
        link.deliver("/clock", {"clock": {"sec": 1, "nanosec": 0}})


def test_webots_of_ros_1_is_reset_with_its_time():
    calls = []
    link = FakeRobotLink(FakeClock(), services={})
    for service, kind, answer in FaithfulSimulator._webots(_Told(calls)):
        link.offer(service, kind, answer)
    dialect = Simulation("webots", reset="simulation")._dialect
    for demand in (dialect.pause, dialect.unpause, dialect.reset_simulation):
        demand.meet(link, namespace="", timeout=1.0)
    assert calls == [("pause", True), ("pause", False), ("reset", True)]


class _Told:
    def __init__(self, calls):
        self.calls = calls

    def pause(self, is_paused):
        self.calls.append(("pause", is_paused))

    def reset(self, *, time):
        self.calls.append(("reset", time))


@pytest.mark.parametrize("robot", ["rosbridge://sim:9090", "rosbridge+tls://sim:9090", "wss://sim/ros"])
def test_a_simulator_behind_any_rosbridge_is_let_go_on_at_its_address(monkeypatch, robot):
    ((name, _),) = opened_to_let_go_on(monkeypatch, robot)
    assert name.address == robot


def test_a_simulator_of_another_robot_is_neither_reset_nor_paused():
    link = FakeRobotLink(FakeClock())
    for service in ("/bob/reset_world", "/bob/sim/pause_physics", "/alicent/unpause_physics"):
        link.offer(service, "std_srvs/Empty", lambda _: {})
    dialect = Simulation()._dialect
    for demand in (dialect.reset_world, dialect.pause, dialect.unpause):
        with pytest.raises(LinkError, match="there is no service '/alice/"):
            demand.meet(link, namespace="/alice", timeout=0.0)
    dialect.reset_world.meet(link, namespace="", timeout=1.0)
    link.offer("/alice/sim/reset_world", "std_srvs/Empty", lambda _: {})
    dialect.reset_world.meet(link, namespace="/alice", timeout=1.0)
    assert [each.service for each in link.calls] == ["/bob/reset_world", "/alice/sim/reset_world"]


@pytest.mark.parametrize(
    ("robot", "namespace", "opened"),
    [
        ("ros2://alice", "", "/alice"),
        ("ros2://alice", "sim", "/alice/sim"),
        ("dds:domain=7,namespace=/alice", "/sim", "/alice/sim"),
        ("dds", "sim", "/sim"),
    ],
)
def test_a_simulator_is_let_go_on_below_the_namespace_in_which_the_run_has_it(monkeypatch, robot, namespace, opened):
    ((_, found),) = opened_to_let_go_on(monkeypatch, robot, namespace)
    assert found == opened


def opened_to_let_go_on(monkeypatch, robot, namespace=""):
    """Return name and namespace of the links that are opened to let a simulator go on."""
    opened = []

    def open_link(_kind, name, _clock, namespace):
        opened.append((name, namespace))
        raise LinkError("nobody is there", where="robot", fix="Start it.")

    monkeypatch.setattr(GraphLinkKind, "open", open_link)
    unpause = Simulation("gazebo_classic_ros2")._dialect.unpause
    unpausing._let_go_on(unpausing._told(robot, namespace, unpause, 1.0, ()))
    return opened


def test_a_guardian_ends_when_it_is_told_to_also_while_another_process_holds_its_pipe(monkeypatch):
    monkeypatch.setattr(unpausing, "_ENDING", 60.0)  # it may not have begun yet on a busy machine
    unpause = Simulation("gazebo_classic_ros2")._dialect.unpause
    unpausing.guard_pauses("dds", "/gus", unpause, 1.0)
    guardian = unpausing._guardians["dds", "/gus"]
    held = os.dup(guardian.stdin.fileno())  # as the watcher of an event does, which is forked when that begins
    try:
        unpausing.guard_pauses_no_more("dds", "/gus")
        assert guardian.returncode == 0
    finally:
        os.close(held)
        guardian.wait(20.0)


@pytest.mark.parametrize(
    ("parameters", "problem"),
    [
        ({"simulator": "gazbo_classic"}, "is not a simulator that is known"),
        ({"simulator": "webots", "reset": "world"}, "no documented service for reset='world'"),
        ({"reset": "wrold"}, "reset is 'wrold'"),
        ({"start": (0, 0)}, r"start is \(0, 0\)"),
        ({"is_placed": True}, "no service known here to place"),
        ({"simulator": "gz", "is_placed": True}, "to be placed and not named"),
        ({"tolerance_m": 0.0}, "tolerance_m is 0.0"),
        ({"lowest_real_time_factor": -1.0}, "lowest_real_time_factor"),
    ],
)
def test_what_cannot_be_is_refused_with_a_fix(parameters, problem):
    with pytest.raises(PluginError, match=problem) as raised:
        Simulation(**parameters)
    assert raised.value.fix


def test_the_check_says_where_it_is_of_no_use():
    assert "names no robot" in next(iter(Simulation().check(Circumstances()))).problem
    (finding,) = Simulation().check(Circumstances(robot="simulated"))
    assert not finding.is_error
    assert list(Simulation().check(Circumstances(robot="dds"))) == []
    robot, starter, own = BasicTurtlebot3(task="Video", task_factor=None), Program(["sleep", "9"]), Simulation()
    assert list(own.check(Circumstances(robot="dds", plugins=[starter, own, robot]))) == []
    (late,) = own.check(Circumstances(robot="dds", plugins=[starter, robot, own]))
    assert "once 'BasicTurtlebot3'" in late.problem


_PAUSED = """\
from robot_runner import ExperimentConfig, Factor, RunTableModel
from robot_runner.plugins.systems import Simulation


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "trial"
    results_output_path = "results"
    time_between_runs_in_ms = 300_000
    robot = "{robot}"
    plugins = [Simulation("gazebo_classic_ros2", timeout_s=20.0, lowest_real_time_factor=0)]

    def create_run_table(self):
        return RunTableModel([Factor("Number", [1, 2])])
"""


@pytest.mark.long
def test_a_simulator_goes_on_after_the_experiment_was_killed_between_two_runs(tmp_path, monkeypatch):
    monkeypatch.setenv("CYCLONEDDS_URI", LOOPBACK)
    robot = f"dds:domain={claim_domain()}"
    config = tmp_path / "study.py"
    config.write_text(_PAUSED.format(robot=robot))
    with closing(DDS.open(RobotName.parse(robot), SystemClock())) as its:
        made = FaithfulSimulator(its, "gazebo_classic_ros2")
        try:
            with (tmp_path / "said.txt").open("wb") as said:
                command = [sys.executable, "-m", "robot_runner", "run", str(config)]
                killed = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=said, stderr=said, cwd=tmp_path)
                try:
                    journal = tmp_path / "results/trial/journal.jsonl"
                    ended = _wait(lambda: made.is_paused and '"status":"done"' in journal.read_text(), killed)
                    assert ended, (tmp_path / "said.txt").read_text()
                    assert made.told[-1] == "pause"
                finally:
                    killed.kill()
                    killed.wait(20)
            begun = time.monotonic()
            assert _wait(lambda: not made.is_paused)
            assert time.monotonic() - begun < 30.0
        finally:
            made.close()


def _wait(holds, process=None):
    deadline = time.monotonic() + 60.0
    while not holds() and time.monotonic() < deadline and (process is None or process.poll() is None):
        time.sleep(0.05)
    return holds()
