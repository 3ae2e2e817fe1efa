"""A converted config says the same in our own words: it plans the same runs, and yields the same measures."""

from __future__ import annotations

import ast
import csv
import sys
from typing import TYPE_CHECKING

import pytest
from tests.legacy.earlier_configs import ROBOT, RUNNER

from robot_runner.cli.main import main
from robot_runner.core.config.preparation import prepare
from robot_runner.core.errors import ConfigError
from robot_runner.core.execution.notices import SilentObserver
from robot_runner.core.execution.orchestrator import execute_experiment
from robot_runner.legacy.commands.convert import check_conversion
from robot_runner.legacy.conversion.converting import convert
from robot_runner.legacy.syntax import Edits

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from tests.legacy.earlier_configs import Executed


@pytest.fixture
def converted() -> Callable[[Path], Path]:
    """Return what converts a file, writes the new one beside it, and sees that both plan the same runs."""

    def written(path: Path) -> Path:
        conversion = convert(path)
        new = path.with_name("converted.py")
        new.write_text(conversion.text, encoding="utf-8")
        for name, text in conversion.beside.items():
            new.with_name(name).write_text(text, encoding="utf-8")
        assert [str(finding) for finding in check_conversion(conversion, new) if finding.is_error] == []
        return new

    return written


def measures_of(path: Path, columns: list[str]) -> list[list[str]]:
    experiment = prepare(path, {"results_output_path": str(path.parent / "own")}).experiment
    finished = execute_experiment(experiment, SilentObserver())
    assert finished.failures == ()
    with finished.run_table.open(newline="") as file:
        return [[row[column] for column in columns] for row in csv.DictReader(file)]


FULL = """
def before_experiment(self) -> None:
    \"\"\"A text that stays.\"\"\"
    self.base = 100

def before_run(self) -> None:
    self.extra = 5  # a comment that stays

def start_run(self, context: RunnerContext) -> None:
    self.size = context.execute_run["size"]
    (context.run_dir / "id.txt").write_text(context.execute_run["__run_id"])

def interact(self, context: RunnerContext) -> None:
    print(f"{self.name}: run {context.run_nr}")

def populate_run_data(self, context: RunnerContext):
    return {"seconds": self.base + self.extra + self.size}
"""


@pytest.mark.long
def test_a_config_of_experiment_runner_becomes_one_of_ours(
    config: Callable[..., Path], converted: Callable[[Path], Path], execute: Callable[..., Executed]
) -> None:
    old = config(FULL)
    new = converted(old)
    text = new.read_text()
    assert "EventManager" not in text
    assert "EventSubscriptionController" not in text
    assert "class RobotRunnerConfig(ExperimentConfig):" in text
    assert "def launch_mission(self, context: RobotRunnerContext) -> None:" in text
    assert "# a comment that stays" in text
    assert '"""A text that stays."""' in text
    columns = ["size", "language", "seconds"]
    assert measures_of(new, columns) == [[row[name] for name in columns] for row in execute(old).table]


@pytest.mark.long
def test_members_that_are_called_like_parameters_of_ours_by_chance_get_other_names(
    config: Callable[..., Path], converted: Callable[[Path], Path], execute: Callable[..., Executed]
) -> None:
    members = """
    attempts: int = 5
    phases, hosts = 3, ["10.0.0.1"]
    most = attempts + phases

    @property
    def robot(self):
        return self.plugins[0]

    @robot.setter
    def robot(self, name):
        self.plugins = [name]

    def start_run(self, context: RunnerContext) -> None:
        attempts = 1  # another variable
        self.robot = "alice"
        self.size = context.execute_run["size"] + attempts + len(context.execute_run["language"])

    def interact(self, context: RunnerContext, times=attempts) -> None:
        self.size += times

    def populate_run_data(self, context: RunnerContext):
        return {"seconds": self.size + self.attempts + RunnerConfig.phases + self.most + len(self.robot)}
    """
    old = config(members)
    new = converted(old)
    text = new.read_text()
    assert "_attempts: int = 5" in text
    assert "attempts = 1  # another variable" in text
    (told,) = [each.problem for each in convert(old).findings if "is called otherwise" in each.problem]
    assert "attempts (now _attempts), hosts (now _hosts), phases (now _phases), plugins (now _plugins)" in told
    columns = ["size", "language", "seconds"]
    assert measures_of(new, columns) == [[row[name] for name in columns] for row in execute(old).table]
    experiment = prepare(new).experiment
    assert experiment is not None
    assert (experiment.parameters.attempts, experiment.parameters.robot, experiment.plugins) == (1, None, ())


