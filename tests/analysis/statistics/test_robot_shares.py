"""Where robots had unequal shares of treatments, what they differ in may pass for an effect: that is said."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import pytest
from tests.analysis.experiment_folders import Folder

from robot_runner.analysis import analyse, load_results
from robot_runner.analysis.report.material import Material
from robot_runner.analysis.report.threats_section import threats_of
from robot_runner.core.events.measure import ROBOTS_OWNER
from robot_runner.core.storage.table_schema import read_schema, write_schema

if TYPE_CHECKING:
    from pathlib import Path


def folder(root: Path, robots: str) -> Path:
    """Return an experiment in which nothing but the robot makes a difference: b draws 5 J more."""
    rows = [
        ("Video" if place < len(robots) / 2 else "Idle", 100.0 + 5 * (robot == "b") + place % 3, robot)
        for place, robot in enumerate(robots)
    ]
    made = Folder(
        root / "e", {"Task": ["Video", "Idle"]}, rows, {"Energy": "J", "Robot": ""}, types={"Robot": "string"}
    )
    made.write()
    columns = read_schema(made.files.schema)
    owned = [replace(each, owner=ROBOTS_OWNER) if each.name == "Robot" else each for each in columns]
    write_schema(made.files.schema, owned)
    return made.root


@pytest.mark.parametrize(
    ("robots", "told"),
    [("aaaaaaaabb" + "aabbbbbbbb", 1), ("aaaaabbbbb" * 2, 0), ("aaabb" + "aabbb", 0)],
    ids=["one was set aside", "equal shares", "as equal as can be"],
)
def test_unequal_shares_of_robots_are_warned_of(tmp_path: Path, robots: str, told: int) -> None:
    results = load_results(folder(tmp_path, robots))
    statistics = analyse(results)
    found = [each for each in statistics.warnings if "unevenly spread over robots" in each]
    assert len(found) == told
    assert [
        each.text for each in threats_of(Material(results, statistics)) if each.title.endswith("over robots")
    ] == found
    if told:
        test = statistics.measure("Energy").test
        assert test is not None
        assert test.effects[0].is_significant  # though the task does nothing
        assert "Video 8 runs on a and 2 runs on b" in found[0]
