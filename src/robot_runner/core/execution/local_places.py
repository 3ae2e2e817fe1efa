"""The places of this machine: slots, each with a log and marks of its own for the run that it executes."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from robot_runner.core.config.claims import worker_count
from robot_runner.core.config.parameters import Parameters
from robot_runner.core.entry_points import named_entry_point
from robot_runner.core.errors import PluginError
from robot_runner.core.execution.executor import executor_for
from robot_runner.core.links.connect import is_simulated

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping, Sequence

    from robot_runner.core.config.claims import Claims
    from robot_runner.core.config.experiment import Experiment
    from robot_runner.core.execution.places import Place, Places, RunInFlight, Watch
    from robot_runner.core.execution.task import OutcomeBuilder, RunTask

__all__ = ["LocalPlace", "LocalPlaces", "places_of"]


class LocalPlace:
    """A slot of this machine, which may have a robot of its own.

    Args:
        experiment: what is executed.
        slot: its number, from 1.
        robot: the name of its robot, of those that take turns, and how it is reached; None where none does.
    """

    def __init__(self, experiment: Experiment, slot: int, robot: tuple[str, str] | None = None) -> None:
        self.name = f"slot {slot}" if robot is None else robot[0]
        self.slot = slot
        self.is_aside = False
        own = (
            experiment.parameters if robot is None else Parameters(**{**vars(experiment.parameters), "robot": robot[1]})
        )
        self._own = frozenset() if robot is None or is_simulated(robot[1]) else frozenset((f"robot:{robot[1]}",))
        self.experiment = replace(experiment, folder=experiment.folder.at_slot(slot), parameters=own)
        self._executor = executor_for(self.experiment)

    def claimed(self, claims: Collection[str], combination: Mapping[str, object]) -> frozenset[str] | None:
        """Return the claims: they are about this machine and what is connected to it; its own robot is one of them."""
        del combination
        return self._own.union(claims)

    def begin(self, task: RunTask, builder: OutcomeBuilder, watch: Watch) -> RunInFlight:
        """Begin an attempt in a process of its own, or execute it in this one (`IN_PROCESS`)."""
        return self._executor.begin(task, builder, watch)


class LocalPlaces:
    """The slots of this machine.

    Args:
        places: all of them.
    """

    descriptors: Collection[int] = ()
    due: float | None = None

    def __init__(self, places: Iterable[Place]) -> None:
        self.all: Sequence[Place] = tuple(places)

    def advance(self) -> Sequence[str]:
        """Say nothing: slots neither come nor go."""
        return ()

    def close(self) -> None:
        """Do nothing: there is nothing to let go of."""


def places_of(experiment: Experiment, claims: Claims, combinations: Iterable[Mapping[str, Any]]) -> Places:
    """Return the places of an experiment: its robots, or slots; one slot where all runs claim the same.

    Those of a cluster are brought by the room that speaks to it, in the group `robot_runner.places`.

    Args:
        experiment: what is executed.
        claims: what its runs claim.
        combinations: of the runs that are to be executed.

    Raises:
        PluginError: nothing brings places of a cluster.
        ExecutionError: the experiment cannot be executed there.
    """
    if (address := experiment.parameters.cluster) is not None:
        point = named_entry_point("places", "cluster")
        if point is None:
            fix = "Install Robot Runner anew: pip install 'robot-runner[cluster]'."
            raise PluginError("nothing that is installed speaks to a cluster", where=f"cluster {address}", fix=fix)
        places: Places = point.load()(experiment, address)
        return places
    if experiment.parameters.robots:
        robots = experiment.parameters.robots.items()
        return LocalPlaces(LocalPlace(experiment, slot, robot) for slot, robot in enumerate(robots, 1))
    count = worker_count(experiment.parameters)
    count = 1 if count > 1 and claims.common(combinations) else count
    return LocalPlaces(LocalPlace(experiment, slot) for slot in range(1, count + 1))
