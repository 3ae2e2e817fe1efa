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
    from robot_runner.core.links.host import UtilisationSample
    from robot_runner.core.links.serial_line import Chunk
    from robot_runner.testing.fake_devices import FakeHostLink, FakeSerialLine
    from robot_runner.testing.fake_robot import FakeRobotLink, Publication, ServiceCall
    from robot_runner.testing.fake_run import (
        FakeClock,
        FakeLinks,
        RecordingBroker,
        Rehearsal,
        context_for,
        make_context,
        rehearse,
    )
    from robot_runner.testing.fake_turtlebot3 import FakeTurtlebot3Link
    from robot_runner.testing.graph_link_contract import GraphLinkContract
    from robot_runner.testing.link_contract import RobotLinkContract
    from robot_runner.testing.plugin_contract import ProfilerContract
    from robot_runner.testing.rosbridge_server import RosbridgeServer
    from robot_runner.testing.system_contract import SystemContract

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
    "Chunk": "robot_runner.core.links.serial_line",
    "FakeClock": "robot_runner.testing.fake_run",
    "FakeHostLink": "robot_runner.testing.fake_devices",
    "FakeLinks": "robot_runner.testing.fake_run",
    "FakeRobotLink": "robot_runner.testing.fake_robot",
    "FakeSerialLine": "robot_runner.testing.fake_devices",
    "FakeTurtlebot3Link": "robot_runner.testing.fake_turtlebot3",
    "GraphLinkContract": "robot_runner.testing.graph_link_contract",
    "ProfilerContract": "robot_runner.testing.plugin_contract",
    "Publication": "robot_runner.testing.fake_robot",
    "RecordingBroker": "robot_runner.testing.fake_run",
    "Rehearsal": "robot_runner.testing.fake_run",
    "RobotLinkContract": "robot_runner.testing.link_contract",
    "RosbridgeServer": "robot_runner.testing.rosbridge_server",
    "ServiceCall": "robot_runner.testing.fake_robot",
    "SystemContract": "robot_runner.testing.system_contract",
    "UtilisationSample": "robot_runner.core.links.host",
    "context_for": "robot_runner.testing.fake_run",
    "make_context": "robot_runner.testing.fake_run",
    "rehearse": "robot_runner.testing.fake_run",
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
