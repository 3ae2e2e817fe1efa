"""Parameters and states are set for a run, read back, and put back, whatever becomes of the run."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from robot_runner.core.errors import LinkError, PluginError, StorageError
from robot_runner.core.plugin import Circumstances
from robot_runner.core.storage.claim_locks import state_folder
from robot_runner.plugins import treatment
from robot_runner.plugins.systems import Lifecycle, RosParameters
from robot_runner.ros.experiment_checks import check_left_settings
from robot_runner.ros.kept_settings import KeptSettings, left_settings
from robot_runner.ros.lifecycle import LifecycleState
from robot_runner.ros.restored_settings import PUT_BACK_BY
from robot_runner.testing import (
    FakeClock,
    FakeLinks,
    FakeRobotLink,
    LifecycleNode,
    ParameterNode,
    Rehearsal,
    SystemContract,
    make_context,
)

if TYPE_CHECKING:
    from collections.abc import Callable

_DEAD = 4_000_000  # above the highest process id of Linux


@pytest.fixture(autouse=True)
def state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    return state_folder("settings")


class TestRosParametersKeepsToTheContract(SystemContract):
    def make_plugin(self):
        return RosParameters({"/planner": {"speed": 0.5, "ids": [1, 2]}})

    def make_links(self, clock):
        link = FakeRobotLink(clock)
        ParameterNode(link, "/planner", {"speed": 0.2, "ids": [0]})
        return FakeLinks(robot=link)


class TestLifecycleKeepsToTheContract(SystemContract):
    def make_plugin(self):
        return Lifecycle({"/slam": "active"})

    def make_links(self, clock):
        link = FakeRobotLink(clock)
        LifecycleNode(link, "/slam")
        return FakeLinks(robot=link)


class Run:
    """A rehearsed run on a robot that is not simulated, as far as files go."""

    def __init__(self, folder, *plugins, link=None, clock=None):
        self.clock = clock or FakeClock()
        self.link = link or FakeRobotLink(self.clock)
        self.plugins = plugins
        links = FakeLinks(robot=self.link)
        self.context = make_context(folder, *plugins, robot="dds:domain=7", links=links, clock=self.clock)
        self.folder = self.context.run_path

    def execute(self, mission: Callable[[], object] = lambda: None):
        Rehearsal(self.context, *self.plugins).execute(mission)

    @property
    def findings(self):
        return [fields for kind, fields in self.context.broker.records if kind == "finding"]


def test_a_run_has_its_parameters_and_the_node_its_own_again(tmp_path, state):
    plugin = RosParameters({"planner": {"speed": 1, "names": []}, "/map": {"size": 3}})
    run = Run(tmp_path, plugin)
    planner = ParameterNode(run.link, "/planner", {"speed": 0.2, "names": ["a"], "other": True})
    size = ParameterNode(run.link, "/map", {"size": 9})
    during = []
    run.execute(lambda: during.extend([dict(planner.values), dict(size.values), len(list(state.iterdir()))]))
    assert during == [{"speed": 1.0, "names": [], "other": True}, {"size": 3}, 1]
    assert planner.values == {"speed": 0.2, "names": ["a"], "other": True}
    assert size.values == {"size": 9}
    kept = json.loads((run.folder / "RosParameters" / "parameters.json").read_text())
    assert kept["/planner"]["speed"] == {"before": 0.2, "set": 1, "during": 1.0, "after": 1.0, "restored": 0.2}
    assert kept["/map"]["size"]["restored"] == 9
    assert list(state.iterdir()) == []
    assert run.findings == []


def test_an_array_that_differs_in_a_value_alone_is_put_back(tmp_path):
    run = Run(tmp_path, RosParameters({"planner": {"gains": [0.5, 1.0, 2.0]}}))
    planner = ParameterNode(run.link, "/planner", {"gains": [0.5, 1.5, 2.0]})
    run.execute()
    assert planner.changes == [("gains", [0.5, 1.0, 2.0]), ("gains", [0.5, 1.5, 2.0])]


def test_an_array_of_which_somebody_else_sets_a_value_makes_the_run_doubtful(tmp_path):
    run = Run(tmp_path, RosParameters({"planner": {"gains": [0.5, 1.0]}}))
    planner = ParameterNode(run.link, "/planner", {"gains": [0.5, 1.5]})
    run.execute(lambda: planner.values.update(gains=[0.5, 9.0]))
    assert "gains of /planner was set to [0.5, 1.0], and is [0.5, 9.0] after the mission" in str(
        run.context.broker.records
    )


def test_a_value_is_bound_to_a_factor(tmp_path):
    clock = FakeClock()
    link = FakeRobotLink(clock)
    node = ParameterNode(link, "/planner", {"speed": 0.2, "frame": "map"})
    plugin = RosParameters({"planner": {"speed": treatment("Speed"), "frame": "odom"}})
    context = make_context(
        tmp_path, plugin, links=FakeLinks(robot=link), clock=clock, robot="dds", combination={"Speed": 0.5}
    )
    Rehearsal(context, plugin).execute(lambda: None)
    assert node.changes[:2] == [("speed", 0.5), ("frame", "odom")]


def test_a_run_whose_mission_fails_puts_all_back(tmp_path):
    run = Run(tmp_path, RosParameters({"planner": {"speed": 1.0}}), Lifecycle({"slam": "active"}))
    planner, slam = ParameterNode(run.link, "/planner", {"speed": 0.2}), LifecycleNode(run.link, "/slam")

    def fail():
        assert (planner.values["speed"], slam.state) == (1.0, LifecycleState.ACTIVE)
        raise ValueError("the mission fails")

    with pytest.raises(ValueError, match="the mission fails"):
        run.execute(fail)
    assert (planner.values["speed"], slam.state) == (0.2, LifecycleState.UNCONFIGURED)
    assert slam.transitions == ["configure", "activate", "deactivate", "cleanup"]


def test_a_node_that_does_not_take_a_value_fails_the_run_and_gets_the_others_back(tmp_path, state):
    run = Run(tmp_path, RosParameters({"planner": {"speed": 1.0}, "map": {"size": 3, "scale": 2.0}}))
    planner = ParameterNode(run.link, "/planner", {"speed": 0.2})
    told = lambda name, value: "too small" if name == "size" else ""  # noqa: E731
    size = ParameterNode(run.link, "/map", {"size": 9, "scale": 1.0}, refuses=told)
    with pytest.raises(LinkError, match="refuses the value: too small"):
        run.execute()
    assert (planner.values, size.values) == ({"speed": 0.2}, {"size": 9, "scale": 1.0})
    assert planner.changes == [("speed", 1.0), ("speed", 0.2)]
    assert list(state.iterdir()) == []


def test_a_node_that_keeps_another_value_than_was_set_fails_the_run(tmp_path):
    run = Run(tmp_path, RosParameters({"planner": {"speed": 2.0}}))
    node = ParameterNode(run.link, "/planner", {"speed": 0.2})

    def clamp(name, value):
        run.clock.at(0, lambda: None)
        node.values = _Clamped(node.values)
        return ""

    node._refuses = clamp
    with pytest.raises(LinkError, match=r"2\.0 was set, and the node has 0\.5"):
        run.execute()


class _Clamped(dict):
    def __setitem__(self, name, value):
        super().__setitem__(name, min(value, 0.5))


def test_all_that_is_wrong_is_told_at_once_and_nothing_is_set(tmp_path):
    run = Run(tmp_path, RosParameters({"planner": {"sped": 1.0}, "map": {"sise": 3}}))
    planner, size = ParameterNode(run.link, "/planner", {"speed": 0.2}), ParameterNode(run.link, "/map", {"size": 3})
    with pytest.raises(LinkError) as caught:
        run.execute()
    assert "'sped'" in caught.value.problem
    assert "'sise'" in caught.value.problem
    assert caught.value.fix == "Did you mean 'speed'? Did you mean 'size'?"
    assert not [*planner.changes, *size.changes]


def test_a_node_that_comes_later_is_awaited_and_one_that_never_comes_is_named(tmp_path):
    run = Run(tmp_path, RosParameters({"planner": {"speed": 1.0}}, patience=3.0))
    run.clock.at(2.0, lambda: ParameterNode(run.link, "/planner", {"speed": 0.2}))
    run.execute()
    assert 2.0 <= run.clock.now() < 3.0
    run = Run(tmp_path, Lifecycle({"slan": "active"}, patience=1.0))
    LifecycleNode(run.link, "/slam")
    with pytest.raises(LinkError) as caught:
        run.execute()
    assert caught.value.problem == "there is no managed node '/slan'"
    assert caught.value.fix == "Did you mean '/slam'?"


def test_what_somebody_else_sets_during_the_mission_makes_the_run_doubtful(tmp_path):
    run = Run(tmp_path, RosParameters({"planner": {"speed": 1.0}}))
    node = ParameterNode(run.link, "/planner", {"speed": 0.2})
    run.execute(lambda: node.values.update(speed=0.7))
    (finding,) = run.findings
    assert finding["problem"] == "speed of /planner was set to 1.0, and is 0.7 after the mission"
    assert node.values == {"speed": 0.2}


def test_a_parameter_without_a_value_keeps_the_one_of_the_run_as_ros_2_would_undeclare_it(tmp_path, state):
    run = Run(tmp_path, RosParameters({"planner": {"speed": 0.5, "count": 2.0}}))
    node = ParameterNode(run.link, "/planner", {"count": None, "speed": None})
    node.values["count"] = 2
    run.execute()
    assert (node.values, type(node.values["count"])) == ({"speed": 0.5, "count": 2}, int)
    (finding,) = run.findings
    assert finding["problem"] == "speed of /planner had no value before the run, and keeps 0.5"
    assert list(state.iterdir()) == []


def test_a_parameter_that_is_gone_after_the_mission_makes_the_run_doubtful(tmp_path, state):
    run = Run(tmp_path, RosParameters({"planner": {"speed": 0.5, "size": 3}}))
    node = ParameterNode(run.link, "/planner", {"speed": 0.2, "size": 1})
    run.execute(lambda: node.values.pop("size"))
    (finding,) = run.findings
    assert finding["problem"] == "size of /planner was set to 3, and is not there after the mission"
    assert node.values == {"speed": 0.2}
    assert list(state.iterdir()) == []


def test_what_a_killed_run_set_and_the_node_lacks_by_now_keeps_no_run_from_its_start(tmp_path, state):
    left({"/planner": {"speed": 1.0, "old": 3}}, {"/planner": {"speed": 0.2, "old": 1}})
    run = Run(tmp_path, RosParameters({"planner": {"speed": 0.6}}))
    node = ParameterNode(run.link, "/planner", {"speed": 1.0})
    run.execute()
    assert node.values == {"speed": 0.2}
    problems = [finding["problem"] for finding in run.findings]
    assert problems[1:] == ["old of /planner is not there any more, so that it is not put back"]
    assert list(state.iterdir()) == []


def test_what_a_killed_run_set_and_cannot_be_put_back_is_told_with_its_file(tmp_path, state):
    left({"/planner": {"speed": 1.0}}, {"/planner": {"speed": 0.2}})
    run = Run(tmp_path, RosParameters({"planner": {"speed": 0.6}}))
    ParameterNode(run.link, "/planner", {"speed": 1.0}, refuses=lambda _, value: "slow" if value == 0.2 else "")
    with pytest.raises(LinkError, match="refuses the value: slow") as told:
        run.execute()
    (file,) = state.iterdir()
    assert f"are still as RosParameters set them in process {_DEAD}" in told.value.problem
    assert told.value.fix == f"Put it back by hand, and remove {file}."


def test_a_node_that_has_gone_is_told_and_fails_nothing(tmp_path):
    run = Run(tmp_path, RosParameters({"planner": {"speed": 1.0}}))
    node = ParameterNode(run.link, "/planner", {"speed": 0.2})
    run.execute(node.close)
    (finding,) = run.findings
    assert "/planner is gone" in finding["problem"]


def left(wanted, before, plugin="RosParameters", kind="parameters"):
    KeptSettings(kind, "dds:domain=7", plugin, before, wanted, (_DEAD, "1")).write()


def test_what_a_killed_run_left_is_told_by_check_and_put_back_by_the_next(tmp_path, state):
    left({"/planner": {"speed": 1.0, "size": 3, "raw": b"x"}}, {"/planner": {"speed": 0.2, "size": 9, "raw": b"ab"}})
    plugin = RosParameters({"planner": {"speed": 0.6}})
    (warning,) = plugin.check(Circumstances(robot="dds:domain=7"))
    assert not warning.is_error
    assert f"parameters of /planner are still as RosParameters set them in process {_DEAD}" in warning.problem
    assert list(plugin.check(Circumstances(robot="dds:domain=8"))) == []
    run = Run(tmp_path, plugin)
    node = ParameterNode(
        run.link, "/planner", {"speed": 1.0, "size": 4, "raw": b"x"}
    )  # somebody has set the size since
    run.execute()
    assert node.values == {"speed": 0.2, "size": 4, "raw": b"ab"}
    problems = [finding["problem"] for finding in run.findings]
    assert "that was done before this run" in problems[0]
    assert problems[1] == "size of /planner is 4 and not 3, as a run set it that died: it is left so"
    assert list(state.iterdir()) == []


def test_an_experiment_without_such_a_plugin_says_that_settings_are_left(state):
    class Parameters:
        robot = "dds:domain=7"

    left({"/slam": {"state": "active"}}, {"/slam": {"state": "inactive"}}, "Lifecycle", "states")
    (finding,) = check_left_settings("Config", Parameters, [RosParameters({"a": {"b": 1}})])
    assert "states of /slam are still as Lifecycle set them" in finding.problem
    assert "Lifecycle on this robot" in finding.fix
    assert list(check_left_settings("Config", Parameters, [Lifecycle({"/a": "active"})])) == []
    (state / "broken.json").write_text("{", encoding="utf-8")
    assert len(left_settings("states", "dds:domain=7")) == 1


def test_settings_that_are_left_are_told_where_nothing_has_imported_the_plugin_that_set_them():
    assert {each.kind: each.__name__ for each in (RosParameters, Lifecycle)} == PUT_BACK_BY
    left({"/planner": {"speed": 1.0}}, {"/planner": {"speed": 0.2}})
    program = f"""
