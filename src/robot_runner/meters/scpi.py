"""The profiler of laboratory instruments with SCPI: power supplies, multimeters and power analysers."""

from __future__ import annotations

import importlib.util
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from importlib import import_module
from typing import Any, ClassVar

from robot_runner.core.errors import Finding, PluginError, did_you_mean
from robot_runner.core.events.context import RobotRunnerContext
from robot_runner.core.plugin import Circumstances
from robot_runner.measuring.measured_machine import simulation_findings
from robot_runner.measuring.parameter_checks import check_list, check_numbers
from robot_runner.meters.electrical import ElectricalProfiler
from robot_runner.meters.electrical_readings import ElectricalReading
from robot_runner.meters.polled import trial_findings

_INSTALL = "Install it: pip install 'robot-runner[scpi]'."
_ENERGY_UNITS = {"J": 1.0, "Wh": 3600.0, "kWh": 3.6e6}
_UNITS = {"power": "W", "voltage": "V", "current": "A"}
#: A number, perhaps with an exponent, the word behind it, and further values behind a separator.
_ANSWER = re.compile(
    r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(E[-+]?\d+)?)\s*([a-zµ]*)(?:\s+[a-z]+)?[\s\0]*(?:[,;].*)?", re.IGNORECASE | re.DOTALL
)
#: A unit with its prefix, such as `mA`, `kWh`, `VDC`, `Amps`.
_WORD = re.compile(r"([munkµ]?)(Wh|VAR|VA|W|V|Ah|A|J)(?:(?<=W)atts?|(?<=V)olts?|(?<=A)mps?)?(?:[AD]C)?", re.IGNORECASE)
#: The status of a reading that a Keithley 2001 or 2002 writes between exponent and unit: normal, overflow, relative.
_STATUS = re.compile(r"([NOR])([VA][AD]C)")
#: Two whole numbers with a comma between them may be one number.
_COMMA = re.compile(r"\s*[-+]?\d+,\d+\s*[a-zA-Z]*\s*")
_PREFIXES = {"": 1.0, "m": 1e-3, "u": 1e-6, "µ": 1e-6, "n": 1e-9, "k": 1e3}
#: The values for overload and for no number. Source: SCPI-99, volume 1, section 7.2.1.4: 9.9E37 and 9.91E37.
_NO_NUMBER = 9.9e37
_LONGEST_QUEUE = 50
#: How many characters of an answer a message shows.
_SHOWN = 40
#: How long to wait for unrequested data, ms; the shortest timeout of VISA.
_AT_ONCE = 1
#: Fixes for an instrument that cannot be opened, by a part of PyVISA's message.
_REFUSED = "Undefined header"
_REMEDIES = (
    (_REFUSED, "Look the command up in the instrument's programming manual."),
    (
        "VI_ERROR_RSRC_NFOUND",
        "Check whether it is switched on and its address is right: `pyvisa-shell` lists what is there.",
    ),
    ("VI_ERROR_TMO", "Look at its terminator (terminator=...), and whether its remote interface is on."),
    (
        "VI_ERROR_INV_RSRC_NAME",
        "Name it as VISA does: 'TCPIP::192.168.0.5::5025::SOCKET' or 'ASRL/dev/ttyUSB0::INSTR'.",
    ),
    ("ermission", "Give yourself the right to open its device (group dialout, or a rule of udev)."),
)
_FIX_SURPLUS = "Use its port for programs instead of that for people (5025, not 5024), and switch its echo off."
_REMEDY = "Check whether it is switched on, its address, and whether its remote interface is on."


class OverloadError(ValueError):
    """A complete answer without a value."""


class SurplusError(ValueError):
    """Unrequested data came: from then on, each answer would be taken for that to the next query."""

    def __init__(self, surplus: str) -> None:
        super().__init__(f"the instrument sends what it was not asked for, such as {surplus.strip()[:_SHOWN]!r}")


def parse_number(answer: str, unit: str = "") -> float:
    """Return the number at the beginning of an instrument's answer; further numbers may follow.

    Args:
        answer: with a unit behind the number, or without.
        unit: of the result: `W`, `V`, `A`, or that of an energy; empty for that of the answer, without prefix.

    Example:
        >>> parse_number("+1.25000E+01,V"), parse_number("150mA")
        (12.5, 0.15)

    Raises:
        ValueError: there is no number, it means an overload, or it has the unit of another quantity.
    """
    said, match = f"the instrument answered {answer.strip()[:_SHOWN]!r}", _ANSWER.fullmatch(answer)
    if _COMMA.fullmatch(answer):
        raise ValueError(f"{said}, with a comma: a decimal comma, or a second number that the query has to leave out")
    if match is None:
        raise ValueError(f"{said}, which is not a number")
    number, exponent, word = float(match[1]), match[2], match[3]
    status = _STATUS.fullmatch(word) if exponent else None
    if not math.isfinite(number) or abs(number) >= _NO_NUMBER or (status and status[1] == "O"):
        raise OverloadError(f"{said}: an overload, or no value")
    told = _WORD.fullmatch(status[2] if status else word)
    if not word:
        return number
    if told is None:
        raise ValueError(f"{said}, which is not a number of {unit or 'a known unit'}")
    wanted = _WORD.fullmatch(unit or told[2])
    if wanted is None or told[2].lower() != wanted[2].lower():
        raise ValueError(f"{said}, which is not {unit}")
    return number * _PREFIXES[told[1].lower()] / _PREFIXES[wanted[1].lower()]


