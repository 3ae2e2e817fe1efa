"""Acting at any instruction of a function: as a signal does, which comes between two of them."""

from __future__ import annotations

import os
import sys
from typing import TYPE_CHECKING, Any, Self

if TYPE_CHECKING:
    from collections.abc import Callable
    from types import FrameType

__all__ = ["Instructions"]


class Instructions:
    """Counts the instructions that functions of some files execute in its block, and acts at one of them.

    CPython handles signals at some of them only: at the entry of a function, at backward jumps, and after calls.

    Args:
        paths: of the files, or of their folders.
        at: the number of the instruction, from 1; None to count only.
        act: called with the frame that executes it; what it raises is raised there.

    Attributes:
        count: how many there were so far.
    """

    def __init__(self, *paths: str, at: int | None, act: Callable[[FrameType], object]) -> None:
        self.count = 0
        self._paths, self._at, self._act, self._process = paths, at, act, os.getpid()

    def __enter__(self) -> Self:
        self._earlier = sys.gettrace()
        # CPython 3.12 traces opcodes only if some frame wanted them when the tracing began.
        sys._getframe().f_trace_opcodes = True
        sys.settrace(self._enter)
        return self

    def __exit__(self, *raised: object) -> None:
        sys.settrace(self._earlier)
        assert self.count, "no instruction of these files was executed"

    def _enter(self, frame: FrameType, _event: str, _argument: object) -> Any:
        if not frame.f_code.co_filename.startswith(self._paths) or os.getpid() != self._process:
            return None
        frame.f_trace = self._trace  # CPython 3.13 traces opcodes only of a frame that has one by then
        frame.f_trace_opcodes = True
        return self._trace

    def _trace(self, frame: FrameType, event: str, _argument: object) -> Any:
        if event == "opcode":
            self.count += 1
            if self.count == self._at:
                self._act(frame)
        return self._trace
