"""Launch files under test: the real roslaunch of ROS 1, and a stand-in for `ros2 launch` that answers as it does."""

from __future__ import annotations

import shutil
from functools import partial
from typing import TYPE_CHECKING

import pytest
from tests.conftest import HEAD, written_config
from tests.core.execution.conftest import Executed, execute_in
from tests.long_cases import soak_but
from tests.loopback_port import claim_port
from tests.ros.ros1_master import ros1_environment
from tests.subjects.conftest import gone

from robot_runner.core.config.preparation import prepare
from robot_runner.core.errors import PluginError
from robot_runner.plugins.systems import RosLaunch
from robot_runner.testing import FakeLinks, make_context

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

needs_roslaunch = pytest.mark.skipif(
    shutil.which("roslaunch") is None, reason="no roslaunch on this machine (on Debian: apt install python3-roslaunch)"
)
OURS = HEAD.replace("import *\n", "import *\nfrom robot_runner.plugins.systems import RosLaunch\n", 1)
TABLE = """\
    def create_run_table(self):
        return RunTableModel([Factor("Planner", ["dwa", "teb"])], seed=1, shuffle=False)
"""
LAUNCH = """\
<launch>
  <arg name="planner"/>
  <arg name="rviz" default="true"/>
  <node name="planner" pkg="subject_nav" type="planner.py" args="$(arg planner) $(arg rviz) TOKEN" output="screen"/>
</launch>
"""
#: A node that is known to the master, and that says which of the signals ends it.
NODE = """\
#!/usr/bin/python3
import sys
import rospy
rospy.init_node("planner")
rospy.on_shutdown(lambda: print("shut down", flush=True))
print("plans with", *sys.argv[1:3], flush=True)
rospy.spin()
"""
#: As ros2 launch of ROS 2 Jazzy answers: the arguments of a launch file, its errors, and its end after SIGINT.
ROS2 = """\
#!/bin/sh
[ "$1" = launch ] || exit 2
case "$*" in
    *no_package*) echo "Package 'no_package' not found: \\"package 'no_package' not found\\"" >&2; exit 1;;
    *--show-args*)
        printf "Arguments (pass arguments as '<name>:=<value>'):\\n\\n"
        printf "    'planner':\\n        Which one.\\n        (default: 'dwa')\\n\\n"
        printf "    'rviz':\\n        no description given\\n"; exit 0;;
esac
echo "[INFO] [launch]: All log files can be found below $ROS_LOG_DIR"
echo "[INFO] [planner-1]: process started with pid [7]"
echo "[planner-1] plans with $*"
case "$*" in *planner:=teb*)
    echo "[planner-1] [ERROR] [map-2]: process has died [pid 8, exit code 1, cmd 'what a node writes']."
    echo "[ERROR] [planner-1]: process has died [pid 7, exit code -11, cmd 'planner --ros-args'].";;
esac
trap 'echo "[INFO] [planner-1]: process has finished cleanly"; kill $!; exit 0' INT
sh -c 'while :; do sleep 0.2; done' TOKEN &
wait
"""


def body_of(parameters: str, environment: dict[str, str], ros: int) -> str:
    return (
        f"plugins = [RosLaunch({parameters}, environment={environment!r}, ros={ros}, name='Nav', ready='plans with')]"
    )


@pytest.fixture
def execute(tmp_path: Path) -> Callable[..., Executed]:
    return partial(execute_in, tmp_path, head=OURS, table=TABLE)


@pytest.fixture
def problems(tmp_path: Path) -> Callable[[str], list[str]]:
    def found(body: str) -> list[str]:
        return [finding.problem for finding in prepare(written_config(tmp_path, body, head=OURS, table=TABLE)).findings]

    return found


@pytest.fixture
def environment(tmp_path: Path, token: str) -> dict[str, str]:
    """Return the environment of a workspace with one package, whose launch starts a master of its own."""
    package = tmp_path / "subject_nav"
    package.mkdir()
    (package / "package.xml").write_text("<package><name>subject_nav</name></package>")
    (package / "nav.launch").write_text(LAUNCH.replace("TOKEN", token))
    (package / "planner.py").write_text(NODE)
    (package / "planner.py").chmod(0o755)
    named = ros1_environment(f"http://127.0.0.1:{claim_port()}", tmp_path)
    return {**named, "ROS_PACKAGE_PATH": str(tmp_path), "ROS_LOG_DIR": str(tmp_path / "log"), "PYTHONUNBUFFERED": "1"}


