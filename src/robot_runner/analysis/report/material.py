"""The input of a report: results, statistics, and values that are derived from both."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import TYPE_CHECKING, Any

from robot_runner.analysis.planning.registered import Registered, registered
from robot_runner.analysis.report.blocks import Badge, Tone
from robot_runner.analysis.run_frame import fact_of
from robot_runner.analysis.sample_files import noted_number, notes_of
from robot_runner.analysis.statistics.disclosed import runs_without_value
from robot_runner.analysis.statistics.execution_order import execution_order
from robot_runner.analysis.statistics.known_precision import KnownPrecision, known_precisions
from robot_runner.core.design.analysis_plan import Correction
from robot_runner.core.design.columns import RUN_ID, STATUS
from robot_runner.core.events.measure import Quality
from robot_runner.core.storage.cells import RunStatus
from robot_runner.core.storage.executed_runs import executed_order, moved_runs
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.words import combination_label, enumerated

if TYPE_CHECKING:
    import pandas as pd

    from robot_runner.analysis.results import Results
    from robot_runner.analysis.statistics.outcome import ExperimentStatistics, MeasureStatistics

#: The qualities of values that are not good, with an explanation for a badge.
_DOUBTED = {
    Quality.DOUBTFUL.value: "There are reasons to doubt these values: see Outcome of each run.",
    Quality.MISSING.value: "These runs are done and have no value.",
}
#: The file of a plugin's notes on its raw samples: `runs/<run id>/<plugin>/quality.json`.
_FILE = "quality.json"


@dataclass(frozen=True, slots=True)
class RunQuality:
    """The completeness of one plugin's samples in one run; None for an unknown value.

    Attributes:
        expected, got: the expected and the actual number of samples.
        coverage: share of the measured window that has samples, percent.
        largest_gap: longest time without a sample, s.
        saturated: the number of samples at the end of the sensor's range.
    """

    run_id: str
    plugin: str
    expected: int | None
    got: int | None
    coverage: float | None
    lost: int | None
    corrupt: int | None
    duplicates: int | None
    largest_gap: float | None
    saturated: int | None
    is_simulated: bool | None

    @property
    def is_complete(self) -> bool:
        """Whether nothing is known to be missing or damaged."""
        return not (self.lost or self.corrupt or (self.coverage is not None and self.coverage < 99.0))  # noqa: PLR2004 - the edges of a window


def by_plugin(qualities: Iterable[RunQuality]) -> dict[str, list[RunQuality]]:
    """Return the qualities, grouped by plugin."""
    found: dict[str, list[RunQuality]] = {}
    for each in qualities:
        found.setdefault(each.plugin, []).append(each)
    return found


def _quality(run_id: str, plugin: str, facts: Mapping[str, Any]) -> RunQuality:
    samples, is_simulated = facts.get("samples"), facts.get("is_simulated")
    known = {**(samples if isinstance(samples, dict) else {}), "saturated": facts.get("saturated")}
    names = ("expected", "got", "lost", "corrupt", "duplicates", "saturated")
    counts = {name: None if (found := noted_number(known.get(name))) is None else int(found) for name in names}
    return RunQuality(
        run_id,
        plugin,
        coverage=noted_number(known.get("coverage")),
        largest_gap=noted_number(known.get("largest_gap")),
        is_simulated=is_simulated if isinstance(is_simulated, bool) else None,
        **counts,
    )


#: The label of all runs, where there are no factors or only one combination.
ALL_RUNS = "all runs"
#: Figures of more measures take minutes to draw, and nobody looks at hundreds.
_MOST_DRAWN = 16
_ENERGY = frozenset({"J", "Wh", "kWh", "kJ", "mJ", "W", "mW"})
#: The separator of a combination's treatments.
JOINT = " / "

_EXPLANATIONS = {
    "simulated": "It comes from a simulated sensor; it was not measured on a real robot.",
    "estimated": "A model estimates it; it was not measured.",
    "entered by hand": "A person entered it by hand.",
}


@dataclass(frozen=True)
class Material:
    """Results of an experiment and statistics of its runs that are done; other values are derived at first use."""

    results: Results
    statistics: ExperimentStatistics

    @cached_property
    def registered(self) -> Registered | None:
        """The registration before the first run, and the deviations from it; None where there is none."""
        return registered(self.results, self.statistics)

    @property
    def is_imported(self) -> bool:
        """Whether the results were imported from another tool, or made by hand."""
        return self.results.manifest.get("origin") == "imported"

    @cached_property
    def runs(self) -> pd.DataFrame:
        """The run table without excluded runs."""
        return self.results.runs

    @cached_property
    def excluded(self) -> pd.DataFrame:
        """The excluded runs, with the reason and the time of each exclusion."""
        return self.results.excluded

    @cached_property
    def done(self) -> pd.DataFrame:
        """The runs that are done."""
        return self.results.done

    def described(self, measure: MeasureStatistics) -> pd.DataFrame:
        """Return the runs that are done and have a value of a measure that was not left out."""
        without = runs_without_value(measure.left_out)
        return self.done[self.done[measure.name].notna() & ~self.done[RUN_ID].isin(without)]

    def residual_in_words(self, measure: MeasureStatistics) -> str:
        """Return in words what is subtracted from a measure's values to get residuals."""
        if self.statistics.design.kind != "full_factorial":
            return "less what effects and blocks of the design add to it"
        parts = [*measure.kept_together, *(["covariates"] if measure.adjustment is not None else [])]
        return f"less the mean of its combination{f' and what {enumerated(parts)} add to it' if parts else ''}"

    @cached_property
    def precisions(self) -> Mapping[str, KnownPrecision]:
        """The precision of each measure for which the experiment was repeated, by name."""
        left_out = {each.name: [one.run_id for one in each.left_out] for each in self.statistics.measures}
        return {each.measure: each for each in known_precisions(self.results, left_out)}

    @property
    def order_of_runs(self) -> str:
        """The order in which drifts are estimated, in words: that of the table if that of execution is not known."""
        return "order of execution" if execution_order(self.results).is_known else "order of the table"

    @property
    def factors(self) -> tuple[str, ...]:
        """The compared factors: without blocks, and without factors of one treatment if there are others."""
        return self.statistics.design.factors or self.results.factors

    @cached_property
    def labels(self) -> Mapping[str, str]:
        """The compared treatments of each run as one text, by the run's id."""
        return self.labels_by(self.factors)

    def labels_by(self, factors: tuple[str, ...]) -> Mapping[str, str]:
        """Return each run's treatments of these factors, as one text, by the run's id."""
        if not factors:
            return dict.fromkeys(self.results.all_runs[RUN_ID], ALL_RUNS)
        runs = self.results.all_runs
        texts = zip(*(runs[name].astype("str").tolist() for name in factors), strict=True)
        return dict(zip(runs[RUN_ID].tolist(), map(cache(combination_label), texts), strict=True))

    @cached_property
    def order(self) -> tuple[str, ...]:
        """All combinations of `factors` in the run table, in the config's order of treatments."""
        return self.order_by(self.factors)

    def order_by(self, factors: tuple[str, ...]) -> tuple[str, ...]:
        """Return the distinct labels of `labels_by`, in the config's order of treatments."""
        if not factors:
            return (ALL_RUNS,)
        rows = self.results.all_runs[list(factors)].drop_duplicates().sort_values(list(factors))
        texts = zip(*(rows[name].astype("str") for name in factors), strict=True)
        return tuple(map(combination_label, texts))

    @cached_property
    def drawn(self) -> frozenset[str]:
        """The measures with figures; if there are many, planned ones first, then energy and power."""
        measures = sorted(self.statistics.measures, key=lambda each: (not each.is_planned, each.unit not in _ENERGY))
        return frozenset(measure.name for measure in measures[:_MOST_DRAWN])

    @cached_property
    def last_attempts(self) -> pd.DataFrame:
        """The last attempt at each run."""
        return self.results.attempts.drop_duplicates("run_id", keep="last")

    @cached_property
    def executed(self) -> tuple[str, ...]:
        """The runs that were begun, in the order of their last attempts."""
        return tuple(executed_order(ExperimentFolder(self.results.folder).journal))

    @cached_property
    def moved(self) -> tuple[str, ...]:
        """The runs that were not executed in the order of the run table."""
        return moved_runs(list(self.results.all_runs[RUN_ID]), self.executed)

    @cached_property
    def qualities(self) -> tuple[RunQuality, ...]:
        """The plugins' notes on their raw samples."""
        notes = notes_of(ExperimentFolder(self.results.folder), self.runs[RUN_ID], f"*/{_FILE}")
        return tuple(_quality(run, path.parent.name, facts) for run, path, facts in notes if isinstance(facts, dict))

    @cached_property
    def doubted(self) -> pd.DataFrame:
        """The doubtful and missing values of runs that are done, as in `Results.quality`."""
        quality = self.results.quality
        return quality[quality["quality"].astype("str") != Quality.GOOD.value].reset_index(drop=True)

    def badges(self, measure: MeasureStatistics) -> tuple[Badge, ...]:
        """Return badges for a measure whose values were not all measured, or are not all good."""
        mine = self.doubted.loc[self.doubted["measure"] == measure.name, "quality"].astype("str")
        counts = {word: int((mine == word).sum()) for word in _DOUBTED}
        told = (Badge(f"{count:,} {word}", Tone.WARNING, _DOUBTED[word]) for word, count in counts.items() if count)
        return (*origin_badges(measure.origin), *told)

    @cached_property
    def counts(self) -> Mapping[RunStatus, int]:
        """The number of runs in each status."""
        found = self.runs[STATUS].astype("str").value_counts()
        return {status: int(found.get(status.value, 0)) for status in RunStatus}

    @cached_property
    def origins(self) -> Mapping[str, Sequence[str]]:
        """The measures whose values were not, or not always, measured, by their origin, such as `simulated`."""
        found: dict[str, list[str]] = {}
        for name in self.results.measures:
            column = self.results.columns[name]
            for badge in origin_badges(column.origin):
                found.setdefault(badge.text, []).append(name)
        return found

    def manifest(self, *keys: str, default: Any = None) -> Any:
        """Return the manifest's entry at these nested keys."""
        return fact_of(self.results.manifest, *keys, default=default)


def correction_in_words(correction: Correction) -> str:
    """Return the authors of a correction."""
    return {Correction.HOLM: "Holm", Correction.BENJAMINI_HOCHBERG: "Benjamini and Hochberg"}[correction]


def origin_in_words(origin: str | None) -> str:
    """Return a sentence on values that were not measured, with a leading space; empty where all were.

    Example:
        >>> origin_in_words("simulated")
        ' The values are simulated.'
    """
    words = " and ".join(badge.text for badge in origin_badges(origin))
    return f" The values are {words}." if words else ""


def origin_badges(*origins: str | None) -> tuple[Badge, ...]:
    """Return badges for values that were not, or not always, measured; each once.

    Example:
        >>> [badge.text for badge in origin_badges("measured, simulated")]
        ['simulated']
    """
    words = dict.fromkeys(word.strip() for origin in origins for word in (origin or "").split(","))
    return tuple(Badge(word, Tone.NOTE, _EXPLANATIONS[word]) for word in words if word in _EXPLANATIONS)
