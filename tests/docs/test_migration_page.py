"""The page for who comes from the earlier tools maps everything that they had, and its configs are executed."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from robot_runner.cli.main import main
from robot_runner.legacy.profilers.profiler_catalogue import PLUGINS
from robot_runner.legacy.stand_ins.events import RobotRunnerEvents, RunnerEvents
from robot_runner.legacy.stand_ins.modules import MODULES

PAGE = (Path(__file__).parents[2] / "docs" / "migration.md").read_text(encoding="utf-8")
OLD, NEW = re.findall(r"^```py\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
NAMED = set(re.findall(r"`(\w+)[`(. ]", PAGE))


def test_every_module_that_can_be_imported_is_told_of() -> None:
    assert {module.rpartition(".")[2] for module in MODULES} - NAMED <= {"Typing", "PS"}


def test_every_profiler_has_its_row_with_ours() -> None:
    table = PAGE.partition("### Profilers and systems")[2].partition("###")[0].splitlines()
    for plugin in PLUGINS:
        rows = [line for line in table if line.startswith("|") and f"`{plugin.name}`" in line]
        assert not plugin.names or any(plugin.ours in row for row in rows), plugin.name


def test_every_event_that_differs_is_told_of() -> None:
    ours = {"BEFORE_EXPERIMENT", "BEFORE_RUN", "START_RUN", "START_MEASUREMENT", "STOP_MEASUREMENT", "STOP_RUN"}
    ours |= {"POPULATE_RUN_DATA", "AFTER_EXPERIMENT"}
    assert {event.name for events in (RobotRunnerEvents, RunnerEvents) for event in events} - ours <= NAMED


def test_the_old_config_of_the_page_becomes_the_new_one(tmp_path: Path) -> None:
    config = tmp_path / "RunnerConfig.py"
    config.write_text(OLD, encoding="utf-8")
    assert main(["convert", str(config)]) == 0
    assert (tmp_path / "RunnerConfig_converted.py").read_text(encoding="utf-8") == NEW


@pytest.mark.long
@pytest.mark.parametrize(("text", "heading"), [(OLD, "__run_id,__done,"), (NEW, "run_id,status,")])
@pytest.mark.filterwarnings("ignore:.*multi-threaded:DeprecationWarning")
def test_both_configs_of_the_page_are_executed(text: str, heading: str, tmp_path: Path) -> None:
    config = tmp_path / "config.py"
    config.write_text(text, encoding="utf-8")
    assert main(["run", str(config)]) == 0
    table = (tmp_path / "experiments" / "sorting" / "run_table.csv").read_text(encoding="utf-8")
    assert table.startswith(heading)
    assert len(table.splitlines()) == 10
