from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    Program = Callable[..., Any]
    Write = Callable[..., Path]
    Terminals = Callable[..., Any]

#: r_1 and r_3 are doubtful, r_4 is missing.
BODY = """
def populate_run_data(self, context):
    if context.combination["Task"] == "Video":
        context.doubt("the sensor was hot: 81 degC", measures=["Energy"])
    return {"Energy": None if context.run_id == "r_4" else 7.5}
"""
SAID = "Energy is doubtful in r_1, r_3, missing in r_4"


def test_doubtful_values_are_marked_and_told_at_the_end(robot_runner: Program, write_config: Write) -> None:
    write_config(BODY)
    answer = robot_runner("run", "config.py", "--plain")
    lines = {line.partition(" is done")[0]: line for line in answer.out.splitlines() if " is done" in line}
    assert lines["run 1 of 4 (r_1)"].endswith("Energy 7.500?")
    assert lines["run 2 of 4 (r_2)"].endswith("Energy 7.500")
    assert SAID in " ".join(answer.out.split())


@pytest.mark.long
def test_the_status_tells_of_them(robot_runner: Program, write_config: Write) -> None:
    write_config(BODY)
    robot_runner("run", "config.py")
    assert SAID in " ".join(robot_runner("status", "config.py").out.split())
    told = robot_runner("status", "config.py", "--json").json
    assert told["bad_values"] == {"Energy": {"doubtful": ["r_1", "r_3"], "missing": ["r_4"]}}


@pytest.mark.long
def test_the_end_and_the_status_tell_of_values_that_nobody_published(
    robot_runner: Program, write_config: Write
) -> None:
    write_config("""
def populate_run_data(self, context):
    return {} if context.run_id == "r_2" else {"Energy": 7.5}
""")
    said = "Energy is missing in r_2"
    assert said in " ".join(robot_runner("run", "config.py").out.split())
    assert said in " ".join(robot_runner("status", "config.py").out.split())
    told = robot_runner("status", "config.py", "--json").json
    assert told["bad_values"] == {"Energy": {"missing": ["r_2"]}}


@pytest.mark.long
def test_the_live_screen_marks_them(terminal: Terminals, write_config: Write) -> None:
    write_config(BODY)
    shown = terminal("run", "config.py")
    shown.wait_for("Quality")
    assert "7.500?" in shown.raw


@pytest.mark.long
def test_each_value_is_explained_with_its_quality_and_reasons(robot_runner: Program, write_config: Write) -> None:
    write_config(BODY)
    robot_runner("run", "config.py")
    said = {
        run: " ".join(robot_runner("explain", "config.py", run, "Energy").out.split()) for run in ("r_1", "r_2", "r_4")
    }
    assert "Quality doubtful: the sensor was hot: 81 degC" in said["r_1"]
    assert said["r_1"].count("the sensor was hot: 81 degC") == 1
    assert "Quality good" in said["r_2"]
    assert "Quality missing" in said["r_4"]
