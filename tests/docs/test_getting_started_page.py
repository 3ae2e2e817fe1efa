"""The commands of the tutorial do what it says."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from robot_runner.cli.main import main

if TYPE_CHECKING:
    from collections.abc import Iterator

PAGE = (Path(__file__).parents[2] / "docs" / "getting-started.md").read_text(encoding="utf-8")
CONSOLES = re.findall(r"^```console\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)


def _commands(block: str) -> Iterator[list[str]]:
    for line in block.splitlines():
        if line.startswith("$ robot-runner "):
            yield line.split()[2:]


@pytest.mark.long
@pytest.mark.filterwarnings("ignore:.*multi-threaded:DeprecationWarning")
def test_writing_your_own_works_as_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    block = next(block for block in CONSOLES if "robot-runner new" in block)
    for words in _commands(block):
        assert main(words) == 0, capsys.readouterr()
    refused = next(block for block in CONSOLES if "is refused" in block)
    config = tmp_path / "study.py"
    config.write_text(config.read_text().replace("def launch_mission", "def lunch_mission"), encoding="utf-8")
    capsys.readouterr()
    assert [main(words) for words in _commands(refused)] == [2]
    assert capsys.readouterr().out == refused.partition("\n")[2]


def test_listing_1_is_refused_as_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    for name in ("ROS_VERSION", "ROS_DISTRO"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("robot_runner.ros.required_ros.installed_ros", lambda: None)
    monkeypatch.chdir(Path(__file__).parents[2])
    block = next(block for block in CONSOLES if "listing_1" in block)
    assert [main(words) for words in _commands(block)] == [2]
    assert block.partition("\n")[2] in capsys.readouterr().err


def test_the_page_names_only_commands_that_there_are(capsys: pytest.CaptureFixture[str]) -> None:
    named = set(re.findall(r"`robot-runner ([a-z]+)[` ]", PAGE))
    assert {"continue", "plugins", "status"} <= named
    assert {command: main([command, "--help"]) for command in named} == dict.fromkeys(named, 0)
    capsys.readouterr()