@pytest.mark.long
def test_what_no_cell_holds_becomes_the_text_that_the_tool_wrote(
    config: Callable[..., Path], converted: Callable[[Path], Path], execute: Callable[..., Executed]
) -> None:
    table = """\
    def create_run_table_model(self):
        self.run_table_model = RunTableModel(
            [FactorModel("size", [1, 2])], data_columns=["trace", "pair", "by_name", "squares", "own"]
        )
        return self.run_table_model
"""
    methods = """
    def populate_run_data(self, context: RunnerContext):
        size = context.execute_run["size"]
        own = {"a": [size]}
        run_data = {
            "trace": [0, context.execute_run["size"]],
            "pair": (size, "a, b"),
            "by_name": {"trace": [size]},
            "squares": [each**2 for each in range(size)],
            "own": own["a"][0],
        }
        return run_data
    """
    old = config(methods, table=table)
    new = converted(old)
    assert '"trace": str([0, context.combination["size"]]),' in new.read_text()
    columns = ["size", "trace", "pair", "by_name", "squares", "own"]
    before = [[row[name] for name in columns] for row in execute(old).table]
    assert measures_of(new, columns) == before
    assert before[1][1:] == ["[0, 2]", "(2, 'a, b')", "{'trace': [2]}", "[0, 1]", "2"]


@pytest.mark.long
def test_a_config_of_robot_runner_becomes_one_of_ours(
    config: Callable[..., Path], converted: Callable[[Path], Path], execute: Callable[..., Executed]
) -> None:
    methods = """
    def launch_mission(self, context: RobotRunnerContext):
        context.run_variation["energy"] = 1
        self.task = context.run_variation["task"]

    def populate_run_data(self, context):
        variation = context.run_variation
        variation["energy"] = variation["speed"] * 10 + len(self.task)
        return variation
    """
    old = config(methods, head=ROBOT)
    new = converted(old)
    columns = ["task", "speed", "energy"]
    assert measures_of(new, columns) == [[row[name] for name in columns] for row in execute(old).table]


RETURNED = """
def interact(self, context: RunnerContext) -> None:
    self.kept = {"seconds": 4.5}
    self.kept["rounds"] = 3

def populate_run_data(self, context: RunnerContext):
    print(context.execute_run["size"], context.execute_run["language"])
    return {
        "size": context.execute_run["size"],  # which the tool wrote again
        "seconds": 4.5, "__done": "DONE", "language": "c"
    }
"""


@pytest.mark.long
def test_treatments_in_what_is_returned_which_the_tool_wrote_again_are_left_out(
    config: Callable[..., Path], converted: Callable[[Path], Path], execute: Callable[..., Executed]
) -> None:
    path = config(RETURNED)
    before = [row["seconds"] for row in execute(path).table]
    new = converted(path)
    assert [seconds for (seconds,) in measures_of(new, ["seconds"])] == before == ["4.5"] * 8
    assert not convert(path).findings


@pytest.mark.parametrize("returned", ['{"seconds": 1.0, "rounds": 3}', "self.kept", "found"])
def test_what_is_returned_without_a_column_is_named_with_its_line(config: Callable[..., Path], returned: str) -> None:
    methods = RETURNED.partition("    return {")[0]
    found = 'found = {"seconds": 1.0}\n    found["rounds"] = 3'
    path = config(f"{methods}    {found}\n    return {returned}\n")
    (told,) = convert(path).findings
    assert told.problem == "'rounds' is not in data_columns: each run of the new file that returns it fails"
    assert '"rounds"' in path.read_text().splitlines()[int(told.where.rpartition(":")[2]) - 1]


def test_callbacks_of_other_names_are_named_after_their_events(
    config: Callable[..., Path], converted: Callable[[Path], Path]
) -> None:
    table = """\
    def create_run_table_model(self):
        return RunTableModel([FactorModel("n", [1])])

    def before_experiment(self):
        raise AssertionError("nobody subscribed this")

    def work(self, context):
        self.helper()

    def helper(self): ...
"""
    new = converted(config(table=table, subscribe="(RunnerEvents.INTERACT, self.work),"))
    names = {node.name for node in ast.walk(ast.parse(new.read_text())) if isinstance(node, ast.FunctionDef)}
    assert names == {"create_run_table", "_before_experiment", "launch_mission", "helper"}
    assert measures_of(new, ["n"]) == [["1"]]


def test_several_callbacks_of_one_event_stay_subscribed(
    config: Callable[..., Path], converted: Callable[[Path], Path]
) -> None:
    table = """\
    def create_run_table_model(self):
        return RunTableModel([FactorModel("n", [1])], data_columns=["a", "b"])

    def first(self, context): return {"a": 1}
    def second(self, context): return {"b": 2}
    def work(self, context): ...
"""
    subscribe = "".join(
        f"(RunnerEvents.{event}, self.{name}),"
        for event, name in (("POPULATE_RUN_DATA", "first"), ("POPULATE_RUN_DATA", "second"), ("INTERACT", "work"))
    )
    new = converted(config(table=table, subscribe=subscribe))
    assert "(RobotRunnerEvents.LAUNCH_MISSION, self.work)" in new.read_text()
    assert measures_of(new, ["a", "b"]) == [["1", "2"]]


@pytest.mark.long
def test_what_is_subscribed_under_a_condition_stays_so(
    config: Callable[..., Path], converted: Callable[[Path], Path]
) -> None:
    path = config("def populate_run_data(self, context): return {'seconds': 2}")
    text = path.read_text().replace("def __init__(self):", "def __init__(self):\n        if self.name:")
    path.write_text(text.replace("        Event", "            Event", 1))
    new = converted(path)
    assert "if self.experiment_name:\n            EventSubscriptionController.subscribe_to" in new.read_text()
    assert {value for (value,) in measures_of(new, ["seconds"])} == {"2"}


