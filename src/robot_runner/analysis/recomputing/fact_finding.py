"""Collects the facts of a study for a recomputation, from its results, its run table and its statistics."""

from __future__ import annotations

import csv
import hashlib
import io
import os
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from robot_runner.analysis.recomputing.designed_facts import Designed, designed_facts
from robot_runner.analysis.recomputing.measure_facts import facts_of_measure
from robot_runner.analysis.recomputing.reported import Number, Reported, ends
from robot_runner.analysis.recomputing.study_facts import (
    Adjustment,
    FactorColumn,
    MeasureFacts,
    StudyFacts,
    TableSource,
)
from robot_runner.analysis.run_frame import several
from robot_runner.analysis.statistics.analysed_design import BATCH, PLACE, Design, MeasureData, design_of
from robot_runner.analysis.statistics.disclosed import Beside, runs_without_value
from robot_runner.analysis.statistics.execution_order import STAMP
from robot_runner.analysis.statistics.experiment_statistics import analyse
from robot_runner.analysis.statistics.families import Key, contrast_key, effect_key, families_of
from robot_runner.analysis.statistics.tests import Choices
from robot_runner.core.design.columns import EXCLUDED, RUN_ID, STATUS, WARM_UP
from robot_runner.core.storage.cells import typed_value
from robot_runner.core.storage.guarded_files import read_bytes
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.run_table_reading import delimiter_of, match_headings
from robot_runner.core.storage.system_refusals import storage_error
from robot_runner.core.storage.table_columns import TableLayout
from robot_runner.core.storage.table_decoders import MISSING, TableFindings

if TYPE_CHECKING:
    from robot_runner.analysis.results import Results
    from robot_runner.analysis.statistics.outcome import ExperimentStatistics, MeasureStatistics
    from robot_runner.core.design.analysis_plan import AnalysisPlan


def facts_of_study(
    results: Results,
    folder: Path,
    *,
    measures: str | Sequence[str] | None = None,
    alpha: float | None = None,
    plan: AnalysisPlan | None = None,
    made: str = "",
) -> StudyFacts:
    """Return the facts of a study for a recomputation.

    Measures, alpha and plan are those of the report, and `folder` is that of the script, with `made`: when and by which
    version. Primary measures of the plan are added, as the error rate is controlled over these.

    Raises:
        StorageError: the run table cannot be read.
        AnalysisError: there is no such measure, or alpha is out of range.
    """
    results = results.confirming
    followed = plan or results.plan
    planned = followed.measures if followed is not None else ()
    primary = [name for name in planned if name in results.columns]
    names = None if measures is None else list(dict.fromkeys([*several(measures), *primary]))
    statistics = analyse(results, measures=names, alpha=alpha, plan=plan)
    shown = statistics if names in (None, measures) else analyse(results, measures=measures, alpha=alpha, plan=plan)
    plan = statistics.plan
    design = design_of(results, blocks=plan.blocks if plan is not None else None)
    facts = dict(_measures(design, statistics, plan))
    cells = Cells(ExperimentFolder.found_at(results.folder).run_table, results)
    block = design.block or ""
    designs = tuple(_correlated_designs(shown, design))
    measured = {name for each in shown.correlations for name in (each.first, each.second)}
    is_known = design.known.is_plain or len(designs) == len(measured)
    return StudyFacts(
        name=results.name,
        made=made,
        alpha=statistics.alpha,
        correction="holm" if statistics.correction.value == "holm" else "BH",
        source=source_of(results, design, cells, folder),
        factors=factor_columns(design, cells),
        varied=design.factors,
        numbers=tuple(dict.fromkeys(_numbers(facts.values(), results))),
        block=block,
        blocks_are_of_batches=bool(block) and BATCH in design.frame and block == results.repetition,
        units=() if block else design.known.unit_columns,
        batch=(results.batch or "") if BATCH in design.frame else "",
        design=_design(statistics),
        measures=tuple(facts.values()),
        families=tuple(_families(statistics, plan, facts)),
        adjusted=_adjusted(statistics, facts),
        correlated=tuple(_correlated(shown, design)),
        correlations=_correlations(shown, is_known=is_known),
        without_within=0 if is_known else len(shown.correlations),
        correlated_designs=designs if is_known else (),
        correlated_without=tuple(_without(shown, measured)),
        conditional=tuple(name for name in design.factors if name in design.conditions),
        possible=design.possible if design.conditions else None,
    )


