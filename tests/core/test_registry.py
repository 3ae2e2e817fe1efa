from __future__ import annotations

import pytest

from robot_runner.core.entry_points import EntryPoint
from robot_runner.core.errors import PluginError
from robot_runner.core.plugin import GROUPS, find_plugin, installed_plugins, load_plugin


def announced(value: str, kind: str = "profilers") -> EntryPoint:
    return EntryPoint("Odd", f"robot_runner.{kind}", value, lambda: ("some-package", "1.0"))


def test_the_built_in_plugins_come_in_through_entry_points_like_anybodys() -> None:
    assert {"BasicTurtlebot3"} <= {plugin.name for plugin in installed_plugins("systems")}
    assert {"Ina219", "PsUtil"} <= {plugin.name for plugin in installed_plugins("profilers")}
    assert {plugin.package for plugin in installed_plugins()} == {"robot-runner"}


@pytest.mark.parametrize("plugin", installed_plugins(), ids=lambda plugin: plugin.name)
def test_every_built_in_plugin_is_of_its_kind_and_says_what_it_measures_and_needs(plugin: EntryPoint) -> None:
    found = load_plugin(plugin)
    assert issubclass(found, GROUPS[plugin.kind])
    assert found.__doc__
    assert found.needs


def test_a_plugin_that_is_not_installed_is_refused_with_the_nearest_name() -> None:
    with pytest.raises(PluginError) as refused:
        find_plugin("profilers", "PsUtill")
    assert refused.value.fix == "Did you mean 'PsUtil'?"


def test_a_plugin_that_cannot_be_imported_names_its_package() -> None:
    with pytest.raises(PluginError) as refused:
        load_plugin(announced("no_such_module:Odd"))
    assert "ModuleNotFoundError" in refused.value.problem
    assert "some-package" in refused.value.fix


def test_what_is_no_plugin_of_its_kind_is_refused() -> None:
    with pytest.raises(PluginError, match="is not a Profiler"):
        load_plugin(announced("collections:OrderedDict"))
    with pytest.raises(PluginError, match="is not a Profiler"):
        load_plugin(announced("robot_runner.ros.turtlebot3.basic_turtlebot3:BasicTurtlebot3"))
