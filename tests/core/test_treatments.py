from __future__ import annotations

import abc
import functools
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import pytest

from robot_runner.core.errors import PluginError
from robot_runner.core.events.manager import EventManager, OwnerKind, RobotRunnerEvents
from robot_runner.core.plugin import Profiler, System
from robot_runner.core.treatments import (
    bind,
    built_with,
    factors_of,
    is_waiting,
    parameters_guarded,
    treatment,
    values_of,
)

if TYPE_CHECKING:
    from collections.abc import Callable

CONFIG = "robot_runner_config"


class Robot(System):
    """A stranger's system: its speed is stored under another name."""

    def __init__(self, speed: float, *wheels: str, name: str | None = None, **options: Any) -> None:
        super().__init__(name=name)
        self.mission = speed * 10
        self.wheels = wheels
        self.options = options

    def start_run(self) -> float:
        return self.mission

    def slow_down(self) -> None:
        self.speed = 0.1

    def in_a_callback(self) -> Callable[[], None]:
        def hear() -> None:
            self.speed = 0.2

        return hear


def set_as_a_config_does(plugin: object, name: str, value: object) -> None:
    """Set an attribute by code of a module that is called as that of a config."""
    exec("setattr(plugin, name, value)", {"__name__": CONFIG, "plugin": plugin, "name": name, "value": value})  # noqa: S102


# What stands for a treatment.


@pytest.mark.parametrize(
    "use",
    [bool, str, "{}".format, lambda it: it == "slow", lambda it: it != "slow", lambda it: f"pi@{it}"],
    ids=["bool", "str", "format", "equal", "unequal", "text"],
)
def test_nothing_is_computed_from_a_treatment_before_there_is_one(use: Callable[[object], object]) -> None:
    with pytest.raises(PluginError, match="treatment\\('Speed'\\) has no value before a run"):
        use(treatment("Speed"))


@pytest.mark.parametrize("name", ["", None, 3, ["Speed"]])
def test_what_names_no_factor_is_refused(name: Any) -> None:
    with pytest.raises(PluginError, match="names no factor"):
        treatment(name)


# Plugins with bound parameters.


def test_a_plugin_with_a_bound_parameter_waits_and_is_what_it_will_be() -> None:
    robot = Robot(treatment("Speed"))
    assert is_waiting(robot)
    assert type(robot) is Robot
    assert factors_of(robot) == {"speed": "Speed"}
    assert not hasattr(robot, "mission")


def test_its_methods_stay_those_that_were_subscribed_while_it_waited() -> None:
    robot = Robot(speed=treatment("Speed"))
    heard = robot.start_run
    for speed in (0.1, 0.2):
        bind(robot, {"Speed": speed})
        assert heard() == speed * 10
    assert not is_waiting(robot)


def test_parameters_are_bound_by_position_by_keyword_and_among_open_ones() -> None:
    robot = Robot(treatment("Speed"), "left", treatment("Wheel"), name="turtle", colour=treatment("Colour"))
    assert factors_of(robot) == {"speed": "Speed", "wheels[1]": "Wheel", "colour": "Colour"}
    combination = {"Speed": 0.5, "Wheel": "right", "Colour": "red", "Other": 1}
    assert values_of(robot, combination) == {"speed": 0.5, "wheels[1]": "right", "colour": "red"}
    bind(robot, combination)
    assert (robot.mission, robot.wheels, robot.options, robot.name) == (
        5,
        ("left", "right"),
        {"colour": "red"},
        "turtle",
    )


def test_one_factor_may_be_bound_to_several_parameters() -> None:
    robot = Robot(treatment("Size"), size=treatment("Size"))
    bind(robot, {"Size": 2})
    assert (robot.mission, robot.options) == (20, {"size": 2})


def test_another_one_is_built_beside_it() -> None:
    robot = Robot(treatment("Speed"))
    other = built_with(robot, {"Speed": 3})
    assert (other.mission, is_waiting(robot), factors_of(other)) == (30, True, {"speed": "Speed"})
    whole = Robot(1)
    assert built_with(whole, {"Speed": 3}) is whole


def test_a_plugin_without_bound_parameters_is_left_as_it_is() -> None:
    robot = Robot(1)
    robot.mission = 7
    bind(robot, {"Speed": 3})
    assert (robot.mission, factors_of(robot)) == (7, {})


