"""Whether sentences, intervals, p-values and weights of a comparison agree with each other, by its JSON alone."""

from __future__ import annotations

import math
import re
from itertools import pairwise
from typing import TYPE_CHECKING, Any

from robot_runner.analysis.wording import shown_number

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = ["disagreements_of_combined", "disagreements_of_two"]

_SAME = 1e-9
_CLOSE = 1e-6
_FEW = {2: "Two experiments", 3: "Three experiments", 4: "Four experiments"}


def disagreements_of_combined(found: dict[str, Any]) -> list[str]:
    """Return what contradicts itself in a meta-analysis, as `compare --json` prints it; nothing where all agree.

    Example:
        >>> disagreements_of_combined({"alpha": 0.05, "experiments": [], "measures": []})
        []
    """
    names = [each["name"] for each in found["experiments"]]
    told: list[str] = []
    for measure in found["measures"]:
        if not measure["effects"] and not measure["not_computed"]:
            told.append(f"{measure['name']}: nothing was combined, and nothing says why")
        for effect in measure["effects"]:
            what = f"{measure['name']}, {' less '.join(effect['weights'])}"
            told += [f"{what}: {each}" for each in _of_effect(effect, names, found["alpha"])]
        told += [f"{measure['name']}: {each}" for each in _of_family(measure["effects"])]
    return told


def _of_family(effects: list[dict[str, Any]]) -> Iterator[str]:
    """Holm: the smallest p-value is multiplied by the number of effects, and the order stays."""
    pairs = sorted(
        (each["difference"]["random"]["p_value"], each["adjusted_p_value"])
        for each in effects
        if each["adjusted_p_value"] is not None
    )
    if pairs and abs(pairs[0][1] - min(1.0, len(pairs) * pairs[0][0])) > _SAME:
        yield f"the smallest p-value {pairs[0][0]} becomes {pairs[0][1]} of {len(pairs)}"
    if any(later[1] < earlier[1] - _SAME for earlier, later in pairwise(pairs)):
        yield "adjusted p-values are not in the order of those before adjustment"


def _of_effect(effect: dict[str, Any], names: list[str], alpha: float) -> Iterator[str]:
    told, found = effect["experiments"], effect["difference"]
    if len(told) < 2 or [name for name in names if name in {each["experiment"] for each in told}] != [
        each["experiment"] for each in told
    ]:
        yield f"it is told of by {[each['experiment'] for each in told]}"
    if abs(sum(effect["weights"].values())) > _SAME:
        yield f"its weights are {effect['weights']}"
    for each in told:
        yield from _of_estimate(each["experiment"], each, alpha)
        if each["g"] is not None and each["g"] * each["estimate"] < 0:
            yield f"{each['experiment']} differs in one direction, and its Hedges' g in the other"
    for name in ("common", "random"):
        yield from _of_estimate(name, found[name], alpha)
        yield from _of_weights(name, found, told)
    yield from _of_heterogeneity(found, alpha)
    yield from _of_sentence(effect, found, alpha)


def _of_estimate(what: str, each: dict[str, Any], alpha: float) -> Iterator[str]:
    interval, p_value = each["interval"], each["p_value"]
    if (interval is None) is not (p_value is None):
        yield f"{what} has an interval without a p-value, or the other way round"
    elif interval is not None:
        if not interval["low"] <= each["estimate"] <= interval["high"]:
            yield f"{what} is {each['estimate']}, outside of its interval"
        leaves_out = not interval["low"] <= 0 <= interval["high"]
        if leaves_out is not (p_value < alpha) and abs(p_value - alpha) > _SAME:
            yield f"{what} has p = {p_value} and an interval from {interval['low']} to {interval['high']}"
        if abs(interval["level"] - (1 - alpha)) > _SAME:
            yield f"{what} has an interval of {interval['level']}"


def _of_weights(name: str, found: dict[str, Any], told: list[dict[str, Any]]) -> Iterator[str]:
    weights = found[f"{name}_weights"]
    if len(weights) != len(told) or abs(sum(weights) - 1) > _SAME or min(weights) < 0:
        yield f"the weights of {name} are {weights}"
        return
    average = sum(weight * each["estimate"] for weight, each in zip(weights, told, strict=True))
    if not math.isclose(average, found[name]["estimate"], rel_tol=_CLOSE, abs_tol=_CLOSE):
        yield f"{name} is {found[name]['estimate']}, and the weighted mean {average}"


def _of_heterogeneity(found: dict[str, Any], alpha: float) -> Iterator[str]:
    told, count = found["heterogeneity"], len(found["random_weights"])
    if told["freedom"] != count - 1:
        yield f"Q has {told['freedom']} degrees of freedom of {count} experiments"
    if (told["tau_squared"] == 0) is not (told["i_squared"] == 0) or (told["tau_squared"] > 0) is not (
        told["q"] > told["freedom"]
    ):
        yield f"tau squared is {told['tau_squared']}, I squared {told['i_squared']}, Q {told['q']}"
    for name in ("tau_squared", "i_squared"):
        interval = told[f"{name}_interval"]
        if not 0 <= interval["low"] <= interval["high"]:
            yield f"the interval of {name} is from {interval['low']} to {interval['high']}"
    if told["tau_squared"] == 0 and found["common"]["estimate"] != found["random"]["estimate"]:
        yield "both averages differ although experiments do not vary"
    if (found["prediction"] is None) is not (count < 3):
        yield f"{count} experiments {'do not ' if found['prediction'] is None else ''}predict a further one"
    if found["prediction"] is not None and not (
        found["prediction"]["low"] <= found["random"]["estimate"] <= found["prediction"]["high"]
    ):
        yield "the average lies outside of what is predicted"


