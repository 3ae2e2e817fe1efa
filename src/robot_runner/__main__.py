"""`python -m robot_runner` is the command line, as `robot-runner` is."""

from __future__ import annotations

import os
import sys

try:
    from robot_runner.cli.main import main
except KeyboardInterrupt:  # Ctrl-C in a queue that has just begun an experiment
    sys.stderr.write("interrupted\n")
    sys.exit(130)

if __name__ == "__main__":
    # A shell that finds Python by a relative entry of PATH hands such a path on, which is nothing in another folder.
    sys.executable = os.path.abspath(sys.executable)  # noqa: PTH100 - a symbolic link of a virtual environment stays
    sys.exit(main())
