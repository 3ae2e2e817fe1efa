"""Errors of links: turned into a `LinkError`, and collected where all steps have to be done in spite of them."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from robot_runner.core.errors import LinkError


def as_link_error(error: Exception, *, where: str, what: str = "") -> LinkError:
    """Return any exception of a client library as a `LinkError` at a topic or action; `what` says what has failed.

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
    """Do all steps, also after one has raised, and raise its exception afterwards.

    Raises:
        BaseException: the first exception, as the most important step comes first. Several link errors become one with
            all their findings; the other exceptions are added as notes.
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
