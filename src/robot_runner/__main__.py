"""`python -m robot_runner` is the command line, as `robot-runner` is."""

from __future__ import annotations

import sys

from robot_runner.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
