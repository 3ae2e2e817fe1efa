"""Convert several experiments to the same names and units, and refuse those that are copies of each other."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from robot_runner.analysis.comparison.matching import in_unit, of_one_quantity
from robot_runner.analysis.statistics.analysed_design import VALUE, Design, MeasureData, design_of
from robot_runner.analysis.statistics.known_design import before_column
from robot_runner.analysis.statistics.left_out import left_out_of
from robot_runner.analysis.statistics.lost_runs import failures_in_words
from robot_runner.analysis.statistics.robustness import doubtful_runs
from robot_runner.core.design.columns import RUN_ID
from robot_runner.core.errors import Finding, did_you_mean, nearest
from robot_runner.core.storage.executed_runs import changes_in_words
from robot_runner.core.words import enumerated, listed

if TYPE_CHECKING:
    import pandas as pd

    from robot_runner.analysis.results import Results

#: Experiments that share this part of the smaller one's attempts or runs are copies, even if one went on or lost runs.
COPIED = 0.5
_PAIR = 2
#: Why an experiment counts as a copy although its runs were executed at other times.
SAME_VALUES = "every value is the same to the last digit, as of a copy, or a simulation with the same seed"


@dataclass(frozen=True, slots=True)
class Experiment:
    """One of several experiments, with the common names of factors and treatments.

    Attributes:
        design: the renamed design of its runs that are done, with the blocks and covariates of its own plan.
        doubtful: the runs whose value is doubtful, by measure.
        new_names: the common names of factors and treatments, by their own names, where they differ.
    """

    name: str
    results: Results
    design: Design
    doubtful: Mapping[str, Sequence[str]]
    new_names: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def of_results(cls, name: str, results: Results) -> Experiment:
        """Return an experiment with the choices of its own plan."""
        plan = results.plan
        design = design_of(results, blocks=plan.blocks if plan else None)
        return cls(name, results, replace(design, covariates=plan.covariates if plan else ()), doubtful_runs(results))

    @property
    def factors(self) -> tuple[str, ...]:
        """All factors, including those with a single treatment."""
        return (*self.design.factors, *self.design.constant)

    def treatments(self, factor: str) -> tuple[str, ...]:
        """Return a factor's treatments among the runs that are done, in their order."""
        if factor not in self.factors:
            return ()
        return tuple(map(str, self.design.frame[factor].cat.categories))

    def with_name(self, old: str, new: str) -> Experiment:
        """Return the experiment with a factor or treatment renamed, in all parts of its design."""

        def named(names: Iterable[str]) -> tuple[str, ...]:
            return tuple(new if name == old else name for name in names)

        design = self.design
        columns = {old: new, before_column(old): before_column(new)} if old in self.factors else {}
        frame, factors, constant = design.frame.rename(columns=columns), named(design.factors), named(design.constant)
        for name in (*factors, *constant):
            frame[name] = frame[name].cat.rename_categories({old: new} if old in frame[name].cat.categories else {})
            if (before := before_column(name)) in frame:
                frame[before] = frame[before].replace(old, new)
        conditions = {
            name: dict(zip(named(of), map(named, of.values()), strict=True))
            for name, of in zip(named(design.conditions), design.conditions.values(), strict=True)
        }
        known = design.known.with_name(old, new)
        design = replace(design, frame=frame, factors=factors, constant=constant, known=known, conditions=conditions)
        renamed = {own: new if name == old else name for own, name in self.new_names.items()}
        return replace(self, design=design, new_names={**renamed, old: new})

    def left_out(self, column: str) -> tuple[str, ...]:
        """Return the runs whose value of a measure is left out by the experiment's own plan."""
        left_out = left_out_of(self.design, column, self.results.plan, self.doubtful.get(column, ()))
        return tuple(each.run_id for each in left_out)

    def kept_doubtful(self, column: str) -> tuple[str, ...]:
        """Return the runs whose value of a measure is doubtful, and kept by the plan."""
        left_out = self.left_out(column)
        return tuple(run_id for run_id in self.doubtful.get(column, ()) if run_id not in left_out)

    def data(self, column: str, unit: str) -> MeasureData | None:
        """Return the values of a measure that the plan keeps, in this unit; None where they are not numbers."""
        design = replace(self.design, without=frozenset(self.left_out(column)))
        found, own = design.data(column), self.results.unit(column)
        if found is None or own == unit:
            return found

        def converted(frame: pd.DataFrame) -> pd.DataFrame:
            return frame.assign(**{VALUE: in_unit(frame[VALUE], own, unit)})

        return replace(found, frame=converted(found.frame), every=converted(found.every))


