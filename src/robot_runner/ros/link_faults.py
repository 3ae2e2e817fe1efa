"""Faults of a link that is used or closed: of whichever kind, each is told, and keeps nothing else from being done."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from robot_runner.core.errors import LinkError


def as_link_error(error: Exception, *, where: str, what: str = "") -> LinkError:
    """Return an error of whichever kind a client library raises as one that has a place and a remedy.

    Args:
        error: what was raised.
        where: the topic or action.
        what: what has failed, before what the library says of it; empty for nothing.

    Example:
        >>> print(as_link_error(RuntimeError("the context is not valid"), where="/cmd_vel"))
        /cmd_vel: RuntimeError: the context is not valid → Look at the run's log, which has the traceback.
    """
    if isinstance(error, LinkError):
        return error
    fix = "Look at the run's log, which has the traceback."
    problem = f"{type(error).__name__}: {error}"
    return LinkError(f"{what}: {problem}" if what else problem, where=where, fix=fix)


def do_all(steps: Iterable[Callable[[], object]]) -> None:
    """Do each of these, whatever the ones before have raised, and raise it afterwards.

    Raises:
        BaseException: what was raised first, and what matters most therefore. Of several link errors it is one that has
            the findings of all; what else was raised is added as notes.
    """
    faults: list[BaseException] = []
    for step in steps:
        try:
            step()
        except BaseException as fault:  # noqa: BLE001 - raised below
            faults.append(fault)
    if not faults:
        return
    first, *others = faults
    if others and isinstance(first, LinkError):
        findings = [finding for each in faults if isinstance(each, LinkError) for finding in each.findings]
        first, cause = LinkError.of_findings(findings), first
        first.__cause__ = cause
    for other in others:
        first.add_note(f"Then failed, too: {type(other).__name__}: {other}")
    raise first
