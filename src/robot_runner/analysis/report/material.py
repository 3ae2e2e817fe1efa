"""What a report is made from: results, statistics, and what is derived of both."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

from robot_runner.analysis.planning.registered import Registered, registered
from robot_runner.analysis.report.blocks import Badge, Tone
from robot_runner.analysis.sample_files import noted
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

#: How the values of a measure can fall short, with an explanation for a badge.
_DOUBTED = {
    Quality.DOUBTFUL.value: "There are reasons to doubt these values: see Outcome of each run.",
    Quality.MISSING.value: "These runs are done and have no value.",
}
#: What a plugin notes about its raw samples: `runs/<run id>/<plugin>/quality.json`.
_FILE = "quality.json"


@dataclass(frozen=True, slots=True)
class RunQuality:
    """How complete the samples of one plugin in one run are; what is not known is None.

    Attributes:
        expected, got: how many samples there should be, and how many there are.
        coverage: share of the measured window that has samples, percent.
        lost, corrupt, duplicates: how many samples.
        largest_gap: longest time without a sample, s.
        saturated: how many samples reached the end of the sensor's range.
        is_simulated: whether the sensor is simulated.
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


def read_qualities(folder: ExperimentFolder, run_ids: Iterable[str]) -> tuple[RunQuality, ...]:
    """Return what is known of the samples of these runs; files that are no such notes are passed over."""
    paths = ((run_id, path) for run_id in run_ids for path in sorted(folder.run(run_id).glob(f"*/{_FILE}")))
    notes = ((run_id, path.parent.name, noted(path, folder.root)) for run_id, path in paths)
    return tuple(_quality(run_id, plugin, facts) for run_id, plugin, facts in notes if isinstance(facts, dict))


def by_plugin(qualities: Iterable[RunQuality]) -> dict[str, list[RunQuality]]:
    """Return what is known of the samples of each plugin."""
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


def noted_number(value: object) -> float | None:
    """Return what a plugin noted as a number; None where it is none, or not finite."""
    is_number = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    return float(value) if is_number else None  # type: ignore[arg-type]  # mypy does not follow the line above


#: Stands where there are no factors, or only one combination.
ALL_RUNS = "all runs"
#: Figures of more measures take minutes to make, and nobody looks at hundreds.
_MOST_DRAWN = 16
_ENERGY = frozenset({"J", "Wh", "kWh", "kJ", "mJ", "W", "mW"})
#: Between the treatments of a combination.
JOINT = " / "

_EXPLANATIONS = {
    "simulated": "It comes from a simulated sensor; it was not measured on a real robot.",
    "estimated": "A model estimates it; it was not measured.",
    "entered by hand": "A person entered it by hand.",
}


