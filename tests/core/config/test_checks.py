from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from robot_runner.core.config.checks import check_columns
from robot_runner.core.config.preparation import prepare
from robot_runner.core.events.measure import Measure, resolve_columns

MEASURES = {"PsUtil": [Measure("CPU", "%"), Measure("CPU_Work", "%")]}


def problems(*data_columns: str | Measure) -> list[str]:
    return [finding.problem for finding in check_columns(resolve_columns(data_columns, MEASURES)[0])]


@pytest.mark.parametrize("name", ["CPU_Wrk", "cpu_work", "CPU_Work_"])
def test_a_column_that_is_nearly_called_like_a_measure_of_a_plugin_is_warned_of_before_anything_is_executed(
    name: str,
) -> None:
    (problem,) = problems(name, "CPU")
    assert problem == f"no plugin yields {name!r}, and PsUtil's 'CPU_Work' has no column"


def test_a_column_of_the_configs_own_is_not_warned_of() -> None:
    assert not problems("CPU_Wrk", "CPU_Work"), "both are there"
    assert not problems(Measure("CPU_Wrk", "%")), "it says what it is"
    assert not problems("Happiness", "CPUTimePerRun")


def test_a_column_that_several_plugins_could_mean_is_not_said_to_be_yielded_by_none() -> None:
    energy = Measure("Energy", "J")
    meters = {"Ina219": [energy, Measure("EnergyPt", "J")], "Battery": [energy]}
    columns, findings = resolve_columns(["Energy"], meters)
    assert [each.problem for each in findings] == ["'Energy' could be any of 'Ina219.Energy', 'Battery.Energy'"]
    assert not check_columns(columns)


@pytest.mark.parametrize(("treatments", "warned"), [(["", "--fast"], ["factor 'Flags'"]), (["none", "--fast"], [])])
def test_an_empty_treatment_is_warned_of_as_tools_read_it_as_a_missing_value(
    write_config: Callable[..., Path], treatments: list[str], warned: list[str]
) -> None:
    table = f"    def create_run_table(self):\n        return RunTableModel([Factor('Flags', {treatments})])\n"
    found = [each for each in prepare(write_config(table=table)).findings if each.where.startswith("factor")]
    assert [each.where for each in found] == warned
    assert all("which R and pandas read as a missing value" in each.problem for each in found)
