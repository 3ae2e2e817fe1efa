"""The paper's Turtlebot Basic: a circular mission for benchmarking measurement-based experiments."""

from robot_runner.plugins.systems.basic_turtlebot3.plugin import BasicTurtlebot3

__all__ = ["BasicTurtlebot3"]
