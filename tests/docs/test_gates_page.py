"""The config of the page on gates and guards is executed as it is printed."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from robot_runner.cli.main import main

PAGE = (Path(__file__).parents[2] / "docs" / "gates-and-guards.md").read_text(encoding="utf-8")
CONFIG, *_ = re.findall(r"^```python\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)


@pytest.mark.long
@pytest.mark.filterwarnings("ignore:.*multi-threaded:DeprecationWarning")
def test_the_config_of_the_page_is_executed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    config = tmp_path / "guarded.py"
    config.write_text(CONFIG)
    assert main(["run", str(config), "--plain"]) == 0
    assert "All 2 runs are done" in capsys.readouterr().out
    assert main(["explain", str(tmp_path / "experiments" / "guarded"), "r_1"]) == 0
    told = " ".join(capsys.readouterr().out.split())
    waited = r"Waited gate, .* until \(the battery of the robot is above 40 % and the topic /odom is there\)"
    assert re.search(waited, told), told


def test_what_can_never_hold_is_said_as_the_page_shows(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    config = tmp_path / "guarded.py"
    contradiction = "all_of(load_below(20), load_above(60))"
    config.write_text(
        CONFIG.replace('all_of(battery_above(40), topic_present("odom"))', contradiction).replace(
            "topic_present, treatment", "load_above, load_below, treatment"
        )
    )
    assert main(["check", str(config)]) == 2
    said, shown = (" ".join(text.split()) for text in (capsys.readouterr().out, PAGE))
    problem = "never are both true: the load of this machine is below 20 %, and the load of this machine is above 60 %"
    for part in ("gates[0], condition 'the load of this machine is below 20 %'", problem, "use any_of."):
        assert part in said
        assert part in shown
