"""Units as people write them into headings, and their conversion to SI by pint."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from functools import cache
from typing import Any

__all__ = ["TIME_UNITS", "Unit", "known_units", "si_heading", "split_heading", "unit_of"]

#: The SI units that values are converted to, each with all its spellings by the rules of pint. Other units of pint are
#: not recognised: the last word of a heading often reads like one (`mem_avg`, `run_d`).
_SYMBOLS = {
    "s": "s ms us ns min h",
    "W": "W kW mW uW",
    "J": "J kJ mJ uJ Wh mWh kWh",
    "V": "V mV uV",
    "A": "A mA uA",
    "Hz": "Hz kHz MHz GHz",
    "B": "B kB KB MB GB KiB MiB GiB",
    "K": "K degC",
    "m": "m cm mm km",
    "rad": "rad deg",
    **{symbol: symbol for symbol in ("m/s", "rad/s", "N", "Pa", "%", "1")},
}
_SI_OF = {symbol: si for si, symbols in _SYMBOLS.items() for symbol in symbols.split()}
_NAME_IN_PINT = {"KB": "kB"}

#: What a time may be counted in.
TIME_UNITS = tuple(_SYMBOLS["s"].split())

_SPELLINGS = {
    "percent": "%",
    "pct": "%",
    "µs": "us",
    "μs": "us",
    "sec": "s",
    "seconds": "s",
    "msec": "ms",
    "°C": "degC",
    "celsius": "degC",
    "m_s": "m/s",
    "rad_s": "rad/s",
    "joules": "J",
    "watts": "W",
    "bytes": "B",
    "MHZ": "MHz",
    # Python programmers write headings without capital letters; these are unambiguous all the same.
    **{symbol.lower(): symbol for symbol in ("J", "kJ", "Wh", "kWh", "Hz", "kB", "MB", "GB")},
}

# At the end of a heading: `power_mW`, `Power (mW)`, `power [mW]`.
_BRACKETED = re.compile(r"^(.*?)\s*[\[(]\s*([^\])]+?)\s*[\])]$")
_SUFFIXED = re.compile(r"^(.+?)[_ ](m_s|rad_s|[A-Za-zµμ°%/]+)$")
_SUFFIXES = {"%": "percent", "m/s": "m_s", "rad/s": "rad_s", "1": ""}


@dataclass(frozen=True, slots=True)
class Unit:
    """A unit and its conversion to SI.

    Attributes:
        symbol: as it was written.
        si: the SI symbol (`%` and `B` stand for themselves).
        factor: multiplies a value to bring it to SI.
        offset: added afterwards.

    Example:
        >>> unit_of("mW").factor
        0.001
    """

    symbol: str
    si: str
    factor: float = 1.0
    offset: float = 0.0

    def to_si(self, values: Any) -> Any:
        """Return a number, or an array of them, in SI."""
        if self.symbol == self.si:
            return values
        parts = round(1 / self.factor)
        # Dividing by a whole number rounds once: 14.849 ms are 0.014849 s, and not 0.014849000000000001 s.
        is_whole_part = self.factor < 1 and math.isclose(parts * self.factor, 1.0, rel_tol=1e-12)
        return (values / parts if is_whole_part else values * self.factor) + self.offset


def known_units() -> tuple[str, ...]:
    """Return the symbols of all units that are recognised."""
    return tuple(_SI_OF)


def unit_of(text: str) -> Unit | None:
    """Return the unit that is written like this, or None."""
    trimmed = text.strip()
    symbol = trimmed if trimmed in _SI_OF else _SPELLINGS.get(trimmed, _SPELLINGS.get(trimmed.casefold(), ""))
    return _unit(symbol) if symbol else None


@cache
def _unit(symbol: str) -> Unit:
    si = _SI_OF[symbol]
    if symbol == si:
        return Unit(symbol, si)
    registry = _registry()
    name = _NAME_IN_PINT.get(symbol, symbol)
    offset = registry.convert(0.0, name, si)
    return Unit(symbol, si, registry.convert(1.0, name, si) - offset, offset)


@cache
def _registry() -> Any:
    from pint import UnitRegistry  # noqa: PLC0415 - takes half a second, with its definitions

    return UnitRegistry()


def split_heading(heading: str) -> tuple[str, Unit | None]:
    """Return a heading without its unit, and the unit; the whole heading where it names none.

    Example:
        >>> split_heading("power_mW")[0], split_heading("PACKAGE_ENERGY (J)")[1].si, split_heading("cpu_util")
        ('power', 'J', ('cpu_util', None))
    """
    for pattern in (_BRACKETED, _SUFFIXED):
        found = pattern.match(heading.strip())
        if found is None:
            continue
        base, symbol = found[1].strip(), found[2]
        # `w` is watts in the name of a power only: an orientation, too, has a component w.
        unit = unit_of("W" if symbol == "w" and "power" in base.casefold() else symbol)
        if base and unit is not None:
            return base, unit
    return heading.strip(), None


def si_heading(heading: str, unit: Unit | None) -> str:
    """Return the heading of a column once its values are in SI.

    Example:
        >>> si_heading("power_mW", unit_of("mW")), si_heading("Watts", unit_of("W"))
        ('power_W', 'Watts_W')
    """
    if unit is None:
        return heading.strip()
    base, named = split_heading(heading)
    if named is None:
        base = heading.strip()
    suffix = _SUFFIXES.get(unit.si, unit.si)
    return f"{base}_{suffix}" if suffix else base
