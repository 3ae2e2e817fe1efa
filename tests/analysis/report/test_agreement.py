"""In a report, sentences, tests, pairs, intervals and effect sizes of one comparison agree with each other."""

from __future__ import annotations

import copy
import json
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from scipy import stats
from tests.analysis.made_experiment import make_experiment
from tests.analysis.report.agreement import disagreements
from tests.analysis.statistics import reference_data as data
from tests.long_cases import soak_but

from robot_runner.analysis import load_results
from robot_runner.analysis.report.writing import ReportFormat, write_report
from robot_runner.core.design.factor import Factor

if TYPE_CHECKING:
    from pathlib import Path

#: Spreads of combinations, from alike to a hundred times larger.
SPREADS = {"alike": (1, 1, 1, 1, 1, 1), "one is large": (1, 1, 1, 1, 1, 8), "all differ": (0.1, 0.5, 1, 2, 5, 10)}
EFFECTS = {"none": (0, 0, 0), "one": (1.5, 0, 0), "all": (1, 1, 2)}
PLAN = {
    "measures": ["Energy", "Time"],
    "family": "primary",
    "hypotheses": [
        {"statement": "Offloading matters.", "measure": "Energy", "factors": ["Offloaded"]},
        {
            "statement": "It takes as long.",
            "measure": "Time",
            "factors": ["Offloaded"],
            "contrast": {"yes": 1, "no": -1},
            "within": 2,
        },
    ],
}


def report_of(folder: Path) -> dict[str, Any]:
    """Return the report of an experiment, as its JSON has it."""
    written = write_report(load_results(folder), ReportFormat.JSON, output=folder.parent / "out")
    found = json.loads(written.document.read_text(encoding="utf-8"))
    assert isinstance(found, dict)
    return found


def made(folder: Path, spreads: tuple[float, ...], effects: tuple[float, float, float], **more: Any) -> dict[str, Any]:
    """Return the report of two factors, with effects of the first, of the second, and of both together."""
    random = np.random.default_rng(int(10 * sum(spreads) + sum(effects)))
    factors = [Factor("Offloaded", ["no", "yes"]), Factor("Map", ["lab", "hall", "yard"])]

    def values(treatments: dict[str, Any], repetition: int) -> dict[str, Any] | None:
        one, other = treatments["Offloaded"] == "yes", ["lab", "hall", "yard"].index(treatments["Map"])
        if other == 2 and repetition > 5:
            return None  # unequal numbers of runs
        mean = 50 + effects[0] * one + effects[1] * other + effects[2] * one * other
        spread = spreads[3 * one + other]
        energy, time = (mean + spread * random.normal() for _ in range(2))
        return {"Energy": energy, "Time": time, "CPU": float(random.lognormal())}

    measures, units = ["Energy", "Time", "CPU"], {"Energy": "J"}
    experiment = make_experiment(
        folder / "made", factors, values, measures=measures, units=units, repetitions=8, **more
    )
    return report_of(experiment.root)


@pytest.mark.long
@pytest.mark.parametrize(
    "drawn",
    soak_but([("alike", "none"), ("one is large", "one"), ("all differ", "all")], product(SPREADS, EFFECTS)),
    ids=" ".join,
)
def test_reports_of_unequal_spreads_agree_with_themselves(tmp_path: Path, drawn: tuple[str, str]) -> None:
    spreads, effects = SPREADS[drawn[0]], EFFECTS[drawn[1]]
    plan = {"analysis": PLAN} if sum(effects) > 1 else {}
    assert disagreements(made(tmp_path, spreads, effects, **plan)) == []


@pytest.mark.long
@pytest.mark.parametrize("choice", [{"estimand": "rank"}, {"estimand": "trimmed mean"}, {"statistic": "anova-type"}])
def test_reports_of_other_choices_agree_with_themselves(tmp_path: Path, choice: dict[str, str]) -> None:
    assert disagreements(made(tmp_path, SPREADS["all differ"], (1, 1, 2), analysis={**PLAN, **choice})) == []