from types import SimpleNamespace
from {check_left_settings.__module__} import check_left_settings
print(*check_left_settings("Config", SimpleNamespace(robot="dds:domain=7"), []))
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=60)
    assert f"parameters of /planner are still as RosParameters set them in process {_DEAD}" in done.stdout


def test_a_robot_is_known_again_under_another_name_of_its_graph(state, monkeypatch):
    left({"/slam": {"state": "active"}}, {"/slam": {"state": "inactive"}}, "Lifecycle", "states")
    monkeypatch.setenv("ROS_DOMAIN_ID", "7")
    same = ["dds:domain=7,distro=humble", "dds", "ros2", "ros2:domain=7,namespace=/alice", "ros2://alice"]
    assert [len(left_settings("states", each)) for each in same] == [1] * len(same)
    others = ["dds:domain=8", "ros1", "rosbridge://127.0.0.1:9090", "simulated", "no_such:link", None]
    assert [left_settings("states", each) for each in others] == [[]] * len(others)
    monkeypatch.setenv("ROS_DOMAIN_ID", "8")  # what is left stays where it was, whatever the variables say later
    assert left_settings("states", "dds") == []


def test_what_another_computer_has_set_is_not_taken_for_left_in_a_home_that_both_share(state, monkeypatch):
    left({"/slam": {"state": "active"}}, {"/slam": {"state": "inactive"}}, "Lifecycle", "states")
    monkeypatch.setattr(socket, "gethostname", lambda: "another")  # whose processes are not seen from here
    assert left_settings("states", "dds:domain=7") == []


