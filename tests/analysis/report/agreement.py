"""Whether sentences, tests, pairs, intervals and effect sizes of a report agree with each other, by its JSON alone."""

from __future__ import annotations

import re
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import stats

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = ["disagreements"]

#: P-values of one comparison that were computed on two ways differ by rounding.
_SAME = 1e-9
#: Where a report has what was computed with one choice made otherwise.
_BESIDE = {
    "without doubtful values": "without_doubtful",
    "with all runs": "with_all_runs",
    "without covariates": "without_covariates",
}
_MAGNITUDES = ("negligible", "small", "medium", "large")


def disagreements(report: dict[str, Any]) -> list[str]:
    """Return what contradicts itself in a report, as `report.json` has it; nothing where all agree.

    Example:
        >>> disagreements({"statistics": {"alpha": 0.05, "measures": [], "without_doubtful": [], "hypotheses": []}})
        []
    """
    statistics = report["statistics"]
    alpha = statistics["alpha"]
    found: list[str] = []
    beside = [each for kind in _BESIDE.values() for each in statistics.get(kind, ())]
    for measure in (*statistics["measures"], *beside):
        found += [f"{measure['name']}: {each}" for each in _of_measure(measure, alpha)]
    for outcome in statistics["hypotheses"]:
        found += [f"{outcome['hypothesis']['statement']}: {each}" for each in _of_hypothesis(outcome, statistics)]
    for known in report.get("precision", ()):
        found += [f"{known['measure']}: {each}" for each in _of_precision(known, statistics)]
    for standing in statistics.get("standings", ()):
        found += [f"{standing['measure']}: {each}" for each in _of_standing(standing, statistics)]
    return [*found, *_of_registration(report)]


def _of_registration(report: dict[str, Any]) -> Iterator[str]:
    """Yield where what is said of a registration contradicts what else the report has."""
    found = report.get("registration")
    threats = {each["title"] for each in report.get("threats", ())}
    if found is None:
        if threats & {"Deviations from the registration", "The registration cannot be trusted"}:
            yield "there is a threat of a registration, and no registration"
        return
    told, problem = found["deviations"], found["problem"]
    if ("Deviations: none." in found["sentence"]) is not (not told and not problem):
        yield f"{len(told)} deviations, and the sentence says: {found['sentence']}"
    if any(each not in found["sentence"] for each in told) or found["sha256"] not in found["sentence"]:
        yield f"the sentence does not cite the registration, or lacks a deviation: {found['sentence']}"
    expected = {"Deviations from the registration": bool(told), "The registration cannot be trusted": bool(problem)}
    for title, is_due in expected.items():
        if (title in threats) is not is_due:
            yield f"the threat {title!r} is {'missing' if is_due else 'there without a reason'}"
    if problem:
        return
    tested = [each["name"] for each in report["statistics"]["measures"] if each["test"] and not each["is_planned"]]
    facts = {
        "excluded": bool(report["excluded"]),
        "extended beyond": len(report["design"]["batches"]) > 1,
        "not planned": report["statistics"]["is_planned"] and bool(tested),
        "not done": any(run["status"].casefold() != "done" for run in report["runs"]),
    }
    for words, is_so in facts.items():
        if any(words in each for each in told) is not is_so:
            yield f"{words!r} is {'so' if is_so else 'not so'}, and the deviations are: {told}"


