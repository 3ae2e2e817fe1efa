"""The phases of missions, as systems wrote them: `runs/<run id>/<plugin>/phases.csv`."""

from __future__ import annotations

import csv
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from robot_runner.analysis.sample_files import PHASES
from robot_runner.analysis.samples import PhaseSpans
from robot_runner.errors import AnalysisError
from robot_runner.storage.safe_write import storage_error

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

__all__ = ["phase_files", "phase_spans", "read_phases"]

_NEEDED = ("phase", "start_s", "end_s")
_NUMBERS = frozenset({"number", "start_s", "end_s"})


def phase_files(files: Mapping[tuple[str, str], Mapping[str, Path]]) -> dict[str, Mapping[str, Path]]:
    """Return the phases' files of each plugin that writes any: by plugin, then by run."""
    return {plugin: paths for (plugin, name), paths in files.items() if name == PHASES}


def read_phases(files: Mapping[str, Mapping[str, Path]]) -> pd.DataFrame:
    """Read phases, on the runs' clocks.

    Returns:
        One row a phase: `run_id`, `plugin`, `number`, `phase`, `start_s`, `end_s` (s on the run's clock), and whatever
        else the systems wrote.

    Raises:
        AnalysisError: a file does not say what a phase is and when.
    """
    columns = ["run_id", "plugin", "number", *_NEEDED]
    rows: list[dict[str, Any]] = []
    for plugin, paths in files.items():
        for run_id, path in paths.items():
            of_file = _rows(path)
            rows += [
                {"run_id": run_id, "plugin": plugin, "number": place} | row for place, row in enumerate(of_file, 1)
            ]
    if not rows:
        return pd.DataFrame({name: pd.Series(dtype=_type(name)) for name in columns})
    frame = pd.DataFrame(rows)
    for name in frame.columns:
        frame[name] = _typed(frame[name], must_be_number=name in _NUMBERS)
    frame = frame.dropna(subset=["start_s", "end_s"]).astype({name: _type(name) for name in columns})
    return frame[[*columns, *(name for name in frame.columns if name not in columns)]].reset_index(drop=True)


def _typed(values: pd.Series, *, must_be_number: bool) -> pd.Series:
    """Return numbers where all are; an empty cell is a missing value."""
    filled = values.replace("", None)
    numbers = pd.to_numeric(filled, errors="coerce")
    if must_be_number or (numbers.notna() == filled.notna()).all():
        return numbers
    return filled.astype("str")


def phase_spans(phases: pd.DataFrame) -> dict[str, PhaseSpans]:
    """Return the phases of each run for looking up times; of the first plugin where several wrote phases.

    Args:
        phases: as `read_phases` returns them.
    """
    spans = {}
    for run_id, of_run in phases.groupby("run_id", sort=False):
        of_plugin = of_run[of_run["plugin"] == of_run["plugin"].iloc[0]].sort_values("start_s")
        spans[str(run_id)] = PhaseSpans(
            of_plugin["start_s"].to_numpy(dtype=np.float64),
            of_plugin["end_s"].to_numpy(dtype=np.float64),
            of_plugin["number"].to_numpy(dtype=np.int16),
            tuple(of_plugin["phase"]),
        )
    return spans


def _rows(path: Path) -> list[dict[str, str]]:
    """Return the rows of one file as text; a small file is read faster so than by pandas."""
    try:
        with path.open(encoding="utf-8-sig", errors="replace", newline="") as file:
            rows = csv.DictReader(file)
            headings = rows.fieldnames or _NEEDED
            missing = [name for name in _NEEDED if name not in headings]
            if missing:
                fix = "Write the columns phase, start_s and end_s."
                raise AnalysisError(f"it has no column {missing[0]!r}", where=str(path), fix=fix)
            # The last row of a run that is being executed may be cut off.
            return [row for row in rows if None not in row and None not in row.values()]
    except OSError as error:
        raise storage_error(path, "read", error) from error


def _type(name: str) -> str:
    return {"number": "int64", "start_s": "float64", "end_s": "float64"}.get(name, "str")