@pytest.mark.long
@needs_roslaunch
def test_roslaunch_launches_nodes_with_the_treatments_and_ends_them_as_ctrl_c_would(
    execute: Callable[..., Executed], environment: dict[str, str], token: str
) -> None:
    parameters = "'subject_nav', 'nav.launch', arguments={'planner': treatment('Planner'), 'rviz': False}"
    done = execute(body_of(parameters, environment, 1))
    assert (done.finished.failures, done.finished.done_count) == ((), 2)
    for run_id, planner in (("r_1", "dwa"), ("r_2", "teb")):
        output = (done.folder / "runs" / run_id / "Nav" / "stdout.txt").read_text()
        assert f"plans with {planner} false" in output
        assert "shut down" in output
    ended = done.journal("subject")[1]
    assert (ended["was_asked"], ended["exit_code"]) == (True, 0)
    assert gone(token)


#: A node that dies once another is there.
DYING = """\
#!/usr/bin/python3
import sys
import rospy
rospy.init_node("dying")
rospy.wait_for_service("/planner/get_loggers")
sys.exit(3)
"""


@pytest.mark.long
@needs_roslaunch
@pytest.mark.parametrize("per", soak_but({"run"}, ["run", "experiment"]))
def test_values_are_doubtful_where_a_launched_node_died_and_the_others_went_on(
    execute: Callable[..., Executed], environment: dict[str, str], tmp_path: Path, per: str
) -> None:
    package = tmp_path / "subject_nav"
    (package / "dying.py").write_text(DYING)
    (package / "dying.py").chmod(0o755)
    dying = '<node name="dying" pkg="subject_nav" type="dying.py"/>\n</launch>'
    (package / "nav.launch").write_text((package / "nav.launch").read_text().replace("</launch>", dying))
    parameters = f"'subject_nav', 'nav.launch', arguments={{'planner': 'dwa'}}, per={per!r}"
    died = "has died [pid"
    mission = f"""
def launch_mission(self, context):
    while not all({died!r} in each.read_text() for each in context.experiment_folder.rglob("Nav/**/stderr.txt")):
        context.clock.sleep(0.05)"""
    done = execute(body_of(parameters, environment, 1) + mission)
    assert (done.finished.failures, done.finished.done_count) == ((), 2)
    doubts = [record for record in done.journal("finding") if "has died" in record["problem"]]
    assert {record["run"] for record in doubts} == {"r_1", "r_2"}, "one that goes on in all runs lacks it in each"
    assert all(record["problem"] == "dying-3, which it launched, has died: exit code 3" for record in doubts)
    assert all('required="true"' in record["fix"] for record in doubts)


#: A node that ends later than Ctrl-C asks, so that roslaunch takes its time.
STUBBORN = """\
#!/usr/bin/python3
import signal, time
signal.signal(signal.SIGINT, signal.SIG_IGN)
while True:
    time.sleep(1)
"""


@pytest.mark.long
@needs_roslaunch
@pytest.mark.parametrize("code", soak_but({0}, [3, 0]))
def test_values_are_doubtful_where_a_required_node_died_and_the_mission_ended_before_roslaunch_did(
    execute: Callable[..., Executed], environment: dict[str, str], tmp_path: Path, code: int
) -> None:
    package = tmp_path / "subject_nav"
    for name, text in (("dying.py", DYING.replace("exit(3)", f"exit({code})")), ("stubborn.py", STUBBORN)):
        (package / name).write_text(text)
        (package / name).chmod(0o755)
    more = '<node name="dying" pkg="subject_nav" type="dying.py" required="true"/>\n'
    more += '<node name="stubborn" pkg="subject_nav" type="stubborn.py"/>\n</launch>'
    (package / "nav.launch").write_text((package / "nav.launch").read_text().replace("</launch>", more))
    parameters = "'subject_nav', 'nav.launch', arguments={'planner': 'dwa'}, grace_s=0.5"
    mission = """
def launch_mission(self, context):
    while "Initiating shutdown" not in (context.run_path / "Nav" / "stderr.txt").read_text():
        context.clock.sleep(0.05)"""
    done = execute(body_of(parameters, environment, 1) + mission, table=TABLE.replace('"dwa", ', ""))
    assert (done.finished.failures, done.finished.done_count) == ((), 1)
    told = [record["problem"] for record in done.journal("finding")]
    assert f"dying-3, which it launched, has died: exit code {code}" in told


@pytest.mark.long
@needs_roslaunch
def test_roslaunch_is_asked_for_what_it_would_refuse_with_each_treatment(
    problems: Callable[[str], list[str]], environment: dict[str, str]
) -> None:
    (unknown, missing) = problems(body_of("'subject_nav', 'nav.launch', arguments={'planer': 'dwa'}", environment, 1))
    assert unknown == "the launch file takes no argument 'planer': nothing would read it"
    assert "requires the 'planner' arg to be set" in missing
    absent = problems(body_of("'subject_nav', treatment('Planner')", environment, 1))
    assert [each[: each.index(":")] for each in absent] == ["with Planner = dwa", "with Planner = teb"]
    assert all("is neither a launch file in package [subject_nav]" in each for each in absent)


