"""How a node of this package lives: from the start of ROS until it is told to end."""

from __future__ import annotations

from typing import TYPE_CHECKING

import rclpy
from rclpy.executors import ExternalShutdownException

if TYPE_CHECKING:
    from typing import Callable

    from rclpy.node import Node

__all__ = ["run"]


def run(make: Callable[[], Node]) -> None:
    """Make a node and let it work until it is told to end; then close it."""
    rclpy.init()
    node = make()
    try:
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