# Experiments that are given twice, or are copies.


def repeated(experiments: Sequence[Experiment]) -> Iterator[Finding]:
    """Yield an error for each experiment that is given twice, or is a copy of another."""
    for one, other in combinations(experiments, _PAIR):
        if why := sameness(one.results, other.results):
            fix = "Leave one of them out: it would count twice, and is not a replication."
            yield Finding.error(other.name, f"this is {one.name} again: {why}", fix)


def sameness(one: Results, other: Results) -> str:
    """Return why the second experiment is the same as the first; empty where it is not."""
    if one.folder == other.folder:
        return "both are the same folder"
    stamps = ["run_id", "attempt", "started_at"]
    attempts = [set(each.attempts[stamps].dropna().itertuples(index=False, name=None)) for each in (one, other)]
    smaller = min(map(len, attempts))
    if smaller and len(attempts[0] & attempts[1]) >= COPIED * smaller:
        return "the runs were executed at the same times, so that one is a copy of the other"
    return SAME_VALUES if _has_same_values(one, other) else ""


def same_runs(one: Results, other: Results) -> tuple[int, int]:
    """Return the number of runs whose measures are all equal in two experiments, to the last digit, and of how many.

    Where runs of one experiment have equal values, as by rounding, equality proves nothing: the number is 0.
    """
    values = _shared_values(one, other)
    if values is None:
        return 0, 0
    first, second = (each.loc[values[0].index.intersection(values[1].index)] for each in values)
    same = ((first == second) | (first.isna() & second.isna())).all(axis=1) & ((first.fillna(0.0) % 1) != 0).any(axis=1)
    alike = first[same]
    return (0 if alike.duplicated().any() else len(alike)), min(map(len, values))


def same_measures(one: Results, other: Results) -> tuple[str, ...]:
    """Return the measures that are equal in each run to the last digit, except where runs are equal by rounding."""
    values = _shared_values(one, other)
    if values is None or not values[0].index.equals(values[1].index):
        return ()
    first, second = values
    is_same = [first[name].equals(second[name]) and not first[name].dropna().duplicated().any() for name in first]
    return tuple(
        name for name, each in zip(first, is_same, strict=True) if each and (first[name].fillna(0.0) % 1).any()
    )


def _has_same_values(one: Results, other: Results) -> bool:
    """Return whether all measures are equal in each run; whole numbers alone may be equal by chance."""
    values = _shared_values(one, other)
    if values is None or not values[0].index.equals(values[1].index):
        return False
    first, second = (each.to_numpy(dtype=np.float64) for each in values)
    return bool(np.any(np.nan_to_num(first) % 1)) and np.array_equal(first, second, equal_nan=True)


def _shared_values(one: Results, other: Results) -> tuple[pd.DataFrame, pd.DataFrame] | None:
    """Return the decimal measures of both, by run id; None where there are none."""
    first, second = (each.done.set_index(RUN_ID).sort_index() for each in (one, other))
    shared = [
        name for name in one.measures if name in other.measures and first[name].dtype == "float64" == second[name].dtype
    ]
    return (first[shared], second[shared]) if shared and len(first) else None


# Names of factors and treatments.


