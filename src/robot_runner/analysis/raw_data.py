"""The raw samples of an experiment: their files, their runs, and their times relative to the mission."""

from __future__ import annotations

import math
from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import pandas as pd

from robot_runner.analysis.alignment import (
    Aligned,
    AlignedColumn,
    AlignedSamples,
    Resampling,
    align_values,
    grid_of,
    median_period,
)
from robot_runner.analysis.arrays import Floats
from robot_runner.analysis.journal_frames import History, journal_phases
from robot_runner.analysis.lazy_samples import LazySamples
from robot_runner.analysis.run_frame import require_choice, several
from robot_runner.analysis.sample_files import (
    PHASES,
    PhaseSpans,
    SampleFile,
    choose_file,
    find_sample_files,
    noted,
    noted_number,
    noted_windows,
    phase_spans,
    read_phases,
    split_unit,
)
from robot_runner.analysis.samples import SampleRequest, labels_of, read_samples
from robot_runner.core.design.columns import RUN_ID, STATUS
from robot_runner.core.errors import AnalysisError, did_you_mean
from robot_runner.core.storage.cells import RunStatus


@dataclass(frozen=True)
class RawData:
    """The files in the runs' folders.

    Attributes:
        files: the CSV files, as `run_files` returns them.
        runs: the run table.
        factors: the columns that tell the combination of a run.
        history: the records of the journal.
        journal: the journal's file.
    """

    files: Mapping[tuple[str, str], Mapping[str, Path]]
    runs: pd.DataFrame
    factors: Sequence[str]
    history: History
    journal: Path

    @cached_property
    def sample_files(self) -> tuple[SampleFile, ...]:
        """The kinds of files of raw samples."""
        return find_sample_files(self.files)

    @cached_property
    def phases(self) -> pd.DataFrame:
        """The phases of missions, on the runs' clocks."""
        files = {plugin: paths for (plugin, name), paths in self.files.items() if name == PHASES}
        return read_phases(files, journal_phases(self.journal))

    @cached_property
    def phase_spans(self) -> dict[str, PhaseSpans]:
        """The phases of each run."""
        return phase_spans(self.phases)

    def known_runs(self, runs: str | Sequence[str], *, where: str) -> list[str]:
        """Return the ids of runs, one or several, as a list.

        Raises:
            AnalysisError: there is no such run.
        """
        known = list(self.runs[RUN_ID])
        wanted = list(dict.fromkeys(several(runs)))
        for run_id in set(wanted).difference(known):
            raise AnalysisError(f"there is no run {run_id!r}", where=where, fix=did_you_mean(run_id, known))
        return wanted

    def mission_phases(self, runs: Sequence[str]) -> pd.DataFrame:
        """Return the phases of runs, s since the start of the mission; see `Results.phases`."""
        phases = self.phases[self.phases["run_id"].isin(runs)]
        first = phases.groupby("run_id")["start_s"].transform("min")
        start = phases["run_id"].map(self.history.starts).astype("float64").fillna(first)
        phases = phases.assign(start_s=phases["start_s"] - start, end_s=phases["end_s"] - start)
        headings = self._headings(phases.columns)
        treatments = self.runs[[RUN_ID, *self.factors]].rename(columns=headings)
        own = [name for name in phases.columns if name != RUN_ID]
        return phases.merge(treatments, on=RUN_ID, how="left")[[RUN_ID, *headings.values(), *own]]

    def request(
        self,
        kind: SampleFile,
        runs: Iterable[str],
        columns: str | Sequence[str] | None,
        *,
        with_factors: bool = True,
        with_phases: bool = True,
        with_window: bool = True,
    ) -> SampleRequest:
        """Return the request for those of these runs that have such a file; see `Results.samples`."""
        run_ids = [run_id for run_id in runs if run_id in kind.paths]
        table = self.runs.set_index(RUN_ID).loc[run_ids]
        is_done = table[STATUS] == RunStatus.DONE.value
        windows = {**self.history.windows, **noted_windows(kind, run_ids)}
        wanted = tuple(kind.columns if columns is None else dict.fromkeys(several(columns)))
        within = ("in_window",) if with_window else ()
        phases = ("phase", "phase_number") if with_phases else ()
        return SampleRequest(
            kind,
            run_ids,
            wanted,
            starts={**self.history.starts, **{run: start for run, (start, _) in windows.items()}},
            windows=windows if with_window else None,
            phases=self.phase_spans if with_phases else None,
            factors=self._treatments(table, ("time_s", *within, *phases, *wanted)) if with_factors else {},
            unfinished=frozenset(table.index[~is_done]),
        )

    def _treatments(self, table: pd.DataFrame, taken: Container[str]) -> dict[str, pd.Categorical]:
        return {heading: table[name].array for name, heading in self._headings(taken).items()}

    def _headings(self, taken: Container[str]) -> dict[str, str]:
        """Return the heading of each factor beside columns of these names: another one where a name is taken."""
        return {name: f"{name} (factor)" if name in taken else name for name in self.factors}

    def with_treatments(self, run_ids: Iterable[str], treatments: Mapping[str, object]) -> list[str]:
        """Return the runs with these treatments.

        Raises:
            AnalysisError: there is no such factor or treatment.
        """
        table = self.runs.set_index(RUN_ID).loc[list(run_ids)]
        for factor, wanted in treatments.items():
            if factor not in self.factors:
                fix = did_you_mean(factor, self.factors)
                raise AnalysisError(f"there is no factor {factor!r}", where="samples", fix=fix)
            all_of = list(table[factor].cat.categories)
            given = wanted.tolist() if hasattr(wanted, "tolist") else wanted  # of NumPy and pandas
            chosen = given if isinstance(given, list | tuple | set | frozenset) else [given]
            words = {str(next((known for known in all_of if known == each), each)) for each in chosen}  # 1.0 means 1
            known = list(map(str, all_of))
            for word in words.difference(known):
                problem, fix = f"factor {factor!r} has no treatment {word!r}", did_you_mean(word, known)
                raise AnalysisError(problem, where="samples", fix=fix)
            table = table[table[factor].astype("str").isin(words)]
        return list(table.index)

    def lazy(self, request: SampleRequest, *, within_window: bool, phases: str | Sequence[str] | None) -> LazySamples:
        """Return samples that are read only when they are used.

        Raises:
            AnalysisError: there is no such phase.
        """
        if phases is None:
            return LazySamples(request, within_window)
        known, chosen = list(self.phases["phase"].unique()), several(phases)
        for name in chosen:
            if name not in known:
                raise AnalysisError(f"there is no phase {name!r}", where="samples", fix=did_you_mean(name, known))
        # Only the chosen phases: while two phases overlap, a sample belongs to both.
        return LazySamples(request, within_window, phase_spans(self.phases[self.phases["phase"].isin(chosen)]))

    def aligned(
        self, columns: Mapping[str, str | Sequence[str]], run_ids: Sequence[str], period: float, how: Resampling
    ) -> AlignedSamples:
        """Return samples of several profilers on one time grid, run by run; see `Results.aligned_samples`."""
        if not (math.isfinite(period) and period > 0):
            fix = "Give seconds, as in 0.1."
            raise AnalysisError(f"{period!r} is not a period of a grid", where="aligned samples", fix=fix)
        if not columns:
            fix = "Name them by plugin, as in {'Ina219': ['power_W']}."
            raise AnalysisError("no columns are given", where="aligned samples", fix=fix)
        require_choice(how, Resampling, "resampling", "aligned samples")
        sources = [_Source.of(self.sample_files, label, several(names)) for label, names in columns.items()]
        shared = [run_id for run_id in run_ids if all(run_id in source.kind.paths for source in sources)]
        headings = [source.heading(name) for source in sources for name in source.names]
        columns_of_all = (1 + len(headings)) * len(shared)
        found = (self._aligned_run(run_id, sources, period, how, columns_of_all) for run_id in shared)
        pieces = [piece for piece in found if piece is not None]
        frame = pd.concat(pieces, ignore_index=True) if pieces else pd.DataFrame(columns=["time_s", *headings])
        lengths = np.array([len(piece) for piece in pieces], dtype=np.int64)
        table = self.runs.set_index(RUN_ID).loc[[str(piece.attrs["run"]) for piece in pieces]]
        labels = labels_of(list(table.index), self._treatments(table, frame.columns), lengths)
        frame = pd.concat([pd.DataFrame(labels), frame], axis=1)
        told = tuple(source.told(name, frame) for source in sources for name in source.names)
        return AlignedSamples(frame, period, how, told)

    def _aligned_run(
        self, run_id: str, sources: Sequence[_Source], period: float, how: Resampling, columns: int
    ) -> pd.DataFrame | None:
        """Return the columns of one of the runs; None where a source has no samples of it."""
        read = [self._numbers(source, run_id) for source in sources]
        if any(not len(times) for times, _ in read):
            return None
        window = self.history.windows.get(run_id)
        length = None if window is None else (0.0, window[1] - window[0])
        spans = [(float(times[0]), float(times[-1])) for times, _ in read]
        grid = grid_of(spans, period, length, columns=columns)
        data: dict[str, Floats] = {"time_s": grid}
        for source, (times, values) in zip(sources, read, strict=True):
            source.take(run_id, times, self.history.uncertainties.get(run_id, {}))
            for name in source.names:
                made = align_values(times, values[name], grid, period, how)
                data[source.heading(name)] = made.course
                source.count(name, made)
        piece = pd.DataFrame(data)
        piece.attrs["run"] = run_id
        return piece

    def _numbers(self, source: _Source, run_id: str) -> tuple[Floats, dict[str, Floats]]:
        """Return the times of a run's samples, ascending, and the values of each column.

        Raises:
            AnalysisError: a column is not numeric.
        """
        request = self.request(source.kind, [run_id], source.names, with_factors=False, with_phases=False)
        samples = read_samples(request).dropna(subset=["time_s"]).sort_values("time_s", kind="stable")
        for name in source.names:
            if samples[name].dtype.kind not in "biuf":
                fix = "Choose columns of numbers; read texts with Results.samples."
                raise AnalysisError(f"column {name!r} holds no numbers", where=source.kind.label, fix=fix)
        times = samples["time_s"].to_numpy(dtype=np.float64)
        return times, {name: samples[name].to_numpy(dtype=np.float64) for name in source.names}


