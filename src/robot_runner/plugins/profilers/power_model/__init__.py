"""Estimates the power of a robot from what it does: its utilisation, its motion and its task."""

from robot_runner.plugins.profilers.power_model.profiler import PowerModel

__all__ = ["PowerModel"]
