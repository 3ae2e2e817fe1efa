"""What validation reads in the code of callbacks: what runs store, draw random numbers from, and wait by."""

from __future__ import annotations

from pathlib import Path

import pytest

from robot_runner.core.config.preparation import prepare

CONFIG = """
import functools, os, random, time
from pathlib import Path
from time import sleep
from time import sleep as wait
import numpy as np
from robot_runner import ExperimentConfig, EventSubscriptionController, Factor, RobotRunnerEvents, RunTableModel
from robot_runner.plugins import Profiler, System, connect_robot
{head}
class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "study"
{body}
    def create_run_table(self):
        return RunTableModel([Factor("A", [1, 2])])
"""
WHERE = "study.py, RobotRunnerConfig"


def told(folder: Path, words: str, body: str, head: str = "", **settings: str) -> list[tuple[str, str]]:
    """Return place and problem of each finding with these words in its problem."""
    config = folder / "study.py"
    config.write_text(CONFIG.format(head=head, body=body), encoding="utf-8")
    preparation = prepare(config, settings, is_for_here=False)
    assert preparation.experiment is not None, preparation.findings
    return [(each.where, each.problem) for each in preparation.findings if words in each.problem]


# What runs store in the config or a plugin, and what is called in the orchestrator's process reads.

LOST_AFTER = "    def after_experiment(self, context): print(self.results)\n"


def lost_told(folder: Path, body: str, head: str = "", **settings: str) -> list[tuple[str, str]]:
    found = told(folder, "gone with it", body, head, **settings)
    return [(where, problem.partition(", which runs change")[0]) for where, problem in found]


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
    assert lost_told(tmp_path, body) == [(WHERE, "after_experiment reads self.results")]
    assert lost_told(tmp_path, body, run_process="spawn") == [(WHERE, "after_experiment reads self.results")]
    assert lost_told(tmp_path, body, run_process="in_process") == []


def test_what_is_read_between_runs_is_named_also_where_events_are_subscribed(tmp_path: Path) -> None:
    body = (
        "    def __init__(self):\n"
        "        EventSubscriptionController.subscribe_to_multiple_events([\n"
        "            (RobotRunnerEvents.START_RUN, self.first), (RobotRunnerEvents.BEFORE_RUN, self.second)])\n"
        "    def first(self): self.count = 1\n"
        "    def second(self): print(self.count)\n"
    )
    assert lost_told(tmp_path, body) == [(WHERE, "before_run reads self.count")]


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
    found = told(folder, "sees nothing", body, **settings)
    return [(where, problem.partition(", which runs read")[0]) for where, problem in found]


@pytest.mark.parametrize("event", ["before_experiment", "before_run"])
def test_what_runs_in_a_fresh_interpreter_or_on_a_worker_do_not_see_is_named(tmp_path: Path, event: str) -> None:
    body = f"    offset = 0\n    def {event}(self): self.offset = 5\n"
    body += "    def populate_run_data(self): return {'E': self.offset}\n"
    expected = [(WHERE, f"{event} changes self.offset")]
    assert unseen_told(tmp_path, body, run_process="spawn") == expected
    assert unseen_told(tmp_path, body, cluster="tcp://127.0.0.1:8786") == expected
    assert unseen_told(tmp_path, body) == []
    set_up = f"    def start_run(self): self.offset = 5\n{body}"
    assert unseen_told(tmp_path, set_up, run_process="spawn") == [], "each run sets it up itself"


# A generator of random numbers that is made once, and from which runs draw: each of them the same numbers.


def drawn_told(folder: Path, head: str, body: str, **settings: str) -> list[tuple[str, str]]:
    found = told(folder, "random numbers", body, head, **settings)
    return [(where, problem.partition("state of ")[2].partition(", and draws")[0]) for where, problem in found]


