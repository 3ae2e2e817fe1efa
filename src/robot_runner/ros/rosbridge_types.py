"""The graph and the types behind a rosbridge, from rosapi and the catalogue."""

from __future__ import annotations

import itertools
import json
import logging
import math
import os
import threading
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from robot_runner.core.errors import LinkError, SilentGraphError
from robot_runner.core.links.commanded_topics import is_zero_first
from robot_runner.core.links.robot import Encoding, GraphEndpoint
from robot_runner.ros.action_types import is_action_part, python_name
from robot_runner.ros.graph_transport import until
from robot_runner.ros.rosbridge_callers import Callers
from robot_runner.ros.rosbridge_session import ANSWER, Reply, Session
from robot_runner.ros.shapes import IDL_KINDS, ROS1_KINDS, STAMPS, UNBOUNDED, Field, Shape, plain_type
from robot_runner.ros.type_catalogue import STANDARD_DEFAULTS, TypeCatalogue
from robot_runner.ros.type_store import ROS2_DISTROS, stored_name

if TYPE_CHECKING:
    from robot_runner.ros.graph_addresses import RosbridgeAddress

_logger = logging.getLogger(__name__)

#: How long rosapi, which is a node of its own, may take to see what the server has done, s.
_CONFIRMATION = 2.0

#: How the name of a rosbridge server's node begins, whatever its generation.
_SERVER = "rosbridge"
#: How long rosapi may take, s, for so many seconds after it has left a question unanswered, or where a robot is to be
#: stopped: the robot must not be kept waiting for it, and one that was only busy is to be believed again.
_IMPATIENCE, _HANGING = 0.5, 10.0
#: What a rosapi of ROS 2 returns in place of a definition whose file it does not find.
_UNTOLD = "# failed to get full definition"


