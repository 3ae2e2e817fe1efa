"""When a subject can be used: conditions about its output, and that it has not died while they are awaited."""

from __future__ import annotations

import re
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

from robot_runner.core.errors import PluginError
from robot_runner.core.events.condition import Condition, Look, LookAgain
from robot_runner.core.events.context import RobotRunnerContext
from robot_runner.core.words import one_line
from robot_runner.subjects.supervised_program import Ended, Start

_SHOWN = 80


def checked_ready(plugin: str, ready: object) -> Condition | str | re.Pattern[str] | None:
    """Return a plugin's `ready`, if it is valid.

    Raises:
        PluginError: `ready` is not a condition, text or pattern.
    """
    if ready is None or isinstance(ready, Condition):
        return ready
    text = ready.pattern if isinstance(ready, re.Pattern) else ready
    if isinstance(ready, str | re.Pattern) and isinstance(text, str) and text:  # a pattern of bytes finds none
        return ready
    fix = "Give a condition, a text that stands in its output, or re.compile(...)."
    raise PluginError(f"ready is {ready!r}", where=plugin, fix=fix)


class TextInOutput(Condition):
    """A line that a subject has written contains a text, or a match of a pattern."""

    every_s = 0.02  # the precision of StartupTime

    def __init__(self, name: str, start: Start, wanted: str | re.Pattern[str]) -> None:
        self._name = name
        self._start = start
        self._shown = wanted if isinstance(wanted, str) else wanted.pattern
        self._pattern = re.compile(re.escape(wanted)) if isinstance(wanted, str) else wanted

    def __str__(self) -> str:
        return f"{self._shown!r} stands in the output of {self._name}"

    def watch(self, context: RobotRunnerContext, opened: ExitStack) -> LookAgain:
        """Begin at the first line that it wrote."""
        del context, opened
        outputs = [_Lines(path) for path in (self._start.stdout, self._start.stderr)]
        last = "nothing was written yet; a program may keep back what it writes to a file (stdbuf -oL ends that)"

        def look() -> Look:
            nonlocal last
            for output in outputs:
                for line in output.fresh():
                    last = one_line(line.strip())[:_SHOWN] or last
                    if self._pattern.search(line):
                        return Look(holds=True, seen=last, value=last)
            return Look(holds=False, seen=last)

        return look


class _Lines:
    """The lines of a growing file; one without an end yet is read again."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._offset = 0

    def fresh(self) -> list[str]:
        with self._path.open("rb") as file:
            file.seek(self._offset)
            data = file.read()
        *whole, rest = data.split(b"\n")
        self._offset += len(data) - len(rest)
        return [line.decode(errors="replace") for line in (*whole, rest)]


class Ready(Condition):
    """A subject can be used, and has not died meanwhile.

    `wanted` is as `checked_ready` returns it; None only requires that it was started.
    """

    def __init__(
        self,
        name: str,
        start: Start,
        wanted: Condition | str | re.Pattern[str] | None,
        *,
        may_end: Callable[[Ended], bool],
    ) -> None:
        condition = TextInOutput(name, start, wanted) if isinstance(wanted, str | re.Pattern) else wanted
        self._name = name
        self._start = start
        self._condition = condition
        self._may_end = may_end
        self.every_s = self.every_s if condition is None else min(self.every_s, condition.every_s)

    def __str__(self) -> str:
        return str(self._condition) if self._condition is not None else "the program was started"

    def watch(self, context: RobotRunnerContext, opened: ExitStack) -> LookAgain:
        """Watch the condition, and whether the subject has died: then waiting is in vain."""
        look_again = self._condition.watch(context, opened) if self._condition is not None else lambda: Look(holds=True)

        def look() -> Look:
            ended = self._start.ended()
            seen = look_again()
            if ended is not None and not (seen.holds and self._may_end(ended)):
                fix = "Execute it by hand to see why."
                raise PluginError(self._start.death(self._name, ended), where=context.owner, fix=fix)
            return seen

        return look
