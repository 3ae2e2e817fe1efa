"""Times as other tools write them: seconds since some start, moments since 1970, dates, times of day."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
import pyarrow as pa

from robot_runner.core.errors import AnalysisError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

__all__ = [
    "DAY",
    "TIME_UNITS",
    "Unit",
    "first_moment",
    "guessed_unit",
    "is_absolute",
    "is_number",
    "known_units",
    "named_time",
    "nanoseconds_of",
    "si_heading",
    "split_heading",
    "unit_of",
    "unit_words",
    "zone_words",
]


# Units as people write them into headings, and what they are in SI.


@dataclass(frozen=True, slots=True)
class Unit:
    """A unit and its way to SI.

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
    factor: float
    offset: float = 0.0

    @property
    def is_si(self) -> bool:
        """Whether values need no conversion."""
        return self.factor == 1.0 and self.offset == 0.0

    def to_si(self, values: Any) -> Any:
        """Return a number, or an array of them, in SI."""
        if self.is_si:
            return values
        parts = round(1 / self.factor)
        # Dividing by a whole number rounds once: 14.849 ms are 0.014849 s, and not 0.014849000000000001 s.
        is_whole_part = self.factor < 1 and math.isclose(parts * self.factor, 1.0, rel_tol=1e-12)
        return (values / parts if is_whole_part else values * self.factor) + self.offset


_PI_DEGREES = 3.141592653589793 / 180

_UNITS = {
    unit.symbol: unit
    for unit in (
        Unit("s", "s", 1.0),
        Unit("ms", "s", 1e-3),
        Unit("us", "s", 1e-6),
        Unit("ns", "s", 1e-9),
        Unit("min", "s", 60.0),
        Unit("h", "s", 3600.0),
        Unit("W", "W", 1.0),
        Unit("kW", "W", 1e3),
        Unit("mW", "W", 1e-3),
        Unit("uW", "W", 1e-6),
        Unit("J", "J", 1.0),
        Unit("kJ", "J", 1e3),
        Unit("mJ", "J", 1e-3),
        Unit("uJ", "J", 1e-6),
        Unit("Wh", "J", 3600.0),
        Unit("mWh", "J", 3.6),
        Unit("kWh", "J", 3.6e6),
        Unit("V", "V", 1.0),
        Unit("mV", "V", 1e-3),
        Unit("uV", "V", 1e-6),
        Unit("A", "A", 1.0),
        Unit("mA", "A", 1e-3),
        Unit("uA", "A", 1e-6),
        Unit("Hz", "Hz", 1.0),
        Unit("kHz", "Hz", 1e3),
        Unit("MHz", "Hz", 1e6),
        Unit("GHz", "Hz", 1e9),
        Unit("B", "B", 1.0),
        Unit("kB", "B", 1e3),
        Unit("KB", "B", 1e3),
        Unit("MB", "B", 1e6),
        Unit("GB", "B", 1e9),
        Unit("KiB", "B", 1024.0),
        Unit("MiB", "B", 1024.0**2),
        Unit("GiB", "B", 1024.0**3),
        Unit("K", "K", 1.0),
        Unit("degC", "K", 1.0, 273.15),
        Unit("m", "m", 1.0),
        Unit("cm", "m", 1e-2),
        Unit("mm", "m", 1e-3),
        Unit("km", "m", 1e3),
        Unit("rad", "rad", 1.0),
        Unit("deg", "rad", _PI_DEGREES),
        Unit("m/s", "m/s", 1.0),
        Unit("rad/s", "rad/s", 1.0),
        Unit("N", "N", 1.0),
        Unit("Pa", "Pa", 1.0),
        Unit("%", "%", 1.0),
        Unit("1", "1", 1.0),
    )
}

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
    # As the headings of Python's programmers have them: without capital letters, but not to be mistaken.
    "j": "J",
    "kj": "kJ",
    "wh": "Wh",
    "kwh": "kWh",
    "hz": "Hz",
    "MHZ": "MHz",
    "kb": "kB",
    "mb": "MB",
    "gb": "GB",
}

#: What a time may be counted in.
TIME_UNITS = ("s", "ms", "us", "ns", "min", "h")

# At the end of a heading: `power_mW`, `Power (mW)`, `power [mW]`.
_BRACKETED = re.compile(r"^(.*?)\s*[\[(]\s*([^\])]+?)\s*[\])]$")
_SUFFIXED = re.compile(r"^(.+?)[_ ](m_s|rad_s|[A-Za-zµμ°%/]+)$")
_SAFE_SUFFIX = {"%": "percent", "m/s": "m_s", "rad/s": "rad_s", "1": ""}


def known_units() -> tuple[str, ...]:
    """Return the symbols of all units that are known."""
    return tuple(_UNITS)


