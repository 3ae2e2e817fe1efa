"""Gates and guards of a config: conditions awaited before each run, and watched during it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

from robot_runner.core.design.numeric_range import is_number
from robot_runner.core.errors import ConditionError, did_you_mean
from robot_runner.core.events.condition import Condition


class GatePolicy(Enum):
    """The consequence of a gate whose condition did not hold in time.

    STOP: the experiment stops; the run is still to do, and the same command goes on with it.
    WAIT: the gate is awaited all the same, and a warning says that it takes long.
    DOUBT: the run is executed, and all of its values are doubtful.
    FAIL: the attempt fails without having been executed.
    """

    STOP = "stop"
    WAIT = "wait"
    DOUBT = "doubt"
    FAIL = "fail"


class GuardAction(Enum):
    """The consequence of a guard whose condition comes true while a run is measured.

    MARK: the run goes on, and all of its values are doubtful.
    REPEAT: the attempt fails at once while `attempts` leaves another one; the last attempt is marked instead.
    STOP: the attempt fails at once, and the experiment stops after it.
    """

    MARK = "mark"
    REPEAT = "repeat"
    STOP = "stop"


@dataclass(frozen=True, slots=True)
class Gate:
    """A condition that is awaited before each attempt at a run, after the operator's steps.

    Attributes:
        condition: what must hold.
        timeout_s: how long it is awaited, s of its clock; None for as long as it takes.
        on_timeout: what follows where it did not hold in time.

    Raises:
        ConditionError: an attribute is of the wrong type or out of range.

    Example:
        >>> from robot_runner import temperature_below
        >>> Gate(temperature_below(50), timeout_s=900).on_timeout
        <GatePolicy.STOP: 'stop'>
    """

    condition: Condition
    timeout_s: float | None = 600.0
    on_timeout: GatePolicy = GatePolicy.STOP

    def __post_init__(self) -> None:
        _check_condition(self.condition, "Gate")
        _check_choice(self.on_timeout, GatePolicy, "Gate(on_timeout=...)")
        timeout = self.timeout_s
        if timeout is not None and not (is_number(timeout) and timeout > 0):
            fix = "Give timeout_s a number of seconds above 0, or None for as long as it takes."
            raise ConditionError(f"timeout_s is {timeout!r}", where=f"Gate({self.condition})", fix=fix)

    @property
    def patience_s(self) -> float:
        """How long it is awaited at most, s; infinite where there is no end to it."""
        return math.inf if self.timeout_s is None or self.on_timeout is GatePolicy.WAIT else self.timeout_s


@dataclass(frozen=True, slots=True)
class Guard:
    """A condition that must not come true while a run is measured.

    Attributes:
        condition: what must not hold, such as `battery_below(15)`.
        action: what follows where it does.

    Raises:
        ConditionError: an attribute is of the wrong type.

    Example:
        >>> from robot_runner import GuardAction
        >>> from robot_runner import battery_below
        >>> Guard(battery_below(15), GuardAction.STOP).action
        <GuardAction.STOP: 'stop'>
    """

    condition: Condition
    action: GuardAction = GuardAction.MARK

    def __post_init__(self) -> None:
        _check_condition(self.condition, "Guard")
        _check_choice(self.action, GuardAction, "Guard(action=...)")


def _check_condition(given: object, what: str) -> None:
    if not isinstance(given, Condition):
        fix = f"Give a condition, such as {what}(temperature_below(50))."
        raise ConditionError(f"{given!r} is not a condition", where=what, fix=fix)


def _check_choice(given: object, choices: type[Enum], what: str) -> None:
    if not isinstance(given, choices):
        known = [f"{choices.__name__}.{choice.name}" for choice in choices]
        raise ConditionError(f"{given!r} is not a {choices.__name__}", where=what, fix=did_you_mean(str(given), known))
