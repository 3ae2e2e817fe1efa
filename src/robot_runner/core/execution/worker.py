"""The program of a spawned run: `python -m robot_runner.core.execution.worker <description>`."""

from __future__ import annotations

import sys

from robot_runner.core.execution.starters import execute_spawned

if __name__ == "__main__":
    execute_spawned(sys.argv[1])
