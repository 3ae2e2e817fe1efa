"""Whether two configs plan the same run table."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

from robot_runner.dialects.conversion.run_tables import ONLY_FACTOR
from robot_runner.errors import Finding

if TYPE_CHECKING:
    from collections.abc import Iterator

    from robot_runner.config.experiment import Experiment

__all__ = ["differences"]

Run = tuple[tuple[str, str], ...]


def differences(before: Experiment, after: Experiment) -> Iterator[Finding]:
    """Yield what the run table of one config has and that of the other lacks; ids are each tool's own."""
    old, new = _runs(before), _runs(after)
    if not before.model.factors and [factor.name for factor in after.model.factors] == [ONLY_FACTOR]:
        old = [((ONLY_FACTOR, str(after.model.factors[0].treatments[0])),)] * len(old)
        yield Finding.warning(
            "run table",
            f"nothing is varied, so there is a factor {ONLY_FACTOR!r} with one treatment",
            "Name what you will compare it with.",
        )
    for run, count in (Counter(old) - Counter(new)).items():
        yield Finding.error("run table", f"{_shown(run)} is planned {count} times less than before", "Mend it by hand.")
    for run, count in (Counter(new) - Counter(old)).items():
        yield Finding.error("run table", f"{_shown(run)} is planned {count} times more than before", "Mend it by hand.")
    is_random = before.model.shuffle or after.model.shuffle
    if Counter(old) == Counter(new) and old != new and not is_random:
        yield Finding.error("run table", "the order of the runs is another", "Mend it by hand.")
    lost = set(before.columns.names) - set(after.columns.names)
    if lost:
        yield Finding.warning(
            "run table",
            f"there is no column {', '.join(map(repr, sorted(lost)))} any more",
            "Add it to data_columns, unless a plugin has it under another name.",
        )


def _runs(experiment: Experiment) -> list[Run]:
    return [tuple((name, str(value)) for name, value in run.combination.items()) for run in experiment.model.plan()]


def _shown(run: Run) -> str:
    return ", ".join(f"{name}={value}" for name, value in run)
