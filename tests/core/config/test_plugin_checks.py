"""Plugins with parameters bound to factors: what is refused before anything is executed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from robot_runner.cli.planning import plan_of
from robot_runner.core.config.preparation import prepare, prepare_or_refuse
from robot_runner.core.storage.input_files import InputFile
from robot_runner.plugins.profilers import PsUtil

if TYPE_CHECKING:
    from robot_runner.core.errors import Finding

Write = Callable[..., Path]

HEAD = """\
from robot_runner import *
from robot_runner.plugins import Circumstances, Finding, Measure, PluginError, Profiler
from robot_runner.plugins.systems import BasicTurtlebot3


class Meter(Profiler):
    asked = []

    def __init__(self, *, cores=1, rate=1.0, port="", name=None):
        super().__init__(name=name or ("Quick" if rate > 100 else None))
        self.measures = tuple(Measure(f"CPU_{core}", "%", "One core.") for core in range(cores))
        self.rate, self.port = rate, port

    def check(self, circumstances):
        self.asked.append(self.rate)
        if self.rate <= 0:
            yield Finding.error(f"plugin {self.name}", f"a rate of {self.rate} Hz", "Give more.")
        if self.rate == 13:
            raise RuntimeError("thirteen")
        if self.rate > 50:
            yield Finding.warning(f"plugin {self.name}", "a high rate", "Give less.")


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "trial"
    results_output_path = "results"
    robot = "simulated"
