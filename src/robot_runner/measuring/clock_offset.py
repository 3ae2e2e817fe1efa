"""How the clock of another computer stands to the run's: estimated before and after a run, with its uncertainty."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from robot_runner.core.errors import LinkError
from robot_runner.measuring.device_clock import ClockMap

#: No steady clock of a computer goes further wrong, parts of one: quartzes are truer than 1e-4, and what sets clocks by
#: the network hastens or delays them by 5e-4 at most (man adjtimex).
_MOST_DRIFT = 2e-3


@dataclass(frozen=True, slots=True)
class ClockExchange:
    """One question after the time, and its answer.

    Attributes:
        sent: when the question was sent, s on the run's clock.
        received: when the answer arrived, s on the run's clock.
        steady: what the computer's steady clock showed in between, s.
        wall: what the computer's wall clock showed in between, s since 1970.
        own_wall: what this machine's wall clock showed half-way between sending and receiving, s since 1970.
        resolution: of the computer's steady clock, s.
    """

    sent: float
    received: float
    steady: float
    wall: float
    own_wall: float
    resolution: float = 0.0

    @property
    def round_trip(self) -> float:
        """The seconds from the question to its answer."""
        return self.received - self.sent


@dataclass(frozen=True, slots=True)
class ClockOffset:
    """How a computer's clocks stood to this machine's at one moment.

    Attributes:
        at: the moment, s on the run's clock.
        steady: what the computer's steady clock showed then, s.
        wall_offset: how far the computer's wall clock was ahead of this machine's, s.
        round_trip: of the exchange that it comes from, s.
        uncertainty: how far both may be wrong, s: half the round trip and the resolution of the computer's clock.
        exchanges: how many there were.
    """

    at: float
    steady: float
    wall_offset: float
    round_trip: float
    uncertainty: float
    exchanges: int


def estimate_offset(exchanges: Sequence[ClockExchange]) -> ClockOffset:
    """Return the offset that the exchange with the least delay tells.

    The computer looked at its clock some time between the question and the answer. Half-way is the best guess, and it
    is wrong by half the round trip at most, however uneven the two ways are; so the quickest exchange says most.
    Source: Mills, Internet time synchronization: the Network Time Protocol (IEEE Trans. Comm. 39, 1991), whose clock
    filter picks the sample with the least delay for the same reason.

    Args:
        exchanges: with one computer, shortly after one another.

    Raises:
        LinkError: there are no exchanges.

    Example:
        >>> slow = ClockExchange(sent=10.0, received=10.5, steady=110.0, wall=3.0, own_wall=0.0)
        >>> quick = ClockExchange(sent=11.0, received=11.25, steady=111.5, wall=4.5, own_wall=1.0)
        >>> offset = estimate_offset([slow, quick])
        >>> offset.at, offset.steady, offset.wall_offset, offset.uncertainty
        (11.125, 111.5, 3.5, 0.125)
    """
    if not exchanges:
        raise LinkError("there was no exchange with its clock", where="clock offset", fix="Ask it for the time first.")
    best = min(exchanges, key=lambda each: each.round_trip)
    return ClockOffset(
        at=(best.sent + best.received) / 2,
        steady=best.steady,
        wall_offset=best.wall - best.own_wall,
        round_trip=best.round_trip,
        uncertainty=best.round_trip / 2 + best.resolution,
        exchanges=len(exchanges),
    )


@dataclass(frozen=True, slots=True)
class ClockRecord:
    """What is known of a computer's clock over a run.

    Attributes:
        host: the computer.
        before: the run.
        after: the run; None where the computer could not be asked any more.

    Example:
        >>> before = ClockOffset(at=10.0, steady=500.0, wall_offset=2.0, round_trip=0.0, uncertainty=0.0, exchanges=8)
        >>> after = ClockOffset(at=30.0, steady=521.0, wall_offset=3.0, round_trip=0.0, uncertainty=0.0, exchanges=8)
        >>> ClockRecord("pi@robot", before, after).to_run.to_run(510.5)  # half-way, on a clock that is 5 % fast
        20.0
    """

    host: str
    before: ClockOffset
    after: ClockOffset | None = None

    @property
    def to_run(self) -> ClockMap:
        """The line from the computer's steady clock to the run's; straight through both offsets, so drift is corrected.

        Between the two it is nowhere further wrong than the worse of them, as long as the drift is even. Where there
        is only the first, both clocks are taken to go equally fast.
        """
        first, last = self.before, self.after
        if last is None or last.steady <= first.steady:
            return ClockMap(first.at - first.steady)
        rate = (last.at - first.at) / (last.steady - first.steady)
        return ClockMap(first.at - rate * first.steady, rate)

    @property
    def uncertainty(self) -> float:
        """How far a time brought to the run's clock may be wrong, s."""
        return max(offset.uncertainty for offset in (self.before, self.after) if offset is not None)

    @property
    def drift(self) -> float | None:
        """By how much the computer's steady clock goes faster than this machine's, in parts of one; None if unknown."""
        if self.after is None or self.after.at <= self.before.at:
            return None
        return (self.after.steady - self.before.steady) / (self.after.at - self.before.at) - 1.0

    def doubts(self) -> Iterator[str]:
        """Yield that the steady clock stood still for a time, as that of a computer which was suspended.

        The line through both offsets is bent then, and samples stand beside their true times by up to what was lost.
        """
        if self.after is None:
            return
        here, there = self.after.at - self.before.at, self.after.steady - self.before.steady
        known = self.before.uncertainty + self.after.uncertainty
        if (off := abs(there - here)) > known + _MOST_DRIFT * here:
            yield (
                f"while {here:.3f} s went by here, the steady clock of {self.host} went on by {there:.3f} s, as where "
                f"a computer is suspended: its samples may stand up to {off:.3f} s beside their true times"
            )

    def facts(self) -> dict[str, Any]:
        """Return it as plain data, for the files and the manifest."""
        return {
            "host": self.host,
            "before": asdict(self.before),
            "after": None if self.after is None else asdict(self.after),
            "uncertainty": self.uncertainty,
            "drift": self.drift,
        }
