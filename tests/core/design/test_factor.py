"""A factor takes treatments of any type that can be told apart in the run table, and refuses the others."""

from __future__ import annotations

import itertools
import pickle
import re
from decimal import Decimal
from functools import partial
from pathlib import Path

import pytest

from robot_runner.core.design.factor import Combination, Factor
from robot_runner.core.design.revision import Revision
from robot_runner.core.errors import DesignError
from robot_runner.plugins.profilers import CodeCarbon, PsUtil


def test_revisions_are_the_same_by_repository_name_and_build_alone() -> None:
    one = Revision("/robot", "main", build="make")
    same, others = Revision("/robot", "main", build="make"), [Revision("/robot", "dev", build="make"), "main", None]
    same.prepare(commit="0" * 40, path="/tree")
    assert one == same
    assert hash(one) == hash(same)
    assert [one == other for other in others] == [False] * 3


class Speed:
    """An object with a text of its own, and no equality."""

    def __init__(self, metres: float) -> None:
        self.metres = metres

    def __str__(self) -> str:
        return f"{self.metres} m/s"


class Nameless:
    """An object that shows where it lies in memory."""


class Vector:
    """An array of another library: it compares element by element and has no truth value."""

    __hash__ = None  # type: ignore[assignment]

    def __init__(self, *elements: float) -> None:
        self.elements = elements

    def __eq__(self, other: object) -> Vector:  # type: ignore[override]
        return self

    def __bool__(self) -> bool:
        raise ValueError("the truth value of an array is ambiguous")

    def __str__(self) -> str:
        return str(self.elements)


class Unsettled(Vector):
    """A setting of another library, which says in its own way that it cannot be hashed."""

    def __hash__(self) -> int:
        raise ValueError("some of it is not settled")


class Broken:
    def __str__(self) -> str:
        raise RuntimeError("no text")


def findings_of(name: object, treatments: object) -> list[str]:
    with pytest.raises(DesignError) as caught:
        Factor(name, treatments)  # type: ignore[arg-type]
    return [str(finding) for finding in caught.value.findings]


def shown(value: object) -> str:
    """Return a name for a case that is the same in each process: addresses are not."""
    return re.sub(r"0x[0-9a-f]+", "", repr(value))


@pytest.mark.parametrize(
    "treatments",
    [
        range(1, 6),
        ["Video", "a,b", 'say "hi"', "two\nlines", "", "   ", "日本語", "🤖", "=1+1"],
        [1, 2.5, True, None, -3, 0.0, float("inf")],
        (index**2 for index in range(3)),
        [Speed(0.1), Speed(0.2)],
        [(1, 2), (3, 4)],
        [[1], [2]],
        [Path("maps/a.yaml")],
        [1, 1.0, True],
    ],
    ids=shown,
)
def test_treatments_of_any_type_are_kept_in_order(treatments: object) -> None:
    expected = list(treatments) if isinstance(treatments, (list, range)) else None
    factor = Factor("Task", treatments)  # type: ignore[arg-type]
    assert isinstance(factor.treatments, tuple)
    if expected is not None:
        assert list(factor.treatments) == expected
    assert factor.texts == tuple(map(str, factor.treatments))


def test_a_factor_cannot_be_changed_and_can_be_a_key_whatever_its_treatments() -> None:
    factor = Factor("Task", [[1], {"a": 2}])
    with pytest.raises(AttributeError):
        factor.name = "Other"  # type: ignore[misc]
    assert {factor: 1}[factor] == 1
    assert pickle.loads(pickle.dumps(factor)) == factor  # noqa: S301 - our own bytes


@pytest.mark.parametrize(
    ("name", "finding"),
    [
        ("", "factor '': the name is empty → Give it a name."),
        ("  ", "factor '  ': the name is empty → Give it a name."),
        (" Task", "factor ' Task': the name begins or ends with a blank → Write 'Task'."),
        ("Ta\nsk", "factor 'Ta\\nsk': the name holds '\\n', which no heading can hold → Leave it out."),
        ("Ta\x00sk", "factor 'Ta\\x00sk': the name holds '\\x00', which no heading can hold → Leave it out."),
        ("T\ud800", "factor 'T\\ud800': the name holds '\\ud800', which no heading can hold → Leave it out."),
        (3, "factor 3: the name is of type int → Give a string."),
        ("run_id", "factor 'run_id': the run table has a column of that name already → Choose another name."),
        ("Status", "factor 'Status': the run table has a column of that name already → Choose another name."),
        (
            "start_run_at",
            "factor 'start_run_at': the run table has a column of that name already → Choose another name.",
        ),
    ],
)
def test_a_name_that_cannot_head_a_column_is_refused(name: object, finding: str) -> None:
    assert findings_of(name, ["a"]) == [finding]


def test_a_name_may_hold_blanks_and_letters_of_any_language() -> None:
    assert Factor("vitesse élevée (m/s)", [1]).name == "vitesse élevée (m/s)"


