"""Software that goes on through all runs drives a robot without a watchdog: whoever dies, the robot stands still."""

from __future__ import annotations

import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import time
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from tests.core.links.ssh_server import SshServer
from tests.long_cases import soak_but
from tests.process.conftest import command_line, kill_together, named, wait_until
from tests.ros.real_graph import over, over_pairs
from tests.ros.ros1_master import RUDE
from tests.subjects.conftest import gone

from robot_runner.core.errors import LinkError
from robot_runner.core.execution.left_systems import may_be_moving, robots_left
from robot_runner.core.execution.standby_lock import locked_by
from robot_runner.core.links import commanded_topics
from robot_runner.core.links.commanded_topics import keep_commanding_zero
from robot_runner.core.links.connect import open_robot
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.outliving import process_stat
from robot_runner.testing.rosbridge_server import RosbridgeServer

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from tests.process.conftest import Experiment

    from robot_runner.core.links.robot import RobotLink

pytestmark = [*map(pytest.mark.filterwarnings, RUDE)]

#: A planner that drives at once, and stops nobody when it is killed: whoever leaves a graph in order stops the robot.
PLANNER = """
import os, signal, sys, time
from robot_runner.core.links.connect import open_robot

signal.signal(signal.SIGTERM, lambda *_: os._exit(0))
with open_robot(sys.argv[1]) as (link, _):
    while True:
        link.publish("/cmd_vel", "geometry_msgs/Twist", {"linear": {"x": 0.2}})
        print("drives", flush=True)
        time.sleep(0.05)
"""
CONFIG = """
import sys
import time
from pathlib import Path
from robot_runner import ExperimentConfig, Factor, RunTableModel
from robot_runner.plugins.systems import Program

class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "trial"
    results_output_path = Path(__file__).parent / "results"
    robot = "{robot}"
    time_between_runs_in_ms = 600_000
    plugins = [Program(
        ["sh", "-c", '"$0" "$@" & wait', sys.executable, str(Path(__file__).with_name("planner.py")), robot],
        name="Planner", per="experiment", ready="drives", ready_timeout_s=60,
    )]

    def launch_mission(self, context):
        context.clock.sleep(0.1)

    def create_run_table(self):
        return RunTableModel([Factor("Map", ["hall", "kitchen"])])
"""


SUPERVISOR, HALTING = b"subjects/supervisor.py", b"robot_runner.subjects.halting"


class Robot:
    """Hears what it is commanded, and carries out the last of it for ever."""

    def __init__(self, link: RobotLink, topic: str = "/cmd_vel") -> None:
        self._heard: list[float] = []
        link.subscribe(topic, "geometry_msgs/Twist", lambda twist: self._heard.append(twist["linear"]["x"]))

    def moves(self) -> bool:
        """Whether the last that it was commanded, since the last call and before, is to drive."""
        return bool(self._heard) and self._heard[-1] > 0

    def await_rest(self) -> None:
        """Wait until it stands still, for good: nobody commands it any more, but what was sent may be heard late."""
        wait_until(lambda: not self.moves(), "it is commanded to stand still")
        heard = -1
        while len(self._heard) > heard:
            heard = len(self._heard)
            time.sleep(1.0)
        wait_until(lambda: not self.moves(), "that is the last that it was commanded")

    def stood_still(self) -> bool:
        """Whether it was commanded to stand still since the last call."""
        heard, self._heard = self._heard, self._heard[-1:]
        return 0.0 in heard[1:]


def parent_of(pid: int) -> int:
    return int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[1])


