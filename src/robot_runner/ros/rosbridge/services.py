"""Services that are called, and those that are offered, over a rosbridge."""

from __future__ import annotations

import logging
import threading
from typing import TYPE_CHECKING, Any

from robot_runner.core.errors import LinkError
from robot_runner.ros.graph_links import missing
from robot_runner.ros.rosbridge.frames import from_protocol, to_protocol
from robot_runner.ros.rosbridge.topics import check_type
from robot_runner.ros.shapes import completed

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from robot_runner.core.links.robot import Message
    from robot_runner.ros.rosbridge.rosapi import RobotTypes, Rosapi
    from robot_runner.ros.rosbridge.session import Session

__all__ = ["Services"]

_logger = logging.getLogger(__name__)


class _Offer:
    """A service that is offered until it is closed."""

    def __init__(
        self, name: str, service_type: str, answer: Callable[[Message], Message], close: Callable[[_Offer], None]
    ) -> None:
        self.name = name
        self.service_type = service_type
        self.answer = answer
        self._close = close
        self._is_closed = False

    def close(self) -> None:
        """Offer it no more; closing twice does nothing."""
        if not self._is_closed:
            self._is_closed = True
            self._close(self)


class Services:
    """All services that are called and offered over one session.

    Args:
        session: over which requests and responses go.
        types: of the robot.
        rosapi: of the robot.
    """

    def __init__(self, session: Session, types: RobotTypes, rosapi: Rosapi) -> None:
        self._session = session
        self._types = types
        self._rosapi = rosapi
        self._offers: dict[str, _Offer] = {}
        session.on_request = self._take

    def call(self, name: str, service_type: str, request: Message, timeout: float) -> Message:
        """Call a service, by its full name, and return its response.

        Raises:
            LinkError: there is no such service, it has another type, does not answer in time or fails, or the request
                does not follow its definition.
        """
        self._session.check_open(name)
        asked, answered = self._types.request(service_type), self._types.response(service_type)
        values = to_protocol(asked, completed(asked, request, where=name))
        true = self._rosapi.service_type(name)
        if true == "":
            raise self._missing(name)
        check_type(name, service_type, true)
        reply = self._session.call(name, values, timeout=timeout, where=name)
        if not reply.is_good:
            if "does not exist" in str(reply.values):
                raise self._missing(name)
            raise LinkError(f"the service failed: {reply.values}", where=name, fix="Look at the log of its node.")
        return from_protocol(answered, reply.values or {}, where=name)

    def offer(self, name: str, service_type: str, answer: Callable[[Message], Message]) -> _Offer:
        """Offer a service, by its full name.

        Raises:
            LinkError: there is no such type, or somebody offers a service of this name already.
        """
        self._session.check_open(name)
        self._types.request(service_type)
        if name in self._offers or self._rosapi.service_type(name):
            problem = f"somebody offers the service {name!r} already"
            raise LinkError(problem, where=name, fix="End the other, or give the robots namespaces of their own.")
        offer = _Offer(name, service_type, answer, self._withdraw)
        self._offers[name] = offer
        wire_type = self._types.wire_name(service_type, "srv")
        try:
            self._session.request({"op": "advertise_service", "service": name, "type": wire_type}, where=name)
            self._rosapi.confirm_service(name, service_type)
        except LinkError:
            del self._offers[name]
            raise
        return offer

    def close(self) -> None:
        """Offer nothing more."""
        for offer in list(self._offers.values()):
            offer.close()

    def _withdraw(self, offer: _Offer) -> None:
        self._offers.pop(offer.name, None)
        if self._session.is_usable:
            operation = {"op": "unadvertise_service", "service": offer.name}
            self._session.request(operation, where=offer.name)

    def _missing(self, name: str) -> LinkError:
        fix = "Start the node that offers it."
        return missing("service", name, self._rosapi.service_names(), where=name, fix=fix)

    def _take(self, operation: Mapping[str, Any]) -> None:
        # In a thread of its own: one that takes long must keep up neither messages nor other services.
        threading.Thread(target=self._respond, args=(operation,), name="rosbridge service", daemon=True).start()

    def _respond(self, operation: Mapping[str, Any]) -> None:
        name = str(operation.get("service"))
        response = {"op": "service_response", "service": name, "id": operation.get("id")}
        try:
            values = self._answered(name, operation.get("args") or {})
            outcome = {"values": values, "result": True}
        except Exception as fault:  # the caller's, who is on the other side
            _logger.exception("the service %s failed", name)
            outcome = {"values": str(fault), "result": False}
        if self._session.is_usable:
            try:
                self._session.send({**response, **outcome})
            except LinkError as error:
                _logger.warning("the response of %s is lost: %s", name, error)

    def _answered(self, name: str, request: object) -> dict[str, Any]:
        offer = self._offers.get(name)
        if offer is None:
            raise LinkError("it is not offered any more", where=name, fix="Offer it anew.")
        asked, answered = self._types.request(offer.service_type), self._types.response(offer.service_type)
        response = offer.answer(from_protocol(asked, request, where=name))
        return to_protocol(answered, completed(answered, response, where=name))
