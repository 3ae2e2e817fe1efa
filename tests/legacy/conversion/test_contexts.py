"""What a config reads from its context and writes into it is converted, however it reaches it, or named."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from tests.legacy.conversion.test_converting import measures_of
from tests.legacy.earlier_configs import SHORT_TABLE

from robot_runner.core.errors import ConfigError
from robot_runner.legacy.conversion.converting import convert

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from tests.legacy.earlier_configs import Executed

REACHED = {
    "a callback's parameter of another name": """
def interact(self, run): self.size = run.execute_run["size"]
def populate_run_data(self, rc): return {"seconds": self.size + rc.run_nr * 0}
""",
    "a helper's parameter with an annotation": """
def size_of(self, of: RunnerContext): return of.run_variation["size"]
def populate_run_data(self, context): return {"seconds": self.size_of(context)}
""",
    "a lambda's parameter": """
of = staticmethod(lambda context: context.run_variation["size"])
def populate_run_data(self, rc): return {"seconds": self.of(rc)}
""",
    "an attribute that keeps it": """
def start_run(self, context): self.run = context
def populate_run_data(self, context): return {"seconds": self.run.execute_run["size"] + len(self.run.run_dir.name) * 0}
""",
    "an attribute of the config's own": """
def start_run(self, context): context.seconds = context.execute_run["size"] + 5
def populate_run_data(self, context): return {"seconds": context.seconds}
""",
    "get of the row's id": """
def populate_run_data(self, context):
    assert context.execute_run.get("__run_id")
    return {"seconds": context.execute_run.get("size")}
""",
    "before_run's parameter": """
def before_run(self, now: RunnerContext): self.size = now.execute_run["size"]
def populate_run_data(self, context): return {"seconds": self.size}
""",
    "a variable of the row that is not returned": """
def stop_run(self, context):
    row = context.execute_run
    row["seconds"] = row["size"] + 1
    assert row["seconds"]
""",
    "the whole row, which is returned": """
def populate_run_data(self, context):
    context.run_variation["seconds"] = context.run_variation["size"] + 1
    return context.run_variation
""",
    "a copy of the row with a value more, which is returned": """
def populate_run_data(self, context): return {**context.execute_run, "seconds": context.execute_run["size"] + 1}
""",
}


@pytest.mark.long
@pytest.mark.parametrize("methods", REACHED.values(), ids=REACHED)
def test_a_context_is_converted_however_it_is_reached(
    methods: str, config: Callable[..., Path], execute: Callable[..., Executed], tmp_path: Path
) -> None:
    old = config(methods, table=SHORT_TABLE)
    new = tmp_path / "converted.py"
    new.write_text(convert(old).text, encoding="utf-8")
    columns = ["size", "seconds"]
    assert measures_of(new, columns) == [[row[name] for name in columns] for row in execute(old).table]


@pytest.mark.long
def test_the_context_of_a_lambda_that_is_subscribed_is_converted(config: Callable[..., Path], tmp_path: Path) -> None:
    callback = 'lambda now: {"seconds": now.run_variation["size"] + now.run_nr * 0}'
    old = config(subscribe=f"(RunnerEvents.POPULATE_RUN_DATA, {callback}),", table=SHORT_TABLE)
    new = tmp_path / "converted.py"
    new.write_text(convert(old).text, encoding="utf-8")
    rows = measures_of(new, ["size", "seconds"])
    assert rows
    assert all(size == seconds for size, seconds in rows)


NOT_WRITTEN = {
    "context.name = 5": "takes no attributes",
    "context.robot = hasattr(context, 'robot')": "takes no attributes",
    "context.execute_run['unplanned'] = 1": "none of the data columns",
    "context.execute_run.update(seconds=1)": "changes the row",
    "print(context.__dict__)": "has no __dict__",
    "print(vars(context))": "has no __dict__",
}


@pytest.mark.parametrize(("statement", "said"), NOT_WRITTEN.items())
def test_what_cannot_be_done_with_a_context_is_named_with_its_line(
    statement: str, said: str, config: Callable[..., Path]
) -> None:
    path = config(f"def start_run(self, context):\n    {statement}")
    line = path.read_text().splitlines().index(f"        {statement}") + 1
    with pytest.raises(ConfigError, match=said) as refused:
        convert(path)
    assert [finding.where for finding in refused.value.findings] == [f"{path}:{line}"]


def test_what_may_be_a_context_is_named(config: Callable[..., Path]) -> None:
    conversion = convert(config("def start_run(self, context):\n    print((lambda each: each.run_dir)(context))"))
    assert [str(finding) for finding in conversion.findings if "each.run_dir is left as it is" in str(finding)]


def test_an_attribute_of_the_config_may_be_called_like_one_of_the_context(config: Callable[..., Path]) -> None:
    conversion = convert(
        config("def start_run(self, context):\n    self.run_dir = context.run_dir\n    self.run_dir.name")
    )
    assert "self.run_dir = context.run_folder\n        self.run_dir.name" in conversion.text
    assert conversion.findings == ()
