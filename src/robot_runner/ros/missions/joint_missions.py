"""Several missions at the same time on one clock, each in its own thread; where one fails, the others are stopped.

The clock of a simulation moves on only in `sleep`. There the missions take turns: the one that wakes up first is
executed until it sleeps again, and the clock moves on to the next wake-up time. So they share the simulated seconds,
and the order is the same each time. On any other clock each mission sleeps by itself.
"""

from __future__ import annotations

import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from robot_runner.core.errors import PluginError, RobotRunnerError
from robot_runner.core.events.context import Clock
from robot_runner.core.events.early_end import RunInterrupted
from robot_runner.core.words import enumerated

#: How long a sleeping mission takes to notice a stop request, s.
_NOTICE = 0.05
#: The timeout for a mission to end after a stop request, s of its clock: it may cancel a goal and stop a robot.
_ENDING = 10.0
#: The same in real time, s; a mission that hangs longer is left behind, and the caller makes its system safe.
_PATIENCE = 12.0
_TICK = 1e-9


class StoppedWithOthers(RunInterrupted):
    """Raised in a mission that is stopped because another one failed, or because the run ends."""


@dataclass(slots=True)
class JointMission:
    """One of the missions that are executed together: the name of its system, for errors, and its work.

    The work sleeps on a `SharedClock`, or on the clock of a simulation. `error` is its exception.
    """

    name: str
    work: Callable[[], object]
    error: BaseException | None = None
    has_ended: bool = False
    wakes_at: float = 0.0
    told_at: float | None = None
    turn: threading.Event = field(default_factory=threading.Event)


_of_thread = threading.local()


def sleep_with_others(seconds: float) -> bool:
    """Sleep together with the other missions if this thread executes one of several; return whether it does.

    The clock of a simulation calls this first, so that links that wait on it let the other missions go on.
    """
    sleep: Callable[[float], None] | None = getattr(_of_thread, "sleep", None)
    if sleep is None:
        return False
    _of_thread.sleep = None  # the clock may call this again
    try:
        sleep(max(0.0, seconds))
    finally:
        _of_thread.sleep = sleep
    return True


def sleep_by(sleep: Callable[[float], None]) -> None:
    """Let this thread sleep by a function of its own wherever it would sleep on the clock of a simulation."""
    _of_thread.sleep = sleep


class SharedClock:
    """A run's clock for several missions: a mission that sleeps lets the others go on, and can be stopped."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock

    def __getattr__(self, name: str) -> Any:
        return getattr(self._clock, name)

    def now(self) -> float:
        """Return the time of the run's clock, s."""
        return self._clock.now()

    def sleep(self, seconds: float) -> None:
        """Sleep for so many seconds; raise a `StoppedWithOthers` if another mission failed, or the run ends."""
        if not sleep_with_others(seconds):
            self._clock.sleep(seconds)


def execute_together(missions: Sequence[JointMission], clock: Clock, *, takes_turns: bool) -> None:
    """Execute missions at the same time until all have ended; if one fails, or this is interrupted, stop the others.

    On the clock of a simulation they take turns, as only one thread at a time may sleep there.

    Raises:
        PluginError: one failed; the message says which, why, and which others were stopped or go on.
        BaseException: the interruption.
    """
    together = (_InTurns if takes_turns else _SideBySide)(missions, clock)
    try:
        together.execute()
    except BaseException as interruption:
        together.stop()
        for note in _left_behind(missions):
            interruption.add_note(note)
        raise
    failed = next((each for each in together.ended if each.error is not None), None)
    if failed is not None:
        others = [each for each in missions if not each.has_ended]
        together.stop()
        raise _failure(failed, others, together.ended)


def _failure(failed: JointMission, stopped: Sequence[JointMission], ended: Sequence[JointMission]) -> PluginError:
    error, fix = failed.error, "Look at its traceback in the run's log."
    reason = f"{type(error).__name__}: {error}"
    if isinstance(error, RobotRunnerError):
        reason, fix = error.problem, error.fix
    parts = [f"{failed.name} failed: {reason}"]
    if stopped:
        verb = "was" if len(stopped) == 1 else "were"
        parts.append(f"{enumerated([each.name for each in stopped])} {verb} stopped with it")
    others = [each for each in ended if each is not failed and not isinstance(each.error, StoppedWithOthers | None)]
    parts.extend(f"{each.name} failed, too: {each.error}" for each in others)
    made = PluginError("; ".join([*parts, *_left_behind(stopped)]), where=failed.name, fix=fix)
    made.__cause__ = error
    return made


