"""What is told of a robot that software for all runs drives on, as nobody was left to halt it."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from robot_runner.core.errors import PluginError
from robot_runner.core.execution.left_systems import may_be_moving
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.subjects import left_subjects
from robot_runner.subjects.halting import CommandedTopics
from robot_runner.subjects.left_subjects import check_within_reach
from robot_runner.subjects.supervised_program import Start
from robot_runner.subjects.surroundings import Surroundings

TWIST = "geometry_msgs/Twist"


@pytest.fixture
def start(tmp_path: Path) -> Start:
    """Return a start of software that has commanded a robot."""
    start = Start(tmp_path / "trial" / "subjects" / "Planner" / "1")
    start.folder.mkdir(parents=True)
    CommandedTopics(start).add("ros2:domain=7", "/cmd_vel", TWIST)
    return start


def told(root: Path) -> list[str]:
    return [each.problem for each in may_be_moving(ExperimentFolder(root))]


def test_a_robot_that_software_for_all_runs_drives_on_is_told_of_until_it_was_halted(
    start: Start, tmp_path: Path
) -> None:
    (problem,) = told(tmp_path / "trial")
    assert problem.startswith("THE ROBOT MAY BE MOVING: an earlier execution was killed while Planner commanded")
    assert "(ros2:domain=7)" in problem
    CommandedTopics(start).end("")
    assert told(tmp_path / "trial") == []


@pytest.mark.skipif(sys.platform != "linux", reason="other systems do not tell who holds a lock")
def test_of_a_robot_that_is_about_to_be_halted_nothing_is_told(start: Start, tmp_path: Path) -> None:
    with CommandedTopics(start).locked() as inherited:
        halting = subprocess.Popen(["/bin/sleep", "60"], pass_fds=inherited)
    with halting:
        assert told(tmp_path / "trial") == []
        halting.kill()
    assert len(told(tmp_path / "trial")) == 1


def test_software_that_has_commanded_no_robot_has_left_none_moving(tmp_path: Path) -> None:
    (tmp_path / "trial" / "subjects" / "Planner" / "1").mkdir(parents=True)
    (tmp_path / "trial" / "subjects" / "Detector").mkdir()
    assert told(tmp_path / "trial") == []


def test_a_copy_that_was_made_meanwhile_tells_of_nothing(start: Start, tmp_path: Path) -> None:
    del start
    shutil.copytree(tmp_path / "trial", tmp_path / "backup")
    assert told(tmp_path / "backup") == []
    assert len(told(tmp_path / "trial")) == 1


@pytest.mark.skipif(
    os.geteuid() == 0 and shutil.which("setpriv") is None, reason="root needs setpriv to become another user"
)
def test_software_that_became_another_user_over_there_is_not_taken_for_dead(
    start: Start, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As `sudo` does: its supervisor cannot end it, nor may its user send it any signal."""
    as_another_user = ["setpriv", "--reuid=65534", "--clear-groups"] if os.geteuid() == 0 else []
    there = lambda _host, command, **_: [*as_another_user, "/bin/sh", "-c", command]  # noqa: E731
    monkeypatch.setattr(left_subjects, "ssh_command", there)
    around = Surroundings.of("Planner", folder=None, environment={}, setup=None, host="robot", ssh_config=None)
    events = [{"started": 1, "at": 0.0, "steady": 0.0}, {"lost": "the network was cut"}]
    start.events.write_text("".join(json.dumps(each) + "\n" for each in events))
    with pytest.raises(PluginError, match="it goes on on robot, out of reach"):
        check_within_reach("Planner", start, around)


def test_software_of_whose_start_nothing_was_heard_before_its_run_was_killed_may_drive_on(start: Start) -> None:
    # Its computer had fallen silent in the moment of the start: only its commands were seen on the graph.
    around = Surroundings.of("Planner", folder=None, environment={}, setup=None, host="robot", ssh_config=None)
    with pytest.raises(PluginError, match="whether it was started on robot is not known"):
        check_within_reach("Planner", start, around)
    start.events.write_text(json.dumps({"refused": "no such program"}) + "\n")
    check_within_reach("Planner", start, around)
