from __future__ import annotations

import pytest

from robot_runner.core.errors import MeasureError
from robot_runner.core.events.measure import CONFIG_OWNER, Measure, resolve_columns

ENERGY = Measure("Energy", "J")
CPU = Measure("CPU", "%")
MEMORY = Measure("Memory", "%")


def test_without_data_columns_the_table_has_all_measures_of_all_plugins() -> None:
    columns, findings = resolve_columns(None, {"Ina219": [ENERGY], "PsUtil": [CPU, MEMORY]})
    assert columns.names == ("Energy", "CPU", "Memory")
    assert findings == []


def test_data_columns_choose_and_order_the_measures() -> None:
    columns, _ = resolve_columns(["CPU", "Energy"], {"Ina219": [ENERGY], "PsUtil": [CPU, MEMORY]})
    assert columns.names == ("CPU", "Energy")
    assert [column.owner for column in columns.in_table] == ["PsUtil", "Ina219"]


def test_a_measure_without_a_column_may_be_published_all_the_same() -> None:
    columns, _ = resolve_columns(["CPU"], {"PsUtil": [CPU, MEMORY]})
    assert columns.column_for("PsUtil", "Memory").is_in_table is False


def test_a_name_that_no_plugin_declares_is_the_configs_own() -> None:
    columns, _ = resolve_columns(["Happiness"], {"PsUtil": [CPU]})
    assert columns.in_table[0].owner == CONFIG_OWNER
    assert columns.column_for(CONFIG_OWNER, "Happiness").name == "Happiness"


def test_clashing_measures_are_named_after_their_plugins() -> None:
    columns, _ = resolve_columns(None, {"left": [ENERGY], "right": [ENERGY]})
    assert columns.names == ("left.Energy", "right.Energy")
    assert columns.column_for("right", "Energy").name == "right.Energy"


def test_an_ambiguous_name_is_a_finding_that_names_the_choices() -> None:
    _, findings = resolve_columns(["Energy"], {"left": [ENERGY], "right": [ENERGY]})
    assert [finding.is_error for finding in findings] == [True]
    assert "'left.Energy'" in findings[0].problem
    assert "'right.Energy'" in findings[0].problem


def test_a_measure_that_is_named_with_its_plugin_where_no_other_has_it_is_told_by_its_name() -> None:
    _, findings = resolve_columns(["PsUtil.CPU", "Laptop.CPU"], {"PsUtil": [CPU], "Ina219": [ENERGY]})
    assert [(finding.is_error, finding.fix) for finding in findings] == [(True, "Write 'CPU'.")]


def test_the_config_may_fill_a_plugins_column() -> None:
    columns, _ = resolve_columns(None, {"Ina219": [ENERGY]})
    assert columns.column_for(CONFIG_OWNER, "Energy").name == "Energy"


def test_nobody_publishes_how_good_a_value_is() -> None:
    columns, _ = resolve_columns(None, {"Ina219": [Measure("Energy", "J")]})
    for owner in ("Ina219", "config"):
        with pytest.raises(MeasureError, match="Did you mean 'Energy'"):
            columns.with_quality().column_for(owner, "Energy.quality")


@pytest.mark.parametrize(("owner", "remedy"), [("PsUtil", "measures of PsUtil"), (CONFIG_OWNER, "data_columns")])
def test_an_undeclared_measure_is_refused_with_the_nearest_name_and_a_remedy(owner: str, remedy: str) -> None:
    columns, _ = resolve_columns(None, {"PsUtil": [CPU, MEMORY]})
    with pytest.raises(MeasureError) as refused:
        columns.column_for(owner, "Memmory")
    assert "'Memory'" in refused.value.fix
    assert remedy in refused.value.fix