def _left_behind(missions: Sequence[JointMission]) -> list[str]:
    return [f"{each.name} did not end within {_PATIENCE:g} s" for each in missions if not each.has_ended]


class _Together(ABC):
    """The base of both ways of execution; `ended` has the missions that are over, in the order of their ends."""

    def __init__(self, missions: Sequence[JointMission], clock: Clock) -> None:
        self.clock = clock
        self.ended: list[JointMission] = []
        self._missions = missions
        self._is_stopping = False
        self._rested = threading.Semaphore(0)
        self._threads = [
            threading.Thread(target=self._carry_out, args=(each,), name=each.name, daemon=True) for each in missions
        ]

    @abstractmethod
    def execute(self) -> None:
        """Execute all, until they have ended or one has failed."""

    @abstractmethod
    def stop(self) -> None:
        """Stop the missions that go on, and wait for them."""

    @abstractmethod
    def sleep(self, mission: JointMission, seconds: float) -> None:
        """Let a mission sleep; called in its thread."""

    @property
    def _has_failed(self) -> bool:
        return any(each.error is not None for each in self.ended)

    def _carry_out(self, mission: JointMission) -> None:
        sleep_by(partial(self.sleep, mission))
        try:
            self._begin(mission)
            mission.work()
        except BaseException as error:  # noqa: BLE001 - whatever it is, the others are stopped and it is said
            mission.error = error
        mission.has_ended = True
        self.ended.append(mission)
        self._rested.release()

    def _begin(self, mission: JointMission) -> None:
        self._check_stopped(mission)

    def _check_stopped(self, mission: JointMission) -> None:
        """Interrupt a mission that is to stop once, and again when it takes too long to end."""
        if not self._is_stopping:
            return
        now = self.clock.now()
        if mission.told_at is None or now - mission.told_at > _ENDING:
            mission.told_at = now if mission.told_at is None else mission.told_at
            raise StoppedWithOthers("the mission was stopped with the others")


class _SideBySide(_Together):
    """Executes missions on a clock that runs by itself."""

    def execute(self) -> None:
        for thread in self._threads:
            thread.start()
        while len(self.ended) < len(self._missions) and not self._has_failed:
            self._rested.acquire()

    def stop(self) -> None:
        self._is_stopping = True
        deadline = time.monotonic() + _PATIENCE
        for thread in self._threads:
            with suppress(RuntimeError):  # it was not started yet
                thread.join(max(0.0, deadline - time.monotonic()))

    def sleep(self, mission: JointMission, seconds: float) -> None:
        deadline = self.clock.now() + seconds
        self._check_stopped(mission)
        while (left := deadline - self.clock.now()) > _TICK:
            self.clock.sleep(min(left, _NOTICE))
            self._check_stopped(mission)


class _InTurns(_Together):
    """Executes missions on the clock of a simulation, which moves on while this thread sleeps on it."""

    def execute(self) -> None:
        now = self.clock.now()
        for mission, thread in zip(self._missions, self._threads, strict=True):
            mission.wakes_at = now
            thread.start()
        while (going_on := self._going_on) and not self._has_failed:
            mission = min(going_on, key=lambda each: each.wakes_at)  # the first of several
            self.clock.sleep(mission.wakes_at - self.clock.now())
            self._let_go_on(mission)

    def stop(self) -> None:
        self._is_stopping = True
        now, deadline = self.clock.now(), time.monotonic() + _PATIENCE
        for mission in self._going_on:
            mission.wakes_at = now  # at once, whatever it slept for
        while (going_on := self._going_on) and (left := deadline - time.monotonic()) > 0:
            mission = min(going_on, key=lambda each: each.wakes_at)
            with suppress(Exception):  # another callback may raise, as the one may have that caused this stop
                self.clock.sleep(mission.wakes_at - self.clock.now())
            self._let_go_on(mission, left)

    def sleep(self, mission: JointMission, seconds: float) -> None:
        self._check_stopped(mission)
        mission.wakes_at = self.clock.now() + seconds
        self._rested.release()
        self._await_turn(mission)
        self._check_stopped(mission)

    def _begin(self, mission: JointMission) -> None:
        self._await_turn(mission)
        super()._begin(mission)

    @property
    def _going_on(self) -> list[JointMission]:
        return [each for each in self._missions if not each.has_ended]

    def _let_go_on(self, mission: JointMission, seconds: float | None = None) -> None:
        """Let a mission go on until it sleeps or ends, for at most `seconds` of real time."""
        mission.turn.set()
        self._rested.acquire(timeout=seconds)

    def _await_turn(self, mission: JointMission) -> None:
        mission.turn.wait()
        mission.turn.clear()
