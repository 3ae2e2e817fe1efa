"""The rules for every link to a graph with publishers of any kind, as tests for its author to inherit."""

from __future__ import annotations

import math
import threading
import time
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, cast

from robot_runner.conditions.graph_presence import node_present, service_present, topic_present
from robot_runner.conditions.topic_messages import battery_above, message_on, topic_below
from robot_runner.core.events.context import SystemClock
from robot_runner.core.links.goals import ActionCanceled
from robot_runner.core.links.robot import Advertiser, Encoding, GoalExecution, Message, Qos, RawMessage, RobotLink
from robot_runner.ros.shapes import plain_type
from robot_runner.ros.watchdog import TWIST, TWIST_STAMPED, velocity_command, velocity_of
from robot_runner.testing.action_contract import PATIENCE, faults_told, punctual_refusal, refusal
from robot_runner.testing.fake_run import FakeLinks, make_context
from robot_runner.testing.link_contract import FaultyCallback, RobotLinkContract, interruptions
from robot_runner.testing.plugin_contract import require

#: The types of velocity commands, one of them in the spelling of ROS 2.
_COMMAND_TYPES = (TWIST, TWIST_STAMPED, "geometry_msgs/msg/Twist")
_TRIGGER = "std_srvs/Trigger"
_STRING = "std_msgs/String"
_BATTERY = "sensor_msgs/BatteryState"
_IMAGE = "sensor_msgs/Image"
_SCAN = "sensor_msgs/LaserScan"
_MANY = 200
#: More than fits into a socket's buffers.
_LAST_BYTES = 4_000_000
_MINUTE_NS = 60_000_000_000


