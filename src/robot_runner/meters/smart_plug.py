"""The profiler of smart plugs, over their local HTTP interface or over MQTT."""

from __future__ import annotations

import importlib.util
import secrets
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from robot_runner.core.design.numeric_range import is_whole
from robot_runner.core.errors import Finding, LinkError, PluginError, did_you_mean
from robot_runner.core.events.context import RobotRunnerContext
from robot_runner.core.links.connect import SIMULATED, is_simulated
from robot_runner.measuring.parameter_checks import check_numbers
from robot_runner.meters.electrical import ElectricalProfiler
from robot_runner.meters.electrical_readings import Readings
from robot_runner.meters.http_requests import HttpDevice, Secret, check_url
from robot_runner.meters.mqtt_requests import MQTT_INSTALL, MqttRequests
from robot_runner.meters.plug_dialects import DIALECTS, PlugDialect
from robot_runner.meters.polled import trial_findings

if TYPE_CHECKING:
    from robot_runner.core.plugin import Circumstances
    from robot_runner.measuring.periodic import Sampling

#: Power in whole watts is too coarse if a watt is this share of it or more, which takes this many readings to notice.
_COARSE_SHARE, _COARSE_READINGS = 0.01, 10


class _Plug:
    def __init__(self, plugin: SmartPlug, password: str | None) -> None:
        self._dialect, self._channel = plugin.dialect, plugin.channel
        self._requests: MqttRequests | None = None
        user, timeout, where = plugin.user, plugin.timeout_s, plugin.name
        if plugin.url is not None:
            path = plugin.dialect.path(plugin.channel, user, password)
            device = HttpDevice(plugin.url, timeout=timeout, user=user, password=password, where=where)
            self._ask: Callable[[], Mapping[str, bytes]] = lambda: {"": device.get(path)}
        else:
            reply_to = f"robot_runner_{secrets.token_hex(4)}"
            user = user if password is not None else ""
            exchange = plugin.dialect.exchange(plugin.topic or "", plugin.channel, reply_to)
            broker = plugin.broker or ""
            self._requests = MqttRequests(broker, exchange, timeout=timeout, user=user, password=password, where=where)
            self._ask = self._requests.ask

    def read(self) -> Readings:
        return (self._dialect.read(self._ask(), self._channel),)

    def close(self) -> None:
        if self._requests is not None:
            self._requests.close()