@pytest.mark.long
@over_pairs(
    "killed",
    [
        "the orchestrator",
        "the supervisor",
        "the orchestrator and the supervisor",
        "the program",
        "the processes that halt",
        "the orchestrator and the first process that halts",
        "the orchestrator and the processes that halt",
        "the orchestrator, as the first process that halts is stopped",
        "the orchestrator, as the supervisor is stopped",
    ],
    "dds",
    "ros1",
    "ros2",
    everywhere=["the orchestrator and the processes that halt"],
)
def test_a_robot_that_a_program_of_all_runs_drives_stands_still_between_two_runs_whoever_is_killed(
    graph: str, start: Callable[..., Experiment], tmp_path: Path, killed: str
) -> None:
    (tmp_path / "planner.py").write_text(PLANNER)
    config = tmp_path / "config.py"
    config.write_text(CONFIG.format(robot=graph))
    with open_robot(graph) as (link, _):
        robot = Robot(link)
        experiment = start(config=config)
        wait_until(
            lambda: (experiment.folder / "run_table.csv").exists() and "Done" in experiment.statuses, "a run is done"
        )
        robot.stood_still()
        wait_until(robot.moves, "the program drives it on between two runs")
        if killed == "the program":
            events = experiment.folder / "subjects" / "Planner" / "1" / "events.jsonl"
            os.kill(json.loads(events.read_text().splitlines()[0])["started"], signal.SIGKILL)
            wait_until(lambda: not robot.moves(), "it stands still")
            experiment.send(signal.SIGINT)
        else:
            doomed = {"the orchestrator": [experiment.process.pid], "the supervisor": named(experiment, SUPERVISOR)}
            halting = named(experiment, HALTING)
            first = [pid for pid in halting if parent_of(pid) not in halting]
            assert (len(first), len(halting)) == (1, 2)
            doomed |= {"the processes that halt": halting, "the first process that halts": first}
            who, _, stopped = killed.removesuffix(" is stopped").partition(", as ")
            for pid in doomed[stopped] if stopped else ():
                os.kill(pid, signal.SIGSTOP)
            kill_together(pid for each in who.split(" and ") for pid in doomed[each])
            if killed == "the supervisor":
                wait_until(lambda: not robot.moves(), "it stands still")
            if "orchestrator" not in killed:
                experiment.send(signal.SIGINT)
        experiment.end()
        experiment.nobody_is_left()
        if (
            killed == "the orchestrator and the processes that halt"
        ):  # nobody is left who could: the next execution does
            assert robot.moves()
            (told,) = may_be_moving(ExperimentFolder.found_at(experiment.folder))
            assert "killed while Planner commanded the robot" in told.problem
            experiment = start(config=config)
            wait_until(robot.stood_still, "it is commanded to stand still before the program is started again")
            wait_until(
                lambda: not experiment.processes() or experiment.statuses.count("Done") == 2, "both runs are done"
            )
            assert experiment.end() == 0, experiment.output
            said = (
                "an earlier execution was killed while Planner commanded the robot; it was commanded to stand still now"
            )
            assert said in experiment.output
            experiment.nobody_is_left()
            robot.await_rest()


@pytest.fixture
def server(tmp_path: Path) -> Iterator[SshServer]:
    (tmp_path / "sshd").mkdir()
    started = SshServer(tmp_path / "sshd")
    yield started
    started.stop()


def wait_until_seen_to_move(robot: Robot, experiment: Experiment) -> None:
    """Wait until a program drives the robot, and the run has seen that."""
    wait_until(robot.moves, "the program drives it")
    told = experiment.folder / ".to_make_safe"
    wait_until(lambda: told.exists() and "/cmd_vel" in told.read_text(), "the run has seen that")


def on_host(server: SshServer) -> str:
    """Return the arguments of a program that is executed on another computer, where the graph is the same."""
    known = {"CYCLONEDDS_URI": os.environ.get("CYCLONEDDS_URI")}  # a shell over there has not this one's variables
    return f"host='robot', ssh_config={str(server.config)!r}, environment={known!r}"


@over("dds")
@pytest.mark.long
@pytest.mark.parametrize("per", soak_but({"experiment"}, ["run", "experiment"]))
def test_a_robot_that_a_program_out_of_reach_may_drive_on_is_told_of_and_no_further_run_begins(
    graph: str, start: Callable[..., Experiment], tmp_path: Path, server: SshServer, per: str
) -> None:
    (tmp_path / "planner.py").write_text(PLANNER)
    config = tmp_path / "config.py"
    text = CONFIG.format(robot=graph).replace('per="experiment"', f"per={per!r}, {on_host(server)}")
    config.write_text(text.replace("sleep(0.1)", "sleep(3600)").replace("600_000", "0"))
    with open_robot(graph) as (link, _):
        robot = Robot(link)
        experiment = start(config=config)
        wait_until_seen_to_move(robot, experiment)
        server.cut()
        assert experiment.end() == 1
    assert "and commands the robot until then: THE ROBOT MAY BE MOVING" in experiment.output
    assert [row["status"] for row in experiment.table] == ["Failed", "-" if per == "run" else "Failed"]
    if per == "experiment":  # it would be started again before the next run, which is not begun
        assert "(r_2) failed after" in experiment.output
        assert "before_run of Planner" in experiment.output
        assert [each.name for each in (experiment.folder / "subjects" / "Planner").iterdir()] == ["1"]


