"""The results of an experiment as typed data frames, from its folder alone: also partial ones, also while it runs."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from robot_runner.analysis.exporting import ExportContent, export_results
from robot_runner.analysis.journal_frames import History, read_history
from robot_runner.analysis.run_frame import (
    RunFrame,
    column_descriptions,
    excluded_frame,
    quality_frame,
    read_run_frame,
)
from robot_runner.analysis.sample_files import (
    PhaseSpans,
    SampleFile,
    choose_file,
    find_sample_files,
    phase_files,
    phase_spans,
    read_phases,
    run_files,
    told_windows,
)
from robot_runner.analysis.samples import SampleRequest, read_samples
from robot_runner.core.design.analysis_plan import AnalysisPlan
from robot_runner.core.design.columns import EXCLUDED, REPETITION, RUN_ID, STATUS
from robot_runner.core.errors import AnalysisError, StorageError, did_you_mean
from robot_runner.core.events.measure import QUALITY_SUFFIX
from robot_runner.core.storage.cells import RunStatus
from robot_runner.core.storage.excluded_runs import ExcludedRuns
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.lock import holder_of
from robot_runner.core.storage.manifest import read_manifest
from robot_runner.core.storage.table_columns import ColumnRole

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import pandas as pd

    from robot_runner.core.errors import Finding
    from robot_runner.core.storage.table_schema import ColumnDescription

__all__ = ["Results", "load_results"]


@dataclass(frozen=True)
class Results:
    """Everything that an experiment's folder holds, each part read when it is first asked for.

    Attributes:
        folder: the experiment's folder.
        manifest: the circumstances, as in `manifest.json`.
        columns: what each column of the run table is, by its heading: role, type, unit, owner, origin.
        with_excluded: whether runs that were excluded are among the others.
        with_warm_ups: whether warm-up runs are among the others; else they are left out everywhere.

    Example:
        >>> results = load_results("experiments/basic_experiment")  # doctest: +SKIP
        >>> results.runs.groupby("Task", observed=True)["Energy"].mean()  # doctest: +SKIP
        >>> results.samples("Ina219", columns=["power_W"])  # doctest: +SKIP
    """

    folder: Path
    manifest: Mapping[str, Any] = field(repr=False)
    columns: Mapping[str, ColumnDescription] = field(repr=False)
    with_excluded: bool = False
    with_warm_ups: bool = False

    @property
    def name(self) -> str:
        """The experiment's name."""
        return str(self.manifest.get("experiment_name", self.folder.name))

    @property
    def factors(self) -> tuple[str, ...]:
        """The factors, without the one that only counts repetitions (as in the paper's Listing 1)."""
        return tuple(name for name in self._named(ColumnRole.FACTOR) if name != self.repetition)

    @property
    def repetition(self) -> str | None:
        """The column that counts the repetitions of a combination (ours, or a factor of that name), if there is one."""
        counted = self._named(ColumnRole.REPETITION)
        named = [name for name in self._named(ColumnRole.FACTOR) if name.casefold() == REPETITION.casefold()]
        return next(iter((*counted, *named)), None)

    @property
    def block(self) -> str | None:
        """The column of the blocks within which the order was randomised (a factor, or the repetition), if any."""
        blocks = self.manifest.get("design", {}).get("blocks")
        return blocks if blocks in self.columns else None

    @property
    def batch(self) -> str | None:
        """The column that says in which batch a run was planned, where the experiment was extended: a stratum."""
        return next(iter(self._named(ColumnRole.BATCH)), None)

    @property
    def warm_ups(self) -> tuple[str, ...]:
        """The ids of the warm-up runs, whether they are among the runs or left out."""
        return self._run_frame.warm_ups

    @property
    def measures(self) -> tuple[str, ...]:
        """The measures that have a column in the run table, in its order; columns of qualities are left out."""
        named = self._named(ColumnRole.MEASURE)
        telling = {name + QUALITY_SUFFIX for name in named}
        return tuple(name for name in named if name not in telling)

    @property
    def plan(self) -> AnalysisPlan | None:
        """What was fixed for the analysis before the experiment, or None."""
        return AnalysisPlan.of_mapping(plain) if (plain := self.manifest.get("analysis")) else None

    @property
    def seed(self) -> int | None:
        """What the order of the runs comes from; None where it is not known."""
        return None if (seed := self.manifest.get("seed")) is None else int(seed)

    @property
    def is_running(self) -> bool:
        """Whether somebody executes the experiment at this moment."""
        return holder_of(self._files.lock) is not None

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What looked odd in the run table's file."""
        return self._run_frame.findings

    def unit(self, name: str) -> str:
        """Return the unit of a column (SI symbol, `%`, `1`); empty where there is none or it is not known."""
        return self.columns[name].unit if name in self.columns else ""

    def label(self, name: str) -> str:
        """Return a heading for an axis or a table: the name with its unit in brackets, as in `Energy (J)`."""
        unit = self.unit(name)
        return f"{name} ({unit})" if unit not in {"", "1"} else name

    @property
    def runs(self) -> pd.DataFrame:
        """The run table: one row a run, in the order of the file, without the runs that were excluded.

        Columns are those of `run_table.csv`: `run_id` (str), `status` (ordered categorical), time stamps
        (datetime64, UTC), factors (ordered categoricals, in the order in which the config has the treatments), the
        repetition and the batch (Int64), whether it warms up (boolean), measures (float64, Int64, boolean or str), a
        user's own columns. What is missing is NaN, NaT or <NA>. `attrs["units"]` has the units. With `with_excluded`,
        all runs are there; where any run was ever excluded, the column `excluded` has the reason.
        """
        frame = self.all_runs
        if self.with_excluded or EXCLUDED not in frame:
            return frame
        return frame[frame[EXCLUDED].isna()].drop(columns=EXCLUDED).reset_index(drop=True)

    @property
    def all_runs(self) -> pd.DataFrame:
        """The whole run table, runs that were excluded among the others, as `runs` has it."""
        return self._run_frame.frame.copy(deep=False)

    @property
    def excluded(self) -> pd.DataFrame:
        """The runs that were excluded, as `all_runs` has them: `excluded` is the reason, `excluded_at` when (UTC)."""
        return excluded_frame(self.all_runs, ExcludedRuns.read(self._files.journal))

    @property
    def done(self) -> pd.DataFrame:
        """The rows of `runs` that are done: what statistics are computed from."""
        return self.runs[self.runs[STATUS] == RunStatus.DONE.value].reset_index(drop=True)

    @property
    def attempts(self) -> pd.DataFrame:
        """All attempts: `run_id`, `attempt`, `status` (done, failed, unfinished), `started_at`, `seconds`, `failure`.

        `seconds` are of real time, as the orchestrator saw them.
        """
        return self._history.attempts

    @property
    def published(self) -> pd.DataFrame:
        """All measures that runs published in their last attempt, with a column in the run table or without.

        One row a value: `run_id`, `measure`, `value` (object), `owner`, `origin`.
        """
        published = self._history.published
        return published if self.with_excluded else published[~published["run_id"].isin(self.excluded[RUN_ID])]

    @property
    def odd(self) -> pd.DataFrame:
        """What plugins found odd about runs: `run_id`, `attempt`, `owner`, `problem`, `fix`."""
        return self._history.odd

    @property
    def quality(self) -> pd.DataFrame:
        """How far each value of the runs that are done can be trusted, one row a value.

        Columns: `run_id`, `measure`, `quality` (ordered categorical: good, doubtful, missing) and `reasons` (text, with
        `; ` between them; empty for a good value).

        Example:
            >>> quality = load_results("experiments/basic_experiment").quality  # doctest: +SKIP
            >>> quality[quality["quality"] != "good"].groupby("measure").size()  # doctest: +SKIP
        """
        return quality_frame(self.done, self.measures, self._reasons)

    def _reasons(self, run_id: str, measure: str) -> tuple[str, ...]:
        """Return what the journal says of a value; the schema, where the journal does not know the run."""
        told = self._history.doubts.get(run_id)
        return self.columns[measure].doubts.get(run_id, ()) if told is None else told.get(measure, ())

    @property
    def readers(self) -> Mapping[str, tuple[str, ...]] | None:
        """Who read the treatment of each factor in runs that are done, or has a parameter bound to it.

        By the factor's name: plugins, and `config`. A factor that is missing was read by nobody. None where a version
        of Robot Runner executed them, or another tool, that did not look.
        """
        return self._history.readers

    def events(self, runs: Sequence[str] | None = None) -> pd.DataFrame:
        """Return the events of runs (of all for None), of the last attempt at each.

        Columns: `run_id`, `event` (ordered categorical), `at` (datetime64, UTC), `clock_s` (s on the run's clock) and
        `since_start_s` (s since the start of the mission); the last two are missing for `before_run` and
        `continue`, which take place outside the run and its clock.

        Raises:
            AnalysisError: there is no such run.
        """
        events = self._history.events
        return events[events["run_id"].isin(self._chosen(runs))].reset_index(drop=True)

    def phases(self, runs: Sequence[str] | None = None) -> pd.DataFrame:
        """Return the phases of missions (of all runs for None), as systems wrote them to `phases.csv`.

        Columns: `run_id`, the factors, `plugin`, `number`, `phase`, `start_s` and `end_s` (s since the start of the
        mission), and whatever else the system wrote, such as `task`, `x_m`, `y_m`, `heading_rad`.

        Raises:
            AnalysisError: there is no such run, or a file of phases does not say when they are.
        """
        phases = self._phases[self._phases["run_id"].isin(self._chosen(runs))]
        first = phases.groupby("run_id")["start_s"].transform("min")
        start = phases["run_id"].map(self._history.starts).astype("float64").fillna(first)
        phases = phases.assign(start_s=phases["start_s"] - start, end_s=phases["end_s"] - start)
        joined = phases.merge(self.all_runs[[RUN_ID, *self._labels]], on=RUN_ID, how="left")
        own = [name for name in joined.columns if name not in {RUN_ID, *self._labels}]
        return joined[[RUN_ID, *self._labels, *own]]

    @cached_property
    def sample_files(self) -> tuple[SampleFile, ...]:
        """The kinds of raw-sample files that there are: plugin, file, columns, and the runs that have one."""
        return find_sample_files(self._run_files)

    def samples(
        self,
        plugin: str | None = None,
        *,
        file: str | None = None,
        runs: Sequence[str] | None = None,
        columns: Sequence[str] | None = None,
        with_factors: bool = True,
        with_phases: bool = True,
        with_window: bool = True,
    ) -> pd.DataFrame:
        """Return raw samples of any or all runs as one tidy table, one row a sample.

        Columns: `run_id` (categorical), the factors (ordered categoricals), `time_s` (s since the start of the
        mission; negative before it), `in_window` (whether the sample lies in the measured window, which is the
        mission), `phase` (categorical) and `phase_number` (0 outside all phases), then the value columns as the plugin
        wrote them, such as `power_W`. Where the mission is not known, times are counted from the start of measurement,
        or from the first sample, and all samples count as within.

        Args:
            plugin: whose samples; may be left out where only one plugin has any.
            file: which file, such as `samples.csv`; may be left out where the plugin has only one kind.
            runs: ids of the runs; None for all that have samples.
            columns: the value columns; None for all. Few are read faster than many.
            with_factors: whether each row carries the treatments of its run (and the repetition).
            with_phases: whether each row carries the phase that it falls into.
            with_window: whether each row says if it lies in the measured window.

        Raises:
            AnalysisError: there are no such samples, runs or columns; names those that there are.
            StorageError: a file cannot be read.
        """
        kind = choose_file(self.sample_files, plugin, file)
        run_ids = [run_id for run_id in self._chosen(runs) if run_id in kind.paths]
        table = self.all_runs.set_index(RUN_ID).loc[run_ids]
        is_done = table[STATUS] == RunStatus.DONE.value
        windows = {**self._history.windows, **told_windows(kind, run_ids)}
        request = SampleRequest(
            kind,
            run_ids,
            tuple(kind.columns if columns is None else columns),
            starts={**self._history.starts, **{run: start for run, (start, _) in windows.items()}},
            windows=windows if with_window else None,
            phases=self._phase_spans if with_phases else None,
            factors={name: table[name].array for name in self._labels} if with_factors else {},
            unfinished=frozenset(table.index[~is_done]),
        )
        return read_samples(request)

    def export(self, folder: Path | str | None = None) -> tuple[Path, ...]:
        """Write the run table and all raw samples as Parquet, and a data package that describes everything.

        Args:
            folder: where the files go, `datapackage.json` among them; None is `export/` in the experiment's folder.

        Returns:
            The files that were written.

        Raises:
            StorageError: a file cannot be written.
        """
        everything = list(self.all_runs[RUN_ID])
        content = ExportContent(
            self.name,
            self.folder,
            {
                "run_table.parquet": self.all_runs,
                "phases.parquet": self.phases(everything),
                "events.parquet": self.events(everything),
            },
            self.sample_files,
            lambda kind, runs: self.samples(kind.plugin, file=kind.name, runs=runs),
            self.unit,
        )
        return export_results(content, None if folder is None else Path(folder))

    @property
    def _files(self) -> ExperimentFolder:
        return ExperimentFolder.found_at(self.folder)

    @property
    def _labels(self) -> list[str]:
        """The columns that say which combination a run is of: the factors, declared repetitions among them."""
        return list(self._named(ColumnRole.FACTOR))

    @cached_property
    def _run_frame(self) -> RunFrame:
        read = read_run_frame(self._files, tuple(self.columns.values()), self.manifest)
        return read if self.with_warm_ups else read.without_warm_ups()

    @cached_property
    def _history(self) -> History:
        history = read_history(self._files.journal)
        return history if self.with_warm_ups else history.without(self.warm_ups)

    @cached_property
    def _run_files(self) -> dict[tuple[str, str], dict[str, Path]]:
        return run_files(self._files, self._run_frame.frame[RUN_ID])

    @cached_property
    def _phases(self) -> pd.DataFrame:
        return read_phases(phase_files(self._run_files))

    @cached_property
    def _phase_spans(self) -> dict[str, PhaseSpans]:
        return phase_spans(self._phases)

    def _named(self, role: ColumnRole) -> tuple[str, ...]:
        return tuple(column.name for column in self.columns.values() if column.role is role)

    def _chosen(self, runs: Sequence[str] | None) -> list[str]:
        if runs is None:
            return list(self.runs[RUN_ID])
        known = list(self._run_frame.frame[RUN_ID])
        wanted = [runs] if isinstance(runs, str) else list(runs)
        for run_id in set(wanted).difference(known):
            raise AnalysisError(f"there is no run {run_id!r}", where=self.name, fix=did_you_mean(run_id, known))
        return wanted


def load_results(folder: Path | str, *, with_excluded: bool = False, with_warm_ups: bool = False) -> Results:
    """Read the results of an experiment.

    Args:
        folder: the experiment's folder: the one that holds `run_table.csv` and `manifest.json`.
        with_excluded: whether runs that were excluded (`robot-runner exclude`) are among the others. By default they
            are in `excluded` and `all_runs` alone, and in no statistics.
        with_warm_ups: whether warm-up runs are among the others; `Results.warm_ups` names them in any case.

    Raises:
        StorageError: there is no experiment here, or it cannot be read.
    """
    root = Path(folder).expanduser().resolve()
    files = ExperimentFolder.found_at(root)
    if not files.manifest.exists() and files.run_table.exists():
        fix = f"Adopt it: robot-runner import {folder}"
        raise StorageError("there is a run table here, but no manifest.json", where=str(folder), fix=fix)
    manifest = read_manifest(files.manifest)
    columns = {column.name: column for column in column_descriptions(files, manifest)}
    return Results(root, MappingProxyType(manifest), MappingProxyType(columns), with_excluded, with_warm_ups)
