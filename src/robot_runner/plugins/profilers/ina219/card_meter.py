"""The meter that records on its card: the samples of a run are in a file that is copied from it after the mission."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from robot_runner.errors import LinkError
from robot_runner.plugins.profilers.ina219.card import read_card
from robot_runner.plugins.sampling.window import Window

if TYPE_CHECKING:
    from robot_runner.events.clock import Clock
    from robot_runner.plugins.profilers.ina219.card import CardRecording
    from robot_runner.plugins.profilers.ina219.evaluation import Evaluation

__all__ = ["CardMeter"]

_POLL = 0.5
#: Share of the run's own measured time by which the marked span may differ from it before it is doubted, and s that a
#: hand or an input pin may be late.
_DIFFERENCE, _REACTION = 0.05, 1.0

_MARK = "Pull the meter's input D4 to ground while the mission lasts, or evaluate the file with read_card."


class CardMeter:
    """Takes the newest span of time in which the mark was on from a file that is new since the run began.

    Args:
        file: where the file is copied to, or appears once the card is in its reader.
        clock: the run's.
        patience: how long to wait for the file, s.
        shunt_ohm: resistance of the shunt, ohm; None takes what the device says.
        rate_hz: nominal rate, Hz; None takes what the device says.
    """

    has_samples_at_once = False

    def __init__(
        self,
        file: Path | str,
        clock: Clock,
        *,
        patience: float = 0.0,
        shunt_ohm: float | None = None,
        rate_hz: float | None = None,
    ) -> None:
        self._file = Path(file).expanduser()
        self._clock = clock
        self._patience = patience
        self._shunt_ohm = shunt_ohm
        self._rate_hz = rate_hz
        self._before = _state(self._file)
        self._start = clock.now()
        self._window: Window | None = None

    def begin(self) -> None:
        """Begin the window on the run's clock; with that of the mark it is only compared."""
        self._before = _state(self._file)
        self._start = self._clock.now()

    def end(self) -> None:
        """End the window on the run's clock; a second call does nothing."""
        if self._window is None:
            self._window = Window(self._start, self._clock.now())

    def evaluate(self) -> Evaluation:
        """Wait for the file and return what its newest marked span amounts to.

        Raises:
            LinkError: the file did not come, holds no recording, or its newest recording has no mark.
        """
        self._wait()
        recording, marked = _newest(read_card(self._file), str(self._file))
        evaluation = recording.evaluate(marked, shunt_ohm=self._shunt_ohm, rate_hz=self._rate_hz)
        details = {**evaluation.details, "clock": "the device's, from the recording's first sample"}
        return replace(evaluation, doubts=(*evaluation.doubts, *self._doubts(marked)), details=details)

    def _wait(self) -> None:
        deadline = self._clock.now() + self._patience
        while _state(self._file) in {None, self._before}:
            if self._clock.now() >= deadline:
                raise LinkError(
                    f"no new recording came within {self._patience:g} s",
                    where=str(self._file),
                    fix="Copy INA219.BIN from the meter's card to it after each mission, or give card_patience_s more.",
                )
            self._clock.sleep(_POLL)

    def _doubts(self, marked: Window) -> tuple[str, ...]:
        if self._window is None:
            return ()
        lasted = self._window.duration
        if abs(marked.duration - lasted) <= _REACTION + _DIFFERENCE * lasted:
            return ()
        return (f"the mark lasted {marked.duration:.1f} s and the measurement {lasted:.1f} s: is it this run's?",)


def _newest(recordings: list[CardRecording], where: str) -> tuple[CardRecording, Window]:
    newest = recordings[-1]
    if not newest.marked:
        raise LinkError("the newest recording has no mark", where=where, fix=_MARK)
    return newest, newest.marked[-1]


def _state(file: Path) -> tuple[int, int, int] | None:
    """Return what changes when a file is replaced or written, or None where there is none."""
    try:
        found = file.stat()
    except OSError:
        return None
    return found.st_ino, found.st_size, found.st_mtime_ns
