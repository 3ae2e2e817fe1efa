"""An experiment that is stopped from another terminal, as by Ctrl-C in its own."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from robot_runner.core.storage.journal import read_journal

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


@pytest.mark.long
def test_it_closes_the_run_and_can_go_on(
    terminal: Callable, write_config: Callable[..., Path], tmp_path: Path, robot_runner: Callable
) -> None:
    write_config("""
        def launch_mission(self, context):
            context.clock.sleep(0.01 if Path("go").exists() else 60)

        def stop_run(self, context):
            Path("closed").touch()
    """)
    shown = terminal("run", "config.py", "--plain")
    shown.wait_for("starts")
    told = robot_runner("stop", "config.py")
    assert (told.code, "trial stops; r_1 is closed first, and is to be done again" in told.out) == (0, True)
    assert shown.finish() == 130
    assert "Interrupted: 0 of 4 runs done, 0 failed, 4 to do" in shown.text
    assert (tmp_path / "closed").exists()
    root = tmp_path / "results" / "trial"
    assert not (root / ".stop").exists()
    assert [each["kind"] for each in read_journal(root / "journal.jsonl")].count("stop_requested") == 1
    refused = robot_runner("stop", "config.py")
    assert (refused.code, "the experiment is not being executed" in refused.err) == (2, True)
    # A request that came when nobody executed it stops no later session.
    (root / ".stop").touch()
    (tmp_path / "go").touch()
    assert robot_runner("run", "config.py").code == 0
