"""Raw samples on disk: columns of numbers as CSV, and what is known about them as JSON."""

from __future__ import annotations

import json
from array import array
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from pathlib import Path

    from robot_runner.plugins.sampling.quality import SampleQuality
    from robot_runner.plugins.sampling.window import Window

__all__ = ["Column", "write_quality", "write_samples"]


@dataclass(frozen=True, slots=True)
class Column:
    """One column of a file of samples.

    Attributes:
        name: its heading, with the unit, such as `power_W`.
        values: its numbers; None, a missing one, leaves its cell empty.
        form: how a number is written, in printf style.

    Example:
        >>> Column("power_W", [7.5], "%.3f").form % 7.5
        '7.500'
    """

    name: str
    values: Sequence[float] | Sequence[float | None]
    form: str = "%.6f"

    def cells(self) -> Iterable[Any]:
        """Return what is written by `cell_form`."""
        return self.values if self._is_complete else ["" if one is None else self.form % one for one in self.values]

    @property
    def cell_form(self) -> str:
        """The printf form of `cells`: that of numbers where none is missing, which is far quicker for many."""
        return self.form if self._is_complete else "%s"

    @property
    def _is_complete(self) -> bool:
        return isinstance(self.values, array) or None not in self.values


def write_samples(path: Path, columns: Sequence[Column]) -> None:
    """Write columns of equal length as a CSV file with a heading, replacing what was there.

    Raises:
        ValueError: the columns are not equally long.
    """
    line = ",".join(column.cell_form for column in columns) + "\n"
    rows = zip(*(column.cells() for column in columns), strict=True)
    with path.open("w", encoding="ascii", newline="") as file:
        file.write(",".join(column.name for column in columns) + "\n")
        file.writelines(map(line.__mod__, rows))


def write_quality(path: Path, quality: SampleQuality | None, window: Window | None, details: Mapping[str, Any]) -> None:
    """Write what is known about the samples as a JSON object, with plain `details` of the sensor beside it."""
    facts = {
        "window": None if window is None else asdict(window),
        "samples": None if quality is None else asdict(quality),
        **details,
    }
    path.write_text(json.dumps(facts, indent=2, allow_nan=False) + "\n", encoding="utf-8")
