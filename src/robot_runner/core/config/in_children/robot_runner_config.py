"""The config, for processes that `multiprocessing` starts anew: they import what its functions and classes come from.

In the process that has loaded the config, the config itself is in this place.
"""

import json
import os
from pathlib import Path

from robot_runner.core.config.dialects import LOADED_VARIABLE, load_config

_loaded = json.loads(os.environ[LOADED_VARIABLE])
load_config(Path(_loaded["file"]), _loaded["set"])  # which puts the config in the place of this module