def _of_precision(known: dict[str, Any], statistics: dict[str, Any]) -> Iterator[str]:
    """What was repeated for has one interval of each mean, in the text as in the tables."""
    measure = next(each for each in statistics["measures"] if each["name"] == known["measure"])
    tabled = {" / ".join(each["treatments"].values()): each for each in _finest(measure)}
    for mean in known["means"]:
        group = tabled.get(mean["of"])
        interval = group and group["mean_interval"]
        if interval is None or mean["half_width"] is None:
            continue
        half_width = (interval["high"] - interval["low"]) / 2
        if abs(half_width - mean["half_width"]) > _SAME * abs(half_width) or group["n"] != mean["n"]:
            yield f"{mean['of']} is known to {mean['half_width']} (n = {mean['n']}), and to {half_width} in its table"
    if "each difference" not in known["asked"]:
        widths = [(each["half_width"], each["wanted"]) for each in known["means"]]
        precise = all(half_width is not None and half_width <= wanted for half_width, wanted in widths)
        if known["is_reached"] is not precise:
            yield f"precision is {'' if known['is_reached'] else 'not '}reached, and its means say otherwise"
    if known["asked"] not in known["sentence"] or f"After {known['repetitions']}," not in known["sentence"]:
        yield f"the sentence tells another rule: {known['sentence']}"


def _finest(measure: dict[str, Any]) -> list[dict[str, Any]]:
    return measure["by_combination"] or measure["by_treatment"] or [measure["overall"]]


def _of_measure(measure: dict[str, Any], alpha: float) -> Iterator[str]:
    test = measure["test"]
    yield from _of_plan(measure, alpha)
    if test is None:
        if measure["post_hoc"] or not (measure["not_computed"] or measure["overall"] is None):
            yield "there are pairs without a test, or no reason why there is no test"
        return
    pairs = {tuple(each["factors"]): each["comparisons"] for each in measure["post_hoc"]}
    for effect in test["effects"]:
        yield from _of_effect(effect, pairs.get(tuple(effect["factors"]), []), alpha)
    for post_hoc in measure["post_hoc"]:
        for pair in post_hoc["comparisons"]:
            yield from _of_pair(pair, alpha)
        adjusted = [
            each["adjusted_p_value"] for each in post_hoc["comparisons"] if each["adjusted_p_value"] is not None
        ]
        raw = [each["p_value"] for each in post_hoc["comparisons"] if each["p_value"] is not None]
        if len(adjusted) != len(raw) or any(
            after < before - _SAME for after, before in zip(adjusted, raw, strict=True)
        ):
            yield f"pairs of {post_hoc['factors']} have adjusted p-values below those before adjustment"
    for name, value in _reasons_missing(measure):
        yield f"{name} has no {value}, and nothing says why"


def _of_effect(effect: dict[str, Any], pairs: list[dict[str, Any]], alpha: float) -> Iterator[str]:
    what = " x ".join(effect["factors"])
    p_value, adjusted, significant = effect["p_value"], effect["adjusted_p_value"], effect["is_significant"]
    if p_value is None:
        if "was not computed" not in effect["conclusion"] or significant is not None:
            yield f"{what} has no p-value, and its sentence claims something"
        return
    if adjusted is None or adjusted < p_value - _SAME or significant is not (adjusted < alpha):
        yield f"{what} is {'' if significant else 'not '}significant with p = {p_value} and {adjusted} adjusted"
    claims = " has an effect on " in effect["conclusion"] or " depends on " in effect["conclusion"]
    if claims is not significant or ("do not show" in effect["conclusion"]) is significant:
        yield f"{what} is {'' if significant else 'not '}significant, and its sentence says: {effect['conclusion']}"
    for size in effect["effect_sizes"]:
        yield from _of_size(what, size, p_value, alpha)
    first = effect["effect_sizes"][0] if effect["effect_sizes"] else None
    if significant and first is not None and f"is {first['magnitude']}" not in effect["conclusion"]:
        yield f"{what} is {first['magnitude']}, and its sentence says: {effect['conclusion']}"
    yield from _of_check(what, effect, alpha)
    yield from _of_parts(what, effect)
    yield from _against_pairs(what, effect, pairs)


