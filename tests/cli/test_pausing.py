"""An experiment that pauses between two runs: asked for from another terminal, without ending anything."""

from __future__ import annotations

import json
import re
import signal
import subprocess
from typing import TYPE_CHECKING

import pytest

from robot_runner.core.storage.journal import read_journal

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

pytestmark = pytest.mark.filterwarnings("ignore:.*multi-threaded:DeprecationWarning")

UNTIL_TOLD = """
def launch_mission(self, context):
    while context.run_number == 1 and not Path("go").exists():
        context.clock.sleep(0.05)
"""
TABLE = """\
    def create_run_table(self):
        return RunTableModel([Factor("Task", ["Video", "Network"])], data_columns=[])
"""


def call(program: str, folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([program, *words], cwd=folder, capture_output=True, text=True, timeout=60, check=False)


def kinds(folder: Path) -> list[str]:
    wanted = {"paused", "continued", "attempt_started", "experiment_finished"}
    return [record["kind"] for record in read_journal(folder / "results" / "trial" / "journal.jsonl", kinds=wanted)]


def test_it_pauses_after_the_present_run_and_goes_on(
    terminal: Callable, write_config: Callable[..., Path], tmp_path: Path, program: str
) -> None:
    write_config(UNTIL_TOLD, table=TABLE)
    shown = terminal("run", "config.py")
    shown.wait_for("launch_mission")
    assert call(program, tmp_path, "pause", "config.py").stdout.startswith("trial pauses after r_1. To go on")
    shown.wait_for("pauses after this run")
    assert "and pauses before the next run" in " ".join(call(program, tmp_path, "status", "config.py").stdout.split())
    assert call(program, tmp_path, "continue", "config.py").stdout == "trial does not pause.\n"
    assert call(program, tmp_path, "pause", "results/trial").returncode == 0
    (tmp_path / "go").touch()
    shown.wait_for("Paused before run 2 of 2. To go on: press ENTER")
    facts = json.loads(call(program, tmp_path, "status", "config.py", "--json").stdout)
    assert (facts["is_paused"], facts["done"], facts["holder"]["pid"]) == (True, 1, shown.child.pid)
    assert "is paused (process" in call(program, tmp_path, "status", "config.py").stdout
    assert "is paused already" in call(program, tmp_path, "pause", "config.py").stdout
    assert call(program, tmp_path, "continue", "config.py").stdout == "trial goes on.\n"
    assert shown.finish() == 0
    assert kinds(tmp_path) == ["attempt_started", "paused", "continued", "attempt_started", "experiment_finished"]
    assert not (tmp_path / "results" / "trial" / ".pause").exists()
    refused = call(program, tmp_path, "pause", "config.py")
    assert (refused.returncode, "nobody executes this experiment" in refused.stderr) == (2, True)


@pytest.mark.parametrize("ending", [signal.SIGINT, signal.SIGKILL])
def test_a_pause_ends_with_its_session(
    terminal: Callable, write_config: Callable[..., Path], tmp_path: Path, program: str, ending: signal.Signals
) -> None:
    write_config(UNTIL_TOLD, table=TABLE)
    shown = terminal("run", "config.py", "--plain")
    shown.wait_for("starts")
    assert call(program, tmp_path, "pause", "config.py").returncode == 0
    (tmp_path / "go").touch()
    shown.wait_for("Paused before run 2 of 2")
    shown.child.kill(ending)
    if ending is signal.SIGINT:
        assert shown.finish() == 130
        assert "Interrupted: 1 of 2 runs done, 0 failed, 1 to do" in shown.text
    else:
        shown.child.wait()
    facts = json.loads(call(program, tmp_path, "status", "config.py", "--json").stdout)
    assert (facts["holder"], facts["is_paused"], facts["pause_is_requested"]) == (None, False, False)
    resumed = call(program, tmp_path, "run", "config.py")
    assert resumed.returncode == 0
    assert "Paused" not in resumed.stdout
    told = call(program, tmp_path, "status", "config.py").stdout
    broken = ", 1 of them broken off" if ending is signal.SIGKILL else ""
    assert re.search(rf"Sessions +2{broken}; .* in all", told)
    assert re.search(r"Started +20.*Z\n +Resumed +20.*Z", told)


def test_enter_ends_a_pause_in_its_own_terminal(
    terminal: Callable, write_config: Callable[..., Path], tmp_path: Path, program: str
) -> None:
    write_config(UNTIL_TOLD, table=TABLE)
    shown = terminal("run", "config.py")
    shown.wait_for("launch_mission")
    assert call(program, tmp_path, "pause", "config.py").returncode == 0
    (tmp_path / "go").touch()
    shown.wait_for("Paused before run 2 of 2")
    shown.child.sendline("")
    assert shown.finish() == 0