class _Instrument:
    """An opened instrument.

    After a failure it is opened again, so that a late or unrequested answer is not taken for that to the next query.

    Raises:
        PluginError: the library is not installed, or the instrument does not answer as it should.
    """

    _resource: Any = None

    def __init__(self, plugin: Scpi) -> None:
        self._plugin = plugin
        try:
            self._prepare()
        except PluginError:
            self.close()
            raise
        except SurplusError as error:
            self.close()
            raise PluginError(str(error), where=plugin.name, fix=_FIX_SURPLUS) from error
        except Exception as error:  # each backend of PyVISA has its own errors
            self.close()
            raise self._error(f"{plugin.resource} does not answer: {_said(error)}", str(error)) from error

    def read(self) -> tuple[ElectricalReading, ...]:
        if self._resource is None:
            self._open()
        try:
            told = {quantity: self._told(quantity, query) for quantity, query in self._plugin.queries.items()}
        except OverloadError:
            raise
        except Exception:
            self.close()
            raise
        if "power" not in told and {"voltage", "current"} <= told.keys():
            told["power"] = told["voltage"] * told["current"]
        if "joules" in told:
            told["joules"] *= _ENERGY_UNITS[self._plugin.energy_unit]
        return (ElectricalReading(**told),)

    def close(self) -> None:
        resource, self._resource = self._resource, None
        if resource is not None:
            with suppress(Exception):  # an error of the backend costs nothing here
                resource.close()

    def _told(self, quantity: str, query: str) -> float:
        return parse_number(self._asked(query), _UNITS.get(quantity, self._plugin.energy_unit))

    def _asked(self, query: str) -> str:
        self._refuse_surplus()
        answer: str = self._resource.query(query)
        return answer

    def _prepare(self) -> None:
        """Open the instrument, set it up, and try each query.

        Its identity is queried before and after: a greeting or an echo is noticed, as it comes instead, early or late.

        Raises:
            PluginError: the instrument refuses its setup, or does not understand a query.
            SurplusError: the instrument sends unrequested data.
        """
        self._open()
        self.identity = self._resource.query("*IDN?").strip()
        if self._resource.query("*IDN?").strip() != self.identity:
            raise SurplusError(self.identity)
        for _ in range(_LONGEST_QUEUE):
            if not self._complaint():  # about earlier commands of others
                break
        for command in self._plugin.setup:
            self._resource.write(command)
        complaint = self._complaint() if self._plugin.setup else ""
        if complaint:
            raise self._error(f"the instrument refuses its setup: {complaint}", _REFUSED)
        for quantity, query in self._plugin.queries.items():
            self._try(quantity, query)
        said = self._resource.query("*IDN?").strip()
        if said != self.identity:
            raise SurplusError(said)

    def _refuse_surplus(self) -> None:
        """Raise a `SurplusError` if the instrument has sent unrequested data."""
        resource, visa = self._resource, import_module("pyvisa")
        if resource.resource_class != "SOCKET" and resource.interface_type != visa.constants.InterfaceType.asrl:
            return  # other interfaces keep answers apart
        patience, resource.timeout = resource.timeout, _AT_ONCE
        surplus, end = b"", (self._plugin.terminator or "\n").encode()
        try:
            while end not in surplus and len(surplus) < _SHOWN:
                surplus += resource.read_bytes(1)  # not a line: a part of one that is just arriving would be missed
        except visa.VisaIOError as error:
            if error.error_code != visa.constants.StatusCode.error_timeout:
                raise
        finally:
            resource.timeout = patience
        if surplus.strip() or end in surplus:  # not blanks alone, with which some end their answers
            raise SurplusError(surplus.decode("ascii", "replace"))

    def _open(self) -> None:
        plugin, milliseconds = self._plugin, round(self._plugin.timeout_s * 1000)
        manager = import_module("pyvisa").ResourceManager(plugin.backend)
        self._resource = manager.open_resource(plugin.resource, open_timeout=milliseconds)
        self._resource.timeout = milliseconds
        self._resource.read_termination = self._resource.write_termination = plugin.terminator

    def _try(self, quantity: str, query: str) -> None:
        try:
            self._told(quantity, query)
        except SurplusError:
            raise
        except Exception as error:
            self.close()
            complaint = ""
            with suppress(Exception):  # an error in its queue says more than a missing answer
                self._open()
                complaint = self._complaint()
            self.close()
            problem = f"the instrument does not understand {query!r}: {complaint or _said(error)}"
            is_refused = complaint or isinstance(error, ValueError)
            raise self._error(problem, _REFUSED if is_refused else str(error)) from error

    def _complaint(self) -> str:
        """Return the first entry of the instrument's error queue; empty if there is no entry, or no queue."""
        try:
            said = str(self._resource.query("SYST:ERR?")).strip()
        except Exception:  # noqa: BLE001 - no queue; opened again, so that a late answer is not taken for the next one
            self.close()
            self._open()
            return ""
        match = re.match(r"[-+]?\d+", said)
        return said if match and int(match[0]) else ""

    def _error(self, problem: str, said: str) -> PluginError:
        fix = next((fix for sign, fix in _REMEDIES if sign in said), _REMEDY)
        return PluginError(problem, where=self._plugin.name, fix=fix)