@dataclass(frozen=True)
class Material:
    """Results and statistics of one experiment; everything else is derived when it is first asked for.

    Attributes:
        results: the experiment.
        statistics: of the runs that are done.
    """

    results: Results
    statistics: ExperimentStatistics

    @cached_property
    def registered(self) -> Registered | None:
        """What was registered before the first run, and the deviations from it; None where nothing was."""
        return registered(self.results, self.statistics)

    @property
    def is_imported(self) -> bool:
        """Whether another tool, or a person, has executed the runs, and a table of theirs was imported."""
        return self.results.manifest.get("origin") == "imported"

    @cached_property
    def runs(self) -> pd.DataFrame:
        """The run table, without the runs that were excluded."""
        return self.results.runs

    @cached_property
    def excluded(self) -> pd.DataFrame:
        """The runs that were excluded, with the reason and the time of each."""
        return self.results.excluded

    @cached_property
    def done(self) -> pd.DataFrame:
        """The runs that are done."""
        return self.results.done

    def described(self, measure: MeasureStatistics) -> pd.DataFrame:
        """Return the runs that are done and have a value of a measure, without those whose value was left out."""
        without = runs_without_value(measure.left_out)
        return self.done[self.done[measure.name].notna() & ~self.done[RUN_ID].isin(without)]

    def residual_in_words(self, measure: MeasureStatistics) -> str:
        """Return what is taken from each value of a measure, so that its residual is left."""
        if self.statistics.design.kind != "full_factorial":
            return "less what effects and blocks of the design add to it"
        parts = [*measure.kept_together, *(["covariates"] if measure.adjustment is not None else [])]
        return f"less the mean of its combination{f' and what {enumerated(parts)} add to it' if parts else ''}"

    @cached_property
    def precisions(self) -> Mapping[str, KnownPrecision]:
        """How precisely each measure is known that the experiment was repeated for, by its name."""
        left_out = {each.name: [one.run_id for one in each.left_out] for each in self.statistics.measures}
        return {each.measure: each for each in known_precisions(self.results, left_out)}

    @property
    def order_of_runs(self) -> str:
        """The order over which a drift is looked for, in words: that of the table where runs do not tell another."""
        return "order of execution" if execution_order(self.results).is_known else "order of the table"

    @property
    def factors(self) -> tuple[str, ...]:
        """The factors that are compared: neither those that are blocks, nor those of one treatment, beside others."""
        return self.statistics.design.factors or self.results.factors

    @cached_property
    def labels(self) -> Mapping[str, str]:
        """The treatments of each run that are compared, as one text, by the run's id."""
        return self.labels_by(self.factors)

    def labels_by(self, factors: tuple[str, ...]) -> Mapping[str, str]:
        """Return each run's treatments of these factors, as one text, by the run's id."""
        if not factors:
            return dict.fromkeys(self.results.all_runs[RUN_ID], ALL_RUNS)
        runs = self.results.all_runs
        texts = zip(*(runs[name].astype("str") for name in factors), strict=True)
        return dict(zip(runs[RUN_ID], map(combination_label, texts), strict=True))

    @cached_property
    def order(self) -> tuple[str, ...]:
        """All combinations of `factors` that the run table has, in the order in which the config has the treatments."""
        return self.order_by(self.factors)

    def order_by(self, factors: tuple[str, ...]) -> tuple[str, ...]:
        """Return what `labels_by` yields, each text once, in the order in which the config has the treatments."""
        if not factors:
            return (ALL_RUNS,)
        rows = self.results.all_runs[list(factors)].drop_duplicates().sort_values(list(factors))
        texts = zip(*(rows[name].astype("str") for name in factors), strict=True)
        return tuple(map(combination_label, texts))

    @cached_property
    def drawn(self) -> frozenset[str]:
        """The measures that have figures, where there are many: planned ones first, then energy and power."""
        measures = sorted(self.statistics.measures, key=lambda each: (not each.is_planned, each.unit not in _ENERGY))
        return frozenset(measure.name for measure in measures[:_MOST_DRAWN])

    @cached_property
    def last_attempts(self) -> pd.DataFrame:
        """The last attempt of each run that was attempted."""
        return self.results.attempts.drop_duplicates("run_id", keep="last")

    @cached_property
    def executed(self) -> tuple[str, ...]:
        """The runs that were begun, in the order in which the last attempt at each was."""
        return tuple(executed_order(ExperimentFolder(self.results.folder).journal))

    @cached_property
    def moved(self) -> tuple[str, ...]:
        """The runs that were executed out of the order of the run table."""
        return moved_runs(list(self.results.all_runs[RUN_ID]), self.executed)

    @cached_property
    def qualities(self) -> tuple[RunQuality, ...]:
        """What plugins noted about their raw samples."""
        return read_qualities(ExperimentFolder(self.results.folder), list(self.runs[RUN_ID]))

    @cached_property
    def doubted(self) -> pd.DataFrame:
        """The values of runs that are done which are doubtful or missing, as `Results.quality` has them."""
        quality = self.results.quality
        return quality[quality["quality"].astype("str") != Quality.GOOD.value].reset_index(drop=True)

    def badges(self, measure: MeasureStatistics) -> tuple[Badge, ...]:
        """Return labels for a measure whose values were not all measured, or are not all good."""
        mine = self.doubted.loc[self.doubted["measure"] == measure.name, "quality"].astype("str")
        counts = {word: int((mine == word).sum()) for word in _DOUBTED}
        told = (Badge(f"{count:,} {word}", Tone.WARNING, _DOUBTED[word]) for word, count in counts.items() if count)
        return (*origin_badges(measure.origin), *told)

    @cached_property
    def counts(self) -> Mapping[RunStatus, int]:
        """How many runs there are in each status."""
        found = self.runs[STATUS].astype("str").value_counts()
        return {status: int(found.get(status.value, 0)) for status in RunStatus}

    @cached_property
    def origins(self) -> Mapping[str, Sequence[str]]:
        """The measures whose values were not, or not always, measured, by the word for it, as in `simulated`."""
        found: dict[str, list[str]] = {}
        for name in self.results.measures:
            column = self.results.columns[name]
            for badge in origin_badges(column.origin):
                found.setdefault(badge.text, []).append(name)
        return found

    def manifest(self, *keys: str, default: Any = None) -> Any:
        """Return what the manifest says under these keys, one within the other."""
        found: Any = self.results.manifest
        for key in keys:
            if not isinstance(found, Mapping) or key not in found:
                return default
            found = found[key]
        return default if found is None else found


def correction_in_words(correction: Correction) -> str:
    """Return who a correction is named after."""
    return {Correction.HOLM: "Holm", Correction.BENJAMINI_HOCHBERG: "Benjamini and Hochberg"}[correction]


def origin_in_words(origin: str | None) -> str:
    """Return a sentence, with a space before it, about values that were not measured; else nothing.

    Example:
        >>> origin_in_words("simulated")
        ' The values are simulated.'
    """
    words = " and ".join(badge.text for badge in origin_badges(origin))
    return f" The values are {words}." if words else ""


def origin_badges(*origins: str | None) -> tuple[Badge, ...]:
    """Return labels for values that were not, or not always, measured; each once.

    Example:
        >>> [badge.text for badge in origin_badges("measured, simulated")]
        ['simulated']
    """
    words = dict.fromkeys(word.strip() for origin in origins for word in (origin or "").split(","))
    return tuple(Badge(word, Tone.NOTE, _EXPLANATIONS[word]) for word in words if word in _EXPLANATIONS)
