"""Bad input: a finding with the place and the nearest name, never a traceback of ours."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from tests.legacy.earlier_configs import ROBOT, RUNNER, problems

from robot_runner.core.config.preparation import prepare

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


def only_problem(path: Path) -> str:
    (problem,) = problems(prepare(path))
    return problem


@pytest.mark.parametrize(
    ("line", "problem", "fix"),
    [
        (
            "from Plugins.Profilers.PowerJular import PowerJular",
            "ever had a plugin Plugins.Profilers.PowerJular",
            "Did you mean 'Plugins.Profilers.PowerJoular'?",
        ),
        (
            "from Plugins.Profilers.Oscilloscope import Oscilloscope",
            "ever had a plugin Plugins.Profilers.Oscilloscope",
            "If it is your own, put it beside the config file",
        ),
        ("from Plugins.Profilers import EnergyBridge", "ever had a plugin", "Did you mean 'EnergiBridge'?"),
        (
            "from ProgressManager.Output.OutputProcedure import OutputProcedur",
            "has no 'OutputProcedur'",
            "Did you mean 'OutputProcedure'?",
        ),
        (
            "from EventManager.Models.RunnerEvent import RunnerEvents",
            "ever had a module EventManager.Models.RunnerEvent",
            "Did you mean 'EventManager.Models.RunnerEvents'?",
        ),
        ("import ConfigValidator.Confg", "ever had a module ConfigValidator.Confg", ""),
        (
            "from Plugins.Systems.TurtleBot3.modules.sensors.OdomSensor import OdomSensor",
            "OdomSensor has nothing that stands in for it",
            "BasicTurtlebot3",
        ),
    ],
)
def test_an_import_of_what_never_was_is_named_with_its_line(
    config: Callable[..., Path], line: str, problem: str, fix: str
) -> None:
    path = config(head=RUNNER.replace("from pathlib", f"{line}\nfrom pathlib"))
    found = only_problem(path)
    assert found.startswith(f"{path}:7: ")
    assert problem in found
    assert fix in found


def test_everything_that_the_text_tells_is_told_at_once(config: Callable[..., Path]) -> None:
    head = RUNNER.replace("time_between_runs_in_ms", "time_between_run_in_ms").replace(
        "operation_type:", "opertion_type:"
    )
    methods = "def interact(self, context): print(context.run_variaton, RunnerEvents.INTERRACT)"
    path = config(methods, head=head)
    found = problems(prepare(path))
    assert [problem.partition(": ")[2].partition("? ")[0] for problem in found] == [
        "RunnerEvents has no event 'INTERRACT' → Did you mean 'INTERACT'?",
        "the context has no 'run_variaton' → Did you mean 'run_variation'?",
        "there is no static parameter 'opertion_type' → Did you mean 'operation_type'",
        "there is no static parameter 'time_between_run_in_ms' → Did you mean 'time_between_runs_in_ms'",
    ]


def test_a_name_of_the_users_own_refuses_nothing(config: Callable[..., Path]) -> None:
    own = "    self_measured = True\n    def create_run_table_models(self): return []\n"
    preparation = prepare(config(head=RUNNER + own))
    assert [finding.problem for finding in preparation.findings] == ["there is no static parameter 'self_measured'"]
    assert preparation.experiment is not None


def test_a_parameter_may_be_given_in_init(config: Callable[..., Path]) -> None:
    late = """
    def __init__(self):
        self.operation_type = self.operation_types[0]
    """
    head = RUNNER.replace(
        "operation_type: OperationType = OperationType.AUTO", "operation_types = [OperationType.AUTO]"
    )
    assert problems(prepare(config(late, head=head))) == []


@pytest.mark.parametrize(
    ("expression", "problem"),
    [
        (
            "RunTableModel([FactorModel('a', [1])], repetition=3)",
            "no argument 'repetition' → Did you mean 'repetitions'?",
        ),
        ("RunTableModel([FactorModel('a', [1])], repetitions=0)", "the number of repetitions is 0"),
        ("RunTableModel([FactorModel('a', [1]), FactorModel('a', [2])])", "two factors are called 'a'"),
        ("RunTableModel([FactorModel('a', [1, 1])])", "treatment 1 is given twice"),
        ("RunTableModel([FactorModel('a', 'scan')])", "the treatments are 'scan', of type str"),
        ("RunTableModel([FactorModel('a', [])])", "FactorModel 'a': there are no treatments"),
        ("RunTableModel(['a'])", "'a' is not a factor"),
        ("RunTableModel([FactorModel('a', [1])], data_columns='x')", "data_columns is 'x'"),
        ("RunTableModel([FactorModel('a', [1])], data_columns=['x', 'x'])", "two data columns are called 'x'"),
        ("RunTableModel([FactorModel('a', [1])], exclude_combinations=[{'b': [1]}])", "there is no factor 'b'"),
        ("RunTableModel([FactorModel('a', [1])], exclude_combinations=[{'a': [1]}])", "every combination is excluded"),
        ("RunTableModel([FactorModel('a', [1])], exclude_combinations=[3])", "an exclusion is 3, of type int"),
        ("[]", "the run table has no runs"),
        ("'table'", "the config returned 'table'"),
        ("[{'__run_id': 'a/b', 'x': 1}]", "cannot have the id 'a/b'"),
        ("1 / 0", "the config raised ZeroDivisionError in the making of the run table"),
    ],
)
def test_a_run_table_that_cannot_be_is_refused(config: Callable[..., Path], expression: str, problem: str) -> None:
    path = config(table=f"    def create_run_table_model(self):\n        return {expression}\n")
    assert problem in only_problem(path)


def test_the_line_of_a_misused_call_is_named(config: Callable[..., Path]) -> None:
    path = config(table="    def create_run_table_model(self):\n        return RunTableModel([], repetition=3)\n")
    line = path.read_text().splitlines().index("        return RunTableModel([], repetition=3)") + 1
    assert only_problem(path).startswith(f"{path}:{line}, RunTableModel: ")


@pytest.mark.parametrize(
    ("subscription", "problem"),
    [
        ("(RunnerEvents.START_RUN, self.strat_run)", "no attribute 'strat_run'"),
        ("('START_RUN', self.go)", "'START_RUN' is not an event → Did you mean 'START_RUN'?"),
        ("(RunnerEvents.START_RUN, 'go')", "the callback of START_RUN is 'go', which cannot be called"),
        ("(RunnerEvents.START_RUN, self.two)", "two(context, other) cannot be called at START_RUN"),
        ("(RunnerEvents.START_RUN, self.go, 1)", "is not a pair of an event and a callback"),
        ("(RunnerEvents.START_RUN, self.go)(RunnerEvents.STOP_RUN, self.go)", "the config raised TypeError"),
    ],
)
@pytest.mark.filterwarnings("ignore:'tuple' object is not callable")
def test_a_subscription_that_cannot_be_is_refused(config: Callable[..., Path], subscription: str, problem: str) -> None:
    methods = "def go(self, context): ...\ndef two(self, context, other): ..."
    assert problem in only_problem(config(methods, subscribe=f"{subscription},"))


def test_a_config_without_a_run_table_is_told_which_method_was_meant(config: Callable[..., Path]) -> None:
    path = config(table="    def make_the_table(self): ...\n")
    assert "the config makes no run table → Define create_run_table_model." in only_problem(path)
    path = config(table="    def create_run_tabel_model(self): ...\n")
    assert "no method is called 'create_run_tabel_model'" in only_problem(path)


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ('Path = ROOT_DIR / "experiments"', "Path = 5", "results_output_path: the value is 5, of type int"),
        ("int = 0", 'int = "soon"', "time_between_runs_in_ms: the value is 'soon'"),
        ("OperationType = OperationType.AUTO", "OperationType = 'AUTO'", "operation_type: the value is 'AUTO'"),
        ('str = "sorting"', "str = None", "experiment_name: the value is None"),
    ],
)
def test_a_static_parameter_of_a_wrong_type_is_refused(
    config: Callable[..., Path], old: str, new: str, problem: str
) -> None:
    assert problem in only_problem(config(head=RUNNER.replace(old, new)))


def test_a_missing_package_is_named_with_its_line(config: Callable[..., Path]) -> None:
    path = config(head=ROBOT.replace("from pathlib", "import rospy_that_is_not_there\nfrom pathlib"))
    assert only_problem(path) == (
        f"{path}:7: the config raised ModuleNotFoundError while it was loaded: "
        "No module named 'rospy_that_is_not_there' → "
        "Install the package that brings 'rospy_that_is_not_there', or correct the name."
    )


def test_all_that_a_file_lacks_is_told_though_it_cannot_be_loaded(
    config: Callable[..., Path], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    imports = """import json, gone_for_good.sub
