"""Ending a run or its mission on purpose: what a context passes on, and what is raised in the callback that it ends."""

from __future__ import annotations

from typing import Protocol

__all__ = ["Ending", "EndingInPlace", "MissionStopped", "RunFailed", "RunInterrupted"]


class RunInterrupted(BaseException):
    """Raised in a run's callback when the run is to stop. A BaseException, so that callbacks do not swallow it."""

    def __init__(self, reason: str = "the run was told to end") -> None:
        super().__init__(reason)


class RunFailed(RunInterrupted):
    """Raised in the callback that is being executed when `context.fail` is called, with its reason."""


class MissionStopped(RunInterrupted):
    """Raised in the mission when `context.stop_mission` is called, with its reason: the run is not failed."""


class Ending(Protocol):
    """What ends a run, or its mission, from any of its threads."""

    @property
    def has_failed(self) -> bool:
        """Whether the run has failed: what is left is the closing, which is not to take long."""
        ...

    def fail(self, owner: str, reason: str) -> None:
        """Fail the run and end what it is doing."""
        ...

    def stop_mission(self, owner: str, reason: str) -> None:
        """End the mission, which is going on and was not stopped before."""
        ...


class EndingInPlace:
    """Ends the callback that asks for it and nothing else: for a context without a run's process around it.

    Example:
        >>> EndingInPlace().fail("Guard", "too warm")
        Traceback (most recent call last):
        robot_runner.core.events.early_end.RunFailed: too warm
    """

    has_failed = False

    def fail(self, owner: str, reason: str) -> None:
        """Raise the reason.

        Raises:
            RunFailed: always.
        """
        del owner
        raise RunFailed(reason)

    def stop_mission(self, owner: str, reason: str) -> None:
        """Raise the reason.

        Raises:
            MissionStopped: always.
        """
        del owner
        raise MissionStopped(reason)
