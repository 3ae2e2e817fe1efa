"""What callbacks of the orchestrating process are told beyond the run at hand: the run to come, and how all ended."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from robot_runner.core.errors import Finding


@dataclass(frozen=True, slots=True)
class NextRun:
    """The run that comes after the one that is over, for `continue_experiment`.

    Attributes:
        run_id: its id in the run table, such as `r_2`.
        run_number: its place in the order of execution, from 1.
        combination: the treatment of each factor, by the factor's name.
        repetition: which repetition of the combination it is, from 1.
    """

    run_id: str
    run_number: int
    combination: Mapping[str, Any]
    repetition: int


@dataclass(frozen=True, slots=True)
class ExperimentEnd:
    """How an experiment ended, for `after_experiment`.

    Attributes:
        done, failed, todo: how many runs of the table are done, failed, and are still to do.
        is_interrupted: whether the user asked for the end.
        is_stopped_by_policy: whether a failed run ended it (`on_failure` STOP).
        failure: what ended it before its time, such as a `before_experiment` that raised; empty where nothing did.
        failures: why each failed run failed, one line each.
        findings: what looked odd.

    Example:
        >>> ExperimentEnd(done=4).is_complete
        True
    """

    done: int = 0
    failed: int = 0
    todo: int = 0
    is_interrupted: bool = False
    is_stopped_by_policy: bool = False
    failure: str = ""
    failures: Sequence[str] = ()
    findings: Sequence[Finding] = ()

    @property
    def is_complete(self) -> bool:
        """Whether all runs are done."""
        return not (self.failed or self.todo or self.failure)
