"""What the samples of a run amount to: energy, mean power, and how far they can be trusted."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from robot_runner.plugins.sampling.integration import energy, energy_from_mean_power
from robot_runner.plugins.sampling.raw_files import Column, write_quality, write_samples

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    from robot_runner.plugins.sampling.quality import SampleQuality
    from robot_runner.plugins.sampling.series import Series
    from robot_runner.plugins.sampling.window import Window

__all__ = ["Evaluation"]

#: Periods of sampling over which a sample may stand for the edge of the window, or for an edge without one beyond it.
_REACH = 5.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Evaluation:
    """The power samples of a run, wherever they came from.

    Attributes:
        window: the measured window.
        power: W, drawn by the robot, at times in s.
        quality: of the samples.
        columns: what was read, as it was read, and what it means; written beside `time_s` and `power_W`.
        details: of the meter, plain values.
        doubts: what the meter's own ways make doubtful, one sentence each.
        is_simulated: whether a simulated sensor took the samples.
    """

    window: Window
    power: Series
    quality: SampleQuality
    columns: tuple[Column, ...] = ()
    details: Mapping[str, Any]
    doubts: tuple[str, ...] = ()
    is_simulated: bool = False

    def values(self) -> Mapping[str, float | None]:
        """Return energy (J), energy as P x t (J) and mean power (W); all None where too little was seen."""
        reach = _REACH * self.quality.period
        joules = energy(self.power, self.window, reach=reach) if self.quality.is_sufficient else None
        if joules is None:
            return {"Energy": None, "EnergyPt": None, "MeanPower": None}
        return {
            "Energy": joules,
            "EnergyPt": energy_from_mean_power(self.power, self.window),
            "MeanPower": joules / self.window.duration,
        }

    def warnings(self) -> Iterator[str]:
        """Yield what is doubtful, with figures."""
        yield from self.quality.warnings()
        if not self.quality.is_sufficient and self.quality.got:
            yield "the samples do not cover the measured window, so no energy was computed from them"
        yield from self.doubts

    def write(self, folder: Path) -> None:
        """Write `samples.csv` and `quality.json`."""
        times, power = Column("time_s", self.power.times), Column("power_W", self.power.values)
        write_samples(folder / "samples.csv", (times, *self.columns, power))
        details = {"is_simulated": self.is_simulated, **self.details}
        write_quality(folder / "quality.json", self.quality, self.window, details)
