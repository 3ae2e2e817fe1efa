"""The packages are built and launched as a user builds and launches them; their metadata agree."""

from __future__ import annotations

import re
import shutil
import subprocess
import time
import tomllib
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest
from tests.ros.ros1_master import RUDE, needs_ros1, ros1_environment

from robot_runner.core.events.context import SystemClock
from robot_runner.ros.link_opening import open_ros1_link

pytestmark = [*map(pytest.mark.filterwarnings, RUDE)]

ROOT = Path(__file__).parents[3]
ROBOT = ROOT / "robot"
PACKAGES = ("robot_runner_onboard", "robot_runner_ros1", "robot_runner_ros2")
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
#: ROS' tools take three numbers only: before a release, the packages have the version that it will have.
VERSION = PROJECT["version"].partition(".dev")[0]
IGNORED = shutil.ignore_patterns("__pycache__")


@pytest.mark.parametrize("package", PACKAGES)
def test_each_package_has_the_version_and_the_licence_of_the_whole(package):
    described = ET.parse(ROBOT / package / "package.xml").getroot()  # noqa: S314 - our own file
    assert described.findtext("name") == package
    assert described.findtext("version") == VERSION
    assert described.findtext("license") == "Apache-2.0"
    written = re.findall(r'version="([^"]+)"', (ROBOT / package / "setup.py").read_text(encoding="utf-8"))
    assert set(written) <= {VERSION}


@pytest.mark.parametrize("package", PACKAGES)
def test_each_package_names_what_its_modules_import_of_ros(package):
    described = ET.parse(ROBOT / package / "package.xml").getroot()  # noqa: S314 - our own file
    named = {each.text for each in described if each.tag.endswith("depend")}
    text = "\n".join(path.read_text(encoding="utf-8") for path in (ROBOT / package).rglob("*.py"))
    imported = set(re.findall(r"^\s*(?:from|import) (\w+(?:_msgs|_srvs)|rospy|rclpy|launch\w*)\b", text, re.MULTILINE))
    assert imported <= named


@pytest.mark.long
@needs_ros1
@pytest.mark.skipif(
    not (shutil.which("catkin_make") and shutil.which("roslaunch")),
    reason="no catkin and no roslaunch on this machine (on Debian: apt install catkin python3-roslaunch)",
)
def test_they_are_built_by_catkin_and_launched(tmp_path, master_uri):
    (tmp_path / "src").mkdir()
    for package in PACKAGES[:2]:
        shutil.copytree(ROBOT / package, tmp_path / "src" / package, ignore=IGNORED)
    environment = {**ros1_environment(master_uri, tmp_path), "PATH": "/usr/bin:/bin", "HOME": str(tmp_path)}
    build = ["catkin_make", "-DPYTHON_EXECUTABLE=/usr/bin/python3", "-DCATKIN_ENABLE_TESTING=OFF"]
    done = subprocess.run(
        build, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=250, check=False
    )
    assert done.returncode == 0, done.stderr
    listing = ". devel/setup.sh && exec roslaunch --nodes robot_runner_ros1 robot.launch"
    listed = subprocess.run(
        ["/bin/sh", "-c", listing], cwd=tmp_path, env=environment, capture_output=True, check=True, timeout=100
    )
    assert set(listed.stdout.split()) == {b"/robot_runner_tasks", b"/robot_runner_watchdog"}
    launch = ". devel/setup.sh && exec roslaunch robot_runner_ros1 robot.launch namespace:=/launched"
    process = subprocess.Popen(
        ["/bin/sh", "-c", launch], cwd=tmp_path, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT
    )
    link = open_ros1_link({"master": master_uri}, SystemClock(), "/launched")
    try:
        deadline = time.monotonic() + 100
        while "/launched/task/stop" not in link.services() or "/launched/robot_runner_watchdog" not in link.nodes():
            assert time.monotonic() < deadline
            time.sleep(0.1)
    finally:
        link.close()
        process.terminate()
        output, _ = process.communicate(timeout=100)
    assert b"the tasks are offered under /launched/task" in output
