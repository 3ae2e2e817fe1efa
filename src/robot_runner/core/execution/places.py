"""Places: where runs are executed, such as a slot of this machine, a robot, or a worker on another machine.

The orchestrator keeps as many runs in flight as there are free places whose claims do not clash. It has no threads: all
that it waits for is *awaited* in one poll loop (`poll_loop.py`), a run in flight like the end of a rest. So a place

1. begins a run and returns at once with a `RunInFlight`;
2. names descriptors that become readable when there is something to do, and the moment at which that is due at the
   latest;
3. does in `advance` what there is to do, and never waits there.

Records of a run are reported in the order in which they were made, and before `advance` returns that it is over. The
orchestrator alone writes the journal and the run table.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from robot_runner.core.config.experiment import Experiment
from robot_runner.core.execution.interruption import Interruption
from robot_runner.core.execution.task import OutcomeBuilder, Report, RunOutcome, RunTask

#: The reason why a run ended that the user's interruption has ended.
INTERRUPTED = "the user interrupted the experiment"


class Awaited(Protocol):
    """Something that goes on beside the orchestrator, and that it waits for in its poll loop."""

    @property
    def descriptors(self) -> Collection[int]:
        """The descriptors to poll: readable, or hung up, when `advance` has work; `advance` may change them."""

    @property
    def due(self) -> float | None:
        """When `advance` is to be called at the latest, on the monotonic clock (s); None for no such moment."""

    def advance(self) -> bool:
        """Do the work that is due, without waiting; return whether it is over. Not called again once it is."""

    def stop(self, because: str, *, is_interruption: bool = False) -> None:
        """Let it close what it has opened, and end. Another call changes nothing.

        `because` becomes the reason why the run failed. With `is_interruption` the user has asked for it, so that the
        run is to be done again.
        """

    def kill(self) -> None:
        """End it at once: the user has interrupted twice."""


@dataclass(frozen=True, slots=True)
class InFlight:
    """A run that is being executed: its place (empty if there is only one), and its last event."""

    run: str
    place: str = ""
    event: str | None = None


class RunInFlight(Awaited, Protocol):
    """One attempt at a run that is being executed at a place."""

    def outcome(self) -> RunOutcome:
        """Return the outcome of the attempt, once it is over, however the run has ended."""

    def close(self) -> None:
        """Release its resources. A run that is still being executed is ended first, and awaited."""


@dataclass(frozen=True, slots=True)
class Watch:
    """What a run in flight reports to, and what ends it, beside its place.

    Attributes:
        interruption: the user's, for a run that the orchestrating process executes itself.
        report: takes each record as it arrives.
        refresh: called after each record of a run that the orchestrating process executes itself.
        noticed_interruption: called once the run has been asked to stop because the user interrupted.
    """

    interruption: Interruption
    report: Report = lambda _kind, _fields: None
    refresh: Callable[[], None] = lambda: None
    noticed_interruption: Callable[[], None] = lambda: None


class Place(Protocol):
    """Where one run at a time can be executed.

    Attributes:
        name: unique among the places; for screens, the journal and findings.
        experiment: with the robot of this place, for its runs, gates and callbacks of the orchestrator.
        slot: the number of the files that a run on this machine has while it is executed, from 1; 0 on another machine.
        is_unavailable: whether it takes no runs any more, or not now: its worker is gone, or its robot was set aside.
    """

    is_unavailable: bool

    @property
    def name(self) -> str: ...  # noqa: D102 - as above

    @property
    def experiment(self) -> Experiment: ...  # noqa: D102 - as above

    @property
    def slot(self) -> int: ...  # noqa: D102 - as above

    def claimed(self, claims: Collection[str], combination: Mapping[str, object]) -> frozenset[str] | None:
        """Return the claims that a run would hold here; None where it cannot be executed here.

        Two runs that hold the same claim are never in flight together.

        Args:
            claims: of the experiment's plugins and config, such as `host:localhost` or `serial:/dev/ttyUSB0`. A place
                on another machine gives those of a machine the name of its own; a robot adds itself.
            combination: the treatments of the run.
        """

    def begin(self, task: RunTask, builder: OutcomeBuilder, watch: Watch) -> RunInFlight:
        """Begin one attempt at a run, and return at once.

        A place that cannot begin it returns a run with that outcome, and is unavailable from then on. `builder` has
        what the orchestrator has recorded of the attempt, and takes each record before `watch.report`.
        """


class Places(Protocol):
    """All places of an experiment; they may come and go while it is executed."""

    @property
    def all(self) -> Sequence[Place]:
        """Those that are there now, in a lasting order, the unavailable ones included."""

    @property
    def descriptors(self) -> Collection[int]:
        """The descriptors that become readable when places may have come or gone."""

    @property
    def due(self) -> float | None:
        """When `advance` is to be called at the latest, on the monotonic clock (s); None for no such moment."""

    def advance(self, *, is_idle: bool = False) -> Sequence[str]:
        """Update, without waiting, which places there are; return messages for the user.

        `is_idle`: nothing is in flight or prepared, as no place can execute what is left.

        Raises:
            ExecutionError: no place is left, and none will come; or for too long none could execute what is left.
        """

    def close(self) -> None:
        """Release all of them; no run is in flight any more."""