def test_a_user_without_a_home_has_left_nothing(monkeypatch):
    monkeypatch.delenv("XDG_STATE_HOME")
    monkeypatch.setattr(Path, "expanduser", _without_home)
    assert left_settings("states", "dds:domain=7") == []
    with pytest.raises(StorageError, match="no home folder"):
        left({"/slam": {"state": "active"}}, {"/slam": {"state": "inactive"}}, "Lifecycle", "states")


def _without_home(path):
    raise RuntimeError("Could not determine home directory.")


def test_who_stands_by_puts_back_what_the_run_left_and_keeps_the_file_where_it_cannot(tmp_path, state):
    left({"/planner": {"speed": 1.0}}, {"/planner": {"speed": 0.2}})
    plugin = RosParameters({"planner": {"speed": 1.0}})
    run = Run(tmp_path, plugin)
    node = ParameterNode(run.link, "/planner", {"speed": 1.0})
    run.link.fault = LinkError("the robot is off", where="link", fix="Switch it on.")
    plugin.make_safe(run.context)
    assert len(list(state.iterdir())) == 1
    (finding,) = run.findings
    assert finding["problem"].startswith("parameters of /planner are not put back: link: the robot is off")
    run.link.fault = None
    plugin.make_safe(run.context)
    assert node.values == {"speed": 0.2}
    assert list(state.iterdir()) == []