from gone_too import anything
from Plugins.Profilers.EnergiBridge import EnergiBridge
try:
    import gone_but_guarded
except ImportError: ...
"""
    methods = "def start_measurement(self, context): self.meter = EnergiBridge()"
    path = config(methods, head=RUNNER.replace("from pathlib", f"{imports}from pathlib", 1))
    assert [problem.partition(" → ")[0] for problem in problems(prepare(path))] == [
        f"{path}:7: the config raised ModuleNotFoundError while it was loaded: No module named 'gone_for_good'",
        f"{path}:8: there is no module 'gone_too'",
        f"{path}:9: EnergiBridge needs the program energibridge, which is not here",
    ]


def test_a_config_that_ends_its_program_ends_only_itself(config: Callable[..., Path]) -> None:
    end = "import os\nif not os.environ.get('A_VARIABLE_THAT_NOBODY_HAS'): os._exit(3)\n"
    path = config(head=RUNNER.replace("from pathlib", f"{end}from pathlib", 1))
    assert only_problem(path) == f"{path}:8: the config raised SystemExit while it was loaded: 3 → Correct this line."


def test_a_process_that_a_config_forks_while_it_is_loaded_ends_by_itself(config: Callable[..., Path]) -> None:
    fork = "import os\nchild = os.fork() or os._exit(5)\nassert os.waitpid(child, 0)[1] >> 8 == 5\n"
    assert problems(prepare(config(head=RUNNER.replace("from pathlib", f"{fork}from pathlib", 1)))) == []


def test_the_tools_own_machinery_cannot_be_used(config: Callable[..., Path]) -> None:
    head = RUNNER.replace(
        "from pathlib",
        "from ExperimentOrchestrator.Experiment.ExperimentController import ExperimentController\nfrom pathlib",
    )
    table = "    def create_run_table_model(self):\n        return ExperimentController(self)\n"
    assert "ExperimentController belonged to the earlier tool itself" in only_problem(config(head=head, table=table))


def test_a_parameter_that_does_not_exist_cannot_be_set(config: Callable[..., Path]) -> None:
    (problem,) = problems(prepare(config(), {"operation_typ": "auto"}))
    assert "there is no static parameter 'operation_typ' → Did you mean 'operation_type'?" in problem


def test_a_neighbour_that_imports_what_never_was_is_no_fault_of_ours(
    config: Callable[..., Path], write: Callable[..., Path]
) -> None:
    write("from Plugins.Profilers.Oscilloscope import Oscilloscope\n", "neighbour_of_misuse.py")
    path = config(head=RUNNER.replace("from pathlib", "import neighbour_of_misuse\nfrom pathlib"))
    assert "ever had a module Plugins.Profilers.Oscilloscope" in only_problem(path)
