"""The fields of ROS message types, from any source, and the completion of messages by them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from numbers import Integral, Real
from types import MappingProxyType
from typing import Any

from robot_runner.core.errors import LinkError, did_you_mean
from robot_runner.core.links.commanded_topics import VELOCITIES

#: The least and the greatest value of each kind of whole number. `byte` and `char` are ROS 2's (an octet, a uint8); a
#: shape of ROS 1 has `int8` and `uint8` in place of them, which is their meaning there.
_INTEGERS: Mapping[str, tuple[int, int]] = MappingProxyType(
    {
        "byte": (0, 2**8 - 1),
        "char": (0, 2**8 - 1),
        **{f"int{bits}": (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) for bits in (8, 16, 32, 64)},
        **{f"uint{bits}": (0, 2**bits - 1) for bits in (8, 16, 32, 64)},
    }
)
#: The meaning of these names in ROS 1; in ROS 2 they are an octet and a uint8.
ROS1_KINDS: Mapping[str, str] = MappingProxyType({"byte": "int8", "char": "uint8"})
#: The names of some kinds in the interface definition language of ROS 2.
IDL_KINDS = MappingProxyType({"boolean": "bool", "float": "float32", "double": "float64", "octet": "byte"})
_FLOATS: Mapping[str, float] = MappingProxyType({"float32": 3.4028234663852886e38, "float64": math.inf})
_TEXTS = ("string", "wstring")
#: The least and the greatest seconds: ROS 1 counts times as uint32 and durations as int32.
STAMPS: Mapping[str, tuple[int, int]] = MappingProxyType({"time": _INTEGERS["uint32"], "duration": _INTEGERS["int32"]})
_SECOND_NS = 1_000_000_000
_NANOSECONDS = (0, _SECOND_NS - 1)

_LEFT_OUT = object()

#: Arrays of these are `bytes`.
BYTE_KINDS = frozenset({"byte", "char", "uint8"})


@dataclass(frozen=True, slots=True)
class UpTo:
    """The count of a sequence: any number of elements, or `limit` at most.

    Example:
        >>> UpTo(3).limit, UNBOUNDED.limit
        (3, None)
    """

    limit: int | None = None


#: The count of a sequence of any length.
UNBOUNDED = UpTo()


@dataclass(frozen=True, slots=True)
class Field:
    """One field of a message type.

    Attributes:
        name: of the field.
        kind: `bool`, a kind of number, text or time, or the shape of a message.
        count: None for one value, a number for an array of that many, `UpTo` for a sequence.
        default: its value if left out; None for ROS' own: zero, an empty text, an empty sequence.
        limit: the most characters of a bounded text; None where there is no bound.

    Example:
        >>> Field("covariance", "float64", 36).count
        36
    """

    name: str
    kind: str | Shape
    count: int | UpTo | None = None
    default: Any = None
    limit: int | None = None


@dataclass(frozen=True, slots=True)
class Shape:
    """A message type, or the request or response of a service type.

    Attributes:
        type_name: ROS name without a generation: `geometry_msgs/Vector3`.
        fields: in the order of its definition.

    Example:
        >>> vector = Shape("geometry_msgs/Vector3", tuple(Field(axis, "float64") for axis in "xyz"))
        >>> Shape("geometry_msgs/Twist", (Field("linear", vector), Field("angular", vector))).names
        ('linear', 'angular')
    """

    type_name: str
    fields: tuple[Field, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """The names of its fields."""
        return tuple(field.name for field in self.fields)


#: One type by its md5 sum: rosserial, and so the board of a TurtleBot3 on ROS 1, publishes it by the name before tf2.
_RENAMED: Mapping[str, str] = MappingProxyType({"tf/tfMessage": "tf2_msgs/TFMessage"})


def plain_type(name: str) -> str:
    """Return the name of a type without `/msg/` and the like of ROS 2, and in its present form if it was renamed.

    Example:
        >>> plain_type("geometry_msgs/msg/Twist"), plain_type("std_srvs/Trigger")
        ('geometry_msgs/Twist', 'std_srvs/Trigger')
    """
    parts = name.split("/")
    if len(parts) == 3 and parts[1] in {"msg", "srv", "action"}:  # noqa: PLR2004 - its parts
        name = f"{parts[0]}/{parts[2]}"
    return _RENAMED.get(name, name)


def stamp_of(nanoseconds: int) -> dict[str, int]:
    """Return a time in the form of messages; `nanoseconds_of` is the inverse.

    Example:
        >>> stamp_of(2_000_000_005), nanoseconds_of({"sec": 2, "nanosec": 5})
        ({'sec': 2, 'nanosec': 5}, 2000000005)
    """
    seconds, rest = divmod(nanoseconds, _SECOND_NS)
    return {"sec": seconds, "nanosec": rest}


def nanoseconds_of(stamp: Mapping[str, int]) -> int:
    """Return a time of a message in ns."""
    return stamp["sec"] * _SECOND_NS + stamp["nanosec"]


def completed(shape: Shape, message: Mapping[str, Any], *, where: str) -> dict[str, Any]:
    """Return the message with every field of its type; those that were left out hold their default.

    Numbers become `int` or `float` as the type has them, arrays lists, and arrays of bytes `bytes`. Floats may be
    infinite or not a number, as a laser's ranges are, but not in a velocity command.

    Raises:
        LinkError: a field is not one of the type's, or its value is not of the field's kind or out of its range.

    Example:
        >>> vector = Shape("geometry_msgs/Vector3", tuple(Field(axis, "float64") for axis in "xyz"))
        >>> completed(vector, {"x": 1}, where="goal")
        {'x': 1.0, 'y': 0.0, 'z': 0.0}
        >>> completed(vector, {"X": 1}, where="a")
        Traceback (most recent call last):
            ...
        robot_runner.core.errors.LinkError: a (geometry_msgs/Vector3): the message has no field 'X' → Did you mean 'x'?
    """
    # What a robot does on a command that is not a finite number is undefined.
    only_finite = shape.type_name in VELOCITIES
    try:
        return _message(shape, message, only_finite=only_finite)
    except _MisfitError as misfit:
        problem = misfit.problem(misfit.path)
        raise LinkError(problem, where=f"{where} ({shape.type_name})", fix=misfit.fix) from None


class _MisfitError(Exception):
    """A value that does not fit; its path is built while it propagates, so that valid messages cost nothing."""

    def __init__(self, problem: Callable[[str], str], fix: str) -> None:
        super().__init__()
        self.problem = problem
        self.fix = fix
        self.path = ""

    def within(self, part: str) -> _MisfitError:
        """Put the name of the field or the index of the element before the path."""
        self.path = f"{part}.{self.path}" if self.path and not self.path.startswith("[") else part + self.path
        return self


def _message(shape: Shape, given: object, *, only_finite: bool) -> dict[str, Any]:
    values = _mapping(shape.fields, given)
    made, known = {}, 0
    for field in shape.fields:
        value = values.get(field.name, _LEFT_OUT)
        known += value is not _LEFT_OUT
        try:
            made[field.name] = _field(field, value, only_finite)
        except _MisfitError as misfit:
            raise misfit.within(field.name) from None
    if known != len(values):
        raise _unknown_name(shape.fields, values)
    return made


def _mapping(fields: Sequence[Field], given: object) -> Mapping[str, Any]:
    if not isinstance(given, Mapping):
        names = ", ".join(repr(field.name) for field in fields) or "of the type: none"
        fix = f"Give a mapping with the fields {names}."
        raise _MisfitError(lambda path: f"{path or 'the message'} is {given!r}, which is not a mapping", fix)
    return given


def _unknown_name(fields: Sequence[Field], given: Mapping[str, Any]) -> _MisfitError:
    known = [field.name for field in fields]
    unknown = next(str(name) for name in given if name not in known)
    fix = did_you_mean(unknown, known) or "Send an empty mapping; the type has no fields."
    return _MisfitError(lambda path: f"the message has no field {path!r}", fix).within(unknown)


def _field(field: Field, given: object, only_finite: bool) -> object:
    if given is _LEFT_OUT:
        return _default(field, only_finite)
    if field.count is None:
        return _one(field, given, only_finite)
    return _many(field, field.count, given, only_finite)


def _default(field: Field, only_finite: bool) -> object:
    if field.default is not None:
        return _field(replace(field, default=None), field.default, only_finite)
    if field.count is None:
        return _zero(field.kind)
    count = field.count if isinstance(field.count, int) else 0
    return bytes(count) if field.kind in BYTE_KINDS else [_zero(field.kind) for _ in range(count)]


def _zero(kind: str | Shape) -> object:
    if isinstance(kind, Shape):
        return _message(kind, {}, only_finite=False)
    return {"sec": 0, "nanosec": 0} if kind in STAMPS else _ZEROS[kind]


def _many(field: Field, count: int | UpTo, given: object, only_finite: bool) -> object:
    values = _elements(given)
    if values is None:
        raise _MisfitError(lambda path: f"field {path!r} is {given!r}", "Give a list.")
    _check_length(count, len(values))
    if isinstance(values, bytes):
        if field.kind in BYTE_KINDS:
            return values
        values = list(values)
    if field.kind == "float64" and not only_finite and all(type(value) is float for value in values):
        return list(values)  # most arrays of a robot are such, and long
    elements = []
    for index, value in enumerate(values):
        try:
            elements.append(_one(field, value, only_finite))
        except _MisfitError as misfit:
            raise misfit.within(f"[{index}]") from None
    return bytes(elements) if field.kind in BYTE_KINDS else elements  # type: ignore[arg-type]  # whole numbers


def _check_length(count: int | UpTo, length: int) -> None:
    limit = count.limit if isinstance(count, UpTo) else count
    if limit is not None and (length > limit or (isinstance(count, int) and length < limit)):
        fix = f"Give {limit}." if isinstance(count, int) else f"Give {limit} at most."
        raise _MisfitError(lambda path: f"field {path!r} has {length} elements", fix)


def _one(field: Field, given: object, only_finite: bool) -> object:
    kind = field.kind
    if isinstance(kind, Shape):
        return _message(kind, given, only_finite=only_finite)
    if kind in _FLOATS:
        return _float(kind, given, only_finite)
    if kind in _INTEGERS:
        return _integer(_INTEGERS[kind], given)
    if kind in STAMPS:
        return _stamp(STAMPS[kind], given)
    return _text(field.limit, given) if kind in _TEXTS else _truth(given)


def _float(kind: str, given: object, only_finite: bool) -> float:
    value = given if type(given) is float else _converted(given)
    if not math.isfinite(value):
        if only_finite:
            raise _misfit(value, "Give a finite number.")
    elif abs(value) > _FLOATS[kind]:
        fix = f"Give at most {_FLOATS[kind]:.3g}."
        raise _MisfitError(lambda path: f"field {path!r} is {value!r}, which is not a {kind}", fix)
    return value


def _converted(given: object) -> float:
    if isinstance(given, Real) and not isinstance(given, bool):
        try:
            return float(given)
        except OverflowError:
            pass
    raise _misfit(given, "Give a finite number.")


def _integer(bounds: tuple[int, int], given: object) -> int:
    least, greatest = bounds
    if isinstance(given, Integral) and not isinstance(given, bool) and least <= (value := int(given)) <= greatest:
        return value
    raise _misfit(given, f"Give a whole number from {least} to {greatest}.")


def _stamp(seconds: tuple[int, int], given: object) -> dict[str, int]:
    values = _mapping(_STAMP_FIELDS, given)
    made = {}
    for name, bounds in (("sec", seconds), ("nanosec", _NANOSECONDS)):
        try:
            made[name] = _integer(bounds, values.get(name, 0))
        except _MisfitError as misfit:
            raise misfit.within(name) from None
    if not values.keys() <= made.keys():
        raise _unknown_name(_STAMP_FIELDS, values)
    return made


def _text(limit: int | None, given: object) -> str:
    if not isinstance(given, str):
        raise _misfit(given, "Give a text.")
    try:
        given.isascii() or given.encode()
    except UnicodeEncodeError as error:  # as in a file's name that is not UTF-8
        problem = f"no encoding has the character {given[error.start]!r}"
        raise _MisfitError(lambda path: f"field {path!r}: {problem}", "Give a text that can be encoded.") from None
    if limit is not None and len(given) > limit:
        raise _MisfitError(lambda path: f"field {path!r} has {len(given)} characters", f"Give {limit} at most.")
    return given


def _truth(given: object) -> bool:
    if isinstance(given, bool) or type(given).__name__ in {"bool", "bool_"}:  # numpy has its own, by either name
        return bool(given)
    raise _misfit(given, "Give True or False.")


def _misfit(given: object, fix: str) -> _MisfitError:
    return _MisfitError(lambda path: f"field {path!r} is {given!r}", fix)


def _elements(given: object) -> Sequence[object] | None:
    """Return the elements of an array, list or tuple, or None for anything else; bytes stay bytes."""
    if isinstance(given, bytes | bytearray | memoryview):
        return bytes(given)
    tolist = getattr(given, "tolist", None)  # of arrays: numpy's and the standard library's
    values = tolist() if callable(tolist) else given
    return values if isinstance(values, Sequence) and not isinstance(values, str) else None


_STAMP_FIELDS = (Field("sec", "int32"), Field("nanosec", "uint32"))
_ZEROS: Mapping[str, object] = MappingProxyType(
    {"bool": False, **dict.fromkeys(_INTEGERS, 0), **dict.fromkeys(_FLOATS, 0.0), **dict.fromkeys(_TEXTS, "")}
)
