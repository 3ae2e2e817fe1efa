"""The protocols of a link to a robot, the same for all kinds of links."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

from robot_runner.core.links.goals import ActionResult, GoalStatus

if TYPE_CHECKING:
    from robot_runner.core.errors import LinkError

#: A ROS message as a plain mapping that follows its definition: `{"linear": {"x": 0.2, ...}, "angular": {...}}`.
#: Times and durations are `{"sec": …, "nanosec": …}` in both generations of ROS, arrays are lists, byte arrays `bytes`.
Message = Mapping[str, Any]


class Qos(StrEnum):
    """How a topic's messages are delivered, by the names of ROS' profiles.

    ROS 1 knows one of them only: what is published `TRANSIENT_LOCAL` is latched there.
    """

    #: Reliable, volatile, the last 10 are kept: `rmw_qos_profile_default`.
    DEFAULT = "default"
    #: Best effort, volatile, the last 5 are kept: `rmw_qos_profile_sensor_data`.
    SENSOR_DATA = "sensor_data"
    #: Reliable, volatile, as many are kept as come: nothing is lost to a slow subscriber.
    RELIABLE = "reliable"
    #: Reliable, and the last message is kept for later subscribers, as of `/tf_static` and a map.
    TRANSIENT_LOCAL = "transient_local"


class Encoding(StrEnum):
    """How the bytes of a message are laid out."""

    #: ROS 1: little endian, no padding.
    ROS1 = "ros1"
    #: ROS 2: XCDR1 with its header of four bytes.
    CDR = "cdr"


@dataclass(frozen=True, slots=True)
class RawMessage:
    """A message as it was received, for recorders and for measuring its size.

    Attributes:
        data: the message's bytes, in the link's encoding.
        received_ns: when it was received, in ns since the epoch, on the clock of this machine (a simulated one: of the
            simulation).
    """

    data: bytes
    received_ns: int


@dataclass(frozen=True, slots=True)
class GraphEndpoint:
    """A publisher or subscriber of a topic.

    Attributes:
        node: the full name of its node; empty where the graph does not say.
        message_type: such as `nav_msgs/Odometry`; empty where the graph does not say.
        is_own: whether it is this link's. Everything that a rosbridge server publishes counts as this link's.
        qos: the profile nearest to its own; None where the graph does not say (a rosbridge; ROS 1 for topics to which
            this process does not subscribe).
        is_shared: whether it may be that of other programs, too: a rosbridge server is one node for all its clients.
    """

    node: str
    message_type: str
    is_own: bool = False
    qos: Qos | None = field(default=None, compare=False)
    is_shared: bool = field(default=False, compare=False)

    @property
    def may_be_others(self) -> bool:
        """Whether it is, or may be, that of another program."""
        return not self.is_own or self.is_shared

    def __str__(self) -> str:
        """Return its name for messages.

        Example:
            >>> str(GraphEndpoint("/teleop", "geometry_msgs/Twist")), str(GraphEndpoint("", "geometry_msgs/Twist"))
            ('/teleop', 'a node whose name is not known')
        """
        return self.node or "a node whose name is not known"


@runtime_checkable
class Subscription(Protocol):
    """A subscription, or an offered service or action, that can be ended."""

    def close(self) -> None:
        """End it; closing twice does nothing."""


@runtime_checkable
class Publisher(Protocol):
    """Publishes on the topics of a robot."""

    def publish(self, topic: str, message_type: str, message: Message, *, qos: Qos = Qos.DEFAULT) -> None:
        """Publish one message; fields that are left out take their ROS default.

        Raises:
            LinkError: the robot cannot be reached, or the message does not follow its definition.
        """


@runtime_checkable
class Advertiser(Protocol):
    """Puts topics on the graph before anything is published on them."""

    def advertise(self, topic: str, message_type: str, *, qos: Qos = Qos.DEFAULT, is_commanded: bool = True) -> bool:
        """Advertise a topic, and wait until its present subscribers would receive a message; may be called again.

        Args:
            topic: its name.
            message_type: such as `geometry_msgs/Twist`.
            qos: of what is published.
            is_commanded: for a type of velocities, whether they are commanded there: then zero must arrive when the
                link is closed, and if the process is killed. Otherwise zero is sent without that guarantee.

        Returns:
            whether they would; False where that took too long.

        Raises:
            LinkError: the robot cannot be reached, there is no such type, or the topic carries another.
        """


@runtime_checkable
class Rejoiner(Protocol):
    """Joins its graph once more; a link cannot whose client library has one view of the graph for the whole process."""

    def rejoined(self) -> RobotLink:
        """Return a link of another participant, which lists no process that is dead by now; the caller closes it.

        From then on, that one sees to it that the last commands are taken, and this one does not wait for that.

        Raises:
            LinkError: the graph cannot be joined.
        """


@runtime_checkable
class Subscriber(Protocol):
    """Receives what is published on the topics of a robot.

    Callbacks may be called from another thread; on the simulated link they are called while the clock is slept on.
    """

    def subscribe(
        self,
        topic: str,
        message_type: str,
        callback: Callable[[Message], None],
        *,
        qos: Qos | None = None,
        is_prompt: bool = False,
    ) -> Subscription:
        """Call `callback` with each message of the topic.

        Args:
            topic: its name. It need not exist yet, except on the simulated link.
            message_type: ROS name, such as `nav_msgs/Odometry`.
            callback: called with each message. Its exceptions fail the run: on the simulated link they are raised by
                sleeping on the clock, on all others by `close`.
            qos: None for a profile that fits the topic's publishers.
            is_prompt: whether callbacks that take long do not delay this one, by which a plugin steers or measures; it
                has to return at once itself.

        Raises:
            LinkError: it carries another type, its publishers offer less than `qos` asks for, or there is no such type.
        """

    def subscribe_raw(
        self, topic: str, message_type: str, callback: Callable[[RawMessage], None], *, qos: Qos | None = None
    ) -> Subscription:
        """Call `callback` with the bytes of each message of the topic; otherwise as `subscribe`."""

    def wait_for(
        self, topic: str, message_type: str, condition: Callable[[Message], bool] | None = None, *, timeout: float = 5.0
    ) -> Message:
        """Return the first message from now on that satisfies the condition (None: the first); `timeout` is in seconds.

        Raises:
            LinkError: none came in time, or as `subscribe`.
        """


@runtime_checkable
class Caller(Protocol):
    """Calls the services of a robot."""

    def call(self, service: str, service_type: str, request: Message | None = None, *, timeout: float = 5.0) -> Message:
        """Call a service and return its response; `timeout` is in seconds.

        Raises:
            LinkError: there is no such service, it has another type, it fails or does not answer in time, or the
                request does not follow its definition.
        """


@runtime_checkable
class Offerer(Protocol):
    """Offers services in the namespace of a robot."""

    def offer(self, service: str, service_type: str, answer: Callable[[Message], Message]) -> Subscription:
        """Offer a service until it is closed; `answer` makes the response of a request.

        Raises:
            LinkError: there is no such type, or a service of this name exists.
        """


class Goal(Protocol):
    """A goal that an action server accepted, until it is over."""

    @property
    def status(self) -> GoalStatus:
        """The last status from the server."""

    @property
    def fault(self) -> LinkError | None:
        """Why there will be no result, if so: its server or the connection is gone, say."""

    def result(self, *, timeout: float) -> ActionResult:
        """Wait until it is over and return its result, however it ended; `timeout` is in seconds.

        Raises:
            LinkError: it is not over in time, and goes on; or its server is gone.
        """

    def cancel(self, *, timeout: float = 5.0) -> None:
        """Cancel it and wait until it is over; nothing is done where it is over. `timeout` is in seconds.

        Raises:
            LinkError: the server refuses, or does not end it in time.
        """


@runtime_checkable
class ActionCaller(Protocol):
    """Sends goals to the action servers of a robot."""

    def send_goal(
        self,
        action: str,
        action_type: str,
        goal: Message | None = None,
        *,
        on_feedback: Callable[[Message], None] | None = None,
        timeout: float = 5.0,
    ) -> Goal:
        """Send a goal and return it once the server has accepted it; a goal that is not over ends with the link.

        Args:
            action: name of the action.
            action_type: ROS name, such as `nav2_msgs/NavigateToPose`.
            goal: fields that are left out take their ROS default.
            on_feedback: called with the feedback of this goal, as the callbacks of subscriptions are.
            timeout: how long the server may take to accept it, s.

        Raises:
            LinkError: there is no such action, it has another type, the server rejects the goal or does not answer in
                time, or the goal does not follow its definition.
        """


class GoalExecution(Protocol):
    """A goal that is executed by an action that this link offers."""

    @property
    def goal(self) -> Message:
        """What is asked for, with every field of its type."""

    @property
    def is_cancel_requested(self) -> bool:
        """Whether the client has cancelled it: raise `ActionCanceled` then."""

    def feedback(self, message: Message) -> None:
        """Send feedback to the client.

        Raises:
            LinkError: the message does not follow its definition, or the graph is lost.
        """


@runtime_checkable
class ActionOfferer(Protocol):
    """Offers actions in the namespace of a robot."""

    def offer_action(
        self,
        action: str,
        action_type: str,
        execute: Callable[[GoalExecution], Message],
        *,
        accept: Callable[[Message], bool] | None = None,
    ) -> Subscription:
        """Offer an action until it is closed.

        Args:
            action: name of the action.
            action_type: ROS name.
            execute: carries out a goal, in a thread of its own, and returns the result of success. It raises
                `ActionAborted` or `ActionCanceled` to end otherwise; any other exception aborts the goal and fails the
                run. On the simulated link the thread runs only while the simulation's clock is slept on, and may sleep
                on that clock itself.
            accept: returns whether a goal is accepted; None for all.

        Raises:
            LinkError: there is no such type, or an action of this name exists.
        """


@runtime_checkable
class GraphListing(Protocol):
    """Lists what is on the graph."""

    def topics(self) -> Mapping[str, str]:
        """Return the type of each topic that is published or subscribed on the graph, by its full name."""

    def services(self) -> Mapping[str, str]:
        """Return the type of each service on the graph, by its full name; empty where the graph does not say."""

    def actions(self) -> Mapping[str, str]:
        """Return the type of each action that a server offers, by its full name."""

    def nodes(self) -> Sequence[str]:
        """Return the full names of the nodes on the graph, sorted."""

    def publishers(self, topic: str) -> Sequence[GraphEndpoint]:
        """Return the publishers of a topic, this link included; none where there is no such topic."""

    def subscribers(self, topic: str) -> Sequence[GraphEndpoint]:
        """Return the subscribers of a topic, this link included; none where there is no such topic."""


@runtime_checkable
class AsksNodes(Protocol):
    """Asks a node whether it is there: the master of ROS 1 lists killed nodes, too."""

    def answers(self, node: str) -> bool:
        """Return whether a node of this full name is there; True where nobody can be asked."""


@runtime_checkable
class RobotLink(Publisher, Subscriber, Caller, Offerer, ActionCaller, ActionOfferer, GraphListing, Protocol):
    """A link to one robot. Names are relative to the robot's namespace unless they begin with `/`.

    Message types are ROS names without a generation, such as `geometry_msgs/Twist`. Code that needs only a part of a
    link is typed by that part: `Publisher`, `Subscriber`, `Caller`, `Offerer`, `ActionCaller`, `ActionOfferer` or
    `GraphListing`.
    """

    @property
    def is_simulated(self) -> bool:
        """Whether its robot is simulated, so that values are labelled as such."""

    @property
    def encoding(self) -> Encoding:
        """How the bytes of raw messages are laid out."""

    def definition(self, message_type: str) -> str:
        """Return the text of a type's definition, followed by those of its parts, as bags store it.

        Raises:
            LinkError: the link knows no such type.
        """

    def close(self) -> None:
        """Cancel the goals that are not over, end all subscriptions and offers, and leave; once.

        Raises:
            LinkError: a goal or a robot that was driven could not be stopped, or a callback raised.
        """
