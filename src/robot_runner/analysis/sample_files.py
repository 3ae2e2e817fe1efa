"""The CSV files in the runs' folders: raw samples, and the phases of missions."""

from __future__ import annotations

import csv
import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from robot_runner.analysis.arrays import Floats, Numbers
from robot_runner.core.errors import AnalysisError, StorageError, did_you_mean
from robot_runner.core.events.measure import CONFIG_OWNER
from robot_runner.core.storage.guarded_files import LINE_LIMIT, open_text, open_to_read, read_json, require_file
from robot_runner.core.storage.system_refusals import storage_errors

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from robot_runner.core.storage.layout import ExperimentFolder

# Raw samples: `runs/<run id>/<plugin>/<file>.csv` with a column of times on the run's clock.

#: The name of the file in which systems write the phases of their mission.
PHASES = "phases.csv"


_CORRECT = "Correct it, or move it away."

#: Headings of the column of times, s on the run's clock; the first one in this order counts.
_TIME_HEADINGS = ("time_s", "t_s", "timestamp_s", "time", "t")


#: Units at the end of a sample column's heading, and their symbols.
_SYMBOLS = ("W", "mW", "kW", "A", "mA", "V", "mV", "J", "s", "ms", "m", "mm", "Hz", "kHz", "MHz", "K", "Pa", "N", "rad")
_UNITS = {
    **{symbol: symbol for symbol in (*_SYMBOLS, "B", "MB", "MiB")},
    "percent": "%", "pct": "%", "C": "°C", "degC": "°C", "deg": "°",
    "m_s": "m/s", "mps": "m/s", "rad_s": "rad/s", "radps": "rad/s",
}  # fmt: skip


def split_unit(heading: str) -> tuple[str, str]:
    """Split the heading of a column of samples into name and unit; the unit is empty where there is none.

    Example:
        >>> split_unit("power_W"), split_unit("speed_m_s"), split_unit("count")
        (('power', 'W'), ('speed', 'm/s'), ('count', ''))
    """
    endings = sorted((each for each in _UNITS if heading.endswith(f"_{each}")), key=len)
    name = heading[: -len(endings[-1]) - 1] if endings else ""
    return (name, _UNITS[endings[-1]]) if name else (heading, "")


@dataclass(frozen=True, slots=True)
class SampleFile:
    """One kind of raw-sample file, which a plugin writes in each run.

    Attributes:
        plugin: the plugin's name, which is also that of its folder.
        name: the file's name.
        time: the heading of its times.
        columns: the headings of its values in any of the runs.
        paths: the file of each run, by the run's id, in the order of the run table.

    Example:
        >>> SampleFile("Ina219", "samples.csv", "time_s", ("power_W",), {}).label
        'Ina219/samples.csv'
    """

    plugin: str
    name: str
    time: str
    columns: tuple[str, ...]
    paths: Mapping[str, Path] = field(repr=False)

    @property
    def label(self) -> str:
        """The plugin and the file, as a path in a run's folder."""
        return f"{self.plugin}/{self.name}"

    @property
    def run_ids(self) -> tuple[str, ...]:
        """The runs that have such a file."""
        return tuple(self.paths)


def run_files(folder: ExperimentFolder, run_ids: Iterable[str]) -> dict[tuple[str, str], dict[str, Path]]:
    """Return the CSV files in the folders of runs: by plugin and file name, then by run.

    Raises:
        StorageError: a folder cannot be read, or an entry is not a regular file: a link, a named pipe.
    """
    found: dict[tuple[str, str], dict[str, Path]] = {}
    for run_id in run_ids:
        with storage_errors(folder.run(run_id), "read"):
            run = folder.run(run_id)
            # Configs write into the run's folder itself, as those of the earlier tools do.
            for path in sorted(path for path in run.glob("*.csv") if not path.is_dir()):
                require_file(path, folder.root)
                found.setdefault((CONFIG_OWNER, path.name), {})[run_id] = path
            for path in sorted(run.glob("*/*.csv")):
                require_file(path, folder.root)
                found.setdefault((path.parent.name, path.name), {})[run_id] = path
    return found


