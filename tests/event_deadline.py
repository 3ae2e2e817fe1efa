"""Deadlines of events in tests: short in the one that is to take too long, and none where a busy machine is slow."""

from __future__ import annotations

from typing import TYPE_CHECKING

from robot_runner.core.execution.local_places import _Supervision

if TYPE_CHECKING:
    import pytest

__all__ = ["enforce_deadline_in"]


def enforce_deadline_in(event: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Have the deadline of events enforced in one event alone, of the first run that comes to it."""
    deadlines, late = _Supervision._deadlines, list[_Supervision]()

    def deadlines_there(supervision: _Supervision) -> tuple[float | None, float | None]:
        of_run, of_event = deadlines(supervision)
        if supervision._builder.event == event and not late:
            late.append(supervision)
        return of_run, of_event if supervision in late and supervision._builder.event == event else None

    monkeypatch.setattr(_Supervision, "_deadlines", deadlines_there)
