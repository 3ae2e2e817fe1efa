"""Every form that configs for Experiment Runner had."""

from __future__ import annotations

import sys
from random import Random
from typing import TYPE_CHECKING

import pytest
from tests.legacy.earlier_configs import RUNNER, planned

from robot_runner.core.config.preparation import prepare
from robot_runner.legacy.run_tables import shown_treatments
from robot_runner.legacy.stand_ins import modules as stand_in_modules

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from tests.legacy.earlier_configs import Executed

WITH_EXCLUSIONS = """\
    def create_run_table_model(self):
        size = FactorModel("size", [10, 20, 30])
        language = FactorModel("language", ["c", "py"])
        self.run_table_model = RunTableModel(
            factors=[size, language],
            exclude_combinations=[{size: [10]}, {size: [20, 30], language: ["py"]}],
            repetitions=2,
            data_columns=["seconds"],
        )
        return self.run_table_model
"""


def test_the_latest_form_gives_its_table(config: Callable[..., Path]) -> None:
    assert planned(prepare(config(table=WITH_EXCLUSIONS))) == [
        ("run_0_repetition_0", {"size": 20, "language": "c"}),
        ("run_1_repetition_0", {"size": 30, "language": "c"}),
        ("run_0_repetition_1", {"size": 20, "language": "c"}),
        ("run_1_repetition_1", {"size": 30, "language": "c"}),
    ]


def test_an_experiment_may_vary_nothing(config: Callable[..., Path], execute: Callable[..., Executed]) -> None:
    table = """\
    def create_run_table_model(self):
        return RunTableModel(factors=[], repetitions=2, data_columns=["seconds"])
"""
    path = config("def populate_run_data(self, context): return {'seconds': context.run_nr}", table=table)
    execute(path)
    assert execute(path).text == ("__run_id,__done,seconds\nrun_0_repetition_0,DONE,1\nrun_0_repetition_1,DONE,2\n")


def test_the_form_of_2022_numbers_its_runs_without_repetitions(config: Callable[..., Path]) -> None:
    table = """\
    def create_run_table(self):
        size = FactorModel("size", [10, 20])
        self.run_table_model = RunTableModel(
            factors=[size, FactorModel("fast", [True, False])],
            exclude_variations=[{size: [10]}],
            data_columns=["seconds"],
        )
        return self.run_table_model.generate_experiment_run_table()
"""
    assert planned(prepare(config(table=table))) == [
        ("run_0", {"size": 20, "fast": True}),
        ("run_1", {"size": 20, "fast": False}),
    ]


@pytest.mark.parametrize(
    ("arguments", "last"),
    [
        ("repetitions=3", "run_1_repetition_2"),
        ("num_repetitions=3", "run_1_repetition_2"),
        ("iterations=3", "run_1_iteration_2"),
        ("exclude_combinations=[]", "run_1_repetition_0"),
        ("exclude_variations=None", "run_1"),
    ],
)
def test_ids_are_those_of_the_version_that_had_the_argument(
    config: Callable[..., Path], arguments: str, last: str
) -> None:
    table = f"""\
    def create_run_table_model(self):
        self.run_table_model = RunTableModel([FactorModel("size", [1, 2])], {arguments})
        return self.run_table_model
"""
    assert planned(prepare(config(table=table)))[-1][0] == last


def test_arguments_may_stand_in_the_order_of_any_version(config: Callable[..., Path]) -> None:
    late = 'RunTableModel([FactorModel("a", [1, 2])], [], 2, ["x"], False)'
    early = 'RunTableModel([FactorModel("a", [1, 2])], [], ["x"], False)'
    for form, count in ((late, 4), (early, 2)):
        table = f"    def create_run_table_model(self):\n        return {form}\n"
        preparation = prepare(config(table=table))
        assert len(planned(preparation)) == count
        assert preparation.experiment.model.data_columns == ("x",)


def test_treatments_without_a_text_of_their_own_are_numbered() -> None:
    noted: list[str] = []
    shown = shown_treatments([print, lambda: 1, lambda: 2, lambda: 3], lambda _, text: noted.append(text))
    name = test_treatments_without_a_text_of_their_own_are_numbered.__name__
    assert noted == [f"{name}.<locals>.<lambda>{number}" for number in ("", "_2", "_3")]
    assert len({str(treatment) for _, treatment in shown}) == 4