def renamed(
    experiments: Sequence[Experiment], same: Sequence[str]
) -> tuple[tuple[Experiment, ...], tuple[Finding, ...]]:
    """Return the experiments with the user's names, each given as `NAME=OTHER`, and findings on these names."""
    findings: list[Finding] = []
    new_names: dict[str, str] = {}
    for text in same:
        known = {each for experiment in experiments for names in _kinds(experiment) for each in names}
        name, equals, other = text.partition("=")
        while name in new_names:
            name = new_names[name]
        while other in new_names:
            other = new_names[other]
        if name == other and name in known:
            continue
        if not equals or other not in known:
            problem = (
                f"no experiment has a factor or a treatment {other!r}"
                if equals
                else f"{text!r} names one name, not two"
            )
            fix = did_you_mean(other, sorted(known)) if equals else "Give both: --same Video=video."
            findings.append(Finding.error("--same", problem, fix))
            continue
        findings += [
            Finding.error(
                each.name, f"the experiment has both {name!r} and {other!r}", f"Leave out --same {shlex.quote(text)}."
            )
            for each in experiments
            if any({name, other} <= set(names) for names in _kinds(each))
        ]
        if not findings:
            experiments = [each.with_name(other, name) for each in experiments]
            new_names[other] = name
    return tuple(experiments), tuple(findings)


def _kinds(experiment: Experiment) -> Iterator[tuple[str, ...]]:
    """Yield groups of names that must be unique: the factors, and the treatments of each."""
    yield experiment.factors
    yield from map(experiment.treatments, experiment.factors)


def differing_names(experiments: Sequence[Experiment]) -> Iterator[Finding]:
    """Yield a warning for each factor, and each treatment, that one experiment lacks but others have."""
    varied = dict.fromkeys(name for each in experiments for name in each.design.factors)
    for experiment in experiments:
        others = [each for each in experiments if each is not experiment]
        own = [name for name in experiment.factors if not any(name in each.factors for each in others)]
        for factor in varied:
            if factor not in experiment.factors:
                yield Finding.warning(experiment.name, f"there is no factor {factor!r}", _same(factor, own))
            else:
                yield from _differing_treatments(experiment, others, factor)


def _differing_treatments(experiment: Experiment, others: Sequence[Experiment], factor: str) -> Iterator[Finding]:
    theirs = dict.fromkeys(name for each in others for name in each.treatments(factor))
    ours = experiment.treatments(factor)
    lacking = [name for name in theirs if name not in ours]
    if lacking:
        fixes = (_same(name, [each for each in ours if each not in theirs]) for name in lacking)
        problem = f"of {factor} there is no {enumerated(map(repr, lacking))}"
        yield Finding.warning(experiment.name, problem, " ".join(filter(None, fixes)))


def _same(name: str, candidates: Sequence[str]) -> str:
    whole = name.removesuffix(".0")  # a number may be written as 1 or as 1.0
    near = next((each for each in candidates if each.removesuffix(".0") == whole), None) or nearest(name, candidates)
    return "" if near is None else f"If {near!r} is the same, say so: --same {shlex.quote(f'{name}={near}')}."


# Measures and their units.


@dataclass(frozen=True, slots=True)
class MeasureChoice:
    """A measure to combine.

    Attributes:
        columns: its name in each experiment that has it.
        unit: the unit to which values are converted: the first known one.
        is_primary: whether a plan names it among its primary measures.
    """

    name: str
    columns: Mapping[str, str]
    unit: str
    is_primary: bool


def chosen_measures_of_all(
    experiments: Sequence[Experiment], wanted: Sequence[str] | None
) -> tuple[tuple[MeasureChoice, ...], tuple[Finding, ...]]:
    """Return the measures to combine, and findings on those that experiments lack.

    Wanted are names, or `one=other` where names differ between experiments; None for the primary measures of the plans
    or, without any, all numeric measures of at least two experiments.
    """
    texts = list(wanted) if wanted is not None else _planned(experiments) or _shared(experiments)
    chosen, findings = [], []
    if not texts:
        fix = "Say which is the same: --measure Energy=E."
        findings.append(
            Finding.error(enumerated(each.name for each in experiments), "these have no measure of one name", fix)
        )
    for text in texts:
        names = (text,) if any(text in each.results.measures for each in experiments) else tuple(text.split("="))
        columns = {
            each.name: next(name for name in names if name in each.results.measures)
            for each in experiments
            if any(name in each.results.measures for name in names)
        }
        if len(columns) >= _PAIR:
            units = [each.results.unit(columns[each.name]) for each in experiments if each.name in columns]
            is_primary = any(each.results.plan and set(names) & set(each.results.plan.measures) for each in experiments)
            chosen.append(MeasureChoice(names[0], columns, next(filter(None, units), ""), is_primary))
        findings += _lacking(names, columns, experiments)
    return tuple(chosen), tuple(findings)


