"""What public forks of the earlier tools added."""

from __future__ import annotations

from collections import Counter
from random import Random
from typing import TYPE_CHECKING

import pytest
from tests.legacy.earlier_configs import ROBOT, RUNNER, planned, problems
from tests.long_cases import soak_but

from robot_runner.core.config.preparation import prepare

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from tests.legacy.earlier_configs import Executed

REPEATED = """\
    def create_run_table(self):
        run_table = RunTableModel(
            factors=[FactorModel("arena", ["circle", "line"])],
            data_columns=["energy"],
            num_of_repetitions=3,
            randomize_order={shuffled},
        )
        run_table.create_experiment_run_table()
        return run_table.get_experiment_run_table()
"""


def test_repetitions_of_a_fork_stand_together_and_have_a_column(config: Callable[..., Path]) -> None:
    assert planned(prepare(config(head=ROBOT, table=REPEATED.format(shuffled=False)))) == [
        ("run_1", {"arena": "circle", "repetition": 1}),
        ("run_2", {"arena": "circle", "repetition": 2}),
        ("run_3", {"arena": "circle", "repetition": 3}),
        ("run_4", {"arena": "line", "repetition": 1}),
        ("run_5", {"arena": "line", "repetition": 2}),
        ("run_6", {"arena": "line", "repetition": 3}),
    ]


def test_a_randomised_order_of_a_fork_counts_ids_and_repetitions_as_they_come(
    config: Callable[..., Path], execute: Callable[..., Executed]
) -> None:
    path = config(head=ROBOT, table=REPEATED.format(shuffled=True))
    executed = execute(path)
    assert executed.text.startswith("__run_id,__done,arena,repetition,energy\nrun_1,DONE,")
    assert [row["__run_id"] for row in executed.table] == [f"run_{number}" for number in range(1, 7)]
    seen: Counter[str] = Counter()
    for row in executed.table:
        seen[row["arena"]] += 1
        assert row["repetition"] == str(seen[row["arena"]])
    assert [run["arena"] for _, run in planned(prepare(path))] == [row["arena"] for row in executed.table]


@pytest.mark.parametrize("repetitions", [1, 2])
def test_a_fork_that_seeds_its_order_gets_the_order_of_the_fork(repetitions: int, config: Callable[..., Path]) -> None:
    table = REPEATED.format(shuffled=True).replace('["circle", "line"]', "list(range(9))")
    path = config(head=ROBOT, table=table.replace("num_of_repetitions=3", f"num_of_repetitions={repetitions}"))
    path.write_text("import random\nrandom.seed(42)\n" + path.read_text(encoding="utf-8"), encoding="utf-8")
    drawn = Random(42)  # noqa: S311 - what the fork does: it samples where nothing is repeated, else it shuffles
    expected = [arena for arena in range(9) for _ in range(repetitions)]
    if repetitions == 1:
        expected = drawn.sample(expected, 9)
    else:
        drawn.shuffle(expected)
    assert [combination["arena"] for _, combination in planned(prepare(path))] == expected


def test_without_repetitions_a_fork_has_no_column_for_them(config: Callable[..., Path]) -> None:
    table = REPEATED.format(shuffled=False).replace("num_of_repetitions=3", "num_of_repetitions=1")
    assert planned(prepare(config(head=ROBOT, table=table))) == [
        ("run_1", {"arena": "circle"}),
        ("run_2", {"arena": "line"}),
    ]


@pytest.mark.long
def test_before_run_may_take_the_context_or_the_row(
    config: Callable[..., Path], execute: Callable[..., Executed]
) -> None:
    for parameter, expression in (
        ("context", "context.run_variation['task']"),
        ("run_variation", "run_variation['task']"),
    ):
        executed = execute(
            config(f"def before_run(self, {parameter}): print({expression})", head=ROBOT), experiment_name=parameter
        )
        assert executed.log("run_3") == "map\n"


def test_several_callbacks_of_one_event_are_all_called(
    config: Callable[..., Path], execute: Callable[..., Executed]
) -> None:
    table = """\
    def create_run_table_model(self):
        return RunTableModel([FactorModel("n", [1])], data_columns=["a", "b"])

    def first(self, context): return {"a": 1}
    def second(self, context): return {"b": 2}
"""
    subscribe = "(RunnerEvents.POPULATE_RUN_DATA, self.first), (RunnerEvents.POPULATE_RUN_DATA, self.second),"
    executed = execute(config(table=table, subscribe=subscribe))
    assert executed.text.splitlines()[1] == "run_0_repetition_0,DONE,1,1,2"
    problem = "two callbacks subscribe to POPULATE_RUN_DATA: first and second"
    assert any(problem in warning for warning in executed.warnings)


