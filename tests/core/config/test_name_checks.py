"""Names of a config that nothing uses though they look like ours, that nothing defines, or that nothing publishes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from tests.conftest import HEAD

from robot_runner.core.config.preparation import prepare

Write = Callable[..., Path]

# Names that look like an event or a parameter, and that nothing uses.


def warnings(config: Path) -> dict[str, str]:
    found = prepare(config).findings
    assert not any(finding.is_error for finding in found), found
    return {finding.where.rpartition(".")[2]: f"{finding.problem} → {finding.fix}" for finding in found}


def test_what_an_earlier_tool_or_a_guess_calls_it_is_told_with_what_to_use(write_config: Write) -> None:
    body = """
    retries = 3
    cooldown: int = 30
    repetitions: int
    def after_run(self): ...
    def interact(self, context): ...
    def start_mission(self): ...
    def beforeEachRun(self): ...
    def end_of_the_mission(self): ...
    def on_end_measurements(self): ...
    """
    found = warnings(write_config(body))
    assert set(found) == {
        "after_run", "beforeEachRun", "cooldown", "interact", "on_end_measurements", "repetitions", "retries",
        "start_mission",
    }  # fmt: skip
    assert found["retries"].startswith("nothing reads this attribute → Use attempts")
    assert found["after_run"] == (
        "nothing calls this method → Call it stop_run, or populate_run_data where it returns measures."
    )
    assert found["interact"].endswith("→ Call it launch_mission.")
    assert found["start_mission"].endswith("→ Call it launch_mission.")
    assert found["cooldown"].endswith("→ Call it time_between_runs_in_ms.")
    assert "did you mean 'stop_measurement'?" in found["on_end_measurements"]


def test_a_guess_with_a_unit_of_time_is_told_like_one_without(write_config: Write) -> None:
    found = warnings(write_config("run_timeout_in_s = 60\ncooldown_ms = 500\nmax_duration_seconds: float = 3.0"))
    assert {name: said.partition("→ ")[2] for name, said in found.items()} == {
        "run_timeout_in_s": "Use run_deadline_in_s, or event_deadline_in_s.",
        "cooldown_ms": "Call it time_between_runs_in_ms.",
        "max_duration_seconds": "Use run_deadline_in_s, or event_deadline_in_s.",
    }


def test_what_the_design_or_the_plan_of_the_analysis_takes_is_told_where_to_give_it(write_config: Write) -> None:
    """As an attribute of the config a warm-up would be none, and nobody would notice."""
    design = {"warm_up": "2", "blocks": "'Day'", "exclude_combinations": "[]", "design": "None"}
    plan = {"hypotheses": "[]", "covariates": "['V']", "alpha": "0.01"}
    found = warnings(write_config("\n".join(f"{name} = {value}" for name, value in (design | plan).items())))
    assert {name: said.partition("→ ")[2] for name, said in found.items()} == {
        "warm_up": "Give it to RunTableModel: warm_up=...",
        "blocks": "Give it to RunTableModel: blocks=...",
        "exclude_combinations": "Give it to RunTableModel: exclude_combinations=...",
        "design": "Give it to RunTableModel: design=...",
        **dict.fromkeys(plan, "Give it to the plan of the analysis: analysis = AnalysisPlan(...)."),
    }


def test_a_duration_that_is_no_method_is_told_how_to_say_it(write_config: Write) -> None:
    found = warnings(write_config("duration_s = 60"))
    assert found == {
        "duration_s": "nothing reads this attribute → Make it a method: def duration_s(self, combination): return 60."
    }
    assert not warnings(write_config("def duration_s(self, combination): return 60"))
    assert not warnings(write_config("duration_s = lambda self, combination: 60"))


@pytest.mark.parametrize(
    "body",
    [
        "def after_run(self): ...\ndef stop_run(self): self.after_run()",
        "retries = 3\ndef start_run(self): print(self.retries)",
        "def interact(self): ...\ndef start_run(self): getattr(self, 'interact')()",
        "def interact(self): ...\ndef start_run(self): getattr(self, self.experiment_name, print)()",
        "def start_mission(self): ...\ndef __init__(self): self.handlers = [self.start_mission]",
        "seed = 3\nother = seed + 1",
        "@registered\ndef teardown(self): ...",
        "def start_camera(self): ...\ndef stop_robot(self): ...\ndef run_script(self): ...\nspeed = 3\nfloor = 'wood'",
        "def _interact(self): ...\n_retries = 3",
    ],
)
def test_what_a_config_uses_itself_or_calls_by_its_own_words_is_no_false_alarm(write_config: Write, body: str) -> None:
    assert warnings(write_config(body, head=f"registered = print\n{HEAD}".replace("= print", "= lambda it: it"))) == {}


def test_what_a_neighbour_or_a_base_class_of_a_package_calls_is_in_use(write_config: Write, tmp_path: Path) -> None:
    (tmp_path / "neighbour.py").write_text(
        "import unittest\ndef drive(config): config.start_mission()\n", encoding="utf-8"
    )
    head = "import neighbour, unittest\n" + HEAD.replace("(ExperimentConfig)", "(ExperimentConfig, unittest.TestCase)")
    body = "def start_mission(self): ...\ndef setUp(self): ...\ndef tearDown(self): ..."
    assert warnings(write_config(body, head=head)) == {}


def test_what_a_base_class_of_a_package_calls_in_a_function_of_a_method_is_in_use(
    write_config: Write, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Lab:
        @classmethod
        def all_robots(cls) -> None:
            def each(config: Any) -> None:
                config.start_mission()

    monkeypatch.setattr("unittest.Lab", Lab, raising=False)
    head = "import unittest\n" + HEAD.replace("(ExperimentConfig)", "(ExperimentConfig, unittest.Lab)")
    assert warnings(write_config("def start_mission(self): ...", head=head)) == {}


def test_a_subscription_uses_its_method(write_config: Write) -> None:
    body = """
    def __init__(self):
        EventSubscriptionController.subscribe_to_multiple_events([(RobotRunnerEvents.LAUNCH_MISSION, self.interact)])
    def interact(self, context): ...
    """
    assert warnings(write_config(body)) == {}


def errors(config: Path) -> list[tuple[str, str, str]]:
    found = [finding for finding in prepare(config).findings if finding.is_error]
    return [(each.where.rpartition(":")[2], each.problem, each.fix) for each in found]


def test_an_event_that_stands_outside_of_the_class_is_refused(write_config: Write) -> None:
    """A wrong indentation: nothing called it, and nothing said so."""
    body = """
    def start_run(self, context):
        if True:
            def launch_mission(self, context): ...
    """
    path = write_config(body)
    path.write_text(path.read_text() + "\n\ndef before_run(self, context): ...\n")
    lines = path.read_text().splitlines()
    fix = "Indent it as the other methods of RobotRunnerConfig are."
    assert errors(path) == [
        (str(number), f"{name} stands outside of the config class, where nothing calls it", fix)
        for number, line in enumerate(lines, 1)
        for name in ("before_run", "launch_mission")
        if f"def {name}" in line
    ]


def test_a_function_of_an_events_name_that_something_calls_may_stand_anywhere(write_config: Write) -> None:
    head = """