def test_treatments_inside_lists_tuples_and_mappings_are_bound_each() -> None:
    command = ["planner", ["--speed=", treatment("Speed")]]
    robot = Robot(0.1, command=command, arguments={"floor": (treatment("Floor"), 2), "whole": {"x": [1]}})
    assert factors_of(robot) == {"command[1][1]": "Speed", "arguments['floor'][0]": "Floor"}
    for speed in (0.1, 0.2):
        combination = {"Speed": speed, "Floor": "wood"}
        bind(robot, combination)
        assert robot.options == {
            "command": ["planner", ["--speed=", speed]],
            "arguments": {"floor": ("wood", 2), "whole": {"x": [1]}},
        }
        assert values_of(robot, combination) == {"command[1][1]": speed, "arguments['floor'][0]": "wood"}


@pytest.mark.parametrize(
    ("value", "where"),
    [
        ({treatment("A")}, "inside a set"),
        ((1, {"x": {treatment("A")}}), "inside a set"),
        ({treatment("A"): 1}, "for a key"),
    ],
)
def test_a_treatment_without_a_place_of_its_own_is_refused(value: object, where: str) -> None:
    with pytest.raises(PluginError) as caught:
        Robot(0.1, processes=value)
    assert caught.value.problem.endswith(f"holds a treatment(...) {where}")
    assert caught.value.fix.startswith("Bind processes")


def test_a_bound_name_is_refused() -> None:
    with pytest.raises(PluginError, match=r"the name of a plugin is the same in all runs.*'Robot'"):
        Robot(0.1, name=treatment("Robot"))


def test_a_parameter_that_there_is_not_is_refused_at_once() -> None:
    class Lamp(System):
        def __init__(self, *, power: float = 1.0) -> None:
            super().__init__()
            self.power = power

    with pytest.raises(TypeError, match=r"Lamp.*unexpected keyword argument 'powr'"):
        Lamp(powr=treatment("Power"))  # type: ignore[call-arg]


def test_what_it_raises_when_it_is_built_comes_out() -> None:
    class Picky(System):
        def __init__(self, *, speed: float) -> None:
            super().__init__()
            if speed > 1:
                raise PluginError("too fast", where="Picky", fix="Slower.")

    picky = Picky(speed=treatment("Speed"))
    with pytest.raises(PluginError, match="too fast"):
        bind(picky, {"Speed": 2})


class Closing(Protocol):
    def close(self) -> None: ...


@dataclass
class OfFields(Profiler):
    port: str

    def __post_init__(self) -> None:
        super().__init__()


@dataclass(frozen=True)
class OfFixedFields(Profiler):  # type: ignore[misc] # as a stranger may write it
    port: str


class Abstract(Profiler, abc.ABC):
    def __init__(self, port: str) -> None:
        super().__init__()
        self.port = port


class OfProtocol(Profiler, Closing):
    def __init__(self, port: str) -> None:
        super().__init__()
        self.port = port

    def close(self) -> None:
        pass


class WithBase:
    def __new__(cls, port: str) -> Any:
        made = super().__new__(cls)
        made.made_for = port  # type: ignore[attr-defined]
        return made


class OfOwnMaking(Profiler, WithBase):
    def __init__(self, port: str) -> None:
        super().__init__()
        self.port = port


class Slotted(Profiler):
    __slots__ = ("port",)

    def __init__(self, port: str) -> None:
        super().__init__()
        self.port = port


@pytest.mark.parametrize("kind", [OfFields, OfFixedFields, Abstract, OfProtocol, OfOwnMaking, Slotted])
def test_plugins_of_any_make_can_be_bound(kind: Any) -> None:
    plugin = kind(port=treatment("Port"))
    assert type(plugin) is kind
    for port in ("a", "b"):
        bind(plugin, {"Port": port})
        assert plugin.port == port
    assert kind("c").port == "c"


def test_one_that_clears_its_attributes_can_be_built_again() -> None:
    class Clearing(System):
        def __init__(self, *, speed: float) -> None:
            vars(self).clear()
            super().__init__()
            self.speed = speed

    plugin = Clearing(speed=treatment("Speed"))
    bind(plugin, {"Speed": 1})
    bind(plugin, {"Speed": 2})
    assert plugin.speed == 2


# Parameters that a config sets.


def test_a_parameter_that_a_config_sets_is_refused_with_the_remedy() -> None:
    robot = Robot(0.1)
    with parameters_guarded({"Task": "Video", "Speed": 0.2}), pytest.raises(PluginError) as caught:
        set_as_a_config_does(robot, "speed", 0.2)
    assert caught.value.problem == "speed is a parameter of Robot: changing it has no effect once it is built"
    assert "Robot(speed=treatment('Speed'))" in caught.value.fix
    assert "Robot(speed=0.2)" in caught.value.fix


def test_other_attributes_can_be_set_and_so_can_parameters_elsewhere() -> None:
    robot = Robot(0.1)
    with parameters_guarded():
        set_as_a_config_does(robot, "note", 1)
        set_as_a_config_does(robot, "mission", 2)
    set_as_a_config_does(robot, "speed", 3)
    assert (robot.note, robot.mission, robot.speed) == (1, 2, 3)  # type: ignore[attr-defined]


