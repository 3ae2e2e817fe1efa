"""Conditions are combined, must hold for a while, and are awaited on the clock that they go by."""

from __future__ import annotations

import time
from contextlib import ExitStack
from typing import TYPE_CHECKING

import pytest

from robot_runner import (
    Condition,
    ConditionError,
    Look,
    all_of,
    any_of,
    battery_above,
    battery_below,
    load_above,
    load_below,
    measure_above,
    message_on,
    not_,
    temperature_above,
    temperature_below,
    text_in,
    topic_above,
    topic_below,
)
from robot_runner.testing import FakeClock, make_context

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from robot_runner import RobotRunnerContext


class Between(Condition):
    """Holds between two moments of the run's clock."""

    def __init__(self, start: float, end: float = 1e9, every_s: float = 0.05) -> None:
        self.start, self.end, self.every_s = start, end, every_s
        self.looks: list[float] = []

    def __str__(self) -> str:
        return f"it is between {self.start:g} and {self.end:g} s"

    def watch(self, context: RobotRunnerContext, opened: ExitStack) -> Callable[[], Look]:
        del opened

        def look() -> Look:
            self.looks.append(now := context.clock.now())
            return Look(self.start <= now < self.end, f"{now:.2f} s", now)

        return look


def waited(folder: Path, condition: Condition, timeout_s: float = 20.0) -> float:
    """Return when a condition held, s of the run's clock."""
    clock = FakeClock()
    condition.wait(make_context(folder, clock=clock, robot=None), timeout_s=timeout_s)
    return clock.now()


def test_all_of_holds_when_the_last_one_does_and_any_of_when_the_first_one_does(tmp_path: Path) -> None:
    assert waited(tmp_path, all_of(Between(1.0), Between(3.0))) == pytest.approx(3.0, abs=0.06)
    assert waited(tmp_path, any_of(Between(1.0), Between(3.0))) == pytest.approx(1.0, abs=0.06)
    assert waited(tmp_path, not_(Between(0.0, 2.0))) == pytest.approx(2.0, abs=0.06)


@pytest.mark.parametrize(
    ("condition", "holds", "is_known"),
    [
        (not_(measure_above("Power", 5)), False, False),
        (all_of(measure_above("Power", 5), Between(0.0)), False, False),
        (all_of(measure_above("Power", 5), not_(Between(0.0))), False, True),
        (any_of(measure_above("Power", 5), Between(0.0)), True, True),
        (any_of(measure_above("Power", 5), not_(Between(0.0))), False, False),
        (not_(not_(measure_above("Power", 5))).held_for(1.0), False, False),
    ],
)
def test_of_what_is_not_known_neither_a_condition_nor_its_opposite_holds(
    tmp_path: Path, condition: Condition, holds: bool, is_known: bool
) -> None:
    with ExitStack() as opened:
        look = condition.watch(make_context(tmp_path, clock=FakeClock(), robot=None), opened)()
    assert (look.holds, look.is_known) == (holds, is_known)


def test_held_for_begins_anew_whenever_it_does_not_hold(tmp_path: Path) -> None:
    flickering = any_of(Between(1.0, 2.0), Between(4.0))
    assert waited(tmp_path, flickering.held_for(3.0)) == pytest.approx(7.0, abs=0.11)


def test_each_part_is_looked_at_as_often_as_it_asks_for(tmp_path: Path) -> None:
    seldom, often = Between(2.0, every_s=1.0), Between(2.0, every_s=0.1)
    waited(tmp_path, all_of(seldom, often))
    assert len(seldom.looks) == 3
    assert len(often.looks) > 15


def test_what_was_seen_of_each_part_is_told(tmp_path: Path) -> None:
    with pytest.raises(ConditionError, match=r"it is between 5 and 1e\+09 s and .*: 0\.\d+ s; 0\.\d+ s"):
        waited(tmp_path, all_of(Between(5.0), Between(6.0)), timeout_s=0.5)


def test_what_is_outside_a_simulation_is_awaited_in_real_time(tmp_path: Path) -> None:
    clock = FakeClock()
    context = make_context(tmp_path, clock=clock, robot=None)
    began = time.monotonic()
    with pytest.raises(ConditionError, match=r"there\.txt cannot be read: No such file"):
        text_in(tmp_path / "there.txt", "ready").wait(context, timeout_s=0.3)
    assert time.monotonic() - began >= 0.3
    assert clock.now() == 0.0