from robot_runner import *
def before_run(self, context): ...
def start_run(context): ...
class Helper:
    if True:
        def stop_run(self): ...
class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "trial"
    before_run = before_run
"""
    assert not errors(write_config(head=head))


@pytest.mark.parametrize("value", ["1000", "OperationType.SEMI", "[PsUtil()]", "-1", "Path('results')"])
def test_a_value_behind_a_colon_is_refused(write_config: Write, value: str) -> None:
    """Nothing read it: with `time_between_runs_in_ms: 60_000`, as in YAML, no robot cooled down."""
    head = """
from __future__ import annotations
from pathlib import Path
from robot_runner import *
class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "trial"
"""
    path = write_config(f"time_between_runs_in_ms: {value}", head=head)
    problem = "the colon makes it an annotation, which gives no value"
    assert errors(path) == [("8", f"time_between_runs_in_ms: {problem}", f"Write time_between_runs_in_ms = {value}.")]


def test_a_parameter_may_be_annotated_without_a_value(write_config: Write) -> None:
    body = "time_between_runs_in_ms: int\nrobot: str | None\noperation_type: OperationType\nnotes: 5"
    assert not errors(write_config(body))


def test_a_value_behind_a_colon_is_refused_in_the_config_class_and_its_bases_alone(write_config: Write) -> None:
    head = """
