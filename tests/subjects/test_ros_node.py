"""Nodes under test: by the real roslaunch of ROS 1, and by a stand-in for `ros2` that checks its words."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
import xmlrpc.client
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING
from xml.dom import minidom

import pytest
import yaml
from tests.conftest import HEAD, written_config
from tests.core.execution.conftest import Executed, execute_in
from tests.loopback_port import claim_port
from tests.ros.ros1_master import ros1_environment, ros1_master
from tests.subjects.conftest import gone
from tests.subjects.test_ros_launch import needs_roslaunch

from robot_runner.core.config.preparation import prepare
from robot_runner.core.errors import PluginError
from robot_runner.core.links.connect import graph_variables
from robot_runner.plugins.systems import Program, RosNode
from robot_runner.subjects.ros_subject import RosSubject
from robot_runner.testing import FakeLinks, make_context

if TYPE_CHECKING:
    from collections.abc import Callable

OURS = HEAD.replace("import *\n", "import *\nfrom robot_runner.plugins.systems import RosNode\n", 1)
TABLE = """\
    def create_run_table(self):
        return RunTableModel([Factor("Planner", ["dwa", "teb"])], seed=1, shuffle=False)
"""
#: A node that says what it was given: words, parameters, its name, and the names that its own were remapped to.
NODE = """\
#!/usr/bin/python3
import sys
import rospy
rospy.init_node("planner")
facts = [rospy.get_name(), rospy.resolve_name("scan"), rospy.get_param("~planner"), rospy.get_param("~limits/speed")]
facts += [rospy.get_param("~map"), rospy.get_param("~exact"), *rospy.myargv()[1:]]
rospy.on_shutdown(lambda: print("shut down", flush=True))
print("planner has", *map(repr, facts), flush=True)
rospy.spin()
"""
#: As ros2 of Jazzy answers: the executables and prefixes of packages, and `run`, which hands no signal on to the node:
#: it awaits the end of its child, which Ctrl-C interrupts as well.
ROS2 = """\
#!/bin/sh
case "$1 $2 $3" in
    "pkg executables nav") echo "nav planner"; echo "nav mapper"; exit 0;;
    "pkg executables "*) echo "Package 'no_package' not found" >&2; exit 1;;
    "pkg prefix rmw_cyclonedds_cpp") echo /opt/ros/jazzy; exit 0;;
    "pkg prefix "*) echo "Package not found" >&2; exit 1;;
    "run nav planner") ;;
    *) echo "unknown words: $*" >&2; exit 2;;
esac
echo "middleware $RMW_IMPLEMENTATION"
shift 3
exec python3 - "$@" <<'END'
import subprocess, sys
tells = "trap 'echo interrupted; exit 0' INT; for word; do echo \\"word <$word>\\"; done; while :; do sleep 0.2; done"
node = subprocess.Popen(["sh", "-c", tells, "TOKEN", *sys.argv[1:]])
while node.returncode is None:
    try:
        node.communicate()
    except KeyboardInterrupt:
        pass