def unit_of(text: str) -> Unit | None:
    """Return the unit that is written so, or None."""
    trimmed = text.strip()
    return _UNITS.get(trimmed) or _UNITS.get(_SPELLINGS.get(trimmed, _SPELLINGS.get(trimmed.casefold(), "")))


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
        # An orientation has a component w.
        unit = _UNITS["W"] if symbol == "w" and "power" in base.casefold() else unit_of(symbol)
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
    suffix = _SAFE_SUFFIX.get(unit.si, unit.si)
    return f"{base}_{suffix}" if suffix else base


_TIME_HEADINGS = (
    "timestamp",
    "time",
    "datetime",
    "date_time",
    "date",
    "t",
    "elapsed",
    "elapsed_time",
    "seconds",
    "clock",
)

#: Numbers as large as these count the seconds (and their fractions) since 1970.
_EPOCHS = (("ns", 1e17), ("us", 1e14), ("ms", 1e11), ("s", 1e8))
_NANOSECONDS = {"s": 10**9, "ms": 10**6, "us": 10**3, "ns": 1, "min": 60 * 10**9, "h": 3600 * 10**9}
_CLOCK = re.compile(r"\d{1,2}:\d\d:\d\d(\.\d+)?")
DAY = 86400 * 10**9


def named_time(headings: Sequence[str]) -> str | None:
    """Return the heading that names the times, whatever the case of its letters, or None."""
    plain = {re.sub(r"[\s-]", "_", split_heading(name)[0].casefold()).strip("_"): name for name in reversed(headings)}
    return next((plain[name] for name in _TIME_HEADINGS if name in plain), None)


def first_moment(table: pa.Table) -> str | None:
    """Return the first column if it holds moments, whatever it is called."""
    return str(table.column_names[0]) if pa.types.is_timestamp(table.column(0).type) else None


def guessed_unit(heading: str, column: pa.ChunkedArray) -> str | None:
    """Return what times are counted in, by their looks; None where they are no times."""
    if pa.types.is_timestamp(column.type):
        return "iso"
    if pa.types.is_time(column.type):
        return "clock"
    if is_number(column.type):
        first = next((value.as_py() for value in column if value.is_valid), None)
        if first is None:
            return None
        epoch = next((unit for unit, least in _EPOCHS if first >= least), None)
        named = split_heading(heading)[1]
        return epoch or (named.symbol if named and named.symbol in TIME_UNITS else "s")
    texts = [value.as_py() for value in column[:20] if value.is_valid]
    if texts and all(isinstance(text, str) and _CLOCK.fullmatch(text.strip()) for text in texts):
        return "clock"
    parsed = pd.to_datetime(pd.Series(texts, dtype="str"), errors="coerce", format="ISO8601")
    return "iso" if len(parsed) and parsed.notna().all() else None


def unit_words(unit: str) -> str:
    """Return a unit of times in words."""
    return {"iso": "dates and times of day", "clock": "times of day"}.get(unit, unit)


def zone_words(column: pa.ChunkedArray) -> str:
    """Return what is taken for granted where moments have no time zone."""
    return ", taken as UTC" if pa.types.is_timestamp(column.type) and column.type.tz is None else ""


def is_absolute(unit: str, column: pa.ChunkedArray) -> bool:
    """Return whether times are moments or times of day, not counted from some start."""
    if unit not in TIME_UNITS:
        return True
    if not is_number(column.type):
        return False
    first = next((value.as_py() for value in column if value.is_valid), 0)
    return bool(first * _NANOSECONDS[unit] >= _EPOCHS[0][1])


def is_number(kind: pa.DataType) -> bool:
    """Return whether a column of this type holds numbers."""
    return bool(pa.types.is_integer(kind) or pa.types.is_floating(kind))


def nanoseconds_of(column: pa.ChunkedArray, unit: str, where: str) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return times as whole nanoseconds, so that nothing is lost to rounding, and which of them are times at all."""
    if unit in TIME_UNITS:
        if not is_number(column.type):
            raise AnalysisError(f"its times are no numbers of {unit}", where=where, fix="Give another time_unit.")
        values = column.to_numpy()
        valid = np.isfinite(values)
        return (np.where(valid, values, 0) * _NANOSECONDS[unit]).round().astype(np.int64), valid
    texts = pd.Series(column.to_pandas())
    try:
        if unit == "clock":
            spans = pd.to_timedelta(texts.astype("str"), errors="coerce").to_numpy("timedelta64[ns]")
            return spans.astype(np.int64), ~np.isnat(spans)
        moments = pd.to_datetime(texts, utc=True, format="ISO8601" if unit == "iso" else unit)
    except ValueError as error:
        fix = "Give another time_unit, or mend the file."
        raise AnalysisError(f"its times cannot be read: {error}", where=where, fix=fix) from error
    stamps = moments.dt.tz_localize(None).to_numpy("datetime64[ns]")
    return stamps.astype(np.int64), ~np.isnat(stamps)