@over("dds")
@pytest.mark.long
def test_a_robot_that_a_program_out_of_reach_of_a_killed_run_may_drive_on_is_told_of(
    graph: str, start: Callable[..., Experiment], tmp_path: Path, server: SshServer
) -> None:
    (tmp_path / "planner.py").write_text(PLANNER)
    config = tmp_path / "config.py"
    text = CONFIG.format(robot=graph).replace('per="experiment"', on_host(server))
    config.write_text(text.replace("sleep(0.1)", "sleep(3600)").replace("600_000", "0"))
    with open_robot(graph) as (link, _):
        robot = Robot(link)
        experiment = start(config=config)
        wait_until_seen_to_move(robot, experiment)
        server.stall()
        os.kill(experiment.run_process(), signal.SIGKILL)
        assert experiment.end() == 1
        assert "THE ROBOT MAY BE MOVING: Planner could not be made safe" in experiment.output
        assert [row["status"] for row in experiment.table] == ["Failed", "-"]


@over("dds")
@pytest.mark.long
def test_a_robot_that_a_program_drives_before_it_is_ready_stands_still_once_the_run_is_killed(
    graph: str, start: Callable[..., Experiment], tmp_path: Path
) -> None:
    (tmp_path / "planner.py").write_text(PLANNER)
    config = tmp_path / "config.py"
    text = (
        CONFIG.format(robot=graph).replace('per="experiment"', 'per="run"').replace('["hall", "kitchen"]', '["hall"]')
    )
    config.write_text(text.replace('ready="drives", ready_timeout_s=60', 'ready="never said", ready_timeout_s=3600'))
    with open_robot(graph) as (link, _):
        robot = Robot(link)
        experiment = start(config=config)
        wait_until_seen_to_move(robot, experiment)
        kill_together([experiment.run_process()])
        assert experiment.end() == 1
        assert experiment.nobody_is_left()
        robot.await_rest()


@over("dds")
@pytest.mark.long
@pytest.mark.parametrize(
    ("with_all", "is_far"),
    [
        pytest.param(True, False, id="the run, its keeper and the orchestrator-here"),
        pytest.param(False, True, id="the run-on another computer"),
        pytest.param(False, False, id="the run-here", marks=pytest.mark.soak),
        pytest.param(True, True, id="the run, its keeper and the orchestrator-far", marks=pytest.mark.soak),
    ],
)
def test_a_program_that_takes_longer_to_end_than_its_killed_run_is_made_safe_drives_the_robot_no_further(
    graph: str,
    start: Callable[..., Experiment],
    tmp_path: Path,
    request: pytest.FixtureRequest,
    with_all: bool,
    is_far: bool,
) -> None:
    obstinate = PLANNER.replace("lambda *_: os._exit(0)", "signal.SIG_IGN").replace("0.05", "0.001")
    (tmp_path / "planner.py").write_text(obstinate)
    config = tmp_path / "config.py"
    text = CONFIG.format(robot=graph).replace('per="experiment"', "grace_s=60").replace("sleep(0.1)", "sleep(3600)")
    text = text.replace('"sh", "-c", \'"$0" "$@" & wait\', ', "").replace('["hall", "kitchen"]', '["hall"]')
    if is_far:
        text = text.replace("grace_s=60", f"grace_s=60, {on_host(request.getfixturevalue('server'))}")
    config.write_text(text)
    with open_robot(graph) as (link, _):
        robot = Robot(link)
        experiment = start(config=config)
        wait_until_seen_to_move(robot, experiment)
        others = [experiment.keeper(), experiment.process.pid] if with_all else []
        kill_together([experiment.run_process(), *others])
        assert experiment.end() == (-signal.SIGKILL if with_all else 1)
        assert experiment.nobody_is_left()
        assert gone(str(tmp_path / "planner.py")), "also over there"
        robot.await_rest()


AT_FIRST = """
    def before_experiment(self):
        Path(__file__).with_name("begun").touch()

    def launch_mission(self, context):
        pass
"""


