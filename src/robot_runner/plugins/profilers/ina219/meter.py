"""What every way to the sensor can do: a serial line, a recording on a card, a kernel driver."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from robot_runner.plugins.profilers.ina219.evaluation import Evaluation

__all__ = ["Meter"]


class Meter(Protocol):
    """The sensor during one run.

    Attributes:
        has_samples_at_once: whether the samples are there when the measurement has ended; else they come later.
    """

    has_samples_at_once: bool

    def begin(self) -> None:
        """Begin the measured window.

        Raises:
            LinkError: the sensor cannot be reached.
        """
        ...

    def end(self) -> None:
        """End the measured window; a second call does nothing.

        Raises:
            LinkError: the sensor was lost; the samples until then are kept.
        """
        ...

    def evaluate(self) -> Evaluation:
        """Return what was measured, after `end`.

        Raises:
            LinkError: there are no samples to be had.
        """
        ...
