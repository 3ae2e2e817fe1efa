"""The results of an experiment as typed data frames, from its folder alone, also partial ones and while it runs."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from robot_runner.analysis.alignment import AlignedSamples, Resampling
from robot_runner.analysis.exporting import export_results
from robot_runner.analysis.journal_frames import History, read_history
from robot_runner.analysis.raw_data import RawData
from robot_runner.analysis.run_frame import (
    ExperimentFacts,
    RunFrame,
    excluded_frame,
    quality_frame,
    read_run_frame,
)
from robot_runner.analysis.sample_files import SampleFile, choose_file, run_files
from robot_runner.analysis.samples import read_samples
from robot_runner.core.design.columns import EXCLUDED, RUN_ID, STATUS
from robot_runner.core.errors import Finding, StorageError
from robot_runner.core.events.measure import OPERATOR_OWNER, Quality
from robot_runner.core.storage.cells import RunStatus
from robot_runner.core.storage.executed_runs import ExcludedRuns
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.lock import holder_of
from robot_runner.core.storage.manifest import read_manifest
from robot_runner.core.storage.table_columns import ColumnRole
from robot_runner.core.storage.table_schema import read_schema

if TYPE_CHECKING:
    import pandas as pd

    from robot_runner.analysis.lazy_samples import LazySamples


@dataclass(frozen=True)
class Results(ExperimentFacts):
    """The contents of an experiment's folder; each part is read when it is first used.

    Attributes:
        folder: the experiment's folder.
        manifest: the circumstances, as in `manifest.json`.
        columns: role, type, unit, owner and origin of each column of the run table, by its heading.
        with_excluded: whether excluded runs are included.
        with_warm_ups: whether warm-up runs are included; otherwise they are left out everywhere.
        only_confirming: whether runs of a search are left out everywhere; see `confirming`.

    Example:
        >>> results = load_results("experiments/basic_experiment")  # doctest: +SKIP
        >>> results.runs.groupby("Task", observed=True)["Energy"].mean()  # doctest: +SKIP
        >>> results.samples("Ina219", columns=["power_W"])  # doctest: +SKIP
    """

    with_excluded: bool = False
    with_warm_ups: bool = False
    only_confirming: bool = False

    @property
    def confirming(self) -> Results:
        """The results with only the runs of the planned analysis.

        Where an adaptive design confirmed its findings, these are the confirming runs; otherwise all runs. Statistics
        and reports use these.
        """
        return replace(self, only_confirming=True) if self.confirming_batches and self.batch else self

    @property
    def with_exploration(self) -> Results:
        """The results with all runs, including those of a design's search."""
        return replace(self, only_confirming=False) if self.only_confirming else self

    @property
    def is_exploratory(self) -> bool:
        """Whether these are runs of a search, for which no test is valid: the best of many looks better than it is."""
        return self.is_adaptive and not self.only_confirming

    @property
    def warm_ups(self) -> tuple[str, ...]:
        """The ids of the warm-up runs, whether they are included or left out."""
        return self._run_frame.warm_ups

    @property
    def is_running(self) -> bool:
        """Whether the experiment is being executed at this moment."""
        return holder_of(self._files.lock) is not None

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Anomalies of the run table's file."""
        return self._run_frame.findings

    @property
    def runs(self) -> pd.DataFrame:
        """The run table: one row a run, in the order of the file, without excluded runs.

        Columns are those of `run_table.csv`: `run_id` (str), `status` (ordered categorical), time stamps
        (datetime64, UTC), factors (ordered categoricals, in the config's order of treatments), the
        repetition and the batch (Int64), whether it warms up (boolean), measures (float64, Int64, boolean or str), a
        user's own columns. What is missing is NaN, NaT or `<NA>`. `attrs["units"]` has the units. With
        `with_excluded`, all runs are there; where any run was ever excluded, the column `excluded` has the reason.
        """
        frame = self.all_runs
        if self.with_excluded or EXCLUDED not in frame:
            return frame
        return frame[frame[EXCLUDED].isna()].drop(columns=EXCLUDED).reset_index(drop=True)

    @property
    def all_runs(self) -> pd.DataFrame:
        """The whole run table, with excluded runs; columns as in `runs`."""
        return self._run_frame.frame.copy(deep=False)

    @property
    def excluded(self) -> pd.DataFrame:
        """The excluded runs, as in `all_runs`: `excluded` is the reason, `excluded_at` the time (UTC)."""
        return self._excluded.copy(deep=False)

    @cached_property
    def _excluded(self) -> pd.DataFrame:
        return excluded_frame(self.all_runs, ExcludedRuns.read(self._files.journal))

    @property
    def done(self) -> pd.DataFrame:
        """The rows of `runs` that are done, from which statistics are computed."""
        return self._done.copy(deep=False)

    @cached_property
    def _done(self) -> pd.DataFrame:
        runs = self.runs
        return runs[runs[STATUS] == RunStatus.DONE.value].reset_index(drop=True)

    @property
    def attempts(self) -> pd.DataFrame:
        """All attempts: `run_id`, `attempt`, `status` (done, failed, unfinished), `started_at`, `seconds`, `failure`.

        `seconds` is real time, measured by the orchestrator.
        """
        return self._history.attempts.copy(deep=False)

    @property
    def published(self) -> pd.DataFrame:
        """All measures that runs published in their last attempt, with or without a column in the run table.

        One row a value: `run_id`, `measure`, `value` (object), `owner`, `origin`.
        """
        published = self._history.published.copy(deep=False)
        return published if self.with_excluded else published[~published["run_id"].isin(self.excluded[RUN_ID])]

    @property
    def odd(self) -> pd.DataFrame:
        """Anomalies that plugins reported about runs: `run_id`, `attempt`, `owner`, `problem`, `fix`."""
        return self._history.odd.copy(deep=False)

    @property
    def quality(self) -> pd.DataFrame:
        """The quality of each value of the runs that are done, one row a value.

        Columns: `run_id`, `measure`, `quality` (ordered categorical: good, doubtful, missing) and `reasons` (text,
        separated by `; `; empty for a good value). An operator's missing answer has no row: mostly, nobody asked.

        Example:
            >>> quality = load_results("experiments/basic_experiment").quality  # doctest: +SKIP
            >>> quality[quality["quality"] != "good"].groupby("measure").size()  # doctest: +SKIP
        """
        found = quality_frame(self.done, self.measures, self._reasons)
        answers = [name for name, column in self.columns.items() if column.owner == OPERATOR_OWNER]
        unasked = found["measure"].isin(answers) & (found["quality"] == Quality.MISSING.value)
        return found[~unasked].reset_index(drop=True)

    def _reasons(self, run_id: str, measure: str) -> tuple[str, ...]:
        """Return the doubts about a value: the journal's, or the schema's where the journal does not have the run."""
        told = self._history.doubts.get(run_id)
        return self.columns[measure].doubts.get(run_id, ()) if told is None else told.get(measure, ())

    @property
    def readers(self) -> Mapping[str, tuple[str, ...]] | None:
        """The plugins (or `config`) that read each factor's treatment in runs that are done, or are bound to it.

        By the factor's name. Nobody read a factor that is missing here. None where the runs were executed by another
        tool, or by a version of Robot Runner, that did not record it.
        """
        return self._history.readers

    def events(self, runs: str | Sequence[str] | None = None) -> pd.DataFrame:
        """Return the events of runs (None: of all), of the last attempt at each.

        Columns: `run_id`, `event` (ordered categorical), `at` (datetime64, UTC), `clock_s` (s on the run's clock) and
        `since_start_s` (s since the start of the mission); the last two are missing for `before_run` and
        `continue`, which happen outside the run and its clock.

        Raises:
            AnalysisError: there is no such run.
        """
        events = self._history.events
        return events[events["run_id"].isin(self._chosen(runs))].reset_index(drop=True)

    def phases(self, runs: str | Sequence[str] | None = None) -> pd.DataFrame:
        """Return the phases of missions (None: of all runs), from `phases.csv` of systems or from the journal.

        Columns: `run_id`, the factors, `plugin` (missing for a phase from the journal), `number`, `phase`, `start_s`
        and `end_s` (s since the start of the mission), and the system's other columns, such as `task` and `x_m`.

        Raises:
            AnalysisError: there is no such run, or a file of phases lacks names or times.
        """
        return self._raw.mission_phases(self._chosen(runs))

    @property
    def sample_files(self) -> tuple[SampleFile, ...]:
        """The kinds of raw-sample files: plugin, file, columns, and the runs that have one."""
        return self._raw.sample_files

    def samples(
        self,
        plugin: str | None = None,
        *,
        file: str | None = None,
        runs: str | Sequence[str] | None = None,
        columns: str | Sequence[str] | None = None,
        with_factors: bool = True,
        with_phases: bool = True,
        with_window: bool = True,
    ) -> pd.DataFrame:
        """Return raw samples of some or all runs as one tidy table, one row a sample.

        Columns: `run_id` (categorical), the factors (ordered categoricals), `time_s` (s since the start of the
        mission; negative before it), `in_window` (whether it lies in the measured window, which is the mission),
        `phase` (categorical; of simultaneous phases the one that began last) and `phase_number` (0 outside all phases),
        then the value columns as the plugin wrote them. A factor with the name of another column has ` (factor)` behind
        it. Where the mission's times are not known, times count from the
        start of measurement, or from the first sample, and all samples count as inside the window.

        Args:
            plugin: the name of the plugin; optional where only one plugin has samples.
            file: the name of the file, such as `samples.csv`; optional where the plugin has only one kind.
            runs: ids of the runs; None for all that have samples.
            columns: the value columns; None for all. Fewer columns are read faster.
            with_factors: whether to add the treatments of each run, those of a factor that counts repetitions, too.
            with_phases: whether to add the phase of each sample.
            with_window: whether to add `in_window`.

        Raises:
            AnalysisError: there are no such samples, runs or columns; the error names the existing ones.
            StorageError: a file cannot be read.
        """
        raw = self._raw
        request = raw.request(
            choose_file(raw.sample_files, plugin, file),
            self._chosen(runs),
            columns,
            with_factors=with_factors,
            with_phases=with_phases,
            with_window=with_window,
        )
        return read_samples(request)

    def lazy_samples(
        self,
        plugin: str | None = None,
        *,
        file: str | None = None,
        runs: str | Sequence[str] | None = None,
        treatments: Mapping[str, object] | None = None,
        columns: str | Sequence[str] | None = None,
        phases: str | Sequence[str] | None = None,
        within_window: bool = False,
    ) -> LazySamples:
        """Select raw samples without reading them; they are read in batches, however many there are.

        Args:
            plugin: as in `samples`.
            file: as in `samples`.
            runs: as in `samples`.
            treatments: the treatments to keep, by factor: `{"Task": "Video"}`, or several in a list.
            columns: as in `samples`.
            phases: the names of the phases to keep; None for all samples.
            within_window: whether samples outside the measured window are left out.

        Raises:
            AnalysisError: there are no such samples, runs, treatments or phases; the error names the existing ones.
        """
        kind = choose_file(self._raw.sample_files, plugin, file)
        request = self._raw.request(kind, self._raw.with_treatments(self._chosen(runs), treatments or {}), columns)
        return self._raw.lazy(request, within_window=within_window, phases=phases)

    def aligned_samples(
        self,
        columns: Mapping[str, str | Sequence[str]],
        *,
        period: float,
        resampling: Resampling = Resampling.MEAN,
        runs: str | Sequence[str] | None = None,
        treatments: Mapping[str, object] | None = None,
    ) -> AlignedSamples:
        """Return samples of several profilers on one time grid, with the share of interpolated values.

        Times are on the run's clock; samples of other computers were converted to it when they were taken. The grid
        covers the measured window or, without one, the time that all profilers cover. A run without samples of one of
        the profilers is left out. Runs are read one after another.

        Args:
            columns: the columns of each plugin: `{"Ina219": ["power_W"], "PsUtil": ["cpu_percent"]}`; write
                `Ina219/samples.csv` where a plugin has several files.
            period: of the grid, s.
            resampling: how the value at a time of the grid is computed.
            runs: as in `samples`.
            treatments: as in `lazy_samples`.

        Raises:
            AnalysisError: there are no such samples, runs or columns, or columns are not numbers.
            StorageError: a file cannot be read.
        """
        chosen = self._raw.with_treatments(self._chosen(runs), treatments or {})
        return self._raw.aligned(columns, chosen, period, resampling)

    def export(self, folder: Path | str | None = None, *, for_spreadsheets: bool = False) -> tuple[Path, ...]:
        """Write the run table and all raw samples as Parquet, and a data package that describes everything.

        Args:
            folder: the folder to write into; None for `export/` in the experiment's folder.
            for_spreadsheets: whether the tables are written into `spreadsheets/`, too, as workbooks without formulas.

        Returns:
            The written files, `datapackage.json` among them.

        Raises:
            StorageError: a file cannot be written.
        """
        runs = list(self.all_runs[RUN_ID])
        tables = {"run_table": self.all_runs, "phases": self.phases(runs), "events": self.events(runs)}
        target = None if folder is None else Path(folder)
        return export_results(self, tables, self._raw, target, for_spreadsheets=for_spreadsheets)

    @property
    def _files(self) -> ExperimentFolder:
        return ExperimentFolder.found_at(self.folder)

    @cached_property
    def _run_frame(self) -> RunFrame:
        read = read_run_frame(self._files, tuple(self.columns.values()), self.manifest)
        if self.only_confirming and self.batch is not None:
            read = read.of_batches(self.batch, self.confirming_batches)
        return read if self.with_warm_ups else read.without_warm_ups()

    @cached_property
    def _history(self) -> History:
        history = read_history(self._files.journal)
        if self.only_confirming:
            own = set(self._run_frame.frame[RUN_ID])
            history = history.without(set(self.with_exploration.all_runs[RUN_ID]) - own)
        return history if self.with_warm_ups else history.without(self.warm_ups)

    @cached_property
    def _raw(self) -> RawData:
        runs = self._run_frame.frame
        files = run_files(self._files, runs[RUN_ID])
        factors = self._named(ColumnRole.FACTOR)  # also one that counts repetitions
        return RawData(files, runs, factors, self._history, self._files.journal)

    def _chosen(self, runs: str | Sequence[str] | None) -> list[str]:
        if runs is None:
            return list(self.runs[RUN_ID])
        return self._raw.known_runs(runs, where=self.name)


def load_results(folder: Path | str, *, with_excluded: bool = False, with_warm_ups: bool = False) -> Results:
    """Read the results of an experiment.

    Args:
        folder: the experiment's folder, with `run_table.csv`, its schema and `manifest.json`.
        with_excluded: whether to include runs that were excluded (`robot-runner exclude`). By default they are only in
            `excluded` and `all_runs`, and in no statistics.
        with_warm_ups: whether to include warm-up runs; `Results.warm_ups` names them in any case.

    Raises:
        StorageError: the folder holds no experiment, or cannot be read.
    """
    root = Path(folder).expanduser().resolve()
    files = ExperimentFolder.found_at(root)
    if not files.manifest.exists() and files.run_table.exists():
        fix = f"Adopt it: robot-runner import {shlex.quote(str(folder))}"
        raise StorageError("there is a run table here, but no manifest.json", where=str(folder), fix=fix)
    manifest = read_manifest(files.manifest)
    columns = {column.name: column for column in read_schema(files.schema)}
    return Results(root, manifest, columns, with_excluded, with_warm_ups)


def results_of(experiment: Results | Path | str) -> Results:
    """Return the results of an experiment, which is given as results or as a folder."""
    return experiment if isinstance(experiment, Results) else load_results(experiment)
