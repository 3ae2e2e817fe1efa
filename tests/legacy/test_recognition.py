from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from robot_runner.core.errors import ConfigError
from robot_runner.legacy.recognition import Dialect, recognise

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

OWN = """
from robot_runner import ExperimentConfig

class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "own"
"""

PAPER = """
import plugins.systems.BasicTurtlebot3
from robot_runner import OperationType

class RobotRunnerConfig:
    experiment_name: str = "basic_experiment"
"""


def dialect_of(path: Path) -> Dialect | None:
    recognised = recognise(path)
    return recognised.dialect if recognised else None


@pytest.mark.parametrize("text", [OWN, PAPER], ids=["derived", "paper"])
def test_our_own_spelling_is_no_earlier_one(write: Callable[..., Path], text: str) -> None:
    assert dialect_of(write(text)) is None


@pytest.mark.parametrize(
    ("text", "dialect"),
    [
        ("from EventManager.Models.RunnerEvents import RunnerEvents\nclass RunnerConfig: ...", "Experiment Runner"),
        (
            "from EventManager.Models.RobotRunnerEvents import RobotRunnerEvents\nclass RobotRunnerConfig: ...",
            "Robot Runner",
        ),
        ("import ConfigValidator.Config.Models.FactorModel as f\nclass RunnerConfig: ...", "Experiment Runner"),
        (
            "from ConfigValidator.Config.Models.FactorModel import FactorModel\nclass RobotRunnerConfig: ...",
            "Robot Runner",
        ),
        ("from plugins.Profilers.NetworkProfiler import NetworkProfiler\nclass RobotRunnerConfig: ...", "Robot Runner"),
        (
            "from Backbone.Events.Models.RobotRunnerEvents import RobotRunnerEvents\nclass RobotRunnerConfig: ...",
            "Robot Runner",
        ),
        (
            """
            try:
                from EventManager.Models.RunnerEvents import RunnerEvents
            except ImportError:
                pass
            if True:
                class RunnerConfig: ...
            """,
            "Experiment Runner",
        ),
        ("class RunnerConfig:\n    name = 'no imports at all'", "Experiment Runner"),
        ("from base import *\nclass RunnerConfig(RunnerConfig):\n    name = 'derived'", "Experiment Runner"),
        ("from base import Derived\nRunnerConfig = Derived", "Experiment Runner"),
        ("from base import Base\nclass RobotRunnerConfig(Base):\n    name = 'derived'", "Robot Runner"),
    ],
)
def test_the_tool_is_told_by_imports_and_class(write: Callable[..., Path], text: str, dialect: str) -> None:
    assert dialect_of(write(text)) == Dialect(dialect)


def test_a_file_that_gets_everything_from_a_neighbour_is_what_the_neighbour_is(write: Callable[..., Path]) -> None:
    write("from EventManager.Models.RobotRunnerEvents import RobotRunnerEvents\nclass RobotRunnerConfig: ...", "one.py")
    write("from one import RobotRunnerConfig", "two.py")
    derived = write("from two import RobotRunnerConfig as Base\nclass RobotRunnerConfig(Base): ...", "three.py")
    assert dialect_of(derived) is Dialect.ROBOT_RUNNER


def test_nothing_is_executed_to_recognise_a_file(write: Callable[..., Path]) -> None:
    path = write("from EventManager.Models.RunnerEvents import RunnerEvents\n1 / 0\nclass RunnerConfig: ...")
    assert dialect_of(path) is Dialect.EXPERIMENT_RUNNER


def test_a_file_that_mixes_our_spelling_with_an_earlier_one_is_refused_with_both_lines(
    write: Callable[..., Path],
) -> None:
    path = write("from robot_runner import Factor\nfrom EventManager.Models.RunnerEvents import RunnerEvents\n")
    problem = r"config.py:2: the file mixes two dialects.*line 1 imports robot_runner.Factor"
    with pytest.raises(ConfigError, match=problem):
        recognise(path)


def test_a_file_that_mixes_two_tools_is_refused_with_the_name_that_was_meant(write: Callable[..., Path]) -> None:
    path = write(
        "from ConfigValidator.Config.Models.FactorModel import FactorModel\n"
        "from EventManager.Models.RobotRunnerEvents import RobotRunnerEvents\n"
        "class RunnerConfig: ...\n"
    )
    with pytest.raises(ConfigError) as refused:
        recognise(path)
    assert refused.value.where == f"{path}:2"
    assert "line 3 has the class RunnerConfig, which is Experiment Runner's" in refused.value.problem
    assert refused.value.fix == "Did you mean 'RunnerEvents'?"


def test_a_misspelt_class_is_named(write: Callable[..., Path]) -> None:
    path = write("from EventManager.Models.RunnerEvents import RunnerEvents\n\nclass RunerConfig: ...")
    with pytest.raises(
        ConfigError, match=r"config.py:3: .* no class named RunnerConfig → Rename the class RunerConfig"
    ):
        recognise(path)
