"""A simulation: one clock, and the robots that live by it."""

from __future__ import annotations

from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from robot_runner.errors import LinkError
from robot_runner.simulator.clock import SimulatedClock
from robot_runner.simulator.parameters import Turtlebot3Parameters
from robot_runner.simulator.turtlebot3 import SimulatedTurtlebot3

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

__all__ = ["Simulation"]


class Simulation:
    """Robots by namespace on one clock, deterministic for a seed.

    Each robot drives in its own copy of the arena: robots do not see or touch each other.

    Attributes:
        clock: moves on only while it is slept on.
        parameters: what its robots are made of.
        real_time_factor: simulated seconds a real second; None for as fast as the physics goes.
        offers: the services that others than the robots offer, by full name: their types and what answers.

    Example:
        >>> simulation = Simulation(seed=1)
        >>> simulation.turtlebot3("/alice") is simulation.turtlebot3("alice")
        True
        >>> simulation.close()
    """

    def __init__(
        self, seed: int, *, parameters: Turtlebot3Parameters | None = None, real_time_factor: float | None = None
    ) -> None:
        self.clock = SimulatedClock(real_time_factor)
        self.parameters = parameters or Turtlebot3Parameters()
        self._seed = seed
        self.offers: dict[str, tuple[str, Callable[[Mapping[str, Any]], Mapping[str, Any]]]] = {}
        self._robots: dict[str, SimulatedTurtlebot3] = {}
        self._is_closed = False

    @property
    def robots(self) -> Mapping[str, SimulatedTurtlebot3]:
        """The robots that were asked for so far, by namespace: empty, or `/alice`."""
        return MappingProxyType(self._robots)

    def turtlebot3(self, namespace: str = "") -> SimulatedTurtlebot3:
        """Return the robot of this namespace, which is made when it is first asked for.

        Raises:
            LinkError: the simulation was closed.
        """
        if self._is_closed:
            raise LinkError(
                "the simulation was closed",
                where=f"robot {namespace!r}",
                fix="Connect to the robot within the run.",
            )
        name = namespace.strip("/")
        full = f"/{name}" if name else ""
        if full not in self._robots:
            self._robots[full] = SimulatedTurtlebot3(full, self.clock, self._seed, self.parameters)
        return self._robots[full]

    def close(self) -> None:
        """Let go of all robots; closing twice does nothing. The clock can still be read and slept on."""
        self._is_closed = True
        self._robots.clear()
        self.offers.clear()
