from __future__ import annotations

import pytest

from robot_runner.core.config.checks import check_columns
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