@over("dds")
@pytest.mark.long
@pytest.mark.parametrize(
    ("per", "name"),
    [
        pytest.param("run", "another", id="another experiment"),
        pytest.param("experiment", "trial", id="the same without the program"),
        pytest.param("run", "trial", id="run-trial", marks=pytest.mark.soak),
        pytest.param("experiment", "another", id="experiment-another", marks=pytest.mark.soak),
    ],
)
def test_a_program_that_nobody_was_left_to_end_is_ended_and_its_robot_stopped_by_whoever_uses_that_next(
    graph: str, start: Callable[..., Experiment], tmp_path: Path, per: str, name: str
) -> None:
    (tmp_path / "planner.py").write_text(PLANNER)
    config = tmp_path / "config.py"
    text = CONFIG.format(robot=graph).replace('per="experiment"', f"per={per!r}").replace("sleep(0.1)", "sleep(3600)")
    config.write_text(text)
    with open_robot(graph) as (link, _):
        robot = Robot(link)
        experiment = start(config=config)
        wait_until_seen_to_move(robot, experiment)
        program = named(experiment, b"python\0" + os.fsencode(tmp_path / "planner.py"))
        program = [pid for pid in program if b"sh\0-c" not in command_line(pid)]
        kill_together(pid for pid in experiment.processes() if pid not in program)
        experiment.end()
        robot.stood_still()
        wait_until(robot.moves, "it is driven on")
        without = text[: text.index("    plugins")] + AT_FIRST + text[text.index("    def create") :]
        config.write_text(without.replace("trial", name))
        following = start("", "--only", "r_2", "--accept-changes", config=config)
        if name == "another":
            following.wait_for("begun")
        else:  # of which nobody knows any more how it is made safe beyond that
            following.end()
            assert "the config has no Planner any more" in following.output
        assert not any(Path(f"/proc/{pid}").exists() for pid in program), "it has ended before anything else"
        assert not robot.moves(), "and the robot stands still"
        if name == "another":
            assert following.end() == 0, following.output


#: Two robots at once, driven by the config alone; no later execution commands anything.
TWO_ROBOTS = """
from pathlib import Path
from robot_runner import ExperimentConfig, Factor, Robots, RunTableModel
from robot_runner.plugins import connect_robot

HERE = Path(__file__).parent

class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "trial"
    results_output_path = HERE / "results"
    robot = Robots(alice={alice!r}, bob={bob!r})
    claims = []

    def before_experiment(self):
        (HERE / "begun").touch()

    def launch_mission(self, context):
        while not (HERE / "killed").exists():
            connect_robot(context).publish("cmd_vel", "geometry_msgs/Twist", {{"linear": {{"x": 0.2}}}})
            context.clock.sleep(0.05)

    def create_run_table(self):
        return RunTableModel([Factor("Map", ["hall", "kitchen"])])
"""


@contextmanager
def two_robots(graph: str) -> Iterator[dict[str, tuple[str, Robot]]]:
    """Yield two robots by name, each with how it is reached; each stands behind a rosbridge of its own, if any."""
    with ExitStack() as opened:
        if graph == "rosbridge":
            links = {name: opened.enter_context(closing(RosbridgeServer())).url for name in ("alice", "bob")}
        else:
            first = f"{graph}," if ":" in graph else f"{graph}:"
            links = {name: f"{first}namespace={name}" for name in ("alice", "bob")}
        yield {
            name: (link, Robot(opened.enter_context(open_robot(link))[0], "cmd_vel")) for name, link in links.items()
        }


def leave_driving(experiment: Experiment, both: dict[str, tuple[str, Robot]], *, stopped: str = "") -> None:
    """Kill both runs, their keepers, those who stand by, and the orchestrator, while both robots drive.

    Args:
        experiment: that drives them.
        both: the robots.
        stopped: `standby` or `keeper`: those are stopped only, and stay.
    """
    robots, folder = [robot for _, robot in both.values()], ExperimentFolder.found_at(experiment.folder)
    wait_until(lambda: all(robot.moves() for robot in robots), "both of them drive")
    # One that is forked only now would not be killed.
    standbys = wait_until(lambda: standbys_of(folder), "somebody stands by for each")
    left = {"standby": standbys, "keeper": [int(process_stat(pid)[1]) for pid in standbys]}.get(stopped, [])
    for pid in left:
        os.kill(pid, signal.SIGSTOP)
    for robot in robots:
        robot.stood_still()  # whatever it was commanded before
    wait_until(lambda: all(robot.moves() for robot in robots), "both of them still drive")
    kill_together(pid for pid in experiment.processes() if pid not in left)
    experiment.end()
    assert [robot.stood_still() for robot in robots] == [False, False], "nobody has stopped them"