def test_what_is_inside_and_outside_lets_both_times_go_by(tmp_path: Path) -> None:
    (tmp_path / "there.txt").write_text("ready")
    clock = FakeClock()
    context = make_context(tmp_path, clock=clock, robot=None)
    began = time.monotonic()
    all_of(text_in(tmp_path / "there.txt", "ready"), Between(0.3)).wait(context, timeout_s=5.0)
    assert time.monotonic() - began >= 0.3
    assert clock.now() == pytest.approx(0.3, abs=0.06)


@pytest.mark.parametrize(
    ("condition", "problem"),
    [
        (all_of(temperature_below(40), temperature_above(50)), "never are both true"),
        (all_of(load_above(90).held_for(5), all_of(load_below(80), load_above(10)).held_for(1)), "never are both true"),
        (battery_above(100), "is never above 100 %"),
        (load_below(0).held_for(3), "is never below 0 %"),
        (temperature_below(-100), "is never below -100 °C"),
        (topic_above("odom", "nav_msgs/Odometry", "pose.pose.position.x", 2), "the experiment names none"),
    ],
)
def test_what_can_never_hold_is_found(condition: Condition, problem: str) -> None:
    assert any(finding.is_error and problem in finding.problem for finding in condition.check(None))


@pytest.mark.parametrize(
    ("condition", "fix"),
    [
        (battery_below(0.15), "Give 15 if 15 % is meant."),
        (battery_above(0.4).held_for(3), "Give 40 if 40 % is meant."),
        (load_below(0.5, host="localhost"), "Give 50 if 50 % is meant."),
    ],
)
def test_a_share_where_percents_are_meant_is_told_of(condition: Condition, fix: str) -> None:
    found = [each for each in condition.check("ros2") if "less than 1 %" in each.problem]
    assert [(each.is_error, each.fix) for each in found] == [(False, f"Limits are in percent. {fix}")]


def test_what_can_hold_is_not_refused() -> None:
    field = ("scan", "sensor_msgs/LaserScan", "ranges.0")
    both = any_of(temperature_below(40), temperature_above(50))
    for condition in (both, all_of(topic_above(*field, 1), topic_below(*field, 2)), measure_above("Energy", 5)):
        assert list(condition.check("simulated")) == []


@pytest.mark.parametrize(
    ("make", "problem"),
    [
        (all_of, "there is no condition"),
        (lambda: any_of("port 8080"), "'port 8080' is not a condition"),
        (lambda: Between(1.0).held_for(0), "nothing can hold for 0 s"),
        (lambda: Between(1.0).held_for("5"), "nothing can hold for '5' s"),
        (lambda: load_below(float("nan")), "nan is not a limit"),
        (lambda: load_below(True), "True is not a limit"),
        (lambda: measure_above("Energy", 10**400), "is not a limit"),
        (lambda: topic_above("odom", "nav_msgs/Odometry", "x", 2, within_s=float("nan")), "within_s is nan"),
        (lambda: topic_above("odom", "nav_msgs/Odometry", "x", 2, within_s=0), "within_s is 0"),
        (lambda: message_on("odom", "nav_msgs/Odometry", "x > 2"), "'x > 2' is not a predicate"),
    ],
)
def test_what_is_no_condition_is_refused_where_it_is_written(make: Callable[[], Condition], problem: str) -> None:
    with pytest.raises(ConditionError, match=problem) as error:
        make()
    assert error.value.fix


def test_a_measure_is_awaited_that_another_plugin_publishes(tmp_path: Path) -> None:
    from robot_runner.plugins import Measure, Profiler

    class Scale(Profiler):
        measures = (Measure("Mass", "kg", "Mass of the robot."),)

        def populate_run_data(self, context: RobotRunnerContext) -> None: ...

    clock = FakeClock()
    context = make_context(tmp_path, Scale(), clock=clock, robot=None)
    clock.at(1.0, lambda: context.publish("Mass", 1.0))
    clock.at(2.0, lambda: context.publish("Mass", 3.0))
    assert measure_above("Mass", 2.5).wait(context, timeout_s=5.0).value == 3.0
    assert clock.now() == pytest.approx(2.0, abs=0.06)
    with pytest.raises(ConditionError, match="the measure Size was not published yet"):
        measure_above("Size", 2.5).wait(context, timeout_s=0.1)
