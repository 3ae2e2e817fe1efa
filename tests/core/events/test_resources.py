"""The links of a run: whichever of them is known is closed, wherever the run was interrupted while it was opened."""

from __future__ import annotations

from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING
from unittest.mock import Mock

import pytest
from tests.instructions import Instructions

from robot_runner.core.events import resources
from robot_runner.core.events.early_end import RunInterrupted
from robot_runner.core.events.resources import Resources, closing_left_open, opened_here
from robot_runner.core.execution.interruption import InterruptGate

if TYPE_CHECKING:
    from collections.abc import Iterator


class _Link:
    is_closed = False

    def close(self) -> None:
        self.is_closed = True


def _opened(at: int | None) -> tuple[_Link, int]:
    """Interrupt opening a link at an instruction; return the link that the next caller gets, and the instructions."""
    opened, gate = Resources(), InterruptGate()
    gate.arm()
    with (
        suppress(RunInterrupted),
        Instructions(resources.__file__, at=at, act=lambda _frame: gate.request()) as counted,
    ):
        opened.open("robot", _Link)
    gate.disarm()
    known = opened.open("robot", _Link)
    opened.close()
    return known, counted.count


def test_a_link_whose_opening_was_interrupted_anywhere_is_closed_if_it_is_known() -> None:
    known, count = _opened(None)
    assert known.is_closed
    for at in range(1, count + 1):
        known, _ = _opened(at)
        assert known.is_closed, at


def test_what_was_left_open_is_closed_with_the_run_that_opened_it_and_what_was_open_before_is_not() -> None:
    closed: list[str] = []

    @contextmanager
    def opened(name: str) -> Iterator[None]:
        with opened_here() as own:
            own.open(name, lambda: Mock(close=lambda: closed.append(name)))
            yield

    with opened("before"):
        with closing_left_open():
            left = opened("left")
            left.__enter__()
            with opened("closed by itself"):
                pass
            assert closed == ["closed by itself"]
        assert closed == ["closed by itself", "left"]
        left.__exit__(None, None, None)
    assert closed == ["closed by itself", "left", "before"]


def test_the_end_of_a_run_fails_where_what_a_callback_opened_could_not_be_closed_whatever_the_callback_does() -> None:
    unreachable = OSError("the network is gone")

    def drive() -> None:
        with suppress(OSError), opened_here() as own:
            own.open("robot", lambda: Mock(close=Mock(side_effect=unreachable)))

    with pytest.raises(OSError, match="the network is gone") as caught, closing_left_open():
        drive()
    assert caught.value is unreachable
