"""The guards of an experiment: conditions that are watched while a run is measured, and their actions."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import ExitStack
from itertools import count

from robot_runner.core.config.gate_parameters import Guard, GuardAction
from robot_runner.core.config.parameters import Parameters
from robot_runner.core.events.condition import LookAgain
from robot_runner.core.events.context import RobotRunnerContext, SystemClock
from robot_runner.core.plugin import Plugin, Profiler
from robot_runner.measuring.periodic import PeriodicSampler

_FIX = "Repeat the run once the cause is gone, or leave its values out."


class GuardWatch(Profiler):
    """Watches the `guards` of a config during the measurement.

    On a real robot it looks in a thread of its own. On a simulated clock it looks while that is slept on, but at
    conditions that are outside of the simulation in real time.

    Args:
        guards: conditions and actions.
        name: of the plugin.

    Example:
        >>> from robot_runner import Guard, battery_below
        >>> GuardWatch([Guard(battery_below(15))]).name
        'guards'
    """

    probe_s: float | None = None
    bytes_per_run: int = 0

    def __init__(self, guards: Sequence[Guard], *, name: str = "guards") -> None:
        super().__init__(name=name)
        self.guards = tuple(guards)
        self._watched: list[_WatchedGuard] = []

    def claims(self, robot: str | None) -> Iterable[str]:
        """Return no claims, as watching disturbs nothing."""
        del robot
        return ()

    def start_measurement(self, context: RobotRunnerContext) -> None:
        """Begin to watch, before other profilers begin."""
        self._watched = []
        for guard in self.guards:
            watched = _WatchedGuard(guard, context)
            self._watched.append(watched)
            watched.begin()

    def stop_measurement(self, context: RobotRunnerContext) -> None:
        """Look once more, after other profilers have ended, and end watching."""
        del context
        with ExitStack() as ending:  # each of them, whatever another one raises
            for watched in self._watched:
                ending.callback(watched.end)
        self._watched = []

    def stop_run(self, context: RobotRunnerContext) -> None:
        """Close what is still open where the measurement never began."""
        self.stop_measurement(context)


class _WatchedGuard:
    """One guard during one run."""

    def __init__(self, guard: Guard, context: RobotRunnerContext) -> None:
        self._guard = guard
        self._context = context
        self._opened = ExitStack()
        self._look_again: LookAgain | None = None
        self._has_come_true = False
        self._was_known = False
        self._unknown = ""
        # Real time for a condition outside of the simulation.
        self._clock = SystemClock() if guard.condition.is_outside else context.clock
        self._began = context.clock.now()
        self._sampler = PeriodicSampler(self._look, rate=1 / guard.condition.every_s, clock=self._clock)

    def begin(self) -> None:
        self._look_again = self._guard.condition.watch(self._context, self._opened)
        self._sampler.start()

    def end(self) -> None:
        with self._opened:
            if self._look_again is None:
                return
            sampling = self._sampler.stop()
            self._look_again = None  # a look that hangs may come back later
            if sampling.failures:
                problem = f"the guard {str(self._guard.condition)!r} could not be watched {sampling.failures} times"
                fix = "Look at what it asks for; nothing is known of it for these times."
                self._context.warn(f"{problem}: {sampling.first_failure}", fix=fix)
            self._tell_whether_blind()

    def _tell_whether_blind(self) -> None:
        """Doubt the run where the condition was never known, or not at the end: it may have come true."""
        if self._unknown and not self._has_come_true:
            how = "knew nothing any more in the end" if self._was_known else "watched nothing"
            reason = f"the guard {str(self._guard.condition)!r} {how}: {self._unknown}"
            self._context.broker.doubt_run(self._context.owner, reason, _FIX)

    def _look(self) -> None:
        if self._has_come_true or self._look_again is None:
            return
        self._unknown = "a look at it has not come back"
        try:
            look = self._look_again()
        except Exception as error:
            self._unknown = f"{type(error).__name__}: {error}"
            raise
        self._was_known = self._was_known or look.is_known
        self._unknown = "" if look.is_known else look.seen or "it is not known"
        if look.holds and self._look_again is not None:
            self._has_come_true = True
            self._act(look.seen)

    def _act(self, seen: str) -> None:
        context, condition = self._context, str(self._guard.condition)
        action = self._guard.action
        if action is GuardAction.REPEAT and not context.attempts_left:
            action = GuardAction.MARK  # the last attempt's values are kept, with the reason
        after = context.clock.now() - self._began
        reason = f"{after:.1f} s after the measurement began, {condition}" + (f" ({seen})" if seen else "")
        facts = {"condition": condition, "action": action.value, "seen": seen, "after": round(after, 3)}
        context.broker.note(context.owner, "guard", {**facts, "problem": reason})
        if action is GuardAction.MARK:
            context.broker.doubt_run(context.owner, reason, _FIX)
        else:
            context.fail(reason)


def watch_guards(parameters: Parameters, plugins: Iterable[Plugin]) -> list[Plugin]:
    """Return the plugin for the guards of a config, if it has any."""
    if not parameters.guards:
        return []
    names = {plugin.name.casefold() for plugin in plugins}
    free = next(name for number in count(1) if (name := "guards" if number == 1 else f"guards-{number}") not in names)
    return [GuardWatch(parameters.guards, name=free)]
