"""The rules for every robot link, as tests for its author to inherit."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from itertools import count
from types import FrameType
from typing import ClassVar

from robot_runner.core.errors import LinkError
from robot_runner.core.events.early_end import RunInterrupted
from robot_runner.core.links.robot import Encoding, Message, RawMessage, RobotLink, Subscription
from robot_runner.testing.action_contract import PATIENCE, ActionContract, faults_told, punctual_refusal, refusal
from robot_runner.testing.plugin_contract import require

_TWIST = "geometry_msgs/Twist"
_ODOMETRY = "nav_msgs/Odometry"
_TRIGGER = "std_srvs/Trigger"


class FaultyCallback:
    """A callback that counts messages, and raises at each."""

    def __init__(self) -> None:
        self.calls = 0

    def __call__(self, message: Message) -> None:
        """Count the message, and raise a `ValueError`."""
        del message
        self.calls += 1
        raise ValueError("a fault of the callback")


def interruptions(act: Callable[[], object]) -> Iterator[float]:
    """Interrupt `act` where Python looks for signals, as a stop request does: once at each, by their order.

    Yields:
        the number of the interruption, after each; at last that of the whole `act`.
    """
    for moment in count(1):
        is_over = not _is_interrupted(act, moment)
        yield float(moment)
        if is_over:
            return


def _is_interrupted(act: Callable[[], object], moment: int) -> bool:
    looks = count(1)
    dropped: list[BaseException] = []

    def look(_frame: FrameType, event: str, _arg: object) -> None:
        # As a function begins, and once one of C has returned.
        if event in {"call", "c_return"} and next(looks) == moment:
            raise RunInterrupted

    def note(lost: sys.UnraisableHookArgs) -> None:
        # Python drops what is raised in a `__del__`; a run raises its request once more.
        if isinstance(lost.exc_value, RunInterrupted):
            dropped.append(lost.exc_value)
        else:
            earlier_hook(lost)

    earlier, earlier_hook = sys.getprofile(), sys.unraisablehook
    sys.unraisablehook = note
    sys.setprofile(look)
    try:
        act()
    except RunInterrupted:
        return True
    finally:
        sys.setprofile(earlier)
        sys.unraisablehook = earlier_hook
    return bool(dropped)


class RobotLinkContract(ActionContract):
    """The rules for a link to any robot; pytest finds the tests in a subclass whose name begins with `Test`.

    A link to a graph with publishers of any kind also keeps to `GraphLinkContract`.

    Attributes:
        topic: a topic that some robot publishes, of type nav_msgs/Odometry.
        publishes: whether such a robot is behind the link, so that the test need not publish.

    Example:
        >>> from robot_runner.simulator.simulated_link import SimulatedRobotLink
        >>> from robot_runner.simulator.simulated_turtlebot3 import Simulation
        >>> from robot_runner.testing import RobotLinkContract
        >>> class TestSimulatedRobotLink(RobotLinkContract):
        ...     def setup_method(self):
        ...         self.simulation = Simulation(seed=1)
        ...     def make_link(self, namespace=""):
        ...         return SimulatedRobotLink(self.simulation, namespace=namespace)
        ...     def pass_time(self, seconds):
        ...         self.simulation.clock.sleep(seconds)
    """

    topic: ClassVar[str] = "odom"
    publishes: ClassVar[bool] = True

    def make_link(self, namespace: str = "") -> RobotLink:
        """Return a new link to the robot of this namespace, always on the same graph; for the author to write."""
        raise NotImplementedError("write make_link(self, namespace), which returns the link to test")

    def pass_time(self, seconds: float) -> None:
        """Let time pass, so that messages can arrive; to be overridden where the robot has a clock of its own."""
        time.sleep(seconds)

    @contextmanager
    def opened(self, namespace: str = "") -> Iterator[RobotLink]:
        """Open a link, which is closed in any case."""
        with ExitStack() as closing:
            link = self.make_link(namespace)
            closing.callback(link.close)
            yield link

    def until(self, claim: Callable[[], object], otherwise: str, *, timeout: float = 60.0) -> None:
        """Let time pass until the claim holds; fail the test if it does not within `timeout` s."""
        passed = 0.0
        deadline = time.monotonic() + timeout
        while not claim():
            require(passed < timeout and time.monotonic() < deadline, otherwise)
            self.pass_time(0.02)
            passed += 0.02

    # --- what it is ---

    def test_it_is_a_robot_link(self) -> None:
        """Check that it has all members of the protocol."""
        with self.opened() as link:
            require(isinstance(link, RobotLink), f"{link!r} lacks members of RobotLink")
            require(isinstance(link.is_simulated, bool), "is_simulated is not a bool")
            require(link.encoding in Encoding, "encoding is not an Encoding")

    def test_it_can_be_closed_twice_and_not_used_after(self) -> None:
        """Check that a closed link raises errors, and does not hang or crash."""
        link = self.make_link()
        link.close()
        link.close()
        refusal(lambda: link.publish("cmd_vel", _TWIST, {}))
        refusal(lambda: link.subscribe(self.topic, _ODOMETRY, lambda _: None))
        refusal(lambda: link.call("task/stop", _TRIGGER))

    # --- messages ---

    def test_a_misspelt_field_is_named_with_its_path(self) -> None:
        """Check that the error names the field and the nearest one."""
        with self.opened() as link:
            error = refusal(lambda: link.publish("cmd_vel", _TWIST, {"linear": {"X": 1.0}}))
            require("linear.X" in error.problem, f"the field is not named: {error}")
            require("'x'" in error.fix, f"the nearest is not named: {error}")

    def test_a_value_of_another_kind_is_named_with_its_path(self) -> None:
        """Check that a text for a number, and a command that is NaN, are refused."""
        with self.opened() as link:
            for value in ("fast", None, float("nan"), float("inf")):
                error = refusal(partial(link.publish, "cmd_vel", _TWIST, {"angular": {"z": value}}))
                require("angular.z" in error.problem, f"the field is not named: {error}")

    def test_an_unknown_type_is_refused(self) -> None:
        """Check that a type that does not exist is an error at once."""
        with self.opened() as link:
            refusal(lambda: link.publish("cmd_vel", "geometry_msgs/Twit", {}))
            refusal(lambda: link.subscribe(self.topic, "nav_msgs/Odometri", lambda _: None))

    def test_a_definition_comes_with_those_that_it_is_made_of(self) -> None:
        """Check that the definition is the text that bags store."""
        with self.opened() as link:
            text = link.definition(_TWIST)
            require("linear" in text and "angular" in text, f"that is not a definition of {_TWIST}: {text!r}")
            require("MSG: geometry_msgs/" in text, f"what it is made of is not there: {text!r}")
            refusal(lambda: link.definition("geometry_msgs/Twit"))

    # --- what the robot publishes ---

    def test_what_the_robot_publishes_is_received(self) -> None:
        """Check that messages are mappings with every field, until the subscription is closed."""
        with self.opened() as link:
            if not self.publishes:
                return
            received: list[Message] = []
            subscription = link.subscribe(self.topic, _ODOMETRY, received.append)
            require(isinstance(subscription, Subscription), f"{subscription!r} cannot be closed")
            self.until(lambda: len(received) > 1, "nothing was received")
            require(
                {"header", "child_frame_id", "pose", "twist"} <= set(received[0]), f"fields are missing: {received[0]}"
            )
            require(set(received[0]["header"]["stamp"]) == {"sec", "nanosec"}, "a stamp has other fields")
            subscription.close()
            subscription.close()

    def test_bytes_of_what_the_robot_publishes_are_received(self) -> None:
        """Check that raw messages have their time of reception."""
        with self.opened() as link:
            if not self.publishes:
                return
            first: list[RawMessage] = []
            subscription = link.subscribe_raw(self.topic, _ODOMETRY, first.append)
            self.until(lambda: len(first) > 1, "nothing was received")
            subscription.close()
            require(isinstance(first[0].data, bytes) and first[0].data, "there are no bytes")
            require(first[0].received_ns <= first[1].received_ns, "time goes back")

    def test_a_message_that_never_comes_is_waited_for_until_the_deadline(self) -> None:
        """Check that `wait_for` ends, and says which message did not arrive."""
        with self.opened() as link:
            error = punctual_refusal(
                lambda: link.wait_for(self.topic, _ODOMETRY, lambda _: False, timeout=0.3), timeout=0.3
            )
            require(self.topic in f"{error.where} {error.problem}", f"the topic is not named: {error}")

    def test_a_fault_of_the_condition_is_raised_where_it_is_waited_for(self) -> None:
        """Check that an exception in the condition is not swallowed."""
        with self.opened() as link:
            if not self.publishes:
                return
            try:
                link.wait_for(self.topic, _ODOMETRY, lambda message: message["no such field"], timeout=5.0)
            except KeyError:
                return
            raise AssertionError("the condition's KeyError was lost")

    def test_a_message_that_comes_is_returned_before_the_deadline(self) -> None:
        """Check that `wait_for` returns before its timeout."""
        with self.opened() as link:
            if not self.publishes:
                return
            begun = time.monotonic()
            message = link.wait_for(self.topic, _ODOMETRY, timeout=2 * PATIENCE)
            require("pose" in message, f"`wait_for` returned {message}")
            require(time.monotonic() - begun < PATIENCE, "`wait_for` waited on although the message was there")

    def test_a_fault_of_a_callback_is_raised_at_the_latest_when_the_link_is_closed(self) -> None:
        """Check that a run cannot succeed after an exception in a callback."""
        if not self.publishes:
            return
        receive, link = FaultyCallback(), self.make_link()
        try:
            link.subscribe(self.topic, _ODOMETRY, receive)
            self.until(lambda: receive.calls, "nothing was received")
        except ValueError:  # callbacks may be called while time passes
            link.close()
            return
        error = refusal(link.close)
        require("a fault of the callback" in error.problem, f"the fault is not named: {error}")

    def test_a_fault_of_a_callback_fails_the_run_at_once(self) -> None:
        """Check that an exception in a callback ends the mission, in whichever thread, and is reported once."""
        if not self.publishes:
            return
        receive = FaultyCallback()
        with faults_told() as told, self.opened() as link:
            link.subscribe(self.topic, _ODOMETRY, receive)
            self.until(lambda: told, "the run was not told")
            count = receive.calls
            self.until(lambda: receive.calls > count, "the subscription ended")
            full_name = f"/{self.topic.strip('/')}"
            require(told == [f"the callback of {full_name}: a fault of the callback"], f"the run was told {told}")

    # --- services ---

    def test_a_service_that_is_not_there_is_refused_in_time(self) -> None:
        """Check that the error names the missing service, within the deadline."""
        with self.opened() as link:
            error = punctual_refusal(lambda: link.call("no/such/service", _TRIGGER, timeout=1.0), timeout=1.0)
            require("no/such/service" in f"{error.where} {error.problem}", f"the service is not named: {error}")

    def test_an_offered_service_answers(self) -> None:
        """Check that requests and responses are mappings with every field, until the offer is closed."""
        asked: list[Message] = []

        def answer(request: Message) -> Message:
            asked.append(request)
            return {"success": True, "message": f"lamp is {request['data']}"}

        with self.opened() as robot, self.opened() as link:
            offer = robot.offer("lamp", "std_srvs/SetBool", answer)
            begun = time.monotonic()
            response = link.call("lamp", "std_srvs/SetBool", {"data": True}, timeout=2 * PATIENCE)
            require(time.monotonic() - begun < PATIENCE, "the call went on waiting when the response was there")
            require(response == {"success": True, "message": "lamp is True"}, f"the service answered {response}")
            require(asked == [{"data": True}], f"the service was asked {asked}")
            error = refusal(lambda: link.call("lamp", "std_srvs/SetBool", {"dat": True}))
            require("dat" in error.problem, f"the field is not named: {error}")
            offer.close()
            offer.close()
            refusal(lambda: link.call("lamp", "std_srvs/SetBool", {"data": True}, timeout=1.0))

    def test_a_service_is_offered_once(self) -> None:
        """Check that a second offer with the same name is refused."""
        with self.opened() as robot, self.opened() as link:
            offer = robot.offer("door", _TRIGGER, lambda _: {"success": True})
            link.call("door", _TRIGGER)
            error = refusal(lambda: link.offer("door", _TRIGGER, lambda _: {}))
            require("door" in f"{error.where} {error.problem}", f"the service is not named: {error}")
            offer.close()

    def test_a_fault_of_an_offered_service_is_the_caller_s_error(self) -> None:
        """Check that the caller gets an error if a service fails, and that neither side ends."""

        def answer(request: Message) -> Message:
            del request
            raise LinkError("the lamp is broken", where="lamp", fix="Change it.")

        with self.opened() as robot, self.opened() as link:
            robot.offer("lamp", _TRIGGER, answer)
            refusal(lambda: link.call("lamp", _TRIGGER, timeout=2.0))

    def test_a_fault_of_an_offered_service_fails_the_run_at_once(self) -> None:
        """Check that an exception in an offered service ends the mission."""

        def answer(request: Message) -> Message:
            raise LinkError(f"the lamp is broken, asked {request}", where="lamp", fix="Change it.")

        with faults_told() as told, self.opened() as robot, self.opened() as link:
            robot.offer("lamp", _TRIGGER, answer)
            refusal(lambda: link.call("lamp", _TRIGGER, timeout=2.0))
        require(len(told) == 1 and "the lamp is broken, asked {}" in told[0], f"the run was told {told}")
        require(told[0].startswith("the answer of /lamp: "), f"the service is not named: {told}")

    # --- the graph ---

    def test_the_graph_is_listed(self) -> None:
        """Check that topics and services are listed by full names with their types, and nodes by full names."""
        with self.opened() as robot, self.opened() as link:
            robot.offer("lamp", _TRIGGER, lambda _: {"success": True})
            robot.publish("cmd_vel", _TWIST, {})
            self.until(lambda: link.topics().get("/cmd_vel") == _TWIST, f"/cmd_vel is not in {link.topics()}")
            self.until(link.nodes, "there are no nodes")
            services, nodes = link.services(), link.nodes()
            require(not services or services.get("/lamp") == _TRIGGER, f"/lamp is not in {services}")
            require(list(nodes) == sorted(nodes), f"{nodes} are not sorted")
            require(all(name.startswith("/") for name in nodes), f"{nodes} are not full names")

    def test_who_publishes_what_the_robot_publishes_is_listed(self) -> None:
        """Check that a robot behind the link is listed as a publisher, with the type of its topic."""
        if not self.publishes:
            return
        with self.opened() as link:
            found = link.publishers(self.topic)
            require({each.message_type for each in found} == {_ODOMETRY}, f"the publishers are {found}")
            require(not any(each.is_own for each in found), f"the link says that it is the robot: {found}")

    def test_robots_are_kept_apart_by_their_namespaces(self) -> None:
        """Check that relative names reach only the link's robot, and full names any robot."""
        with self.opened("alice") as alice, self.opened("/bob") as bob:
            alice.offer("who", _TRIGGER, lambda _: {"success": True, "message": "alice"})
            bob.offer("who", _TRIGGER, lambda _: {"success": True, "message": "bob"})
            require(alice.call("who", _TRIGGER)["message"] == "alice", "alice's service is not hers")
            require(bob.call("who", _TRIGGER)["message"] == "bob", "bob's service is not his")
            require(bob.call("/alice/who", _TRIGGER)["message"] == "alice", "a full name is not taken as such")
