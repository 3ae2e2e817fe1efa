"""A real ROS 1 master on loopback, on a free port."""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import time
from contextlib import contextmanager
from typing import TYPE_CHECKING

import pytest
from tests.loopback_port import claim_port

from robot_runner.core.errors import LinkError
from robot_runner.ros.ros1_master import Master

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

__all__ = ["needs_ros1", "quiet_about_rospy", "ros1_environment", "ros1_master"]

MASTER = shutil.which("rosmaster")
needs_ros1 = pytest.mark.skipif(
    MASTER is None or importlib.util.find_spec("rospy") is None,
    reason="no ROS 1 for this Python (on Debian: apt install python3-rospy python3-rosmaster, for Debian's own Python)",
)

#: rospy leaves sockets to the garbage collector and calls what Python has since renamed.
RUDE = ("ignore::ResourceWarning", "ignore::DeprecationWarning", "ignore::pytest.PytestUnraisableExceptionWarning")


def quiet_about_rospy(test):
    """Mark a test or a class of tests in whose process rospy runs."""
    for rule in RUDE:
        test = pytest.mark.filterwarnings(rule)(test)
    return needs_ros1(test)


def ros1_environment(uri: str, folder: Path) -> dict[str, str]:
    """Return what a node of this master needs in its environment, so that it stays on loopback and in the folder."""
    return {
        "ROS_MASTER_URI": uri,
        "ROS_IP": "127.0.0.1",
        "ROS_HOME": str(folder / "ros_home"),
        "ROS_LOG_DIR": str(folder / "ros_log"),
    }


@contextmanager
def ros1_master(folder: Path) -> Iterator[str]:
    """Start a master, and end it by its process id; yields its URI."""
    port = claim_port()
    uri = f"http://127.0.0.1:{port}"
    with (folder / "rosmaster.txt").open("wb") as output:
        # Debian's own Python: the one of the tests may be another.
        process = subprocess.Popen(
            ["/usr/bin/python3", MASTER, "--core", "-p", str(port), "-w", "3"],
            env=os.environ | ros1_environment(uri, folder),
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
        )
        try:
            _await(uri)
            yield uri
        finally:
            process.terminate()
            try:
                process.wait(5)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def _await(uri: str) -> None:
    deadline = time.monotonic() + 60
    while True:
        try:
            return Master(uri, timeout=1.0).check()
        except LinkError:
            if time.monotonic() > deadline:
                raise
            time.sleep(0.05)
