"""A generator of random numbers that is made once, and from which runs draw: each of them the same numbers."""

from __future__ import annotations

from pathlib import Path

import pytest

from robot_runner.core.config.preparation import prepare

BEGIN = """
import random, functools
import numpy as np
from robot_runner import ExperimentConfig, Factor, RunTableModel
from robot_runner.plugins import Profiler
{head}
class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "generators"
{body}
    def create_run_table(self):
        return RunTableModel([Factor("A", [1, 2])])
"""


def told(folder: Path, head: str, body: str, **settings: str) -> list[tuple[str, str]]:
    config = folder / "generators.py"
    config.write_text(BEGIN.format(head=head, body=body), encoding="utf-8")
    preparation = prepare(config, settings, is_for_here=False)
    assert preparation.experiment is not None, preparation.findings
    found = [each for each in preparation.findings if "random numbers" in each.problem]
    return [(each.where, each.problem.partition("state of ")[2].partition(", and draws")[0]) for each in found]


DRAWS = "    def launch_mission(self, context): print(GEN.normal())\n"
CONFIG = "generators.py, RobotRunnerConfig"
METER = """
class Meter(Profiler):
    def __init__(self):
        super().__init__()
        self.rng = np.random.default_rng(4)

    def start_measurement(self, context): self.rng.normal()
"""


@pytest.mark.parametrize(
    ("head", "body", "where", "named"),
    [
        ("GEN = np.random.default_rng(1)", DRAWS, CONFIG, "GEN"),
        ("GEN = np.random.RandomState(1)", DRAWS, CONFIG, "GEN"),
        ("GEN = random.Random(1)", "    def start_run(self): self.x = [GEN.random() for _ in 'ab']\n", CONFIG, "GEN"),
        ("", "    rng = random.Random(3)\n    def stop_run(self): self.rng.random()\n", CONFIG, "self.rng"),
        (
            "GEN = random.Random(1)\ndef drawn():\n    return (lambda: GEN.random())()\n",
            "    def helped(self): return drawn()\n    def launch_mission(self): self.helped()\n",
            CONFIG,
            "GEN",
        ),
        (
            METER,
            "    plugins = [Meter()]\n",
            "plugin Meter",
            "self.rng",
        ),
    ],
    ids=[
        "NumPy's",
        "NumPy's older one",
        "Python's, in a comprehension",
        "an attribute",
        "by way of others",
        "a plugin's",
    ],
)
def test_what_runs_draw_from_is_named(tmp_path: Path, head: str, body: str, where: str, named: str) -> None:
    assert told(tmp_path, head, body) == [(where, named)]
    assert told(tmp_path, head, body, run_process="in_process") == []


@pytest.mark.parametrize(
    ("head", "body"),
    [
        (
            "GEN = np.random.default_rng(1)\nLEVELS = GEN.permutation(4)\n",
            "    def launch_mission(self): print(LEVELS)\n",
        ),
        ("GEN = random.Random(1)", "    def before_run(self): GEN.random()\n"),
        ("GEN = random.SystemRandom()", "    def launch_mission(self): GEN.random()\n"),
        ("", "    def start_run(self, context): self.rng = random.Random(context.run_seed)\n"),
        ("", "    def launch_mission(self): random.random() + np.random.normal()\n"),
    ],
    ids=["for the design alone", "in the orchestrator", "the system's", "made in each run", "those of the modules"],
)
def test_nothing_is_said_of_what_is_right(tmp_path: Path, head: str, body: str) -> None:
    assert told(tmp_path, head, body) == []
