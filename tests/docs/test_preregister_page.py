"""The registration that the page shows is the one of its study, and so is the power in it."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from robot_runner.cli.main import main

PAGE = (Path(__file__).parents[2] / "docs" / "preregister.md").read_text(encoding="utf-8")
#: What is another one in each registration: the seed, and with it the checksum.
_DRAWN = re.compile(r"seed \d+|[0-9a-f]{64}")


@pytest.mark.long
def test_the_page_shows_what_its_commands_print(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    config = re.search(r"^```python\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
    shown = re.search(
        r"^\$ robot-runner (power .*)\n\$ robot-runner (preregister .*)\n((?:  .*\n)+)", PAGE, re.MULTILINE
    )
    assert config is not None
    assert shown is not None
    Path("study.py").write_text(config[1], encoding="utf-8")
    assert main(shown[1].split()) == 0
    capsys.readouterr()
    assert main(shown[2].split()) == 0
    assert _DRAWN.sub("…", capsys.readouterr().out) == _DRAWN.sub("…", shown[3])
