"""Measures how busy a computer is: this machine, the robot's on-board one, or a simulated one."""

from robot_runner.plugins.profilers.psutil.profiler import PsUtil

__all__ = ["PsUtil"]