def test_lists_of_callbacks_become_entries(config: Callable[..., Path], converted: Callable[[Path], Path]) -> None:
    table = """\
    def create_run_table_model(self):
        return RunTableModel(treatments=[FactorModel("n", [1])], data_columns=["a", "b"])

    def first(self, context): return {"a": 1}
    def second(self, context): return {"b": 2}
    def interact(self, context): ...
"""
    subscribe = "(RunnerEvents.POPULATE_RUN_DATA, [self.first, self.second]), (RunnerEvents.INTERACT, [self.interact]),"
    old = config(table=table, subscribe=subscribe)
    old.write_text(
        old.read_text().replace("subscribe_to_multiple_events(", "subscribe_to_multiple_events_multiple_callbacks(", 1)
    )
    new = converted(old)
    assert "(RobotRunnerEvents.LAUNCH_MISSION, self.interact)" in new.read_text()
    assert measures_of(new, ["a", "b"]) == [["1", "2"]]


def test_a_continue_callback_says_that_the_user_was_asked(
    config: Callable[..., Path], converted: Callable[[Path], Path]
) -> None:
    head = ROBOT.replace("OperationType.AUTO", "OperationType.SEMI")
    methods = "def swap(self):\n    self.swapped = True"
    new = converted(config(methods, head=head, subscribe="(RobotRunnerEvents.CONTINUE, self.swap),"))
    assert "def continue_experiment(self):" in new.read_text()
    assert "def before_experiment(self):\n        return True" in new.read_text(), "the earlier tool asked between runs"
    assert len(measures_of(new, ["task"])) == 4


def test_a_continue_callback_that_ends_early_lets_the_next_run_start_too(
    config: Callable[..., Path], converted: Callable[[Path], Path]
) -> None:
    head = ROBOT.replace("OperationType.AUTO", "OperationType.SEMI")
    methods = """\
def ready(self):
    print("ready")
    return False
def swap(self):
    self.swaps = getattr(self, "swaps", 0) + 1
    match self.swaps:
        case 1:
            return
    if self.swaps == 2:
        return print("swapped")
    list(map(lambda each: each, self.asked()))
def asked(self):
    return []
"""
    subscribe = "(RobotRunnerEvents.BEFORE_EXPERIMENT, self.ready), (RobotRunnerEvents.CONTINUE, self.swap),"
    new = converted(config(methods, head=head, subscribe=subscribe))
    assert "        return []" in new.read_text()
    assert len(measures_of(new, ["task"])) == 4


@pytest.mark.long
def test_what_stands_beside_a_subscription_and_uses_its_names_is_kept(
    config: Callable[..., Path], converted: Callable[[Path], Path]
) -> None:
    path = config("def populate_run_data(self, context): return {'seconds': self.seconds}")
    beside = "        ]); self.seconds = len(RunnerEvents.START_RUN.name)"
    path.write_text(path.read_text().replace("        ])", beside, 1))
    assert {value for (value,) in measures_of(converted(path), ["seconds"])} == {"9"}


def test_factors_by_keyword_are_renamed(config: Callable[..., Path], converted: Callable[[Path], Path]) -> None:
    path = config()
    text = path.read_text().replace('"size", [10, 20]', 'treatments=[10, 20], factor_name="size"')
    path.write_text(text)
    assert 'Factor(treatments=[10, 20], name="size")' in converted(path).read_text()


@pytest.mark.parametrize(("subscribe", "is_said"), [("", True), ("(RobotRunnerEvents.CONTINUE, print),", False)])
def test_it_is_said_that_runs_wait_now_which_went_on_by_themselves(
    subscribe: str, is_said: bool, config: Callable[..., Path]
) -> None:
    head = ROBOT.replace("OperationType.AUTO", "OperationType.SEMI")
    findings = convert(config(head=head, subscribe=subscribe)).findings
    assert is_said is any("now each run waits" in finding.problem for finding in findings)


def test_before_run_with_the_row_gets_the_context(
    config: Callable[..., Path], converted: Callable[[Path], Path]
) -> None:
    new = converted(config("def before_run(self, run_variation):\n    print(run_variation['task'])", head=ROBOT))
    assert "def before_run(self, context):" in new.read_text()
    assert len(measures_of(new, ["task"])) == 4


def test_what_is_put_before_a_decorated_function_stands_before_its_decorators(
    config: Callable[..., Path], converted: Callable[[Path], Path]
) -> None:
    body = "def before_run(self, run_variation):\n    @staticmethod\n    def told(): print(run_variation['task'])\n"
    new = converted(config(body, head=ROBOT)).read_text()
    assert "run_variation = context.combination\n        @staticmethod\n        def told()" in new


