"""What runs claim: what plugins say, their robot and hosts, and the whole machine for who does not say."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from robot_runner.core.config.claims import Claims, held_claims, usable_cores, worker_count
from robot_runner.core.config.preparation import prepare, prepare_or_refuse
from robot_runner.core.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

HEAD = """\
from robot_runner import *
from robot_runner.plugins import Profiler, System
from robot_runner.plugins.profilers import Ina219, PsUtil, RosTopics, WattsUpPro
from robot_runner.plugins.systems import BasicTurtlebot3, Together, Waypoints

class Silent(Profiler):
    def start_measurement(self, context):
        pass

class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "trial"
"""


CAMERA = """\
class Camera(Profiler):
    def claims(self, robot): return [f"device:camera of {robot}"]
"""


@pytest.fixture
def claims(write_config: Callable[..., Path]) -> Callable[..., Any]:
    """Return what gives the claims of a config's first run, and those that it holds against other experiments."""

    def of(body: str) -> tuple[dict[str, list[str]], frozenset[str]]:
        experiment = prepare_or_refuse(write_config(body, head=HEAD), looks_at_graph=False)
        found = Claims(experiment.parameters, experiment.plugins, experiment.events)
        combination = next(iter(experiment.model.plan())).combination
        return found.of(combination), held_claims(found, experiment.model)

    return of


def test_a_simulated_robot_and_its_meters_claim_nothing(claims: Callable[..., Any]) -> None:
    body = """
    robot = "simulated"
    plugins = [BasicTurtlebot3(), Ina219(), PsUtil()]
    def launch_mission(self, context): pass
    """
    assert claims(body) == ({}, frozenset())


def test_who_measures_this_machine_claims_it_against_everybody(claims: Callable[..., Any]) -> None:
    body = 'robot = "simulated"\nplugins = [BasicTurtlebot3(), PsUtil(host="localhost")]'
    assert claims(body) == ({"host:localhost": ["PsUtil"]}, frozenset({"host:localhost"}))


def test_who_does_not_say_has_the_machine_to_itself_and_keeps_no_other_experiment_out(
    claims: Callable[..., Any],
) -> None:
    body = "plugins = [Silent()]\ndef launch_mission(self, context): pass"
    assert claims(body) == ({"host:localhost": ["config", "Silent"]}, frozenset())


def test_a_config_says_what_its_callbacks_need(claims: Callable[..., Any]) -> None:
    body = 'claims = ["device:lamp"]\nhosts = {"base": "local"}\ndef launch_mission(self, context): pass'
    assert claims(body) == (
        {"host:localhost": ["config"], "device:lamp": ["config"]},
        frozenset({"device:lamp"}),
    )


