"""Names that the code of a config reads, and that nothing defines."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from robot_runner.core.config.preparation import prepare

Write = Callable[..., Path]


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
