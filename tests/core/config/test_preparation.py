from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from robot_runner.core.config.checks import read_parameters
from robot_runner.core.config.loader import load_config
from robot_runner.core.config.parameters import PARAMETERS, OperationType, Parameter
from robot_runner.core.config.preparation import prepare
from robot_runner.core.design.factor import Factor
from robot_runner.core.design.run_table_model import RunTableModel

if TYPE_CHECKING:
    from robot_runner.core.errors import Finding

Write = Callable[..., Path]


def findings_of(path: Path, **overrides: str) -> tuple[Finding, ...]:
    before = sorted(path.parent.rglob("*"))
    preparation = prepare(path, overrides)
    assert [each for each in sorted(path.parent.rglob("*")) if "__pycache__" not in each.parts] == [
        each for each in before if "__pycache__" not in each.parts
    ]
    assert (preparation.experiment is None) == any(finding.is_error for finding in preparation.findings)
    assert all(finding.where and finding.problem and finding.fix for finding in preparation.findings)
    return preparation.findings


def test_a_well_formed_config_has_no_findings(write_config: Write) -> None:
    assert findings_of(write_config()) == ()


@pytest.mark.parametrize("name", [" x ", "-x", ".x", "x."])
def test_a_name_of_allowed_characters_is_told_where_they_may_stand(write_config: Write, name: str) -> None:
    (finding,) = [each for each in prepare(write_config(), {"experiment_name": name}).findings if each.is_error]
    assert "letters a to z, digits, and between them blanks, '.', '_' and '-'" in finding.fix


def test_a_config_need_not_derive_from_ours(write_config: Write) -> None:
    head = "from robot_runner import *\nclass RobotRunnerConfig:\n    experiment_name = 'plain'\n"
    experiment = prepare(write_config(head=head)).experiment
    assert experiment is not None
    assert experiment.parameters.operation_type is OperationType.AUTO


def test_a_contrast_of_a_treatment_that_no_run_has_is_refused_with_the_nearest(tmp_path: Path) -> None:
    path = tmp_path / "study.py"
    path.write_text("""
from robot_runner import *
class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "contrasts"
    analysis = AnalysisPlan(hypotheses=[
        Hypothesis("Tasks differ.", measure="E", factors="Task", contrast={"Vido": 1, "Idle": -1}),
        Hypothesis("Speeds differ.", measure="E", factors="Speed", contrast={0.1: 1, 0.2: -1}),
    ])
    def create_run_table(self):
        return RunTableModel([Factor("Task", ["Video", "Idle"]), Factor("Speed", [0.1, 0.2])], data_columns=["E"])
""")
    (finding,) = findings_of(path)
    assert finding.problem == "'Vido', in the contrast, is not a treatment of 'Task'"
    assert "Did you mean 'Video'?" in finding.fix


def test_a_bound_that_leaves_open_which_treatments_are_alike_is_warned_of(tmp_path: Path) -> None:
    path = tmp_path / "study.py"
    path.write_text("""
from robot_runner import *
class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "bounds"
    analysis = AnalysisPlan(hypotheses=[
        Hypothesis("Speeds cost alike.", measure="E", factors="Speed", within=5),
        Hypothesis("Tasks cost alike.", measure="E", factors="Task", within=5),
    ])
    def create_run_table(self):
        factors = [Factor("Task", ["Video", "Idle"]), Factor("Speed", [0.1, 0.2, 0.3])]
        return RunTableModel(factors, data_columns=["E"])
""")
    (finding,) = findings_of(path)
    assert finding.problem == "the bound is of two treatments, and 'Speed' has 3, so that it cannot be tested"
    assert finding.fix == "Name two, as in contrast={'0.1': 1, '0.3': -1}."


@pytest.mark.parametrize(
    "design",
    ['design=Crossover(unit="Person", period="Turn")', 'blocks="Turn", shuffle=True', "repetitions=2"],
    ids=["of a design", "of the order", "of the plan"],
)
def test_a_hypothesis_about_blocks_is_told_to_be_tested_by_nothing(tmp_path: Path, design: str) -> None:
    path = tmp_path / "study.py"
    path.write_text(f"""
from robot_runner import *
from robot_runner.designs import Crossover
class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "turns"
    analysis = AnalysisPlan(blocks={'"Turn"' if "rep" in design else None}, hypotheses=[
        Hypothesis("Later is better.", measure="E", factors="Turn"),
        Hypothesis("Tasks differ.", measure="E", factors="Task"),
    ])
    def create_run_table(self):
        factors = [Factor("Person", range(6)), Factor("Turn", [1, 2]), Factor("Task", ["Video", "Idle"])]
        return RunTableModel(factors, data_columns=["E"], {design})
""")
    (finding,) = findings_of(path)
    assert not finding.is_error
    assert finding.where == "analysis, hypothesis 'Later is better.'"
    assert finding.problem.startswith("Turn is a block")