@pytest.mark.long
def test_a_shuffled_order_comes_from_a_recorded_seed(
    config: Callable[..., Path], execute: Callable[..., Executed]
) -> None:
    table = """\
    def create_run_table_model(self):
        return RunTableModel([FactorModel("n", list(range(20)))], shuffle=True, data_columns=[])
"""
    path = config(table=table)
    first = execute(path)
    order = [row["__run_id"] for row in first.table]
    assert sorted(order) != order
    assert [run_id for run_id, _ in planned(prepare(path))] == order


@pytest.mark.long
def test_what_is_no_text_in_the_search_path_is_passed_over_as_an_import_does(
    config: Callable[..., Path], execute: Callable[..., Executed], monkeypatch: pytest.MonkeyPatch
) -> None:
    """As `sys.path.append(os.getenv("RR_PATH"))` leaves there where the variable is not set."""
    monkeypatch.setattr(sys, "path", [*sys.path])
    path = config()
    head = "import pathlib, sys\nsys.path += [None, b'bytes', 3, pathlib.Path('folder')]\n"
    path.write_text(head + path.read_text(encoding="utf-8"), encoding="utf-8")
    assert {row["__done"] for row in execute(path).table} == {"DONE"}


SHUFFLED = """\
    def create_run_table_model(self):
        return RunTableModel([FactorModel("n", list(range(20)))], shuffle=True, data_columns=[])
"""


SHUFFLED_BY_ITSELF = """\
    def create_run_table_model(self):
        rows = RunTableModel([FactorModel("n", list(range(20)))]).generate_experiment_run_table()
        random.shuffle(rows)
        return rows
"""


@pytest.mark.parametrize(
    ("head", "table"),
    [
        ("import random\nrandom.seed(42)\n", SHUFFLED),
        ("from random import seed\nseed(42)\n", SHUFFLED),
        ("import random\n", SHUFFLED.replace("        return", "        random.seed(42)\n        return")),
        ("import random\nrandom.seed(42)\n", SHUFFLED_BY_ITSELF),
    ],
    ids=["the file", "the function alone", "the table's method", "its own shuffling"],
)
def test_a_config_that_seeds_the_order_gets_the_order_of_the_earlier_tool(
    head: str, table: str, config: Callable[..., Path]
) -> None:
    expected = list(range(20))
    Random(42).shuffle(expected)  # noqa: S311 - what the earlier tool does with its rows
    path = config(table=table)
    path.write_text(head + path.read_text(encoding="utf-8"), encoding="utf-8")
    preparation = prepare(path)
    assert [combination["n"] for _, combination in planned(preparation)] == expected
    assert preparation.experiment is not None
    assert (preparation.experiment.model.seed, preparation.experiment.model.seed_is_given) == (42, True)


@pytest.mark.long
@pytest.mark.parametrize(
    "seeds",
    [
        "random.seed(int((pathlib.Path(__file__).parent / 'clock').read_text()))",
        pytest.param("random.seed(42)\nrandom.seed()", marks=pytest.mark.soak),
    ],
    ids=["of a clock", "none in the end"],
)
def test_an_order_by_a_seed_that_differs_each_time_is_gone_on_with_as_it_began(
    seeds: str, config: Callable[..., Path], execute: Callable[..., Executed]
) -> None:
    methods = """
    def interact(self, context):
        assert (Path(__file__).parent / "mended").exists() or context.execute_run["n"] < 10
"""
    path = config(methods, table=SHUFFLED)
    path.write_text(f"import pathlib, random\n{seeds}\n{path.read_text(encoding='utf-8')}", encoding="utf-8")
    (path.parent / "clock").write_text("1")
    begun = [row["n"] for row in execute(path).table]
    (path.parent / "clock").write_text("2")
    (path.parent / "mended").touch()
    executed = execute(path)
    assert [row["n"] for row in executed.table] == begun
    assert {row["__done"] for row in executed.table} == {"DONE"}
    assert not [warning for warning in executed.warnings if "order" in warning]


@pytest.mark.long
def test_a_factor_that_is_a_data_column_too_is_what_the_config_returns(
    config: Callable[..., Path], execute: Callable[..., Executed]
) -> None:
    """As in a published study, which applied treatments of its own and returned them."""
    table = """\
    def create_run_table_model(self):
        return RunTableModel(
            [FactorModel("governor", ["powersave", "performance"]), FactorModel("load", ["low"])],
            data_columns=["governor", "load", "energy"],
        )
"""
    methods = """
    def populate_run_data(self, context):
        print(repr(context.execute_run["governor"]))
        return {"governor": "ondemand", "load": context.run_nr % 2, "energy": context.run_nr}
    """
    executed = execute(config(methods, table=table))
    assert executed.text.splitlines() == [
        "__run_id,__done,governor,load,energy",
        "run_0_repetition_0,DONE,ondemand,1,1",
        "run_1_repetition_0,DONE,ondemand,0,2",
    ]
    assert executed.log("run_0_repetition_0").strip() == "' '"
    assert any("'governor' is a factor and a data column" in warning for warning in executed.warnings)


