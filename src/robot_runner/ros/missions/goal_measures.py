"""Measures that are fields of an action's result, or statistics of fields of its feedback."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import nullcontext, suppress
from dataclasses import dataclass
from operator import itemgetter
from statistics import fmean
from types import MappingProxyType
from typing import Any

from robot_runner.core.errors import LinkError, PluginError, did_you_mean
from robot_runner.core.events.measure import Measure, MeasureValue
from robot_runner.core.links.graph_names import field_of, is_time
from robot_runner.core.links.robot import Message

_PREFIX = "result."
_PAIR = 2
_COUNT = "count"
#: The functions that reduce the values of a feedback field to one.
_OVER: Mapping[str, Callable[[Sequence[Any]], Any]] = MappingProxyType(
    {"first": itemgetter(0), "last": itemgetter(-1), "minimum": min, "maximum": max, "mean": fmean}
)
#: Those that need numbers.
_OF_NUMBERS = frozenset({"minimum", "maximum", "mean"})


@dataclass(frozen=True, slots=True)
class _Taken:
    """One measure and its source."""

    measure: Measure
    over: str
    field: str


class ResultMeasures:
    """Measures that are fields of a result; raises a `PluginError` if a field's name is not valid.

    Example:
        >>> ResultMeasures({"ErrorCode": "error_code"}, where="Arm").values({"error_code": 0})
        {'ErrorCode': 0}
    """

    def __init__(self, wanted: Mapping[str | Measure, str] | None, *, where: str) -> None:
        self._where = where
        self._taken = []
        for name, field in _checked(wanted, "result", "{'ErrorCode': 'error_code'}", where):
            if not isinstance(field, str) or not field.strip():
                fix = "Name it with dots: {'ErrorCode': 'error_code'}."
                raise PluginError(f"result[{str(name)!r}] is {field!r}, which is not a field", where=where, fix=fix)
            plain = field.strip().removeprefix(_PREFIX)
            self._taken.append(_Taken(_as_measure(name, f"Field {plain!r} of the action's result."), "", plain))
        self.measures = [each.measure for each in self._taken]

    def values(self, result: Message | None, *, is_reached: bool = True) -> dict[str, MeasureValue]:
        """Return the value of each measure; None where there is no result, or that of a goal that failed lacks it.

        Raises:
            LinkError: the result of a goal that was reached lacks a field.
        """
        values: dict[str, MeasureValue] = dict.fromkeys((each.measure.name for each in self._taken), None)
        if result is None:
            return values
        for each in self._taken:
            # A server that gives up leaves its lists empty: a study of failures must not lose these runs.
            with nullcontext() if is_reached else suppress(LinkError):
                values[each.measure.name] = _value_of(result, each.field, self._where)
        return values


class FeedbackMeasures:
    """Measures of the feedback of one goal; raises a `PluginError` if one of them is not valid.

    What is wanted is `"count"`, the number of feedback messages, or a function and a field, as in the example. The
    functions are `first`, `last`, `minimum`, `maximum` and `mean`; the latter three leave out NaN and infinite values.

    Example:
        >>> feedback = FeedbackMeasures({"Recoveries": ("last", "number_of_recoveries")}, where="Navigation")
        >>> feedback.take({"number_of_recoveries": 2})
        >>> feedback.values()
        {'Recoveries': 2}
    """

    def __init__(self, wanted: Mapping[str | Measure, Any] | None, *, where: str) -> None:
        self._where = where
        self._taken = [
            _feedback(name, how, where)
            for name, how in _checked(wanted, "feedback", "{'Recoveries': ('last', 'number_of_recoveries')}", where)
        ]
        self.measures = [each.measure for each in self._taken]
        self.begin()

    def begin(self) -> None:
        """Discard the feedback from before; `count` is how many messages came since."""
        self.count = 0
        self._came: dict[str, list[Any]] = {each.measure.name: [] for each in self._taken}

    def take(self, message: Message) -> None:
        """Take one feedback message."""
        self.count += 1
        for each in self._taken:
            if each.over != _COUNT:
                self._keep(each, self._came[each.measure.name], _value_of(message, each.field, self._where))

    def values(self) -> dict[str, MeasureValue]:
        """Return the value of each measure; None where no feedback came."""
        return {each.measure.name: self._value(each) for each in self._taken}

    def _keep(self, each: _Taken, came: list[Any], value: MeasureValue) -> None:
        if each.over in _OF_NUMBERS and value is None:  # NaN or infinite: not known yet
            return
        if each.over in _OF_NUMBERS and not isinstance(value, bool | int | float):
            problem = f"the field {each.field!r} of the feedback is {value!r}, which has no {each.over}"
            raise LinkError(problem, where=self._where, fix="Ask for its first or its last value.")
        if each.over == "last":
            came[:] = [value]
        elif each.over != "first" or not came:
            came.append(value)

    def _value(self, each: _Taken) -> MeasureValue:
        if each.over == _COUNT:
            return self.count
        came = self._came[each.measure.name]
        value: MeasureValue = _OVER[each.over](came) if came else None
        return value


def _feedback(name: str | Measure, how: Any, where: str) -> _Taken:
    if how == _COUNT:
        return _Taken(_as_measure(name, "How often feedback came.", unit="1"), _COUNT, "")
    if not isinstance(how, Sequence) or isinstance(how, str) or len(how) != _PAIR or not isinstance(how[1], str):
        fix = "Say 'count', or how and which field: ('last', 'number_of_recoveries')."
        raise PluginError(f"feedback[{str(name)!r}] is {how!r}", where=where, fix=fix)
    over, field = how
    if over not in _OVER:
        fix = did_you_mean(str(over), _OVER) or f"Say one of {', '.join(_OVER)}."
        raise PluginError(f"feedback[{str(name)!r}] asks for {over!r} of {field!r}", where=where, fix=fix)
    described = f"{str(over).capitalize()} value of field {field!r} of the action's feedback."
    return _Taken(_as_measure(name, described), over, field.removeprefix("feedback."))


def _checked(
    wanted: Mapping[str | Measure, Any] | None, parameter: str, example: str, where: str
) -> Iterator[tuple[str | Measure, Any]]:
    if wanted is not None and not isinstance(wanted, Mapping):
        fix = f"Give a mapping from measure to field: {example}."
        raise PluginError(f"{parameter} is {wanted!r}", where=where, fix=fix)
    yield from (wanted or {}).items()


def _as_measure(name: str | Measure, description: str, unit: str = "") -> Measure:
    return name if isinstance(name, Measure) else Measure(name, unit, description)


def _value_of(message: Message, field: str, where: str) -> MeasureValue:
    """Return a field as a value of the run table: times in s, and None for a number that is not finite.

    A `LinkError` says that there is no such field, or that it is neither a number nor a text.
    """
    found = field_of(message, field, where=where)
    if is_time(found):
        return float(found["sec"]) + float(found["nanosec"]) * 1e-9
    if isinstance(found, bool | int | str):
        return found
    if isinstance(found, float):
        return found if math.isfinite(found) else None
    problem = f"the field {field!r} is neither a number nor a text, but {type(found).__name__}"
    raise LinkError(problem, where=where, fix="Name a field of it, with a dot, or an element by its number.")
