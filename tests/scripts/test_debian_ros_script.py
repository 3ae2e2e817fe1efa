"""Debian's ROS 1 is seen by the tests' environment, after what that has of its own."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from tests.ros.ros1_master import needs_ros1

ROOT = Path(__file__).parents[2]


@pytest.fixture
def clone(tmp_path):
    (tmp_path / "scripts").mkdir()
    shutil.copy(ROOT / "scripts" / "debian_ros.sh", tmp_path / "scripts")
    return tmp_path


def execute(clone):
    subprocess.run(["sh", "scripts/debian_ros.sh"], cwd=clone, check=True, timeout=60)


def test_without_an_environment_it_does_nothing(clone):
    execute(clone)
    assert sorted(path.name for path in clone.iterdir()) == ["scripts"]


@pytest.mark.long
@needs_ros1
def test_the_system_s_packages_come_last(clone):
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", clone / ".venv"], check=True, timeout=60)
    execute(clone)
    execute(clone)
    program = "import sys, rospy; print(sys.path[-1], rospy.__file__)"
    python = clone / ".venv" / "bin" / "python"
    said = subprocess.run([python, "-I", "-c", program], capture_output=True, text=True, check=True, timeout=60)
    path, module = said.stdout.split()
    assert path == "/usr/lib/python3/dist-packages"
    assert module.startswith(path)
