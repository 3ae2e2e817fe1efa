"""Exclusions keep what their author meant; where the earlier tools did something else, it is said."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from tests.legacy.earlier_configs import ROBOT, planned

from robot_runner.core.config.preparation import prepare

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


def runs_and_warnings(path: Path) -> tuple[set[tuple[object, ...]], list[str]]:
    preparation = prepare(path)
    warnings = [str(finding) for finding in preparation.findings]
    return {tuple(run.values()) for _, run in planned(preparation)}, warnings


@pytest.fixture
def excluding(config: Callable[..., Path]) -> Callable[..., tuple[set[tuple[object, ...]], list[str]]]:
    def excluded(factors: str, exclusions: str) -> tuple[set[tuple[object, ...]], list[str]]:
        table = f"""\
    def create_run_table(self):
        run_table = RunTableModel(factors=[{factors}], exclude_variations={exclusions})
        run_table.create_experiment_run_table()
        return run_table.get_experiment_run_table()
"""
        return runs_and_warnings(config(head=ROBOT, table=table))

    return excluded


def test_a_value_of_another_type_that_is_equal_is_not_hit(excluding: Callable[..., tuple[set, list[str]]]) -> None:
    runs, warnings = excluding("FactorModel('camera', [True, False]), FactorModel('speed', [1, 2])", "[{True}]")
    assert runs == {(False, 1), (False, 2)}
    assert any("also left out runs with the equal value of factor 'speed'" in warning for warning in warnings)


def test_equal_values_of_two_factors_are_meant_in_the_order_of_the_factors(
    excluding: Callable[..., tuple[set, list[str]]],
) -> None:
    runs, warnings = excluding("FactorModel('a', [10, 20]), FactorModel('b', [10, 20])", "[{20, 10}]")
    assert runs == {(10, 10), (10, 20), (20, 20)}
    assert any("is taken for a=20, b=10" in warning for warning in warnings)


def test_a_value_that_could_be_of_either_factor_leaves_out_both_and_says_so(
    excluding: Callable[..., tuple[set, list[str]]],
) -> None:
    runs, warnings = excluding("FactorModel('light', ['on', 'off']), FactorModel('camera', ['on', 'off'])", "[{'on'}]")
    assert runs == {("off", "off")}
    assert any("whether 'on' of 'light' and 'camera' is meant" in warning for warning in warnings)


def test_two_treatments_of_one_factor_match_nothing(excluding: Callable[..., tuple[set, list[str]]]) -> None:
    runs, warnings = excluding("FactorModel('task', ['scan', 'map', 'rest'])", "[{'scan'}, {'scan', 'map'}]")
    assert runs == {("map",), ("rest",)}
    assert any("exclusion 2 matches no combination" in warning for warning in warnings)


def test_exclusions_that_overlap_leave_out_no_neighbour(config: Callable[..., Path]) -> None:
    table = """\
    def create_run_table_model(self):
        a = FactorModel("a", [1, 2, 3])
        b = FactorModel("b", [1, 2])
        return RunTableModel([a, b], exclude_combinations=[{a: [1]}, {a: [1], b: [2]}])
"""
    runs, warnings = runs_and_warnings(config(table=table))
    assert runs == {(2, 1), (2, 2), (3, 1), (3, 2)}
    assert any("the earlier tool then also left out (2, 1)" in warning for warning in warnings)


def test_a_treatment_that_is_none_excludes_nothing_and_is_named(config: Callable[..., Path]) -> None:
    table = """\
    def create_run_table_model(self):
        size = FactorModel("size", ["small", "large"])
        return RunTableModel([size, FactorModel("n", [1])], exclude_combinations=[{size: ["smal"]}])
"""
    runs, warnings = runs_and_warnings(config(table=table))
    assert len(runs) == 2
    assert any("'smal' is not a treatment of factor 'size'" in warning and "'small'" in warning for warning in warnings)


@pytest.mark.parametrize("key", ["size", "'size'"])
@pytest.mark.parametrize("wanted", ["['small']", "'small'", "{'small'}", "('small',)"])
def test_factors_and_treatments_may_be_named_in_any_way(config: Callable[..., Path], key: str, wanted: str) -> None:
    table = f"""\
    def create_run_table_model(self):
        size = FactorModel("size", ["small", "large"])
        return RunTableModel([size], exclude_combinations=[{{{key}: {wanted}}}])
"""
    assert runs_and_warnings(config(table=table)) == ({("large",)}, [])


def test_a_number_that_equals_a_bool_of_its_own_factor_is_it(config: Callable[..., Path]) -> None:
    table = """\
    def create_run_table_model(self):
        flag = FactorModel("flag", [True, False])
        return RunTableModel([flag], exclude_combinations=[{flag: [0]}])
"""
    assert runs_and_warnings(config(table=table)) == ({(True,)}, [])
