"""What validation reads in the code of callbacks: what runs store, draw random numbers from, and wait by."""

from __future__ import annotations

from pathlib import Path

import pytest

from robot_runner.core.config.preparation import prepare

# What runs store in the config or a plugin, and what is called in the orchestrator's process reads.

LOST_BEGIN = """
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
LOST_AFTER = "    def after_experiment(self, context): print(self.results)\n"
LOST_CONFIG = "lost.py, RobotRunnerConfig"


def lost_told(folder: Path, body: str, head: str = "", **settings: str) -> list[tuple[str, str]]:
    config = folder / "lost.py"
    config.write_text(LOST_BEGIN.format(head=head, body=body), encoding="utf-8")
    preparation = prepare(config, settings, is_for_here=False)
    assert preparation.experiment is not None, preparation.findings
    found = [each for each in preparation.findings if "gone with it" in each.problem]
    return [(each.where, each.problem.partition(", which runs change")[0]) for each in found]


@pytest.mark.parametrize(
    "body",
    [
        "    results = []\n    def populate_run_data(self): self.results.append(1)\n" + LOST_AFTER,
        "    def stop_run(self): self.results += 1\n" + LOST_AFTER,
        "    def start_measurement(self, context): self.results[context.run_id] = 1\n" + LOST_AFTER,
        "    def launch_mission(me): del me.results[0]\n" + LOST_AFTER,
        "    def launch_mission(self): self.keep(1)\n    def keep(self, one): self.results = one\n" + LOST_AFTER,
        (
            "    def launch_mission(self): self.results = 1\n"
            "    def total(self): return self.results\n"
            "    def after_experiment(self): print(self.total())\n"
        ),
        "    @functools.lru_cache\n    def start_run(self): self.results = 1\n" + LOST_AFTER,
    ],
    ids=["a list", "a sum", "a dict", "an element", "in a method", "read in a method", "behind a decorator"],
)
def test_what_is_read_after_the_experiment_is_named(tmp_path: Path, body: str) -> None:
    assert lost_told(tmp_path, body) == [(LOST_CONFIG, "after_experiment reads self.results")]
    assert lost_told(tmp_path, body, run_process="spawn") == [(LOST_CONFIG, "after_experiment reads self.results")]
    assert lost_told(tmp_path, body, run_process="in_process") == []


def test_what_is_read_between_runs_is_named_also_where_events_are_subscribed(tmp_path: Path) -> None:
    body = (
        "    def __init__(self):\n"
        "        EventSubscriptionController.subscribe_to_multiple_events([\n"
        "            (RobotRunnerEvents.START_RUN, self.first), (RobotRunnerEvents.BEFORE_RUN, self.second)])\n"
        "    def first(self): self.count = 1\n"
        "    def second(self): print(self.count)\n"
    )
    assert lost_told(tmp_path, body) == [(LOST_CONFIG, "before_run reads self.count")]


def test_plugins_of_the_config_s_own_are_looked_at_as_well(tmp_path: Path) -> None:
    head = (
        "class Meter(Profiler):\n"
        "    def stop_measurement(self): self.total = 1\n"
        "    def after_experiment(self): print(self.total)\n"
    )
    body = "    plugins = [Meter()]\n    def after_experiment(self): print(self.total)\n    total = 0\n"
    assert lost_told(tmp_path, body, head) == [("plugin Meter", "after_experiment reads self.total")]


@pytest.mark.parametrize(
    "body",
    [
        "    def start_run(self): self.process = 1\n    def stop_run(self): print(self.process)\n",
        (
            "    def before_experiment(self): self.server = 1\n    def launch_mission(self): print(self.server)\n"
            "    def after_experiment(self): print(self.server)\n"
        ),
        "    def before_run(self): self.begun = 1\n    def populate_run_data(self): print(self.begun)\n",
        "    def launch_mission(self, context): context.results = [1]\n    results = ()\n" + LOST_AFTER,
        (
            "    def before_experiment(self): self.file = open('/dev/null')\n"
            "    def populate_run_data(self): self.file.write('line')\n"
            "    def after_experiment(self): self.file.close()\n"
        ),
        (
            "    def before_experiment(self): self.base = object()\n"
            "    def populate_run_data(self): self.base.insert(1); self.base.update(2)\n"
            "    def after_experiment(self): print(self.base)\n"
        ),
    ],
    ids=[
        "within a run",
        "of before the experiment",
        "of before the run",
        "of another object",
        "a file",
        "no container",
    ],
)
def test_nothing_is_said_of_what_arrives(tmp_path: Path, body: str) -> None:
    assert lost_told(tmp_path, body) == []


def unseen_told(folder: Path, body: str, **settings: str) -> list[tuple[str, str]]:
    config = folder / "lost.py"
    config.write_text(LOST_BEGIN.format(head="", body=body), encoding="utf-8")
    found = [each for each in prepare(config, settings, is_for_here=False).findings if "sees nothing" in each.problem]
    return [(each.where, each.problem.partition(", which runs read")[0]) for each in found]


@pytest.mark.parametrize("event", ["before_experiment", "before_run"])
def test_what_runs_in_a_fresh_interpreter_or_on_a_worker_do_not_see_is_named(tmp_path: Path, event: str) -> None:
    body = f"    offset = 0\n    def {event}(self): self.offset = 5\n"
    body += "    def populate_run_data(self): return {'E': self.offset}\n"
    told = [(LOST_CONFIG, f"{event} changes self.offset")]
    assert unseen_told(tmp_path, body, run_process="spawn") == told
    assert unseen_told(tmp_path, body, cluster="tcp://127.0.0.1:8786") == told
    assert unseen_told(tmp_path, body) == []
    set_up = f"    def start_run(self): self.offset = 5\n{body}"
    assert unseen_told(tmp_path, set_up, run_process="spawn") == [], "each run sets it up itself"


# A generator of random numbers that is made once, and from which runs draw: each of them the same numbers.

DRAWN_BEGIN = """
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