"""


def table(*factors: str, more: str = "") -> str:
    return f"    def create_run_table(self):\n        return RunTableModel([{', '.join(factors)}]{more})\n"


SPEEDS = table("Factor('Speed', [0.05, 0.2, 0.5])")
RATES = table("Factor('Rate', [1.0, 2.0])")


def found(write: Write, plugin: str, factors: str) -> tuple[Finding, ...]:
    return prepare(write(f"plugins = [{plugin}]", head=HEAD, table=factors)).findings


def test_a_treatment_that_the_plugin_does_not_take_is_refused_with_factor_and_treatment(write_config: Write) -> None:
    (finding,) = found(write_config, "BasicTurtlebot3(speed=treatment('Speed'), task='Video')", SPEEDS)
    assert finding.is_error
    assert finding.where == "BasicTurtlebot3(speed=treatment('Speed'))"
    assert finding.problem.startswith("with Speed = 0.5: ")
    assert finding.fix == "Give a speed of at most 0.22 m/s."


def test_a_factor_that_there_is_not_is_refused_with_the_nearest(write_config: Write) -> None:
    (finding,) = found(write_config, "BasicTurtlebot3(speed=treatment('Sped'), task='Video')", SPEEDS)
    assert finding.where == "BasicTurtlebot3(speed=treatment('Sped'))"
    assert finding.problem == "the run table has no factor 'Sped'"
    assert finding.fix == "Did you mean 'Speed'?"


def test_excluded_combinations_are_not_tried(write_config: Write) -> None:
    factors = table(
        "Factor('Task', ['Video', 'Network']), Factor('Speed', [0.2, 0.5])", more=", [{'Speed': 0.5}], repetitions=3"
    )
    assert found(write_config, "BasicTurtlebot3(speed=treatment('Speed'))", factors) == ()


def test_a_task_can_be_bound_like_any_parameter(write_config: Write) -> None:
    for factor in ("Task", "Load"):
        tasks = table(f"Factor('{factor}', ['Video', 'Network'])")
        assert found(write_config, f"BasicTurtlebot3(task=treatment('{factor}'))", tasks) == ()
    wrong = table("Factor('Load', ['Video', 'Netwrk'])")
    (finding,) = found(write_config, "BasicTurtlebot3(task=treatment('Load'))", wrong)
    assert finding.problem == "with Load = Netwrk: 'Netwrk' is not a task of the robot"


def test_the_check_is_asked_once_with_each_treatment(write_config: Write) -> None:
    factors = table("Factor('Rate', [60.0, 1.0, -2.0, 13.0])", more=", repetitions=2")
    findings = found(write_config, "Meter(rate=treatment('Rate'))", factors)
    assert {(each.is_error, each.problem) for each in findings} == {
        (True, "with Rate = -2.0: a rate of -2.0 Hz"),
        (True, "with Rate = 13.0: the check raised RuntimeError: thirteen"),
        (False, "with Rate = 60.0: a high rate"),
    }


def test_what_is_found_with_all_treatments_is_said_once_and_plainly(write_config: Write) -> None:
    (finding,) = found(write_config, "Meter(rate=treatment('Rate'))", table("Factor('Rate', [60.0, 70.0])"))
    assert finding.problem == "a high rate"


def test_measures_must_be_the_same_in_all_runs(write_config: Write) -> None:
    (finding,) = found(write_config, "Meter(cores=treatment('Cores'))", table("Factor('Cores', [1, 2])"))
    assert finding.is_error
    assert finding.where == "plugin Meter, bound to 'Cores'"
    assert finding.problem == "the measures of the plugin depend on a bound parameter: CPU_0 % and CPU_0 %, CPU_1 %"


def test_a_name_must_not_follow_from_a_treatment(write_config: Write) -> None:
    (finding, *_) = found(write_config, "Meter(rate=treatment('Rate'))", table("Factor('Rate', [1.0, 200.0])"))
    assert finding.is_error
    assert finding.problem == "the plugin is named 'Meter' and 'Quick' under two treatments"


def test_plugins_that_clash_under_one_treatment_alone_are_found(write_config: Write) -> None:
    plugins = (
        "BasicTurtlebot3(name='A', task='Video', namespace=treatment('Robot')), "
        "BasicTurtlebot3(name='B', task='Video', namespace='/alice')"
    )
    findings = found(write_config, plugins, table("Factor('Robot', ['/bob', '/alice'])"))
    assert [finding.problem for finding in findings if "operates the robot" in finding.problem] == [
        "with Robot = /alice: the plugin operates the robot of the namespace '/alice', and so does 'B'"
    ]


def test_combinations_of_all_bound_factors_are_tried_and_no_others(write_config: Write) -> None:
    factors = table("Factor('Rate', [1.0, 2.0])", "Factor('Port', ['a', 'b'])", "Factor('Other', range(50))")
    config = write_config("plugins = [Meter(rate=treatment('Rate'), port=treatment('Port'))]", head=HEAD, table=factors)
    experiment = prepare_or_refuse(config)
    assert experiment.plugins[0].asked == [1.0, 1.0, 2.0, 2.0]  # type: ignore[attr-defined]


def test_of_very_many_combinations_each_treatment_is_tried(write_config: Write) -> None:
    factors = table("Factor('Rate', [float(each) for each in range(14, 50)])", "Factor('Port', list('abcdefghijkl'))")
    config = write_config("plugins = [Meter(rate=treatment('Rate'), port=treatment('Port'))]", head=HEAD, table=factors)
    asked = prepare_or_refuse(config).plugins[0].asked  # type: ignore[attr-defined]
    assert set(asked) == {float(each) for each in range(14, 50)}
    assert 256 <= len(asked) < 300 < 36 * 12


def test_all_other_findings_come_with_it(write_config: Write) -> None:
    body = "attempts = 0\nplugins = [BasicTurtlebot3(speed=treatment('Sped'), task='Video'), 7]"
    problems = [each.problem for each in prepare(write_config(body, head=HEAD, table=SPEEDS)).findings]
    assert any("no factor 'Sped'" in each for each in problems)
    assert any("7 is not a plugin" in each for each in problems)
    assert any("the value is 0" in each for each in problems)


def test_without_a_run_table_nothing_is_said_of_factors(write_config: Write) -> None:
    broken = "    def create_run_table(self):\n        return None\n"
    (finding,) = found(write_config, "BasicTurtlebot3(speed=treatment('Speed'), task='Video')", broken)
    assert finding.where.endswith(".create_run_table")


def test_a_treatment_inside_a_set_is_refused_at_its_line(write_config: Write) -> None:
    (finding,) = found(write_config, "Meter(port={'a', treatment('Port')})", RATES)
    assert "config.py:" in finding.where
    assert finding.problem == "port holds a treatment(...) inside a set"


def test_a_class_that_takes_no_part_in_being_built_is_found(write_config: Write) -> None:
    own = HEAD.replace("    asked = []\n", "    asked = []\n    def __new__(cls, **_): return object.__new__(cls)\n")
    config = write_config("plugins = [Meter(port=treatment('Port'))]", head=own, table=RATES)
    (finding,) = prepare(config).findings
    assert finding.where == "Meter.port"
    assert finding.problem == "treatment('Port') was taken for a value"


def test_attributes_of_a_plugin_that_waits_are_told_to_come_later(write_config: Write) -> None:
    body = """
    def __init__(self):
        self.meter = Meter(rate=treatment("Rate"))
        print(self.meter.rate)
    """
    (finding,) = prepare(write_config(body, head=HEAD, table=RATES)).findings
    assert "is built once the run table is made" in finding.fix


def test_a_parameter_that_is_set_while_the_config_is_loaded_is_refused(write_config: Write) -> None:
    body = """
    def __init__(self):
        self.turtle = BasicTurtlebot3(task="Video")
        self.turtle.speed = 0.05
        self.plugins = [self.turtle]
    """
    (finding,) = prepare(write_config(body, head=HEAD, table=RATES)).findings
    assert finding.problem == "speed is a parameter of BasicTurtlebot3: changing it has no effect once it is built"
    assert "BasicTurtlebot3(speed=0.05)" in finding.fix
    assert "config.py:" in finding.where


def test_an_import_line_does_not_add_a_plugin_that_is_listed_with_a_bound_parameter(write_config: Write) -> None:
    head = "import plugins.systems.BasicTurtlebot3\n" + HEAD
    body = "plugins = [BasicTurtlebot3(task=treatment('Load'))]"
    config = write_config(body, head=head, table=table("Factor('Load', ['Video', 'Network'])"))
    (plugin,) = prepare_or_refuse(config).plugins
    assert plugin.task == "Video"  # type: ignore[attr-defined]


def test_columns_can_be_planned_before_there_is_a_run(write_config: Write) -> None:
    config = write_config("plugins = [Meter(rate=treatment('Rate'))]", head=HEAD, table=RATES)
    assert prepare_or_refuse(config).columns.names == ("CPU_0",)
    assert plan_of(config, {}).columns.names == ("CPU_0",)


def test_room_on_the_disk_is_asked_for_the_treatment_that_needs_most(write_config: Write) -> None:
    head = f"from robot_runner.plugins.profilers import PsUtil\n{HEAD}"
    config = write_config("plugins = [PsUtil(rate_hz=treatment('Rate'))]", head=head, table=RATES)
    (plugin,) = prepare_or_refuse(config).plugins
    assert plugin.bytes_per_run == PsUtil(rate_hz=2.0).bytes_per_run > PsUtil(rate_hz=1.0).bytes_per_run


@pytest.mark.parametrize("factor", ["'Rate'", "'rate'"])
def test_factors_are_named_exactly(write_config: Write, factor: str) -> None:
    findings = found(write_config, f"Meter(rate=treatment({factor}))", RATES)
    assert bool(findings) == (factor == "'rate'")


@pytest.mark.parametrize(
    ("measures", "problem"),
    [
        ("['Energy']", "measures: 'Energy' is not of type Measure"),
        ("Measure('Energy')", "measures: 'Measure' object is not iterable"),
        ("None", "measures: 'NoneType' object is not iterable"),
        ("property(lambda self: 1 / 0)", "measures: ZeroDivisionError: division by zero"),
        ("[Measure('Energy', 'J'), Measure('Energy', 'J')]", "there are 2 measures 'Energy'"),
        ("[Measure(7)]", "the name is of type int"),
        ("[Measure('Power\\nMean')]", "the name holds '\\n', which no heading can hold"),
        ("[Measure('run_id')]", "the run table has a column of that name already"),
        ("[Measure('Task')]", "two columns are called 'Task'"),
        ("[Measure('Repetition')]", "two columns are called 'Repetition'"),
    ],
)
def test_measures_of_a_plugin_that_cannot_be_columns_are_refused(
    write_config: Write, measures: str, problem: str
) -> None:
    head = (
        "from robot_runner import *\nfrom robot_runner.plugins import Measure, Profiler\n\n\n"
        f"class Meter(Profiler):\n    measures = {measures}\n\n\n"
        "class RobotRunnerConfig(ExperimentConfig):\n    experiment_name = 'x'\n    plugins = [Meter()]\n"
    )
    rows = table("Factor('Task', ['Video'])", more=", repetitions=2")
    (finding,) = prepare(write_config(head=head, table=rows)).findings
    assert finding.is_error
    assert finding.problem == problem


@pytest.mark.parametrize(
    ("line", "problem"),
    [
        ("async def make_safe(self, context): pass", "make_safe is async: its body would never be executed"),
        (
            "def make_safe(self, context): yield",
            "make_safe is a generator, as it has a yield: its body would never be ",
        ),
        ("def make_safe(self): pass", "make_safe() cannot be called with a context"),
        ("def make_safe(self, context, how): pass", "make_safe(context, how) cannot be called with a context"),
        ("make_safe = None", "make_safe is None, which cannot be called"),
        ("async def stand_by(self, context): pass", "stand_by is async: its body would never be executed"),
    ],
)
def test_a_system_that_would_not_stop_its_robot_is_refused(write_config: Write, line: str, problem: str) -> None:
    head = (
        "from robot_runner import *\nfrom robot_runner.plugins import System\n\n\n"
        f"class Rover(System):\n    {line}\n\n\n"
        "class RobotRunnerConfig(ExperimentConfig):\n    experiment_name = 'x'\n    plugins = [Rover()]\n"
    )
    (finding,) = prepare(write_config(head=head)).findings
    assert finding.problem.startswith(problem)
    assert finding.where.startswith("Rover")
    assert "make_safe" in finding.fix or "plain def" in finding.fix or "yield" in finding.fix


@pytest.mark.parametrize(
    ("lines", "problem"),
    [
        ("bytes_per_run = '1 MB'", "bytes_per_run is '1 MB', of type str"),
        ("bytes_per_run = float('nan')", "bytes_per_run is nan, of type float"),
        ("bytes_per_run = None", "bytes_per_run is None, of type NoneType"),
        ("smoke_parameters = ['task_s']", "smoke_parameters is ['task_s'], of type list"),
        (
            "def check(self, circumstances): return ['the port is busy']",
            "the check raised TypeError: 'the port is busy' ",
        ),
        (
            "def claims(self, robot): self.asked = robot",
            "claims raised TypeError: 'NoneType' ",
        ),
    ],
)
def test_what_a_plugin_says_of_itself_in_a_wrong_type_is_a_finding(
    write_config: Write, lines: str, problem: str
) -> None:
    head = (
        "from robot_runner import *\nfrom robot_runner.plugins import Profiler\n\n\n"
        f"class Meter(Profiler):\n    {lines}\n\n\n"
        "class RobotRunnerConfig(ExperimentConfig):\n    experiment_name = 'x'\n    plugins = [Meter()]\n"
    )
    (finding,) = prepare(write_config(head=head)).findings
    assert finding.is_error
    assert finding.problem.startswith(problem)
    assert "Meter" in finding.where


@pytest.mark.parametrize(
    ("named", "inputs"),
    [("['map.yaml']", ("map.yaml",)), ("'map.yaml'", ("map.yaml",)), ("[5]", ())],
    ids=["in a list", "alone", "a number"],
)
def test_a_path_stands_for_the_input_file_and_what_is_none_is_left_out(
    write_config: Write, named: str, inputs: tuple[str, ...]
) -> None:
    head = (
        "from robot_runner import *\nfrom robot_runner.plugins import InputFile, Profiler\n\n\nclass Meter(Profiler):\n"
        f"    def input_files(self): return {named}\n\n\n"
        "class RobotRunnerConfig(ExperimentConfig):\n    experiment_name = 'x'\n    plugins = [Meter()]\n"
    )
    experiment = prepare(write_config(head=head)).experiment
    assert experiment is not None
    assert experiment.inputs == tuple(map(InputFile, map(Path, inputs)))


NAMELESS = """\
from dataclasses import dataclass