@contextmanager
def robots_left_driving(
    graph: str, start: Callable[..., Experiment], folder: Path, *, stopped: str = ""
) -> Iterator[tuple[Experiment, dict[str, tuple[str, Robot]]]]:
    """Yield an experiment in this folder that was killed, whose config can be executed again, and its two robots."""
    config = folder / "config.py"
    with two_robots(graph) as both:
        config.write_text(TWO_ROBOTS.format(**{name: link for name, (link, _) in both.items()}))
        experiment = start(config=config)
        leave_driving(experiment, both, stopped=stopped)
        (folder / "killed").touch()
        (folder / "begun").unlink()
        yield experiment, both


@over("dds", soak=["ros1", "ros2", "rosbridge"])
@pytest.mark.long
def test_robots_that_nobody_was_left_to_stop_are_stopped_by_the_next_execution_before_anything_else(
    graph: str, start: Callable[..., Experiment], tmp_path: Path
) -> None:
    with robots_left_driving(graph, start, tmp_path) as (experiment, both):
        again = start("", "--only", "r_1", config=experiment.config)
        again.wait_for("begun")
        assert not any(robot.moves() for _, robot in both.values()), "both stand still before the experiment begins"
        assert again.end() == 0, again.output
        told = " ".join(again.output.split())
        for run, name in (("r_1", "alice"), ("r_2", "bob")):
            link, robot = both[name]
            said = (
                f"an earlier execution was killed in {run} ({link}), and no process was left to make its systems safe"
            )
            assert f"{said}; that was done now" in told
            assert not robot.moves()
        again.nobody_is_left()


@pytest.mark.long
@over_pairs("stopped", ["", "standby", "keeper"], "rosbridge", "dds", "ros1")
def test_robots_that_a_killed_experiment_left_moving_are_stopped_before_another_one_that_uses_them_begins(
    graph: str, start: Callable[..., Experiment], tmp_path: Path, stopped: str
) -> None:
    with robots_left_driving(graph, start, tmp_path, stopped=stopped) as (experiment, both):
        experiment.config.write_text(experiment.config.read_text().replace('"trial"', '"another"'))
        another = start("", "--only", "r_1", config=experiment.config)
        another.wait_for("begun")
        assert not any(robot.moves() for _, robot in both.values()), "both stand still before it begins"
        assert another.end() == 0, another.output
        told = " ".join(another.output.split())
        for link, _ in both.values():
            assert (
                f"({link}), and no process was left to make its systems safe; its robot was told to stand still" in told
            )
        assert not any((tmp_path / "results" / "trial").glob(".to_make_safe*"))
        assert experiment.nobody_is_left()


def renamed(folder: Path) -> Path:
    """Rename the folder of an experiment."""
    return folder.rename(folder.with_name("old"))


@over("rosbridge", soak=["dds", "ros1"])
@pytest.mark.long
@pytest.mark.parametrize(
    ("becomes_of_it", "name"),
    [
        pytest.param(shutil.rmtree, "trial", id="removed-the same"),
        pytest.param(renamed, "another", id="renamed-another"),
        pytest.param(shutil.rmtree, "another", id="removed-another", marks=pytest.mark.soak),
        pytest.param(renamed, "trial", id="renamed-the same", marks=pytest.mark.soak),
    ],
)
def test_robots_are_stopped_also_where_the_folder_of_the_killed_experiment_was_removed_or_renamed(
    graph: str, start: Callable[..., Experiment], tmp_path: Path, name: str, becomes_of_it: Callable[[Path], object]
) -> None:
    with robots_left_driving(graph, start, tmp_path) as (experiment, both):
        becomes_of_it(experiment.folder)
        ours = [each for each in robots_left() if str(tmp_path) in each.where]
        assert len(ours) == 2, "which `robot-runner doctor` tells"
        experiment.config.write_text(experiment.config.read_text().replace('"trial"', f'"{name}"'))
        following = start("", "--only", "r_1", config=experiment.config)
        following.wait_for("begun")
        assert not any(robot.moves() for _, robot in both.values()), "both stand still before anything else begins"
        assert following.end() == 0, following.output
        told = " ".join(following.output.split())
        for link, _ in both.values():
            assert (
                f"({link}), and no process was left to make its systems safe; its robot was told to stand still" in told
            )
        assert not [each for each in robots_left() if str(tmp_path) in each.where]