def test_a_fork_subscribes_lists_of_callbacks(config: Callable[..., Path], execute: Callable[..., Executed]) -> None:
    table = """\
    def create_run_table(self):
        run_table = RunTableModel([FactorModel("n", [1])], data_columns=["a", "b"])
        run_table.create_experiment_run_table()
        return run_table.get_experiment_run_table()

    def first(self, context): return {"a": 1}
    def second(self, context): return {"b": 2}
    def go(self, context): print("going")
"""
    subscribe = (
        "(RobotRunnerEvents.POPULATE_RUN_DATA, [self.first, self.second]), (RobotRunnerEvents.START_RUN, [self.go]),"
    )
    path = config(head=ROBOT, table=table, subscribe=subscribe)
    path.write_text(
        path.read_text().replace("subscribe_to_multiple_events(", "subscribe_to_multiple_events_multiple_callbacks(", 1)
    )
    executed = execute(path)
    assert executed.text.splitlines()[1] == "run_0,DONE,1,1,2"
    assert executed.log("run_0") == "going\n"
    assert executed.warnings == []


def test_each_of_a_list_of_callbacks_must_be_callable(config: Callable[..., Path]) -> None:
    path = config("def go(self, context): ...", subscribe="(RunnerEvents.START_RUN, [self.go, 'self.go']),")
    assert "the callback of START_RUN is 'self.go', which cannot be called" in problems(prepare(path))[0]


@pytest.mark.long
@pytest.mark.parametrize(
    "tool",
    soak_but({"robot-runner", ""}, ["experiment-runner", "robot-runner", "", "experiment-runner/experiment-runner"]),
)
def test_a_plugin_of_a_forks_own_is_found_in_its_clone(
    config: Callable[..., Path], write: Callable[..., Path], execute: Callable[..., Executed], tool: str
) -> None:
    write("class Meter:\n    def read(self): return 4.5\n", f"clone/{tool}/Plugins/Profilers/ForkMeter.py")
    head = RUNNER.replace("from pathlib", "from Plugins.Profilers.ForkMeter import Meter\nfrom pathlib")
    path = config(
        "def populate_run_data(self, context): return {'seconds': Meter().read()}",
        head=head,
        name="clone/experiments/meter/RunnerConfig.py",
    )
    assert {row["seconds"] for row in execute(path).table} == {"4.5"}


@pytest.mark.long
def test_what_a_fork_added_to_a_module_of_the_tool_comes_from_its_clone(
    config: Callable[..., Path], write: Callable[..., Path], execute: Callable[..., Executed]
) -> None:
    write(
        "from Plugins.Profilers.DataSource import CLISource\n"
        "class WattsUpPro(CLISource): own = True\n"
        "def run_for(seconds): return seconds * 2\n",
        "clone/experiment-runner/Plugins/Profilers/WattsUpPro.py",
    )
    head = RUNNER.replace("from pathlib", "from Plugins.Profilers.WattsUpPro import WattsUpPro, run_for\nfrom pathlib")
    body = "return {'seconds': run_for(2) + hasattr(WattsUpPro, 'own')}"
    methods = f"def populate_run_data(self, context): {body}"
    assert {row["seconds"] for row in execute(config(methods, head=head, name="clone/run/RunnerConfig.py")).table} == {
        "4"
    }


def test_of_a_clone_the_modules_of_its_own_are_kept_and_none_of_the_tool(
    config: Callable[..., Path], write: Callable[..., Path]
) -> None:
    tool = "clone/experiment-runner"
    table = "import ConfigValidator.Config.Models.FactorModel\n"
    write(table, f"{tool}/ConfigValidator/Config/Models/RunTableModel.py")
    write("class FactorModel: ...\n", f"{tool}/ConfigValidator/Config/Models/FactorModel.py")
    write("class WattsUpPro: own = True\n\ndef run_for(seconds): ...\n", f"{tool}/Plugins/Profilers/WattsUpPro.py")
    write("class PowerJoular: ...\n", f"{tool}/Plugins/Profilers/PowerJoular.py")
    write("", f"{tool}/__main__.py")
    write("class Meter: ...\n", f"{tool}/Plugins/Profilers/ForkMeter.py")
    imported = (
        "from Plugins.Profilers.ForkMeter import Meter\n"
        "from Plugins.Profilers.WattsUpPro import run_for\n"
        "from Plugins.Profilers.PowerJoular import PowerJoular\n"
    )
    path = config(head=RUNNER.replace("from pathlib", f"{imported}from pathlib"), name="clone/run/RunnerConfig.py")
    experiment = prepare(path, is_for_here=False).experiment
    assert experiment is not None
    kept = {place.as_posix() for place in experiment.local_modules.values()}
    assert kept == {"Plugins/Profilers/ForkMeter.py", "Plugins/Profilers/WattsUpPro.py"}


