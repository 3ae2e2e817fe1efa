"""The public API for tests of plugins and configs: fakes, a rehearsal of a run, and contracts to inherit.

Fakes are real implementations of the links' protocols, on a clock that the test moves. A contract is a class of tests
of the rules that every plugin must keep to.

Example:
    >>> from robot_runner.testing import FakeClock
    >>> clock = FakeClock()
    >>> clock.sleep(2.5)
    >>> clock.now()
    2.5
"""

from __future__ import annotations

from robot_runner.core.doors import open_door

TYPE_CHECKING = False
if TYPE_CHECKING:
    from robot_runner.core.events.context import SystemClock as SystemClock
    from robot_runner.measuring.host import UtilisationSample as UtilisationSample
    from robot_runner.measuring.serial_line import Chunk as Chunk
    from robot_runner.testing.condition_contract import ConditionContract as ConditionContract
    from robot_runner.testing.fake_actions import FakeAction as FakeAction
    from robot_runner.testing.fake_devices import FakeHostLink as FakeHostLink
    from robot_runner.testing.fake_devices import FakeSerialLine as FakeSerialLine
    from robot_runner.testing.fake_devices import FakeTurtlebot3Link as FakeTurtlebot3Link
    from robot_runner.testing.fake_robot import FakeRobotLink as FakeRobotLink
    from robot_runner.testing.fake_robot import Publication as Publication
    from robot_runner.testing.fake_robot import ServiceCall as ServiceCall
    from robot_runner.testing.fake_run import FakeClock as FakeClock
    from robot_runner.testing.fake_run import FakeLinks as FakeLinks
    from robot_runner.testing.fake_run import RecordingBroker as RecordingBroker
    from robot_runner.testing.fake_run import Rehearsal as Rehearsal
    from robot_runner.testing.fake_run import context_for as context_for
    from robot_runner.testing.fake_run import make_context as make_context
    from robot_runner.testing.fake_run import rehearse as rehearse
    from robot_runner.testing.graph_link_contract import GraphLinkContract as GraphLinkContract
    from robot_runner.testing.link_contract import RobotLinkContract as RobotLinkContract
    from robot_runner.testing.parameter_node import LifecycleNode as LifecycleNode
    from robot_runner.testing.parameter_node import ParameterNode as ParameterNode
    from robot_runner.testing.plugin_contract import ProfilerContract as ProfilerContract
    from robot_runner.testing.rosbridge_server import RosbridgeServer as RosbridgeServer
    from robot_runner.testing.system_contract import SystemContract as SystemContract
else:
    __getattr__, __dir__ = open_door(__name__)
