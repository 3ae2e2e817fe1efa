"""What is found beforehand of the gates and guards of a config."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from robot_runner import (
    Condition,
    Gate,
    Guard,
    all_of,
    battery_above,
    load_above,
    load_below,
    message_on,
    not_,
    port_open,
    temperature_below,
    throttled,
    topic_present,
)
from robot_runner.conditions.condition_checks import check_conditions
from robot_runner.core.config.parameters import Parameters
from robot_runner.plugins import treatment
from robot_runner.plugins.profilers import Battery, Ina219, PsUtil
from robot_runner.plugins.systems import Together, Waypoints

if TYPE_CHECKING:
    from collections.abc import Callable

    from robot_runner.plugins import Plugin

WAY = [(1.0, 0.0)]


def pair() -> Plugin:
    return Together(Waypoints(WAY, name="a", namespace="/alice"), Waypoints(WAY, name="b", namespace="/bob"))


def found(condition: Condition, *plugins: Plugin, robot: str = "simulated", cluster: str | None = None) -> list[str]:
    parameters = Parameters(robot=robot, gates=(Gate(condition),), guards=(Guard(condition),), cluster=cluster)
    return [str(each) for each in check_conditions("config.py", parameters, plugins)]


@pytest.mark.parametrize(
    "condition",
    [battery_above(10), all_of(load_below(50), topic_present("odom")).held_for(2), message_on("odom", "x/Y")],
)
def test_a_condition_about_a_simulated_robot_that_nobody_drives_is_found(condition: Condition) -> None:
    for finding in found(condition, pair()):
        assert "which no system commands: they command /alice, /bob" in finding
        assert "namespace='/bob'" in finding
    assert len(found(condition, pair())) == 2
    alone = found(condition, Waypoints(WAY, namespace="alice"))
    assert "they command /alice" in alone[0]


def test_a_condition_about_a_robot_that_is_driven_is_none_to_tell_of() -> None:
    assert found(battery_above(10, namespace="bob"), pair()) == []
    assert found(load_below(50), pair()) == []
    assert found(battery_above(10)) == []
    assert found(battery_above(10), Waypoints(WAY)) == []
    assert found(battery_above(10), pair(), robot="ros2") == []
    assert found(battery_above(10), Waypoints(WAY, namespace=treatment("Robot"))) == []


@pytest.mark.parametrize("profiler", [Battery, PsUtil, Ina219])
def test_a_profiler_of_a_simulated_robot_that_nobody_drives_is_found(profiler: Callable[..., Plugin]) -> None:
    parameters = Parameters(robot="simulated")
    (finding,) = check_conditions("config.py", parameters, [pair(), profiler()])
    assert "which no system commands: they command /alice, /bob" in finding.problem
    assert not list(check_conditions("config.py", parameters, [pair(), profiler(namespace="/bob")]))
    assert not list(check_conditions("config.py", parameters, [Waypoints(WAY), profiler()]))
    assert not list(check_conditions("config.py", Parameters(robot="ros2"), [pair(), profiler()]))


def test_a_profiler_of_a_computer_that_is_named_is_about_no_robot() -> None:
    assert not list(check_conditions("config.py", Parameters(robot="simulated"), [pair(), PsUtil(host="localhost")]))


@pytest.mark.parametrize("condition", [temperature_below(50), not_(load_above(10)), throttled(), port_open(80)])
def test_a_gate_about_this_machine_is_warned_of_where_workers_execute_the_runs(condition: Condition) -> None:
    def told(cluster: str | None) -> list[str]:
        return [each for each in found(condition, cluster=cluster) if "workers of a cluster" in each]

    (finding,) = told("tcp://scheduler:8786")  # and none of the guard, which is watched at the run
    assert "gates[0]" in finding
    assert told(None) == []


def test_a_gate_about_a_named_computer_or_the_robot_is_not_warned_of() -> None:
    condition = all_of(temperature_below(50, host="pi@robot"), port_open(80, host="robot"), topic_present("odom"))
    told = found(all_of(condition, battery_above(10)), cluster="tcp://scheduler:8786")
    assert [each for each in told if "workers of a cluster" in each] == []
