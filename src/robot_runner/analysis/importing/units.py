"""Numbers and units as people write them: decimal commas, grouped thousands, units (by pint) in cells and headings."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

from robot_runner.core.storage.cells import number_of

#: The units of times.
TIME_UNITS = ("s", "ms", "us", "ns", "min", "h")

#: The units that are recognised in the last word of a heading; other words only look like units (`mem_avg`, `run_d`,
#: `cpu_min`). In brackets, or from the user, any unit of pint is accepted.
_IN_NAMES = (
    "s", "ms", "us", "ns", "h", "W", "kW", "mW", "uW", "J", "kJ", "MJ", "mJ", "uJ", "Wh", "mWh", "kWh", "V", "mV",
    "uV", "A", "mA", "uA", "mAh", "Hz", "kHz", "MHz", "GHz", "B", "kB", "KB", "MB", "GB", "KiB", "MiB", "GiB", "K",
    "degC", "m", "cm", "mm", "km", "rad", "deg", "m/s", "rad/s", "N", "Pa", "kg", "g", "rpm", "rps", "fps", "%",
    "1",
)  # fmt: skip
#: The unit for each kind of quantity: the SI unit; percentages and bytes are not converted.
_SI = ("s", "W", "J", "V", "A", "Hz", "B", "B/s", "K", "m", "rad", "rad/s", "N", "Pa", "kg", "C", "ohm", "%", "1")
#: Products with a name of their own. N*m and J/m are not replaced: one may be a torque, the other is not a force.
_NAMED = {"W*s": "J", "J/s": "W", "A*V": "W", "V*A": "W"}

#: What these units divide, where they stand behind it in a heading: `MB_s`, `Wh_km`, `J_kg`; other single letters may
#: be names.
_DIVISORS = frozenset(("s", "h", "m", "km", "kg", "W", "J", "Wh", "kWh"))
_DIVIDED = frozenset({"J"} | {each for each in _IN_NAMES if len(each) > 1 and each != "min"})

_SPELLINGS = {
    "%": "percent pct percentage",
    "us": "µs μs",
    "s": "sec secs second seconds",
    "ms": "msec millisec millis millisecond milliseconds",
    "ns": "nanosecond nanoseconds",
    "min": "mins minute minutes",
    "h": "hr hrs hour hours",
    "degC": "°c ℃ celsius",
    "m/s": "m_s",
    "rad/s": "rad_s",
    "W": "watt watts",
    "V": "volt volts",
    "B": "byte bytes",
    # Python programmers write headings in lower case; these are unambiguous nevertheless.
    "J": "joule joules j",
    **{each: each.lower() for each in ("kJ", "Wh", "kWh", "Hz", "kHz", "MHz", "GHz")},
    **{each: each.lower() for each in ("kB", "MB", "GB", "KiB", "MiB", "GiB")},
}
_SPELT = {spelling: symbol for symbol, all_of in _SPELLINGS.items() for spelling in all_of.split()}
#: Words for counted things: `ops/sec` is a number per second.
_COUNTED = re.compile(
    r"\b(ops?|operations?|req|requests?|frames?|packets?|messages?|msgs?|samples?|tokens?|counts?|cycles?|points?|pts)\b"
)
#: Words that pint reads as pints, atomic masses, surveyors' links or the speed of light, and headings do not.
_MEANT_OTHERWISE = (
    "a.u. n/a unit units pt pp pi pc eu db link links hand hands rod rods chain chains pole poles pin pins cup cups "
    "shot shots dot dots bag bags stone slug"
)
_WORD = re.compile(r"[A-Za-zµμ°Ω%℃]+")
#: Pint's spelling of units that are written otherwise here, and of the signs of multiplication and powers.
_IN_PINT = {"KB": "kB", "1": "", "rps": "count/s", "fps": "count/s", "qps": "count/s", "px": "pixel"}
#: Torques without a multiplication sign, which pint reads as the fineness of yarn.
_IN_PINT |= {f"{prefix}Nm": f"({prefix}N*m)" for prefix in ("", "m", "k")}
_POWER = re.compile(r"\^|\*\*")
#: The power of a unit. Python would compute that of another, as in `s^9^9^9`, for years.
_PLAIN_POWER = re.compile(rf"(?:{_POWER.pattern})\s*\(?-?\d(?:[./]\d)?\)?(?!\s*(?:{_POWER.pattern})|[\w.])")
_SIGNS = str.maketrans({"⋅": "*", "·": "*", "²": "^2", "³": "^3", "μ": "µ"})
#: Single letters that are units in headings; others that pint knows (`C`, `G`, `b`) too often mean something else.
_LETTERS = frozenset("sWJVAKmNhBgΩ%1")
_MAY_BE_A_UNIT = re.compile(r"[A-Za-zµμ°Ω%℃1][A-Za-zµμ°Ω%\d/*^ ().⋅·²³_-]{0,23}")

_BRACKETED = re.compile(r"\s*[\[(]\s*([^\s\])\[(](?:[^\])\[(]*?[^\s\])\[(])?)\s*[\])]")
_SUFFIXED = re.compile(
    r"(?P<base>.+?)[_ .](?P<unit>(?:m_s|rad_s|[A-Za-zµμ°%/]+)(?:_per_[A-Za-z]+)?)"
    r"(?P<rest>[_ ](?:avg|mean|median|max|sd|std|rss|total))?",
    re.IGNORECASE,
)
#: What multiplies the unit behind it, as in `[1/10 C]` and `(x1000 J)`: the numbers are not in that unit.
_SCALE = re.compile(r"[x×*]?\d.*", re.IGNORECASE)  # noqa: RUF001 - people write either
_SPREAD = re.compile(r"(^|[_ ])(var|variance|cv)($|[_ ])", re.IGNORECASE)
_ACCELERATION = re.compile(r"acc(el|[^a-z]|$)|gravity", re.IGNORECASE)
_TIMES = re.compile(r"time|duration|elapsed|latency|delay|period|interval|\bt$", re.IGNORECASE)
_TORQUE = re.compile(r"torque|moment|stiffness", re.IGNORECASE)
#: `attempt_C` and `template_C` are no temperatures.
_TEMPERATURE = re.compile(r"(?i:temp)(?![lot])")
#: Words for differences and spreads: a rise by 5 degC is none by 278.15 K.
_DIFFERENCE = re.compile(
    r"(?<![A-Z])(?:(?<![a-z])|(?=[A-Z]))(?i:std|stdev|stddev|sd|se|sem|rmse|mae|err(or)?|iqr|range|spread|delta|"
    r"diff(erence)?|rise|drop|increase|decrease|change|drift)(?![a-z])|[\u0394\u2206]"
)
_SUFFIXES = {"%": "percent", "m/s": "m_s", "rad/s": "rad_s", "1": ""}


@dataclass(frozen=True, slots=True)
class Unit:
    """A unit and its conversion to SI.

    Attributes:
        symbol: as it was written.
        si: the symbol of the SI unit (`%` and `B` are not converted).
        factor: multiplies a value to convert it to SI.
        offset: is added afterwards.

    Example:
        >>> unit_of("mW").factor, unit_of("kJ/km").si
        (0.001, 'J/m')
    """

    symbol: str
    si: str
    factor: float = 1.0
    offset: float = 0.0

    def to_si(self, values: Any) -> Any:
        """Return a number, or an array, in SI."""
        if self.factor == 1.0 and self.offset == 0.0:
            return values
        parts = round(1 / self.factor)
        # Dividing by a whole number rounds only once: 14.849 ms are 0.014849 s, not 0.014849000000000001 s.
        is_whole_part = self.factor < 1 and math.isclose(parts * self.factor, 1.0, rel_tol=1e-12)
        return (values / parts if is_whole_part else values * self.factor) + self.offset


def known_units() -> tuple[str, ...]:
    """Return the symbols of the units that are recognised at the end of a heading."""
    return _IN_NAMES


def unit_of(text: str) -> Unit | None:
    """Parse a unit; None if it is not known."""
    symbol = _symbol(text.strip())
    return _unit(symbol) if symbol in _IN_NAMES or (_MAY_BE_A_UNIT.fullmatch(symbol) and _is_clear(symbol)) else None


def _symbol(text: str) -> str:
    return text if text in _IN_NAMES else _SPELT.get(text.casefold(), text)


def _is_clear(symbol: str) -> bool:
    words = {symbol.casefold(), *_WORD.findall(symbol.casefold())}
    return (len(symbol) > 1 or symbol in _LETTERS) and words.isdisjoint(_MEANT_OTHERWISE.split())


@cache
def _unit(symbol: str) -> Unit | None:
    if symbol in _SI:
        return Unit(symbol, symbol)
    written = _WORD.sub(lambda found: _IN_PINT.get(_symbol(found[0]), _symbol(found[0])), _COUNTED.sub("count", symbol))
    written = written.translate(_SIGNS)
    if len(_POWER.findall(written)) != len(_PLAIN_POWER.findall(written)):
        return None
    try:
        parsed = dict(_registry().parse_units(written)._units)  # noqa: SLF001 - the only way to the parts
        parts = [(_part(name), power) for name, power in parsed.items()]
        factor = math.prod(part.factor**power for part, power in parts)
    except Exception:  # noqa: BLE001 - pint raises many kinds of errors for texts that are not units
        return None
    offset = sum(part.offset for part, _ in parts)
    if not parts or not factor or any(name.startswith("decibel") for name in parsed) or (offset and len(parts) > 1):
        return None
    above = "*".join(_raised(part.si, power) for part, power in parts if power > 0) or "1"
    below = "".join(f"/{_raised(part.si, -power)}" for part, power in parts if power < 0)
    si = _NAMED.get(above + below, above + below)
    return Unit(symbol, si, factor, offset)


@cache
def _part(name: str) -> Unit:
    """Return a single unit of pint, converted to ours for its kind of quantity."""
    registry = _registry()
    if name == "percent":
        return Unit("%", "%")
    root = registry.get_root_units(name)[1]
    si = _of_roots().get(root, f"{root:~}".replace(" ", ""))
    offset = registry.convert(0.0, name, root if si not in _SI else _IN_PINT.get(si, si))
    return Unit(name, si, registry.convert(1.0, name, root if si not in _SI else _IN_PINT.get(si, si)) - offset, offset)


@cache
def _of_roots() -> dict[Any, str]:
    registry = _registry()
    roots = {registry.get_root_units(_IN_PINT.get(si, si))[1]: si for si in _SI if si not in {"%", "1"}}
    return {**roots, registry.Unit("count"): "1", registry.Unit(""): "1"}


def _raised(symbol: str, power: float) -> str:
    return symbol if power == 1 else f"{symbol}^{power:g}"


@cache
def _registry() -> Any:
    from pint import UnitRegistry  # noqa: PLC0415 - takes half a second, with its definitions

    return UnitRegistry()


def split_heading(heading: str) -> tuple[str, Unit | None]:
    """Split a heading into name and unit; the name is the whole heading where there is no unit.

    Example:
        >>> split_heading("power_mW")[0], split_heading("PACKAGE_ENERGY (J)")[1].si, split_heading("cpu_util")
        ('power', 'J', ('cpu_util', None))
    """
    name = heading.strip()
    if _SPREAD.search(name):  # a variance has the squared unit, a coefficient of variation has none
        return name, None
    for found in reversed([*_BRACKETED.finditer(name)]):
        # Of `[avg %]` the last word is the unit; `Core(s)` is a plural.
        base = (name[: found.start()] + name[found.end() :]).strip()
        *before, last = found[1].split()
        unit = _unit_in(base, found[1]) or (None if before and _SCALE.fullmatch(before[-1]) else _unit_in(base, last))
        is_plural = found[0] == "(s)" and not _TIMES.search(base)
        if base and unit is not None and not is_plural:
            return (name, None) if _is_of_differences(name, unit) else (base, unit)
    if suffixed := _SUFFIXED.fullmatch(name):
        base, written = suffixed["base"], suffixed["unit"].replace("_per_", "/")
        is_known = all(_symbol(part) in {*_IN_NAMES, "w"} for part in written.split("/"))
        is_known |= written == "C" and bool(_TEMPERATURE.search(base))
        unit = _unit_in(base, written) if is_known and not _divides(base, _symbol(written)) else None
        if unit is not None and not _is_of_differences(name, unit):
            return base + (suffixed["rest"] or ""), unit
    # A heading that is only a unit has to be a word: `Joules`, `Watts`.
    return name, unit_of(name) if name.casefold() in _SPELT and len(name) > len("Hour") else None


def _divides(base: str, unit: str) -> bool:
    """Return whether a unit is a part of another, as in `throughput_MB_s`, `use_J_km`, `tokens_s` and `torque_N_m`."""
    *before, last = re.split("[_ .]", base)
    if last == "N" and unit in {"m", "cm", "mm"}:  # the N of a position is North
        return bool(_TORQUE.search(base))
    if last == "per" or unit not in _DIVISORS:
        return last == "per"
    # A time is in seconds also behind another unit, and what stands behind a number is a condition: `at_500_rpm_W`.
    if _TIMES.search(base) if unit in TIME_UNITS else (before and before[-1].isdigit()):
        return False
    if last in {"W", "A"}:
        return unit == "h"
    is_counted = unit in TIME_UNITS and (_COUNTED.fullmatch(last.casefold()) or last.casefold() in {"byte", "bytes"})
    return bool(is_counted) or (_symbol(last) in _DIVIDED and last != "j")


def _is_of_differences(name: str, unit: Unit) -> bool:
    """Return whether numbers may be differences or spreads, which a unit with an offset would turn into others."""
    return bool(unit.offset and _DIFFERENCE.search(name))


def _unit_in(base: str, written: str) -> Unit | None:
    """Return the unit in a heading, also for ambiguous letters: degrees or coulombs, minutes or metres."""
    # `w` is watts only in the name of a power: orientations also have a component w.
    if written == "w" and "power" in base.casefold():
        return unit_of("W")
    if written == "C" and _TEMPERATURE.search(base):
        return unit_of("degC")
    # `power_min` is a minimum, not minutes; the g of an acceleration is that of the Earth, not grams.
    if (written == "min" and not _TIMES.search(base)) or (written == "g" and _ACCELERATION.search(base)):
        return None
    return None if written == "m" and _TIMES.search(base) else unit_of(written)


def si_heading(heading: str, unit: Unit | None) -> str:
    """Return the heading of a column for values in SI.

    Example:
        >>> si_heading("power_mW", unit_of("mW")), si_heading("Watts", unit_of("W"))
        ('power_W', 'Watts_W')
    """
    if unit is None:
        return heading.strip()
    suffix = _SUFFIXES.get(unit.si, unit.si.replace("/", "_per_").replace("*", "_"))
    base = split_heading(heading)[0]
    return f"{base}_{suffix}" if suffix else base


#: What stands for a missing value among numbers, in small letters.
MISSING = frozenset(
    {"", "na", "n/a", "#n/a", "<na>", "nan", "none", "null", "-", "–", "—"}  # noqa: RUF001 - spreadsheets write dashes
)

#: Styles of numbers that are not plain: the separator of thousands, the decimal sign, and both in words.
_STYLES = (
    ("", ",", "decimal commas"),
    (",", ".", "commas between thousands"),
    (".", ",", "points between thousands"),
    ("[ \u00a0\u202f]", "[.,]", "blanks between thousands"),
    ("['\u2019]", ".", "apostrophes between thousands"),
)
_WITH_COMMAS = frozenset(words for _, decimal, words in _STYLES if decimal == ",")
_NUMBER = re.compile(r"[+-]?\d[\d., \u00a0\u202f'\u2019]*(?:[eE][+-]?\d+)?")
_WITH_UNIT = re.compile(r"([+-]?\d[\d.,]*(?:[eE][+-]?\d+)?)\s*([^\d\s.,].{0,11})")


@dataclass(frozen=True, slots=True)
class PlainCells:
    """The cells of a column in plain notation.

    Attributes:
        cells: the column.
        unit: the unit behind each number, or None.
        words: the original notation in words; empty where nothing was changed.
        doubt: other possible readings, as of `1,234`; empty where the numbers are clear.
    """

    cells: Sequence[str]
    unit: Unit | None = None
    words: str = ""
    doubt: str = ""

    @property
    def has_decimal_commas(self) -> bool:
        """Whether numbers certainly have decimal commas."""
        return not self.doubt and any(each in _WITH_COMMAS for each in self.words.split(", "))


def plain_cells(cells: Sequence[str], *, decimal: str | None, has_decimal_commas: bool) -> PlainCells:
    """Return a column with its numbers in plain notation; words are unchanged, and columns that have mostly words.

    Args:
        cells: the column.
        decimal: the decimal sign, if the user gave it.
        has_decimal_commas: whether other numbers of the file have decimal commas.

    Example:
        >>> plain_cells(["1,5", "2,25", "nan"], decimal=None, has_decimal_commas=False).cells
        ['1.5', '2.25', 'nan']
    """
    filled = _mostly_numbers({cell for cell in set(cells) if cell.casefold() not in MISSING})
    numbers = {cell: cell for cell in filled}
    unit = None
    suffixed = {cell: found for cell in filled if (found := _WITH_UNIT.fullmatch(cell))}
    if filled and len(suffixed) == len(filled):
        suffixes = {found[2].strip() for found in suffixed.values()}
        unit = unit_of(suffixes.pop()) if len(suffixes) == 1 else None
        if unit is not None:
            numbers = {cell: found[1] for cell, found in suffixed.items()}
    readings = _readings(numbers.values(), has_decimal_commas or decimal == ",")
    if decimal is not None and len(readings) > 1:
        readings = [each for each in readings if (each[0] in _WITH_COMMAS) == (decimal == ",")] or readings
    if not readings or (unit is None and readings[0][1] == numbers):
        return PlainCells(cells)
    words, plain = readings[0]
    unclear = min((each for each in plain if len({number_of(of[each]) for _, of in readings}) > 1), default="")
    doubt = f"{unclear} may be {' or '.join(of[unclear] for _, of in readings)}" if unclear else ""
    written = {cell: plain[number] for cell, number in numbers.items()}
    said = ", ".join(filter(None, (words, f"the unit {unit.symbol} behind each" if unit else "")))
    return PlainCells([written.get(cell, cell) for cell in cells], unit, said, doubt)


def _mostly_numbers(filled: Collection[str]) -> Collection[str]:
    """Return the numbers, or numbers with units, of a column that has a few words beside them; else all cells."""
    for kind in (_NUMBER, _WITH_UNIT):
        found = [cell for cell in filled if kind.fullmatch(cell)]
        if 2 * len(found) > len(filled):
            return found
    return filled


def _readings(numbers: Collection[str], has_decimal_commas: bool) -> list[tuple[str, dict[str, str]]]:
    """Return the possible readings of all numbers, the likeliest first: the style in words, and the plain numbers."""
    if all(number_of(number) is not None for number in numbers):
        if not has_decimal_commas or not any("." in number for number in numbers):
            return [("", {number: number for number in numbers})] if numbers else []
        found = [_read(numbers, *_STYLES[2]), ("", {number: number for number in numbers})]
    else:
        found = [_read(numbers, *style) for style in _STYLES]
    different: list[tuple[str, dict[str, str]]] = []
    for each in found:
        if each is not None and all(_differ(each[1], other[1]) for other in different):
            different.append(each)
    return different


def _read(numbers: Collection[str], group: str, decimal: str, words: str) -> tuple[str, dict[str, str]] | None:
    groups = rf"[1-9]\d{{0,2}}(?:{re.escape(group) if len(group) == 1 else group}\d{{3}})+|"  # 0,125 is not a thousand
    whole = rf"{groups if group else ''}\d+"
    sign = decimal if decimal.startswith("[") else re.escape(decimal)
    pattern = re.compile(rf"([+-]?(?:{whole}))(?:{sign}(\d+))?([eE][+-]?\d+)?")
    plain = {}
    for number in numbers:
        found = pattern.fullmatch(number)
        if found is None:
            return None
        digits = re.sub(r"[^\d+-]", "", found[1])
        plain[number] = f"{digits}{'.' if found[2] else ''}{found[2] or ''}{found[3] or ''}"
    return words, plain


def _differ(first: dict[str, str], second: dict[str, str]) -> bool:
    return any(number_of(first[number]) != number_of(second[number]) for number in first)
