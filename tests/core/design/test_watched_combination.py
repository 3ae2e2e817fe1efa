from __future__ import annotations

import copy
import pickle
from typing import TYPE_CHECKING, Any

import pytest

from robot_runner.core.design.factor import Combination
from robot_runner.core.design.watched_combination import WatchedCombination

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping


@pytest.mark.parametrize(
    ("read", "expected"),
    [
        (lambda it: it["Speed"], ["Speed"]),
        (lambda it: (it["Speed"], it["Speed"]), ["Speed"]),
        (lambda it: it.get("Speed"), ["Speed"]),
        (lambda it: "Speed" in it, ["Speed"]),
        (lambda it: it.get("Colour"), []),
        (lambda it: "Colour" in it, []),
        (len, []),
        (dict, ["Task", "Speed"]),
        (lambda it: list(it.values()), ["Task", "Speed"]),
        (list, ["Task", "Speed"]),
        (str, ["Task", "Speed"]),
        (repr, ["Task", "Speed"]),
        (lambda it: it == {"Task": "Video", "Speed": 0.2}, ["Task", "Speed"]),
    ],
)
def test_a_combination_tells_once_what_was_read(read: Callable[[Any], object], expected: list[str]) -> None:
    told: list[str] = []
    watched = WatchedCombination({"Task": "Video", "Speed": 0.2}, told.append)
    read(watched)
    assert told == expected
    assert watched.unread == {"Task", "Speed"} - set(expected)


@pytest.mark.parametrize("copy", [copy.copy, copy.deepcopy, lambda it: pickle.loads(pickle.dumps(it))])  # noqa: S301 - ours
def test_a_copy_can_be_handed_to_another_process_and_counts_as_read(copy: Callable[[Any], object]) -> None:
    told: list[str] = []
    assert copy(WatchedCombination({"Task": "Video"}, told.append)) == {"Task": "Video"}
    assert told == ["Task"]


def test_a_watched_combination_is_equal_to_what_it_watches() -> None:
    watched = WatchedCombination({"Task": "Video"}, lambda _: None)
    assert watched == {"Task": "Video"}
    assert str(watched) == "{'Task': 'Video'}"
    with pytest.raises(KeyError):
        watched["Speed"]


@pytest.mark.parametrize(
    "combination", [Combination({"Task": 0, "Speed": 1}, ("Video", 0.2)), {"Task": "Video", "Speed": 0.2}]
)
def test_a_factor_that_a_run_does_not_have_is_told_with_the_nearest_one(combination: Mapping[str, Any]) -> None:
    watched = WatchedCombination(combination, lambda _: None)
    with pytest.raises(KeyError, match="the run has no factor 'Sped': did you mean 'Speed'") as raised:
        watched["Sped"]
    assert raised.value.args == ("Sped",)
    assert str(pickle.loads(pickle.dumps(raised.value))) == str(raised.value)  # noqa: S301 - ours
    assert (watched.get("Sped"), "Sped" in watched) == (None, False)