def test_whatever_fails_at_one_node_the_others_are_put_back(tmp_path, state):
    before, wanted = {"speed": 0.2}, {"speed": 1.0}
    left({"/arm": wanted, "/planner": wanted}, {"/arm": before, "/planner": before})
    plugin = RosParameters({"planner": wanted})
    run = Run(tmp_path, plugin)
    arm, planner = (ParameterNode(run.link, name, dict(wanted)) for name in ("/arm", "/planner"))
    write = plugin.write

    def fail(link, node, values):
        if node == "/planner":  # the first one
            raise RuntimeError("context is not valid")
        write(link, node, values)

    plugin.write = fail
    plugin.make_safe(run.context)
    assert arm.values == before
    assert len(list(state.iterdir())) == 1
    plugin.write = write
    plugin.make_safe(run.context)
    assert planner.values == before
    assert list(state.iterdir()) == []


def test_a_robot_that_is_off_at_the_end_is_put_right_before_the_next_run(tmp_path, state):
    plugin = RosParameters({"planner": {"speed": 1.0}})
    run = Run(tmp_path / "first", plugin)
    node = ParameterNode(run.link, "/planner", {"speed": 0.2})
    off = LinkError("the robot is off", where="link", fix="Switch it on.")
    with pytest.raises(LinkError, match="the robot is off"):
        run.execute(lambda: setattr(run.link, "fault", off))
    assert len(list(state.iterdir())) == 1
    run.link.fault = None
    following = Run(tmp_path / "second", plugin, link=run.link, clock=run.clock)
    during = []
    following.execute(lambda: during.append(node.values["speed"]))
    assert during == [1.0]
    assert node.values == {"speed": 0.2}
    assert "that was done before this run" in following.findings[0]["problem"]
    assert list(state.iterdir()) == []


