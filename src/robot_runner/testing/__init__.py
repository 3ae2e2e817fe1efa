"""The door for who tests a plugin or a config: fakes, a rehearsal of a run, and contracts to inherit.

Fakes are real implementations of the links' protocols on a clock that the test moves. A contract is a class of
tests that holds what every plugin must keep to.

Example:
    >>> from robot_runner.testing import FakeClock
    >>> clock = FakeClock()
    >>> clock.sleep(2.5)
    >>> clock.now()
    2.5
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from robot_runner.links.host import UtilisationSample
    from robot_runner.links.serial import Chunk
    from robot_runner.testing.clock import FakeClock
    from robot_runner.testing.context import FakeLinks, RecordingBroker, context_for, make_context
    from robot_runner.testing.graph_link_contract import GraphLinkContract
    from robot_runner.testing.host import FakeHostLink
    from robot_runner.testing.link_contract import RobotLinkContract
    from robot_runner.testing.profiler_contract import ProfilerContract
    from robot_runner.testing.rehearsal import Rehearsal, rehearse
    from robot_runner.testing.robot import FakeRobotLink, Publication, ServiceCall
    from robot_runner.testing.rosbridge_server import RosbridgeServer
    from robot_runner.testing.serial import FakeSerialLine
    from robot_runner.testing.system_contract import SystemContract
    from robot_runner.testing.turtlebot3 import FakeTurtlebot3Link

__all__ = [
    "Chunk",
    "FakeClock",
    "FakeHostLink",
    "FakeLinks",
    "FakeRobotLink",
    "FakeSerialLine",
    "FakeTurtlebot3Link",
    "GraphLinkContract",
    "ProfilerContract",
    "Publication",
    "RecordingBroker",
    "Rehearsal",
    "RobotLinkContract",
    "RosbridgeServer",
    "ServiceCall",
    "SystemContract",
    "UtilisationSample",
    "context_for",
    "make_context",
    "rehearse",
]

_HOMES = {
    "Chunk": "robot_runner.links.serial",
    "FakeClock": "robot_runner.testing.clock",
    "FakeHostLink": "robot_runner.testing.host",
    "FakeLinks": "robot_runner.testing.context",
    "FakeRobotLink": "robot_runner.testing.robot",
    "FakeSerialLine": "robot_runner.testing.serial",
    "FakeTurtlebot3Link": "robot_runner.testing.turtlebot3",
    "GraphLinkContract": "robot_runner.testing.graph_link_contract",
    "ProfilerContract": "robot_runner.testing.profiler_contract",
    "Publication": "robot_runner.testing.robot",
    "RecordingBroker": "robot_runner.testing.context",
    "Rehearsal": "robot_runner.testing.rehearsal",
    "RobotLinkContract": "robot_runner.testing.link_contract",
    "RosbridgeServer": "robot_runner.testing.rosbridge_server",
    "ServiceCall": "robot_runner.testing.robot",
    "SystemContract": "robot_runner.testing.system_contract",
    "UtilisationSample": "robot_runner.links.host",
    "context_for": "robot_runner.testing.context",
    "make_context": "robot_runner.testing.context",
    "rehearse": "robot_runner.testing.rehearsal",
}


def __getattr__(name: str) -> object:
    """Import a name when it is first asked for."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    found = getattr(import_module(_HOMES[name]), name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return __all__
