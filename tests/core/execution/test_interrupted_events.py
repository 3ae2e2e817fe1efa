"""A signal may come at any instruction while the orchestrator emits an event: nothing of its deadline is left."""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, cast

import pytest
from tests.forked_program import child_processes
from tests.instructions import Instructions

from robot_runner.core.events import manager
from robot_runner.core.events.manager import EventManager, OwnerKind, RobotRunnerEvents
from robot_runner.core.execution import interruption, orchestrator_events
from robot_runner.core.execution.interruption import Interruption
from robot_runner.core.execution.orchestrator_events import OrchestratorEvents
from robot_runner.core.execution.poll_loop import PollLoop

if TYPE_CHECKING:
    from types import FrameType

_FILES = (contextlib.__file__, manager.__file__, interruption.__file__, orchestrator_events.__file__)
#: Each so many instructions, of a thousand.
_STRIDE = 7
_EVENT = RobotRunnerEvents.BEFORE_EXPERIMENT


def _emitted(at: int | None, act: Callable[[Interruption], Callable[[FrameType], None]]) -> int:
    """Emit an event with a deadline and two callbacks; return how many instructions that took.

    Raises:
        AssertionError: something of the deadline goes on.
    """
    events, there = EventManager(), child_processes()
    for owner in ("first", "second"):
        events.subscribe(_EVENT, lambda: None, owner=owner, kind=OwnerKind.SYSTEM)
    parameters = SimpleNamespace(event_deadline_in_s=1000.0, grace_in_s=1000.0)
    experiment = cast("Any", SimpleNamespace(events=events, parameters=parameters))
    with Interruption() as stops:
        emitter = OrchestratorEvents(experiment, cast("Any", None), PollLoop(stops))
        with Instructions(*_FILES, at=at, act=act(stops)) as counted:
            emission = emitter._emit(_EVENT, lambda _owner: None)
        assert signal.getitimer(signal.ITIMER_REAL)[0] == 0.0, at
        assert signal.getsignal(signal.SIGALRM) is signal.SIG_DFL, at
        assert child_processes() <= there, at  # the watcher would kill this process later
        assert len(emission.failures) <= 1, at
    return counted.count


@pytest.fixture
def _no_timer() -> Iterator[None]:
    """Keep the deadline of the test itself, which has the same signal, from being taken for one of the event."""
    earlier, timer = signal.signal(signal.SIGALRM, signal.SIG_DFL), signal.setitimer(signal.ITIMER_REAL, 0)
    yield
    signal.signal(signal.SIGALRM, earlier)
    signal.setitimer(signal.ITIMER_REAL, *timer)


def _deadline_passes(_stops: Interruption) -> Callable[[FrameType], None]:
    def act(frame: FrameType) -> None:
        handler = signal.getsignal(signal.SIGALRM)
        if callable(handler):
            handler(signal.SIGALRM, frame)

    return act


def _user_interrupts(stops: Interruption) -> Callable[[FrameType], None]:
    return lambda frame: stops._count_signal(signal.SIGINT, frame)


def _user_interrupts_twice(stops: Interruption) -> Callable[[FrameType], None]:
    def act(frame: FrameType) -> None:
        try:
            stops._count_signal(signal.SIGINT, frame)
        finally:
            stops._count_signal(signal.SIGINT, frame)

    return act


@pytest.mark.long
@pytest.mark.usefixtures("_no_timer")
@pytest.mark.parametrize(
    "act", [_deadline_passes, pytest.param(_user_interrupts, marks=pytest.mark.soak), _user_interrupts_twice]
)
def test_wherever_a_signal_comes_an_event_leaves_no_timer_and_no_watcher(
    act: Callable[[Interruption], Callable[[FrameType], None]],
) -> None:
    count = _emitted(None, act)
    for at in range(1, count + 1, _STRIDE):
        _emitted(at, act)