def _numbers(facts: Iterable[MeasureFacts], results: Results) -> Iterator[str]:
    """Yield the columns that are read as numbers: measures and covariates."""
    for each in facts:
        if each.answered is None:
            yield each.name
        yield from (name for name in each.covariates if name in results.measures)


def _measures(
    design: Design, statistics: ExperimentStatistics, plan: AnalysisPlan | None
) -> Iterator[tuple[tuple[str, Beside | None], MeasureFacts]]:
    """Yield the facts of each measure, of the planned analysis and of the sensitivity analyses."""
    choices = Choices(statistics.alpha, statistics.correction)
    if plan is not None:
        choices = replace(choices, estimand=plan.estimand, statistic=plan.statistic)
        design = replace(design, covariates=plan.covariates)
    hypotheses = plan.hypotheses if plan is not None else ()
    key_of = _unique_names()
    for beside, measures in _analyses(statistics):
        for measure in measures:
            if measure.overall is None and measure.proportions is None:
                continue
            mine = replace(design, without=runs_without_value(measure.left_out))
            if beside is Beside.WITHOUT_COVARIATES:
                mine = replace(mine, covariates=())
            words = "" if beside is None else beside.value
            yield (measure.name, beside), facts_of_measure(mine, measure, choices, hypotheses, key_of, words)


def _analyses(statistics: ExperimentStatistics) -> Iterator[tuple[Beside | None, tuple[MeasureStatistics, ...]]]:
    """Yield the planned analysis, then the sensitivity analyses that were made."""
    yield None, statistics.measures
    yield from ((each, statistics.beside(each)) for each in Beside if statistics.beside(each))


def _unique_names() -> Callable[[str], str]:
    """Return a function that makes texts unique, by a number for repeated ones."""
    taken: set[str] = set()

    def unique(text: str) -> str:
        name, number = text, 1
        while name in taken:
            number += 1
            name = f"{text} ({number})"
        taken.add(name)
        return name

    return unique


def _design(statistics: ExperimentStatistics) -> Reported:
    of = statistics.design
    row: dict[str, Number] = {
        "runs": of.used,
        "not done": of.left_out,
        "combinations": of.combinations,
        "without runs": of.empty_combinations,
        "fewest runs": of.smallest_group,
        "most runs": of.largest_group,
    }
    return Reported.of([("design", row)])


def _families(
    statistics: ExperimentStatistics, plan: AnalysisPlan | None, facts: Mapping[tuple[str, Beside | None], MeasureFacts]
) -> Iterator[Adjustment]:
    """Yield the families of the planned analysis, and those of sensitivity analyses that the report shows."""
    for beside, measures in _analyses(statistics):
        again = {each.name: each for each in measures}
        keys = {
            each.name: dict(
                _keys(again.get(each.name, each), facts.get((each.name, beside if each.name in again else None)))
            )
            for each in statistics.measures
        }
        names = {key: name for of in keys.values() for key, name in of.items()}
        shown = {key for measure, of in keys.items() if measure in again for key in of}
        for name, tests in families_of({measure: tuple(of) for measure, of in keys.items()}, plan):
            known = [key for key in tests if key in names]
            if shown.intersection(known):
                yield Adjustment(
                    f"{name}{'' if beside is None else f', {beside.value}'}",
                    tuple(names[key] for key in known),
                    tuple(names[key] for key in known if key in shown),
                )


def _keys(measure: MeasureStatistics, facts: MeasureFacts | None) -> Iterator[tuple[Key, str]]:
    """Yield the key of each test of a measure with a p-value, in the statistics and in the script."""
    if facts is None:
        return
    for effect in measure.effects:
        if effect.p_value is not None:
            yield effect_key(measure.name, effect.factors), facts.effect_keys[effect.factors]
    for each in measure.contrasts:
        yield contrast_key(each.statement), facts.contrast_keys[each.statement]