def test_a_plugins_own_code_sets_what_it_wants_also_when_a_config_calls_it() -> None:
    robot = Robot(0.1)
    later = robot.in_a_callback()
    names = {"__name__": CONFIG, "robot": robot, "later": later, "Robot": Robot}
    with parameters_guarded():
        exec("robot.slow_down()", names)  # noqa: S102
        assert robot.speed == 0.1
        exec("later()", names)  # noqa: S102
        assert robot.speed == 0.2
        exec("robot = Robot(0.3)", names)  # noqa: S102
    assert names["robot"].mission == 3  # type: ignore[attr-defined]


def test_a_plugin_of_the_config_itself_may_set_its_own_and_nobody_else_may() -> None:
    source = """
from dataclasses import dataclass
from robot_runner.plugins import Profiler

@dataclass
class Meter(Profiler):
    port: str
    def __post_init__(self):
        super().__init__()
    def reset(self):
        self.port = "none"

def helper(meter):
    meter.port = "x"
"""
    names: dict[str, Any] = {"__name__": CONFIG}
    with parameters_guarded():
        exec("import sys, types; sys.modules[__name__] = types.ModuleType(__name__)", names)  # noqa: S102
        exec(source, names)  # noqa: S102
        meter = names["Meter"]("a")
        meter.reset()
        assert meter.port == "none"
        with pytest.raises(PluginError, match="port is a parameter of Meter"):
            names["helper"](meter)


def test_a_property_is_there_to_be_set() -> None:
    class Dimmed(System):
        def __init__(self, *, level: float) -> None:
            super().__init__()
            self._level = level

        @property
        def level(self) -> float:
            return self._level

        @level.setter
        def level(self, value: float) -> None:
            self._level = value

    lamp = Dimmed(level=1)
    with parameters_guarded():
        set_as_a_config_does(lamp, "level", 2)
    assert lamp.level == 2


def test_parameters_that_a_derived_class_hands_on_are_guarded_too() -> None:
    class Renamed(Robot):
        def __init__(self, **keywords: Any) -> None:
            super().__init__(0.1, **keywords)

    with parameters_guarded(), pytest.raises(PluginError, match="speed is a parameter of Renamed"):
        set_as_a_config_does(Renamed(), "speed", 1)


def test_the_guard_is_up_while_callbacks_of_a_config_are_called_and_not_those_of_plugins() -> None:
    robot, set_by = Robot(0.1), []
    manager = EventManager()
    for kind in OwnerKind:
        callback = functools.partial(_set_speed, robot, set_by, kind)
        manager.subscribe(RobotRunnerEvents.START_RUN, callback, owner=kind.name, kind=kind)
    emission = manager.emit(RobotRunnerEvents.START_RUN, lambda _: None)
    assert set_by == [OwnerKind.SYSTEM, OwnerKind.PROFILER]
    assert [failure.owner for failure in emission.failures] == ["CONFIG"]


def _set_speed(robot: Robot, set_by: list[OwnerKind], kind: OwnerKind, _context: object) -> None:
    set_as_a_config_does(robot, "speed", 1)
    set_by.append(kind)


class Convoy(System):
    """A stranger's system that is made of others."""

    def __init__(self, *robots: Robot, name: str | None = None) -> None:
        super().__init__(name=name)
        self.robots = robots


def test_a_plugin_is_built_with_the_treatments_of_those_that_it_is_made_of() -> None:
    convoy = Convoy(Robot(treatment("Speed"), name="alice"), Robot(0.1, name="bob"))
    assert is_waiting(convoy)
    assert dict(factors_of(convoy)) == {"robots[0].speed": "Speed"}
    copies = [built_with(convoy, {"Speed": speed}) for speed in (0.2, 0.3)]
    assert [copy.robots[0].mission for copy in copies] == [2.0, 3.0]
    assert not any(is_waiting(copy) for copy in copies)
    for speed in (0.4, 0.5):
        bind(convoy, {"Speed": speed})
        assert [robot.mission for robot in convoy.robots] == [speed * 10, 1.0]
        assert values_of(convoy, {"Speed": speed}) == {"robots[0].speed": speed}


class Goal(NamedTuple):
    x: float
    y: float


class Mover(Profiler):
    def __init__(self, goal: Goal) -> None:
        super().__init__()
        self.goal = goal


def test_a_treatment_in_a_named_tuple_is_a_field_of_it() -> None:
    mover = Mover(Goal(treatment("Distance"), 2.0))
    bind(mover, {"Distance": 5.0})
    assert (mover.goal, type(mover.goal)) == (Goal(5.0, 2.0), Goal)