def test_python_warns_of_a_line_of_a_config_once_where_it_is_executed(write_config: Write) -> None:
    path = write_config(r"_pattern = '\d+'")
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        assert findings_of(path) == ()
    assert [Path(each.filename) for each in told if "invalid escape" in str(each.message)] == [path]


def test_files_that_stand_in_for_modules_of_python_are_told(write_config: Write) -> None:
    path = write_config()
    for name in ("random.py", "my_statistics.py", "queue/__init__.py", "test/__init__.py", "types/notes.txt"):
        (path.parent / name).parent.mkdir(exist_ok=True)
        (path.parent / name).touch()
    told = findings_of(path)
    assert [Path(each.where).name for each in told] == ["queue", "random.py"]
    assert "Python's own module 'random'" in told[1].problem
    assert "my_random.py" in told[1].fix


@pytest.mark.parametrize(
    "value", ["'~nobody-of-this-name/x'", "'loop/x'", repr("a/" * 2500)], ids=["nobody", "loop", "too long"]
)
def test_a_results_path_at_which_no_folder_can_lie_is_a_finding(write_config: Write, value: str) -> None:
    path = write_config(f"results_output_path = {value}")
    (path.parent / "loop").symlink_to(path.parent / "loop")
    found = [each for each in findings_of(path) if each.is_error]
    told = [each.problem for each in found if each.where.endswith("results_output_path")]
    assert [problem[:21] for problem in told] == ["no folder can lie at "]
    assert len(told[0]) < 200


WRONG_VALUES = [
    ("experiment_name", "''"),
    ("experiment_name", "'../outside'"),
    ("experiment_name", "7"),
    ("results_output_path", "7"),
    ("results_output_path", "''"),
    ("operation_type", "'auto'"),
    ("time_between_runs_in_ms", "True"),
    ("time_between_runs_in_ms", "-1"),
    ("time_between_runs_in_ms", "1.5"),
    ("robot", "7"),
    ("required_ros_version", "True"),
    ("required_ros_version", "3"),
    ("required_ros_version", "'one'"),
    ("required_ros_distro", "7"),
    ("on_failure", "'stop'"),
    ("attempts", "0"),
    ("run_deadline_in_s", "0"),
    ("event_deadline_in_s", "float('inf')"),
    ("grace_in_s", "-1"),
    ("run_process", "'fork'"),
]


def test_a_journal_that_cannot_be_read_keeps_no_factor_from_being_known(write_config: Write, tmp_path: Path) -> None:
    steps = "operator_steps = [OperatorStep('lay the floor', when_changes='Task')]"
    path = write_config(f"results_output_path = {str(tmp_path)!r}\n{steps}")
    experiment = prepare(path).experiment
    assert experiment is not None
    experiment.folder.journal.mkdir(parents=True)
    problems = [finding.problem for finding in findings_of(path)]
    assert problems
    assert not any("no factor" in problem for problem in problems), problems


@pytest.mark.parametrize(("name", "value"), WRONG_VALUES)
def test_a_malformed_parameter_is_refused_with_its_value_and_what_it_must_be(
    write_config: Write, name: str, value: str
) -> None:
    findings = findings_of(write_config(f"{name} = {value}"))
    (finding,) = [each for each in findings if each.where.endswith(f".{name}")]
    assert finding.is_error
    assert repr(eval(value)) in finding.problem  # noqa: S307 - from the table above
    assert finding.fix.startswith("It must be ")


def test_all_malformed_parameters_are_found_at_once(write_config: Write) -> None:
    values = dict(WRONG_VALUES)
    findings = findings_of(write_config("\n".join(f"{name} = {value}" for name, value in values.items())))
    assert {finding.where.rpartition(".")[2] for finding in findings} == set(values)


@pytest.mark.parametrize("parameter", PARAMETERS.values(), ids=lambda parameter: parameter.name)
def test_every_parameter_accepts_its_default(parameter: Parameter) -> None:
    assert parameter.default is not None or parameter.kind.accepts(None)
    if parameter.name != "experiment_name":
        assert parameter.kind.accepts(parameter.default)


@pytest.mark.parametrize("value", ["1", "2", "None", "any", "'any'"])
def test_the_ros_version_can_be_a_generation_none_or_any(write_config: Write, value: str) -> None:
    assert findings_of(write_config(f"required_ros_version = {value}"), robot="simulated") == ()


