"""Which columns of raw samples a report shows over the time of the mission."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

    from robot_runner.analysis.results import Results
    from robot_runner.analysis.sample_files import SampleFile

__all__ = ["SampledMeasure", "is_way", "sampled_measures"]

_MOST = 4
_UNITS = {
    "W": "W", "mW": "mW", "kW": "kW", "A": "A", "mA": "mA", "V": "V", "mV": "mV", "J": "J", "s": "s", "ms": "ms",
    "m": "m", "mm": "mm", "Hz": "Hz", "kHz": "kHz", "MHz": "MHz", "percent": "%", "pct": "%", "C": "°C", "degC": "°C",
    "K": "K", "rad": "rad", "deg": "°", "mps": "m/s", "radps": "rad/s", "B": "B", "MB": "MB", "MiB": "MiB",
}  # fmt: skip
_ACRONYMS = frozenset({"cpu", "gpu", "ram", "rss"})
#: What columns are left out because others of the same file say the same in units that people read.
_RAW = ("_raw", "_counts", "_ticks")


@dataclass(frozen=True, slots=True)
class SampledMeasure:
    """One column of raw samples.

    Attributes:
        file: where it is.
        column: its heading there, such as `power_W`.
        title: what it is, as in `Power`.
        unit: its unit; empty where the heading does not tell.
        origin: `measured`, `simulated`, `estimated`, or None.
    """

    file: SampleFile
    column: str
    title: str
    unit: str
    origin: str | None

    @property
    def label(self) -> str:
        """A heading for an axis, as in `Power (W)`."""
        return f"{self.title} ({self.unit})" if self.unit else self.title


def sampled_measures(results: Results) -> tuple[SampledMeasure, ...]:
    """Return the columns of samples that are shown: of each file power if it has any, else its first columns."""
    found: list[SampledMeasure] = []
    for file in results.sample_files:
        if not is_way(file.columns):
            found += [_measure(results, file, column) for column in _leading(file.columns)]
    return tuple(sorted(found, key=lambda each: each.unit != "W")[:_MOST])


def is_way(columns: Sequence[str]) -> bool:
    """Whether samples are places on a floor."""
    return {"x_m", "y_m"} <= set(columns)


def _leading(columns: Sequence[str]) -> list[str]:
    readable = [column for column in columns if not column.endswith(_RAW)]
    power = [column for column in readable if column.casefold().startswith("power")]
    return power[:1] or readable[:2]


def _measure(results: Results, file: SampleFile, column: str) -> SampledMeasure:
    name, _, suffix = column.rpartition("_")
    unit = _UNITS.get(suffix, "") if name else ""
    words = (name if unit else column).replace("_", " ").split()
    title = " ".join(word.upper() if word.casefold() in _ACRONYMS else word for word in words)
    return SampledMeasure(file, column, title[:1].upper() + title[1:], unit, _origin(results, file.plugin))


def _origin(results: Results, plugin: str) -> str | None:
    published = results.published
    origins = published.loc[(published["owner"] == plugin), "origin"].dropna().unique()
    return ", ".join(sorted(map(str, origins))) or None
