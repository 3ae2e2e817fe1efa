"""The name of a robot as a config gives it: how it is reached, and options of that way."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from math import inf
from typing import TYPE_CHECKING, Any

from robot_runner.errors import LinkError, did_you_mean

if TYPE_CHECKING:
    from collections.abc import Mapping

    from robot_runner.simulator.parameters import Turtlebot3Parameters

__all__ = ["RobotName", "SimulationOptions", "simulation_options"]

_WHERE = "robot"
_REAL_TIME_FACTOR = "real_time_factor"


@dataclass(frozen=True, slots=True)
class RobotName:
    """What `robot` in a config says: `link`, `link:option=value,option=value`, or an address: `link://host:port`.

    Attributes:
        link: the name of the robot link.
        options: what is set on it, as written, in that order.
        address: the whole of an address; None where it is none.

    Example:
        >>> RobotName.parse("simulated:task_power_factor=1.1")
        RobotName(link='simulated', options={'task_power_factor': '1.1'}, address=None)
    """

    link: str
    options: Mapping[str, str] = field(default_factory=dict)
    address: str | None = None

    @classmethod
    def parse(cls, text: str) -> RobotName:
        """Take a name apart.

        Raises:
            LinkError: an option has no name or no value, or is given twice.
        """
        link, colon, rest = text.partition(":")
        if rest.startswith("//"):
            return cls(link.strip(), {}, text.strip())
        options: dict[str, str] = {}
        for part in rest.split(",") if colon else ():
            name, equals, value = (piece.strip() for piece in part.partition("="))
            if not name or not equals or not value:
                raise LinkError(
                    f"{part.strip()!r} in {text!r} sets no option",
                    where=_WHERE,
                    fix=f"Write it as in '{link.strip()}:option=value,option=value'.",
                )
            if name in options:
                raise LinkError(f"{text!r} sets {name!r} twice", where=_WHERE, fix="Leave one of them out.")
            options[name] = value
        return cls(link.strip(), options)


@dataclass(frozen=True, slots=True)
class SimulationOptions:
    """What `robot = "simulated:name=value,..."` says of the simulation.

    Attributes:
        parameters: what its robots are made of.
        real_time_factor: simulated seconds a real second (1.0: real time); None for as fast as the physics goes.
    """

    parameters: Turtlebot3Parameters
    real_time_factor: float | None


def simulation_options(options: Mapping[str, str]) -> SimulationOptions:
    """Return what a simulated robot with these options is made of, and how fast its time goes by.

    Example:
        >>> simulation_options({"initial_charge": "40", "real_time_factor": "1"}).real_time_factor
        1.0

    Raises:
        LinkError: there is no such parameter, or it cannot have this value.
    """
    from robot_runner.simulator.parameters import Turtlebot3Parameters  # noqa: PLC0415  # only where there is a simulator

    kinds = {each.name: int if each.type == "int" else float for each in fields(Turtlebot3Parameters)}
    kinds[_REAL_TIME_FACTOR] = float
    values: dict[str, Any] = {}
    for name, text in options.items():
        if name not in kinds:
            fix = did_you_mean(name, kinds)
            raise LinkError(f"the simulated robot has no parameter {name!r}", where=_WHERE, fix=fix)
        try:
            values[name] = kinds[name](text)
        except ValueError as error:
            kind = "a whole number" if kinds[name] is int else "a number"
            problem = f"the simulated robot's {name} is {text!r}, which is not {kind}"
            raise LinkError(problem, where=_WHERE, fix=f"Give {kind}, as in {name}=1.") from error
    pace = values.pop(_REAL_TIME_FACTOR, None)
    if pace is not None and not 0 < pace < inf:
        problem = f"the simulated robot's {_REAL_TIME_FACTOR} is {pace:g}, which no clock can keep"
        raise LinkError(problem, where=_WHERE, fix="Give 1 for real time, 2 for twice as fast.")
    return SimulationOptions(Turtlebot3Parameters(**values), pace)