def test_a_real_robot_is_claimed_with_its_graph_and_namespace(
    claims: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    body = 'robot = "rosbridge://alice:9090"\nprobe = False\nplugins = [BasicTurtlebot3(namespace="/alice")]'
    own, held = claims(body)
    assert set(own) == {"robot:rosbridge://alice:9090"}
    assert held == {"robot:rosbridge alice:9090/alice"}


def test_one_robot_is_claimed_alike_over_any_link_and_whatever_else_of_ros_is_sourced(
    write_config: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    plugins = "probe = False\nplugins = [BasicTurtlebot3(task='Video', task_factor=None)]"
    monkeypatch.setattr("socket.gethostname", lambda: "lab-pc.example.org")
    for robot, environment, expected in (
        ("dds:domain=7,namespace=alice", {}, "robot:domain 7/alice"),
        ("dds:domain=7,namespace=alice", {"ROS_DOMAIN_ID": "3", "ROS_MASTER_URI": "http://a"}, "robot:domain 7/alice"),
        ("dds://alice", {"ROS_DOMAIN_ID": "7"}, "robot:domain 7/alice"),
        ("ros2://alice", {"ROS_DOMAIN_ID": "7", "ROS_DISTRO": "jazzy"}, "robot:domain 7/alice"),
        ("dds://alice", {"ROS_DOMAIN_ID": "8"}, "robot:domain 8/alice"),
        ("rosbridge://127.0.0.1:9090", {"ROS_DOMAIN_ID": "7"}, "robot:rosbridge localhost:9090"),
        ("rosbridge://localhost", {}, "robot:rosbridge localhost:9090"),
        ("ros1", {"ROS_MASTER_URI": "http://a:11311", "ROS_DOMAIN_ID": "7"}, "robot:master a:11311"),
        ("ros1:master=http://a:11311", {}, "robot:master a:11311"),
        ("ros1", {"ROS_MASTER_URI": "http://Lab-PC:11311"}, "robot:master localhost:11311"),
        ("ros1:master=http://lab-pc.example.org:11311", {}, "robot:master localhost:11311"),
        ("rosbridge://127.0.1.1:9090", {}, "robot:rosbridge localhost:9090"),
    ):
        with monkeypatch.context() as patch:
            for variable in ("ROS_DOMAIN_ID", "ROS_MASTER_URI", "ROS_DISTRO"):
                patch.delenv(variable, raising=False)
            for variable, value in environment.items():
                patch.setenv(variable, value)
            experiment = prepare(write_config(f'robot = "{robot}"\n{plugins}', head=HEAD), is_for_here=False).experiment
            assert experiment is not None
            found = Claims(experiment.parameters, experiment.plugins, experiment.events)
            assert held_claims(found, experiment.model) == {expected}, (robot, environment)


def test_one_robot_is_claimed_alike_however_its_namespace_is_named(
    claims: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    for variable in ("ROS_DOMAIN_ID", "ROS_MASTER_URI"):
        monkeypatch.delenv(variable, raising=False)
    lone = "plugins = [BasicTurtlebot3(task='Video', task_factor=None)]"
    named = "plugins = [BasicTurtlebot3(task='Video', task_factor=None, namespace='/lab/alice')]"
    pair = "plugins = [Together(*(Waypoints([(1, 0)], name=a[-3:], namespace=a) for a in ('lab/alice', 'bob')))]"
    bound = "plugins = [Waypoints([(1, 0)], namespace=treatment('Task'))]"
    lidar = "plugins = [BasicTurtlebot3(task='Video', task_factor=None), RosTopics(['scan'], namespace='lidar')]"
    by_callbacks = "plugins = [RosTopics(['scan'], namespace='lidar')]\ndef launch_mission(self, context): pass"
    alice, bob = "robot:domain 7/lab/alice", "robot:domain 7/bob"
    for robot, body, expected in (
        ("dds:domain=7,namespace=/lab/alice", lone, {alice}),
        ("dds:namespace=lab/alice/,domain=7", lone, {alice}),
        ("dds:domain=7", named, {alice}),
        ("dds:domain=7,namespace=lab", named.replace("/lab", ""), {alice}),
        ("dds:domain=7", pair, {alice, bob}),
        ("dds:domain=7", bound, {"robot:domain 7/Video", "robot:domain 7/Network"}),
        ("dds:domain=7", lidar, {"robot:domain 7", "robot:domain 7/lidar"}),
        ("dds:domain=7,namespace=lab/alice", lidar, {alice, f"{alice}/lidar"}),
        ("dds:domain=7,namespace=lab/alice", by_callbacks, {alice, f"{alice}/lidar"}),
    ):
        assert claims(f'robot = "{robot}"\nprobe = False\n{body}')[1] == expected, (robot, body)
    assert claims(f'robot = "dds://alice"\n{lone}')[1] == {"robot:domain 0/alice"}


def test_a_robot_that_is_driven_late_in_a_long_plan_is_claimed_from_the_beginning(
    write_config: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    for variable in ("ROS_DOMAIN_ID", "ROS_MASTER_URI"):
        monkeypatch.delenv(variable, raising=False)
    table = """
    def create_run_table(self):
        return RunTableModel([Factor("Robot", ["alice", "bob"]), Factor("Trial", range(300))], data_columns=[])
    """
    body = "robot = 'dds:domain=7'\nprobe = False\nplugins = [Waypoints([(1, 0)], namespace=treatment('Robot'))]"
    experiment = prepare_or_refuse(write_config(body, head=HEAD, table=table), looks_at_graph=False)
    assert {run.combination["Robot"] for run in list(experiment.model.plan())[:300]} == {"alice"}
    found = Claims(experiment.parameters, experiment.plugins, experiment.events)
    assert held_claims(found, experiment.model) == {"robot:domain 7/alice", "robot:domain 7/bob"}


def test_nobody_looks_for_a_robot_to_know_what_is_claimed(
    write_config: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    def look() -> None:
        raise AssertionError("nobody is to look")

    monkeypatch.setattr("robot_runner.ros.ros_environment.found_robot", look)
    experiment = prepare(write_config('robot = "auto"', head=HEAD), is_for_here=False).experiment
    assert experiment is not None
    assert "robot:auto" in held_claims(
        Claims(experiment.parameters, experiment.plugins, experiment.events), experiment.model
    )


@pytest.mark.parametrize("given", ["0", "-1", "many", "1.5", "99999999999"])
def test_a_number_of_workers_that_is_none_is_refused(write_config: Callable[..., Path], given: str) -> None:
    with pytest.raises(ConfigError, match='1 to 10,000, or "auto"'):
        prepare_or_refuse(write_config(), {"workers": given})


def test_auto_is_as_many_workers_as_there_are_cores(write_config: Callable[..., Path]) -> None:
    experiment = prepare_or_refuse(write_config("claims = []"), {"workers": "auto"})
    assert worker_count(experiment.parameters) == usable_cores() >= 1


#: How the first version of control groups tells a quota.
QUOTA, PERIOD = "cpu.cfs_quota_us", "cpu.cfs_period_us"


@pytest.mark.parametrize(
    ("groups", "files", "cores"),
    [
        ("0::/", {}, 64),
        ("0::/", {"cpu.max": "200000 100000\n"}, 2),
        ("0::/", {"cpu.max": "max 100000\n"}, 64),
        ("0::/job/step", {"job/cpu.max": "150000 100000\n", "job/step/cpu.max": "max 100000\n"}, 2),
        ("0::/job/step", {"job/step/cpu.max": "10000 100000\n"}, 1),
        ("0::/of/the/host", {"cpu.max": "300000 100000\n"}, 3),
        (
            "4:cpu,cpuacct:/job\n0::/",
            {"cpu,cpuacct/job/cpu.cfs_quota_us": "250000", "cpu,cpuacct/job/cpu.cfs_period_us": "50000"},
            5,
        ),
        ("4:cpu:/\n3:cpuset:/", {"cpu/cpu.cfs_quota_us": "-1\n", "cpu/cpu.cfs_period_us": "100000\n"}, 64),
        ("nonsense", {}, 64),
    ],
)
def test_a_container_that_has_the_time_of_a_few_cores_may_use_these(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, groups: str, files: dict[str, str], cores: int
) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(64)), raising=False)
    for name, text in {
        "proc/self/cgroup": f"{groups}\n",
        **{f"sys/fs/cgroup/{name}": files[name] for name in files},
    }.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text, encoding="ascii")
    assert usable_cores(tmp_path) == cores


def test_a_plugin_whose_claims_raise_is_a_finding(write_config: Callable[..., Path]) -> None:
    head = HEAD.replace("class Silent(Profiler):", "class Silent(Profiler):\n    def claims(self, robot): return 1 / 0")
    findings = prepare(write_config("plugins = [Silent()]", head=head), {"workers": "2"}).findings
    assert any("ZeroDivisionError" in finding.problem for finding in findings)


def test_a_single_claim_need_not_stand_in_a_list(claims: Callable[..., Any]) -> None:
    body = """
    class Scale(Silent):
        def claims(self, robot): return "serial:/dev/ttyUSB0"
    plugins = [Scale()]
    """
    assert claims(body) == ({"serial:/dev/ttyUSB0": ["Scale"]}, frozenset({"serial:/dev/ttyUSB0"}))


def test_a_plugin_is_asked_for_the_claims_of_each_robot_that_takes_turns(write_config: Callable[..., Path]) -> None:
    head = HEAD.replace("class RobotRunnerConfig", CAMERA + "\n\nclass RobotRunnerConfig", 1)
    body = "robot = Robots('ros2://alice', 'ros2://bob')\nplugins = [Camera()]"
    found = prepare(write_config(body, head=head), is_for_here=False)
    assert found.experiment is not None, found.findings
    experiment = found.experiment
    told = Claims(experiment.parameters, experiment.plugins, experiment.events)
    assert [list(told.of({}, robot)) for robot in experiment.parameters.robots.values()] == [
        ["device:camera of ros2://alice"],
        ["device:camera of ros2://bob"],
    ]
    assert {"device:camera of ros2://alice", "device:camera of ros2://bob"} <= held_claims(told, experiment.model)
    assert told.common([{}]) == {}