def drawn_told(folder: Path, head: str, body: str, **settings: str) -> list[tuple[str, str]]:
    config = folder / "generators.py"
    config.write_text(DRAWN_BEGIN.format(head=head, body=body), encoding="utf-8")
    preparation = prepare(config, settings, is_for_here=False)
    assert preparation.experiment is not None, preparation.findings
    found = [each for each in preparation.findings if "random numbers" in each.problem]
    return [(each.where, each.problem.partition("state of ")[2].partition(", and draws")[0]) for each in found]


DRAWN_DRAWS = "    def launch_mission(self, context): print(GEN.normal())\n"
DRAWN_CONFIG = "generators.py, RobotRunnerConfig"
DRAWN_METER = """
class Meter(Profiler):
    def __init__(self):
        super().__init__()
        self.rng = np.random.default_rng(4)

    def start_measurement(self, context): self.rng.normal()
"""


@pytest.mark.parametrize(
    ("head", "body", "where", "named"),
    [
        ("GEN = np.random.default_rng(1)", DRAWN_DRAWS, DRAWN_CONFIG, "GEN"),
        ("GEN = np.random.RandomState(1)", DRAWN_DRAWS, DRAWN_CONFIG, "GEN"),
        (
            "GEN = random.Random(1)",
            "    def start_run(self): print([GEN.random() for _ in 'a'])\n",
            DRAWN_CONFIG,
            "GEN",
        ),
        ("", "    rng = random.Random(3)\n    def stop_run(self): self.rng.random()\n", DRAWN_CONFIG, "self.rng"),
        (
            "GEN = random.Random(1)\ndef drawn():\n    return (lambda: GEN.random())()\n",
            "    def helped(self): return drawn()\n    def launch_mission(self): self.helped()\n",
            DRAWN_CONFIG,
            "GEN",
        ),
        (
            DRAWN_METER,
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
    assert drawn_told(tmp_path, head, body) == [(where, named)]
    assert drawn_told(tmp_path, head, body, run_process="in_process") == []


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
    assert drawn_told(tmp_path, head, body) == []


# A mission of the simulated robot that waits by the clock of this machine, which is not its clock.

SLEPT_BEGIN = """
import time
from time import sleep
from time import sleep as wait
from robot_runner import ExperimentConfig, Factor, RunTableModel
from robot_runner.plugins import System

def rest(seconds):
    wait(seconds)

class Lift(System):
    def launch_mission(self, context): {of_lift}

class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "sleeping"
    robot = "simulated"
    plugins = [Lift()]

    def start_run(self, context): time.sleep(1)
    def launch_mission(self, context): {of_config}
    def helped(self): sleep(1)

    def create_run_table(self):
        return RunTableModel([Factor("A", [1, 2])])
"""
SLEPT_CONFIG = "sleeping.py, RobotRunnerConfig"


def slept_told(folder: Path, of_config: str, of_lift: str = "pass", **settings: str) -> list[str]:
    config = folder / "sleeping.py"
    config.write_text(SLEPT_BEGIN.format(of_config=of_config, of_lift=of_lift), encoding="utf-8")
    preparation = prepare(config, settings, is_for_here=False)
    assert preparation.experiment is not None, preparation.findings
    return [each.where for each in preparation.findings if "time.sleep" in each.problem]


@pytest.mark.parametrize("way", ["time.sleep(1)", "sleep(1)", "rest(1)", "self.helped()", "[wait(1) for _ in 'ab']"])
def test_a_mission_that_waits_by_this_machine_s_clock_is_told(tmp_path: Path, way: str) -> None:
    assert slept_told(tmp_path, way) == [SLEPT_CONFIG]
    assert slept_told(tmp_path, "pass", "time.sleep(1)") == ["plugin Lift"]
    assert slept_told(tmp_path, way, robot="ros2://alice") == []


@pytest.mark.parametrize("way", ["context.clock.sleep(1)", "time.monotonic()"])
def test_a_mission_that_waits_by_the_run_s_clock_is_right(tmp_path: Path, way: str) -> None:
    assert slept_told(tmp_path, way) == []


# A robot that the orchestrator drives.


def driven_told(folder: Path, event: str, call: str, **settings: str) -> list[str]:
    config = folder / "driven.py"
    head = "from robot_runner.plugins import connect_robot\nTWIST = 'geometry_msgs/msg/Twist'\n"
    body = f"    def {event}(self, context): {call}\n"
    config.write_text(LOST_BEGIN.format(head=head, body=body), encoding="utf-8")
    preparation = prepare(config, {"robot": "rosbridge://lab:9090", **settings}, is_for_here=False)
    assert preparation.experiment is not None, preparation.findings
    return [each.problem for each in preparation.findings if "nothing stops the robot" in each.problem]


DRIVE = "connect_robot(context).publish('cmd_vel', 'geometry_msgs/TwistStamped', {'twist': {'linear': {'x': 0.2}}})"


@pytest.mark.parametrize("event", ["before_run", "continue_experiment"])
@pytest.mark.parametrize(
    "call",
    [
        DRIVE,
        "link = connect_robot(context); link.publish('cmd_vel', TWIST, self.ahead)",
        "connect_robot(context).send_goal('dock', 'nav2_msgs/DockRobot', self.dock)",
    ],
)
def test_a_robot_that_is_driven_in_the_orchestrator_s_process_is_told(tmp_path: Path, event: str, call: str) -> None:
    told = f"{event} drives the robot in the orchestrator's process: where that is killed meanwhile, "
    assert driven_told(tmp_path, event, call) == [f"{told}nothing stops the robot"]
    assert driven_told(tmp_path, event, call, robot="simulated") == []
    assert driven_told(tmp_path, event, call, run_process="in_process") == []
    assert driven_told(tmp_path, "launch_mission", call) == []


@pytest.mark.parametrize(
    "call",
    [
        "context.publish('Twist', 'Twist of it')",
        "connect_robot(context).publish('lamp', LAMP, {'data': True})",
        "connect_robot(context).publish('cmd_vel', TWIST, {})",
        "connect_robot(context).publish('cmd_vel', TWIST, {'linear': {'x': 0.0, 'y': 0}, 'angular': {}})",
    ],
)
def test_what_else_is_published_in_the_orchestrator_s_process_is_right(tmp_path: Path, call: str) -> None:
    assert driven_told(tmp_path, "before_run", call) == []


# A file that each run writes under one name.


def written_anew(folder: Path, body: str, head: str = "") -> list[str]:
    config = folder / "writing.py"
    config.write_text(
        LOST_BEGIN.format(head=f"import os\nfrom pathlib import Path\n{head}", body=body), encoding="utf-8"
    )
    preparation = prepare(config, is_for_here=False)
    assert preparation.experiment is not None, preparation.findings
    return [each.problem for each in preparation.findings if "again in each run" in each.problem]


@pytest.mark.parametrize(
    "call",
    [
        "open('out.csv', 'w')",
        "open('out.csv', mode='xb')",
        "open(OUT, 'w')",
        "open(Path('out.csv'), 'w+')",
        "Path('out.csv').open('w')",
        "Path('out.csv').write_text('text')",
        "self.frame.to_csv('out.csv', index=False)",
        "numpy.savetxt('out.csv', [1])",
        "written('out.csv', 'w')",
    ],
)
def test_a_file_that_each_run_replaces_is_told(tmp_path: Path, call: str) -> None:
    head = "import numpy\nOUT = 'out.csv'\ndef written(name, mode):\n    return open('out.csv', mode='w')\n"
    told = written_anew(tmp_path, f"    def stop_run(self, context): {call}\n", head)
    assert told == ["stop_run writes 'out.csv' again in each run: the last one replaces the others"]


@pytest.mark.parametrize(
    "call",
    [
        "open('in.csv')",
        "open('out.csv', 'a')",
        "open(context.run_folder / 'out.csv', 'w')",
        "open(f'{context.run_id}.csv', 'w')",
        "(context.run_folder / 'out.csv').write_text('text')",
        "open(name, 'w')",
        "self.archive.open('out.csv', 'w')",
        "numpy.savetxt(context.run_folder / 'out', [1])",
        "open('/sys/class/gpio/export', 'w')",
        "Path('/dev/ttyACM0').write_bytes(b'?')",
        "self.maps.save('lab')",
        "(os.chdir(context.run_folder), open('out.csv', 'w'))",
    ],
)
def test_a_file_that_each_run_has_for_itself_is_right(tmp_path: Path, call: str) -> None:
    assert written_anew(tmp_path, f"    def stop_run(self, context): {call}\n", "import numpy\n") == []
    assert written_anew(tmp_path, "    def before_experiment(self): open('out.csv', 'w')\n") == []


# Measures that `continue` publishes, where a run without a value is tried again.

LATE_BEGIN = """
from robot_runner import BadValuePolicy, ExperimentConfig, Factor, RunTableModel
class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "late"
    on_bad_value = BadValuePolicy.{policy}
{body}
    def create_run_table(self):
        return RunTableModel([Factor("A", [1, 2])], data_columns=["Voltage", "Mood"])
"""


def told_late(folder: Path, policy: str, body: str) -> list[str]:
    config = folder / "late.py"
    config.write_text(LATE_BEGIN.format(policy=policy, body=body), encoding="utf-8")
    preparation = prepare(config, is_for_here=False)
    assert preparation.experiment is not None, preparation.findings
    return [each.problem for each in preparation.findings if "is over" in each.problem]


@pytest.mark.parametrize("policy", ["TRY_AGAIN", "FAIL"])
def test_a_measure_that_comes_when_its_absence_has_failed_the_run_is_told(tmp_path: Path, policy: str) -> None:
    told = "continue_experiment publishes Mood, Voltage once a run is over, which on_bad_value has taken for missing"
    body = "    def continue_experiment(self, context):\n        context.publish('Voltage', 12)\n"
    assert told_late(tmp_path, policy, f"{body}        context.publish(name='Mood', value=1)\n") == [told]


def test_a_measure_that_comes_after_the_run_is_right_where_a_missing_one_is_kept(tmp_path: Path) -> None:
    body = "    def continue_experiment(self, context): context.publish('Voltage', 12)\n"
    assert told_late(tmp_path, "KEEP", body) == []
    assert told_late(tmp_path, "FAIL", body.replace("continue_experiment", "populate_run_data")) == []
    message = "    def continue_experiment(self, context): self.link.publish('led', 'std_msgs/Bool', {'data': True})\n"
    assert told_late(tmp_path, "FAIL", message) == []
