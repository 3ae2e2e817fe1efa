from __future__ import annotations

import re
import textwrap
import time
from typing import TYPE_CHECKING

import pytest
from tests.event_deadline import enforce_deadline_in

from robot_runner.cli import trial
from robot_runner.core.entry_points import EntryPoint
from robot_runner.core.plugin import installed_plugins
from robot_runner.ros.topic_latency import TopicLatency

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

pytestmark = pytest.mark.filterwarnings("ignore:.*multi-threaded:DeprecationWarning")

GOOD = """\
from robot_runner.plugins import Column, Measure, PeriodicSampler, Profiler, mean, report_quality, write_samples


class Meter(Profiler):
    \"\"\"Measures what it is told.\"\"\"

    measures = (Measure("Power", "W", "Mean power."), Measure("Spare", "W", "Never there."))
    sampler = None

    def __init__(self, *, watts=7.5, label="none", name=None):
        super().__init__(name=name)
        self.watts, self.label = watts, label

    def start_measurement(self, context):
        self.sampler = PeriodicSampler(lambda: self.watts, rate=50.0, clock=context.clock)
        self.sampler.start()

    def stop_measurement(self, context):
        if self.sampler is not None:
            self.sampler.stop()

    def populate_run_data(self, context):
        samples = self.sampler.stop()
        write_samples(context.raw_data_folder / "samples.csv", [Column("time_s", samples.times)])
        report_quality(context, samples.quality(), samples.window)
        print("measured", self.label)
        context.publish("Power", mean(samples.series()))
        context.publish("Spare", None)
"""


@pytest.fixture
def plugin(tmp_path: Path) -> Callable[[str], Path]:
    """Return what writes a file with a profiler in it."""

    def write(body: str, name: str = "stranger.py") -> Path:
        path = tmp_path / name
        path.write_text(textwrap.dedent(body))
        return path

    return write


def broken(body: str, *, measures: str = "(Measure('Power', 'W', 'Mean power.'),)") -> str:
    head = f"""\
from robot_runner.plugins import Finding, Measure, Profiler


class Meter(Profiler):
    measures = {measures}

"""
    return head + textwrap.indent(textwrap.dedent(body), "    ")


def test_a_count_has_no_unit(robot_runner: Callable, plugin: Callable) -> None:
    counting = broken(
        "def populate_run_data(self, context): context.publish('Packets', 3)",
        measures="(Measure('Packets', '1', 'Packets received.'),)",
    )
    assert "Packets  3  (measured)" in robot_runner("try", plugin(counting), "--seconds", "0.01").out


def test_an_author_sees_what_the_framework_sees(robot_runner: Callable, plugin: Callable) -> None:
    begun = time.monotonic()
    answer = robot_runner("try", plugin(GOOD), "--seconds", "0.2")
    seconds = time.monotonic() - begun
    assert answer.code == 0
    assert "Measures what it is told." in answer.out
    assert "start_run          no callback" in answer.out
    assert "start_measurement  called" in answer.out
    assert "Power  7.500 W  (measured" in answer.out  # "measured, doubtful" where a busy machine kept samples off
    assert "Spare  no value" in answer.out
    assert "samples.csv   " in answer.out
    assert "time_s" in answer.out
    expected = re.search(r"\d+ of (\d+) expected", answer.out)
    assert expected is not None
    assert 10 <= int(expected[1]) <= 50 * seconds + 1  # at 50 Hz; on a busy machine 0.2 s take longer
    assert "jitter" in answer.out
    assert "  measured none\n" in answer.out
    assert "warning: r_1, Meter: Spare has no value" in answer.out


def test_parameters_are_set_as_python_literals_or_texts(robot_runner: Callable, plugin: Callable) -> None:
    answer = robot_runner("try", plugin(GOOD), "--seconds", "0.1", "--set", "watts=2.5", "--set", "label=left meter")
    assert "Power  2.500 W" in answer.out
    assert "  measured left meter\n" in answer.out


def test_json_has_the_same_and_nothing_else(robot_runner: Callable, plugin: Callable, tmp_path: Path) -> None:
    answer = robot_runner("try", plugin(GOOD), "--seconds", "0.1", "--json", "--keep", tmp_path / "kept")
    told = answer.json
    assert told["status"] == "done"
    power = told["measures"]["Power"]
    assert power.items() >= {"value": 7.5, "unit": "W", "origin": "measured"}.items()
    assert power["quality"] == ("doubtful" if power["doubts"] else "good")
    assert told["measures"]["Spare"]["quality"] == "missing"
    assert told["measures"]["Spare"]["value"] is None
    assert {event["name"]: event["is_heard"] for event in told["events"]}["launch_mission"] is False
    assert sorted(file["name"] for file in told["raw_files"]) == ["quality.json", "samples.csv"]
    assert told["quality"]["samples"]["got"] >= 2
    assert sorted(path.name for path in (tmp_path / "kept").iterdir()) == ["quality.json", "samples.csv"]


