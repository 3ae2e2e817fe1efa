"""The registration of an experiment before its first run, and all deviations from it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from itertools import product
from typing import TYPE_CHECKING, Any

from robot_runner.analysis.wording import listed
from robot_runner.core.design.batch import CONFIRMATION
from robot_runner.core.design.columns import RUN_ID
from robot_runner.core.errors import StorageError
from robot_runner.core.secret_names import shown_settings
from robot_runner.core.storage.executed_runs import executed_order, moved_in_words, moved_runs
from robot_runner.core.storage.guarded_files import read_bytes
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.registration import (
    Registration,
    combination_differences,
    differences,
    plain_text,
    read_registration,
)
from robot_runner.core.words import counted

if TYPE_CHECKING:
    from robot_runner.analysis.results import Results
    from robot_runner.analysis.statistics.outcome import ExperimentStatistics


@dataclass(frozen=True, slots=True)
class Registered:
    """A registration, and the deviations from it.

    Attributes:
        registered_at: when it was made (UTC).
        sha256: its checksum, as recorded at the start of the experiment.
        power: the registered sentences on the study's power, if any.
        deviations: each as a clause, without a full stop.
        problem: why the file in the folder cannot be trusted; empty if it can.
    """

    registered_at: str
    sha256: str
    power: tuple[str, ...]
    deviations: tuple[str, ...]
    problem: str = ""

    def as_mapping(self) -> dict[str, Any]:
        """Return it as plain data, for the report's JSON."""
        return {**asdict(self), "sentence": self.sentence}

    @property
    def sentence(self) -> str:
        """The sentence of the report."""
        told = f"Registered on {self.registered_at[:10]} at {self.registered_at[11:19]} UTC, SHA-256 {self.sha256}."
        if self.problem:
            return f"{told} {self.problem}"
        return f"{told} Deviations: {'; '.join(self.deviations) or 'none'}."


def registered(results: Results, statistics: ExperimentStatistics) -> Registered | None:
    """Return the registration of an experiment with all deviations from it; None if there is none."""
    stated = results.manifest.get("registration")
    if not isinstance(stated, dict):
        return _made_too_late(results.manifest.get("registration_changes"))
    at, digest = str(stated.get("registered_at")), str(stated.get("sha256"))
    try:
        found = read_registration(ExperimentFolder.found_at(results.folder).registration)
    except StorageError as error:
        problem = f"Whether it was followed is not known: {error.problem}."
        return Registered(at, digest, (), (), problem)
    if not found.is_intact or found.sha256 != digest:
        problem = "The file in the folder is not the one that the experiment began with: its checksum differs."
        return Registered(at, digest, (), (), problem)
    power = tuple(map(str, (found.content["power"] or {}).get("answers", ())))
    return Registered(at, digest, power, tuple(_deviations(found, results, statistics)))


def _made_too_late(changes: Any) -> Registered | None:
    """Return a registration that was made after the experiment had begun without one."""
    later = changes[-1].get("registration") if changes else None
    if not isinstance(later, dict):
        return None
    problem = "It was made after the first run, and does not count."
    return Registered(str(later.get("registered_at")), str(later.get("sha256")), (), (), problem)


def _deviations(found: Registration, results: Results, statistics: ExperimentStatistics) -> Iterator[str]:
    manifest, content = results.manifest, found.content
    design, stated = _first_design(manifest), content["design"]
    if "excluded" in stated:  # which only the registration has: combinations are compared with the run table
        design["excluded"] = stated["excluded"]
    design["units"] = {name: results.unit(name) for name in stated.get("units", ()) if name in results.columns}
    now: dict[str, Any] = {
        "design": design,
        "seed": manifest.get("seed"),
        "analysis": manifest.get("analysis"),
        "repeat_until": manifest.get("repeat_until"),
        "measures": [{"name": name, "unit": results.unit(name)} for name in results.measures],
    }
    yield from differences(content, json.loads(json.dumps(now, default=str)))
    yield from _of_combinations(stated, results)
    yield from _of_config(content["config"], results)
    yield from _of_execution(found, results)
    yield from _of_runs(results)
    yield from _of_analysis(statistics, results)


def _first_design(manifest: Mapping[str, Any]) -> dict[str, Any]:
    """Return the initial design of the experiment; added batches are reported separately."""
    design = {name: each for name, each in (manifest.get("design") or {}).items() if name not in {"source", "batches"}}
    batches = (manifest.get("design") or {}).get("batches") or []
    if batches and batches[0].get("repetitions"):
        design["repetitions"] = batches[0]["repetitions"]
    if rule := manifest.get("repeat_until"):  # the repetitions that it adds were registered with the rule
        design["repetitions"] = rule["least"]
    return design


