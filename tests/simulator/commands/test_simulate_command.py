"""`robot-runner simulate` says when the robot is there, ends when it is told to, and refuses what cannot be."""

from __future__ import annotations

import signal
import subprocess
import sys

import pytest
from tests.long_cases import soak_but
from tests.ros.dds_domain import LOOPBACK, claim_domain
from tests.ros.ros1_master import needs_ros1

from robot_runner.cli.guard import REFUSED
from robot_runner.cli.main import main


@pytest.mark.long
@pytest.mark.parametrize(
    "number", soak_but([signal.SIGINT], [signal.SIGINT, signal.SIGTERM]), ids=lambda number: number.name
)
def test_over_dds_it_is_ready_and_ends_cleanly(number, monkeypatch):
    monkeypatch.setenv("CYCLONEDDS_URI", LOOPBACK)
    words = ["simulate", "turtlebot3", "--link", f"dds:domain={claim_domain()}", "--namespace", "/alice"]
    process = subprocess.Popen(
        [sys.executable, "-m", "robot_runner", *words], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    try:
        first = [process.stdout.readline() for _ in range(3)]
        process.send_signal(number)
        rest, _ = process.communicate(timeout=60)
    finally:
        process.kill()
        process.communicate()
    assert "namespace /alice" in first[0]
    assert first[1].startswith("power meter: ")
    assert first[2] == "ready\n"
    assert rest.startswith("ended after ")
    assert process.returncode == 0


@pytest.mark.parametrize(
    ("words", "complaint", "fix"),
    [
        (["turtlebot4", "--link", "dds"], "there is no simulated 'turtlebot4'", "Did you mean 'turtlebot3'?"),
        (["rover.urdf", "--link", "dds"], "there is no simulated 'rover.urdf'", "saves it as MJCF"),
        (["turtlebot3"], "--link is missing", "robot-runner simulate --help"),
        (["turtlebot3", "--link", "gazebo"], "no robot can be put on 'gazebo'", "'ros1'"),
        (["turtlebot3", "--link", "dds", "--real-time-factor", "2"], "told the time", "--use-sim-time"),
        pytest.param(
            ["turtlebot3", "--link", "dds", "--namespace", "3x"],
            "'3x' cannot be the name of a namespace",
            "digit",
            id="a namespace over DDS",
        ),
        (["turtlebot3", "--link", "dds:domain=900"], "the domain id is '900'", "0 to 232"),
        pytest.param(
            ["turtlebot3", "--link", "ros1:master=http://127.0.0.1:9"],
            "there is no ROS master at",
            "roscore",
            marks=needs_ros1,
        ),
    ],
)
def test_what_cannot_be_is_refused_with_a_remedy(words, complaint, fix, capsys):
    assert main(["simulate", *words]) == REFUSED
    said = capsys.readouterr()
    assert complaint in said.err
    assert fix in said.err
    assert "ready" not in said.out