def test_nothing_is_left_behind(robot_runner: Callable, plugin: Callable, tmp_path: Path, monkeypatch) -> None:
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    monkeypatch.setenv("TMPDIR", str(scratch))
    monkeypatch.setattr("tempfile.tempdir", None)
    assert robot_runner("try", plugin(GOOD), "--seconds", "0.1").code == 0
    assert list(scratch.iterdir()) == []


@pytest.mark.long
def test_an_installed_profiler_is_named_alone_and_the_simulated_robot_can_be_set(robot_runner: Callable) -> None:
    answer = robot_runner("try", "PsUtil", "--set", "robot=simulated", "--seconds", "3", "--set", "rate_hz=20")
    assert answer.code == 0, answer.err
    assert "%  (simulated)" in answer.out
    assert "of 60 expected" in answer.out


def test_what_its_check_finds_refuses_it_with_a_fix(robot_runner: Callable) -> None:
    answer = robot_runner("try", "PsUtil")
    assert answer.code == 2
    assert "error: plugin PsUtil: the plugin measures a computer, and none is named" in answer.err
    assert "fix: " in answer.err
    assert robot_runner("try", "PsUtil", "--json").json["status"] == "refused"


def test_why_raw_data_cannot_be_kept_is_said(robot_runner: Callable, plugin: Callable, tmp_path: Path) -> None:
    linking = broken("def start_run(self, context):\n    (context.raw_data_folder / 'last.csv').symlink_to('gone.csv')")
    answer = robot_runner("try", plugin(linking), "--seconds", "0.05", "--keep", tmp_path / "kept")
    assert answer.code == 2
    assert "the folder cannot be written: [Errno 2] No such file or directory" in answer.err


@pytest.mark.parametrize(
    ("body", "code", "said"),
    [
        ("raise RuntimeError('no licence')", 2, "the code raised RuntimeError when it was imported: no licence"),
        ("x = 1", 2, "the module holds no class that derives from Profiler"),
        (
            broken("def __init__(self):\n    raise ValueError('no port')"),
            2,
            "the code raised ValueError when it was made: no port",
        ),
        (broken("def __init__(self):\n    pass"), 2, "the plugin has no name"),
        (broken("def check(self, circumstances):\n    return 1 / 0"), 2, "the check raised ZeroDivisionError"),
        (broken("def start_run(self, a, b):\n    pass"), 2, "start_run(a, b) cannot be called with a context"),
        (
            broken("def start_measurement(self, context):\n    raise OSError('unplugged')"),
            1,
            "failed: start_measurement of Meter: OSError: unplugged",
        ),
        (
            broken("def populate_run_data(self, context):\n    context.publish('Powr', 1.0)"),
            1,
            "measure 'Powr' was not declared",
        ),
        (
            broken("def populate_run_data(self, context):\n    context.publish('Power', float('nan'))"),
            1,
            "Power  refused: nan",
        ),
        (broken("def start_run(self):\n    import os; os._exit(3)"), 1, "failed: start_run"),
        (broken("def start_run(self):\n    pass"), 1, "Power  never published"),
        (broken("def start_measurment(self, context):\n    pass"), 1, "Did you mean 'start_measurement'?"),
    ],
    ids=lambda value: None if isinstance(value, int) else value.splitlines()[-1].strip()[:40],
)
def test_a_strangers_broken_profiler_is_told_clearly(
    robot_runner: Callable, plugin: Callable, body: str, code: int, said: str
) -> None:
    answer = robot_runner("try", plugin(body), "--seconds", "0.05")
    assert answer.code == code, answer.err
    assert said in answer.out + answer.err
    assert "fault of Robot Runner" not in answer.err


def test_a_slip_in_the_name_of_a_callback_is_told_once(robot_runner: Callable, plugin: Callable) -> None:
    slip = plugin(broken("def start_measurment(self, context):\n    pass"))
    found = robot_runner("try", slip, "--seconds", "0.1", "--json").json["findings"]
    assert [each["fix"] for each in found if "start_measurment" in each["where"]] == [
        "Did you mean 'start_measurement'? Otherwise begin the name with '_'."
    ]


