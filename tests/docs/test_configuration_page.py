"""The page of the config class says what the code says, and its configs are executed."""

from __future__ import annotations

import re
from enum import Enum
from pathlib import Path, PurePath

import pytest

from robot_runner.cli.main import main
from robot_runner.core.config.parameters import PARAMETERS, REQUIRED
from robot_runner.core.events.context import ExperimentContext, RobotRunnerContext
from robot_runner.core.events.manager import ORCHESTRATED_EVENTS, RobotRunnerEvents

PAGE = (Path(__file__).parents[2] / "docs" / "configuration.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```python\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
CONFIGS = [place for place, block in enumerate(BLOCKS) if "class RobotRunnerConfig" in block]


def _default(value: object) -> str:
    if value is REQUIRED:
        return "required"
    if isinstance(value, Enum):
        return f"`{type(value).__name__}.{value.name}`"
    return f'`Path("{value}")`' if isinstance(value, PurePath) else f"`{value!r}`"


def test_every_static_parameter_has_its_row() -> None:
    rows = [
        f"| `{each.name}` | `{each.type_name.replace('|', chr(92) + '|')}` | {_default(each.default)} "
        f"| {each.description} |"
        for each in PARAMETERS.values()
    ]
    header = "| parameter | type | default | meaning |\n|---|---|---|---|\n"
    table = PAGE.partition(header)[2].partition("\n\n")[0]
    assert table.splitlines() == rows


def test_every_event_has_its_row_in_order() -> None:
    rows = re.findall(r"^\| `([A-Z_]+)` \| `(\w+)` \| (\w+) \|", PAGE, re.MULTILINE)
    assert rows == [
        (event.name, event.callback_name, "orchestrator" if event in ORCHESTRATED_EVENTS else "run")
        for event in RobotRunnerEvents
    ]


@pytest.mark.parametrize("context", [ExperimentContext, RobotRunnerContext])
def test_everything_that_a_context_offers_is_told(context: type) -> None:
    internal = {
        "resources",
        "owner",
        "broker",
        "ending",
        "hosts",
        "run_path",
    }  # for plugins, and for the context itself
    offered = {name for name in dir(context) if not name.startswith("_")} - internal
    assert {name for name in offered if not re.search(rf"^\|.*`{name}[`(]", PAGE, re.MULTILINE)} == set()


@pytest.mark.long
@pytest.mark.parametrize("place", CONFIGS)
@pytest.mark.filterwarnings("ignore:.*multi-threaded:DeprecationWarning")
def test_a_config_of_the_page_is_executed(place: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    config = tmp_path / "config.py"
    imports = [line for block in BLOCKS[:place] for line in block.splitlines() if line.startswith(("import", "from"))]
    shared = [line for line in imports if "import plugins" not in line]
    config.write_text("\n".join([*shared, BLOCKS[place]]), encoding="utf-8")
    code = main(["run", str(config), "--set", f"results_output_path={tmp_path}", "--set", "operation_type=auto"])
    said = capsys.readouterr()
    assert code == 0, said
    assert re.search(r"^(All \d+ runs are|The one run is) done", said.out, re.MULTILINE)
    assert "  ! " not in said.out


def test_the_page_has_configs() -> None:
    assert len(CONFIGS) >= 5