#: What a plan may say of values and covariates; one run of each treatment is doubtful, and some are far out.
DISCLOSED: dict[str, dict[str, Any]] = {
    "outliers": {"outliers": {"interquartile_ranges": 1.5, "bounds": {"Energy": [45, None]}}},
    "doubtful refused": {"doubtful": "refuse"},
    "covariates and ranks": {"covariates": ["CPU"], "estimand": "rank"},
    "all": {"covariates": ["CPU"], "outliers": {"median_deviations": 2.5}, "doubtful": "leave out"},
    "blocks": {"covariates": ["CPU", "order"], "blocks": "Repetition"},
}


@pytest.mark.long
@pytest.mark.parametrize("choice", soak_but({*DISCLOSED} - {"outliers"}, DISCLOSED))
def test_reports_of_what_a_plan_leaves_out_or_adjusts_for_agree_with_themselves(tmp_path: Path, choice: str) -> None:
    doubts = {"r_1": "the sensor was hot", "r_10": "the sensor was hot"}
    plan = {**PLAN, **DISCLOSED[choice]}
    report = made(tmp_path, SPREADS["all differ"], (1, 1, 2), analysis=plan, doubts=doubts)
    assert disagreements(report) == []


@pytest.mark.long
def test_reports_of_blocks_agree_with_themselves(tmp_path: Path) -> None:
    assert disagreements(made(tmp_path, SPREADS["all differ"], (1, 1, 2), blocks="Repetition")) == []


#: From R's `datasets` and textbooks; those of them in blocks have a value for each block in the same place.
PUBLISHED = {
    "PlantGrowth": (data.PLANT_GROWTH, None),
    "InsectSprays": (data.INSECT_SPRAYS, None),
    "chickwts": (data.CHICK_WEIGHTS, None),
    "airquality": (data.AIR_QUALITY, None),
    "sleep": (data.SLEEP, "Repetition"),
    "depression": (data.DEPRESSION, "Repetition"),
    "permeability": (data.PERMEABILITY, None),
    "mtcars": (data.MILES_PER_GALLON, None),
    "ToothGrowth": (data.TOOTH_GROWTH, None),
    "warpbreaks": (data.WARP_BREAKS, None),
    "ergoStool": (data.ERGO_STOOL, "Repetition"),
    "RoundingTimes": (data.ROUNDING_TIMES, "Repetition"),
    "Higgins1990Table1": (data.HIGGINS_TABLE_1, None),
}


@pytest.mark.parametrize(
    "name", soak_but({"sleep", "ToothGrowth", "warpbreaks", "ergoStool", "Higgins1990Table1"}, PUBLISHED)
)
def test_reports_of_published_data_agree_with_themselves(tmp_path: Path, name: str) -> None:
    given, blocks = PUBLISHED[name]
    groups = {(key,) if isinstance(key, str) else key: values for key, values in given.items()}
    names = ["A", "B"][: len(next(iter(groups)))]
    factors = [Factor(each, list(dict.fromkeys(key[place] for key in groups))) for place, each in enumerate(names)]

    def value(treatments: dict[str, Any], repetition: int) -> dict[str, Any] | None:
        mine = groups[tuple(treatments[each] for each in names)]
        return {"Energy": float(mine[repetition - 1])} if repetition <= len(mine) else None

    most = max(map(len, groups.values()))
    made = make_experiment(tmp_path / "made", factors, value, repetitions=most, blocks=blocks)
    report = report_of(made.root)
    assert report["statistics"]["measures"][0]["test"] is not None
    assert disagreements(report) == []


@pytest.mark.long
def test_the_report_of_the_demo_agrees_with_itself(executed_demo: Path, tmp_path: Path) -> None:
    written = write_report(executed_demo / "robot-runner-demo" / "basic_experiment", ReportFormat.JSON, output=tmp_path)
    assert disagreements(json.loads(written.document.read_text(encoding="utf-8"))) == []


def spread_out(mean: float, spread: float, count: int) -> list[float]:
    """Return values of a normal shape with exactly this mean and spread."""
    values = stats.norm.ppf((np.arange(count) + 0.5) / count)
    return [float(value) for value in mean + spread * values / values.std(ddof=1)]


