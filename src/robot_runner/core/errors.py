"""One tree of errors, each with problem, where and fix, and the findings that validation gathers.

```
RobotRunnerError
├── DesignError        a factor, an exclusion or a run table that is invalid
├── ConfigError        a config file that cannot be loaded; carries every finding
├── PluginError        a plugin that is not installed or does not keep its promises
├── MeasureError       a value that the run table must not take
├── StorageError       a file or folder that cannot be read or written
├── LinkError          a robot, host or device that cannot be reached
│   ├── GoalRejectedError   a goal that an action server does not take
│   ├── SilentGraphError    a graph that does not tell what is on it
│   └── CommandError   a command on a host that failed, or did not end in time
├── ConditionError     something that cannot be awaited
│   └── ConditionTimeout   ... or that did not come in time
├── ExecutionError     an experiment that cannot start or go on
├── AnalysisError      results that cannot be read, adopted or analysed
└── PackageError       a replication package that cannot be made, or must not be used
```
"""

from __future__ import annotations

import difflib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any, Self


class Severity(Enum):
    """Whether a finding refuses the experiment (an error) or is only shown (a warning)."""

    ERROR = "error"
    WARNING = "warning"


@dataclass(frozen=True, slots=True)
class Finding:
    """One result of validation, or of a profiler that checks its own samples.

    Attributes:
        severity: whether the experiment is refused because of it.
        where: the file, attribute, plugin or run.
        problem: what is wrong, with the value shown.
        fix: one imperative sentence that mends it; empty where there is nothing to do.
    """

    severity: Severity
    where: str
    problem: str
    fix: str = ""

    @classmethod
    def error(cls, where: str, problem: str, fix: str) -> Finding:
        """Make a finding that refuses the experiment."""
        return cls(Severity.ERROR, where, problem, fix)

    @classmethod
    def warning(cls, where: str, problem: str, fix: str = "") -> Finding:
        """Make a finding that is shown and does not refuse."""
        return cls(Severity.WARNING, where, problem, fix)

    @property
    def is_error(self) -> bool:
        """Whether the experiment is refused because of it."""
        return self.severity is Severity.ERROR

    def __str__(self) -> str:
        return f"{self.where}: {self.problem}" + (f" → {self.fix}" if self.fix else "")


def errors_first(findings: Iterable[Finding]) -> list[Finding]:
    """Return findings with the errors first, and otherwise in their order."""
    return sorted(findings, key=lambda finding: not finding.is_error)


class RobotRunnerError(Exception):
    """The base of all errors of Robot Runner: a problem, where it is, and how to correct it.

    Where there are several, `findings` lists them all and the three parts are those of the first.

    Example:
        >>> str(RobotRunnerError("there is no port 'tty9'", where="Ina219", fix="Plug it in."))
        "Ina219: there is no port 'tty9' → Plug it in."
    """

    def __init__(self, problem: str, *, where: str = "", fix: str = "", findings: Sequence[Finding] = ()) -> None:
        super().__init__(problem)
        self.problem = problem
        self.where = where
        self.fix = fix
        self.findings = tuple(findings) or (self.as_finding(),)

    @classmethod
    def of_findings(cls, findings: Sequence[Finding]) -> Self:
        """Make one error of several findings; the first gives its problem, place and fix."""
        first = findings[0]
        return cls(first.problem, where=first.where, fix=first.fix, findings=findings)

    @classmethod
    def refuse(cls, findings: Iterable[Finding]) -> None:
        """Raise one error of all these findings; where there are none, do nothing."""
        if listed := tuple(findings):
            raise cls.of_findings(listed)

    @classmethod
    def raised_by(cls, call: Callable[..., object], *arguments: Any, **keywords: Any) -> tuple[Finding, ...]:
        """Return the findings of such an error that a call raises; none where it returns."""
        try:
            call(*arguments, **keywords)
        except cls as error:
            return error.findings
        return ()

    def __str__(self) -> str:
        head = f"{self.where}: {self.problem}" if self.where else self.problem
        return f"{head} → {self.fix}" if self.fix else head

    def as_finding(self) -> Finding:
        """Return the same three parts as an error finding, to be listed among others."""
        return Finding.error(self.where, self.problem, self.fix)


class DesignError(RobotRunnerError):
    """A factor, an exclusion or a run table that is invalid."""


class ConfigError(RobotRunnerError):
    """A config file that cannot be loaded or executed; `findings` lists all problems."""


class PluginError(RobotRunnerError):
    """A plugin that is not installed or does not keep its promises."""


class MeasureError(RobotRunnerError):
    """A value that the run table must not take: undeclared, of a wrong type, or not finite."""


class StorageError(RobotRunnerError):
    """A file or folder that cannot be read or written."""


class LinkError(RobotRunnerError):
    """A robot, host or device that cannot be reached or does not answer."""


class GoalRejectedError(LinkError):
    """A goal that an action server does not take."""


class SilentGraphError(LinkError):
    """A graph that does not tell what is on it, although its robots may take commands."""


class CommandError(LinkError):
    """A command on a host failed, or did not end in time."""


class ExecutionError(RobotRunnerError):
    """An experiment that cannot start or go on."""


class ConditionError(RobotRunnerError):
    """Something that cannot be awaited, or that was awaited and did not come in time."""


class ConditionTimeout(ConditionError):  # noqa: N818 - it is named like Python's own TimeoutError is caught
    """Something that was awaited and did not come in time."""


class AnalysisError(RobotRunnerError):
    """Results that cannot be read, adopted or analysed."""


class PackageError(RobotRunnerError):
    """A replication package that cannot be made, or that must not be used as it is."""


#: How similar two names must be for one to count as a misspelling of the other (1.0: equal).
SLIP = 0.85


def nearest(name: str, candidates: Iterable[str], least: float = 0.6) -> str | None:
    """Return the candidate most similar to `name`, ignoring case; None if none is as similar as `least` (of 1.0)."""
    by_folded = {candidate.casefold(): candidate for candidate in candidates}
    match = difflib.get_close_matches(name.casefold(), by_folded, n=1, cutoff=least)
    return by_folded[match[0]] if match else None


def did_you_mean(name: str, candidates: Iterable[str], otherwise: str | None = None) -> str:
    """Return a fix that names the nearest candidate; if none is similar, `otherwise`, or a list of all."""
    known = list(candidates)
    near = nearest(name, known)
    if near is not None:
        return f"Did you mean {near!r}?"
    if otherwise is not None:
        return otherwise
    return "Choose one of: " + ", ".join(map(repr, known)) + "." if known else ""
