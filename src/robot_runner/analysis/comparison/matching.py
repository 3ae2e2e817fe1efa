"""Match the runs and measures of two experiments, and find the circumstances that differ."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pandas as pd

from robot_runner.analysis.arrays import Floats
from robot_runner.analysis.comparison.shared_units import APART, Units, same_robots, unit_columns_of_both
from robot_runner.analysis.importing.units import Unit, unit_of
from robot_runner.analysis.run_frame import fact_of, several
from robot_runner.core.design.columns import RUN_ID
from robot_runner.core.errors import AnalysisError, did_you_mean
from robot_runner.core.secret_names import shown_settings
from robot_runner.core.words import combination_label, enumerated, listed, shown_commit

if TYPE_CHECKING:
    from robot_runner.analysis.results import Results


@dataclass(frozen=True, slots=True)
class MatchedRuns:
    """The runs of one combination in both experiments.

    Attributes:
        treatments: the combination, by factor.
        first, second: their rows in the run tables; pairs have the same order.
        units: the units whose runs vary together.
    """

    treatments: Mapping[str, str]
    first: pd.DataFrame
    second: pd.DataFrame
    units: Units = APART

    def values(self, first: str, second: str, *, is_paired: bool) -> MatchedValues:
        """Return the values of a measure in both, without missing ones; of pairs, both values or none."""
        ours, theirs = numbers_of(self.first[first]), numbers_of(self.second[second])
        known = (np.isfinite(ours), np.isfinite(theirs))
        if is_paired:
            known = (known[0] & known[1],) * 2
        return MatchedValues(ours[known[0]], theirs[known[1]], self.units.of_runs(*known))


class MatchedValues(NamedTuple):
    """The values of a measure in both experiments, and the units whose values vary together."""

    first: Floats
    second: Floats
    units: Units


@dataclass(frozen=True, slots=True)
class Matching:
    """Matched runs of two experiments: the factors, one group for each combination, and notes for readers.

    Attributes:
        blocks: the columns of either experiment that are design columns but not treatments.
    """

    first: Results
    second: Results
    factors: tuple[str, ...]
    groups: tuple[MatchedRuns, ...]
    notes: tuple[str, ...]
    blocks: tuple[str, ...] = ()

    @property
    def together(self) -> tuple[str, ...]:
        """The units whose runs count together."""
        return tuple(dict.fromkeys(name for each in self.groups for name in each.units.names))


def are_answers(matching: Matching, names: tuple[str, str]) -> bool:
    """Return whether the values of a measure are yes or no in both experiments."""
    runs = (matching.first.runs[names[0]], matching.second.runs[names[1]])
    return all(isinstance(each.dtype, pd.BooleanDtype) for each in runs)


def match_runs(first: Results, second: Results, *, is_paired: bool) -> Matching:
    """Match the runs that are done by the treatments of the factors of both experiments.

    A column that is not a treatment in one design, such as the day, counts as none in the other, too.
    """
    columns = unit_columns_of_both(first, second)
    blocks = tuple(dict.fromkeys(name for each in columns for name in each.every))
    factors = tuple(name for name in first.factors if name in second.factors and name not in blocks)
    names = names_of(first, second)
    notes = _notes_on_factors(dict(zip(names, (first, second), strict=True)), factors, blocks)
    same = {name: _written_otherwise(first.done[name], second.done[name]) for name in factors}
    ours, theirs = _by_combination(first, factors), _by_combination(second, factors, same)
    notes += _notes_on_robots(first, second)
    for name, here, there in zip(names, (ours, theirs), (theirs, ours), strict=True):
        alone = [combination_label(_treatments(rows, factors)) for key, rows in here.items() if key not in there]
        if alone:
            notes.append(f"Only {name} has {', '.join(alone[:6])}{' and others' if len(alone) > 6 else ''}.")  # noqa: PLR2004
    groups = []
    for key, rows in ours.items():
        if key in theirs:
            pair = _paired(first, second, rows, theirs[key], blocks) if is_paired else (rows, theirs[key])
            units = Units.of(pair, columns)
            groups.append(MatchedRuns(dict(zip(factors, _treatments(rows, factors), strict=True)), *pair, units))
    if not is_paired:
        for place, (name, each) in enumerate(zip(names, (first, second), strict=True)):
            notes += _notes_on_batches(name, each, [(group.first, group.second)[place] for group in groups], blocks)
    told = [name for name in blocks if name in (*first.factors, *second.factors)]
    notes[:0] = [*_notes_on_blocks(told, groups), *([] if is_paired else _notes_on_same_units(first, second, groups))]
    return Matching(first, second, factors, tuple(groups), tuple(notes), blocks)


def chosen_measures(first: Results, second: Results, wanted: str | Sequence[str] | None) -> list[tuple[str, str]]:
    """Return the measures to compare, by their names in each experiment.

    Wanted are names, or `one=other` where they differ; None for all measures of both, except texts.

    Raises:
        AnalysisError: an experiment has no such measure, or they have none in common.
    """
    if wanted is None:
        shared = [(name, name) for name in first.measures if name in second.measures]
        if not shared:
            ours, theirs = next(iter(first.measures), "A"), next(iter(second.measures), "B")
            fix = f"Say which to compare: --measure {shlex.quote(f'{ours}={theirs}')}."
            raise AnalysisError("the experiments have no measure of one name", where=second.name, fix=fix)
        # A measure that is text in both, such as the robot's name, would make the common verdict undecided.
        return [each for each in shared if not all(map(are_texts, (first, second), each))] or shared
    return [_named(first, second, text) for text in several(wanted)]


def notes_on_left_out(
    called: Sequence[str], experiments: Sequence[Results], chosen: Sequence[tuple[str, str]]
) -> Iterator[str]:
    """Yield notes on measures that are not compared where none was asked for: texts, and those that one lacks."""
    shared = set.intersection(*(set(each.measures) for each in experiments))
    if texts := [name for name in experiments[0].measures if name in shared and (name, name) not in chosen]:
        yield f"No means are compared of what is text in both: {listed(texts)}."
    own = [[name for name in each.measures if name not in shared and not are_texts(each, name)] for each in experiments]
    yield from (
        f"Only {name} has {listed(each)}, not compared." for name, each in zip(called, own, strict=True) if each
    )
    if all(own):
        pair = shlex.quote(f"{own[0][0]}={own[1][0]}")
        yield f"If measures of other names are the same, say so: --measure {pair}."


def _named(first: Results, second: Results, text: str) -> tuple[str, str]:
    if text in first.measures and text in second.measures:  # a name may contain =
        return text, text
    ours, equals, theirs = text.partition("=")
    names = (ours, theirs if equals else ours)
    for results, name in zip((first, second), names, strict=True):
        if name not in results.measures:
            fix = did_you_mean(name, results.measures) or "Look at the run table."
            raise AnalysisError(f"there is no measure {name!r}", where=results.name, fix=fix)
    return names


def _notes_on_factors(
    experiments: Mapping[str, Results], factors: tuple[str, ...], blocks: tuple[str, ...]
) -> list[str]:
    notes = []
    for called, results in experiments.items():
        own = [name for name in results.factors if name not in (*factors, *blocks)]
        if own:
            notes.append(f"Only {called} has the factor {', '.join(own)}: its runs are taken together.")
    if not factors:
        beside = f" besides {listed(blocks)}" if blocks else ""
        notes.append(f"The experiments have no factor in common{beside}: all runs are compared as one group.")
    return notes


def _notes_on_blocks(blocks: Sequence[str], groups: Sequence[MatchedRuns]) -> Iterator[str]:
    together = dict.fromkeys(name for each in groups for name in each.units.names)
    if blocks:
        are, them = ("is not a treatment", "it") if len(blocks) == 1 else ("are not treatments", "them")
        apart = "" if together else ", and as no combination has several runs of one, each run counts by itself"
        yield f"{listed(blocks)} {are}, as the design adds {them}: runs are matched without {them}{apart}."
    if together:
        names = " or ".join(together)
        yield (
            f"Runs of one {names} vary together, and count together: chance is how much units of {names} differ. More "
            "runs of the same units hardly make the comparison more precise."
        )


def _notes_on_same_units(first: Results, second: Results, groups: Sequence[MatchedRuns]) -> Iterator[str]:
    for name in dict.fromkeys(name for each in groups for name in each.units.names):
        ours, theirs = (set(each.done[name].astype("str")) if name in each.done else None for each in (first, second))
        if ours == theirs:
            yield (
                f"Units of {name} have the same names in both, and are taken for others all the same. Where they are "
                "the same robots, rooms or people, `robot-runner compare --paired` compares within them."
            )


def _notes_on_robots(first: Results, second: Results) -> Iterator[str]:
    robots = same_robots(first, second)
    if robots:
        yield (
            f"Both experiments used {listed(robots)}, which are taken for the same robots. Where they are others, name "
            'Robot as the blocks of the analysis: AnalysisPlan(blocks="Robot").'
        )


def _notes_on_batches(
    name: str, results: Results, groups: Sequence[pd.DataFrame], blocks: Sequence[str]
) -> Iterator[str]:
    """Yield a note where runs of a combination are of several batches, of which there are too few to be units."""
    batch = results.batch
    if batch is None or batch in blocks or results.is_adaptive:
        return
    several = [set(rows[batch].fillna(1).astype(int)) for rows in groups]
    if found := set().union(*(each for each in several if len(each) > 1)):
        which = enumerated(map(str, sorted(found)))
        yield (
            f"{name} was extended: runs of its batches {which}, which were executed at other times, are compared as "
            "one. What changed between these is taken for chance between runs, and may pass for a difference of the "
            "experiments. Tests of treatments, in the reports, are within batches."
        )


def _by_combination(
    results: Results, factors: tuple[str, ...], names: Mapping[str, Mapping[str, str]] | None = None
) -> dict[tuple[str, ...], pd.DataFrame]:
    """Return the runs of each combination; `names` has other names of treatments, by factor."""
    done = results.done
    if not factors:
        return {(): done}
    by: dict[tuple[str, ...], pd.DataFrame] = {}
    for key, rows in done.groupby(list(factors), observed=True, sort=True):
        texts = zip(factors, map(str, key), strict=True)
        by[tuple((names or {}).get(name, {}).get(text, text) for name, text in texts)] = rows
    return by


def _written_otherwise(ours: pd.Series, theirs: pd.Series) -> dict[str, str]:
    """Return the names that we have for their treatments, where these are numbers that are written otherwise.

    A treatment 1 becomes 1.0 beside 0.5, and a text beside `auto`. Of texts on both sides each is another treatment, as
    versions 1 and 1.0 are.
    """
    if all(each.cat.categories.dtype == "str" for each in (ours, theirs)):
        return {}
    known, others = (list(map(str, each.cat.categories)) for each in (ours, theirs))
    whole = {text.removesuffix(".0"): text for text in known if text not in others}
    return {text: whole[same] for text in others if text not in known and (same := text.removesuffix(".0")) in whole}


def _treatments(rows: pd.DataFrame, factors: tuple[str, ...]) -> tuple[str, ...]:
    """Return the treatments of a combination as texts."""
    return tuple(str(rows[name].iloc[0]) for name in factors)


def _paired(
    first: Results, second: Results, ours: pd.DataFrame, theirs: pd.DataFrame, blocks: tuple[str, ...]
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return the rows as pairs: by run id within one experiment, otherwise by repetition, otherwise in order.

    Where both experiments have repetitions and blocks, runs of the same repetition and block are pairs.
    """
    if first.folder == second.folder:
        keys = (ours[RUN_ID], theirs[RUN_ID])
    elif first.repetition and second.repetition:
        shared = [name for name in blocks if name in ours and name in theirs]
        columns = ([*shared, first.repetition], [*shared, second.repetition])
        keys = tuple(
            pd.Series(list(rows[names].astype("str").itertuples(index=False, name=None)), dtype="object")
            for rows, names in zip((ours, theirs), columns, strict=True)
        )
    else:
        keys = (pd.Series(range(len(ours))), pd.Series(range(len(theirs))))
        if len(ours) != len(theirs):
            problem = f"a combination has {len(ours)} and {len(theirs)} runs, and nothing tells which belong together"
            raise AnalysisError(problem, where=second.name, fix=_UNPAIRED)
    for results, own in zip((first, second), keys, strict=True):
        if not own.is_unique:
            problem = (
                "a combination has several runs of one repetition, so that they are not pairs with those of another"
            )
            raise AnalysisError(problem, where=results.name, fix=_UNPAIRED)
    places = {key: place for place, key in enumerate(keys[1])}
    pairs = [(place, places[key]) for place, key in enumerate(keys[0]) if key in places]
    return ours.iloc[[ours_at for ours_at, _ in pairs]], theirs.iloc[[theirs_at for _, theirs_at in pairs]]