@pytest.mark.long
def test_ros2_launch_gets_the_treatments_and_is_interrupted(
    execute: Callable[..., Executed], problems: Callable[[str], list[str]], tmp_path: Path, token: str
) -> None:
    (tmp_path / "bin").mkdir()
    program = tmp_path / "bin" / "ros2"
    program.write_text(ROS2.replace("TOKEN", token))
    program.chmod(0o755)
    path = {"PATH": f"{program.parent}:/usr/bin:/bin"}
    done = execute(body_of("'nav', 'nav.launch.py', arguments={'planner': treatment('Planner')}", path, 2))
    assert (done.finished.failures, done.finished.done_count) == ((), 2)
    output = (done.folder / "runs/r_2/Nav/stdout.txt").read_text()
    assert f"below {done.folder}/runs/r_2/Nav/ros_log" in output
    assert "plans with launch nav nav.launch.py planner:=teb" in output
    assert "process has finished cleanly" in output
    assert [(each["run"], each["problem"]) for each in done.journal("finding")] == [
        ("r_2", "planner-1, which it launched, has died: exit code -11")
    ]
    assert gone(token)
    assert problems(body_of("'nav', 'nav.launch.py', arguments={'planer': 1}", path, 2)) == [
        "the launch file takes no argument 'planer': nothing would read it"
    ]
    (outer,) = prepare(
        written_config(tmp_path, body_of("'nav', 'nav.launch.py', arguments={'map': 1}", path, 2), head=OURS)
    ).findings
    assert (outer.is_error, outer.problem) == (
        False,
        "the launch file declares no argument 'map': only what it includes may read it",
    )
    (refused,) = problems(body_of("'no_package', 'nav.launch.py'", path, 2))
    assert refused.startswith("ros2 refuses no_package/nav.launch.py: Package 'no_package' not found")
    assert problems(body_of("'nav', 'nav.launch.py'", {"PATH": "/nowhere"}, 2)) == ["the program 'ros2' is not there"]


@pytest.mark.long
def test_a_launch_file_is_told_the_namespace_of_the_run_s_robot_of_several(
    execute: Callable[..., Executed], tmp_path: Path, token: str
) -> None:
    program = tmp_path / "ros2"
    program.write_text(ROS2.replace("TOKEN", token).replace("'rviz'", "'namespace'"))
    program.chmod(0o755)
    parameters = "'nav', 'nav.launch.py', arguments={'namespace': '{namespace}', 'planner': treatment('Planner')}"
    body = body_of(parameters, {"PATH": f"{tmp_path}:/usr/bin:/bin"}, 2)
    done = execute(f"robot = Robots('simulated://alice', 'simulated://bob')\n{body}")
    assert (done.finished.failures, done.finished.done_count) == ((), 2)
    for row, planner in zip(done.table, ("dwa", "teb"), strict=True):
        output = (done.folder / "runs" / row["run_id"] / "Nav" / "stdout.txt").read_text()
        assert f"plans with launch nav nav.launch.py namespace:={row['Robot']} planner:={planner}\n" in output
    assert {row["Robot"] for row in done.table} == {"alice", "bob"}


@pytest.mark.parametrize(
    ("robot", "value", "told"),
    [
        ("ros2://alice", "{namespace}", ("namespace:=alice",)),
        ("ros2:domain=7,namespace=/fleet/alice", "/{namespace}/nav", ("namespace:=/fleet/alice/nav",)),
        ("ros2", "{namespace}", ()),
        (None, "{namespace}", ()),
        ("ros2", "{name}", ("namespace:={name}",)),
    ],
)
def test_an_argument_may_hold_the_namespace_of_the_run_s_robot_and_is_left_out_where_there_is_none(
    tmp_path: Path, robot: str | None, value: str, told: tuple[str, ...]
) -> None:
    launch = RosLaunch("nav", "nav.launch", arguments={"namespace": value}, ros=2)
    launch.prepare_start(make_context(tmp_path, launch, robot=robot, links=FakeLinks()))
    assert launch.words() == ("ros2", "launch", "nav", "nav.launch", *told)


def test_what_is_launched_for_all_runs_has_no_robot_of_its_own() -> None:
    with pytest.raises(PluginError, match="all runs") as refused:
        RosLaunch("nav", "nav.launch", arguments={"namespace": "{namespace}"}, ros=2, per="experiment")
    assert refused.value.fix == "Start it in each run (per='run'), or write the namespace out."


@pytest.mark.parametrize("wrong", [{"ros": 3}, {"host": "pi@robot"}, {"setup": "install/setup.bash"}])
def test_which_ros_is_meant_has_to_be_said_where_it_cannot_be_seen(wrong: dict[str, object]) -> None:
    with pytest.raises(PluginError, match="ros"):
        RosLaunch("nav", "nav.launch", **wrong)


def test_the_ros_that_is_sourced_is_taken() -> None:
    for ros, first in (("1", "roslaunch"), ("2", "ros2")):
        assert RosLaunch("nav", "nav.launch", environment={"ROS_VERSION": ros}).words()[0] == first