def _of_check(what: str, effect: dict[str, Any], alpha: float) -> Iterator[str]:
    check = effect["check"]
    if check is None or check["p_value"] is None:
        return
    agrees = (check["p_value"] < alpha) == (effect["p_value"] < alpha)
    told = "The test of " in effect["conclusion"]
    # The check is not corrected: where nothing is left of the effect after correction, neither shows anything.
    is_worth_telling = not agrees and (effect["is_significant"] or check["p_value"] < alpha)
    if check["agrees"] is not agrees or told is not is_worth_telling:
        yield f"{what}: the check has p = {check['p_value']}, and the sentence says: {effect['conclusion']}"


def _of_parts(what: str, effect: dict[str, Any]) -> Iterator[str]:
    """A p-value is that of its statistic, or between those of the tests that it combines; the sentence has both."""
    is_drawn = any(how in effect["test"] for how in ("bootstrap", "sign flips"))
    freedom = effect["degrees_of_freedom"]
    for part in effect["parts"]:
        if abs(stats.f.sf(part["statistic"], *part["degrees_of_freedom"]) - part["p_value"]) > _SAME:
            yield f"{what}: {part['name']} has another p-value than its statistic"
        if f"{part['name']} F(" not in effect["conclusion"]:
            yield f"{what}: the sentence lacks {part['name']}: {effect['conclusion']}"
    alone = stats.t if len(freedom) == 1 else stats.f
    tails = alone.sf(abs(effect["statistic"]), *freedom) * (2 if len(freedom) == 1 else 1)
    bounds = [part["p_value"] for part in effect["parts"]] or [tails]
    if effect["test"] == "Lenth's t":
        if abs(_of_lenth(abs(effect["statistic"]), round(3 * freedom[0])) - effect["p_value"]) > 0.01:
            yield f"{what} has p = {effect['p_value']}, which Lenth's t of {effect['statistic']} does not have"
        is_drawn = True
    if not is_drawn and not min(bounds) - _SAME <= effect["p_value"] <= max(bounds) + _SAME:
        yield f"{what} has p = {effect['p_value']}, and its statistic tells {bounds}"
    if len(effect["parts"]) != effect["test"].count(" and ") + 1 and effect["parts"]:
        yield f"{what} is tested by {effect['test']}, and has {len(effect['parts'])} parts"


@cache
def _without_effects(count: int) -> Any:
    """Effects of experiments in which none is there, over their pseudo standard error (Lenth 1989), by simulation."""
    sizes = np.abs(np.random.default_rng(3).normal(size=(20_000, count)))
    first = 1.5 * np.median(sizes, axis=1)
    error = [1.5 * np.median(row[row < 2.5 * scale]) for row, scale in zip(sizes, first, strict=True)]
    return sizes[:, 0] / np.array(error)


def _of_lenth(statistic: float, count: int) -> float:
    return float(np.mean(_without_effects(count) >= statistic * (1 - _SAME)))


def _against_pairs(what: str, effect: dict[str, Any], pairs: list[dict[str, Any]]) -> Iterator[str]:
    known = [pair for pair in pairs if pair["p_value"] is not None]
    if not effect["is_significant"] and any(pair["is_significant"] for pair in known):
        yield f"{what} is not significant, and a pair of its treatments is"
    if len(effect["factors"]) > 1:
        return
    if len(pairs) == 1 and len(known) == 1:
        (pair,) = known
        if abs(pair["p_value"] - effect["p_value"]) > _SAME or pair["is_significant"] != effect["is_significant"]:
            yield f"{what} has p = {effect['p_value']}, and its only pair {pair['p_value']}"
        if pair["effect_sizes"] != effect["effect_sizes"]:
            yield f"{what} and its only pair have different effect sizes"
    nobody = effect["is_significant"] and known and not any(pair["is_significant"] for pair in known)
    if bool(nobody) is not ("no two treatments differ" in effect["conclusion"]):
        yield f"{what}: the sentence and the pairs differ on whether two treatments differ: {effect['conclusion']}"
    yield from _against_largest(what, effect, known)