_UNPAIRED = "Compare without --paired, or experiments that have the same factors."


def of_one_quantity(own: str, wanted: str) -> tuple[Unit, Unit] | None:
    """Return two units that convert to each other; None where one is not known, or they measure other quantities."""
    ours, theirs = unit_of(own), unit_of(wanted)
    if ours is None or theirs is None:
        return None
    if {own, wanted} == {"%", "1"}:  # a share; elsewhere 1 may be any number without a unit
        ours, theirs = (_SHARE if each.symbol == "1" else each for each in (ours, theirs))
    return (ours, theirs) if ours.si == theirs.si else None


_SHARE = Unit("1", "%", 100.0)


def why_incomparable(own: str, wanted: str) -> str:
    """Return why values in two known units cannot be compared; empty where they can, or a unit is not known."""
    are_known = unit_of(own) is not None and unit_of(wanted) is not None
    is_one = not are_known or of_one_quantity(own, wanted) is not None
    return "" if is_one else f"The units are {wanted} and {own}, which measure different quantities."


def in_unit(values: Any, own: str, wanted: str) -> Any:
    """Return a number, or several, in the wanted unit; unchanged where the units do not convert."""
    units = of_one_quantity(own, wanted)
    if units is None or units[0] == units[1]:
        return values
    return (units[0].to_si(values) - units[1].offset) / units[1].factor


