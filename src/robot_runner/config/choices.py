"""The choices that static parameters offer."""

from __future__ import annotations

from enum import Enum

__all__ = ["FailurePolicy", "OperationType", "RunProcess"]


class OperationType(Enum):
    """Whether the next run starts by itself (AUTO), or once the user says so (SEMI: to swap a battery, say)."""

    AUTO = "auto"
    SEMI = "semi"


class FailurePolicy(Enum):
    """What follows a run whose last attempt failed: go on with the next run, or stop the experiment."""

    CONTINUE = "continue"
    STOP = "stop"


class RunProcess(Enum):
    """Where a run is executed.

    FORK: a fresh process forked from the orchestrator; it sees what `before_experiment` set up.
    SPAWN: a fresh interpreter that loads the config again.
    IN_PROCESS: the orchestrator itself; fast, and a run that dies takes the experiment with it.
    """

    FORK = "fork"
    SPAWN = "spawn"
    IN_PROCESS = "in_process"