def _against_largest(what: str, effect: dict[str, Any], pairs: list[dict[str, Any]]) -> Iterator[str]:
    """An effect over all treatments is no larger, by its name, than the largest difference of two of them."""
    shares = [each for each in effect["effect_sizes"] if each["name"].endswith("omega squared")]
    sizes = [each for pair in pairs for each in pair["effect_sizes"] if each["name"] == "Cohen's d"]
    if shares and len(sizes) == len(pairs) > 1:
        largest = max(_MAGNITUDES.index(each["magnitude"]) for each in sizes)
        if _MAGNITUDES.index(shares[0]["magnitude"]) > largest:
            yield f"{what} is {shares[0]['magnitude']}, and the largest difference {_MAGNITUDES[largest]}"
    told = re.search(r" is (higher|lower) than that of ", effect["conclusion"])
    if told and len(pairs) == 1 and (told[1] == "higher") is not (pairs[0]["difference"] > 0):
        yield f"{what}: the sentence has the wrong direction: {effect['conclusion']}"


def _of_pair(pair: dict[str, Any], alpha: float) -> Iterator[str]:
    what = f"{pair['first']} and {pair['second']}"
    p_value, interval = pair["p_value"], pair["interval"]
    if (p_value is None) is not (interval is None):
        yield f"{what} have a p-value without an interval, or the other way round"
        return
    if p_value is None:
        return
    if pair["is_significant"] is not (pair["adjusted_p_value"] < alpha):
        yield f"{what} are judged against their adjusted p-value {pair['adjusted_p_value']}"
    leaves_out = not interval["low"] <= 0 <= interval["high"]
    if leaves_out is not (p_value < alpha) and abs(p_value - alpha) > _SAME:
        yield f"{what} have p = {p_value} and an interval from {interval['low']} to {interval['high']}"
    if not interval["low"] <= pair["difference"] <= interval["high"]:
        yield f"{what} differ by {pair['difference']}, outside their interval"
    for size in pair["effect_sizes"]:
        if size["name"].endswith(" d"):
            yield from _of_size(what, size, p_value, alpha)
            if size["value"] * pair["difference"] < 0:
                yield f"{what} differ in one direction, and {size['name']} in the other"


def _of_size(what: str, size: dict[str, Any], p_value: float, alpha: float) -> Iterator[str]:
    interval = size["interval"]
    if interval is None or not size["name"].endswith((" d", "omega squared")):
        return
    if not interval["low"] - _SAME <= size["value"] <= interval["high"] + _SAME:
        yield f"{what}: {size['name']} = {size['value']} lies outside its interval"
    leaves_out = interval["low"] > 0 or interval["high"] < 0
    if leaves_out is not (p_value < alpha) and abs(p_value - alpha) > _SAME:
        yield f"{what}: p = {p_value}, and {size['name']} lies between {interval['low']} and {interval['high']}"


def _reasons_missing(measure: dict[str, Any]) -> Iterator[tuple[str, str]]:
    told = [each["what"] for each in measure["not_computed"]]
    compared = [*measure["test"]["effects"], *(pair for each in measure["post_hoc"] for pair in each["comparisons"])]
    for each in compared:
        for size in each["effect_sizes"]:
            if size["interval"] is None and not any(what.startswith(f"interval of {size['name']}") for what in told):
                yield size["name"], "interval"


def _of_hypothesis(outcome: dict[str, Any], statistics: dict[str, Any]) -> Iterator[str]:
    hypothesis, supported = outcome["hypothesis"], outcome["is_supported"]
    if supported is None:
        if "could not be tested" not in outcome["conclusion"]:
            yield f"the sentence says: {outcome['conclusion']}"
        return
    if supported is not (outcome["adjusted_p_value"] < statistics["alpha"]):
        yield f"p = {outcome['adjusted_p_value']} does not go with its verdict"
    if supported is not ("support it" in outcome["conclusion"] and "do not support" not in outcome["conclusion"]):
        yield f"the sentence says: {outcome['conclusion']}"
    measure = next((each for each in statistics["measures"] if each["name"] == hypothesis["measure"]), None)
    if (
        measure is None
        or measure["test"] is None
        or hypothesis["contrast"] is not None
        or hypothesis["within"] is not None
    ):
        return
    for effect in measure["test"]["effects"]:
        if set(effect["factors"]) == set(hypothesis["factors"]) and effect["is_significant"] is not supported:
            yield f"its effect is {'' if effect['is_significant'] else 'not '}significant"