def test_a_missing_name_is_refused(write_config: Write) -> None:
    head = "from robot_runner import *\nclass RobotRunnerConfig:\n    pass\n"
    assert "missing" in findings_of(write_config(head=head))[0].problem


@pytest.mark.parametrize(
    ("body", "meant"),
    [
        ("experiment_nam = 'x'", "experiment_name"),
        ("time_betwen_runs_in_ms = 5", "time_between_runs_in_ms"),
        ("opertion_type: int", "operation_type"),
        ("plugin = []", "plugins"),
        ("def lunch_mission(self, context): pass", "launch_mission"),
        ("def populate_rundata(self): pass", "populate_run_data"),
        ("def before_runs(self): pass", "before_run"),
    ],
)
def test_a_misspelt_name_is_refused_with_the_one_that_was_meant(write_config: Write, body: str, meant: str) -> None:
    head = "from robot_runner import *\nclass RobotRunnerConfig:\n    experiment_name = 'x'\n"
    head = head if "experiment_nam" not in body else head.replace("    experiment_name = 'x'\n", "")
    findings = findings_of(write_config(body, head=head))
    assert any(finding.is_error and repr(meant) in finding.fix for finding in findings)


@pytest.mark.skipif(sys.version_info < (3, 14), reason="Python before 3.14 evaluates annotations at once")
def test_annotations_may_name_what_is_imported_for_type_checkers_alone(write_config: Write) -> None:
    head = """
from robot_runner import *
from robot_runner.plugins import Profiler

class Own(Profiler):
    def __init__(self, speed: Speed = 3) -> None: super().__init__()
    def start_measurement(self, context: Context) -> None: ...

class RobotRunnerConfig:
    experiment_name = "x"
    plugins = [Own(speed=treatment("Task"))]
    speed: Speed
    def before_run(self, context: Context) -> None: ...
"""
    assert findings_of(write_config(head=head)) == ()
    (finding,) = findings_of(write_config("opertion_type: ForTypeCheckersAlone"))
    assert "'operation_type'" in finding.fix


def test_a_name_of_the_users_own_is_left_alone(write_config: Write) -> None:
    assert findings_of(write_config("speed = 0.1\n_launch_missions = 3\ndef drive(self): pass")) == ()


def test_callbacks_signatures_are_checked(write_config: Write) -> None:
    (finding,) = findings_of(write_config("def start_run(self, context, speed): pass"))
    assert "start_run(context, speed)" in finding.problem
    assert "config.py:" in finding.where


@pytest.mark.parametrize(
    ("plugins", "problem"),
    [
        ("PsUtil()", "the value is PsUtil(...)"),
        ("[[PsUtil()]]", "[PsUtil(...)] is not a plugin"),
        ("[PsUtil]", "PsUtil is a class"),
        ("['PsUtil']", "'PsUtil' is not a plugin"),
        ("[object()]", "the object of the class object is not a plugin"),
        ("[PsUtil(), PsUtil()]", "2 plugins are named 'PsUtil'"),
        ("[PsUtil(name='a/b')]", "a plugin cannot be named 'a/b'"),
    ],
)
def test_what_is_no_list_of_distinct_plugins_is_refused(write_config: Write, plugins: str, problem: str) -> None:
    head = f"""\
from robot_runner import *
from robot_runner.plugins.profilers import PsUtil
class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "x"
    robot = "simulated"
    plugins = {plugins}
"""
    assert any(problem in finding.problem for finding in findings_of(write_config(head=head)))


@pytest.mark.parametrize(
    ("table", "problem"),
    [
        ("", "the config does not say which runs to execute"),
        ("    def create_run_table(self): return []\n", "create_run_table returned []"),
        ("    def create_run_table(self): return 1 / 0\n", "ZeroDivisionError"),
        ("    def create_run_table(self): return RunTableModel([])\n", "factors"),
        ("    def create_run_table(self): return RunTableModel([Factor('A', [1, 1])])\n", "twice"),
        (
            "    def create_run_table(self): return RunTableModel([Factor('A', [1])], data_columns=['run_id'])\n",
            "that name already",
        ),
    ],
)
def test_a_run_table_that_cannot_be_is_refused(write_config: Write, table: str, problem: str) -> None:
    findings = findings_of(write_config(table=table))
    assert any(problem in finding.problem or problem in finding.where for finding in findings)


def test_an_unknown_robot_is_refused_with_the_nearest(write_config: Write) -> None:
    (finding,) = findings_of(write_config(), robot="simulatd")
    assert "'simulated'" in finding.fix


