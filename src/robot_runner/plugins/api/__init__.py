"""What a plugin must be: a system that operates a robot, or a profiler that measures."""

from robot_runner.plugins.api.plugin import Circumstances, Plugin, Profiler, System

__all__ = ["Circumstances", "Plugin", "Profiler", "System"]