def _lacking(names: Sequence[str], columns: Mapping[str, str], experiments: Sequence[Experiment]) -> Iterator[Finding]:
    """Yield findings on experiments without a measure: an error where fewer than two have it."""
    known = dict.fromkeys(name for each in experiments for name in each.results.measures)
    told = names[1:] if columns else names  # the first may be a new name
    if unknown := [name for name in told if name not in known]:
        for name in unknown:
            yield Finding.error("--measure", f"no experiment has a measure {name!r}", did_you_mean(name, known))
        return
    make = Finding.warning if len(columns) >= _PAIR else Finding.error
    for each in experiments:
        if each.name not in columns:
            yield make(each.name, f"there is no measure {names[0]!r}", _call(names, each.results))


def _planned(experiments: Sequence[Experiment]) -> list[str]:
    plans = [each.results.plan for each in experiments if each.results.plan is not None]
    return list(dict.fromkeys(name for plan in plans for name in plan.measures))


def _shared(experiments: Sequence[Experiment]) -> list[str]:
    names = [name for each in experiments for name in each.results.measures if each.design.data(name) is not None]
    return [name for name in dict.fromkeys(names) if names.count(name) >= _PAIR]


def _call(names: Sequence[str], results: Results) -> str:
    near = nearest(names[0], results.measures)
    return (
        "" if near is None else f"If {near!r} is the same, say so: --measure {shlex.quote('='.join((*names, near)))}."
    )


def value_findings(choice: MeasureChoice, experiments: Sequence[Experiment]) -> Iterator[Finding]:
    """Yield warnings of values of a measure that a plan leaves out, and of doubtful ones that it keeps."""
    for each in experiments:
        column = choice.columns.get(each.name)
        if column is None:
            continue
        if left_out := each.left_out(column):
            yield Finding.warning(each.name, f"the plan of this experiment leaves out {column} of {listed(left_out)}")
        if doubtful := each.kept_doubtful(column):
            fix = "Look at its report, which says what stands without them."
            yield Finding.warning(each.name, f"{column} of {listed(doubtful)} is doubtful", fix)


def notes_on_oddities(experiment: Experiment, columns: Sequence[str]) -> Iterator[str]:
    """Yield notes on values that the report leaves out and doubtful ones, which are compared; then on odd runs."""
    odd = {"left out by the report of": experiment.left_out, "doubtful in": experiment.kept_doubtful}
    for what, runs_of in odd.items():
        alike = dict[tuple[str, ...], list[str]]()
        for column in columns:
            if runs := runs_of(column):
                alike.setdefault(runs, []).append(column)
        for runs, found in alike.items():
            be, count = ("is", "counts") if len(found) == 1 else ("are", "count")
            yield f"{enumerated(found)} of {listed(runs)} {be} {what} {experiment.name}, and {count} all the same."
    results = experiment.results
    told = failures_in_words(results), changes_in_words(results.manifest), *(odd.problem for odd in results.findings)
    yield from (f"Of {experiment.name}, {why}." for why in told if why)


def unit_findings(choice: MeasureChoice, experiments: Sequence[Experiment]) -> Iterator[Finding]:
    """Yield findings on experiments with another unit of a measure, or without one."""
    for each in experiments:
        column = choice.columns.get(each.name)
        unit = choice.unit if column is None else each.results.unit(column)
        if unit == choice.unit:
            continue
        if not unit:
            problem = f"the unit of {column} is not known: its values are taken to be in {choice.unit}"
            yield Finding.warning(each.name, problem, "Name the unit, as in data_columns or when it is imported.")
        elif not of_one_quantity(unit, choice.unit):
            problem = f"{column} is in {unit}, which cannot be converted to {choice.unit}"
            yield Finding.error(each.name, problem, "Leave the experiment out, or name other measures with --measure.")
        else:
            yield Finding.warning(each.name, f"{column} is in {unit}: its values are converted to {choice.unit}")