raise SystemExit(node.returncode)
END
"""


@pytest.fixture
def execute(tmp_path: Path) -> Callable[..., Executed]:
    return partial(execute_in, tmp_path, head=OURS, table=TABLE)


@pytest.fixture
def problems(tmp_path: Path) -> Callable[[str], list[str]]:
    def found(body: str) -> list[str]:
        return [finding.problem for finding in prepare(written_config(tmp_path, body, head=OURS, table=TABLE)).findings]

    return found


@pytest.fixture
def workspace(tmp_path: Path, token: str) -> dict[str, str]:
    """Return the environment of a workspace that is a git repository with one package."""
    package = tmp_path / "ws" / "src" / "subject_nav"
    package.mkdir(parents=True)
    (package / "package.xml").write_text("<package><name>subject_nav</name><version>1.2.3</version></package>")
    (package / "planner.py").write_text(NODE + f"# {token}\n")
    (package / "planner.py").chmod(0o755)
    (tmp_path / "hall.yaml").write_text("map: hall\nplanner: none\n")
    for words in (
        ["init", "-q"],
        ["add", "."],
        ["-c", "user.name=A", "-c", "user.email=a@b.c", "commit", "-qm", "One"],
    ):
        subprocess.run(["git", *words], cwd=package, check=True, capture_output=True)
    named = ros1_environment(f"http://127.0.0.1:{claim_port()}", tmp_path)
    path = {"ROS_PACKAGE_PATH": str(tmp_path / "ws" / "src"), "PYTHONUNBUFFERED": "1"}
    return {**named, **path, "ROS_LOG_DIR": str(tmp_path / "log")}


def _commit(folder: Path) -> str:
    return subprocess.run(["git", "rev-parse", "HEAD"], cwd=folder, check=True, capture_output=True, text=True).stdout


@pytest.mark.long
@needs_roslaunch
def test_a_node_of_ros_1_gets_its_treatments_names_and_parameters_and_its_commit_is_recorded(
    execute: Callable[..., Executed], workspace: dict[str, str], tmp_path: Path
) -> None:
    body = f"""plugins = [RosNode(
        'subject_nav', 'planner.py', arguments=['fast lane', treatment('Planner')], namespace='alice', node_name='nav',
        parameters={{'planner': treatment('Planner'), 'limits': {{'speed': 0.5}}, 'exact': '<1>'}},
        parameters_file={str(tmp_path / "hall.yaml")!r}, remappings={{'scan': '/front/scan'}},
        environment={workspace!r}, ros=1, name='Nav', ready='planner has')]"""
    done = execute(body, table=TABLE.replace('"dwa", ', ""))  # `ros2 run` shows that each run has its own
    assert (done.finished.failures, done.finished.done_count) == ((), 1)
    output = (done.folder / "runs/r_1/Nav/stdout.txt").read_text()
    assert "planner has '/alice/nav' '/front/scan' 'teb' 0.5 'hall' '<1>' 'fast lane' 'teb'" in output
    assert "shut down" in output
    started = done.journal("subject")[0]
    package = tmp_path / "ws" / "src" / "subject_nav"
    described = {"version": "1.2.3", "commit": _commit(package).strip(), "is_dirty": False}
    assert (started["ros"], started["packages"]) == (1, {"subject_nav": described})


@pytest.mark.long
@needs_roslaunch
def test_a_node_of_ros_1_finds_nothing_at_the_master_that_the_run_before_has_set(
    execute: Callable[..., Executed], workspace: dict[str, str], tmp_path: Path
) -> None:
    node = """#!/usr/bin/python3