DRAWN_DRAWS = "    def launch_mission(self, context): print(GEN.normal())\n"
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
        ("GEN = np.random.default_rng(1)", DRAWN_DRAWS, WHERE, "GEN"),
        ("GEN = np.random.RandomState(1)", DRAWN_DRAWS, WHERE, "GEN"),
        (
            "GEN = random.Random(1)",
            "    def start_run(self): print([GEN.random() for _ in 'a'])\n",
            WHERE,
            "GEN",
        ),
        ("", "    rng = random.Random(3)\n    def stop_run(self): self.rng.random()\n", WHERE, "self.rng"),
        (
            "GEN = random.Random(1)\ndef drawn():\n    return (lambda: GEN.random())()\n",
            "    def helped(self): return drawn()\n    def launch_mission(self): self.helped()\n",
            WHERE,
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

SLEPT_HEAD = """
def rest(seconds):
    wait(seconds)

class Lift(System):
    def launch_mission(self, context): {}
"""
SLEPT_BODY = """
    robot = "simulated"
    plugins = [Lift()]

    def start_run(self, context): time.sleep(1)
    def launch_mission(self, context): {}
    def helped(self): sleep(1)
"""


def slept_told(folder: Path, of_config: str, of_lift: str = "pass", **settings: str) -> list[str]:
    found = told(folder, "time.sleep", SLEPT_BODY.format(of_config), SLEPT_HEAD.format(of_lift), **settings)
    return [where for where, _ in found]


@pytest.mark.parametrize("way", ["time.sleep(1)", "sleep(1)", "rest(1)", "self.helped()", "[wait(1) for _ in 'ab']"])
def test_a_mission_that_waits_by_this_machine_s_clock_is_told(tmp_path: Path, way: str) -> None:
    assert slept_told(tmp_path, way) == [WHERE]
    assert slept_told(tmp_path, "pass", "time.sleep(1)") == ["plugin Lift"]
    assert slept_told(tmp_path, way, robot="ros2://alice") == []


@pytest.mark.parametrize("way", ["context.clock.sleep(1)", "time.monotonic()"])
def test_a_mission_that_waits_by_the_run_s_clock_is_right(tmp_path: Path, way: str) -> None:
    assert slept_told(tmp_path, way) == []


# A robot that the orchestrator drives.


def driven_told(folder: Path, event: str, call: str, **settings: str) -> list[str]:
    body = f"    def {event}(self, context): {call}\n"
    head = "TWIST = 'geometry_msgs/msg/Twist'"
    found = told(folder, "nothing stops the robot", body, head, **{"robot": "rosbridge://lab:9090", **settings})
    return [problem for _, problem in found]


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
    problem = f"{event} drives the robot in the orchestrator's process: where that is killed meanwhile, "
    assert driven_told(tmp_path, event, call) == [f"{problem}nothing stops the robot"]
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
    return [problem for _, problem in told(folder, "again in each run", body, head)]


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
    assert written_anew(tmp_path, f"    def stop_run(self, context): {call}\n", head) == [
        "stop_run writes 'out.csv' again in each run: the last one replaces the others"
    ]


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


def told_late(folder: Path, policy: str, body: str) -> list[str]:
    return [problem for _, problem in told(folder, "is over", body, on_bad_value=policy)]


@pytest.mark.parametrize("policy", ["TRY_AGAIN", "FAIL"])
def test_a_measure_that_comes_when_its_absence_has_failed_the_run_is_told(tmp_path: Path, policy: str) -> None:
    problem = "continue_experiment publishes Mood, Voltage once a run is over, which on_bad_value has taken for missing"
    body = "    def continue_experiment(self, context):\n        context.publish('Voltage', 12)\n"
    assert told_late(tmp_path, policy, f"{body}        context.publish(name='Mood', value=1)\n") == [problem]


def test_a_measure_that_comes_after_the_run_is_right_where_a_missing_one_is_kept(tmp_path: Path) -> None:
    body = "    def continue_experiment(self, context): context.publish('Voltage', 12)\n"
    assert told_late(tmp_path, "KEEP", body) == []
    assert told_late(tmp_path, "FAIL", body.replace("continue_experiment", "populate_run_data")) == []
    message = "    def continue_experiment(self, context): self.link.publish('led', 'std_msgs/Bool', {'data': True})\n"
    assert told_late(tmp_path, "FAIL", message) == []
