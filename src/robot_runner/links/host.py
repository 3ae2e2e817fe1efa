"""What a link to a computer can do: sample its utilisation on board, and hand the samples over afterwards."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

__all__ = ["HostLink", "UtilisationSample", "UtilisationSampler"]


@dataclass(frozen=True, slots=True)
class UtilisationSample:
    """CPU and memory utilisation of a computer at one moment.

    Attributes:
        time: seconds on the run's clock.
        cpu: share of all cores that was busy since the sample before, 0..100 %.
        memory: share of the physical memory in use, 0..100 %.
    """

    time: float
    cpu: float
    memory: float


@runtime_checkable
class UtilisationSampler(Protocol):
    """A small loop on the computer that samples utilisation until it is stopped."""

    def stop(self) -> list[UtilisationSample]:
        """End the loop and return its samples, oldest first; a second call returns the same."""
        ...


@runtime_checkable
class HostLink(Protocol):
    """A computer: this one, the robot's on-board one over SSH, or a simulated one."""

    @property
    def is_simulated(self) -> bool:
        """Whether the computer is a simulated one."""
        ...

    def sample_utilisation(self, rate: float) -> UtilisationSampler:
        """Begin to sample CPU and memory utilisation `rate` times a second."""
        ...

    def close(self) -> None:
        """End all samplers and leave; closing twice does nothing."""
        ...