@pytest.mark.parametrize("shuffled", [True, False])
@pytest.mark.parametrize("returned", ["study", "study.generate_experiment_run_table()"])
def test_of_several_models_the_one_that_is_returned_tells_how_runs_are_ordered(
    config: Callable[..., Path], returned: str, shuffled: bool
) -> None:
    table = f"""
    def create_run_table_model(self):
        sizes, orders = FactorModel("size", [1, 2, 3, 4, 5]), FactorModel("order", ["random", "sorted"])
        study = RunTableModel([sizes, orders], shuffle={shuffled}, data_columns=["energy"])
        RunTableModel([sizes], shuffle={not shuffled}, data_columns=["time", "order"])
        return {returned}
    """
    experiment = prepare(config(table=table), {}).experiment
    assert experiment is not None
    model = experiment.model
    assert (model.shuffle, [each.name for each in model.factors]) == (shuffled, ["size", "order"])
    sizes = [run.combination["size"] for run in model.plan()]
    assert (sizes != sorted(sizes)) is shuffled


@pytest.mark.long
def test_rows_that_a_config_shuffles_itself_come_in_the_recorded_order(
    config: Callable[..., Path], execute: Callable[..., Executed]
) -> None:
    table = """\
    def create_run_table(self):
        import random
        rows = RunTableModel([FactorModel("n", list(range(20)))]).generate_experiment_run_table()
        random.shuffle(rows)
        return rows
"""
    path = config(table=table)
    order = [row["__run_id"] for row in execute(path).table]
    assert [run_id for run_id, _ in planned(prepare(path))] == order


@pytest.mark.long
def test_hooks_share_what_is_kept_on_self(config: Callable[..., Path], execute: Callable[..., Executed]) -> None:
    methods = """
    def before_experiment(self):
        self.base = 1000

    def before_run(self):
        self.prepared = 100

    def start_run(self, context):
        self.started = 10

    def interact(self, context):
        self.seen = context.execute_run["size"]

    def populate_run_data(self, context):
        return {"seconds": self.base + self.prepared + self.started + self.seen}
    """
    executed = execute(config(methods))
    assert [int(row["seconds"]) - int(row["size"]) for row in executed.table] == [1110] * 8


@pytest.mark.long
def test_hooks_are_called_in_the_order_of_the_tool(
    config: Callable[..., Path], execute: Callable[..., Executed]
) -> None:
    methods = """
    def start_run(self, context): print("start_run")
    def start_measurement(self, context): print("start_measurement")
    def interact(self, context): print("interact")
    def stop_measurement(self, context): print("stop_measurement")
    def stop_run(self, context): print("stop_run")
    def populate_run_data(self, context): print("populate_run_data")
    """
    said = execute(config(methods)).log("run_0_repetition_0").split()
    assert said == [
        "start_run",
        "start_measurement",
        "interact",
        "stop_measurement",
        "stop_run",
        "populate_run_data",
    ]


@pytest.mark.long
def test_the_context_has_both_names_of_the_row(config: Callable[..., Path], execute: Callable[..., Executed]) -> None:
    methods = """
    def start_run(self, context: RunnerContext):
        assert context.run_variation is context.execute_run
        context.run_variation["seconds"] = context.run_nr * 2
        (context.run_dir / "raw.txt").write_text(context.execute_run["__run_id"])
    """
    executed = execute(config(methods))
    assert [row["seconds"] for row in executed.table] == [str(2 * number) for number in range(1, 9)]
    assert (executed.folder / "run_3_repetition_1" / "raw.txt").read_text() == "run_3_repetition_1"


@pytest.mark.long
def test_a_factor_that_no_callback_looks_at_is_found(
    config: Callable[..., Path], execute: Callable[..., Executed]
) -> None:
    before = "def before_run(self): ...\n"
    looks = before + "def interact(self, context): self.seconds = context.execute_run['size'] / 10\n"
    returns = "def populate_run_data(self, context): return {'seconds': self.seconds}"
    (warning,) = execute(config(looks + returns)).warnings
    assert "looked at language" in warning
    assert "read context.combination['language'] in a callback" in warning
    both = looks.replace("10", "len(context.combination['language'])")
    assert not execute(config(both + returns), experiment_name="both").warnings