class Rosapi:
    """Asks rosapi, the node beside a rosbridge, over `callers`, as it may hang; the server itself over the session.

    Where rosapi does not answer, `told` and what lists the graph (`topics`, `services`, `nodes`, `endpoints`,
    `action_servers`) raise a `SilentGraphError`; what else it cannot answer is None or empty.
    """

    def __init__(self, session: Session, callers: Callers) -> None:
        self._session = session
        self._callers = callers
        self._hung_at = time.monotonic() if is_zero_first() else -math.inf
        self._probes = itertools.count(1)

    def version(self, address: RosbridgeAddress) -> tuple[int, str | None]:
        """Return the generation of the robot's ROS, and its distribution: from its address, or else from rosapi.

        Raises:
            LinkError: the generation is not known, or is not that of the address.
        """
        seen = self._session.generation
        if address.generation is not None:
            if seen not in {None, address.generation}:
                problem = f"the robot's address says ROS {address.generation}, and its rosbridge is one of ROS {seen}"
                raise LinkError(problem, where=self._session.where, fix=f"Say ?ros={seen}, or leave it out.")
            return address.generation, address.distro
        if seen == 1:  # its rosapi does not report the distribution
            return 1, None
        if seen is None:  # nobody else tells
            self._hung_at = -math.inf
        told = self._ask("get_ros_version")
        if told.is_good and isinstance(told.values, dict):
            return int(told.values.get("version", 2)), str(told.values.get("distro") or "") or None
        if seen is not None or self._ask("get_time").is_good:
            return seen or 1, None
        problem = "neither rosapi nor the server's own node tells which generation of ROS it is"
        fix = "Start rosapi beside it, or say it: robot = 'rosbridge://robot:9090?ros=1' (or ros=2)."
        raise LinkError(problem, where=self._session.where, fix=fix)

    def topics(self) -> dict[str, str]:
        """Return the type of each topic by its full name; an empty text where it is not known."""
        values = self.told("topics")
        return {name: plain_type(kind) for name, kind in zip(values["topics"], values["types"], strict=True)}

    def services(self) -> dict[str, str]:
        """Return the type of each service by its full name."""
        names: list[str] = self.told("services")["services"]
        asked: list[tuple[str, Mapping[str, Any]]] = [("/rosapi/service_type", {"service": name}) for name in names]
        answers = self._callers.calls(asked, timeout=ANSWER, where=self._session.where)
        types = [_text(answer, "type") for answer in answers]
        return {name: plain_type(kind) for name, kind in zip(names, types, strict=True) if kind}

    def service_names(self) -> list[str]:
        """Return the full names of the services; none where rosapi does not answer."""
        answer = self._ask("services")
        return list(answer.values["services"]) if answer.is_good else []

    def nodes(self) -> list[str]:
        """Return the full names of the nodes."""
        return list(self.told("nodes")["nodes"])

    def endpoints(self, question: str, topic: str) -> list[GraphEndpoint]:
        """Return the `publishers` or `subscribers` of a topic; rosapi knows one type of it."""
        known = self.topic_type(topic) or ""
        names: list[str] = self.told(question, {"topic": topic})[question]
        servers = {name for name in names if name.rpartition("/")[2].startswith(_SERVER)}
        return [GraphEndpoint(name, known, name in servers, is_shared=name in servers) for name in names]

    def topic_type(self, topic: str) -> str | None:
        """Return the type of a topic, or None where there is none or it is not known."""
        return plain_type(_text(self._ask("topic_type", {"topic": topic}), "type")) or None

    def service_type(self, service: str) -> str | None:
        """Return the type of a service, an empty text where there is none, None where it is not known."""
        answer = self._ask("service_type", {"service": service})
        return plain_type(_text(answer, "type")) if answer.is_good else None

    def action_servers(self) -> list[str]:
        """Return the full names of the actions of ROS 2 that are offered."""
        return list(self.told("action_servers")["action_servers"])

    def action_type(self, action: str) -> str:
        """Return the type of an action; an empty text where this rosapi is too old to report it."""
        return plain_type(_text(self._ask("action_type", {"action": action}), "type"))

    def confirm_publisher(self, topic: str, message_type: str) -> None:
        """Check that the server publishes a topic; without rosapi this is not possible.

        The servers of today do not send the status messages of the protocol, they only write them to their log.

        Raises:
            LinkError: it does not.
        """
        wanted = plain_type(message_type)
        self._confirm(topic, wanted, "the publisher", lambda: self._is_there("publishers", topic, {wanted}))

    def confirm_subscription(self, topic: str, message_type: str) -> None:
        """Check that the server subscribes a topic; otherwise as `confirm_publisher`."""
        wanted = plain_type(message_type)
        # Of a topic that nobody publishes, rosapi knows the name and not the type.
        self._confirm(topic, wanted, "the subscription", lambda: self._is_there("subscribers", topic, {"", wanted}))

    def _is_there(self, question: str, topic: str, types: Collection[str]) -> bool:
        """Whether the server is one of the `publishers` or `subscribers`; where its name is not known, whether any is.

        The topic's type does not tell: the robot's own node, which has the type, shows it as well.
        """
        is_unknown = self._session.generation is None
        listed = self.endpoints(question, topic)
        return any(each.message_type in types and (is_unknown or each.is_own) for each in listed)

    def confirm_service(self, service: str, service_type: str) -> None:
        """Check that the server offers a service; otherwise as `confirm_publisher`."""
        wanted = plain_type(service_type)
        self._confirm(service, wanted, "the service", lambda: self.service_type(service) == wanted)

    def _confirm(self, name: str, type_name: str, what: str, is_there: Callable[[], bool]) -> None:
        try:
            is_confirmed = not self._ask("get_time").is_good or until(is_there, _CONFIRMATION)
        except SilentGraphError:  # it hangs by now
            return
        if not is_confirmed:
            package = type_name.partition("/")[0]
            problem = f"the rosbridge server does not take {what} of type {type_name}"
            fix = f"Source a workspace with the package {package!r} where the server is started, or look at its log."
            raise LinkError(problem, where=name, fix=fix)

    def has_service_type(self, service_type: str) -> bool:
        """Whether the robot has a service type, as a service shows that the server offers for a moment."""
        name = f"/robot_runner_probe_{os.getpid()}_{next(self._probes)}"
        operation = {"op": "advertise_service", "service": name, "type": service_type}
        try:
            self._session.request(operation, where=service_type)
            self.confirm_service(name, service_type)
        except LinkError:
            return False
        self._session.request({"op": "unadvertise_service", "service": name}, where=service_type)
        return True

    def details(self, question: str, type_name: str) -> Sequence[Mapping[str, Any]]:
        """Return what a type and those that it is made of are made of; nothing where the robot does not know it.

        A rosapi of ROS 2 ends where it is asked for a service type that it cannot import.
        """
        answer = self._ask(question, {"type": type_name})
        return list(answer.values.get("typedefs", [])) if answer.is_good and isinstance(answer.values, dict) else []

    def raw_definitions(self) -> dict[str, str]:
        """Return the text of the definition of the type of each topic, by the type's name."""
        answer = self._ask("topics_and_raw_types")
        if not answer.is_good or not isinstance(answer.values, dict):
            return {}
        names, texts = answer.values.get("types", []), answer.values.get("typedefs_full_text", [])
        return {plain_type(name): text for name, text in zip(names, texts, strict=False)}

    def told(self, question: str, values: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """Call a service of rosapi by its name, and return the response."""
        answer = self._ask(question, values)
        if not answer.is_good or not isinstance(answer.values, dict):
            problem = f"the graph cannot be listed, because rosapi does not answer: {answer.values}"
            fix = "Start rosapi beside the rosbridge server, as the server's own launch file does."
            raise SilentGraphError(problem, where=self._session.where, fix=fix)
        return answer.values

    def _ask(self, question: str, values: Mapping[str, Any] | None = None) -> Reply:
        where, begun = self._session.where, time.monotonic()
        patience = _IMPATIENCE if begun < self._hung_at + _HANGING else ANSWER
        try:
            return self._callers.call(f"/rosapi/{question}", values or {}, timeout=patience, where=where)
        except LinkError as error:
            self._session.check_open(where)
            if patience == ANSWER:
                _logger.warning("rosapi does not answer within %g s, so that nothing is confirmed by it", patience)
                self._hung_at = time.monotonic()
            return Reply(is_good=False, values=error.problem)


def _text(answer: Reply, field: str) -> str:
    return str(answer.values.get(field) or "") if answer.is_good and isinstance(answer.values, dict) else ""


class RosapiParameters:
    """A parameter server by `/rosapi/get_param` and the like, which carry values as JSON.

    A rosapi may be configured to show some parameters only (`params_glob`); the others are as if not set.
    """

    def __init__(self, rosapi: Rosapi) -> None:
        self._rosapi = rosapi

    def parameter_names(self) -> list[str]:
        """Return the full names of all parameters."""
        return list(self._rosapi.told("get_param_names")["names"])

    def parameter(self, name: str) -> Any:
        """Return the value of one, None where it is not set; a `LinkError` says rosapi does not answer, or no JSON."""
        told = self._rosapi.told("get_param", {"name": name, "default": ""})["value"]
        try:
            return json.loads(told or "null")
        except ValueError as error:
            fix = "Look at rosapi's log."
            raise LinkError(f"rosapi reports its value as {told!r}, which is not JSON", where=name, fix=fix) from error

    def set_parameter(self, name: str, *, value: Any) -> None:
        """Set one; raise a `LinkError` if rosapi does not answer, or the value cannot be written as JSON."""
        try:
            written = json.dumps(value, allow_nan=False)
        except (TypeError, ValueError) as error:
            fix = "Give a number, a text, True or False, or a list of them."
            raise LinkError(f"{value!r} cannot pass through a rosbridge: {error}", where=name, fix=fix) from error
        self._rosapi.told("set_param", {"name": name, "value": written})

    def delete_parameter(self, name: str) -> None:
        """Take one away."""
        self._rosapi.told("delete_param", {"name": name})


class RobotTypes:
    """What the types of one robot, of ROS 1 or 2, are made of.

    A `LinkError` says that neither the catalogue nor the robot knows one.

    Raises:
        LinkError: the robot's generation is not known, or a type definition cannot be used.
    """

    def __init__(self, rosapi: Rosapi, address: RosbridgeAddress) -> None:
        self._rosapi = rosapi
        self.generation, distro = rosapi.version(address)
        self.encoding = Encoding.ROS1 if self.generation == 1 else Encoding.CDR
        known = distro if self.generation == 1 or distro in ROS2_DISTROS else None
        self._catalogue = TypeCatalogue.of(self.generation, None if self.generation == 1 else known, address.types)
        self._learning = threading.Lock()  # what two threads learn at once is kept of both
        self._told: dict[tuple[str, str], Shape] = {}

    def wire_name(self, type_name: str, kind: str = "msg") -> str:
        """Return a type's name as the robot's generation spells it; `kind` is `msg` or `srv`."""
        name = plain_type(type_name)
        if self.generation != 1 and is_action_part(name):
            return python_name(name)  # a server imports the type by the name that it is given
        return name if self.generation == 1 else name.replace("/", f"/{kind}/", 1)

    def is_known_here(self, message_type: str) -> bool:
        """Whether bytes of this type can be read here: its definition is in the catalogue, or comes from the robot."""
        try:
            self._catalogue.shape(message_type)
        except LinkError:
            return self._is_learnt(message_type)
        return True

    def shape(self, message_type: str) -> Shape:
        """Return the fields of a message type."""
        self.is_known_here(message_type)
        return self._shape(self._catalogue.shape, message_type, "message_details", "msg")

    def request(self, service_type: str) -> Shape:
        """Return the fields of a service type's request."""
        return self._shape(self._catalogue.request, service_type, "service_request_details", "srv")

    def response(self, service_type: str) -> Shape:
        """Return the fields of a service type's response."""
        return self._shape(self._catalogue.response, service_type, "service_response_details", "srv")

    def definition(self, message_type: str) -> str:
        """Return the text of a type's definition, followed by those of the types of its fields."""
        try:
            return self._catalogue.definition(message_type)
        except LinkError:
            text = self._rosapi.raw_definitions().get(plain_type(message_type))
            if not text:
                raise
            return text

    def serialise(self, message_type: str, message: Mapping[str, Any]) -> bytes:
        """Return the bytes of a complete message; raises a `LinkError` where the catalogue lacks its type."""
        return self._catalogue.serialise(message_type, message, self.encoding)

    def deserialise(self, message_type: str, data: bytes) -> dict[str, Any]:
        """Return the message that these bytes are; raises a `LinkError` where they are not of this type."""
        return self._catalogue.deserialise(message_type, data, self.encoding)

    def _is_learnt(self, message_type: str) -> bool:
        """Whether rosapi returns the text of a definition, as it does for the types of present topics."""
        text = self._rosapi.raw_definitions().get(plain_type(message_type), "")
        if not text or text.startswith(_UNTOLD):
            return False
        try:
            with self._learning:
                self._catalogue = self._catalogue.with_definition(message_type, text)
        except LinkError as error:
            _logger.warning("the definition of %s that the robot sent cannot be used: %s", message_type, error)
            return False
        return True

    def _shape(self, look_up: Callable[[str], Shape], name: str, question: str, kind: str) -> Shape:
        if (told := self._told.get((question, name))) is not None:
            return told
        try:
            return look_up(name)
        except LinkError:
            wire_name = self.wire_name(name, kind)
            if kind == "srv" and self.generation != 1 and not self._rosapi.has_service_type(wire_name):
                raise
            definitions = self._rosapi.details(question, wire_name)
            if not definitions:
                raise
            return self._told.setdefault((question, name), _assembled(name, definitions, self.generation))


def _assembled(name: str, definitions: Sequence[Mapping[str, Any]], generation: int | None) -> Shape:
    """Return the shape of a type from rosapi's definitions of it (the first) and of the types of its fields."""
    by_name = {plain_type(each["type"]): each for each in definitions}
    # rosapi reports no defaults.
    defaults, kinds = ({}, ROS1_KINDS) if generation == 1 else (STANDARD_DEFAULTS, IDL_KINDS)
    shapes: dict[str, Shape] = {}

    def shape(own: str, told: Mapping[str, Any], under: frozenset[str]) -> Shape:
        if own not in shapes:
            columns = zip(told["fieldnames"], told["fieldtypes"], told["fieldarraylen"], strict=True)
            shapes[own] = Shape(own, tuple(field(own, *column, under | {own}) for column in columns))
        return shapes[own]

    def field(own: str, label: str, told: str, count: int, under: frozenset[str]) -> Field:
        kind = kinds.get(told, plain_type(told))
        length = None if count < 0 else count or UNBOUNDED
        if kind in STAMPS or kind not in by_name or kind in under:
            return Field(label, kind, length, defaults.get((stored_name(own), label)))
        return Field(label, shape(kind, by_name[kind], under), length)

    return shape(plain_type(name), definitions[0], frozenset())
