"""The places of this machine: slots, each with a log and marks of its own for the run that it executes."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from robot_runner.core.config.claims import worker_count
from robot_runner.core.entry_points import named_entry_point
from robot_runner.core.errors import PluginError
from robot_runner.core.execution.executor import executor_for

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping, Sequence

    from robot_runner.core.config.claims import Claims
    from robot_runner.core.config.experiment import Experiment
    from robot_runner.core.execution.places import Place, Places, RunInFlight, Watch
    from robot_runner.core.execution.task import OutcomeBuilder, RunTask

__all__ = ["LocalPlace", "LocalPlaces", "places_of"]


class LocalPlace:
    """A slot of this machine.

    Args:
        experiment: what is executed.
        slot: its number, from 1.
    """

    def __init__(self, experiment: Experiment, slot: int) -> None:
        self.name = f"slot {slot}"
        self.slot = slot
        self.is_aside = False
        self.experiment = replace(experiment, folder=experiment.folder.at_slot(slot))
        self._executor = executor_for(self.experiment)

    def claimed(self, claims: Collection[str], combination: Mapping[str, object]) -> frozenset[str] | None:
        """Return the claims: they are about this machine and what is connected to it."""
        del combination
        return frozenset(claims)

    def begin(self, task: RunTask, builder: OutcomeBuilder, watch: Watch) -> RunInFlight:
        """Begin an attempt in a process of its own, or execute it in this one (`IN_PROCESS`)."""
        return self._executor.begin(task, builder, watch)


class LocalPlaces:
    """The slots of this machine.

    Args:
        experiment: what is executed.
        count: how many there are.
    """

    descriptors: Collection[int] = ()
    due: float | None = None

    def __init__(self, experiment: Experiment, count: int) -> None:
        self.all: Sequence[Place] = tuple(LocalPlace(experiment, slot) for slot in range(1, count + 1))

    def advance(self) -> Sequence[str]:
        """Say nothing: slots neither come nor go."""
        return ()

    def close(self) -> None:
        """Do nothing: there is nothing to let go of."""


def places_of(experiment: Experiment, claims: Claims, combinations: Iterable[Mapping[str, Any]]) -> Places:
    """Return the places of an experiment: one where all of these runs make the same claim, and none could overlap.

    Those of a cluster are brought by the room that speaks to it, in the group `robot_runner.places`.

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
    count = worker_count(experiment.parameters)
    return LocalPlaces(experiment, 1 if count > 1 and claims.common(combinations) else count)