def are_texts(results: Results, measure: str) -> bool:
    """Return whether a measure has values that are not numeric; a text may say why there is no number."""
    values = results.done[measure]
    return bool(values.notna().any()) and not pd.api.types.is_numeric_dtype(values)


def numbers_of(values: pd.Series) -> Floats:
    """Return the values of a measure; NaN for a missing one, and for all where the measure is not numeric."""
    if not pd.api.types.is_numeric_dtype(values):
        return np.full(len(values), np.nan)
    return np.asarray(values.to_numpy(dtype=np.float64, na_value=np.nan))


_ASPECTS = (
    ("Robot", ("robot",)),
    ("Config", ("config", "file")),
    ("Seed of the order", ("seed",)),
    ("Set by hand", ("deviations",)),
    ("Robot Runner", ("software", "robot_runner")),
    ("Python", ("software", "python")),
    ("System", ("host", "system")),
    ("Machine", ("host", "machine")),
    ("Processor", ("host", "processor")),
)


def names_of(*experiments: Results) -> tuple[str, ...]:
    """Return unique names of experiments: their own, those of their folders, or their own with an ordinal."""
    own = tuple(each.name for each in experiments)
    for names in (own, tuple(each.folder.name for each in experiments)):
        if len(set(names)) == len(names):
            return names
    return tuple(
        f"{_ORDINALS.get(place, f'{place + 1}th')} {name}" if own.count(name) > 1 else name
        for place, name in enumerate(own)
    )


