"""Times as other tools write them: seconds since some start, moments since 1970, dates, times of day."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
import pyarrow as pa

from robot_runner.analysis.importing.units import TIME_UNITS, split_heading
from robot_runner.errors import AnalysisError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

__all__ = [
    "DAY",
    "first_moment",
    "guessed_unit",
    "is_absolute",
    "is_number",
    "named_time",
    "nanoseconds_of",
    "unit_words",
    "zone_words",
]

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
