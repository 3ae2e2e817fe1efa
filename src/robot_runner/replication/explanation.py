"""Explain the origin of each value of a run, from the experiment's folder alone."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from robot_runner.core.design.batch import CONFIRMATION
from robot_runner.core.design.columns import BATCH, RUN_ID, STATUS, WARM_UP
from robot_runner.core.errors import StorageError, did_you_mean
from robot_runner.core.events.measure import CONFIG_OWNER, OPERATOR_OWNER, QUALITY_SUFFIX, ROBOTS_OWNER, quality_text
from robot_runner.core.storage.cells import RunStatus
from robot_runner.core.storage.executed_runs import executed_order, moved_runs, recorded_rows, unrecorded_runs
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.manifest import read_manifest
from robot_runner.core.storage.registration import read_registration
from robot_runner.core.storage.system_refusals import storage_errors
from robot_runner.core.storage.table_columns import MARKS, ColumnDescription, ColumnRole
from robot_runner.core.storage.table_schema import read_schema
from robot_runner.core.words import EMPTY, shown_commit, shown_duration
from robot_runner.replication.about import imported_facts
from robot_runner.replication.config_lines import ConfigLines, executed_config
from robot_runner.replication.run_history import RunHistory

_ORCHESTRATED = frozenset({"before_run", "continue"})
_UNKNOWN_CONFIG = (
    "changed between two executions, and it is not recorded which of config/ and earlier_configs/ executed the run"
)
_UNMEASURED = {"simulated": "simulated, not measured", "estimated": "estimated by a model, not measured"}


@dataclass(frozen=True, slots=True)
class Explanation:
    """The origin of one value.

    Attributes:
        name: the column, or the measure if it has no column.
        role: factor, measure, timestamp, and so on.
        value: None if it is missing.
        facts: the known facts of its origin, in order: a heading and a text each.
    """

    name: str
    role: str
    value: Any
    unit: str
    facts: tuple[tuple[str, str], ...]


@dataclass(frozen=True, slots=True)
class RunExplanation:
    """The origin of the values of one run.

    Attributes:
        facts: the facts that all values share: status, attempts, robot, host.
        values: one for each requested name.
    """

    experiment: str
    run_id: str
    facts: tuple[tuple[str, str], ...]
    values: tuple[Explanation, ...]


def explain_run(root: Path, run_id: str, names: Sequence[str] = ()) -> RunExplanation:
    """Explain the values of a run.

    Args:
        root: the experiment's folder.
        run_id: the run.
        names: the columns or measures to explain; empty means all.

    Raises:
        StorageError: there is no such run or column, or a file cannot be read.
    """
    return _Explaining(root, run_id).explain(names)


class _Explaining:
    def __init__(self, root: Path, run_id: str) -> None:
        self._files = ExperimentFolder.found_at(root)
        self._manifest = read_manifest(self._files.manifest)
        self._columns = {column.name: column for column in read_schema(self._files.schema)}
        rows, _ = recorded_rows(self._files, tuple(self._columns.values()))
        place = rows.place_of(run_id)
        if place is None:
            known = [rows.run_id(each) for each in range(min(len(rows), 1000))]  # searching more is slow
            raise StorageError(f"there is no run {run_id!r}", where=str(root), fix=did_you_mean(run_id, known))
        self._run_id, self._row = run_id, rows.row(place)
        self._run_ids = [rows.run_id(each) for each in range(len(rows))]
        self._history = RunHistory.read(self._files.journal, run_id)
        with storage_errors(self._files.config, "read"):
            self._config = executed_config(self._files, self._execution)
            self._lines = ConfigLines(self._files.root, self._config, self._manifest.get("config") or {})
        self._imported = imported_facts(self._manifest)
        self._is_done = self._row[STATUS] is RunStatus.DONE
        ended = () if self._history.finished_at is None else (run_id,)
        self._is_unrecorded = self._is_done and bool(unrecorded_runs([run_id], ended, self._manifest))
        self._is_of_table = self._is_done and not self._is_unrecorded and not self._history.attempt

    def explain(self, names: Sequence[str]) -> RunExplanation:
        extra = {name: None for name in self._history.measures if name not in self._row}
        known = [name for name in (*self._row, *extra) if name != RUN_ID]
        for name in names:
            if name not in known:
                fix = did_you_mean(name, known)
                raise StorageError(f"there is no column or measure {name!r}", where=self._run_id, fix=fix)
        return RunExplanation(
            str(self._manifest.get("experiment_name", self._files.root.name)),
            self._run_id,
            tuple(fact for fact in self._run_facts() if fact[1]),
            tuple(map(self._explained, names or known)),
        )

    def _explained(self, name: str) -> Explanation:
        role = ColumnRole.MEASURE if name in self._history.measures else ColumnRole.EXTRA
        column = self._columns.get(name) or ColumnDescription(name=name, role=role)
        value = self._row[name] if name in self._row else self._history.measures[name]["value"]
        if value is None and column.role is ColumnRole.FACTOR:
            value = ""  # an empty treatment: a factor's cell is never missing
        facts = {
            ColumnRole.MEASURE: self._measure_facts,
            ColumnRole.FACTOR: self._factor_facts,
            ColumnRole.REPETITION: self._factor_facts,
            ColumnRole.BATCH: self._batch_facts,
            ColumnRole.WARM_UP: self._progress_facts,
            ColumnRole.TIMESTAMP: self._stamp_facts,
            ColumnRole.PROGRESS: self._progress_facts,
            ColumnRole.EXTRA: self._extra_facts,
        }[column.role](column)
        told = tuple(fact for fact in facts if fact[1])
        return Explanation(name, column.role.value, _plain(value), column.unit, told)

    def _run_facts(self) -> Iterator[tuple[str, str]]:
        history = self._history
        yield "Status", _plain(self._row[STATUS])
        excluded = history.excluded.present.get(self._run_id)
        if excluded is not None:
            yield "Excluded", f"{excluded.reason} ({excluded.at}): not in the statistics"
        if len(history.corrections) > (excluded is not None):
            yield from (("Correction", told) for told in history.corrections)
        yield "Place", f"run {self._run_ids.index(self._run_id) + 1} of {len(self._run_ids)}, {self._order()}"
        if self._mark(WARM_UP):
            yield "Warm-up", "the run was executed and kept, and is not analysed"
        if self._imported is not None:  # the journal's host, software and times are those of the import
            came = f"at {self._imported.get('at')} from {self._imported.get('table')} of {self._imported.get('from')}"
            yield "Imported", f"{came}: where and by what it was executed is not known"
            return
        if self._is_of_table:
            yield "Executed", "not here: the run table had it as done, and where and by what is not known"
            return
        yield "Executed", self._executed()
        yield from history.attempts
        yield from history.steps
        if history.stopped:
            yield "Mission", history.stopped
        yield from history.waits
        if history.waited:
            yield "Waited in all", shown_duration(history.waited)
        yield "Robot", f"{history.place}: {self._reached}" if self._own_robot else self._reached or "as the config says"
        yield "Host", f"{self._worker}, directed from {self._host()}" if self._worker else self._host()
        yield "System", self._system()
        yield from (("Program", self._program(path, owner)) for path, owner in history.programs)
        yield "Commit", history.commit
        yield "Config", "" if self._config is not None else _UNKNOWN_CONFIG
        yield "Registered", self._registered()
        yield from (("Other host", host) for host in history.hosts)
        yield from (("Subject", subject) for subject in history.subjects)
        for owner, name, factor, value in history.bound:
            yield "Parameter", f"{name} of {owner} = {value}, bound to the factor {factor}"

    def _registered(self) -> str:
        """Return when the study was registered, and whether the folder's registration is still the same."""
        stated = self._manifest.get("registration")
        if not isinstance(stated, dict):
            return ""
        told = f"{stated.get('registered_at')}, before the first run; SHA-256 {stated.get('sha256')}"
        try:
            found = read_registration(self._files.registration)
        except StorageError as error:
            return f"{told}; {error.problem}"
        is_same = found.is_intact and found.sha256 == stated.get("sha256")
        return told if is_same else f"{told}; the file in the folder was changed since"

    def _order(self) -> str:
        design = self._manifest.get("design") or {}
        if design.get("source") not in {None, "config"}:
            by_hand = ", which was written by hand" if self._imported is None else ""
            return f"in the order of {design['source']}{by_hand}"
        batch = self._batch or {}
        order = batch if batch.get("batch", 1) > 1 else {**design, "seed": self._manifest.get("seed")}
        blocks = f" within blocks of {order['blocks']}" if order.get("blocks") else ""
        by = "as results decided" if _mapping(design.get("facts")).get("decides") else "in the order of the config"
        planned = f"randomised{blocks} from seed {order['seed']}" if order.get("shuffle") else f"{by}{blocks}"
        planned = f"{planned}, in batch {batch['batch']}" if batch else planned
        return f"changed by hand in run_table.csv; planned: {planned}" if design.get("is_reordered") else planned

    def _mark(self, name: str) -> Any:
        """Return the run's value of a column of the plan; None if a column of that name has another role."""
        return self._row[name] if name in self._columns and self._columns[name].role is MARKS[name].role else None

    @property
    def _batch(self) -> Mapping[str, Any] | None:
        """The manifest's entry for the batch of the run; None if there is only one plan."""
        batches = (self._manifest.get("design") or {}).get("batches") or ()
        return next((each for each in batches if each.get("batch") == self._mark(BATCH)), None)

    def _batch_facts(self, column: ColumnDescription) -> Iterator[tuple[str, str]]:
        yield "From", f"Robot Runner: {column.description}"
        batch = self._batch
        if batch is not None:
            by = "to confirm what was found" if batch.get("role") == CONFIRMATION else "by `robot-runner extend`"
            added = f", added at {batch['at']} {by}" if batch.get("at") else ""
            yield "Runs", f"{batch['runs']} ({batch['first']} to {batch['last']}){added}"

    def _executed(self) -> str:
        """Return the run's place in the order of execution, if that differs from the table's."""
        executed = executed_order(self._files.journal)
        if self._run_id not in moved_runs(self._run_ids, executed):
            return ""
        place = f"as number {executed.index(self._run_id) + 1} of the {len(executed)} runs so far"
        return f"{place}, out of the order of the run table"

    @property
    def _own_robot(self) -> str:
        """The connection of the robot that executed the run, if several robots take turns."""
        given = _mapping(self._execution.get("given")).get(f"robot[{self._history.place!r}]")
        return str(given or _mapping(self._manifest.get("robots")).get(self._history.place) or "")

    @property
    def _reached(self) -> str:
        """The robot's connection in the execution of the run."""
        given = _mapping(self._execution.get("given")).get("robot")
        return self._own_robot or str(given or self._manifest.get("robot") or "")

    def _host(self) -> str:
        """The machine that executed or directed the run, and its Python, in the execution of the run."""
        python = _mapping(self._manifest.get("software")).get("python")
        facts = {**_mapping(self._manifest.get("host")), "python": python}
        changed = self._execution.get("changed") or {}
        facts |= {name: each["is"] for name, each in changed.items() if name in facts}
        machine = " ".join(str(facts[part]) for part in ("processor", "system", "release") if facts.get(part))
        return f"{machine}, Python {facts['python']}" if facts["python"] else machine

    @property
    def _execution(self) -> Mapping[str, Any]:
        """The manifest's entry for the execution in which the run was executed."""
        moment, executions = self._history.started_at or "", self._manifest.get("executions") or ()
        begun = [each for each in executions if str(each.get("started_at", "")) <= moment]
        return begun[-1] if begun else {}

    @property
    def _worker(self) -> str:
        """The worker of a cluster that executed the run, and its machine."""
        machine = f" ({self._history.machine})" if self._history.machine else ""
        return f"worker {self._history.place} of a cluster{machine}" if self._history.is_elsewhere else ""

    def _system(self) -> str:
        software = _mapping(self._manifest.get("software"))
        named = _mapping(software.get("system")).get("name")
        packages = len(_mapping(software.get("system_packages")))
        return f"{named or 'unknown'}, {packages:,} packages in the manifest" if named or packages else ""

    def _program(self, path: str, owner: str) -> str:
        """Return a program's path, its version if known, and its caller."""
        known = _mapping(_mapping(self._manifest.get("programs")).get(path))
        if known.get("package"):
            told = f"{known['package']} {known.get('version') or ''}".rstrip()
        else:
            told = f"SHA-256 {known['sha256']}" if known.get("sha256") else "of an unknown version"
        return f"{path} ({told}){f', called by {owner}' if owner else ''}"

    def _measure_facts(self, column: ColumnDescription) -> Iterator[tuple[str, str]]:
        if self._is_of_table:
            yield "From", f"{self._files.run_table.name}, which had it as the run was not executed here"
            return
        published = self._history.measures.get(column.name, {})
        owner = str(published.get("owner") or column.owner)
        origin = str(published.get("origin") or column.origin or "")
        yield "Origin", _UNMEASURED.get(origin, origin)
        doubts = tuple(published.get("doubts", ())) if published else column.doubts.get(self._run_id, ())
        if self._is_unrecorded:
            yield "Quality", "not known: the journal has no end of this run, and is missing or older than the run table"
        elif published or self._is_done:
            value = self._row.get(column.name, published.get("value"))
            is_told = self._imported is None or value is None or bool(doubts)
            yield "Quality", quality_text(value, doubts) if is_told else "not known: it was imported without any"
        yield from self._owner_facts(owner, column.name)
        yield "Aggregation", column.description
        yield "Raw data", ", ".join(self._raw_files(owner))
        yield "Published", "" if self._imported is not None else self._published(column.name)
        if published and _plain(self._row.get(column.name, published["value"])) != _plain(published["value"]):
            yield "Edited", f"the journal has {published['value']!r}: the table was changed by hand since"
        yield from (("Doubt", doubt) for doubt in self._history.doubts_about(owner, column.name) if doubt not in doubts)

    def _owner_facts(self, owner: str, measure: str) -> Iterator[tuple[str, str]]:
        if owner == "import" and self._imported is not None:
            yield "From", "`robot-runner import`"
            return
        if owner == OPERATOR_OWNER:
            when = self._history.asked.get(measure.removesuffix(QUALITY_SUFFIX))
            yield "From", f"a person, who was {f'asked {when}' if when else 'not asked about'} the run"
            return
        if owner == ROBOTS_OWNER:
            yield "From", "Robot Runner: the robot whose turn it was"
            return
        if owner == CONFIG_OWNER:
            yield "From", "the config"
            yield "Config", self._lines.of_measure(measure)
            return
        plugins = (each for each in self._manifest.get("plugins", ()) if each.get("name") == owner)
        plugin: Mapping[str, Any] = next(plugins, {})
        kind = str(plugin.get("class", "")).rpartition(":")[2]
        package = f" ({plugin['package']} {plugin.get('version')})" if plugin.get("package") else ""
        named = f"{owner}, " if kind != owner and kind else ""
        yield "Plugin", f"{named}{kind or owner}{package}" if owner else "none: no plugin published it"
        yield "Config", self._lines.of_plugin(owner, kind)
        for whose, name, factor, value in self._history.bound:
            if whose == owner:
                yield "Parameter", f"{name} = {value}, bound to the factor {factor}"

    def _raw_files(self, owner: str) -> Iterator[str]:
        run = self._files.run(self._run_id)
        folder = run if owner == CONFIG_OWNER and not (run / CONFIG_OWNER).is_dir() else run / owner
        for path in sorted(each for each in folder.rglob("*") if each.is_file()) if owner else ():
            if folder == run and (path.parent != run or path == self._files.log(self._run_id)):
                continue
            yield f"{path.relative_to(self._files.root).as_posix()} ({path.stat().st_size:,} bytes)"

    def _published(self, name: str) -> str:
        if name not in self._history.measures:
            return "" if self._history.attempt else "not executed yet"
        return f"in attempt {self._history.attempt} ({self._files.journal.name})"

    def _factor_facts(self, column: ColumnDescription) -> Iterator[tuple[str, str]]:
        design = self._manifest.get("design") or {}
        treatments = (design.get("factors") or {}).get(column.name)
        if treatments:
            yield "Treatments", ", ".join(each or EMPTY for each in treatments)
        elif column.role is ColumnRole.REPETITION:
            yield "Treatments", f"1 to {design.get('repetitions')}"
        if design.get("source") not in {None, "config"}:
            came = "imported" if self._imported is not None else "written by hand before the first run"
            yield "From", f"{design['source']}, which was {came}"
        if column.role is ColumnRole.FACTOR:
            yield "Assumed", self._assumed(column.name)
            bound = [f"{name} of {owner}" for owner, name, factor, _ in self._history.bound if factor == column.name]
            for name, facts in ((self._manifest.get("revisions") or {}).get(column.name) or {}).items():
                yield "Revision", f"{name} is {shown_commit(facts)}"
            yield "Bound to", ", ".join(bound)
            yield "Read by", self._read_by(column.name)
        yield "Config", self._lines.of_factor(column.name) or self._lines.of_method("create_run_table")

    def _assumed(self, factor: str) -> str:
        """Return a sentence if the run was planned before the factor was added, else an empty text."""
        batches = (self._manifest.get("design") or {}).get("batches") or ()
        added = next((each["batch"] for each in batches if factor in each.get("defaults", {})), 0)
        if (self._mark(BATCH) or 1) >= added:
            return ""
        return f"the factor was added with batch {added}, and runs before count as having had this treatment"

    def _read_by(self, factor: str) -> str:
        if self._history.readers is None:  # not executed, or by an earlier version that did not record it
            return ""
        return ", ".join(self._history.readers.get(factor, ())) or "no callback and no plugin looked at it"

    def _stamp_facts(self, column: ColumnDescription) -> Iterator[tuple[str, str]]:
        event = column.name.removesuffix("_at")
        is_own = event not in _ORCHESTRATED
        if self._row[column.name] is None:
            yield "Event", f"{event}, not emitted in this run"
        else:
            where = "the run's own process" if is_own else "the orchestrator"
            clock_of = (is_own and self._worker) or self._host()
            yield "Event", f"{event}, emitted in {where}, before any callback was called; UTC of {clock_of}"
        clock = self._history.clocks.get(event)
        if clock is not None and is_own:
            simulated = " (simulated time)" if self._reached.startswith("simulated") else ""
            yield "Run's clock", f"{clock:.3f} s{simulated}"
        yield "Config", self._lines.of_method("continue_experiment" if event == "continue" else event)

    def _progress_facts(self, column: ColumnDescription) -> Iterator[tuple[str, str]]:
        yield "From", f"Robot Runner: {column.description or 'how far the run has come'}"

    def _extra_facts(self, column: ColumnDescription) -> Iterator[tuple[str, str]]:
        came = "" if self._imported is None else f"{self._imported.get('table')}, which was imported, or "
        yield "From", f"{came}a column that somebody added to {self._files.run_table.name} by hand"
        yield "Meaning", column.description


def _mapping(value: Any) -> Mapping[str, Any]:
    """Return a manifest's value if it is a mapping, else an empty one: the folder may come from elsewhere."""
    return value if isinstance(value, dict) else {}


def _plain(value: Any) -> Any:
    plain = getattr(value, "value", value)
    return plain if isinstance(plain, bool | int | float | str) or plain is None else str(plain)