def _of_combinations(design: Mapping[str, Any], results: Results) -> Iterator[str]:
    """Yield the combinations of the run table that were not registered, and the registered ones that it lacks."""
    names = list(design.get("factors") or {})
    runs = results.with_exploration.all_runs
    if not names or any(name not in runs for name in names):
        return  # reported as factors
    if "combinations" in design:
        planned = {tuple(map(plain_text, each)) for each in design["combinations"]}
    else:
        left_out = {tuple(each) for each in design.get("excluded", ())}
        cells = (cell for cell in product(*design["factors"].values()) if cell not in left_out)
        planned = {tuple(map(plain_text, cell)) for cell in cells}
    present = {tuple(map(plain_text, row)) for row in runs[names].itertuples(index=False)}
    if results.is_adaptive:
        present &= planned  # the registration left the others to the search
    yield from combination_differences(planned, present, "the run table", design["factors"])


def _of_config(config: Mapping[str, Any], results: Results) -> Iterator[str]:
    files = ExperimentFolder.found_at(results.folder)
    for name, digest in {str(config.get("file")): config.get("sha256"), **(config.get("modules") or {})}.items():
        path = files.config / name
        if path.is_file() and hashlib.sha256(read_bytes(path, files.root)).hexdigest() != digest:
            yield f"the file {name} was changed after the registration"
    settings = config.get("settings") or {}
    for execution in results.manifest.get("executions") or ():
        set_now = {name: text for name, text in (execution.get("deviations") or {}).items() if name != _PATH}
        if shown_settings(set_now) != shown_settings(settings):
            shown = listed(f"{name} = {text}" for name, text in shown_settings(set_now).items()) or "nothing"
            yield f"set from outside on {str(execution.get('started_at'))[:10]}: {shown}"
            return


#: The folder of the results is not part of a plan.
_PATH = "results_output_path"


def _of_execution(found: Registration, results: Results) -> Iterator[str]:
    manifest = results.manifest
    executions = manifest.get("executions") or [{}]
    if str(executions[0].get("started_at", "9")) < found.registered_at:
        # Only the first execution keeps a registration, and so it began later.
        yield "by its time it was registered after the first run, which had it: a clock was wrong, or a file was edited"
    if manifest.get("registration_changes"):
        yield "another registration took the place of this one after runs had been executed, and does not count"
    if manifest.get("analysis_changes"):
        yield "the analysis plan was changed after runs had been executed"
    if manifest.get("repeat_until_changes"):
        yield "how precisely measures are to be known was changed after runs had been executed"
    for batch in (manifest.get("design") or {}).get("batches", [])[1:]:
        if batch.get("role") == CONFIRMATION:
            continue  # planned with the search, and registered with it
        runs, at = counted(batch["runs"], "run"), str(batch.get("at"))[:10]
        yield f"extended beyond what was registered: batch {batch['batch']}, {runs}, added on {at}"
    if manifest.get("table_deviations"):
        yield f"the run table was edited by hand ({counted(len(manifest['table_deviations']), 'change')})"
    order = executed_order(ExperimentFolder.found_at(results.folder).journal)
    if moved := moved_in_words(moved_runs(list(results.all_runs[RUN_ID]), order), order):
        yield moved


def _of_runs(results: Results) -> Iterator[str]:
    excluded = list(results.excluded[RUN_ID])
    if excluded:
        yield f"{counted(len(excluded), 'run')} excluded: {listed(excluded)}"
    left = len(results.runs) - len(results.done)
    if left:
        yield f"{counted(left, 'run')} not done"


def _of_analysis(statistics: ExperimentStatistics, results: Results) -> Iterator[str]:
    plan = results.plan
    if not statistics.is_planned and statistics.plan is not None:
        yield "this report follows a plan that was given for it, and not the experiment's"
    elif not statistics.is_planned and plan is not None:
        yield "this report does not follow the plan, as its level of significance or its correction is another"
    elif plan is not None:
        planned = (*plan.measures, *plan.secondary)
        tested = [each.name for each in statistics.measures if each.test is not None]
        if unplanned := [name for name in tested if name not in {*planned, *plan.covariates}]:
            yield f"measures tested that were not planned: {listed(unplanned)}"
        shown = {each.name for each in statistics.measures}
        if left_out := [name for name in planned if name in results.columns and name not in shown]:
            yield f"planned measures that this report leaves out: {listed(left_out)}"
