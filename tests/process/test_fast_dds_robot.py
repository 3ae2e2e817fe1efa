"""The experiment of the paper on a robot that runs Fast DDS, as ROS 2 Humble comes, and who else is on its graph."""

from __future__ import annotations

import json
import math
import struct
import threading
import time
from contextlib import closing
from typing import TYPE_CHECKING, Any

import pytest
from tests.process.conftest import kill_together, wait_until
from tests.process.test_real_graphs import LAUNCHED, failures_of, written
from tests.processor_wait import ProcessorWait, family
from tests.ros.dds_domain import LOOPBACK, claim_domain
from tests.ros.fastdds_robot import TWIST_TYPE, FastNode, FastRobot, needs_fastdds, relay_program

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

pytestmark = needs_fastdds

PATIENCE = 60.0
PROFILERS = '[RosTopics(["odom"]), RosBag(["odom", "cmd_vel"]), RosGraph()]'
TRIGGER = "std_srvs/srv/Trigger"
SUCCESS = b"\0\1\0\0" + struct.pack("<B3xI", 1, 1) + b"\0"


class TaskRobot(FastRobot):
    """Drives, and offers the services of the tasks; says which were asked for."""

    def __init__(self, program: Path, domain: int) -> None:
        super().__init__(program, domain)
        self.asked: list[str] = []
        tasks = [f"/task/{task}/{verb}" for task in ("video", "network") for verb in ("start", "stop")]
        for service in (*tasks, "/task/stop"):
            self.offer(service, TRIGGER, lambda _, name=service: self.asked.append(name) or SUCCESS)

    def drives(self, since: float) -> bool:
        return any(moment > since and forwards >= 0.19 for moment, forwards, _ in list(self.commands))

    def stood(self, since: float) -> float | None:
        """Return when it was told to stand still for the first time."""
        return next((moment for moment, *speeds in list(self.commands) if moment > since and not any(speeds)), None)


@pytest.fixture
def domain(monkeypatch: pytest.MonkeyPatch) -> int:
    monkeypatch.setenv("CYCLONEDDS_URI", LOOPBACK)
    monkeypatch.delenv("ROS_DISTRO", raising=False)
    return claim_domain()


@pytest.fixture
def robot(domain: int, tmp_path_factory: pytest.TempPathFactory) -> Iterator[TaskRobot]:
    with closing(TaskRobot(relay_program(tmp_path_factory), domain)) as made:
        yield made


@pytest.mark.soak
def test_the_mission_of_the_paper_is_driven_and_measured_over_fast_dds(
    robot: TaskRobot, domain: int, start: Callable[..., Any], tmp_path: Path
) -> None:
    config = written(tmp_path, ["Video", "Network"], PROFILERS, robot=f"dds:domain={domain}", namespace="", drive_s=0.8)
    text = config.read_text().replace('"CPU", "Memory", "Energy", ', "")
    config.write_text(text)
    begun, wait = time.monotonic(), ProcessorWait(family())
    experiment = start(config=config)
    experiment.output, _ = experiment.process.communicate(timeout=PATIENCE)
    assert experiment.process.returncode == 0, experiment.output
    wait.look()
    starved = min(1.0, wait.seconds / (time.monotonic() - begun))
    assert [row["status"] for row in experiment.table] == ["Done", "Done"]
    for row in experiment.table:
        assert 25 * (1.0 - starved) < float(row["OdomRate"]) < 35
        assert int(row["BagMessages"]) > 100 * (1.0 - starved)
        assert int(row["Nodes"]) == 2 or starved > 0.1  # then the robot's node may tell its name after the look
        assert float(row["Distance"]) > 0.05
    assert robot.asked.count("/task/video/start") == robot.asked.count("/task/video/stop") > 0
    assert robot.asked.count("/task/network/start") == robot.asked.count("/task/network/stop") > 0
    assert math.hypot(*robot.command) == 0.0


#: The run says when its own link can name who else may command the robot: Fast DDS announces that in its own time. It
#: looks from before the mission on, since a config's `launch_mission` comes after that of its plugins.
NOTES_THE_TELEOP = """
        import threading
        from robot_runner.plugins import connect_robot
        threading.Thread(target=self.note_the_teleop, args=(connect_robot(context),), daemon=True).start()

    def note_the_teleop(self, link):
        import time
        while "/teleop" not in {each.node for each in link.publishers("/cmd_vel")}:
            time.sleep(0.05)
        (Path(__file__).parent / "named").touch()
"""


@pytest.mark.long
def test_a_robot_on_fast_dds_stands_still_after_a_kill_and_a_rival_of_its_commands_is_named(
    robot: TaskRobot, domain: int, start: Callable[..., Any], tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    config = written(tmp_path, ["Video"], robot=f"dds:domain={domain}", namespace="", drive_s=60.0)
    text = config.read_text().replace('"CPU", "Memory", "Energy", "Distance", "OdomRate", "BagMessages", "Nodes"', "")
    text = text.replace("RobotRunnerEvents.LAUNCH_MISSION", "RobotRunnerEvents.START_MEASUREMENT")
    config.write_text(text.replace(LAUNCHED, NOTES_THE_TELEOP))
    experiment = start(config=config)
    wait_until(lambda: robot.drives(0.0), "the robot drives")
    wait, doomed, killed = ProcessorWait(family()), [experiment.run_process(), experiment.process.pid], time.time()
    kill_together(doomed)
    wait_until(lambda: wait.look() or robot.stood(killed), "it is told to stand still")
    assert robot.stood(killed) - killed - wait.seconds < 1.0
    experiment.end()
    assert experiment.nobody_is_left()

    since, experiment = time.time(), start(config=config)
    wait_until(lambda: robot.drives(since), "the robot drives again")
    with closing(FastNode(relay_program(tmp_path_factory), domain, "teleop")) as teleop:
        stick, is_over = teleop.publisher("/cmd_vel", TWIST_TYPE), threading.Event()

        def pull() -> None:
            while not is_over.wait(0.05):
                teleop.write(stick, b"\0\1\0\0" + struct.pack("<6d", -0.1, 0, 0, 0, 0, 0))

        experiment.wait_for("named")
        pulling = threading.Thread(target=pull)
        pulling.start()
        try:
            wait_until(lambda: failures_of(experiment), "the run has failed")
        finally:
            is_over.set()
            pulling.join()
    assert experiment.end() == 1
    (problem,) = failures_of(experiment).values()
    assert "/teleop commands the robot on '/cmd_vel': -0.1 m/s" in problem, json.dumps(problem)