def _adjusted(statistics: ExperimentStatistics, facts: Mapping[tuple[str, Beside | None], MeasureFacts]) -> Reported:
    rows: list[tuple[str, Number]] = []
    adjusted: dict[tuple[str, Beside | None], Number] = {}
    adjusted |= {(each.hypothesis.statement, None): each.adjusted_p_value for each in statistics.hypotheses}
    adjusted |= {(each.statement, each.beside): each.p_value_without for each in statistics.standings if each.statement}
    for beside, measures in _analyses(statistics):
        for measure in measures:
            found = facts.get((measure.name, beside))
            if found is None:
                continue
            rows += [(found.effect_keys[each.factors], each.adjusted_p_value) for each in measure.effects]
            rows += [
                (found.contrast_keys[each.statement], adjusted.get((each.statement, beside)))
                for each in measure.contrasts
            ]
    return Reported.of([(key, {"adjusted p": value}) for key, value in rows if value is not None])


def _correlated(statistics: ExperimentStatistics, design: Design) -> Iterator[tuple[tuple[str, tuple[str, ...]], ...]]:
    """Yield the pairs of correlated measures, each with its varied factors."""
    for each in statistics.correlations:
        several = [(name, _of_measure(design, statistics, name)) for name in (each.first, each.second)]
        yield tuple((name, () if data is None else data.factors) for name, data in several)


def _of_measure(design: Design, statistics: ExperimentStatistics, name: str) -> MeasureData | None:
    return replace(design, without=runs_without_value(statistics.measure(name).left_out)).data(name)


