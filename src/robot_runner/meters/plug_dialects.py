"""Requests for the power of smart plugs over HTTP and MQTT: Tasmota, and both lines of Shelly."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from contextlib import suppress
from typing import Any, NamedTuple, Protocol
from urllib.parse import urlencode

from robot_runner.meters.electrical_readings import ElectricalReading

_KILOWATT_HOUR, _WATT_HOUR, _WATT_MINUTE = 3.6e6, 3600.0, 60.0


#: A later Shelly's power is wrong if its `errors` begin with one of these, such as `out_of_range:apower`.
_OF_METER = ("power_meter", "out_of_range")


class Exchange(NamedTuple):
    """A message to a plug, and the topics of its answers."""

    topic: str
    payload: str
    answers: tuple[str, ...]


class PlugDialect(Protocol):
    """The requests and answers of one kind of plug.

    Attributes:
        counter_step: the smallest step of its energy counters, J.
    """

    counter_step: float

    def path(self, channel: int, user: str, password: str | None) -> str:
        """Return the path of a GET request."""

    def exchange(self, topic: str, channel: int, reply_to: str) -> Exchange:
        """Return the exchange with a plug over MQTT; some plugs answer to the topic `reply_to`."""

    def read(self, answers: Mapping[str, bytes], channel: int) -> ElectricalReading:
        """Return a reading from the answers by topic; the answer to a GET request has the topic "".

        Raises:
            ValueError: they do not have the values.
        """


def _decoded(body: bytes) -> Mapping[str, Any]:
    try:
        decoded = json.loads(body, parse_int=float)  # an int may be larger than any float
    except (ValueError, RecursionError) as error:
        raise ValueError(f"the plug answered {body[:40]!r}, which is not JSON") from error
    if not isinstance(decoded, dict):
        raise ValueError(f"the plug answered {body[:40]!r}, which is not an object")  # noqa: TRY004 - it came from outside
    return decoded


def _number(fields: Mapping[str, Any], name: str, *, unit: float = 1.0) -> float | None:
    value = fields.get(name)
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError(f"the plug reports {name} = {value!r}, which is not a number")
    return value * unit


def _fields(told: Mapping[str, Any], *names: str) -> Mapping[str, Any]:
    """Return a nested object of an answer; an empty one where there is none."""
    for name in names:
        found = told.get(name)
        told = found if isinstance(found, dict) else {}
    return told


def _required(reading: ElectricalReading, said: object) -> ElectricalReading:
    if reading.power is None:
        only = f"the plug reported no power, only {str(said)[:80]}"
        raise ValueError(f"{only}: does this model, or this channel, measure it?")
    return reading


class _Tasmota:
    """Command `Status 10`. Source: tasmota.github.io/docs, Commands, MQTT and Power-Monitoring-Calibration."""

    counter_step = 0.001 * _KILOWATT_HOUR

    def path(self, channel: int, user: str, password: str | None) -> str:
        del channel
        login = {} if password is None else {"user": user, "password": password}
        return "/cm?" + urlencode({"cmnd": "Status 10", **login})

    def exchange(self, topic: str, channel: int, reply_to: str) -> Exchange:
        del channel, reply_to
        full = topic if "%prefix%" in topic else f"%prefix%/{topic}"
        asked, answered = (full.replace("%prefix%", prefix) for prefix in ("cmnd", "stat"))
        return Exchange(f"{asked}/Status", "10", (f"{answered}/STATUS10",))

    def read(self, answers: Mapping[str, bytes], channel: int) -> ElectricalReading:
        (body,) = answers.values()
        told = _decoded(body)
        if "WARNING" in told:  # the answer to a wrong password
            raise ValueError(f"the plug refuses: {told['WARNING']}")
        fields = _fields(told, "StatusSNS", "ENERGY")
        has_several = isinstance(fields.get("Power"), list)
        # A value that is not a list is that of the whole plug, also the single counter of several outlets (without
        # SetOption129).
        single = {name: _of_channel(value, channel) for name, value in fields.items() if has_several or not channel}
        is_own = not has_several or isinstance(fields.get("Total"), list)
        joules = _number(single, "Total", unit=_KILOWATT_HOUR) if is_own else None
        power, voltage, current = (_number(single, name) for name in ("Power", "Voltage", "Current"))
        return _required(ElectricalReading(power, voltage, current, joules), told)


def _of_channel(value: Any, channel: int) -> Any:
    """Return the value of one channel; plugs with several send a list, where the channels differ."""
    if not isinstance(value, list):
        return value
    return value[channel] if channel < len(value) else None


class _ShellyFirst:
    """Shelly of the first generation. Source: shelly-api-docs.shelly.cloud/gen1, /status and MQTT support."""

    counter_step = 1.0 * _WATT_MINUTE

    def path(self, channel: int, user: str, password: str | None) -> str:
        del channel, user, password
        return "/status"

    def exchange(self, topic: str, channel: int, reply_to: str) -> Exchange:
        del reply_to
        device = f"shellies/{topic.removeprefix('shellies/')}"
        relay = f"{device}/relay/{channel}"
        return Exchange(f"{device}/command", "update", (f"{relay}/power", f"{relay}/energy"))

    def read(self, answers: Mapping[str, bytes], channel: int) -> ElectricalReading:
        if "" not in answers:
            told = {topic.rpartition("/")[2]: _plain(body) for topic, body in answers.items()}
            return ElectricalReading(power=told["power"], joules=told["energy"] * _WATT_MINUTE)
        status = _decoded(answers[""])
        meters = status.get("emeters") or status.get("meters") or []
        fields = _fields({"meter": _of_channel(meters, channel)}, "meter")
        # Energy meters (EM, 3EM) count watt-hours, plugs watt-minutes.
        unit = _WATT_HOUR if status.get("emeters") else _WATT_MINUTE
        joules = _number(fields, "total", unit=unit)
        power, voltage, current = (_number(fields, name) for name in ("power", "voltage", "current"))
        if fields.get("is_valid") is False:
            raise ValueError("the plug reports that its reading is not valid")
        if joules is None:  # without a counter it measures nothing, like a Shelly 1: the power is a set one
            power = None
        return _required(ElectricalReading(power, voltage, current, joules), meters)


def _plain(body: bytes) -> float:
    with suppress(ValueError):
        if math.isfinite(number := float(body)):
            return number
    raise ValueError(f"the plug sent {body[:40]!r}, which is not a number")


class _ShellyLater:
    """Shelly from the second generation on. Source: shelly-api-docs.shelly.cloud/gen2, Switch, PM1, MQTT channel."""

    counter_step = 0.001 * _WATT_HOUR

    def __init__(self, component: str) -> None:
        self._method = f"{component}.GetStatus"

    def path(self, channel: int, user: str, password: str | None) -> str:
        del user, password
        return f"/rpc/{self._method}?id={channel}"

    def exchange(self, topic: str, channel: int, reply_to: str) -> Exchange:
        request = {"id": 1, "src": reply_to, "method": self._method, "params": {"id": channel}}
        return Exchange(f"{topic}/rpc", json.dumps(request), (f"{reply_to}/rpc",))

    def read(self, answers: Mapping[str, bytes], channel: int) -> ElectricalReading:
        del channel
        (body,) = answers.values()
        told = _decoded(body)
        if "error" in told:
            raise ValueError(f"the plug refuses: {str(told['error'])[:80]}")
        fields = _fields(told, "result") or told
        errors = fields.get("errors")
        for error in errors if isinstance(errors, list) else ():
            if str(error).startswith(_OF_METER):
                raise ValueError(f"the plug reports {error!r} for its power meter")
        joules = _number(_fields(fields, "aenergy"), "total", unit=_WATT_HOUR)
        power, voltage, current = (_number(fields, name) for name in ("apower", "voltage", "current"))
        return _required(ElectricalReading(power, voltage, current, joules), told)


#: The kinds of plug, by the name that a config gives them.
DIALECTS: Mapping[str, PlugDialect] = {
    "tasmota": _Tasmota(),
    "shelly1": _ShellyFirst(),
    "shelly2": _ShellyLater("Switch"),
    "shelly2-pm": _ShellyLater("PM1"),
}