def test_without_ros_an_experiment_that_requires_it_is_refused_and_told_of_the_simulated_robot(
    write_config: Write, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("ROS_VERSION", raising=False)
    monkeypatch.setattr("robot_runner.ros.required_ros.installed_ros", lambda: None)
    (finding,) = findings_of(write_config("required_ros_version = 1\nrequired_ros_distro = 'melodic'"))
    assert "requires ROS 1 melodic, and no ROS is found" in finding.problem
    assert "--set robot=simulated" in finding.fix


@pytest.mark.parametrize(
    ("version", "distro", "refused"), [("1", "noetic", 1), ("2", "humble", 1), ("1", "melodic", 0)]
)
def test_the_ros_that_is_sourced_must_be_the_one_required(
    write_config: Write, monkeypatch: pytest.MonkeyPatch, version: str, distro: str, refused: int
) -> None:
    monkeypatch.setenv("ROS_VERSION", version)
    monkeypatch.setenv("ROS_DISTRO", distro)
    findings = findings_of(write_config("required_ros_version = 1\nrequired_ros_distro = 'melodic'"))
    assert len(findings) == refused


def test_a_results_path_below_a_file_is_refused(write_config: Write, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    (finding,) = findings_of(write_config("results_output_path = 'file/below'"))
    assert finding.problem == f"{tmp_path / 'file'} is not a folder"


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_an_unwritable_results_path_is_refused(write_config: Write, tmp_path: Path) -> None:
    (tmp_path / "locked").mkdir(mode=0o500)
    (finding,) = findings_of(write_config("results_output_path = 'locked'"))
    assert "cannot be written" in finding.problem


def test_findings_of_every_kind_come_together(write_config: Write) -> None:
    body = "attempts = 0\nrobot = 'simulatd'\ndef lunch_mission(self): pass\ndef stop_run(self, a, b, c): pass"
    table = "    def create_run_table(self): return RunTableModel([])\n"
    assert len(findings_of(write_config(body, table=table))) >= 4


def test_a_disk_too_small_for_what_will_be_kept_is_refused_with_both_figures(write_config: Write) -> None:
    head = """\
from robot_runner import *
from robot_runner.plugins import Profiler
class Camera(Profiler):
    bytes_per_run = 10**18
class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "x"
    plugins = [Camera()]
"""
    (finding,) = findings_of(write_config(head=head))
    assert finding.problem.startswith("4 runs will keep about 4,000,000,000,000.02 MB, and ")
    assert " MB are free in " in finding.problem


@pytest.mark.parametrize("deadline", ["run_deadline_in_s", "event_deadline_in_s"])
def test_a_deadline_that_nobody_looks_after_is_warned_of(write_config: Write, deadline: str) -> None:
    def told(process: str) -> list[str]:
        path = write_config(f"    {deadline} = 5.0\n    run_process = RunProcess.{process}\n")
        return [each.problem for each in prepare(path).findings]

    problem = f"run_process is IN_PROCESS: nothing ends a run that takes longer than {deadline}"
    assert problem in told("IN_PROCESS")
    assert problem not in told("FORK")


def test_threads_that_loading_starts_are_warned_of_where_runs_are_forked(write_config: Write) -> None:
    head = """\
import threading
from robot_runner import *
OVER = threading.Event()
threading.Thread(target=OVER.wait, name="poller", daemon=True).start()
class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "x"
"""
    path = write_config(head=head)
    try:
        (finding,) = findings_of(path)
        assert "(poller)" in finding.problem
        assert not finding.is_error
        assert findings_of(path, run_process="spawn") == ()
    finally:
        import sys

        sys.modules["robot_runner_config"].OVER.set()


def test_a_robot_whose_name_has_a_slip_is_one_finding_and_the_plugins_are_asked_about_the_one_that_was_meant(
    write_config: Write,
) -> None:
    head = (
        "from robot_runner import *\nfrom robot_runner.plugins.profilers import Ina219, PsUtil\n\n\n"
        "class RobotRunnerConfig(ExperimentConfig):\n    experiment_name = 'slip'\n    plugins = [Ina219(), PsUtil()]\n"
    )
    (finding,) = findings_of(write_config(head=head), robot="simulatd")
    assert finding.fix == "Did you mean 'simulated'?"
    (none_near,) = findings_of(write_config(head=head), robot="zzz")
    assert none_near.problem == "robot is 'zzz', which is not a link of this version"
    # What is wrong beside the slip is said all the same.
    clashing = head.replace("Ina219()", "Ina219(port='/dev/none')")
    problems = [finding.problem for finding in findings_of(write_config(head=clashing), robot="simulatd")]
    assert problems[0].startswith("robot is 'simulatd'")
    assert len(problems) == 2


@pytest.mark.parametrize(
    ("line", "fix"),
    [
        (
            "operation_type = 'semi'",
            " Write operation_type = OperationType.SEMI (from robot_runner import OperationType).",
        ),
        ("time_between_runs_in_ms = '500'", " Write time_between_runs_in_ms = 500."),
        ("operation_type = 'neither'", "OperationType.SEMI."),
    ],
)
def test_a_text_in_the_place_of_a_value_says_what_to_write(write_config: Write, line: str, fix: str) -> None:
    (finding,) = findings_of(write_config(line))
    assert finding.fix.startswith("It must be ")
    assert finding.fix.endswith(fix)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("gates", "none"),
        ("guards", "None"),
        ("operator_steps", "none"),
        ("repeat_until", "none"),
        ("phases", ""),
        ("claims", ""),
    ],
)
def test_what_a_config_lists_can_be_left_out_from_outside(write_config: Write, name: str, text: str) -> None:
    head = (
        "from robot_runner import *\nclass RobotRunnerConfig(ExperimentConfig):\n    experiment_name = 'listed'\n"
        "    gates = [Gate(temperature_below(50))]\n    guards = [Guard(battery_below(15))]\n    phases = ['dock']\n"
        "    operator_steps = [OperatorStep('swap')]\n    claims = ['device:arm']\n"
    )
    loaded = load_config(write_config(head=head), {name: text})
    parameters, findings = read_parameters(loaded)
    assert (findings, getattr(parameters, name)) == ([], ())