from __future__ import annotations
from robot_runner import *
class Profile:
    plugins: [str]
    robot: dict(kind="x")
def helper():
    robot: Robot("x")
class Lab(ExperimentConfig):
    attempts: 3
class RobotRunnerConfig(Lab):
    experiment_name = "trial"
    class Motor:
        notify: [str]
"""
    assert errors(write_config("def start_run(self):\n        robot: Robot('x')", head=head)) == [
        ("10", "attempts: the colon makes it an annotation, which gives no value", "Write attempts = 3.")
    ]


# Names that the code reads, and that nothing defines.


def undefined(config: Path) -> list[tuple[str, str, str]]:
    found = prepare(config).findings
    return [(each.where, each.problem, each.fix) for each in found if "nothing defines" in each.problem]


def test_a_name_that_is_not_defined_is_told_before_a_run_has_to_fail_of_it(write_config: Write) -> None:
    """The experiment could be executed, it said, and each run failed: after its mission, if `stop_run` read it."""
    body = """
    def launch_mission(self, context):
        time.sleep(1)
    def stop_run(self, context):
        print([contxt.run_id for _ in "ab"])
    """
    path = write_config(body)
    read = {word: number for number, line in enumerate(path.read_text().splitlines(), 1) for word in line.split()}
    assert undefined(path) == [
        (
            f"{path}:{read['time.sleep(1)']}",
            "nothing defines the name 'time', which launch_mission reads",
            "Import it: import time",
        ),
        (
            f"{path}:{read['print([contxt.run_id']}",
            "nothing defines the name 'contxt', which stop_run reads",
            "Did you mean 'context'?",
        ),
    ]


def test_a_name_that_the_run_table_lacks_is_told_once(write_config: Write) -> None:
    table = "    def create_run_table(self):\n        return RunTableModel([Faktor('Task', [1])])\n"
    found = [each for each in prepare(write_config(table=table)).findings if "Faktor" in each.problem]
    assert [(each.is_error, each.fix) for each in found] == [(True, "Did you mean 'Factor'?")]


def test_a_parameter_that_a_function_lacks_is_told(write_config: Write) -> None:
    body = """
    def start_run(self, context):
        self.go()
    def go():
        print(context.run_id)
    """
    assert [fix for *_, fix in undefined(write_config(body))] == ["Make it a parameter of go."]


def test_a_name_that_is_not_defined_in_a_neighbour_is_told_with_its_file(write_config: Write, tmp_path: Path) -> None:
    neighbour = tmp_path / "neighbour_with_a_slip.py"
    neighbour.write_text("def far():\n    return math.inf\n")
    head = """
from robot_runner import *
from neighbour_with_a_slip import far
class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "trial"
"""
    assert [where for where, *_ in undefined(write_config(head=head))] == [f"{neighbour}:2"]


@pytest.mark.parametrize(
    "code",
    [
        "global made\n        made = 1",
        "print(made_later, __file__, __name__)",
        "try:\n            unicode\n        except NameError:\n            pass",
        "import math\n        print(math.pi)",
        "def inner() -> int:\n            return inner()",
        "print(sorted([2, 1], key=lambda number: -number))",
        "print(super().experiment_name, __class__)",
    ],
)
def test_a_name_that_is_defined_by_the_time_it_is_read_is_not_told(write_config: Write, code: str) -> None:
    path = write_config(f"def start_run(self, context):\n        {code}\n    def stop_run(self):\n        print(made)")
    path.write_text(path.read_text() + "\n\nmade_later = made = 1\n")
    assert undefined(path) == []


# Measures that a config declares and that nothing publishes.

TABLE = """\
    def create_run_table(self):
        return RunTableModel([Factor("Task", ["Video"])], data_columns=["Accuracy", Measure("Score", "1", "Points.")])
