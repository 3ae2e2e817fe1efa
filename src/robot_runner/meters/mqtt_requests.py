"""Requests over MQTT: publish a message, and wait for the answers on other topics."""

from __future__ import annotations

import select
import ssl
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from importlib import import_module
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

from robot_runner.core.errors import LinkError

if TYPE_CHECKING:
    from robot_runner.meters.plug_dialects import Exchange

MQTT_INSTALL = "Install it: pip install 'robot-runner[mqtt]'."
_PORTS = {"mqtt": 1883, "mqtts": 8883}
#: How long paho waits for the network at a time, s.
_STEP = 0.05
#: So much of a message is kept: a broker passes on up to 256 MiB, and an answer has some hundred bytes.
_MOST_BYTES = 1 << 20
_FIX = "Look at the broker's address, whether it is switched on, and at the network."
_FIX_LOGIN = "Name its user, and where its password stands: password_env='NAME' or password_file='...'."


class MqttRequests:
    """A connection to a broker, without a thread: the network is polled during the wait for an answer.

    Args:
        broker: such as `mqtt://192.168.0.2:1883`, or `mqtts://...` for TLS.
        exchange: the request to repeat.
        timeout: how long to wait for the broker and for the answers, s.
        user: of the broker; empty where it needs none.
        password: of that user.
        where: for errors: whose connection it is.

    Raises:
        LinkError: paho-mqtt is not installed, or the broker cannot be reached or refuses.
    """

    def __init__(
        self,
        broker: str,
        exchange: Exchange,
        *,
        timeout: float,
        user: str = "",
        password: str | None = None,
        where: str,
    ) -> None:
        self._broker = broker
        self._exchange = exchange
        self._timeout = timeout
        self._where = where
        self._answers: dict[str, bytes] = {}
        self._refusal: str | None = None
        self._subscribed = 0
        try:
            paho: Any = import_module("paho.mqtt.client")
        except ModuleNotFoundError as error:
            raise LinkError("paho-mqtt is not installed", where=where, fix=MQTT_INSTALL) from error
        self._client: Any = paho.Client(paho.CallbackAPIVersion.VERSION2)
        self._client.connect_timeout = timeout
        if user:
            self._client.username_pw_set(user, password)
        if broker.startswith("mqtts:"):
            self._client.tls_set()
        self._client.on_connect = self._connected
        self._client.on_subscribe = self._noted_subscription
        self._client.on_message = self._received
        try:
            self._connect()
        except LinkError:
            self.close()
            raise

    def ask(self) -> Mapping[str, bytes]:
        """Publish the request and return the answers, by topic.

        Raises:
            LinkError: the connection was lost, an answer did not come in time, or others come without end.
        """
        if not self._client.is_connected():
            self._connect()
        # First read late answers, which are not for this request. paho takes one message at a time, and TLS may have
        # taken more from the network than that.
        deadline = time.monotonic() + self._timeout
        while (line := self._client.socket()) is not None and (
            select.select([line], [], [], 0.0)[0] or (isinstance(line, ssl.SSLSocket) and line.pending())
        ):
            self._client.loop(0)
            if time.monotonic() > deadline:
                problem = f"messages on {', '.join(self._exchange.answers)} come faster than they can be read"
                fix = "See that only the plug sends there, and less often."
                raise LinkError(problem, where=self._where, fix=fix)
        self._answers.clear()
        self._client.publish(self._exchange.topic, self._exchange.payload)
        missing = set(self._exchange.answers)
        if not self._wait(lambda: missing <= self._answers.keys()):
            silent = ", ".join(sorted(missing - self._answers.keys()))
            problem = f"no answer came on {silent} within {self._timeout:g} s"
            fix = (
                f"Look at the plug's topic and kind: mosquitto_sub -h {self._address[0]} -t '#' -v shows what it sends."
            )
            raise LinkError(problem, where=self._where, fix=fix)
        return dict(self._answers)

    def close(self) -> None:
        """Disconnect from the broker."""
        with suppress(OSError, ValueError):
            self._client.disconnect()
            self._client.loop(0)
        self._drop()
        # Without a reference cycle the client is freed, and closes its inner sockets, at once.
        self._client.on_connect = self._client.on_subscribe = self._client.on_message = None

    @property
    def _address(self) -> tuple[str, int]:
        parts = urlsplit(self._broker)
        return parts.hostname or "", parts.port or _PORTS[parts.scheme]

    def _connect(self) -> None:
        self._refusal, self._subscribed = None, 0
        try:
            self._client.connect(*self._address)
        except OSError as error:
            said = str(error) or type(error).__name__
            raise LinkError(f"{self._broker} does not answer: {said}", where=self._where, fix=_FIX) from error
        is_settled = self._wait(lambda: self._refusal is not None or self._subscribed == len(self._exchange.answers))
        if self._refusal:
            self._drop()
            problem = f"{self._broker} refuses: {self._refusal}"
            raise LinkError(problem, where=self._where, fix=_FIX_LOGIN)
        if not is_settled:
            self._drop()
            raise LinkError(f"{self._broker} does not answer as a broker", where=self._where, fix=_FIX)

    def _drop(self) -> None:
        socket = self._client.socket()
        if socket is not None:
            with suppress(OSError):
                socket.close()

    def _wait(self, is_enough: Callable[[], bool]) -> bool:
        deadline = time.monotonic() + self._timeout
        while not is_enough():
            remaining = deadline - time.monotonic()
            if remaining <= 0 or self._refusal is not None:
                return False
            if self._client.loop(min(_STEP, remaining)) and not is_enough():
                if self._refusal is None:
                    raise LinkError(f"the connection to {self._broker} was lost", where=self._where, fix=_FIX)
                return False
        return True

    def _connected(self, client: Any, _data: Any, _flags: Any, reason: Any, _properties: Any) -> None:
        if reason.is_failure:
            self._refusal = str(reason)
            return
        for topic in self._exchange.answers:
            client.subscribe(topic)

    def _noted_subscription(self, _client: Any, _data: Any, _id: int, reasons: Any, _properties: Any) -> None:
        refused = [str(reason) for reason in reasons if reason.is_failure]
        self._refusal = refused[0] if refused else self._refusal
        self._subscribed += 1

    def _received(self, _client: Any, _data: Any, message: Any) -> None:
        if not message.retain:  # a retained message is of an earlier moment
            self._answers[message.topic] = bytes(message.payload[:_MOST_BYTES])