def test_an_event_that_a_fork_added_is_told_apart_from_a_misspelt_one(
    config: Callable[..., Path], write: Callable[..., Path]
) -> None:
    write("", "clone/experiment-runner/ConfigValidator/__init__.py")
    write("class RunnerEvents: CALIBRATE = 11\n", "clone/experiment-runner/EventManager/Models/RunnerEvents.py")
    subscribe = "(RunnerEvents.CALIBRATE, self.go), (RunnerEvents.STAR_RUN, self.go),"
    path = config("def go(self, context): ...", subscribe=subscribe, name="clone/run/RunnerConfig.py")
    (added, misspelt) = problems(prepare(path))
    assert "no event 'CALIBRATE' → The fork whose clone this is raised it itself" in added
    assert "no event 'STAR_RUN' → Did you mean 'START_RUN'?" in misspelt


def test_a_name_that_neither_tool_nor_clone_has_is_refused_with_its_line(
    config: Callable[..., Path], write: Callable[..., Path]
) -> None:
    write("class PowerJoular: ...\n", "clone/experiment-runner/Plugins/Profilers/PowerJoular.py")
    head = RUNNER.replace("from pathlib", "from Plugins.Profilers.PowerJoular import PowerJoule\nfrom pathlib")
    path = config(head=head, name="clone/run/RunnerConfig.py")
    assert problems(prepare(path)) == [
        f"{path}:7: Plugins.Profilers.PowerJoular has no 'PowerJoule' → Did you mean 'PowerJoular'?"
    ]


@pytest.mark.parametrize(
    ("made", "ids"),
    [
        ("f'run_{i}'", ["run_0", "run_1"]),
        ("f'run_{i + 1}'", ["run_1", "run_2"]),
        ('f"run_{i}_repetition_{j}"', ["run_0_repetition_0", "run_1_repetition_0"]),
        ("f'run_{i}_iteration_{j}'", ["run_0_iteration_0", "run_1_iteration_0"]),
        ("str(i)", ["run_0_repetition_0", "run_1_repetition_0"]),
    ],
)
def test_runs_are_numbered_as_the_tool_does_whose_clone_the_config_stands_in(
    config: Callable[..., Path], write: Callable[..., Path], made: str, ids: list[str]
) -> None:
    write(
        f"class RunTableModel:\n    def rows(self, i, j): return {made}\n",
        "clone/experiment-runner/ConfigValidator/Config/Models/RunTableModel.py",
    )
    table = "    def create_run_table_model(self): return RunTableModel([FactorModel('n', [1, 2])])\n"
    path = config(table=table, name="clone/examples/RunnerConfig.py")
    assert [run_id for run_id, _ in planned(prepare(path))] == ids


@pytest.mark.long
def test_a_profiler_derived_from_the_tools_own_class_measures(
    config: Callable[..., Path], execute: Callable[..., Executed]
) -> None:
    head = RUNNER.replace(
        "from pathlib", "from Plugins.Profilers.DataSource import CLISource, ParameterDict\nfrom pathlib"
    ).replace(
        "class RunnerConfig",
        """class Counter(CLISource):
    parameters = ParameterDict({("-u",): None})
    source_name = "sh"
    supported_platforms = ["Linux", "Darwin"]

    def __init__(self, file):
        super().__init__()
        self.logfile = file
        self.args = {"-u": None}

    def _format_cmd(self):
        return f"{super()._format_cmd()} -c 'echo 1,2 >> {self.logfile}; exec sleep 60'"

    @staticmethod
    def parse_log(logfile):
        return logfile.read_text().strip().split(",")


class RunnerConfig""",
    )
    methods = """
    def start_measurement(self, context):
        self.meter = Counter(context.run_dir / "counter.csv")
        self.meter.start()
        for _ in range(3000):  # a minute at most
            if self.meter.logfile.exists() and self.meter.logfile.read_text():
                break
            __import__("time").sleep(0.02)
    def stop_measurement(self, context): self.meter.stop()
    def populate_run_data(self, context): return {"seconds": int(self.meter.parse_log(self.meter.logfile)[1])}
    """
    executed = execute(config(methods, head=head))
    assert {row["seconds"] for row in executed.table} == {"2"}


