"""Parameters of a real node are put back, whoever of an experiment is killed: over DDS, and at a ROS 1 master."""

from __future__ import annotations

import json
import os
import shutil
import signal
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

import pytest
from tests.conftest import HEAD
from tests.process.conftest import kill_together, wait_until
from tests.ros.dds_domain import LOOPBACK, claim_domain
from tests.ros.ros1_master import needs_ros1

from robot_runner.core.events.context import SystemClock
from robot_runner.ros.link_opening import open_dds_link
from robot_runner.ros.ros1_master import Master
from robot_runner.testing import ParameterNode

if TYPE_CHECKING:
    from pathlib import Path

Start = Callable[..., Any]

IMPORTS = """
from robot_runner.plugins import treatment
from robot_runner.plugins.systems import RosParameters
"""
BODY = """
    robot = {robot!r}
    plugins = [RosParameters({{"/planner": {{"speed": treatment("Speed")}}}})]
    time_between_runs_in_ms = 0
    def start_run(self, context):
        pass  # it might start the robot, so that a master without any node is no error
    def launch_mission(self, context):
        import time
        (Path(__file__).parent / "launched").touch()
        time.sleep({seconds})
    def create_run_table(self):
        return RunTableModel([Factor("Speed", {speeds})])
"""


@pytest.fixture(autouse=True)
def _state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))


@pytest.fixture(params=["dds", pytest.param("ros1", marks=[needs_ros1, pytest.mark.soak])])
def planner(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[str, Callable[[], Any]]]:
    """The robot's name, and what tells the speed of its planner, which is 0.2 at first."""
    if request.param == "ros1":
        master = Master(request.getfixturevalue("master_uri"))
        master.set_parameter("/planner/speed", value=0.2)
        yield "ros1", lambda: master.parameter("/planner/speed")
        master.delete_parameter("/planner/speed")
        return
    monkeypatch.setenv("CYCLONEDDS_URI", LOOPBACK)
    domain = claim_domain()
    link = open_dds_link({"domain": str(domain)}, SystemClock())
    node = ParameterNode(link, "/planner", {"speed": 0.2})
    yield f"dds:domain={domain}", lambda: node.values["speed"]
    link.close()


@pytest.fixture
def experiment(start: Start, write_config: Callable[..., Path], tmp_path: Path) -> Callable[..., Any]:
    def begin(robot: str, *, seconds: float = 60, speeds: tuple[float, ...] = (0.5,)) -> Any:
        shutil.rmtree(tmp_path / "results", ignore_errors=True)  # a new experiment, each time
        head = HEAD.replace("import *\n", f"import *\n{IMPORTS}", 1)
        body = BODY.format(robot=robot, seconds=seconds, speeds=list(speeds))
        return start(config=write_config(body, head=head, table=""))

    return begin


@pytest.mark.long
def test_each_run_has_its_treatment_and_whoever_is_killed_the_parameter_is_put_back(
    planner: Any, experiment: Callable[..., Any], tmp_path: Path
) -> None:
    robot, speed = planner
    killed = experiment(robot)
    killed.wait_for("launched")
    assert speed() == 0.5
    os.kill(killed.run_process(), signal.SIGKILL)
    assert killed.end() == 1
    assert speed() == 0.2, "the process that stands by has put it back"

    (tmp_path / "launched").unlink()
    gone = experiment(robot)
    gone.wait_for("launched")
    kill_together([gone.standby(), gone.keeper(), gone.process.pid, gone.run_process()])
    gone.end()
    wait_until(gone.nobody_is_left, "all of it is dead")
    assert speed() == 0.5, "nobody was left who could put it back"

    following = experiment(robot, seconds=0, speeds=(0.5, 1.5))
    assert following.end() == 0, following.output
    assert "which did not put them back; that was done before this run" in " ".join(following.output.split())
    assert speed() == 0.2
    for row in following.table:
        facts = json.loads(
            (following.folder / "runs" / row["run_id"] / "RosParameters" / "parameters.json").read_text()
        )
        wanted = float(row["Speed"])
        expected = {"before": 0.2, "set": wanted, "during": wanted, "after": wanted, "restored": 0.2}
        assert facts == {"/planner": {"speed": expected}}