def _of_plan(measure: dict[str, Any], alpha: float) -> Iterator[str]:
    """What the plan leaves out and adjusts for goes with the tests."""
    left_out = [each["run_id"] for each in measure["left_out"]]
    if len(left_out) != len(set(left_out)):
        yield "a run is left out twice"
    if (measure["rule_false_positives"] is not None) and not any(
        each["reason"] == "outlier" for each in measure["left_out"]
    ):
        yield "a rule for outliers is told of that left none out"
    adjustment, test = measure["adjustment"], measure["test"]
    is_adjusted = test is not None and test["method"] == "analysis of covariance"
    if (adjustment is not None) is not is_adjusted:
        yield "slopes are told without an analysis of covariance, or the other way round"
    if adjustment is None or test is None:
        return
    for slope in adjustment["slopes"]:
        interval = slope["interval"]
        if interval is not None and (interval["low"] > 0 or interval["high"] < 0) is not (slope["p_value"] < alpha):
            yield f"the slope over {slope['covariate']} has p = {slope['p_value']} and another verdict by its interval"
        affected = slope["treatments_p_value"] is not None and slope["treatments_p_value"] < alpha
        if affected and not any(" differs between " in each or "unevenly" in each for each in adjustment["warnings"]):
            yield f"the covariate {slope['covariate']} differs between treatments, and no sentence says so"
    yield from _adjusted_means(measure, adjustment)


def _adjusted_means(measure: dict[str, Any], adjustment: dict[str, Any]) -> Iterator[str]:
    means = {tuple(each["treatments"].items()): each["adjusted"] for each in adjustment["means"]}
    for post_hoc in measure["post_hoc"]:
        if len(post_hoc["factors"]) > 1:
            continue
        (factor,) = post_hoc["factors"]
        for pair in post_hoc["comparisons"]:
            difference = means[(factor, pair["first"]),] - means[(factor, pair["second"]),]
            if abs(difference - pair["difference"]) > 1e-6 * max(1.0, abs(difference)):
                yield f"adjusted means of {pair['first']} and {pair['second']} differ by {difference}, their pair not"
    for effect in measure["test"]["effects"]:
        if " mean of " in effect["conclusion"] and "adjusted mean" not in effect["conclusion"]:
            yield f"adjusted means are compared, and the sentence says: {effect['conclusion']}"


def _of_standing(standing: dict[str, Any], statistics: dict[str, Any]) -> Iterator[str]:
    """What is said to stand is significant in both analyses, or in neither."""
    words = {None: "is not known", True: "the conclusion stands", False: "the conclusion does not stand"}
    if words[standing["stands"]] not in standing["conclusion"]:
        yield f"stands is {standing['stands']}, and the sentence says: {standing['conclusion']}"
    if standing["statement"]:
        return
    found = []
    for kind in ("measures", _BESIDE[standing["beside"]]):
        measure = next(each for each in statistics[kind] if each["name"] == standing["measure"])
        effects = measure["test"]["effects"] if measure["test"] is not None else []
        found += [each for each in effects if set(each["factors"]) == set(standing["factors"])]
    if standing["stands"] is None:
        return
    now, then = found
    if now["p_value"] != standing["p_value"] or then["p_value"] != standing["p_value_without"]:
        yield f"{standing['factors']}: its p-values are not those of the tests"
    turned = "other direction" in standing["conclusion"]
    if standing["stands"] is not (now["is_significant"] == then["is_significant"] and not turned):
        yield f"{standing['factors']}: {standing['conclusion']}"