def test_a_factor_that_counts_the_runs_need_not_be_looked_at(
    config: Callable[..., Path], execute: Callable[..., Executed]
) -> None:
    table = """\
    def create_run_table_model(self):
        self.run_table_model = RunTableModel([FactorModel("run_number", ["r1", "r2"])], data_columns=["x"])
        return self.run_table_model
"""
    assert not execute(config("def populate_run_data(self, context): return {'x': 1}", table=table)).warnings


@pytest.mark.long
def test_experiment_path_is_set_before_anything_is_called(
    config: Callable[..., Path], execute: Callable[..., Executed]
) -> None:
    executed = execute(config("def after_experiment(self): (self.experiment_path / 'end.txt').write_text('!')"))
    assert (executed.folder / "end.txt").exists()
    assert executed.folder.parts[-2:] == ("experiments", "sorting")


@pytest.mark.long
def test_the_table_is_up_to_date_when_the_experiment_has_ended(
    config: Callable[..., Path], execute: Callable[..., Executed]
) -> None:
    head = RUNNER.replace(
        "from pathlib", "from ProgressManager.Output.CSVOutputManager import CSVOutputManager\nfrom pathlib"
    )
    methods = """
    def populate_run_data(self, context): return {"seconds": 7}
    def after_experiment(self):
        rows = CSVOutputManager(self.experiment_path).read_run_table()
        (self.experiment_path / "sum.txt").write_text(str(sum(row["seconds"] for row in rows)))
    """
    assert (execute(config(methods, head=head)).folder / "sum.txt").read_text() == "56"


def test_a_config_that_derives_from_the_tools_own_class_hears_what_it_overrides(
    write: Callable[..., Path], execute: Callable[..., Executed]
) -> None:
    path = write(
        """
        from ConfigValidator.Config.RunnerConfig import RunnerConfig as OriginalRunnerConfig
        from ConfigValidator.Config.Models.RunTableModel import RunTableModel
        from ConfigValidator.Config.Models.FactorModel import FactorModel

        class RunnerConfig(OriginalRunnerConfig):
            name = "derived"
            time_between_runs_in_ms = 0

            def create_run_table_model(self):
                self.run_table_model = RunTableModel([FactorModel("n", [1, 2])], data_columns=["square"])
                return self.run_table_model

            def populate_run_data(self, context):
                return {"square": context.execute_run["n"] ** 2}
        """
    )
    executed = execute(path)
    assert executed.folder == path.parent / "experiments" / "derived"
    assert [row["square"] for row in executed.table] == ["1", "4"]


@pytest.mark.long
def test_a_config_that_derives_from_another_config_file_replaces_its_callbacks(
    config: Callable[..., Path], write: Callable[..., Path], execute: Callable[..., Executed]
) -> None:
    config("def interact(self, context): print('base')", name="BaseRunnerConfig.py")
    derived = write(
        """
        from BaseRunnerConfig import *

        class RunnerConfig(RunnerConfig):
            name = "derived"

            def __init__(self):
                super().__init__()
                EventSubscriptionController.subscribe_to_single_event(RunnerEvents.INTERACT, self.other)

            def other(self, context):
                print("derived")
        """,
        "derived.py",
    )
    executed = execute(derived)
    assert executed.log("run_0_repetition_0") == "derived\n"
    assert list(executed.experiment.local_modules) == [derived.parent / "BaseRunnerConfig.py"]
    assert len(executed.table) == 8


@pytest.mark.long
def test_neighbours_can_be_imported_also_later(
    config: Callable[..., Path], write: Callable[..., Path], execute: Callable[..., Executed]
) -> None:
    write("def twice(n): return 2 * n", "modules_of_sorting/maths.py")
    write(
        "from ProgressManager.Output.OutputProcedure import OutputProcedure as output\n"
        "def say(text): output.console_log_OK(text)\n",
        "modules_of_sorting/words.py",
    )
    head = RUNNER.replace("from pathlib", "from modules_of_sorting.maths import twice\nfrom pathlib")
    methods = """
    def interact(self, context):
        from modules_of_sorting.words import say
        from ProgressManager.RunTable.Models.RunProgress import RunProgress
        say(f"later {RunProgress.TODO.name}")

    def populate_run_data(self, context): return {"seconds": twice(21)}
    """
    executed = execute(config(methods, head=head))
    assert {row["seconds"] for row in executed.table} == {"42"}
    assert executed.log("run_0_repetition_0") == "later TODO\n"


