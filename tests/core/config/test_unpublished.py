"""Measures that a config declares and that nothing publishes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from robot_runner.core.config.preparation import prepare

Write = Callable[..., Path]

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