class _Source:
    """One profiler's columns in aligned samples, with the counts that grow while runs are aligned."""

    def __init__(self, kind: SampleFile, names: tuple[str, ...]) -> None:
        self.kind, self.names = kind, names
        self._periods: list[float] = []
        self._uncertainties: list[float] = []
        self._interpolated = dict.fromkeys(names, 0)

    @classmethod
    def of(cls, kinds: Sequence[SampleFile], label: str, names: Sequence[str]) -> _Source:
        """Return the source of a plugin, or of plugin and file as in `Meter/packets.csv`."""
        plugin, _, file = label.partition("/")
        return cls(choose_file(kinds, plugin, file or None), tuple(dict.fromkeys(names)))

    def heading(self, name: str) -> str:
        return f"{self.kind.plugin}.{name}"

    def take(self, run_id: str, times: Floats, uncertainties: Mapping[str, float]) -> None:
        self._periods.append(median_period(times))
        noted = _noted_uncertainty(self.kind.paths[run_id].with_name("quality.json"))
        told = (uncertainties.get(self.kind.plugin), noted)
        self._uncertainties += [each for each in told if each is not None]

    def count(self, name: str, made: Aligned) -> None:
        self._interpolated[name] += int(np.count_nonzero(made.is_interpolated))

    def told(self, name: str, frame: pd.DataFrame) -> AlignedColumn:
        count = max(1, len(frame))
        return AlignedColumn(
            self.heading(name),
            split_unit(name)[1],
            float(np.nanmedian(self._periods)) if np.isfinite(self._periods).any() else float("nan"),
            100 * self._interpolated[name] / count,
            100 * int(frame[self.heading(name)].isna().sum()) / count,
            max(self._uncertainties, default=None),
        )


def _noted_uncertainty(path: Path) -> float | None:
    """Return how far the times of a meter with its own clock may be off, s, as its plugin noted it."""
    try:
        return noted_number(noted(path)["samples"]["clock_uncertainty"])
    except (KeyError, TypeError):
        return None