@pytest.mark.long
def test_the_modules_of_the_tool_are_gone_afterwards(
    config: Callable[..., Path], execute: Callable[..., Executed]
) -> None:
    execute(config("def before_run(self): import ProgressManager.RunTable.Models.RunProgress"))
    assert [name for name in sys.modules if name.split(".")[0] in {"EventManager", "ConfigValidator"}] == []
    with pytest.raises(ModuleNotFoundError):
        __import__("EventManager.EventSubscriptionController")


def test_a_module_of_the_users_own_with_such_a_name_comes_back(
    config: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    own = type(sys)("EventManager")
    monkeypatch.setitem(sys.modules, "EventManager", own)
    assert prepare(config()).experiment is not None
    assert sys.modules["EventManager"] is own


def test_an_event_of_a_run_looks_only_at_modules_of_the_earlier_tools(
    config: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    experiment = prepare(config("def start_run(self, context): ...")).experiment
    assert experiment is not None

    def looked_at(module: str) -> bool:
        raise AssertionError(f"{module} was looked at: with a thousand modules, that is milliseconds for each event")

    monkeypatch.setattr(stand_in_modules, "is_earlier_import", looked_at)
    with experiment.config.executing_nothing():
        assert "EventManager.Models.RunnerEvents" in sys.modules
    assert "EventManager.Models.RunnerEvents" not in sys.modules


def test_objects_are_treatments_with_their_text(config: Callable[..., Path], execute: Callable[..., Executed]) -> None:
    table = """\
    def create_run_table_model(self):
        class Level:
            def __init__(self, n): self.n = n
            def __str__(self): return f"level {self.n}"
        one, two = Level(1), Level(2)
        levels = FactorModel("level", [one, two])
        self.run_table_model = RunTableModel([levels], exclude_combinations=[{levels: [one]}], data_columns=["n"])
        return self.run_table_model

    def populate_run_data(self, context):
        return {"n": context.execute_run["level"].n}
"""
    executed = execute(config(table=table, subscribe="(RunnerEvents.POPULATE_RUN_DATA, self.populate_run_data),"))
    assert [(row["level"], row["n"]) for row in executed.table] == [("level 2", "2")]


def test_a_treatment_without_a_text_of_its_own_is_shown_by_its_name(
    config: Callable[..., Path], execute: Callable[..., Executed]
) -> None:
    table = """\
    def create_run_table_model(self):
        self.run_table_model = RunTableModel([FactorModel("sort", [quick, bubble])], data_columns=["n"])
        return self.run_table_model

    def populate_run_data(self, context):
        return {"n": context.execute_run["sort"]([3, 1])[0]}

def quick(numbers): return sorted(numbers)
def bubble(numbers): return sorted(numbers, reverse=True)
"""
    executed = execute(config(table=table, subscribe="(RunnerEvents.POPULATE_RUN_DATA, self.populate_run_data),"))
    assert [(row["sort"], row["n"]) for row in executed.table] == [("quick", "1"), ("bubble", "3")]


def test_a_model_that_is_kept_and_not_returned_is_found(config: Callable[..., Path]) -> None:
    table = """\
    def create_run_table_model(self):
        self.run_table_model = RunTableModel([FactorModel("n", [1, 2])])
"""
    assert len(planned(prepare(config(table=table)))) == 2


def test_columns_that_are_appended_to_the_model_are_columns(config: Callable[..., Path]) -> None:
    table = """\
    def create_run_table_model(self):
        model = RunTableModel([FactorModel("n", [1, 2])], data_columns=["a"])
        model.get_data_columns().append("b")
        return model
"""
    assert prepare(config(table=table)).experiment.model.data_columns == ("a", "b")


@pytest.mark.long
def test_an_attribute_of_its_own_that_a_config_sets_on_the_context_is_no_misspelling(
    config: Callable[..., Path], execute: Callable[..., Executed]
) -> None:
    methods = """
    def start_run(self, context): context.run_dirs = [context.run_dir]
    def populate_run_data(self, context): return {"seconds": len(context.run_dirs)}
    """
    assert {row["seconds"] for row in execute(config(methods)).table} == {"1"}