def test_the_traceback_of_a_strangers_callback_is_shown(robot_runner: Callable, plugin: Callable) -> None:
    answer = robot_runner("try", plugin(broken("def start_run(self):\n    1 / 0")), "--seconds", "0.05")
    assert "stranger.py" in answer.out
    assert "ZeroDivisionError" in answer.out


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["PsUtl"], "Did you mean 'PsUtil'?"),
        (["PsUtil", "--set", "hst=localhost"], "Did you mean 'host'?"),
        (["PsUtil", "--set", "host"], "'host' is not an assignment"),
        (["PsUtil", "--seconds", "0"], "--seconds is 0"),
        (["PsUtil", "--seconds", "nan"], "--seconds is nan"),
        (["nowhere.py"], "there is no such file"),
        (["no_such_module:Meter"], "the code raised ModuleNotFoundError when it was imported"),
        (["robot_runner.core.errors:Finding"], "Finding is not a plugin"),
        (["robot_runner.meters.psutil:PsUtl"], "Did you mean 'PsUtil'?"),
        (["BasicTurtlebot"], "Did you mean 'BasicTurtlebot3'?"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_words_that_make_no_sense_are_refused(robot_runner: Callable, words: list[str], said: str) -> None:
    answer = robot_runner("try", *words)
    assert answer.code == 2
    assert said in answer.err


def test_a_file_with_two_profilers_wants_one_named(robot_runner: Callable, plugin: Callable) -> None:
    path = plugin(GOOD + "\n\nclass Other(Meter):\n    pass\n")
    assert f"Name one: {path}:Meter." in robot_runner("try", path).err
    assert robot_runner("try", f"{path}:Other", "--seconds", "0.05").code == 0


def test_raw_data_are_not_kept_over_something_else(robot_runner: Callable, plugin: Callable, tmp_path: Path) -> None:
    answer = robot_runner("try", plugin(GOOD), "--keep", tmp_path)
    assert answer.code == 2
    assert "the folder to keep is there already" in answer.err


@pytest.mark.long
def test_a_profiler_that_hangs_is_ended(
    robot_runner: Callable, plugin: Callable, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(trial, "_PATIENCE", 0.5)
    monkeypatch.setattr(trial, "_GRACE", 0.5)
    enforce_deadline_in("start_measurement", monkeypatch)
    path = plugin(broken("def start_measurement(self):\n    while True:\n        pass"))
    answer = robot_runner("try", path, "--seconds", "0.1")
    assert answer.code == 1
    assert "failed: start_measurement" in answer.out


def test_a_plugin_that_needs_a_parameter_says_which_and_how_to_set_it(robot_runner: Callable) -> None:
    answer = robot_runner("try", "CodeCarbon")
    assert answer.code == 2
    assert "CodeCarbon: the plugin cannot be built without country" in answer.err
    assert "Add --set country=..." in answer.err
    assert "author" not in answer.err


@pytest.mark.parametrize(
    ("answers", "topics"), [("/plan", ("/scan", "/plan")), ("['/plan', '/cmd_vel']", ("/scan", "/plan", "/cmd_vel"))]
)
def test_a_parameter_of_any_number_of_values_takes_one_or_a_list(answers: str, topics: tuple[str, ...]) -> None:
    plugin, _ = trial.make_plugin("TopicLatency", {"answers": answers, "cause": "/scan", "timeout_s": "2"})
    assert isinstance(plugin, TopicLatency)
    assert (plugin.topics, plugin.timeout_s) == (topics, 2)


SYSTEM = """\
from robot_runner.plugins import Measure, System


class Arm(System):
    measures = (Measure("Lifts", "1", "How often it lifted."),)

    def __init__(self, *, name=None):
        super().__init__(name=name)
        self.lifts = 0

    def launch_mission(self, context):
        self.lifts += context.combination["Lifts_wanted"]

    def populate_run_data(self, context):
        context.publish("Lifts", float(self.lifts))
"""


def test_a_system_is_tried_with_its_own_mission_and_with_treatments(robot_runner: Callable, plugin: Callable) -> None:
    plugin(SYSTEM, "arm.py")
    began = time.monotonic()
    answer = robot_runner("try", "arm.py", "--factor", "Lifts_wanted=3", "--json")
    assert answer.code == 0, answer.err
    assert answer.json["measures"]["Lifts"]["value"] == 3.0
    assert time.monotonic() - began < 60.0  # it does not wait for the longest mission


@pytest.mark.long
def test_an_installed_system_is_tried_on_the_embedded_robot_and_asked_for_on_a_real_one(robot_runner: Callable) -> None:
    words = ("try", "BasicTurtlebot3", "--factor", "Task=Video")
    answer = robot_runner(*words, "--set", "robot=simulated", "--json")
    assert answer.code == 0, answer.err
    assert answer.json["measures"]["Duration"]["value"] == pytest.approx(95.0, abs=2.0)
    refused = robot_runner(*words, "--set", "robot=ros1")
    assert refused.code == 2
    assert "the plugin operates the robot 'ros1', which may move" in refused.err
    assert "--yes" in refused.err


def test_no_package_can_take_the_name_of_a_plugin_of_ours(monkeypatch: pytest.MonkeyPatch) -> None:
    strangers = EntryPoint("PsUtil", "robot_runner.profilers", "stranger:Meter", lambda: ("stranger", "2.1"))
    monkeypatch.setattr(trial, "installed_plugins", lambda: (*installed_plugins(), strangers))
    assert trial.plugin_class("PsUtil").__name__ == "PsUtil"