def test_means_that_are_alike_are_not_told_to_differ(tmp_path: Path) -> None:
    # Unbalanced, with unequal spreads: a type II test with HC3 weighs combinations by their spread and says F(1, 128) =
    # 349, p < 0.001 of means that are 1.905 and 1.900.
    cells = {("no", "a"): (1.00, 0.02, 30), ("yes", "a"): (1.10, 0.02, 28)}
    cells |= {("no", "b"): (2.81, 0.9, 40), ("yes", "b"): (2.70, 0.9, 34)}
    values = {cell: spread_out(*of) for cell, of in cells.items()}

    def value(treatments: dict[str, Any], repetition: int) -> dict[str, Any] | None:
        mine = values[treatments["Offloaded"], treatments["Map"]]
        return {"Energy": mine[repetition - 1]} if repetition <= len(mine) else None

    factors = [Factor("Offloaded", ["no", "yes"]), Factor("Map", ["a", "b"])]
    report = report_of(make_experiment(tmp_path / "made", factors, value, repetitions=40).root)
    (measure,) = report["statistics"]["measures"]
    offloaded = measure["test"]["effects"][0]
    (pair,) = measure["post_hoc"][0]["comparisons"]
    assert pair["difference"] == pytest.approx(0.005)
    assert offloaded["p_value"] == pytest.approx(pair["p_value"])
    assert offloaded["p_value"] > 0.9
    assert "do not show an effect of Offloaded" in offloaded["conclusion"]
    assert disagreements(report) == []


@pytest.mark.long
def test_what_contradicts_itself_is_found(tmp_path: Path) -> None:
    report = made(tmp_path, SPREADS["alike"], (3, 0, 0))
    assert disagreements(report) == []

    def spoiled(change: Any) -> list[str]:
        other = copy.deepcopy(report)
        change(other["statistics"]["measures"][0])
        return disagreements(other)

    def effect(measure: dict[str, Any]) -> dict[str, Any]:
        return measure["test"]["effects"][0]  # type: ignore[no-any-return]

    def pair(measure: dict[str, Any]) -> dict[str, Any]:
        return measure["post_hoc"][0]["comparisons"][0]  # type: ignore[no-any-return]

    assert effect(report["statistics"]["measures"][0])["is_significant"]
    changes = [
        lambda measure: effect(measure).update(conclusion="The data do not show an effect of Offloaded."),
        lambda measure: effect(measure).update(is_significant=False),
        lambda measure: effect(measure)["check"].update(p_value=0.9),
        lambda measure: effect(measure)["effect_sizes"][0]["interval"].update(low=-9.0, high=9.0),
        lambda measure: pair(measure).update(p_value=0.9),
        lambda measure: pair(measure).update(is_significant=False),
        lambda measure: pair(measure)["interval"].update(low=-9.0, high=9.0),
        lambda measure: pair(measure).update(difference=99.0),
        lambda measure: pair(measure)["effect_sizes"][0].update(interval=None),
    ]
    for change in changes:
        assert spoiled(change)


@pytest.mark.long
def test_what_contradicts_the_plan_is_found(tmp_path: Path) -> None:
    plan = {**PLAN, "covariates": ["CPU"], "outliers": {"median_deviations": 2}}
    report = made(tmp_path, SPREADS["alike"], (3, 0, 0), analysis=plan)
    assert disagreements(report) == []

    def energy(statistics: dict[str, Any]) -> dict[str, Any]:
        return statistics["measures"][0]  # type: ignore[no-any-return]

    assert energy(report["statistics"])["left_out"]
    changes = [
        lambda statistics: energy(statistics)["left_out"].append(energy(statistics)["left_out"][0]),
        lambda statistics: energy(statistics)["adjustment"]["slopes"][0].update(
            p_value=0.9, interval={"low": 1, "high": 2}
        ),
        lambda statistics: energy(statistics)["adjustment"]["slopes"][0].update(treatments_p_value=0.001),
        lambda statistics: energy(statistics)["adjustment"]["means"][0].update(adjusted=99.0),
        lambda statistics: energy(statistics).update(adjustment=None),
        lambda statistics: statistics["standings"][0].update(stands=not statistics["standings"][0]["stands"]),
        lambda statistics: statistics["standings"][0].update(p_value_without=0.5),
    ]
    for change in changes:
        other = copy.deepcopy(report)
        change(other["statistics"])
        assert disagreements(other)
