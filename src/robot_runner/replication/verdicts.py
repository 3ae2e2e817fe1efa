"""The verdict of a replication: a conclusion for each measure, one for the experiment, and an exit code."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any

from robot_runner.core.events.measure import OPERATOR_OWNER, QUALITY_SUFFIX, ROBOTS_OWNER
from robot_runner.core.storage.table_columns import ColumnDescription, ColumnRole
from robot_runner.core.words import combination_label, counted, enumerated, has_true_zero, listed
from robot_runner.replication.needed_runs import needed_runs
from robot_runner.replication.run_by_run import Sameness

#: The default bound of differences that do not matter: a convention, and called one wherever it is used.
DEFAULT_BOUND = "5%"
#: The same for units without a true zero: temperatures (degrees Fahrenheit are smaller) and decibels.
_DEGREES, _DEGREES_FAHRENHEIT, _DECIBELS = "2", "3.6", "1"
_TIMES = frozenset({"ns", "us", "\N{MICRO SIGN}s", "\N{GREEK SMALL LETTER MU}s", "ms", "s", "min", "h"})
_MEASURED = frozenset({None, "", "measured"})


class Conclusion(Enum):
    """A conclusion on a measure, or on all primary measures together.

    IDENTICAL: the same value in every run, to the last digit. EQUIVALENT: no difference as large as the bound.
    DIFFERENT: a difference that chance does not explain, or one without random variation. UNDECIDED: nothing was
    compared, or too little for any of the others.
    """

    IDENTICAL = "identical"
    EQUIVALENT = "equivalent"
    DIFFERENT = "different"
    UNDECIDED = "undecided"

    @property
    def exit_code(self) -> int:
        """The exit code of this conclusion."""
        return {Conclusion.DIFFERENT: 3, Conclusion.UNDECIDED: 4}.get(self, 0)


@dataclass(frozen=True, slots=True)
class Margin:
    """The largest difference of a measure that does not matter.

    Attributes:
        text: in the form of `compare --bound`: a percentage of the original's mean, or a number in the measure's unit.
        source: where it comes from, in words.

    Example:
        >>> str(Margin("5%", "--bound"))
        '5 %'
    """

    text: str
    source: str

    def __str__(self) -> str:
        return f"{self.text.strip().removesuffix('%')} %" if self.text.strip().endswith("%") else self.text.strip()


@dataclass(frozen=True, slots=True)
class MeasureConclusion:
    """The conclusion of a replication on one measure.

    Attributes:
        runs: the number of runs with a value in either experiment.
        bound: the largest difference that does not matter, in words; empty if no bound was needed.
        bound_source: where the bound comes from.
        sentence: the conclusion in words.
        secondary_because: why the measure does not count in the verdict; empty for a primary measure.
    """

    name: str
    unit: str
    conclusion: Conclusion
    runs: int
    bound: str
    bound_source: str
    sentence: str
    secondary_because: str = ""


@dataclass(frozen=True, slots=True)
class ReplicationVerdict:
    """The verdict of a replication.

    Attributes:
        conclusion: of all primary measures together.
        sentence: the same in words.
        measures: one conclusion for each measure, the primary ones first.
    """

    conclusion: Conclusion
    sentence: str
    measures: tuple[MeasureConclusion, ...]


#: Why measures of these owners are not primary without a plan that names measures.
_CIRCUMSTANCES = {ROBOTS_OWNER: "it is which robot was free", OPERATOR_OWNER: "it is what the operator answered"}


def why_not_primary(
    columns: Sequence[ColumnDescription], manifest: Mapping[str, Any], empty: Collection[str] = ()
) -> dict[str, str]:
    """Return by name why a measure is not primary; the text is empty for a primary measure.

    The primary measures are those in the analysis plan. Without a plan, all are primary except: durations on this
    machine's clock with a simulated robot, which depend on the machine's load; the robot of a run, if there are
    several; the operator's answers, which describe the circumstances; and measures that are `empty` in both
    experiments. If none remained, all are primary.
    """
    measures = [each for each in columns if each.role is ColumnRole.MEASURE and not each.name.endswith(QUALITY_SUFFIX)]
    plan = manifest.get("analysis") or {}
    planned = {column.name for column in measures if column.name in (plan.get("measures") or ())}
    is_simulated = str(manifest.get("robot") or "").startswith("simulated")
    found = {}
    for column in measures:
        if planned:
            found[column.name] = "" if column.name in planned else "the plan does not name it as primary"
        else:
            is_timing = is_simulated and column.unit in _TIMES and column.origin in _MEASURED
            because = "it is how long the machine took" if is_timing else _CIRCUMSTANCES.get(column.owner, "")
            found[column.name] = "neither experiment has a value of it" if column.name in empty else because
    return found if not all(found.values()) else dict.fromkeys(found, "")


def margins_of(units: Mapping[str, str], manifest: Mapping[str, Any], given: Sequence[str]) -> dict[str, Margin]:
    """Return the margin of each measure: the given one, else the planned one, else the default.

    Args:
        units: the units of the measures, by name.
        manifest: the original's; a hypothesis of equivalence in its plan has a margin for its measure.
        given: `5%` or `10` for every measure, `NAME=5%` for one, as in `--bound`; already validated.
    """
    own = {name: text for name, equals, text in (each.rpartition("=") for each in given) if equals}
    general = next((each for each in given if "=" not in each), None)
    planned = _planned(manifest.get("analysis") or {})
    found = {}
    for name, unit in units.items():
        if name in own or general is not None:
            found[name] = Margin(own.get(name, general or ""), "as --bound says")
        elif name in planned:
            found[name] = Margin(f"{planned[name]:g}", "the margin of equivalence in the plan of the original")
        else:
            found[name] = Margin(_default(unit), "the default, as neither --bound nor the plan says what matters")
    return found


def _default(unit: str) -> str:
    """Return the default margin for a unit."""
    if has_true_zero(unit):
        return DEFAULT_BOUND
    plain = unit.strip().lower()
    return _DECIBELS if plain.startswith("db") else _DEGREES_FAHRENHEIT if "f" in plain else _DEGREES


def _planned(plan: Mapping[str, Any]) -> dict[str, float]:
    """Return by measure the smallest margin of a difference of two means in the hypotheses."""
    found: dict[str, float] = {}
    for each in plan.get("hypotheses") or ():
        margin, name = (each.get("within"), each.get("measure")) if isinstance(each, dict) else (None, None)
        if not isinstance(margin, int | float) or not 0 < margin < math.inf:
            continue
        # A contrast's margin is that of the weighted sum; a difference of two means has the weights 1 and -1.
        weights = (each.get("contrast") or {}).values()
        weight = sum(abs(float(weight)) for weight in weights) / 2 or 1.0
        found[str(name)] = min(margin / weight, found.get(str(name), float("inf")))
    return found


def reached_verdict(
    columns: Sequence[ColumnDescription],
    manifest: Mapping[str, Any],
    same: Mapping[str, Sameness],
    margins: Mapping[str, Margin],
    comparison: Mapping[str, Any] | None,
) -> ReplicationVerdict:
    """Return the verdict of the replication.

    Args:
        columns: the columns of the original's run table.
        manifest: the original's.
        same: the comparison run by run of each measure that both have.
        margins: the largest difference that does not matter, by measure.
        comparison: the output of `robot-runner compare --json`, as plain data; None if it was not executed.
    """
    empty = {name for name, each in same.items() if not each.runs and not each.lacking}
    secondary = why_not_primary(columns, manifest, empty)
    compared = {each["first_name"]: each for each in (comparison or {}).get("measures", ()) if _has_numbers(each)}
    units = {column.name: column.unit if column.unit != "1" else "" for column in columns}
    measures = [
        _judged(
            _Judged(name, units[name], same.get(name), margins[name], compared.get(name)),
            untested=_why_untested(name, comparison),
            secondary_because=because,
        )
        for name, because in secondary.items()
    ]
    measures.sort(key=lambda each: bool(each.secondary_because))
    primary = [each for each in measures if not each.secondary_because]
    conclusion = _of_all([each.conclusion for each in primary])
    return ReplicationVerdict(conclusion, _sentence_of_all(conclusion, primary, len(measures)), tuple(measures))


@dataclass(frozen=True, slots=True)
class _Judged:
    """A measure with the results that its conclusion depends on."""

    name: str
    unit: str
    same: Sameness | None
    margin: Margin
    found: Mapping[str, Any] | None

    @property
    def label(self) -> str:
        return self.name if self.unit in {"", "1"} else f"{self.name} ({self.unit})"

    @property
    def bound(self) -> str:
        unit = "" if self.margin.text.strip().endswith("%") else self.unit
        return f"{self.margin} {unit}".strip()


def _has_numbers(found: Mapping[str, Any]) -> bool:
    """Return whether any combination has a mean; texts have none, and are not tested."""
    return any(each["first_mean"] is not None for each in found["differences"])


def _why_untested(name: str, comparison: Mapping[str, Any] | None) -> str:
    """Return why there are no statistics of a measure, where there are none."""
    if comparison is None:
        return (
            "no statistics were at hand to tell whether that matters (install the extra `analysis`, and repeat "
            "the command: no run is executed again)"
        )
    found = (each["differences"] for each in comparison.get("measures", ()) if each["first_name"] == name)
    differences = next(found, None)
    if differences == []:
        return "no combination is compared that both have (of a search, only runs that confirm it are)"
    if any(each["second_mean"] is not None for each in differences or ()):
        return "the original has no number of it"
    return "its values are not numbers, and one execution does not tell whether that is chance"


def _judged(judged: _Judged, *, untested: str, secondary_because: str) -> MeasureConclusion:
    same, runs = judged.same, 0 if judged.same is None else judged.same.runs
    if same is not None and same.is_complete:
        conclusion, told = Conclusion.IDENTICAL, f"is identical in {_all_runs(runs)}, to the last digit."
    elif same is None or not runs:
        told = "could not be decided: no run has a value of it in both experiments."
        conclusion = Conclusion.UNDECIDED
    elif same.is_same:
        told = f"could not be decided: it is identical in {_all_runs(runs)} that can be compared, and {_lacking(same)}."
        conclusion = Conclusion.UNDECIDED
    elif judged.found is None:
        conclusion = Conclusion.UNDECIDED
        told = f"could not be decided: it differs in {runs - same.identical} of {counted(runs, 'run')}, and {untested}."
    else:
        conclusion, told = _by_statistics(judged, judged.found)
        told = f"{told.removesuffix('.')}; {_lacking(same)}." if same.lacking else told
    is_bounded = judged.found is not None and not (same is not None and same.is_same)
    return MeasureConclusion(
        judged.name,
        judged.unit,
        conclusion,
        runs,
        judged.bound if is_bounded else "",
        judged.margin.source if is_bounded else "",
        f"{judged.label} {told}",
        secondary_because,
    )


def _lacking(same: Sameness) -> str:
    """Return in words how many runs of the original the replication lacks."""
    are = "is" if same.lacking == 1 else "are"
    return f"{counted(same.lacking, 'run')} of the original {are} not done here, or excluded"


def _by_statistics(judged: _Judged, found: Mapping[str, Any]) -> tuple[Conclusion, str]:
    """Return the conclusion of a comparison, and a predicate whose subject is the measure."""
    differences = found["differences"]
    verdicts = [Conclusion(each["verdict"]) for each in differences]
    conclusion = _of_all(verdicts)
    within = f"{judged.bound} ({judged.margin.source})"
    # A comparison environment that was made by an earlier version does not report it.
    largest = f"; the largest difference is {found['largest']}" if found.get("largest") else ""
    if conclusion in {Conclusion.EQUIVALENT, Conclusion.IDENTICAL}:  # of all existing values; a run may lack one
        return Conclusion.EQUIVALENT, f"is equivalent within {within}{largest}."
    pairs = zip(differences, verdicts, strict=True)
    concerned = [_combination(each) for each, verdict in pairs if verdict is conclusion]
    where = f" for {listed(concerned)}" if concerned and len(differences) > 1 else ""
    if conclusion is Conclusion.DIFFERENT:
        return conclusion, f"is different{where}{largest}; the bound was {within}."
    levels = [each["interval"]["level"] for each in differences if each.get("interval")]
    alpha = 1 - levels[0] if levels else 0.05
    needed = needed_runs(differences, alpha, is_relative=judged.margin.text.strip().endswith("%"))
    return conclusion, f"could not be decided{where} within {within}{largest}: {needed}."


def _combination(each: Mapping[str, Any]) -> str:
    return combination_label(each["treatments"].values()) or "all runs"


def _of_all(conclusions: Sequence[Conclusion]) -> Conclusion:
    """Return the joint conclusion: different if one is different, identical only if all are."""
    for each in (Conclusion.DIFFERENT, Conclusion.UNDECIDED, Conclusion.EQUIVALENT):
        if each in conclusions:
            return each
    return Conclusion.IDENTICAL if conclusions else Conclusion.UNDECIDED


def _sentence_of_all(conclusion: Conclusion, primary: Sequence[MeasureConclusion], measure_count: int) -> str:
    concerned = enumerated(each.name for each in primary if each.conclusion is conclusion)
    if conclusion is Conclusion.IDENTICAL:
        runs = counted(max(each.runs for each in primary), "run")
        what = "value" if len(primary) == measure_count else f"value of {enumerated(each.name for each in primary)}"
        return f"The results are identical: every {what} of {runs}, to the last digit."
    if conclusion is Conclusion.EQUIVALENT:
        bounds = " and ".join(dict.fromkeys(each.bound for each in primary if each.bound))
        return f"The results are equivalent: no difference reaches the bound of {bounds}."
    if conclusion is Conclusion.DIFFERENT:
        return f"The results are different: {concerned}."
    if not primary or not any(each.runs for each in primary):
        return "The results could not be compared: no run has a value in both experiments."
    return f"Whether the results agree could not be decided: {concerned}."


def _all_runs(runs: int) -> str:
    return "the one run" if runs == 1 else f"all {runs:,} runs"