"""

#: A callback that publishes one of them.
ACCURACY = 'def populate_run_data(self, context): return {"Accuracy": 1}'

#: A decorator as many have it, which calls a method with whatever it is given.
TIMED = "def timed(method):\n    def waited(*given): return method(*given)\n    return waited"


def unpublished(config: Path) -> list[str]:
    found = prepare(config).findings
    assert not any(finding.is_error for finding in found), found
    return [f"{each.problem} → {each.fix}" for each in found if each.problem.startswith("nothing publishes")]


def test_a_measure_that_no_callback_publishes_is_told(write_config: Write) -> None:
    body = """
    def populate_run_data(self, context):
        return {"Accuracy": 0.5}
    """
    assert unpublished(write_config(body, table=TABLE)) == [
        "nothing publishes 'Score': it stays empty → Return it from populate_run_data, or leave it out of data_columns."
    ]


def test_it_is_told_with_the_name_of_an_undeclared_one_that_is_published(write_config: Write) -> None:
    body = """
    def launch_mission(self, context):
        context.publish("Accuracy", 0.5)
        context.publish("Scores", 3)
    """
    (told,) = unpublished(write_config(body, table=TABLE))
    assert "Did you mean 'Scores'?" in told


@pytest.mark.parametrize(
    "body",
    [
        'def populate_run_data(self, context): return {"Accuracy": 0.5, "Score": None}',
        'def populate_run_data(self, context): return {"Accuracy": 0.5, **self.found()}\ndef found(self): return {}',
        'def populate_run_data(self, context):\n    found = {"Accuracy": 0.5}\n    return found',
        'def launch_mission(self, context):\n    for each in self.names: context.publish(each, 1)\nnames = "Accuracy",',
        f"{ACCURACY}\ndef stop_run(self, context): self.finish(context)\ndef finish(self, context): ...",
        f'{ACCURACY}\ndef stop_run(self, context): publish = context.publish; publish("Score", 1)',
        f"{ACCURACY}\ndef start_run(self, context): self.context = context\ndef stop_run(self): finish(self.context)",
        f"{ACCURACY}\ndef start_run(self, context): self.context: object = context",
        f"{ACCURACY}\ndef start_run(self, context): print(now := context)",
        "def launch_mission(self, context): ...",  # publishes nothing so far
        f"launch_mission = print\n{ACCURACY}",
        'populate_run_data = lambda self: found()\ndef stop_run(self, context): context.publish("Accuracy", 1)',
        f'names = ("Accuracy", "Score")\n{ACCURACY}',
        f"{ACCURACY}\ndef start_run(self, context): Thread(target=shelf.poll, args=(context,)).start()",
        f"{ACCURACY}\ndef start_run(self, context): shelf.poll(*[context], **{{'to': context}})",
        f"{ACCURACY}\ndef start_run(self, context): self.before, self.context = None, context",
        f"{ACCURACY}\ndef start_run(self, context): self.kept = {{'context': context}}",
        f"{ACCURACY}\ndef start_run(self, context): self.contexts += [context]\ncontexts = []",
        f"{ACCURACY}\ndef start_run(self, context): shelf.poll(lambda: context)",
        f"{ACCURACY}\ndef start_run(self, context): self.later = {{'Score': context.publish}}",
        f"{ACCURACY}\ndef start_run(self, *given): shelf.poll(*given)",
        f"{ACCURACY}\n{TIMED}\n@timed\ndef start_run(self, context): shelf.poll(context)",
    ],
)
def test_nothing_is_told_where_all_are_published_or_the_code_cannot_tell(write_config: Write, body: str) -> None:
    assert not unpublished(write_config(body, table=TABLE))


def test_the_design_of_an_earlier_tools_config_declares_and_does_not_publish(write_config: Write) -> None:
    table = TABLE.replace("create_run_table", "create_run_table_model")
    table += "    def create_run_table(self): return self.create_run_table_model()\n"
    assert len(unpublished(write_config(ACCURACY, table=table))) == 1
