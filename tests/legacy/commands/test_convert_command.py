"""`robot-runner convert`, called as a user calls it."""

from __future__ import annotations

import shlex
from typing import TYPE_CHECKING

import pytest
from tests.legacy.earlier_configs import SHORT_TABLE

from robot_runner.cli.main import main

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from tests.legacy.earlier_configs import Executed


@pytest.mark.long
def test_what_it_says_next_can_be_done_where_the_old_config_was_executed(
    config: Callable[..., Path], execute: Callable[..., Executed], capsys: pytest.CaptureFixture[str]
) -> None:
    old = config('def populate_run_data(self, context): return {"seconds": 1.0}', table=SHORT_TABLE)
    assert execute(old).finished.failures == ()
    assert main(["convert", str(old)]) == 0
    said = {line.split()[0]: line for line in capsys.readouterr().out.splitlines() if "robot-runner " in line}
    for step in ("Check", "Execute"):
        words = shlex.split(said[step].partition("robot-runner ")[2])
        assert main(words) == 0, capsys.readouterr()