import rospy
rospy.init_node("planner")
print("planner has", rospy.get_param("~inflation", "no inflation"), rospy.get_param("~speed"), flush=True)
rospy.spin()
"""
    (tmp_path / "ws/src/subject_nav/planner.py").write_text(node)
    (tmp_path / "dwa.yaml").write_text("{inflation: 0.9, speed: 1}")
    (tmp_path / "teb.yaml").write_text("speed: 2")
    with ros1_master(tmp_path) as uri, xmlrpc.client.ServerProxy(uri) as server:
        server.setParam("/test", "/alice/planner/speed", 7)
        body = f"""plugins = [RosNode(
            'subject_nav', 'planner.py', namespace='alice', node_name='planner',
            parameters_file=[[{str(tmp_path)!r} + '/', treatment('Planner'), '.yaml']],
            environment={workspace | {"ROS_MASTER_URI": uri}!r}, ros=1, name='Nav', ready='planner has')]"""
        done = execute(body)
        left = server.getParam("/test", "/alice")[2], server.getParam("/test", "/robot_runner_kept")[2]
    told = [(done.folder / f"runs/{run}/Nav/stdout.txt").read_text() for run in ("r_1", "r_2")]
    assert "planner has 0.9 1" in told[0]
    assert "planner has no inflation 2" in told[1]
    assert left == ({"planner": {"speed": 7}}, {})


@pytest.mark.long
@needs_roslaunch
def test_what_roslaunch_would_refuse_of_a_node_is_found_before(
    problems: Callable[[str], list[str]], workspace: dict[str, str]
) -> None:
    def of(words: str) -> list[str]:
        return problems(f"plugins = [RosNode({words}, environment={workspace!r}, ros=1)]")

    (absent,) = of("'subject_nav', 'planer.py'")
    assert "Cannot locate node of type [planer.py] in package [subject_nav]" in absent
    assert "ResourceNotFound: subject_na" in of("'subject_na', 'planner.py'")[0]
    (lost,) = of("'subject_nav', 'planner.py', parameters_file='/nowhere.yaml'")
    assert "file does not exist [/nowhere.yaml]" in lost


@pytest.mark.long
@needs_roslaunch
def test_a_node_of_ros_1_that_dies_fails_the_run(execute: Callable[..., Executed], workspace: dict[str, str]) -> None:
    done = execute(  # its parameters are missing
        f"plugins = [RosNode('subject_nav', 'planner.py', environment={workspace!r}, ros=1, ready='none')]",
        table=TABLE.replace('"dwa", ', ""),
    )
    assert done.finished.done_count == 0
    assert "RosNode has died" in done.finished.failures[0]


@pytest.mark.long
def test_ros2_run_gets_the_words_of_a_node_and_its_middleware(
    execute: Callable[..., Executed], problems: Callable[[str], list[str]], tmp_path: Path, token: str
) -> None:
    program = tmp_path / "bin" / "ros2"
    program.parent.mkdir()
    program.write_text(ROS2.replace("TOKEN", token))
    program.chmod(0o755)
    (tmp_path / "hall.yaml").write_text("/**:\n  ros__parameters:\n    map: hall\n")
    path = {"PATH": f"{program.parent}:{Path(sys.executable).parent}:/usr/bin:/bin"}

    def body(words: str) -> str:
        return f"plugins = [RosNode({words}, environment={path!r}, ros=2, name='Nav', ready='word <speed', rmw=None)]"

    given = f"""'nav', 'planner', arguments=['--fast'], parameters={{'planner': treatment('Planner'), 'speed': 0.2,
        'goal': {{'x': [1, 2]}}}}, parameters_file={str(tmp_path / "hall.yaml")!r},
        remappings={{'scan': '/front/scan'}}, node_name='nav', namespace='/alice'"""
    done = execute(body(given).replace("rmw=None", "rmw='rmw_cyclonedds_cpp'").replace("word <speed", "word <goal.x"))
    assert (done.finished.failures, done.finished.done_count) == ((), 2)
    lines = (done.folder / "runs/r_2/Nav/stdout.txt").read_text().splitlines()
    words = [line[6:-1] for line in lines if line.startswith("word <")]
    assert lines[0] == "middleware rmw_cyclonedds_cpp"
    remaps = ["-r", "scan:=/front/scan", "-r", "__node:=nav", "-r", "__ns:=/alice"]
    parameters = ["-p", 'planner:="teb"', "-p", "speed:=0.2", "-p", "goal.x:=[1, 2]"]
    files = ["--params-file", str(tmp_path / "hall.yaml")]
    assert words == ["--fast", "--ros-args", *remaps, *files, *parameters]
    assert lines[-1] == "interrupted"
    assert gone(token)
    assert problems(body("'nav', 'planer'")) == ["the package 'nav' has no executable 'planer'"]
    assert problems(body("'no_package', 'planner'")) == ["ros2 refuses no_package: Package 'no_package' not found"]
    assert problems(body("'nav', 'planner', parameters_file='lost.yaml'")) == [
        "there is no file of parameters 'lost.yaml'"
    ]
    wrong = body("'nav', 'planner'").replace("rmw=None", "rmw='rmw_cyclondds_cpp'")
    assert problems(wrong) == ["the middleware 'rmw_cyclondds_cpp' is not installed"]


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        ({"arguments": "--fast"}, "arguments is"),
        ({"node_name": "a/b"}, "cannot be named"),
        ({"namespace": "a b"}, "cannot be the name of a namespace"),
        ({"parameters": {"speed": float("nan")}}, "'speed' cannot be nan"),
        ({"parameters": {"a b": 1}}, "'a b' is not the name of a parameter"),
        ({"parameters": {"a": {"b": object()}}}, "'a.b' cannot be"),
        ({"ros": 1, "rmw": "rmw_fastrtps_cpp"}, "and ros is 1"),
    ],
)
def test_parameters_that_cannot_be_are_refused(wrong: dict[str, object], told: str) -> None:
    with pytest.raises(PluginError, match=told):
        RosNode("nav", "planner", **{"ros": 2, **wrong})


def test_packages_of_overlays_are_told_with_the_commits_of_their_sources(tmp_path: Path) -> None:
    from robot_runner.subjects.ros_subject import _DESCRIBE

    for path, name in (("src/a", "a"), ("install/a/share/a", "a"), ("install/b/share/b", "b"), ("src/a/test/c", "c")):
        (tmp_path / path).mkdir(parents=True)
        (tmp_path / path / "package.xml").write_text(
            f'<package format="3"><name>{name}</name><version> 2.0.1 </version>'
        )
    prefixes = os.pathsep.join([str(tmp_path / "install" / "a"), str(tmp_path / "install" / "b"), "/opt/ros/jazzy"])
    environment = {"PATH": os.environ["PATH"], "AMENT_PREFIX_PATH": prefixes}
    for described in ({"version": "2.0.1"}, None):
        said = subprocess.run(_DESCRIBE, env=environment, capture_output=True, check=True).stdout
        told = json.loads(said)
        assert sorted(told) == ["a", "b"]
        if described is not None:
            assert told["a"] == told["b"] == described
            for words in (
                ["init", "-q"],
                ["add", "src"],
                ["-c", "user.name=A", "-c", "user.email=a@b.c", "commit", "-qm", "A"],
            ):
                subprocess.run(["git", *words], cwd=tmp_path, check=True, capture_output=True)
    assert (told["a"]["commit"], told["a"]["is_dirty"]) == (_commit(tmp_path).strip(), False)


@pytest.mark.parametrize("value", [1e-06, 1e16, -2.5e-09, 0.1, 3, True, "1e-06", "a < b & c: 'd'", [1e-06, 2.0], ["1"]])
def test_values_are_the_same_once_they_are_read_as_yaml(value: object) -> None:
    node = RosNode("nav", "planner", parameters={"speed": value}, ros=1)
    (parameter,) = minidom.parseString(node.words()[-1]).getElementsByTagName("rosparam")  # noqa: S318 - our own
    found = yaml.safe_load(parameter.firstChild.data)  # as rosparam reads it
    assert (found, type(found)) == (value, type(value))
    words = RosNode("nav", "planner", parameters={"speed": value}, ros=2).words()
    assert yaml.safe_load(words[-1].removeprefix("speed:=")) == value


@pytest.mark.parametrize(
    ("robot", "namespace", "started_in"),
    [
        ("ros2", "", None),
        ("ros2", "/alice", "/alice"),
        ("ros2://alice", "", "/alice"),
        ("ros2:domain=7,namespace=/alice", "arm", "/alice/arm"),
        (None, "alice", "/alice"),
    ],
)
def test_a_node_is_started_within_the_namespace_of_the_run_s_robot(monkeypatch, tmp_path, robot, namespace, started_in):
    monkeypatch.setattr(RosSubject, "prepare_start", lambda *_: None)  # a master of ROS 1 would be asked
    for ros, told in ((1, f'ns="{str(started_in).strip("/")}"'), (2, f"__ns:={started_in}")):
        node = RosNode("nav", "planner", namespace=namespace, ros=ros)
        node.prepare_start(make_context(tmp_path / str(ros), node, robot=robot, links=FakeLinks()))
        assert any(told in word for word in node.words()) is (started_in is not None)
        shared = RosNode("nav", "planner", namespace=namespace, ros=ros, per="experiment")
        shared.prepare_start(make_context(tmp_path / f"all {ros}", shared, robot=robot, links=FakeLinks()))
        assert shared.words() == RosNode("nav", "planner", namespace=namespace, ros=ros).words()


@pytest.mark.parametrize(
    ("robot", "environment", "told"),
    [
        ("dds:domain=7", {}, "7 http://here:11311"),
        ("ros2:domain=9,namespace=/alice", {}, "9 http://here:11311"),
        ("ros2://alice", {}, "3 http://here:11311"),
        ("ros1:master=http://bob:11311", {}, "3 http://bob:11311"),
        ("dds:domain=7", {"ROS_DOMAIN_ID": 8}, "8 http://here:11311"),
        (None, {}, "3 http://here:11311"),
    ],
)
@pytest.mark.parametrize("per", ["run", "experiment"])
def test_a_program_is_started_on_the_graph_of_its_robot_unless_it_is_told_another(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, robot: str | None, environment: dict, told: str, per: str
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "3")
    monkeypatch.setenv("ROS_MASTER_URI", "http://here:11311")
    asks = ["sh", "-c", "echo $ROS_DOMAIN_ID $ROS_MASTER_URI"]
    program = Program(asks, environment=environment, per=per, exit_codes=[0])
    begun = program._begin(make_context(tmp_path, program, robot=robot, links=FakeLinks()), tmp_path / "started")
    while begun.ended() is None:
        time.sleep(0.01)
    assert (tmp_path / "started" / "stdout.txt").read_text().strip() == told
    begun.stop()


def test_on_another_computer_the_master_has_an_address_of_its_own_and_the_domain_is_the_same() -> None:
    assert graph_variables("dds:domain=7", is_here=False) == {"ROS_DOMAIN_ID": "7"}
    assert graph_variables("ros1:master=http://127.0.0.1:11311", is_here=False) == {}


@pytest.mark.parametrize(
    ("options", "folder"),
    [
        ({}, {"ROS_LOG_DIR": "/results/Nav/ros_log"}),
        ({"environment": {"ROS_LOG_DIR": "/logs"}}, {}),
        ({"host": "pi@robot"}, {}),  # where this computer's folders are not
    ],
)
def test_nodes_of_this_computer_write_their_logs_beside_their_output_unless_they_are_told_another_folder(
    options: dict, folder: dict[str, str]
) -> None:
    node = RosNode("nav", "planner", ros=2, **options)
    assert node.variables(Path("/results/Nav")) == folder


@pytest.mark.parametrize(
    "text", ["on", "1", "1e-6", "h\u00e9 \u6f22", "\U0001f916 ok", "\\ud83e\\udd16", "a\nb: 'c' #"]
)
def test_a_text_is_the_same_text_in_yaml(text: str) -> None:
    (value,) = RosNode("nav", "planner", parameters={"say": text}, ros=2).words()[-1:]
    assert yaml.safe_load(value.removeprefix("say:=")) == text
