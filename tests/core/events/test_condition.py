"""A condition is awaited on the run's clock, and what was seen is recorded."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import pytest

from robot_runner import Condition, ConditionError, ConditionTimeout, Look
from robot_runner.core.errors import PluginError
from robot_runner.testing import FakeClock, make_context

if TYPE_CHECKING:
    from collections.abc import Callable
    from contextlib import ExitStack
    from pathlib import Path

    from robot_runner import RobotRunnerContext


class _After(Condition):
    """Holds from some moment of the run's clock on."""

    def __init__(self, seconds: float, closed: list[str]) -> None:
        self.seconds = seconds
        self.closed = closed

    def __str__(self) -> str:
        return f"{self.seconds:g} s are over"

    def watch(self, context: RobotRunnerContext, opened: ExitStack) -> Callable[[], Look]:
        opened.callback(self.closed.append, "closed")
        return lambda: Look(context.clock.now() >= self.seconds, f"{context.clock.now():.1f} s", context.clock.now())


def test_a_condition_is_awaited_on_the_clock_of_the_run_and_what_it_opened_is_closed(tmp_path: Path) -> None:
    clock = FakeClock()
    closed: list[str] = []
    condition = _After(clock.now() + 3.0, closed)

    look = condition.wait(make_context(tmp_path, clock=clock, robot=None), timeout_s=10.0)

    assert look.value == pytest.approx(condition.seconds, abs=0.06)
    assert closed == ["closed"]


def test_a_condition_that_does_not_hold_in_time_says_what_was_awaited_and_seen(tmp_path: Path) -> None:
    clock = FakeClock()
    closed: list[str] = []
    condition = _After(clock.now() + 30.0, closed)

    with pytest.raises(ConditionError, match=r"after 2 s it still did not hold that .* s are over: \d+\.\d s"):
        condition.wait(make_context(tmp_path, clock=clock, robot=None), timeout_s=2.0)

    assert closed == ["closed"]


class _NanosecondClock(FakeClock):
    """Counts whole nanoseconds, as the clock of the simulation does."""

    def sleep(self, seconds: float) -> None:
        super().sleep(round(seconds * 1e9) / 1e9)


@pytest.mark.timeout(20)
@pytest.mark.parametrize("kind", [FakeClock, _NanosecondClock])
@pytest.mark.parametrize(("start", "timeout_s"), [(2.0, 0.3), (0.3, 2.0), (100.0, 0.1)])
def test_a_wait_is_over_where_what_is_left_is_less_than_the_clock_can_show(
    tmp_path: Path, kind: type[FakeClock], start: float, timeout_s: float
) -> None:
    context = make_context(tmp_path, clock=kind(start), robot=None)
    with pytest.raises(ConditionTimeout):
        _After(1e9, []).wait(context, timeout_s=timeout_s)


@pytest.mark.parametrize("timeout_s", [float("nan"), None, "5"])
def test_a_time_that_is_none_is_refused_as_it_would_never_be_over(tmp_path: Path, timeout_s: Any) -> None:
    with pytest.raises(ConditionError, match="timeout_s is "):
        _After(30.0, []).wait(make_context(tmp_path, clock=FakeClock(), robot=None), timeout_s=timeout_s)


class _Flag:
    """Is true, and no bool: as a comparison of numpy's is."""

    def __bool__(self) -> bool:
        return True


def test_what_a_look_shows_is_kept_as_a_journal_can_be_read(tmp_path: Path) -> None:
    look = Look(_Flag(), 52.5)  # type: ignore[arg-type] # as conditions of users do
    assert (look.holds, look.seen, Look(False, None).seen) == (True, "52.5", "")  # type: ignore[arg-type]


def test_facts_of_a_clock_that_could_not_be_read_again_are_refused_where_they_are_told(tmp_path: Path) -> None:
    context = make_context(tmp_path, robot=None)
    before = {"wall_offset": 1.5, "round_trip": 0.25}
    facts = {"host": "pi", "before": before, "after": None, "uncertainty": 0.125, "drift": None}
    context.note_clock(facts)
    with pytest.raises(PluginError, match="these are not facts of a clock: host is None, not a text"):
        context.note_clock({**facts, "host": None})
    with pytest.raises(PluginError, match="wall_offset is nan, not a finite number; after is missing"):
        context.note_clock({"host": "pi", "before": before | {"wall_offset": math.nan}, "uncertainty": 1, "drift": 0})