class GraphLinkContract(RobotLinkContract):
    """The rules of `RobotLinkContract`, and those for two links to one graph.

    Attributes:
        discovery: how long, s, a publisher and a subscriber may take to discover each other.
        keeps_last: whether later subscribers get the last message that was published with `TRANSIENT_LOCAL`.

    Example:
        >>> from robot_runner.core.events.context import SystemClock
        >>> from robot_runner.ros.link_opening import open_ros1_link
        >>> from robot_runner.testing import GraphLinkContract
        >>> class TestRos1Link(GraphLinkContract):
        ...     def make_link(self, namespace=""):
        ...         return open_ros1_link({"master": "http://127.0.0.1:11311"}, SystemClock(), namespace)
    """

    publishes: ClassVar[bool] = False
    discovery: ClassVar[float] = 60.0
    keeps_last: ClassVar[bool] = True

    def received_on(
        self, link: RobotLink, topic: str, message_type: str, publisher: RobotLink, message: Message
    ) -> list[Message]:
        """Subscribe, and publish until the first message arrives; return the list that collects later messages."""
        received: list[Message] = []
        link.subscribe(topic, message_type, received.append)

        def has_arrived() -> bool:
            publisher.publish(topic, message_type, message, qos=Qos.RELIABLE)
            return bool(received)

        self.until(has_arrived, f"nothing is received on {topic}", timeout=self.discovery)
        return received

    def receive_with_faults(self, link: RobotLink, publisher: RobotLink) -> None:
        """Subscribe with a callback that raises, and publish until it is called again."""
        receive = FaultyCallback()
        link.subscribe("chatter", _STRING, receive)

        def was_called_again() -> bool:
            publisher.publish("chatter", _STRING, {"data": "a"})
            return receive.calls > 1

        self.until(was_called_again, "nothing is received after a fault", timeout=self.discovery)

    def test_conditions_of_a_graph_hold_once_what_they_ask_for_is_there(self) -> None:
        """Check that nodes, topics, services, messages, fields and a battery can be awaited."""
        with self.opened() as robot, self.opened() as link, ExitStack() as opened:
            context = make_context(Path("unused"), links=FakeLinks(robot=link), clock=SystemClock())
            robot.offer("task/ready", _TRIGGER, lambda _: {"success": True})
            battery = {"percentage": 0.55, "voltage": 11.9}
            awaited = [
                topic_present("battery_state", _BATTERY),
                battery_above(50),
                topic_below("battery_state", _BATTERY, "voltage", 12.0),
                message_on("battery_state", _BATTERY, lambda message: message["voltage"] > battery["percentage"]),
            ]
            looks = {str(condition): condition.watch(context, opened) for condition in awaited}

            def hold() -> bool:
                robot.publish("battery_state", _BATTERY, battery, qos=Qos.RELIABLE)
                return all(look().holds for look in looks.values())

            self.until(hold, f"these do not hold: {list(looks)}", timeout=self.discovery)
            for condition in map(node_present, filter(getattr(link, "answers", None), link.nodes())):
                require(condition.watch(context, opened)().holds, f"it does not hold that {condition}")
            if link.services():
                ready = service_present("task/ready").watch(context, opened)
                self.until(lambda: ready().holds, "the service is not found", timeout=self.discovery)
            for condition in (node_present("nobody"), topic_present("nothing"), service_present("nowhere")):
                look = condition.watch(context, opened)()
                require(not look.holds and look.seen, f"it holds that {condition}, or nothing is said of it")

    def test_a_message_arrives_with_every_field(self) -> None:
        """Check that texts, numbers, arrays, bytes, times and nested fields arrive as they were sent."""
        sent = {"stamp": {"sec": 12, "nanosec": 345}, "frame_id": "caméra"}
        image = {"header": sent, "height": 2, "width": 1, "encoding": "mono8", "step": 1, "data": b"\x00\xff"}
        with self.opened() as robot, self.opened() as link:
            received = self.received_on(link, "image", _IMAGE, robot, image)[0]
            header = received["header"]
            require(header["stamp"] == sent["stamp"], f"the stamp is {header['stamp']}")
            require(header["frame_id"] == "caméra", f"a text is {header['frame_id']!r}")
            require(received["data"] == b"\x00\xff", f"bytes are {received['data']!r}")
            require((received["height"], received["is_bigendian"]) == (2, 0), f"numbers are {received}")

    def test_floats_that_are_no_numbers_arrive(self) -> None:
        """Check NaN and infinity, by which a laser says that it sees nothing."""
        with self.opened() as robot, self.opened() as link:
            scan = {"ranges": [1.5, math.inf, math.nan], "angle_max": 1.25}
            ranges = self.received_on(link, "scan", _SCAN, robot, scan)[0]["ranges"]
            require(isinstance(ranges, list), f"an array is {ranges!r}")
            require(ranges[:2] == [1.5, math.inf] and math.isnan(ranges[2]), f"the ranges are {ranges}")

    def test_bytes_and_prompt_callbacks_wait_for_no_other_and_bytes_are_those_of_the_message(self) -> None:
        """Check that bytes are as in a bag of this generation, and that they and prompt callbacks are not delayed."""
        from robot_runner.ros.type_catalogue import TypeCatalogue  # noqa: PLC0415  # it needs rosbags

        with self.opened() as robot, self.opened() as link:
            raw, prompt, released = list[RawMessage](), list[Message](), threading.Event()
            hang: Any = lambda _: released.wait(2 * self.discovery)  # noqa: E731
            for _ in range(2):
                link.subscribe("chatter", _STRING, hang)
                link.subscribe("chatter", _STRING, prompt.append, is_prompt=True)
                link.subscribe_raw("chatter", _STRING, raw.append)

            def have_arrived() -> bool:
                robot.publish("chatter", _STRING, {"data": "hello"})
                return len(raw) > 1 and len(prompt) > 1

            self.until(have_arrived, "messages are not received, or wait for a callback", timeout=self.discovery)
            released.set()
            catalogue = TypeCatalogue.of(1 if link.encoding is Encoding.ROS1 else 2)
            message = catalogue.deserialise(_STRING, raw[0].data, link.encoding)
            require(message == {"data": "hello"}, f"the bytes say {message}")
            require(abs(raw[0].received_ns - time.time_ns()) < _MINUTE_NS, "the time is not that of this machine")

    def test_all_subscriptions_receive_until_they_are_closed(self) -> None:
        """Check that closing one subscription does not end another."""
        with self.opened() as robot, self.opened() as link:
            first: list[Message] = []
            subscription = link.subscribe("chatter", _STRING, first.append)
            received = self.received_on(link, "chatter", _STRING, robot, {"data": "a"})
            self.until(lambda: first, "the first subscription receives nothing")
            subscription.close()
            count = len(first)
            robot.publish("chatter", _STRING, {"data": "b"})
            self.until(lambda: received[-1] == {"data": "b"}, "the second subscription receives no more")
            require(len(first) == count, "a closed subscription receives")

    def test_a_fault_of_a_callback_does_not_end_the_subscription(self) -> None:
        """Check that the next message is still received, and that closing the link raises the exception."""
        with self.opened() as robot:
            link = self.make_link()
            try:
                self.receive_with_faults(link, robot)
            finally:
                error = refusal(link.close)
            require("a fault of the callback" in error.problem, f"the fault is not named: {error}")

    def test_a_fault_in_a_thread_of_the_link_fails_the_run_at_once(self) -> None:
        """Check that it is reported to the run once, from any thread, and that closing does not raise it again."""
        with self.opened() as robot, faults_told() as told, self.opened() as link:
            self.receive_with_faults(link, robot)
            require(told == ["the callback of /chatter: a fault of the callback"], f"the run was told {told}")

    def test_a_closed_link_receives_no_more(self) -> None:
        """Check that closing a link ends its subscriptions, but not those of another link."""
        with self.opened() as robot, self.opened() as other:
            link = self.make_link()
            try:
                mine = self.received_on(link, "chatter", _STRING, robot, {"data": "a"})
            finally:
                link.close()
            count = len(mine)
            others = self.received_on(other, "chatter", _STRING, robot, {"data": "b"})
            # What was published before may still be on its way.
            self.until(lambda: others[-1] == {"data": "b"}, "the other link receives no more", timeout=self.discovery)
            require(len(mine) == count, "a closed link receives messages")

    def test_both_forms_of_a_name_are_one_topic(self) -> None:
        """Check that a relative name and its full name are the same topic, to publishers and subscribers."""
        with self.opened("alice") as robot, self.opened("/alice") as link:
            self.received_on(link, "/alice/chatter", _STRING, robot, {"data": "a"})
            robot.publish("/alice/chatter", _STRING, {"data": "b"})
            found = self.received_on(link, "chatter", _STRING, robot, {"data": "c"})
            # What was published before may still be on its way.
            self.until(lambda: found[-1]["data"] in {"b", "c"}, "what follows is not received", timeout=self.discovery)

    def test_who_publishes_and_who_subscribes_a_topic_is_listed(self) -> None:
        """Check that publishers and subscribers, also the link's own, are listed with their types until they leave."""
        with self.opened() as link:
            with self.opened() as robot:
                self.received_on(link, "chatter", _STRING, robot, {"data": "a"})
                for found in (link.publishers("chatter"), link.subscribers("/chatter")):
                    types = {endpoint.message_type for endpoint in found}
                    require(types == {_STRING}, f"the types of what is there are {types}")
                self.until(lambda: any(each.is_own for each in link.subscribers("chatter")), "no own subscription")
                self.until(lambda: any(each.is_own for each in robot.publishers("chatter")), "no own publisher")
                require(not link.publishers("nothing"), "a topic that is not there has a publisher")
            self.until(lambda: not link.publishers("chatter"), "a publisher that left is listed for ever")

    def test_a_topic_is_on_the_graph_before_its_first_message(self) -> None:
        """Check that existing subscribers receive an advertised topic from its first message on."""
        with self.opened() as robot, self.opened() as link:
            arrivals: list[float] = []
            robot.subscribe("begun", _STRING, lambda _: arrivals.append(time.monotonic()))
            self.until(lambda: bool(link.subscribers("begun")), "the subscriber is not on the graph")
            require(isinstance(link, Advertiser), "the link cannot advertise")
            cast("Advertiser", link).advertise("begun", _STRING)
            self.until(lambda: any(each.is_own for each in link.publishers("begun")), "the topic is not on the graph")
            require(not arrivals, "a message was published by advertising")
            begun = time.monotonic()
            link.publish("begun", _STRING, {"data": "first"})
            self.until(lambda: bool(arrivals), "the first message did not arrive")
            require(arrivals[0] - begun < 1.0, f"the first message took {arrivals[0] - begun:.2f} s")

    def test_who_has_subscribed_since_a_topic_was_advertised_is_reached_once_it_is_advertised_again(self) -> None:
        """Check that nodes that subscribed after the first `advertise` receive the first message, too."""
        with self.opened() as robot, self.opened() as link:
            require(isinstance(link, Advertiser), "the link cannot advertise")
            cast("Advertiser", link).advertise("later", _STRING)
            arrived: list[Message] = []
            robot.subscribe("later", _STRING, arrived.append)
            self.until(lambda: bool(link.subscribers("later")), "the subscriber is not on the graph")
            cast("Advertiser", link).advertise("later", _STRING)
            link.publish("later", _STRING, {"data": "first"})
            self.until(lambda: bool(arrived), "the first message did not arrive")

    def test_what_is_published_last_arrives_although_the_link_is_closed_at_once(self) -> None:
        """Check that closing a link does not lose its last message, which may be the one that stops the robot."""
        with self.opened() as robot, self.opened() as link:
            received: list[Any] = []
            robot.subscribe("last", _STRING, lambda message: received.append(message["data"][0]), qos=Qos.RELIABLE)
            self.until(lambda: bool(link.subscribers("last")), "the subscriber is not on the graph")
            link.publish("last", _STRING, {"data": "?"})
            self.until(lambda: bool(received), "the first message did not arrive")
            for sign in "...!":
                link.publish("last", _STRING, {"data": sign * _LAST_BYTES})
            link.close()
            self.until(lambda: "!" in received, "the last message did not arrive")

    def test_many_messages_arrive_in_order_and_without_loss(self) -> None:
        """Check that no message is lost between a reliable publisher and a reliable subscriber."""
        with self.opened() as robot, self.opened() as link:
            received: list[Message] = []
            link.subscribe("numbers", "std_msgs/Int32", received.append, qos=Qos.RELIABLE)
            self.received_on(link, "numbers", "std_msgs/Int32", robot, {"data": -1})
            for number in range(_MANY):
                robot.publish("numbers", "std_msgs/Int32", {"data": number}, qos=Qos.RELIABLE)
            self.until(lambda: received and received[-1]["data"] == _MANY - 1, "the last message did not arrive")
            numbers = [message["data"] for message in received if message["data"] >= 0]
            require(numbers == list(range(_MANY)), f"{_MANY - len(numbers)} of {_MANY} messages are missing")

    def test_the_first_message_that_satisfies_a_condition_is_returned(self) -> None:
        """Check that `wait_for` skips the others, and returns as soon as the message arrives."""
        with self.opened() as robot, self.opened() as link:
            numbers, is_over = iter(range(100_000)), threading.Event()

            def count() -> None:
                while not is_over.wait(0.02):
                    robot.publish("numbers", "std_msgs/Int32", {"data": next(numbers)})

            def is_seventh(message: Message) -> bool:
                return bool(message["data"] % 7 == 0)

            counting = threading.Thread(target=count)
            counting.start()
            begun = time.monotonic()
            try:
                found = link.wait_for("numbers", "std_msgs/Int32", is_seventh, timeout=2 * PATIENCE)
            finally:
                is_over.set()
                counting.join()
            require(found["data"] % 7 == 0, f"`wait_for` returned {found}")
            require(time.monotonic() - begun < PATIENCE, "`wait_for` went on waiting when the message was there")

    def test_a_last_message_is_there_for_later_subscribers(self) -> None:
        """Check that `TRANSIENT_LOCAL` works as in ROS (latched)."""
        if not self.keeps_last:
            return
        with self.opened() as robot, self.opened() as link:
            robot.publish("map_name", _STRING, {"data": "arena"}, qos=Qos.TRANSIENT_LOCAL)
            received: list[Message] = []
            link.subscribe("map_name", _STRING, received.append, qos=Qos.TRANSIENT_LOCAL)
            self.until(lambda: received, "a later subscriber receives nothing", timeout=self.discovery)
            require(received[0] == {"data": "arena"}, f"the last message is {received[0]}")

    def test_a_topic_with_another_type_is_refused(self) -> None:
        """Check that the error names both types, for subscribers and for publishers."""
        with self.opened() as robot, self.opened() as link:
            self.received_on(link, "chatter", _STRING, robot, {"data": "a"})
            for error in (
                refusal(lambda: link.subscribe("chatter", "std_msgs/Int32", lambda _: None)),
                refusal(lambda: link.publish("chatter", "std_msgs/Int32", {"data": 1})),
            ):
                require(_STRING in error.problem and "std_msgs/Int32" in error.problem, f"types are missing: {error}")

    def test_a_service_of_another_type_is_refused(self) -> None:
        """Check that a call raises an error that says so, within its deadline."""
        with self.opened() as robot, self.opened() as link:
            robot.offer("lamp", _TRIGGER, lambda _: {"success": True})
            link.call("lamp", _TRIGGER)
            error = punctual_refusal(lambda: link.call("lamp", "std_srvs/SetBool", {}, timeout=2.0), timeout=2.0)
            require("lamp" in f"{error.where} {error.problem}", f"the service is not named: {error}")

    def test_a_service_that_does_not_answer_is_given_up_at_the_deadline(self) -> None:
        """Check that a call ends although its service does not."""
        released = threading.Event()

        def answer(request: Message) -> dict[str, Any]:
            del request
            released.wait(2 * PATIENCE)
            return {"success": True}

        with self.opened() as robot, self.opened() as link:
            robot.offer("slow", _TRIGGER, answer)
            try:
                error = punctual_refusal(lambda: link.call("slow", _TRIGGER, timeout=0.5), timeout=0.5)
                require("0.5 s" in f"{error.problem}", f"the deadline is not named: {error}")
            finally:
                released.set()

    def test_a_goal_that_is_accepted_too_late_is_cancelled(self) -> None:
        """Check that a robot does not execute a goal whose client has given up."""
        if not self.can_reject:  # the server in between accepts at once
            return
        ended: list[str] = []

        def execute(execution: GoalExecution) -> Message:
            while not execution.is_cancel_requested:
                time.sleep(0.02)
            ended.append("cancelled")
            raise ActionCanceled

        def accept(goal: Message) -> bool:
            time.sleep(1.0)
            return bool(goal)

        with self.opened() as robot, self.opened() as link:
            robot.offer_action("slow", self.action_type, execute, accept=accept)
            self.until(lambda: "/slow" in link.actions(), "the action is not found", timeout=self.discovery)
            error = refusal(lambda: link.send_goal("slow", self.action_type, {"order": 1}, timeout=0.5))
            require("0.5 s" in error.problem, f"the deadline is not named: {error}")
            self.until(lambda: ended, "a goal that was accepted too late goes on", timeout=PATIENCE)

    def test_topics_of_one_robot_are_not_those_of_another(self) -> None:
        """Check that a relative name belongs to the link's robot only."""
        with self.opened("alice") as alice, self.opened("bob") as bob, self.opened() as link:
            others: list[Message] = []
            bob.subscribe("chatter", _STRING, others.append)
            self.received_on(link, "/alice/chatter", _STRING, alice, {"data": "a"})
            bob.publish("chatter", _STRING, {"data": "b"})
            self.received_on(link, "/bob/chatter", _STRING, bob, {"data": "b"})
            require(all(message == {"data": "b"} for message in others), f"bob receives {others}")

    def test_a_robot_that_was_driven_is_stopped_when_the_link_is_closed(self) -> None:
        """Check that the last command that the robot receives is zero."""
        for number, message_type in enumerate(_COMMAND_TYPES):
            with self.opened() as robot:
                link, topic = self.make_link(), f"cmd_vel_{number}"
                try:
                    received = self.received_on(
                        robot, topic, message_type, link, velocity_command(message_type, 0.2, 0.0)
                    )
                    require(_speed(message_type, received[-1]) > 0, f"the robot received {received[-1]}")
                finally:
                    link.close()
                is_stopped = partial(lambda kind, got: _speed(kind, got[-1]) == 0.0, message_type, received)
                self.until(is_stopped, f"the last command is {received[-1]}")

    def test_a_stop_command_after_an_interrupted_publish_arrives(self) -> None:
        """Check that the next message is received wherever in a publish a stop request comes."""
        with self.opened() as robot, self.opened() as link:
            received = self.received_on(robot, "cmd_vel", TWIST, link, {})
            for moment in interruptions(partial(link.publish, "cmd_vel", TWIST, {"linear": {"x": 0.2}})):
                link.publish("cmd_vel", TWIST, {"angular": {"z": moment}})
                has_arrived = partial(lambda z: received[-1]["angular"]["z"] == z, moment)
                self.until(has_arrived, f"what follows interruption {moment:g} is lost", timeout=self.discovery)


def _speed(message_type: str, command: Message) -> float:
    return float(velocity_of(plain_type(message_type), command)["linear"]["x"])