@over("rosbridge", soak=["ros1"])
@pytest.mark.long
def test_of_a_live_experiment_whose_folder_was_renamed_no_robot_is_said_to_be_left_moving(
    graph: str, start: Callable[..., Experiment], tmp_path: Path
) -> None:
    with two_robots(graph) as both:
        config = tmp_path / "config.py"
        config.write_text(TWO_ROBOTS.format(**{name: link for name, (link, _) in both.items()}))
        experiment = start(config=config)
        wait_until(lambda: all(robot.moves() for _, robot in both.values()), "both of them drive")
        folder = renamed(experiment.folder)
        assert not [each for each in robots_left() if str(tmp_path) in each.where], "which `robot-runner doctor` tells"
        assert not may_be_moving(ExperimentFolder.found_at(folder)), "which `robot-runner status` tells"
        kill_together(experiment.processes())
        experiment.end()
        assert len([each for each in robots_left() if str(tmp_path) in each.where]) == 2


#: Tells that who stands by for a run has joined the robot's graph.
TOLD = """
from robot_runner.plugins import System

class Told(System):
    def claims(self, robot):
        return []
    def stand_by(self, context):
        (HERE / f"joined_{context.run_id}").touch()
    def make_safe(self, context):
        pass

class RobotRunnerConfig(ExperimentConfig):
    plugins = [Told()]
"""


@over("dds")
@pytest.mark.long
def test_robots_are_stopped_by_who_stands_by_also_where_it_can_open_and_write_no_file_any_more(
    graph: str, start: Callable[..., Experiment], tmp_path: Path
) -> None:
    config = tmp_path / "config.py"
    with two_robots(graph) as both:
        text = TWO_ROBOTS.format(**{name: link for name, (link, _) in both.items()})
        config.write_text(text.replace("\nclass RobotRunnerConfig(ExperimentConfig):\n", TOLD))
        robots = [robot for _, robot in both.values()]
        experiment = start(config=config)
        for run in ("r_1", "r_2"):
            experiment.wait_for(f"joined_{run}")
        wait_until(lambda: all(robot.moves() for robot in robots), "both of them drive")
        folder = ExperimentFolder.found_at(experiment.folder)
        standbys = wait_until(lambda: standbys_of(folder), "somebody stands by for each")
        for pid in standbys:
            resource.prlimit(pid, resource.RLIMIT_NOFILE, (0, 0))
            resource.prlimit(pid, resource.RLIMIT_FSIZE, (0, 0))
        kill_together(pid for pid in experiment.processes() if pid not in standbys)
        wait_until(lambda: not any(robot.moves() for robot in robots), "both stand still")


def standbys_of(folder: ExperimentFolder) -> list[int]:
    """Return who stands by for the first two slots, once somebody does for both."""
    found = [pid for slot in (1, 2) if (pid := locked_by(folder.at_slot(slot))) is not None]
    return found if len(found) == 2 else []


#: A robot that hears its commands, in a process of its own.
SUBSCRIBER = """
import sys, time
from robot_runner.core.links.connect import open_robot

with open_robot(sys.argv[1]) as (link, _):
    link.subscribe("/cmd_vel", "geometry_msgs/Twist", lambda twist: print(twist["linear"]["x"], flush=True))
    print("ready", flush=True)
    time.sleep(3600)
"""


@over("dds", soak=["ros2"])  # a connection of ROS 1 takes what the system of the other process keeps for it
@pytest.mark.long
def test_a_robot_that_takes_no_command_any_more_is_not_said_to_have_been_told_to_stand_still(
    graph: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    command = ("/cmd_vel", "geometry_msgs/Twist")
    robot = subprocess.Popen([sys.executable, "-c", SUBSCRIBER, graph], stdout=subprocess.PIPE, text=True)
    try:
        assert robot.stdout is not None
        assert robot.stdout.readline() == "ready\n"
        with open_robot(graph) as (link, _):
            link.publish(*command, {"linear": {"x": 0.2}})
            keep_commanding_zero(link, [command])
            assert "0.0\n" in iter(robot.stdout.readline, ""), "it hears, as long as it is well"
            robot.send_signal(signal.SIGSTOP)  # as where its network is cut
            monkeypatch.setattr(commanded_topics, "_TELLING", 1.0)
            monkeypatch.setattr(commanded_topics, "_REACHING", 2.0)  # before it counts as gone
            try:
                with pytest.raises(LinkError, match="the robot's subscription is not reached"):
                    keep_commanding_zero(link, [command])
            finally:
                robot.send_signal(signal.SIGCONT)
    finally:
        robot.kill()
        robot.communicate()