from robot_runner import *
from robot_runner.plugins import Profiler


class Meter(Profiler):
    def __init__(self, *, gain=1.0):
        self.gain = gain  # and no super().__init__()


@dataclass
class Named(Profiler):
    gain: float = 1.0
    name: str = "../Meter"


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "x"
    plugins = [{}]
"""


@pytest.mark.parametrize(
    ("plugin", "where", "problem"),
    [
        ("Meter()", "Meter", "the plugin has no name"),
        ("Meter(gain=treatment('Gain'))", "Meter", "with Gain = 2.0: the plugin has no name"),
        ("Named()", "Named", "a plugin cannot be named '../Meter'"),
        ("Named(name='operator')", "Named", "a plugin cannot be named 'operator'"),
    ],
)
def test_a_plugin_whose_init_leaves_out_that_of_its_base_is_a_finding(
    write_config: Write, plugin: str, where: str, problem: str
) -> None:
    gains = table("Factor('Gain', [2.0])")
    findings = prepare(write_config(head=NAMELESS.format(plugin), table=gains)).findings
    (finding,) = [each for each in findings if each.is_error]
    assert (finding.where, finding.problem) == (where, problem)
    taken = "letters, digits, '_' and '-' (64 at most); 'config', 'log', 'operator' and 'robots' are taken"
    assert "super().__init__(name=name)" in finding.fix or taken in finding.fix


MISSPELT = """\
from robot_runner import *
from robot_runner.plugins import PolledProfiler, System


