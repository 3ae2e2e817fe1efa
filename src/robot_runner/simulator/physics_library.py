"""MuJoCo, imported without what draws into windows where there is no screen (Linux).

That is GLFW, which starts an interpreter of its own to look for its library: two fifths of the processor time of the
import. A camera loads what it renders with when it is opened (`camera.py`).
"""

from __future__ import annotations

import os
import sys

__all__ = ["mujoco"]

_VARIABLE = "MUJOCO_GL"

if sys.platform != "linux" or {_VARIABLE, "DISPLAY", "WAYLAND_DISPLAY"} & os.environ.keys():
    import mujoco
else:
    os.environ[_VARIABLE] = "disabled"
    try:
        import mujoco
    finally:
        del os.environ[_VARIABLE]
