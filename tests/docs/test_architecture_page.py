"""The page for the next owner names every package that there is, in the order in which they may import each other."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[2]
SOURCE = ROOT / "src" / "robot_runner"
ROWS = re.findall(
    r"^\|[^|\n]*\| (`[^|\n]*) \|", (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8"), re.MULTILINE
)
FLOORS = [re.findall(r"`([\w.]+)`", row) for row in ROWS]


def _layers() -> list[list[str]]:
    """The layers of the import contracts, each as the names of its packages below `robot_runner`."""
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"][
        "contracts"
    ]
    layered = [contract for contract in contracts if contract["type"] == "layers"]
    return [
        [(container + "." + name.strip()).removeprefix("robot_runner.") for name in layer.split("|")]
        for contract in layered
        for container in contract["containers"]
        for layer in contract["layers"]
    ]


def test_every_package_has_a_row() -> None:
    packages = {path.parent.name for path in SOURCE.glob("*/__init__.py")} - {"plugins"}  # a door
    named = {name.partition(".")[0] for floor in FLOORS for name in floor}
    assert packages - named == set()


def test_the_rows_stand_in_the_order_that_the_contract_allows() -> None:
    height = {name: -number for number, layer in enumerate(_layers()) for name in layer}
    heights = [[height[name] for name in floor if name in height] for floor in FLOORS]
    stack = [floor for floor in heights if floor]
    assert len(stack) > 5
    assert [max(floor) for floor in stack] == sorted((max(floor) for floor in stack), reverse=True)