@pytest.mark.parametrize(
    ("treatments", "finding"),
    [
        ([], "the factor has no treatments → Give at least one."),
        ("abc", "the treatments are 'abc', which is of type str → Give a list."),
        (5, "the treatments are 5, which is of type int → Give a list."),
        ({"a": 1}, "the treatments are {'a': 1}, which is of type dict → Give a list."),
        ({"a"}, "the treatments are a set, which has another order in each process → Give a list."),
        (
            itertools.count(),
            "the factor has more than 1,000,000 treatments → Give fewer; an endless iterable cannot be planned.",
        ),
        (["a", "a"], "treatment 'a' is given twice → Remove one; repetitions=2 executes each combination twice."),
        (
            [Decimal("1.0"), Decimal("1.00")],
            "treatment Decimal('1.00') is given twice → Remove one; repetitions=2 executes each combination twice.",
        ),
        (
            [1, "1"],
            (
                "treatments 1 and '1' would both be written '1' in the run table → "
                "Change one of them so that they look different."
            ),
        ),
        (
            [True, "True"],
            (
                "treatments True and 'True' would both be written 'True' in the run table → "
                "Change one of them so that they look different."
            ),
        ),
        (["a\ud800"], "treatment 'a\\ud800' holds '\\ud800', which UTF-8 cannot hold → Leave it out."),
        (
            [Broken()],
            (
                "a treatment of type Broken has no text: its str() raised RuntimeError: no text → "
                "Correct the __str__ of its class."
            ),
        ),
    ],
    ids=shown,
)
def test_treatments_that_could_not_be_told_apart_are_refused(treatments: object, finding: str) -> None:
    assert findings_of("Task", treatments) == [f"factor 'Task': {finding}"]


def test_an_object_that_shows_its_address_is_refused_and_told_how_to_show_itself() -> None:
    (finding,) = findings_of("Robot", [Nameless()])
    assert "shows a memory address, so it could not be recognised when resuming" in finding
    assert finding.endswith("→ Give its class a __str__ (Nameless).")
    assert Factor("Task", ["at 0x1f, and not an object at 0x1f"]).texts  # a text may say what it likes


@pytest.mark.parametrize("treatments", [[PsUtil(name="a"), 1], [[PsUtil()], [PsUtil(), CodeCarbon(country="NLD")]]])
def test_a_plugin_as_treatment_is_refused_as_its_text_does_not_show_its_parameters(treatments: list[object]) -> None:
    """A run with `PsUtil(rate_hz=1)` was taken for one with another rate when it was resumed."""
    for finding in findings_of("M", treatments):
        assert "(...)" in finding
        assert "does not show its parameters, so it could not be recognised when resuming" in finding
        assert finding.endswith("→ Bind a parameter of the plugin by treatment('M'), or give its class a __str__.")
    assert findings_of("M", treatments)
    assert Factor("Task", ["PsUtil(...)"]).texts  # a text may say what it likes


def test_of_a_function_as_treatment_it_is_said_what_to_give_in_its_place() -> None:
    found = findings_of("Planner", [lambda: 1, partial(lambda: 1)])
    assert len(found) == 2
    assert all(each.endswith("→ Give a text in its place, by which a callback finds the function.") for each in found)


def test_a_set_as_treatment_is_refused_as_it_is_written_in_any_order() -> None:
    (finding,) = findings_of("Rooms", [frozenset({"hall", "kitchen"})])
    assert finding.endswith(
        "is a set: its elements are written in another order by each process → Give a tuple or a sorted list."
    )


def test_all_that_is_wrong_is_listed_at_once() -> None:
    assert len(findings_of(" Task", ["a", "a", Nameless()])) == 3


@pytest.mark.parametrize(
    ("treatments", "value", "place"),
    [
        (["a", "b"], "b", 1),
        ([0, 1], True, None),
        ([True, False], 0, None),
        ([1, 2], 2.0, 1),
        ([1, 1.0], 1.0, 1),
        ([1, 1.0], Decimal(1), None),
        ([float("nan")], float("nan"), 0),
        ([(1, 2), (3, 4)], (3, 4), 1),
        (["1"], 1, None),
    ],
)
def test_a_value_means_a_treatment_by_type_first_and_then_by_equality(
    treatments: list[object], value: object, place: int | None
) -> None:
    assert Factor("X", treatments).position_of(value) == place


def test_an_object_is_recognised_by_its_text() -> None:
    assert Factor("Speed", [Speed(0.1), Speed(0.2)]).position_of(Speed(0.2)) == 1


def test_an_array_is_recognised_by_its_text() -> None:
    factor = Factor("Goal", [Vector(0, 1), Vector(2, 3)])
    assert factor.position_of(Vector(2, 3)) == 1
    assert factor.position_of(Vector(4, 5)) is None


def test_a_treatment_that_can_be_changed_is_each_run_s_own_whatever_it_raises_for_a_hash() -> None:
    planned = Combination({"Goal": 0, "Way": 1}, (Unsettled(1, 2), ["dock"]))
    own = planned.of_one_run()
    assert [str(each) for each in own.treatments] == ["(1, 2)", "['dock']"]
    assert not any(one is other for one, other in zip(own.treatments, planned.treatments, strict=True))


def test_the_nearest_treatment_is_suggested_or_all_are_listed() -> None:
    assert Factor("Task", ["Video", "Network"]).suggestion("vidoe") == "Did you mean 'Video'?"
    assert Factor("Task", ["Video", "Network"]).suggestion("x") == "Choose one of: 'Video', 'Network'."
    assert Factor("N", range(12)).suggestion("x") == "Choose one of: 0, 1, 2, 3, 4, 5, 6, 7, 8, 9 and 2 more."