def _said(error: Exception) -> str:
    return f"{type(error).__name__}: {error}".splitlines()[0]


class Scpi(ElectricalProfiler):
    """Measures with a laboratory instrument that speaks SCPI: a supply, a multimeter or a power analyser, over PyVISA.

    Power is the answer to the query `power`, else voltage times current.

    Args:
        resource: its VISA address, such as `TCPIP::192.168.0.5::5025::SOCKET`.
        name: distinguishes several instances; None for the class's name.
        power: the query for power, W; None where there is none.
        voltage: the query for voltage, V; None leaves it out.
        current: the query for current, A; None leaves it out.
        energy: the query for an energy counter; None where there is none.
        energy_unit: of that counter: `J`, `Wh` or `kWh`.
        setup: commands to send before the measurement, such as `["SENS:CURR:RANG 3"]`.
        rate_hz: readings a second, Hz; a supply takes 20 to 100 ms for each query.
        timeout_s: how long to wait for an answer, s.
        terminator: of lines in both directions.
        backend: of PyVISA: `@py` needs no maker's library; empty for an installed one (NI, Keysight).

    Raises:
        PluginError: there is no query, the energy's unit is unknown, or the rate or the timeout is not positive.

    Example:
        >>> Scpi("TCPIP::192.168.0.5::5025::SOCKET", power="MEAS:POW? (@1)").measures[0].unit
        'J'
    """

    needs: ClassVar[str] = (
        "An instrument that speaks SCPI over a network, USB or a serial line, and robot-runner[scpi]."
    )
    bytes_per_run: int = 20_000  # 5 readings a second of 40 bytes for a mission of 95 s

    def __init__(  # noqa: PLR0913 - keywords of a user's config
        self,
        resource: str,
        *,
        name: str | None = None,
        power: str | None = None,
        voltage: str | None = "MEAS:VOLT?",
        current: str | None = "MEAS:CURR?",
        energy: str | None = None,
        energy_unit: str = "Wh",
        setup: Sequence[str] = (),
        rate_hz: float = 5.0,
        timeout_s: float = 2.0,
        terminator: str = "\n",
        backend: str = "@py",
    ) -> None:
        super().__init__(name=name, rate_hz=rate_hz)
        queries = {"power": power, "voltage": voltage, "current": current, "joules": energy}
        self.queries = {quantity: query for quantity, query in queries.items() if query is not None}
        if not self.queries:
            raise PluginError("there is nothing to ask", where=self.name, fix="Give a query: voltage='MEAS:VOLT?'.")
        if energy_unit not in _ENERGY_UNITS:
            fix = did_you_mean(energy_unit, _ENERGY_UNITS)
            raise PluginError(f"energy_unit is {energy_unit!r}", where=self.name, fix=fix)
        check_numbers(self.name, timeout_s=timeout_s)
        check_list(self.name, setup=setup)
        self.resource = resource
        self.energy_unit = energy_unit
        self.setup = tuple(setup)
        self.timeout_s = timeout_s
        self.terminator = terminator
        self.backend = backend
        self._identity = ""

    def claims(self, robot: str | None) -> Iterable[str]:
        """Return a claim of the instrument."""
        del robot
        return (f"device:{self.resource}",)

    def check(self, circumstances: Circumstances) -> Iterable[Finding]:
        """Return errors: no library, no instrument, or a query that it does not understand."""
        libraries = ("pyvisa", "pyvisa_py") if self.backend.endswith("@py") else ("pyvisa",)
        missing = [each for each in libraries if importlib.util.find_spec(each) is None]
        if missing:
            problem = f"{' and '.join(missing)} cannot be imported"
            return [Finding.error(f"plugin {self.name}", problem, _INSTALL)]
        return trial_findings(self, lambda: _Instrument(self)) or simulation_findings(self.name, circumstances.robot)

    def open(self, context: RobotRunnerContext) -> _Instrument:
        """Return the instrument; a `PluginError` says that its answers are not as expected."""
        del context
        instrument = _Instrument(self)
        self._identity = instrument.identity
        return instrument

    def details(self) -> Mapping[str, Any]:
        """Return the instrument's identity, and the queries."""
        return {**super().details(), "identity": self._identity, "queries": self.queries}
