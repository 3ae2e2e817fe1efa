"""The values that a parameter of a node may have: nine kinds, and their messages in ROS 2."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import IntEnum
from numbers import Integral, Real
from typing import Any, TypeAlias

from robot_runner.core.errors import LinkError

#: The value of a parameter; None for one that is declared and has no value yet.
ParameterValue: TypeAlias = bool | int | float | str | bytes | list[bool] | list[int] | list[float] | list[str] | None

_INT64 = range(-(2**63), 2**63)
_ARRAY = "Give one of True or False, a whole number, a number, a text, bytes, or a list of one of these kinds."


class ParameterKind(IntEnum):
    """The kinds of rcl_interfaces/ParameterType."""

    NOT_SET = 0
    BOOL = 1
    INTEGER = 2
    DOUBLE = 3
    STRING = 4
    BYTE_ARRAY = 5
    BOOL_ARRAY = 6
    INTEGER_ARRAY = 7
    DOUBLE_ARRAY = 8
    STRING_ARRAY = 9

    @property
    def words(self) -> str:
        """Its name for people."""
        return self.name.lower().replace("_", " ")


#: The field of rcl_interfaces/ParameterValue that holds each kind.
_FIELDS: Mapping[int, str] = {
    kind: f"{kind.name.lower()}_value" for kind in ParameterKind if kind is not ParameterKind.NOT_SET
}
_SCALARS: dict[type, ParameterKind] = {
    bool: ParameterKind.BOOL,
    int: ParameterKind.INTEGER,
    float: ParameterKind.DOUBLE,
    str: ParameterKind.STRING,
    bytes: ParameterKind.BYTE_ARRAY,
}
_ARRAYS: dict[ParameterKind, ParameterKind] = {
    kind: ParameterKind[f"{kind.name}_ARRAY"] for kind in _SCALARS.values() if kind is not ParameterKind.BYTE_ARRAY
}


@dataclass(frozen=True, slots=True)
class ParameterDescription:
    """The description that a node gives of one of its parameters.

    Attributes:
        name: of the parameter.
        kind: of its values.
        is_read_only: whether it can be set only when the node is started.
        may_change_kind: whether it takes values of any kind.
        limits: the least and the greatest value of a number; None where the node names none.
        text: the description by the node's author.
    """

    name: str
    kind: ParameterKind
    is_read_only: bool = False
    may_change_kind: bool = False
    limits: tuple[float, float] | None = None
    text: str = ""


def normal(value: Any, *, where: str) -> ParameterValue:
    """Return a value in a type that parameters have: numbers of NumPy, tuples and byte arrays are converted.

    Raises:
        LinkError: no parameter can have this value.

    Example:
        >>> normal((1, 2.5), where="gains")
        [1.0, 2.5]
    """
    if isinstance(value, bytes | bytearray):
        return bytes(value)
    if isinstance(value, list | tuple):
        array: ParameterValue = _array([_scalar(each, where) for each in value], value, where)
        return array
    scalar: ParameterValue = _scalar(value, where)
    return scalar


def kind_of(value: ParameterValue) -> ParameterKind:
    """Return the kind of a value that is `normal`; an empty list counts as one of texts.

    Example:
        >>> kind_of([0.5, 1.0]).words
        'double array'
    """
    if value is None:
        return ParameterKind.NOT_SET
    if isinstance(value, list):
        return _ARRAYS[_SCALARS[type(value[0])]] if value else ParameterKind.STRING_ARRAY
    return _SCALARS[type(value)]


def fitted(value: Any, kind: ParameterKind, *, where: str) -> ParameterValue:
    """Convert a value to this kind where nothing is lost: a whole number may stand for a double.

    Raises:
        LinkError: it is of another kind.

    Example:
        >>> fitted(1, ParameterKind.DOUBLE, where="speed"), fitted((), ParameterKind.BOOL_ARRAY, where="flags")
        (1.0, [])
    """
    given = normal(value, where=where)
    found = kind_of(given)
    if found is kind or (given == [] and kind > ParameterKind.BYTE_ARRAY):
        return given
    if kind is ParameterKind.DOUBLE and isinstance(given, int) and not isinstance(given, bool):
        return float(given)
    if kind is ParameterKind.DOUBLE_ARRAY and found is ParameterKind.INTEGER_ARRAY and isinstance(given, list):
        return [float(each) for each in given]
    problem = f"the parameter is of the kind {kind.words}, and {value!r} is of the kind {found.words}"
    raise LinkError(problem, where=where, fix=f"Give a value of the kind {kind.words}{_instead(given, kind)}.")


def same_value(one: ParameterValue, other: ParameterValue) -> bool:
    """Return whether two values are equal; a whole number may equal a double, and NaN equals NaN.

    Example:
        >>> same_value(1, 1.0), same_value([0.5], [0.5]), same_value(True, 1)
        (True, True, False)
    """
    if isinstance(one, list) and isinstance(other, list):
        pairs: list[tuple[Any, Any]] = list(zip(one, other, strict=False))
        return len(one) == len(other) and all(same_value(*pair) for pair in pairs)
    if isinstance(one, float) and isinstance(other, float) and math.isnan(one):
        return math.isnan(other)
    return one == other and isinstance(one, bool) == isinstance(other, bool)


def as_wire(value: ParameterValue, kind: ParameterKind | None = None) -> dict[str, Any]:
    """Return a value as a rcl_interfaces/ParameterValue; `kind` is needed for an empty list."""
    kind = kind_of(value) if kind is None or value is None else kind
    return {"type": int(kind)} if value is None else {"type": int(kind), _FIELDS[kind]: value}


def from_wire(message: Mapping[str, Any]) -> ParameterValue:
    """Return the value of a rcl_interfaces/ParameterValue.

    Example:
        >>> from_wire({"type": 3, "double_value": 0.5})
        0.5
    """
    kind = ParameterKind(message["type"])
    if kind is ParameterKind.NOT_SET:
        return None
    value: ParameterValue = message[_FIELDS[kind]]
    return value


def to_json(value: ParameterValue) -> Any:
    """Return a value in a form that JSON can hold, from which `from_json` restores it.

    Example:
        >>> to_json(b"ab"), to_json([0.5]), to_json(float("inf"))
        ({'bytes': '6162'}, [0.5], {'float': 'inf'})
    """
    if isinstance(value, bytes):
        return {"bytes": value.hex()}
    if isinstance(value, float) and not math.isfinite(value):
        return {"float": repr(value)}
    return [to_json(each) for each in value] if isinstance(value, list) else value


def from_json(stored: Any) -> ParameterValue:
    """Return the value that `to_json` stored; raises a ValueError, TypeError or KeyError for anything else."""
    if isinstance(stored, dict):
        return bytes.fromhex(stored["bytes"]) if "bytes" in stored else float(stored["float"])
    if isinstance(stored, list):
        array: ParameterValue = _array([from_json(each) for each in stored], stored, "stored")
        return array
    if stored is None or isinstance(stored, bool | int | float | str):
        return stored
    raise ValueError(json.dumps(stored))


def _scalar(value: Any, where: str) -> Any:
    if isinstance(value, bool | str):
        return value
    if type(value).__name__ in {"bool", "bool_"}:  # NumPy's, by either name
        return bool(value)
    if isinstance(value, Integral):
        if int(value) not in _INT64:
            raise LinkError(f"{value!r} does not fit 64 bits", where=where, fix="Give a smaller number.")
        return int(value)
    if isinstance(value, Real):
        return float(value)
    raise LinkError(f"no parameter can have the value {value!r}", where=where, fix=_ARRAY)


def _array(values: Iterable[Any], given: Any, where: str) -> Any:
    values = list(values)
    kinds = {type(each) for each in values}
    if kinds == {int, float}:
        return [float(each) for each in values]
    if len(kinds) > 1 or kinds - set(_SCALARS) or kinds == {bytes}:
        raise LinkError(f"the values of {given!r} are not of one kind", where=where, fix=_ARRAY)
    return values


def _instead(value: ParameterValue, kind: ParameterKind) -> str:
    if kind is ParameterKind.INTEGER and isinstance(value, float) and value.is_integer():
        return f": {int(value)}"
    if kind is ParameterKind.STRING and value is not None:
        return f": {str(value)!r}"
    return ""