def _of_sentence(effect: dict[str, Any], found: dict[str, Any], alpha: float) -> Iterator[str]:
    text, random, significant = effect["conclusion"], found["random"], effect["is_significant"]
    if effect["adjusted_p_value"] is None:
        if "there is no variation to test against" not in text or significant is not None:
            yield f"there is no p-value, and the sentence says: {text}"
        return
    if (
        significant is not (effect["adjusted_p_value"] < alpha)
        or effect["adjusted_p_value"] < random["p_value"] - _SAME
    ):
        yield f"it is {'' if significant else 'not '}significant with p = {effect['adjusted_p_value']}"
    claims = bool(re.search(r" is (higher|lower) than | differs from zero on average", text))
    denies = "do not show that" in text or "is not shown to differ from zero" in text
    if claims is not significant or denies is significant:
        yield f"it is {'' if significant else 'not '}significant, and the sentence says: {text}"
    direction = re.search(r" is (higher|lower) than ", text)
    if direction and (direction[1] == "higher") is not (random["estimate"] > 0):
        yield f"it is {random['estimate']}, and the sentence says: {text}"
    yield from _of_further_sentences(effect, found, alpha)


def _of_further_sentences(effect: dict[str, Any], found: dict[str, Any], alpha: float) -> Iterator[str]:
    text, significant = effect["conclusion"], effect["is_significant"]
    differ = found["heterogeneity"]["p_value"] < alpha
    if ("The experiments differ by more than chance explains" in text) is not differ or (
        "is not shown (Q" in text
    ) is differ:
        yield f"the experiments {'' if differ else 'do not '}differ, and the sentence says: {text}"
    if f"I² = {shown_number(found['heterogeneity']['i_squared'], 3)} %" not in text:
        yield f"I squared is {found['heterogeneity']['i_squared']}, and the sentence says: {text}"
    holds_zero = found["prediction"] is not None and found["prediction"]["low"] <= 0 <= found["prediction"]["high"]
    if ("may find the opposite" in text) is not (significant and holds_zero):
        yield f"a further experiment is expected at {found['prediction']}, and the sentence says: {text}"
    common = found["common"]["p_value"] < alpha
    if ("If all experiments estimated one and the same effect" in text) is not (common is not significant):
        yield f"the common effect is {'' if common else 'not '}significant, and the sentence says: {text}"
    for count, words in _FEW.items():
        if (words in text) is not (len(effect["experiments"]) == count):
            yield f"there are {len(effect['experiments'])} experiments, and the sentence says: {text}"


def disagreements_of_two(found: dict[str, Any]) -> list[str]:
    """Return what contradicts itself in a comparison of two experiments, as `compare --json` prints it."""
    alpha = found["alpha"]
    told: list[str] = []
    for measure in found["measures"]:
        for each in measure["differences"]:
            what = f"{measure['first_name']}, {' / '.join(each['treatments'].values())}"
            told += [f"{what}: {problem}" for problem in (*_of_difference(each, alpha), *_of_region(each))]
        told += [f"{measure['first_name']}: {problem}" for problem in _of_verdict(measure)]
    return told


def _of_difference(each: dict[str, Any], alpha: float) -> Iterator[str]:
    if each["p_value"] is None:
        if each["verdict"] != "undecided" or not each["not_computed"]:
            yield f"it is {each['verdict']} without a test, or no reason is given"
        return
    yield from _of_estimate("the difference", {**each, "estimate": each["difference"]}, alpha)
    is_equivalent = each["equivalence_p_value"] is not None and each["equivalence_p_value"] < alpha
    expected = "equivalent" if is_equivalent else "different" if each["adjusted_p_value"] < alpha else "undecided"
    if each["verdict"] != expected:
        yield f"it is {each['verdict']}, and its p-values say {expected}"


def _of_region(each: dict[str, Any]) -> Iterator[str]:
    told = each["practical"]
    if told is None:
        return
    if abs(told["below"] + told["within"] + told["above"] - 1) > _CLOSE:
        yield f"the probabilities are {told['below']}, {told['within']} and {told['above']}"
    if not told["interval"]["low"] <= each["difference"] <= told["interval"]["high"]:
        yield f"the difference {each['difference']} lies outside of its credible interval"
    if (told["above"] > told["below"]) is not (each["difference"] > 0) and abs(told["above"] - told["below"]) > _CLOSE:
        yield f"it is {each['difference']}, and it is {told['above']} above and {told['below']} below"


def _of_verdict(measure: dict[str, Any]) -> Iterator[str]:
    verdicts, text = [each["verdict"] for each in measure["differences"]], measure["conclusion"]
    expected = (
        "different"
        if "different" in verdicts
        else "equivalent"
        if verdicts and set(verdicts) == {"equivalent"}
        else "undecided"
    )
    if measure["verdict"] != expected or (verdicts and not text.startswith(expected.capitalize())):
        yield f"it is {measure['verdict']} of {verdicts}, and the sentence says: {text}"
    probabilities = [each["practical"]["within"] for each in measure["differences"] if each["practical"] is not None]
    if probabilities:
        least = min(probabilities)
        shown = "< 0.001" if least < 0.001 else "> 0.999" if least > 0.999 else f"{least:.3f}"
        if f" is {shown}" not in text.partition("the probability that")[2]:
            yield f"the least probability is {least}, and the sentence says: {text}"
