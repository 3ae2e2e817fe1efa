"""What goes to an executor and what comes back: plain data, so that it can cross to another process."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from robot_runner.errors import Finding
    from robot_runner.events.measure import PublishedMeasure

__all__ = ["AttemptStatus", "Report", "RunFailure", "RunOutcome", "RunTask", "seed_of_run"]

#: Takes what happens in a run as it happens: the kind of the record and its plain fields.
Report = Callable[[str, dict[str, Any]], None]


class AttemptStatus(Enum):
    """How one attempt ended."""

    DONE = "done"
    FAILED = "failed"
    INTERRUPTED = "interrupted"


@dataclass(frozen=True, slots=True)
class RunTask:
    """One attempt at executing one run.

    Attributes:
        run_number: its place in the order of execution, from 1.
        combination: the treatment of each factor, by name.
        experiment_seed: the seed from which the run's own is derived.
        run_seed: a seed for this run alone, the same each time that it is executed.
    """

    run_id: str
    run_number: int
    run_count: int
    attempt: int
    combination: Mapping[str, Any]
    repetition: int
    experiment_seed: int
    run_seed: int


def seed_of_run(experiment_seed: int, run_id: str) -> int:
    """Return a seed of 32 bits that depends on the experiment's seed and the run, and on nothing else."""
    digest = hashlib.blake2b(f"{experiment_seed}/{run_id}".encode(), digest_size=4).digest()
    return int.from_bytes(digest, "big")


@dataclass(frozen=True, slots=True)
class RunFailure:
    """Why an attempt failed.

    Attributes:
        event: the event during which it failed, or empty where that is not known.
        owner: whose callback failed: a plugin's name, `config`, or empty.
        problem: what happened, in one line.
        traceback: the Python traceback, where there is one.
    """

    problem: str
    event: str = ""
    owner: str = ""
    traceback: str = ""

    def __str__(self) -> str:
        place = " of ".join(part for part in (self.event, self.owner) if part)
        return f"{place}: {self.problem}" if place else self.problem


@dataclass(frozen=True, slots=True)
class RunOutcome:
    """How one attempt went.

    Attributes:
        stamps: UTC time of each event's emission, by the event's name.
        measures: what was published, by column.
        failure: the first thing that went wrong, if any did.
        later_failures: what went wrong after that, while what was open was closed.
        seconds: real time that the attempt took.
    """

    status: AttemptStatus
    stamps: Mapping[str, str] = field(default_factory=dict)
    measures: Mapping[str, PublishedMeasure] = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()
    failure: RunFailure | None = None
    later_failures: tuple[RunFailure, ...] = ()
    seconds: float = 0.0