def find_sample_files(files: Mapping[tuple[str, str], Mapping[str, Path]]) -> tuple[SampleFile, ...]:
    """Return the kinds of raw-sample files among the CSV files that `run_files` returns.

    Raises:
        StorageError: a file cannot be read.
    """
    kinds = []
    for (plugin, name), paths in sorted(files.items()):
        if name == PHASES:
            continue
        headings = {run_id: headings_of(path) for run_id, path in paths.items()}
        times = [time for cells in headings.values() if (time := _time_of(cells))]
        if times:
            time = max(set(times), key=times.count)
            usable = {run_id: path for run_id, path in paths.items() if time in headings[run_id]}
            union = dict.fromkeys(cell for run_id in usable for cell in headings[run_id] if cell and cell != time)
            kinds.append(SampleFile(plugin, name, time, tuple(union), usable))
    return tuple(kinds)


def choose_file(files: Sequence[SampleFile], plugin: str | None, name: str | None) -> SampleFile:
    """Return the only kind of file that fits.

    Raises:
        AnalysisError: none or several fit; the error names the existing ones.
    """
    if not files:
        fix = "Have runs write CSV files with a column of times, time_s (s), into context.raw_data_folder."
        raise AnalysisError("there are no raw samples", where="samples", fix=fix)
    plugins = list(dict.fromkeys(file.plugin for file in files))
    if plugin is not None and plugin not in plugins:
        raise AnalysisError(f"plugin {plugin!r} has no raw samples", where="samples", fix=did_you_mean(plugin, plugins))
    fitting = [file for file in files if plugin in {None, file.plugin}]
    names = [file.name for file in fitting]
    if name is not None and name not in names:
        raise AnalysisError(f"there is no file {name!r}", where="samples", fix=did_you_mean(name, names))
    fitting = [file for file in fitting if name in {None, file.name}]
    if len(fitting) > 1:
        labels = ", ".join(file.label for file in fitting)
        raise AnalysisError(f"several files fit: {labels}", where="samples", fix="Say which plugin and which file.")
    return fitting[0]


def noted(path: Path, root: Path | None = None) -> Any:
    """Return a plugin's notes from a JSON file; None where there is no file, or it cannot be trusted."""
    try:
        return read_json(path, root)
    except StorageError:
        return None


def noted_number(value: object) -> float | None:
    """Return a plugin's note as a number; None where it is not a finite number."""
    is_number = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    return float(value) if is_number else None  # type: ignore[arg-type]  # mypy does not follow the line above


def notes_of(folder: ExperimentFolder, run_ids: Iterable[str], pattern: str) -> Iterator[tuple[str, Path, Any]]:
    """Yield the run, the file and the notes of each JSON file that fits a pattern in the folders of runs."""
    for run_id in run_ids:
        for path in sorted(folder.run(run_id).glob(pattern)):
            yield run_id, path, noted(path, folder.root)


def noted_windows(file: SampleFile, run_ids: Iterable[str]) -> dict[str, tuple[float, float]]:
    """Return the measured windows of runs, beginning and end, s on the clock of these samples.

    A plugin notes its window in `quality.json` beside its samples; runs without a note are left out.
    """
    told = {}
    for run_id in run_ids:
        try:
            window = noted(file.paths[run_id].with_name("quality.json"))["window"]
            start, end = (float(window[edge]) for edge in ("start", "end"))
        except (ValueError, KeyError, TypeError):
            continue
        if math.isfinite(start) and math.isfinite(end):
            told[run_id] = (start, end)
    return told


def headings_of(path: Path) -> tuple[str, ...]:
    """Return the headings of a CSV file; none where it is empty.

    Raises:
        StorageError: the file cannot be read.
    """
    with open_to_read(path) as file:
        line = file.readline(LINE_LIMIT).decode("utf-8-sig", "replace")
    try:
        return tuple(next(csv.reader([line]), ()))
    except csv.Error as error:
        raise AnalysisError(f"the file's first line is not CSV: {error}", where=str(path), fix=_CORRECT) from error


def _time_of(headings: Sequence[str]) -> str | None:
    folded = {heading.strip().casefold(): heading for heading in reversed(headings)}
    return next((folded[name] for name in _TIME_HEADINGS if name in folded), None)


# The phases of missions, from files of systems (`runs/<run id>/<plugin>/phases.csv`) or from the journal.

_NEEDED = ("phase", "start_s", "end_s")
_NUMBERS = frozenset({"number", "start_s", "end_s"})


@dataclass(frozen=True, slots=True)
class PhaseSpans:
    """The phases of one run, in order; where several overlap, the one that began last.

    `starts` and `ends` are in s on the run's clock.
    """

    starts: Floats
    ends: Floats
    numbers: NDArray[np.int16]
    names: tuple[str, ...]