def test_a_living_run_keeps_its_own(tmp_path):
    child = os.fork()
    if child == 0:
        signal.pause()
        os._exit(0)
    try:
        started = Path(f"/proc/{child}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()[19]
        KeptSettings("parameters", "dds", "P", {"/a": {"b": 1}}, {"/a": {"b": 2}}, (child, started)).write()
        assert left_settings("parameters", "dds") == []
    finally:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
    assert len(left_settings("parameters", "dds")) == 1


@pytest.mark.parametrize(
    ("parameters", "problem"),
    [
        ({}, "parameters is {}"),
        ({"planner": {}}, "the parameters of 'planner' are {}"),
        ({"planner": {"FollowPath": {"speed": 0.5}}}, "FollowPath of 'planner' is {'speed': 0.5}"),
        ({"planner": 3}, "the parameters of 'planner' are 3"),
        ({"pla nner": {"a": 1}}, "'pla nner' cannot be the name"),
        ({"planner": {"a": object}}, "no parameter can have the value <class 'object'>"),
        ({"planner": {"a": [1, "b"]}}, "are not of one kind"),
        ({"planner": {"a": 2**63}}, "does not fit 64 bits"),
    ],
)
def test_what_cannot_be_parameters_is_refused_at_once(parameters, problem):
    with pytest.raises(PluginError) as caught:
        RosParameters(parameters)
    assert problem in caught.value.problem
    assert caught.value.fix


def test_states_that_there_are_not_and_ros_1_are_refused():
    with pytest.raises(PluginError, match="brought to the state 'actve'") as caught:
        Lifecycle({"/slam": "actve"})
    assert caught.value.fix == "Did you mean 'active'?"
    with pytest.raises(PluginError, match="states is"):
        Lifecycle({})
    (finding,) = Lifecycle({"/slam": "active"}).check(Circumstances(robot="ros1:master=http://a:1"))
    assert "life cycle" in finding.problem
    with pytest.raises(PluginError, match="patience is -1"):
        RosParameters({"a": {"b": 1}}, patience=-1)
    (no_robot,) = RosParameters({"a": {"b": 1}}).check(Circumstances())
    assert no_robot.is_error