def _without(statistics: ExperimentStatistics, correlated: Collection[str]) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Yield the correlated measures with values that are left out, with the runs of these."""
    for each in statistics.measures:
        if each.name in correlated and (gone := runs_without_value(each.left_out)):
            yield each.name, tuple(sorted(gone))


def _correlated_designs(
    statistics: ExperimentStatistics, design: Design
) -> Iterator[tuple[str, tuple[str, ...], Designed]]:
    """Yield the correlated measures, with their factors and the model of their design, if it is supported."""
    for name in dict.fromkeys(name for each in statistics.correlations for name in (each.first, each.second)):
        data = _of_measure(design, statistics, name)
        found = None if data is None else designed_facts(data, design.results)
        if data is not None and found is not None:
            yield name, data.factors, found


def _correlations(statistics: ExperimentStatistics, *, is_known: bool) -> Reported:
    """Return the correlations; those within treatments only if scripts support the model of the residuals."""
    rows: list[tuple[str, dict[str, Number]]] = []
    for each in statistics.correlations:
        row: dict[str, Number] = {
            "n": each.n,
            "Pearson's r": each.pearson,
            **ends(each.pearson_interval, "r "),
            "Spearman's rho": each.spearman,
            "p": each.p_value,
            "adjusted p": each.adjusted_p_value,
            "r within treatments": each.within if is_known else None,
        }
        rows.append((f"{each.first} and {each.second}", row))
    return Reported.of(rows)


_MARK = "\ufeff"
#: Time stamps in this form sort as texts.
_STAMPS = re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}Z", re.ASCII)


class Cells:
    """The raw cells of a run table.

    Attributes:
        delimiter: between the cells.
        renamed: columns whose headings differ from their names: the position from 1, and the name.
    """

    def __init__(self, path: Path, results: Results) -> None:
        try:
            text = read_bytes(path).decode()  # with the byte order mark, as R and pandas read it
        except ValueError as error:
            raise storage_error(path, "read", OSError(str(error))) from error
        layout = TableLayout.of_schema(tuple(results.columns.values()))
        lines = [line for line in text.splitlines(keepends=True) if line.strip()]
        self.delimiter = delimiter_of(lines[0].removeprefix(_MARK) if lines else "", layout)
        self._rows = [row for row in csv.reader(io.StringIO(text, newline=""), delimiter=self.delimiter) if row]
        first = self._rows.pop(0)
        bare = [first[0].removeprefix(_MARK), *first[1:]]
        self._places = dict(match_headings(bare, layout, TableFindings(path), line=1).places)
        self.renamed = tuple((at + 1, name) for name, at in self._places.items() if first[at] != name)

    def __contains__(self, name: object) -> bool:
        return name in self._places

    def column(self, name: str) -> list[str]:
        """Return the cells of a column; empty ones for a missing column."""
        place = self._places.get(name, -1)
        return [row[place] if 0 <= place < len(row) else "" for row in self._rows]


def source_of(results: Results, design: Design, cells: Cells, folder: Path) -> TableSource:
    """Return the facts for reading the run table."""
    path = ExperimentFolder.found_at(results.folder).run_table
    used = list(results.done[RUN_ID])
    batch = (results.batch if results.only_confirming else None) or ""
    confirming = tuple(map(str, results.confirming_batches)) if batch else ()
    chosen = _chosen(cells, used, cells.column(batch) if batch else (), confirming)
    wanted = set(used)
    stamps = [stamp for stamp, run in zip(cells.column(STAMP), cells.column(RUN_ID), strict=True) if run in wanted]
    is_stamped = STAMP in results.done and all(map(_STAMPS.fullmatch, stamps))
    places = [int(place) for place in design.frame[PLACE]]
    # If the clock was set back, only the journal has the order, which the script does not read.
    by_stamps = {at: place for place, at in enumerate(sorted(range(len(stamps)), key=stamps.__getitem__), start=1)}
    is_stamped = is_stamped and places == [by_stamps[at] for at in range(len(stamps))]
    is_ordered = is_stamped or places == list(range(1, len(places) + 1))
    texts = sorted({text for name in (*results.measures, EXCLUDED, WARM_UP) for text in cells.column(name)})
    return TableSource(
        path=os.path.relpath(path.resolve(), folder.resolve()).replace(os.sep, "/"),
        checksum=hashlib.md5(read_bytes(path), usedforsecurity=False).hexdigest(),
        delimiter=cells.delimiter,
        renamed=cells.renamed,
        done=chosen or (),
        missing=tuple(text for text in texts if _is_missing(text)),
        yes=tuple(filter(_is_yes, texts)),
        has_exclusions=EXCLUDED in cells,
        has_warm_ups=WARM_UP in cells,
        batch=batch,
        confirming=confirming,
        run_ids=() if chosen else tuple(used),
        stamp=STAMP if is_stamped else "",
        places=() if is_ordered else tuple(places),
    )


def _chosen(
    cells: Cells, used: Sequence[str], batches: Sequence[str], confirming: Sequence[str]
) -> tuple[str, ...] | None:
    """Return the status texts of runs that are done, or None if the columns do not determine which runs are used."""
    words = dict(zip(cells.column(RUN_ID), cells.column(STATUS), strict=True))
    done = tuple(dict.fromkeys(words.get(run, "") for run in used))
    columns = (words, words.values(), cells.column(EXCLUDED), cells.column(WARM_UP), batches or [""] * len(words))
    found = [
        run
        for run, word, why, warms, batch in zip(*columns, strict=True)
        if word in done and _is_missing(why) and not _is_yes(warms) and (not batches or batch in confirming)
    ]
    return done if found == list(used) and used else None


def _is_missing(text: str) -> bool:
    return text in MISSING or not text.strip()


def _is_yes(text: str) -> bool:
    return typed_value(text, "boolean") is True


def factor_columns(design: Design, cells: Cells) -> tuple[FactorColumn, ...]:
    """Return the treatments of each factor in their order, with their spelling in the file."""
    place = {run: at for at, run in enumerate(cells.column(RUN_ID))}
    found = []
    for name in (*design.factors, *design.constant):
        texts = cells.column(name)
        spelled: dict[str, dict[str, None]] = {label: {} for label in design.frame[name].cat.categories}
        for run, label in zip(design.frame[RUN_ID], design.frame[name], strict=True):
            spelled[label][texts[place[run]]] = None
        pairs = [(text, str(label)) for label, those in spelled.items() for text in those]
        found.append(FactorColumn(name, tuple(text for text, _ in pairs), tuple(of for _, of in pairs)))
    return tuple(found)
