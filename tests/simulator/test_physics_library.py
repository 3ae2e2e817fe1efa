"""The simulator is imported without the windows of MuJoCo, unless somebody could want one."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

PROGRAM = """
import os, sys
before = dict(os.environ)
import robot_runner.simulator.drive, robot_runner.simulator.physics, robot_runner.simulator.camera
assert dict(os.environ) == before
print("glfw" in sys.modules)
"""


@pytest.mark.long
@pytest.mark.parametrize(
    ("environment", "has_windows"), [({}, "False"), ({"DISPLAY": ":0"}, "True"), ({"MUJOCO_GL": "glfw"}, "True")]
)
def test_windows_are_loaded_only_where_there_is_a_screen_or_they_are_asked_for(environment, has_windows):
    others = {key: text for key, text in os.environ.items() if key not in {"DISPLAY", "WAYLAND_DISPLAY", "MUJOCO_GL"}}
    told = subprocess.run(
        [sys.executable, "-c", PROGRAM],
        env=others | environment,
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
    )
    assert told.stdout.strip() == has_windows