@pytest.mark.parametrize(
    "model",
    [
        'RunTableModel(factors=[FactorModel("a", [1, 2])], num_repetitions=3)',
        'RunTableModel(factors=[FactorModel("a", [1, 2])], iterations=3, data_columns=["x"])',
        'RunTableModel([FactorModel("a", [1, 2])], [], ["x"], False)',
        'RunTableModel([FactorModel("a", [1, 2])], None, 2, ["x"], True)',
        'RunTableModel([FactorModel("a", [1, 2]), FactorModel("b", [3])], num_of_repetitions=2, randomize_order=True)',
        'RunTableModel(factors=[FactorModel("a", [1, 2]), FactorModel("b", ["x", "y"])], num_of_repetitions=2)',
        'RunTableModel([FactorModel("a", ["on", "off"]), FactorModel("b", [1, 2])], exclude_variations=[{"on", 2}])',
        'RunTableModel([FactorModel("a", ["x", "y"]), FactorModel("b", ["x", "y"])], exclude_variations=[{"x"}])',
        'RunTableModel([FactorModel("a", [1, 2]), FactorModel("b", [1, 2])], exclude_variations=[{2, 1}, {9}])',
        'RunTableModel([FactorModel("a", [True, False]), FactorModel("b", [0, 1])], exclude_variations=[{True}])',
        'RunTableModel(factors=[FactorModel("a", range(3))], shuffle=True)',
    ],
)
def test_every_form_of_a_run_table_plans_the_same_runs(
    config: Callable[..., Path], converted: Callable[[Path], Path], model: str
) -> None:
    table = f"""\
    def create_run_table_model(self):
        self.run_table_model = {model}
        return self.run_table_model
"""
    converted(config(table=table))


@pytest.mark.parametrize(
    ("exclusions", "after"),
    [
        ("[{a: [1]}, {a: [7]}, {a: [8], b: ['x']}]", "[{a: [1]}]"),
        ("[{a: [7]}, {a: [1]}]", "[{a: [1]}]"),
        ("[{a: [7]}]", "[]"),
        ("[{a: [1, 7]}]", "[{'a': [1]}]"),
        ("[{a: [9]}, {1}, {a: [2], b: ['z']}, {b: ['y']}]", "[{'a': [1]}, {b: ['y']}]"),
    ],
)
def test_what_an_exclusion_names_that_there_is_not_is_left_out(
    config: Callable[..., Path], converted: Callable[[Path], Path], exclusions: str, after: str
) -> None:
    table = f"""\
    def create_run_table_model(self):
        a, b = FactorModel("a", [1, 2, 3]), FactorModel("b", ["x", "y"])
        return RunTableModel(factors=[a, b], exclude_variations={exclusions})
"""
    assert f"exclude_combinations={after})" in converted(config(table=table)).read_text()


def test_a_model_without_factors_gets_one(config: Callable[..., Path], converted: Callable[[Path], Path]) -> None:
    table = "    def create_run_table_model(self): return RunTableModel(repetitions=2)\n"
    assert (
        'RunTableModel(factors=[Factor("setup", ["as it is"])], repetitions=2)'
        in converted(config(table=table)).read_text()
    )


def test_a_parameter_that_is_made_of_the_name_still_is(
    config: Callable[..., Path], converted: Callable[[Path], Path]
) -> None:
    head = RUNNER.replace('ROOT_DIR / "experiments"', 'ROOT_DIR / f"{name}_results" / name')
    new = converted(config(head=head))
    assert prepare(new).experiment.folder.root == new.parent / "sorting_results" / "sorting" / "sorting"


@pytest.mark.long
def test_the_folder_is_known_where_the_class_ends_with_its_declaration(
    config: Callable[..., Path], converted: Callable[[Path], Path]
) -> None:
    old = config("def populate_run_data(self, context: RunnerContext): return {'seconds': self.experiment_path.name}")
    old.write_text(f"{old.read_text().rstrip()}\n\n    experiment_path: Path = None\n")  # as in the tool's template
    assert measures_of(converted(old), ["seconds"]) == [["sorting"]] * 8


def test_a_name_that_the_class_goes_on_to_change_is_the_experiments(
    config: Callable[..., Path], converted: Callable[[Path], Path]
) -> None:
    late = '    if len(name) > 3:\n        name = name + "_2"\n'
    new = converted(config(head=RUNNER + late))
    assert prepare(new).experiment.parameters.experiment_name == "sorting_2"


def test_a_method_that_only_subscribed_does_nothing(
    config: Callable[..., Path], converted: Callable[[Path], Path]
) -> None:
    path = config("def interact(self, context): ...")
    path.write_text(
        path.read_text().replace("def __init__(self):", "def __init__(self): self.listen()\n    def listen(self):")
    )
    assert "    def listen(self):\n        pass\n" in converted(path).read_text()


def test_a_class_of_theirs_that_only_says_of_what_type_something_is_needs_no_counterpart(
    config: Callable[..., Path], converted: Callable[[Path], Path]
) -> None:
    head = RUNNER.replace(
        "from pathlib", "from ProgressManager.RunTable.Models.RunProgress import RunProgress\nfrom pathlib"
    )
    text = converted(config("def interact(self, context: RunnerContext) -> RunProgress: ...", head=head)).read_text()
    assert "def launch_mission(self, context: RobotRunnerContext) -> object: ..." in text


