"""Deadlines of events in tests: short in the one that is to take too long, and none where a busy machine is slow."""

from __future__ import annotations

from typing import TYPE_CHECKING

from robot_runner.core.execution.local_places import _Supervision
from robot_runner.core.execution.orchestrator_events import EventDeadline

if TYPE_CHECKING:
    import pytest

__all__ = ["enforce_deadline_in"]

#: Longer than any test takes, s.
_NEVER = 1e6


def enforce_deadline_in(event: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Have the deadline of events enforced in one event alone: of the first run that comes to it, or of no run."""
    deadlines, late, begin = _Supervision._deadlines, list[_Supervision](), EventDeadline.__init__

    def deadlines_there(supervision: _Supervision) -> tuple[float | None, float | None]:
        of_run, of_event = deadlines(supervision)
        if supervision._builder.event == event and not late:
            late.append(supervision)
        return of_run, of_event if supervision in late and supervision._builder.event == event else None

    def begin_there(deadline: EventDeadline, what: str, seconds: float, grace: float) -> None:
        begin(deadline, what, seconds if what.startswith(event) else _NEVER, grace)

    monkeypatch.setattr(_Supervision, "_deadlines", deadlines_there)
    monkeypatch.setattr(EventDeadline, "__init__", begin_there)
