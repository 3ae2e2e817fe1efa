"""The rules for every condition, as tests for its author to inherit."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import ClassVar

from robot_runner.core.errors import ConditionTimeout, Finding
from robot_runner.core.events.condition import Condition, Look, LookAgain
from robot_runner.core.events.context import RobotRunnerContext
from robot_runner.core.links.connect import SIMULATED
from robot_runner.testing.fake_run import FakeClock, FakeLinks, make_context
from robot_runner.testing.plugin_contract import require

#: The timeout for beginning to watch, s: it must not delay a run.
_SOON = 20.0
#: The timeout for a condition that holds, or is about to, s of the condition's clock.
_PATIENCE = 30.0
#: How long a condition that never holds is awaited, s of its clock.
_IN_VAIN = 0.3


class ConditionContract:
    """The rules that a condition must keep to; pytest finds the tests in a subclass whose name begins with `Test`.

    Attributes:
        robot: how the robot is reached in the tests.

    Example:
        >>> from robot_runner import text_in
        >>> from robot_runner.testing import ConditionContract
        >>> class TestTextIn(ConditionContract):
        ...     robot = None
        ...     def make_condition(self):
        ...         return text_in("server.txt", "ready")
        ...     def make_it_hold(self, context):
        ...         (context.run_folder / "server.txt").write_text("ready")
    """

    robot: ClassVar[str | None] = SIMULATED

    def make_condition(self) -> Condition:
        """Return an equal condition at each call; for the author to write."""
        raise NotImplementedError("write make_condition(self), which returns the condition to test")

    def make_it_hold(self, context: RobotRunnerContext) -> None:
        """Make the condition hold, which it must not do before."""
        raise NotImplementedError("write make_it_hold(self, context), which makes the condition hold")

    def make_links(self, clock: FakeClock) -> FakeLinks | None:
        """Return fakes in place of the robot's links; None, the default, uses the robot that `robot` names."""
        del clock
        return None

    @contextmanager
    def run(self, folder: Path) -> Iterator[RobotRunnerContext]:
        """Open a run, whose resources are closed at its end."""
        clock = FakeClock()
        links = self.make_links(clock)
        context = make_context(folder, robot=self.robot, links=links, clock=clock if links is not None else None)
        try:
            yield context
        finally:
            context.resources.close()

    def test_it_says_what_is_to_hold_in_one_line(self) -> None:
        """Check that its text completes the sentence "waiting until ..."."""
        said = str(self.make_condition())
        require(said.strip() and "\n" not in said, f"the condition says {said!r}: write __str__, one line")
        require(not said.endswith("."), f"{said!r} ends a sentence; it has to stand in the middle of one")

    def test_its_check_speaks_in_findings(self) -> None:
        """Check that `check` has no findings where the condition works, and says what to do elsewhere."""
        errors = [str(finding) for finding in self.make_condition().check(self.robot) if finding.is_error]
        require(not errors, f"the condition's check refuses the circumstances of these tests: {errors}")
        for finding in self.make_condition().check(None):
            require(isinstance(finding, Finding), f"the condition's check returned {finding!r}, which is not a Finding")
            require(finding.fix or not finding.is_error, f"a finding offers no fix: {finding}")

    def test_it_holds_once_what_it_asks_for_is_there(self, tmp_path: Path) -> None:
        """Check that the condition does not hold before, and that the wait ends as soon as it does."""
        with self.run(tmp_path) as context, ExitStack() as opened:
            condition = self.make_condition()
            look = self._watched(condition, context, opened)()
            require(isinstance(look, Look), f"a look returned {look!r}, which is not a Look")
            require(not look.holds, f"it holds that {condition} before it was made to: {look.seen}")
            require("\n" not in look.seen, f"what was seen has several lines: {look.seen!r}")
            self.make_it_hold(context)
            require(condition.wait(context, timeout_s=_PATIENCE).holds, f"it does not hold that {condition}")

    def test_a_wait_in_vain_tells_what_was_awaited(self, tmp_path: Path) -> None:
        """Check that a wait ends after its timeout, and that the error says what was awaited."""
        with self.run(tmp_path) as context:
            condition = self.make_condition()
            try:
                condition.wait(context, timeout_s=_IN_VAIN)
            except ConditionTimeout as error:
                require(str(condition) in error.problem, f"the error does not say what was awaited: {error}")
            else:
                raise AssertionError(f"it holds that {condition} although nothing made it hold")

    def test_two_watches_know_nothing_of_each_other(self, tmp_path: Path) -> None:
        """Check that one object can be used in several runs at once: state must belong to a watch."""
        with self.run(tmp_path / "one") as first, self.run(tmp_path / "other") as second, ExitStack() as opened:
            condition = self.make_condition()
            before = dict(vars(condition)) if hasattr(condition, "__dict__") else {}
            look = self._watched(condition, second, opened)
            self._watched(condition, first, opened)()
            require(not look().holds, f"it holds that {condition} in a run in which nothing made it hold")
            after = dict(vars(condition)) if hasattr(condition, "__dict__") else {}
            require(before == after, "watching changed the condition: keep what a look needs in `watch`")

    def test_what_was_opened_is_closed(self, tmp_path: Path) -> None:
        """Check that no thread is left once the watch and the run have ended."""
        before = set(threading.enumerate())
        with self.run(tmp_path) as context, ExitStack() as opened:
            self._watched(self.make_condition(), context, opened)()
        deadline = time.monotonic() + _SOON
        while (left := set(threading.enumerate()) - before) and time.monotonic() < deadline:
            time.sleep(0.01)
        require(
            not left, f"these threads go on: {sorted(thread.name for thread in left)}; close with `opened.callback`"
        )

    @staticmethod
    def _watched(condition: Condition, context: RobotRunnerContext, opened: ExitStack) -> LookAgain:
        began = time.monotonic()
        look_again = condition.watch(context, opened)
        require(time.monotonic() - began < _SOON, "watch() takes long: it is to begin, and not to wait")
        return look_again