def test_a_derived_profiler_refuses_a_parameter_that_it_does_not_know(config: Callable[..., Path]) -> None:
    head = RUNNER.replace("from pathlib", "from Plugins.Profilers.Ps import Ps\nfrom pathlib")
    table = """\
    def create_run_table_model(self):
        Ps(additional_args={"--foramt": "x"})
"""
    assert any(
        "'ps' has no parameter" in problem or "ps has no parameter '--foramt'" in problem
        for problem in problems(prepare(config(head=head, table=table)))
    )


def test_a_fork_may_import_under_a_guard_what_is_not_there(config: Callable[..., Path]) -> None:
    guard = "try:\n    from Plugins.Profilers.ForkOnly import Meter\nexcept ImportError:\n    Meter = None\n"
    head = RUNNER.replace("from pathlib", f"{guard}from pathlib", 1)
    assert prepare(config(head=head)).experiment is not None


@pytest.mark.long
@pytest.mark.parametrize("tool", ["experiment-runner", "robot-runner/robot-runner"])
def test_what_stands_beside_the_main_file_of_a_clone_is_importable(
    config: Callable[..., Path], write: Callable[..., Path], execute: Callable[..., Executed], tool: str
) -> None:
    write("", f"clone/{tool}/__main__.py")
    write("", f"clone/{tool}/Plugins/__init__.py")
    write("def doubled(seconds): return seconds * 2\n", f"clone/{tool}/fork_{len(tool)}_helpers.py")
    head = RUNNER.replace("from pathlib", f"from fork_{len(tool)}_helpers import doubled\nfrom pathlib")
    methods = "def populate_run_data(self, context): return {'seconds': doubled(4)}"
    path = config(methods, head=head, name="clone/experiments/study/RunnerConfig.py")
    executed = execute(path)
    assert {(row["__done"], row["seconds"]) for row in executed.table} == {("DONE", "8")}, executed.finished.failures


@pytest.mark.long
def test_an_event_at_which_a_fork_validated_is_heard_before_the_experiment(
    config: Callable[..., Path], execute: Callable[..., Executed], tmp_path: Path
) -> None:
    methods = """\
        def note(self, word):
            with (self.ROOT_DIR / "order").open("a") as file:
                file.write(word + " ")

        def before_experiment(self): self.note("before")

        def validate(self): self.note("validated")
    """
    path = config(methods, subscribe="(RunnerEvents.VALIDATE_EXPERIMENT, self.validate),")
    said = " ".join(finding.problem for finding in prepare(path).findings)
    assert "this event is a fork's own: its callback is called at before_experiment" in said
    execute(path)
    assert (tmp_path / "order").read_text().split() == ["validated", "before"]


def test_who_only_parses_a_log_needs_no_program_and_who_measures_does(config: Callable[..., Path]) -> None:
    head = RUNNER.replace("from pathlib", "from Plugins.Profilers.EnergiBridge import EnergiBridge\nfrom pathlib")
    parsing = config("def populate_run_data(self, context): return EnergiBridge.parse_log('e.csv')", head=head)
    assert problems(prepare(parsing)) == []
    measuring = "def start_run(self, context): self.meter = EnergiBridge(target_program='sleep 1')"
    assert "needs the program energibridge" in "".join(problems(prepare(config(measuring, head=head))))


@pytest.mark.parametrize(("kind", "name"), [("factor", "__done"), ("factor", "__run_id"), ("measure", "__done")])
def test_a_name_of_the_tools_own_columns_is_refused_instead_of_lost(
    config: Callable[..., Path], kind: str, name: str
) -> None:
    factors = f'[FactorModel("size", [1, 2]){f""", FactorModel("{name}", [3, 4])""" if kind == "factor" else ""}]'
    columns = f"['{name}']" if kind == "measure" else "['seconds']"
    table = f"    def create_run_table_model(self):\n        return RunTableModel({factors}, data_columns={columns})\n"
    (said,) = problems(prepare(config(table=table)))
    assert f"a {kind} is named {name!r}, which is the tool's own column: it would be lost" in said
    assert f"Name it {name.strip('_')!r}." in said


def test_the_first_of_two_errors_is_told(config: Callable[..., Path], write: Callable[..., Path]) -> None:
    head = RUNNER.replace(
        "class RunnerConfig", "try:\n    {}['rate']\nexcept KeyError:\n    print(undefined)\n\n\nclass RunnerConfig"
    )
    (said,) = problems(prepare(config(head=head)))
    assert "NameError while it was loaded: name 'undefined' is not defined (after KeyError: 'rate')" in said