_ORDINALS = {0: "first", 1: "second", 2: "third"}


def differing_circumstances(*experiments: Results) -> tuple[tuple[str, ...], ...]:
    """Return the circumstances that differ between experiments: the circumstance, then its value in each."""
    rows = [("Runs that are done", *(str(len(each.done)) for each in experiments))]
    rows += [(name, *(_shown(fact_of(each.manifest, *keys)) for each in experiments)) for name, keys in _ASPECTS]
    blocks = {name for each in unit_columns_of_both(*experiments) for name in each.every}
    for factor in experiments[0].factors:
        if all(factor in each.factors for each in experiments):
            treatments = (", ".join(map(str, each.runs[factor].cat.categories)) for each in experiments)
            rows.append((factor if factor in blocks else f"Treatments of {factor}", *treatments))
            revisions = [fact_of(each.manifest, "revisions", factor, default={}) for each in experiments]
            for name in revisions[0]:
                of_each = [each.get(name) or {} for each in revisions]
                if len({facts.get("commit") for facts in of_each}) > 1:  # not where its repository was
                    rows.append((f"{factor} {name}", *map(shown_commit, of_each)))
    return tuple(row for row in rows if len(set(row[1:])) > 1)


def _shown(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{name} = {each}" for name, each in shown_settings(value).items()) or "nothing"
    return "not recorded" if value is None else str(value)
