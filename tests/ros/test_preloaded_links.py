"""What reaches a robot is imported before runs are forked, unless that starts threads, which do not survive a fork."""

from __future__ import annotations

import subprocess
import sys

import pytest
from tests.ros.ros1_master import needs_ros1

from robot_runner.core.links.connect import preload_before_forks
from robot_runner.ros.graph_links import GRAPH_LINKS, GraphLinkKind

THREADS = """
import os, sys
from robot_runner.core.links.connect import preload_before_forks
preload_before_forks(sys.argv[1])
print(len(os.listdir("/proc/self/task")), sys.argv[2] in sys.modules)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux shows the threads of C libraries")
@pytest.mark.parametrize(
    ("robot", "library", "is_imported"),
    [
        pytest.param("ros1", "rospy", True, marks=needs_ros1),
        pytest.param("dds:domain=7", "cyclonedds", True, id="dds"),
        ("rosbridge://robot:9090", "robot_runner.ros.rosbridge_transport", True),
        pytest.param("ros2", "rclpy", False, marks=pytest.mark.ros2),
        ("auto", "rospy", False),
        ("no_such_link", "rospy", False),
    ],
)
def test_the_library_of_a_link_is_imported_before_forks_and_starts_no_thread(
    monkeypatch: pytest.MonkeyPatch, robot: str, library: str, is_imported: bool
) -> None:
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "1")  # its threads can be forked
    command = [sys.executable, "-c", THREADS, robot, library]
    told = subprocess.run(command, check=True, capture_output=True, text=True, timeout=100).stdout
    assert told.split() == ["1", str(is_imported)]


def test_a_library_that_cannot_be_imported_is_left_to_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    called = []

    def fail(kind: GraphLinkKind, name: object) -> None:
        called.append(name)
        raise ImportError(kind.description)

    monkeypatch.setattr(GraphLinkKind, "preload", fail)
    preload_before_forks("dds:domain=7")
    assert len(called) == 1
    assert not GRAPH_LINKS["ros2"].can_be_forked
