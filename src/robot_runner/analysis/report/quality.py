"""What plugins noted about their raw samples: `runs/<run id>/<plugin>/quality.json`."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from robot_runner.storage.layout import ExperimentFolder

__all__ = ["RunQuality", "read_qualities"]

_FILE = "quality.json"


@dataclass(frozen=True, slots=True)
class RunQuality:
    """How complete the samples of one plugin in one run are; what is not known is None.

    Attributes:
        expected, got: how many samples there should be, and how many there are.
        coverage: share of the measured window that has samples, percent.
        lost, corrupt, duplicates: how many samples.
        largest_gap: longest time without a sample, s.
        saturated: how many samples reached the end of the sensor's range.
        is_simulated: whether the sensor is simulated.
    """

    run_id: str
    plugin: str
    expected: int | None
    got: int | None
    coverage: float | None
    lost: int | None
    corrupt: int | None
    duplicates: int | None
    largest_gap: float | None
    saturated: int | None
    is_simulated: bool | None

    @property
    def is_complete(self) -> bool:
        """Whether nothing is known to be missing or damaged."""
        return not (self.lost or self.corrupt or (self.coverage is not None and self.coverage < 99.0))  # noqa: PLR2004 - the edges of a window


def read_qualities(folder: ExperimentFolder, run_ids: Iterable[str]) -> tuple[RunQuality, ...]:
    """Return what is known of the samples of these runs; files that are no such notes are passed over."""
    found = []
    for run_id in run_ids:
        for path in sorted(folder.run(run_id).glob(f"*/{_FILE}")):
            try:
                facts = json.loads(path.read_text(encoding="utf-8"))
            except (OSError, ValueError):
                continue
            if isinstance(facts, dict):
                found.append(_quality(run_id, path.parent.name, facts))
    return tuple(found)


def _quality(run_id: str, plugin: str, facts: Mapping[str, Any]) -> RunQuality:
    samples = facts.get("samples")
    counts: Mapping[str, Any] = samples if isinstance(samples, dict) else {}
    is_simulated = facts.get("is_simulated")
    return RunQuality(
        run_id,
        plugin,
        expected=_whole(counts.get("expected")),
        got=_whole(counts.get("got")),
        coverage=_number(counts.get("coverage")),
        lost=_whole(counts.get("lost")),
        corrupt=_whole(counts.get("corrupt")),
        duplicates=_whole(counts.get("duplicates")),
        largest_gap=_number(counts.get("largest_gap")),
        saturated=_whole(facts.get("saturated")),
        is_simulated=is_simulated if isinstance(is_simulated, bool) else None,
    )


def _number(value: object) -> float | None:
    is_number = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    return float(value) if is_number else None  # type: ignore[arg-type]  # mypy does not follow the line above


def _whole(value: object) -> int | None:
    number = _number(value)
    return None if number is None else int(number)