def read_phases(
    files: Mapping[str, Mapping[str, Path]], told: Mapping[str, Sequence[tuple[str, float, float]]]
) -> pd.DataFrame:
    """Read the files of phases; times stay on the runs' clocks.

    Args:
        files: the file of each run, by plugin.
        told: the phases of each run in the journal: name, beginning and end. Phases that a file also has are left out;
            `plugin` is missing for the others, and their numbers continue those of the files.

    Returns:
        One row a phase: `run_id`, `plugin`, `number`, `phase`, `start_s`, `end_s` (s on the run's clock), and the other
        columns of the files.

    Raises:
        AnalysisError: a file lacks a column of names or times.
    """
    columns = ["run_id", "plugin", "number", *_NEEDED]
    rows: list[dict[str, Any]] = []
    for plugin, paths in files.items():
        for run_id, path in paths.items():
            of_file = _rows(path)
            rows += [
                {"run_id": run_id, "plugin": plugin, "number": place} | row for place, row in enumerate(of_file, 1)
            ]
    in_files = {(row["run_id"], row["phase"]) for row in rows}
    counts = Counter(row["run_id"] for row in rows)
    for run_id, of_run in told.items():
        others = sorted((each for each in of_run if (run_id, each[0]) not in in_files), key=lambda each: each[1:])
        for number, (name, start, end) in enumerate(others, counts[run_id] + 1):
            rows.append(dict(zip(columns, (run_id, None, number, name, start, end), strict=True)))
    if not rows:
        return pd.DataFrame({name: pd.Series(dtype=_type(name)) for name in columns})
    frame = pd.DataFrame(rows)
    for name in frame.columns:
        frame[name] = _typed(frame[name], must_be_number=name in _NUMBERS)
    frame = frame.dropna(subset=["start_s", "end_s"]).astype({name: _type(name) for name in columns})
    return frame[[*columns, *(name for name in frame.columns if name not in columns)]].reset_index(drop=True)


def _typed(values: pd.Series, *, must_be_number: bool) -> pd.Series:
    """Return numbers where all cells are numbers; an empty cell is a missing value."""
    filled = values.replace("", None)
    numbers = pd.to_numeric(filled, errors="coerce")
    if must_be_number or (numbers.notna() == filled.notna()).all():
        return numbers
    return filled.astype("str")


def phase_spans(phases: pd.DataFrame) -> dict[str, PhaseSpans]:
    """Return the phases of each run, for looking up times."""
    spans = {}
    for run_id, of_run in phases.groupby("run_id", sort=False):
        # Of those that begin together, the one that ends first is within the others.
        ordered = of_run.sort_values(["start_s", "end_s"], ascending=[True, False])
        starts, ends = (ordered[name].to_numpy(dtype=np.float64) for name in ("start_s", "end_s"))
        places = np.arange(len(ordered))
        if (starts[1:] < ends[:-1]).any():
            starts, ends, places = _pieces(starts, ends)
        numbers = ordered["number"].to_numpy(dtype=np.int16)[places]
        spans[str(run_id)] = PhaseSpans(starts, ends, numbers, tuple(ordered["phase"].iloc[places]))
    return spans


def _pieces(starts: Floats, ends: Floats) -> tuple[Floats, Floats, Numbers]:
    """Cut overlapping spans into pieces; return their beginnings, their ends, and the last span of each piece."""
    edges = np.unique([starts, ends])
    within = [np.flatnonzero((starts <= edge) & (edge < ends)) for edge in edges[:-1]]
    filled = np.array([len(each) > 0 for each in within])
    last = np.array([each[-1] for each in within if len(each)], dtype=np.intp)
    return edges[:-1][filled], edges[1:][filled], last


def _rows(path: Path) -> list[dict[str, str]]:
    """Return the rows of one file as text; for a small file this is faster than pandas."""
    try:
        with open_text(path) as file:
            rows = csv.DictReader(file)
            headings = rows.fieldnames or _NEEDED
            missing = [name for name in _NEEDED if name not in headings]
            if missing:
                fix = "Write the columns phase, start_s and end_s."
                raise AnalysisError(f"the file has no column {missing[0]!r}", where=str(path), fix=fix)
            # The last row of a run that is being executed may be cut off.
            return [row for row in rows if None not in row and None not in row.values()]
    except csv.Error as error:
        raise AnalysisError(f"the file is not CSV: {error}", where=str(path), fix=_CORRECT) from error


def _type(name: str) -> str:
    return {"number": "int64", "start_s": "float64", "end_s": "float64"}.get(name, "str")