class SmartPlug(ElectricalProfiler):
    """Measures with a smart plug: a cheap meter for the charger of a robot, a base station or a workstation.

    Energy is the integral of its power: the counters of plugs are too coarse for a mission, and serve as a check only.

    Args:
        kind: `tasmota`, `shelly1` (first generation), `shelly2` (later ones) or `shelly2-pm` (those without a switch).
        name: distinguishes several plugs; None for the class's name.
        url: of its local HTTP interface, such as `http://192.168.0.20`.
        broker: instead of `url` the MQTT broker, such as `mqtt://192.168.0.2`, or `mqtts://...` for TLS.
        topic: the plug's topic at the broker, such as `tasmota_1A2B3C` or `shellyplusplugs-a8032abe54dc`.
        channel: the number of the outlet, from 0.
        user: whose password it is; None takes the plug's default user.
        password_env: the environment variable that holds the password of the plug or of the broker.
        password_file: the file whose first line it is.
        rate_hz: readings a second, Hz; plugs update their values about once a second.
        timeout_s: how long to wait for an answer, s.

    Raises:
        PluginError: there is no such kind, an address is malformed or contains a password, or not exactly one of `url`
            and `broker` is given.

    Example:
        >>> SmartPlug("shelly2", url="http://192.168.0.20").measures[0].unit
        'J'
    """

    needs: ClassVar[str] = "A Tasmota or Shelly plug in the local network; over MQTT a broker and robot-runner[mqtt]."
    bytes_per_run: int = 5_000  # a row a second of 50 bytes for a mission of 95 s
    # Shelly reports energy by the minute ("by_minute"), and no maker documents how often a counter is updated.
    counter_period = 60.0

    def __init__(  # noqa: PLR0913 - two ways to one plug
        self,
        kind: str,
        *,
        name: str | None = None,
        url: str | None = None,
        broker: str | None = None,
        topic: str | None = None,
        channel: int = 0,
        user: str | None = None,
        password_env: str | None = None,
        password_file: str | Path | None = None,
        rate_hz: float = 1.0,
        timeout_s: float = 2.0,
    ) -> None:
        super().__init__(name=name, rate_hz=rate_hz)
        if kind not in DIALECTS:
            raise PluginError(f"kind is {kind!r}", where=self.name, fix=did_you_mean(kind, DIALECTS))
        if (url is None) == (broker is None):
            problem = "neither url nor broker is named" if url is None else "both url and broker are named"
            raise PluginError(problem, where=self.name, fix="Name one: url='http://192.168.0.20'.")
        if (broker is None) != (topic is None):
            problem = "topic is named without a broker" if broker is None else "the broker is named without a topic"
            raise PluginError(problem, where=self.name, fix="Name both: broker='mqtt://...', topic='tasmota_1A2B3C'.")
        if topic is not None and (not topic or any(sign in topic for sign in "+#\0 ")):
            fix = "Give the topic as the plug's own settings show it."
            raise PluginError(f"topic is {topic!r}", where=self.name, fix=fix)
        if not is_whole(channel) or channel < 0:
            raise PluginError(f"channel is {channel!r}", where=self.name, fix="Count the outlets from 0.")
        check_numbers(self.name, timeout_s=timeout_s)
        self.kind = kind
        self.url = None if url is None else check_url(url, where=self.name)
        self.broker = None if broker is None else check_url(broker, where=self.name, schemes=("mqtt", "mqtts"))
        self.topic = None if topic is None else topic.strip("/")
        self.channel = channel
        self.user = "admin" if user is None else user  # of all these plugs, unless it was changed
        self.timeout_s = timeout_s
        self.counter_step = self.dialect.counter_step
        self._secret = Secret.named(password_env, password_file, where=self.name)
        if user is not None and self._secret is None:
            fix = "Name where the password stands: password_env='NAME' or password_file='...'."
            raise PluginError("user is named without a password", where=self.name, fix=fix)

    @property
    def dialect(self) -> PlugDialect:
        """The requests and answers of this kind of plug."""
        return DIALECTS[self.kind]

    def claims(self, robot: str | None) -> Iterable[str]:
        """Return a claim of the plug."""
        del robot
        return (f"device:{self.url or self.broker} {self.topic or self.channel}",)

    def check(self, circumstances: Circumstances) -> Iterable[Finding]:
        """Return errors: no library, or a plug without power in its answers; and a warning for a simulated robot."""
        where = f"plugin {self.name}"
        if is_simulated(circumstances.robot):
            problem = f"robot is {SIMULATED!r}, and draws nothing from a plug"
            return [Finding.warning(where, problem, "Do not take its values for the robot's.")]
        if self.broker is not None and importlib.util.find_spec("paho") is None:
            return [Finding.error(where, "paho-mqtt is not installed", MQTT_INSTALL)]
        return trial_findings(self, self._opened)

    def open(self, context: RobotRunnerContext) -> _Plug:
        """Return the plug, after one answer with its power; a `LinkError` says that there was none."""
        del context
        return self._opened()

    def doubts(self, sampling: Sampling[Readings]) -> Iterator[str]:
        """Yield doubts, also about power in whole watts."""
        yield from super().doubts(sampling)
        watts = [power for (reading,) in sampling.readings if (power := reading.power)]
        is_whole = len(watts) >= _COARSE_READINGS and all(power == round(power) for power in watts)
        if is_whole and sum(watts) / len(watts) < 1 / _COARSE_SHARE:
            remedy = " (Tasmota's command `WattRes 2` corrects that)" if self.kind == "tasmota" else ""
            yield f"the plug reports its power in whole watts, at {sum(watts) / len(watts):.0f} W{remedy}"

    def details(self) -> Mapping[str, Any]:
        """Return the kind and address of the plug."""
        way = {"url": self.url} if self.url is not None else {"broker": self.broker, "topic": self.topic}
        return {**super().details(), "kind": self.kind, **way, "channel": self.channel}

    def _opened(self) -> _Plug:
        plug = _Plug(self, None if self._secret is None else self._secret.read(self.name))
        try:
            plug.read()
        except ValueError as error:
            plug.close()
            fix = f"Check whether it is a plug of the kind {self.kind!r} that measures power, and at its channel."
            raise LinkError(str(error), where=self.name, fix=fix) from error
        except LinkError:
            plug.close()
            raise
        return plug
