"""The program of a spawned run: `python -m robot_runner.execution.worker <task>`."""

from __future__ import annotations

import sys

from robot_runner.execution.spawning import execute_described

if __name__ == "__main__":
    execute_described(sys.argv[1])