class Arm(System):
    def start_run(self, context): self.reset_arm()
    {}


class Meter(PolledProfiler):
    def open(self, context): ...
    {}


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "x"
    probe = False
    plugins = [Arm(), Arm(name="other"), Meter(rate_hz=treatment('Rate'))]
"""


@pytest.mark.parametrize(
    ("of_arm", "of_meter", "where", "meant"),
    [
        ("def stop_runs(self, context): ...", "", "Arm.stop_runs", "stop_run"),
        ("def make_save(self, context): ...", "", "Arm.make_save", "make_safe"),
        ("", "def start_measurment(self, context): ...", "Meter.start_measurment", "start_measurement"),
        ("", "def column(self, sampling): ...", "Meter.column", "columns"),
    ],
)
def test_a_method_of_a_plugin_that_is_nearly_called_like_one_of_ours_is_a_warning(
    write_config: Write, of_arm: str, of_meter: str, where: str, meant: str
) -> None:
    config = write_config(head=MISSPELT.format(of_arm, of_meter), table=RATES)
    (finding,) = [each for each in prepare(config).findings if each.where == where]
    assert not finding.is_error
    assert finding.problem == "nothing calls this method of the plugin"
    assert finding.fix == f"Did you mean {meant!r}? Otherwise begin the name with '_'."


@pytest.mark.parametrize(
    "of_arm",
    [
        "def reset_arm(self): ...",
        "def stop_runs(self): ...\n    def stop_run(self, context): ...",
        "def stop_runs(self): ...\n    def launch_mission(self, context): (lambda: self.stop_runs())()",
        "def _stop_runs(self): ...",
        "stop_runs = 3",
    ],
)
def test_a_method_of_a_plugin_that_is_called_or_not_like_one_of_ours_is_none_to_warn_of(
    write_config: Write, of_arm: str
) -> None:
    config = write_config(head=MISSPELT.format(of_arm, "gain = 1.0"), table=RATES)
    assert not [each for each in prepare(config).findings if each.where.startswith(("Arm.", "Meter."))]


def test_a_check_of_a_plugin_that_ends_the_program_is_told_like_one_that_raises(write_config: Write) -> None:
    of_meter = "def check(self, circumstances): raise SystemExit(3)"
    config = write_config(head=MISSPELT.format("gain = 1.0", of_meter), table=RATES)
    assert any(each.problem == "the check raised SystemExit: 3" for each in prepare(config).findings)


def test_a_text_where_a_plugin_takes_true_or_false_is_refused_as_any_text_would_be_true(write_config: Write) -> None:
    (finding,) = found(write_config, "BasicTurtlebot3(task='Video', sole_control='no')", SPEEDS)
    assert (finding.where, finding.problem) == ("BasicTurtlebot3", "sole_control is 'no', of type str")
    assert finding.fix == "Give True or False."
    bound = "BasicTurtlebot3(task='Video', sole_control=treatment('Control'))"
    findings = found(write_config, bound, table("Factor('Control', ['sole', 'shared'])"))
    assert [each.problem for each in findings] == [
        "with Control = sole: sole_control is 'sole', of type str",
        "with Control = shared: sole_control is 'shared', of type str",
    ]
    assert found(write_config, bound, table("Factor('Control', [True, False])")) == ()


@pytest.mark.parametrize("given", ["namespace=5", "namespace=treatment('Number')"])
def test_a_check_that_raises_for_an_argument_of_another_type_tells_of_that_and_blames_nobody(
    write_config: Write, given: str
) -> None:
    findings = found(write_config, f"BasicTurtlebot3(task='Video', {given})", table("Factor('Number', [5])"))
    told = {(each.where, each.problem.removeprefix("with Number = 5: "), each.fix) for each in findings}
    assert told == {("BasicTurtlebot3", "namespace is 5, of type int", "Give a text.")}