def test_who_varies_nothing_gets_a_factor_with_one_treatment(
    config: Callable[..., Path], converted: Callable[[Path], Path]
) -> None:
    table = """\
    def create_run_table_model(self):
        return Model(factors=[], repetitions=3, data_columns=["x"])
"""
    head = RUNNER.replace("import RunTableModel", "import RunTableModel as Model")
    head = head.replace("from ConfigValidator.Config.Models.FactorModel import FactorModel\n", "")
    path = config(head=head, table=table)
    new = converted(path)
    assert 'RunTableModel(factors=[Factor("setup", ["as it is"])], repetitions=3' in new.read_text()
    (finding,) = check_conversion(convert(path), new)
    assert finding.problem == "nothing is varied, so there is a factor 'setup' with one treatment"


def test_a_config_for_another_machine_is_converted_on_this_one(
    config: Callable[..., Path], converted: Callable[[Path], Path], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    for gone in ("ROS_VERSION", "ROS_DISTRO"):
        monkeypatch.delenv(gone, raising=False)
    head = ROBOT.replace("required_ros_version: int = None", "required_ros_version: int = 2").replace(
        "from pathlib", "from Plugins.Profilers.PowerJoular import PowerJoular\nfrom pathlib"
    )
    path = config("def start_measurement(self, context): self.meter = PowerJoular()", head=head)
    assert prepare(path).experiment is None
    assert "import PowerJoular" in converted(path).read_text()


def test_what_is_imported_and_never_used_is_left_out(
    config: Callable[..., Path], converted: Callable[[Path], Path]
) -> None:
    head = RUNNER.replace(
        "from pathlib",
        "from ProgressManager.Output.CSVOutputManager import CSVOutputManager\n"
        "from Plugins.Profilers.WattsUpPro import WattsUpPro\nfrom pathlib",
    )
    text = converted(config(head=head)).read_text()
    assert "CSVOutputManager" not in text
    assert "WattsUpPro" not in text


@pytest.mark.parametrize("ending", ["get_experiment_run_table", "generate_experiment_run_table"])
def test_rows_of_a_model_become_the_model(
    config: Callable[..., Path], converted: Callable[[Path], Path], ending: str
) -> None:
    table = f"""\
    def create_run_table(self):
        first = FactorModel("a", [1, 2])
        assert first.factor_name == "a" and list(first.get_treatments()) == [1, 2]
        model = RunTableModel(factors=[first], exclude_variations=[{{first: [1]}}])
        model.create_experiment_run_table()
        return model.{ending}()
"""
    assert "FactorModel" not in converted(config(table=table)).read_text()


def test_a_path_that_began_in_the_current_folder_still_does(
    config: Callable[..., Path], converted: Callable[[Path], Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    monkeypatch.chdir(elsewhere)
    head = ROBOT.replace('Path(__file__).parent / "results"', 'Path("out")')
    new = converted(config(head=head))
    assert prepare(new).experiment.folder.root == elsewhere / "out" / "patrol"


def test_a_config_that_derives_from_the_tools_class_derives_from_ours(
    write: Callable[..., Path], converted: Callable[[Path], Path]
) -> None:
    old = write(
        """
        from ConfigValidator.Config.RunnerConfig import RunnerConfig as Original
        from ConfigValidator.Config.Models.RunTableModel import RunTableModel
        from ConfigValidator.Config.Models.FactorModel import FactorModel

        class RunnerConfig(Original):
            name = "derived"

            def __init__(self):
                super().__init__()
                self.counter = 0

            def create_run_table_model(self):
                return RunTableModel([FactorModel("n", [1, 2])], data_columns=["double"])

            def populate_run_data(self, context):
                return {"double": 2 * context.execute_run["n"]}
        """
    )
    new = converted(old)
    assert "class RobotRunnerConfig(ExperimentConfig):" in new.read_text()
    assert measures_of(new, ["double"]) == [["2"], ["4"]]


def test_a_profiler_that_needs_no_tool_around_it_is_kept(
    config: Callable[..., Path], converted: Callable[[Path], Path]
) -> None:
    head = RUNNER.replace("from pathlib", "from Plugins.Profilers.Ps import Ps as Meter\nfrom pathlib")
    text = converted(config("def start_measurement(self, context): self.meter = Meter()", head=head)).read_text()
    assert "from robot_runner.plugins.earlier import Ps as Meter" in text


@pytest.mark.long
def test_a_plugin_of_a_clones_own_is_written_beside_with_public_imports(
    config: Callable[..., Path], converted: Callable[[Path], Path], write: Callable[..., Path]
) -> None:
    write(
        "from Plugins.Profilers.DataSource import CLISource\nfrom Plugins.Profilers.Ps import Ps\n\n\n"
        "class ClonesMeter:\n    kinds = (CLISource, Ps)\n    def read(self): return 4.5\n",
        "Plugins/Profilers/ClonesMeter.py",
    )
    head = RUNNER.replace(
        "from pathlib", "from Plugins.Profilers.ClonesMeter import ClonesMeter as Meter\nfrom pathlib"
    )
    new = converted(config("def populate_run_data(self, context): return {'seconds': Meter().read()}", head=head))
    assert "from ClonesMeter import ClonesMeter as Meter" in new.read_text()
    beside = new.with_name("ClonesMeter.py").read_text()
    assert "from robot_runner.plugins.earlier import CLISource, Ps\n" in beside
    assert {value for (value,) in measures_of(new, ["seconds"])} == {"4.5"}


@pytest.mark.long
def test_what_stands_beside_the_main_file_of_a_clone_is_written_beside(
    config: Callable[..., Path], converted: Callable[[Path], Path], write: Callable[..., Path]
) -> None:
    tool = "clone/experiment-runner"
    write("", f"{tool}/__main__.py")
    write("", f"{tool}/Plugins/__init__.py")
    write("def read(): return 4.5\n", f"{tool}/socket_of_clone.py")
    write(
        "from ProgressManager.Output.OutputProcedure import OutputProcedure as output\nimport socket_of_clone\n\n\n"
        "def measured():\n    output.console_log_OK('read')\n    return socket_of_clone.read()\n",
        f"{tool}/handler_of_clone.py",
    )
    head = RUNNER.replace("from pathlib", "from handler_of_clone import measured\nfrom pathlib")
    methods = "def populate_run_data(self, context): return {'seconds': measured()}"
    new = converted(config(methods, head=head, name="clone/study/RunnerConfig.py"))
    assert "print('read')" in new.with_name("handler_of_clone.py").read_text()
    assert {value for (value,) in measures_of(new, ["seconds"])} == {"4.5"}


def test_a_measure_that_is_called_like_a_column_of_ours_is_renamed_wherever_it_is_named(
    config: Callable[..., Path], converted: Callable[[Path], Path]
) -> None:
    table = """\
    def create_run_table_model(self):
        return RunTableModel(
            factors=[FactorModel("size", ["status", "big"])], data_columns=["status", "seconds"]
        )
"""
    methods = """
def interact(self, context: RunnerContext) -> None:
    self.answer = {"status": 200}["status"]

def populate_run_data(self, context: RunnerContext):
    row = {"seconds": 1}
    row["status"] = self.answer
    print(f"answered {row['status']}")
    return row
"""
    old = config(methods, table=table)
    new = converted(old)
    assert 'FactorModel("size"' not in new.read_text()
    assert '["status", "big"]' in new.read_text(), "a treatment keeps its name"
    assert measures_of(new, ["status_", "size"]) == [["200", "status"], ["200", "big"]]
    assert any("the column 'status' is called 'status_' now" in finding.problem for finding in convert(old).findings)


def test_a_column_that_only_loses_its_blanks_clashes_with_none_of_ours(config: Callable[..., Path]) -> None:
    table = """\
    def create_run_table_model(self):
        return RunTableModel(factors=[FactorModel(" size", [1])], data_columns=["attempt "])
"""
    found = [finding.problem for finding in convert(config(table=table)).findings]
    assert "the column ' size' is called 'size' now: no heading has blanks around it" in found
    assert "the column 'attempt ' is called 'attempt_' now: the run table has one of ours called 'attempt'" in found


CARBON = """\
from Plugins.Profilers import CodecarbonWrapper as carbon
from Plugins.Profilers.CodecarbonWrapper import DataColumns
"""
CARBON_TABLE = """\
    def create_run_table_model(self):
        self.run_table_model = RunTableModel(factors=[FactorModel("size", [1, 2])], data_columns=["own"])
        return self.run_table_model
"""
MEASURING = """
def start_measurement(self, context): ...
def stop_measurement(self, context): ...
def populate_run_data(self, context): ...
"""


@pytest.mark.parametrize(
    ("decorated", "decorator"),
    [
        (
            "class RunnerConfig",
            "@carbon.emission_tracker(\n    data_columns=[DataColumns.EMISSIONS],\n    country_iso_code='NLD'\n)\n",
        ),
        (
            "    def stop_measurement(",
            "    @carbon.start_emission_tracker(country_iso_code='NLD')\n    @carbon.stop_emission_tracker\n",
        ),
    ],
)
def test_codecarbons_decorators_become_our_profiler(
    config: Callable[..., Path], converted: Callable[[Path], Path], decorated: str, decorator: str
) -> None:
    path = config(MEASURING, head=RUNNER.replace("from pathlib", f"{CARBON}from pathlib"))
    path.write_text(path.read_text().replace(decorated, decorator + decorated, 1))
    text = converted(path).read_text()
    assert "from robot_runner.plugins.profilers import CodeCarbon" in text
    assert "    plugins = [CodeCarbon(country='NLD')]\n    ROOT_DIR" in text
    assert "carbon." not in text
    assert any("are a profiler now" in finding.problem for finding in convert(path).findings)


def test_columns_and_settings_of_codecarbon_are_those_of_our_profiler(
    config: Callable[..., Path], converted: Callable[[Path], Path]
) -> None:
    columns = "DataColumns.EMISSIONS, DataColumns.ENERGY_CONSUMED, DataColumns.GPU_ENERGY"
    settings = f"data_columns=[{columns}], country_iso_code='NLD', measure_power_secs=5, tracking_mode='process'"
    path = config(MEASURING, head=RUNNER.replace("from pathlib", f"{CARBON}from pathlib"), table=CARBON_TABLE)
    path.write_text(path.read_text().replace("class Runner", f"@carbon.emission_tracker({settings})\nclass Runner", 1))
    new = converted(path)
    assert check_conversion(convert(path), new) == ()
    text = new.read_text()
    assert "CodeCarbon(country='NLD', interval_s=5, options={\"tracking_mode\": 'process'})" in text
    assert 'data_columns=["own", "Emissions", "Energy"])' in text
    (told,) = [each for each in convert(path).findings if "are a profiler now" in each.problem]
    assert "codecarbon__energy_consumed is Energy now" in told.problem
    assert "codecarbon__gpu_energy has no column any more, and stands in emissions.json" in told.problem
    assert "which were in kWh" in told.fix
    path.write_text(path.read_text().replace('data_columns=["own"]', 'data_columns=list(["own"])'))
    (lost,) = check_conversion(convert(path), converted(path))
    assert "there is no column 'codecarbon__emissions', 'codecarbon__energy_consumed' any more" in lost.problem


def test_a_measure_that_is_called_like_one_of_codecarbons_is_refused(config: Callable[..., Path]) -> None:
    settings = "data_columns=[DataColumns.ENERGY_CONSUMED], country_iso_code='NLD'"
    path = config(MEASURING, head=RUNNER.replace("from pathlib", f"{CARBON}from pathlib"), table=CARBON_TABLE)
    text = path.read_text().replace("class Runner", f"@carbon.emission_tracker({settings})\nclass Runner", 1)
    path.write_text(text.replace('data_columns=["own"]', 'data_columns=["own", "Energy"]'))
    with pytest.raises(ConfigError, match="the config has a measure 'Energy', and so has CodeCarbon's profiler"):
        convert(path)


def test_codecarbon_without_a_country_is_refused(config: Callable[..., Path]) -> None:
    path = config(MEASURING, head=RUNNER.replace("from pathlib", f"{CARBON}from pathlib"))
    path.write_text(path.read_text().replace("class Runner", "@carbon.emission_tracker(online=True)\nclass Runner", 1))
    with pytest.raises(ConfigError, match="do not say the country_iso_code"):
        convert(path)


@pytest.mark.parametrize(
    ("line", "use", "problem"),
    [
        (
            "from Plugins.Profilers.WattsUpPro import WattsUpPro",
            "def start_run(self, context): self.meter = WattsUpPro()",
            "WattsUpPro cannot be used outside a config of the earlier tool → List our WattsUpPro",
        ),
        (
            "from ProgressManager.Output.CSVOutputManager import CSVOutputManager",
            "def after_experiment(self): CSVOutputManager(self.experiment_path).read_run_table()",
            "CSVOutputManager has no counterpart here",
        ),
        ("from ConfigValidator.Config.Models.FactorModel import *", "", "everything of a module is imported"),
        (
            "from Plugins.Profilers.OwnMeter import OwnMeter",
            "def start_run(self, context): self.meter = OwnMeter()",
            "Plugins.Profilers.OwnMeter is a module of the clone that the config stands in → Put it beside the config",
        ),
    ],
)
def test_what_has_no_counterpart_is_named_with_its_line(
    config: Callable[..., Path], write: Callable[..., Path], line: str, use: str, problem: str
) -> None:
    write(
        "from ProgressManager.RunTable.Models.RunProgress import RunProgress\n"
        "class OwnMeter: state = RunProgress.TODO\n",
        "Plugins/Profilers/OwnMeter.py",
    )
    path = config(use, head=RUNNER.replace("from pathlib", f"{line}\nfrom pathlib"))
    with pytest.raises(ConfigError) as refused:
        convert(path)
    assert f"{path}:7: {problem}" in str(refused.value)


def test_a_question_that_is_asked_through_the_tool_is_named_with_its_line(config: Callable[..., Path]) -> None:
    line = "from ProgressManager.Output.OutputProcedure import OutputProcedure as output"
    use = "def before_run(self): self.is_dry = output.query_yes_no('Is the floor dry?')"
    path = config(use, head=RUNNER.replace("from pathlib", f"{line}\nfrom pathlib"))
    number = next(at for at, text in enumerate(path.read_text().splitlines(), 1) if "query_yes_no" in text)
    with pytest.raises(ConfigError) as refused:
        convert(path)
    assert f"{path}:{number}: output.query_yes_no has no counterpart here" in str(refused.value)


def test_a_neighbour_that_is_written_for_the_earlier_tool_has_to_be_mended_first(
    config: Callable[..., Path], write: Callable[..., Path]
) -> None:
    write("from ProgressManager.Output.OutputProcedure import OutputProcedure\n", "neighbour_of_conversion.py")
    path = config(head=RUNNER.replace("from pathlib", "import neighbour_of_conversion\nfrom pathlib"))
    with pytest.raises(ConfigError, match=r"neighbour_of_conversion\.py:1: the config imports this module"):
        convert(path)


def test_our_own_spelling_needs_no_converting(write: Callable[..., Path]) -> None:
    path = write("from robot_runner import ExperimentConfig\nclass RobotRunnerConfig(ExperimentConfig): ...\n")
    with pytest.raises(ConfigError, match="the config is written in our own spelling already"):
        convert(path)
    with pytest.raises(ConfigError, match="the file has no class named RobotRunnerConfig"):
        convert(write("print(4)\n", "script.py"))


def test_a_difference_is_found(config: Callable[..., Path]) -> None:
    path = config()
    conversion = convert(path)
    new = path.with_name("changed.py")
    new.write_text(conversion.text.replace("[10, 20]", "[10, 30]"))
    problems = [finding.problem for finding in check_conversion(conversion, new)]
    assert "size=20, language=c is planned 2 times less than before" in problems
    assert "size=30, language=c is planned 2 times more than before" in problems


def test_edits_that_touch_are_all_applied() -> None:
    text = "f(ä, b)"
    call = ast.parse(text).body[0].value
    edits = Edits(text)
    edits.replace(call.args[1], "c")
    edits.insert(edits.start_of(call.args[1]), "x=")
    edits.insert(edits.end_of(call.args[1]), ", d")
    edits.replace(call.func, "g")
    assert edits.applied() == "g(ä, x=c, d)"
    edits.replace(call, "whole")
    assert edits.applied() == "whole"


def test_a_neighbour_in_another_encoding_stays_as_it_is(
    config: Callable[..., Path], converted: Callable[[Path], Path], tmp_path: Path
) -> None:
    (tmp_path / "names_in_latin_1.py").write_bytes(b'# -*- coding: latin-1 -*-\nNAME = "caf\xe9"\n')
    head = RUNNER.replace("from pathlib", "import names_in_latin_1\nfrom pathlib")
    new = converted(config("def populate_run_data(self, context): return {'seconds': 1}", head=head))
    assert "import names_in_latin_1\n" in new.read_text()


def test_a_neighbour_that_is_not_beside_the_new_file_is_named(
    config: Callable[..., Path], write: Callable[..., Path], tmp_path: Path
) -> None:
    write("SIZES = (1, 2)\n", "neighbour_left_behind.py")
    head = RUNNER.replace("from pathlib", "from neighbour_left_behind import SIZES\nfrom pathlib")
    conversion = convert(config("def populate_run_data(self, context): return {'seconds': 1}", head=head))
    new = write(conversion.text, "elsewhere/config.py")
    found = check_conversion(conversion, new)
    assert [finding.problem for finding in found] == [
        "it imports neighbour_left_behind.py, which stands beside the old file and not beside this one"
    ]
    assert found[0].fix.startswith(f"Copy {tmp_path / 'neighbour_left_behind.py'} to {new.parent}")


def test_a_place_that_ends_in_a_slash_is_a_folder(config: Callable[..., Path], tmp_path: Path) -> None:
    path = config("def populate_run_data(self, context): return {'seconds': 1}")
    assert main(["convert", str(path), "--out", f"{tmp_path}/new/"]) == 0
    assert (tmp_path / "new" / path.name).is_file()


def test_what_is_no_text_in_the_search_path_is_passed_over(
    config: Callable[..., Path], converted: Callable[[Path], Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "path", [*sys.path])
    path = config()
    path.write_text("import sys\nsys.path.append(None)\n" + path.read_text(encoding="utf-8"), encoding="utf-8")
    assert "sys.path.append(None)" in converted(path).read_text(encoding="utf-8")


def test_folders_without_init_in_each_other_can_be_imported_from_elsewhere(
    config: Callable[..., Path], converted: Callable[[Path], Path], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(sys, "path", [*sys.path])
    module = tmp_path / "elsewhere/of_study/one/two/three/four/five/six/loads.py"
    module.parent.mkdir(parents=True)
    module.write_text("LOAD = 1\n")
    path = config()
    head = f"import sys\nsys.path.append({str(tmp_path / 'elsewhere')!r})\n"
    head += "from of_study.one.two.three.four.five.six.loads import LOAD\n"
    path.write_text(head + path.read_text(encoding="utf-8"), encoding="utf-8")
    assert "import LOAD" in converted(path).read_text(encoding="utf-8")


def test_an_order_that_the_config_seeded_is_said_to_be_another(config: Callable[..., Path]) -> None:
    table = """\
    def create_run_table_model(self):
        return RunTableModel([FactorModel("n", list(range(20)))], shuffle=True, data_columns=["seconds"])
"""
    path = config(table=table)
    path.write_text("import random\nrandom.seed(42)\n" + path.read_text(encoding="utf-8"), encoding="utf-8")
    conversion = convert(path)
    new = path.with_name("converted.py")
    new.write_text(conversion.text, encoding="utf-8")
    (finding,) = check_conversion(conversion, new)
    assert str(finding) == (
        "run table: random.seed(42) does not decide the order of the runs any more → Write RunTableModel(..., seed=42) "
        "for an order that comes again each time; it is another one than before."
    )
