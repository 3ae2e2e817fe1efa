"""What runs store in the config or a plugin, and what is called in the orchestrator's process reads."""

from __future__ import annotations

from pathlib import Path

import pytest

from robot_runner.core.config.preparation import prepare

BEGIN = """
import functools
from robot_runner import ExperimentConfig, EventSubscriptionController, Factor, RobotRunnerEvents, RunTableModel
from robot_runner.plugins import Profiler
{head}
class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "lost"
{body}
    def create_run_table(self):
        return RunTableModel([Factor("A", [1, 2])])
"""
AFTER = "    def after_experiment(self, context): print(self.results)\n"
CONFIG = "lost.py, RobotRunnerConfig"


def told(folder: Path, body: str, head: str = "", **settings: str) -> list[tuple[str, str]]:
    config = folder / "lost.py"
    config.write_text(BEGIN.format(head=head, body=body), encoding="utf-8")
    preparation = prepare(config, settings, is_for_here=False)
    assert preparation.experiment is not None, preparation.findings
    found = [each for each in preparation.findings if "gone with it" in each.problem]
    return [(each.where, each.problem.partition(", which runs change")[0]) for each in found]


@pytest.mark.parametrize(
    "body",
    [
        "    results = []\n    def populate_run_data(self): self.results.append(1)\n" + AFTER,
        "    def stop_run(self): self.results += 1\n" + AFTER,
        "    def start_measurement(self, context): self.results[context.run_id] = 1\n" + AFTER,
        "    def launch_mission(me): del me.results[0]\n" + AFTER,
        "    def launch_mission(self): self.keep(1)\n    def keep(self, one): self.results = one\n" + AFTER,
        (
            "    def launch_mission(self): self.results = 1\n"
            "    def total(self): return self.results\n"
            "    def after_experiment(self): print(self.total())\n"
        ),
        "    @functools.lru_cache\n    def start_run(self): self.results = 1\n" + AFTER,
    ],
    ids=["a list", "a sum", "a dict", "an element", "in a method", "read in a method", "behind a decorator"],
)
def test_what_is_read_after_the_experiment_is_named(tmp_path: Path, body: str) -> None:
    assert told(tmp_path, body) == [(CONFIG, "after_experiment reads self.results")]
    assert told(tmp_path, body, run_process="spawn") == [(CONFIG, "after_experiment reads self.results")]
    assert told(tmp_path, body, run_process="in_process") == []


def test_what_is_read_between_runs_is_named_also_where_events_are_subscribed(tmp_path: Path) -> None:
    body = (
        "    def __init__(self):\n"
        "        EventSubscriptionController.subscribe_to_multiple_events([\n"
        "            (RobotRunnerEvents.START_RUN, self.first), (RobotRunnerEvents.BEFORE_RUN, self.second)])\n"
        "    def first(self): self.count = 1\n"
        "    def second(self): print(self.count)\n"
    )
    assert told(tmp_path, body) == [(CONFIG, "before_run reads self.count")]


def test_plugins_of_the_config_s_own_are_looked_at_as_well(tmp_path: Path) -> None:
    head = (
        "class Meter(Profiler):\n"
        "    def stop_measurement(self): self.total = 1\n"
        "    def after_experiment(self): print(self.total)\n"
    )
    body = "    plugins = [Meter()]\n    def after_experiment(self): print(self.total)\n    total = 0\n"
    assert told(tmp_path, body, head) == [("plugin Meter", "after_experiment reads self.total")]


@pytest.mark.parametrize(
    "body",
    [
        "    def start_run(self): self.process = 1\n    def stop_run(self): print(self.process)\n",
        (
            "    def before_experiment(self): self.server = 1\n    def launch_mission(self): print(self.server)\n"
            "    def after_experiment(self): print(self.server)\n"
        ),
        "    def before_run(self): self.begun = 1\n    def populate_run_data(self): print(self.begun)\n",
        "    def launch_mission(self, context): context.results = [1]\n    results = ()\n" + AFTER,
        (
            "    def before_experiment(self): self.file = open('/dev/null')\n"
            "    def populate_run_data(self): self.file.write('line')\n"
            "    def after_experiment(self): self.file.close()\n"
        ),
    ],
    ids=["within a run", "of before the experiment", "of before the run", "of another object", "a file"],
)
def test_nothing_is_said_of_what_arrives(tmp_path: Path, body: str) -> None:
    assert told(tmp_path, body) == []