@pytest.mark.parametrize("name", ["results_output_path", "registration"])
def test_an_empty_path_from_outside_is_no_folder_that_happens_to_be_there(write_config: Write, name: str) -> None:
    (finding,) = findings_of(write_config(), **{name: ""})
    assert finding.is_error
    assert finding.fix.startswith("It must be a path, such as ")


def test_a_property_of_the_users_own_is_not_computed_before_the_experiment(write_config: Write) -> None:
    assert findings_of(write_config("@property\ndef port(self): raise RuntimeError('only in a run')")) == ()


def test_every_callback_that_cannot_be_called_is_found_at_once(write_config: Write) -> None:
    findings = findings_of(write_config("def start_run(self, a, b): pass\nasync def stop_run(self, context): pass"))
    assert [finding.problem.partition(" ")[0] for finding in findings] == ["start_run(a,", "stop_run"]


@pytest.mark.parametrize(
    ("returned", "order"),
    [
        ("table.plan(seed=42)", "shuffled, seed 42, given"),
        ("(table.plan(), table.randomize_runs_order(5))[0]", "shuffled, another seed"),
        ("(table.randomize_runs_order(3), table.randomize_runs_order(5))[0]", "shuffled, seed 3, given"),
        ("table", "shuffled, another seed"),
    ],
)
def test_a_config_that_returns_a_planned_table_gets_its_order(write_config: Write, returned: str, order: str) -> None:
    table = (
        "    def create_run_table(self):\n        table = RunTableModel([Factor('x', range(8))], shuffle=True)\n"
        f"        return {returned}\n"
    )
    experiment = prepare(write_config(table=table)).experiment
    assert experiment is not None
    model = experiment.model
    seed = f"seed {model.seed}, given" if model.seed_is_given else "another seed"
    assert f"{'shuffled' if model.shuffle else 'as written'}, {seed}" == order
    if model.seed_is_given:
        expected = RunTableModel([Factor("x", range(8))], shuffle=True, seed=model.seed).plan()
        assert [run.combination["x"] for run in model.plan()] == [run.combination["x"] for run in expected]


@pytest.mark.parametrize("table", ['[Factor("batch", [1, 2])]', '[Factor("F", [1, 2])], data_columns=["batch"]'])
def test_a_factor_or_measure_in_the_place_of_the_column_of_batches_is_told_before_it_is_executed(
    write_config: Write, table: str
) -> None:
    """Once the runs are done, `extend` would refuse the experiment."""
    (found,) = findings_of(write_config(table=f"    def create_run_table(self): return RunTableModel({table})"))
    assert not found.is_error
    assert found.problem == "robot-runner extend adds a column 'batch', and refuses an experiment that has one already"
    assert not findings_of(
        write_config(table='    def create_run_table(self): return RunTableModel([Factor("Batch", [1, 2])])')
    )
