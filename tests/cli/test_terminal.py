"""What a person sees and does at a real (pseudo-)terminal, and from a second one."""

from __future__ import annotations

import re
import signal
import subprocess
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

SEMI = """\
operation_type = OperationType.SEMI

def before_run(self, context):
    print("room", context.run_id, "is ready")

def continue_experiment(self, context):
    print("swap the battery after", context.run_id)

def populate_run_data(self, context):
    return {"Energy": 2.5}
"""
TWO_RUNS = """\
    def create_run_table(self):
        return RunTableModel([Factor("Task", ["Video", "Network"])], data_columns=["Energy"])
"""
ENDLESS = """\
def launch_mission(self, context):
    context.share(phase="waiting for Godot", phase_number=1, phase_count=2)
    context.clock.sleep(600)
"""


def call(program: str, folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([program, *words], cwd=folder, capture_output=True, text=True, check=False, timeout=60)


@pytest.mark.long
def test_enter_starts_the_next_run(terminal: Callable, write_config: Callable[..., Path], tmp_path: Path) -> None:
    write_config(SEMI, table=TWO_RUNS)
    shown = terminal("run", "config.py")
    shown.wait_for("Press ENTER to start run 1 of 2, or in another terminal: robot-runner continue results/trial")
    assert "Next is r_1, run 1 of 2: Task=Video\n2 runs left\n" in shown.text
    shown.child.sendline("")
    shown.wait_for("Press ENTER to start run 2 of 2, or in another terminal: robot-runner continue results/trial")
    assert re.search(r"Next is r_2, run 2 of 2: Task=Network\n1 run, (about|at least) \d+", shown.text)
    assert "▶" not in shown.text, "the live part gives way"
    shown.child.sendline("")
    assert shown.finish() == 0
    rows = [line.split() for line in shown.text.splitlines()]
    assert ["room", "r_1", "is", "ready"] in rows
    assert [row[:3] for row in rows if row and row[0].startswith("r_")] == [
        ["r_1", "Video", "2.500"],
        ["r_2", "Network", "2.500"],
    ]
    assert "swap the battery after r_1" in shown.text
    assert "swap the battery after r_2" not in shown.text
    assert "All 2 runs are done" in shown.text
    assert (tmp_path / "results" / "trial" / "run_table.csv").exists()


@pytest.mark.long
def test_a_second_terminal_lets_it_go_on(
    terminal: Callable, write_config: Callable[..., Path], tmp_path: Path, robot_runner: Callable
) -> None:
    write_config(SEMI, table=TWO_RUNS)
    shown = terminal("run", "config.py")
    shown.wait_for("start run 1")
    shown.child.sendline("")
    shown.wait_for("start run 2")
    waiting = robot_runner("status", "config.py", "--json").json
    assert waiting["is_waiting_for_user"] is True
    assert waiting["holder"]["pid"] == shown.child.pid
    assert "waits for you (process" in robot_runner("status", "results/trial").out
    answer = robot_runner("continue", "results/trial")
    assert (answer.code, answer.err) == (0, "")
    assert "trial goes on: 2 of 2 runs begun." in answer.out
    assert shown.finish() == 0
    ended = robot_runner("continue", "config.py")
    assert ended.code == 2
    assert "the experiment is not being executed" in ended.err
    assert "All its runs are done." in ended.err


@pytest.mark.long
def test_where_nobody_sits_a_second_terminal_is_the_way(
    write_config: Callable[..., Path], tmp_path: Path, program: str
) -> None:
    write_config(SEMI, table=TWO_RUNS)
    with subprocess.Popen(
        [program, "run", "config.py"], cwd=tmp_path, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, text=True
    ) as running:
        assert running.stdout is not None
        asked = []
        for line in running.stdout:
            if line.startswith("Waiting before run"):
                asked.append(line.split(".")[0])
                assert call(program, tmp_path, "continue", "results/trial").returncode == 0
        assert running.wait(timeout=60) == 0
    assert asked == ["Waiting before run 1 of 2", "Waiting before run 2 of 2"]


@pytest.mark.long
def test_an_experiment_that_does_not_wait_is_not_told_to_go_on(
    terminal: Callable, write_config: Callable[..., Path], tmp_path: Path, robot_runner: Callable
) -> None:
    write_config(ENDLESS)
    shown = terminal("run", "config.py")
    shown.wait_for("waiting for Godot")
    answer = robot_runner("continue", "config.py")
    assert answer.code == 2
    assert f"the experiment does not wait: process {shown.child.pid} on " in answer.err
    assert "executes r_1" in answer.err
    assert "fix: Wait until it asks" in answer.err
    second = robot_runner("run", "config.py")
    assert second.code == 2
    assert "is being executed by process" in second.err


@pytest.mark.long
def test_the_live_screen_shows_run_event_and_phase_and_ctrl_c_ends_it_cleanly(
    terminal: Callable, write_config: Callable[..., Path], tmp_path: Path, robot_runner: Callable
) -> None:
    write_config(ENDLESS)
    shown = terminal("run", "config.py")
    shown.wait_for(r"waiting for Godot.*[12]\.\d s")
    run = "▶ r_1 (run 1 of 4): Task=Video, Repetition=1"
    shown.wait_until_shown("0 of 4 done", run, "launch_mission: waiting for Godot (1 of 2)")
    now = robot_runner("status", "config.py").out
    assert "r_1, launch_mission" in now
    shown.child.sendintr()
    assert shown.finish() == 130
    assert "Interrupted: 0 of 4 runs done, 0 failed, 4 to do" in shown.text
    assert "go on with the 4 runs that are left: robot-runner config.py" in shown.text
    assert "▶" not in shown.text, "the live part is taken away"
    assert "not being executed" in robot_runner("status", "config.py").out


@pytest.mark.long
def test_ctrl_c_ends_the_waiting_too(terminal: Callable, write_config: Callable[..., Path]) -> None:
    write_config(SEMI, table=TWO_RUNS)
    shown = terminal("run", "config.py")
    shown.wait_for("start run 1")
    shown.child.sendline("")
    shown.wait_for("start run 2")
    shown.child.sendintr()
    assert shown.finish() == 130
    assert "Interrupted: 1 of 2 runs done, 0 failed, 1 to do" in shown.text


@pytest.mark.long
def test_an_enter_that_came_too_early_starts_nothing(
    terminal: Callable, write_config: Callable[..., Path], tmp_path: Path
) -> None:
    mission = "while not Path('go').exists(): context.clock.sleep(0.02)"
    write_config(f"{SEMI}\ndef launch_mission(self, context):\n    {mission}\n", table=TWO_RUNS)
    shown = terminal("run", "config.py")
    shown.wait_for("start run 1")
    shown.child.sendline("")
    shown.wait_for("launch_mission")
    shown.child.sendline("")
    (tmp_path / "go").touch()
    shown.wait_for("start run 2")
    with pytest.raises(shown.timeout):
        shown.child.expect("r_2 is ready", timeout=0.5)
    shown.child.sendline("")
    assert shown.finish() == 0


@pytest.mark.long
def test_plain_lines_on_a_terminal(terminal: Callable, write_config: Callable[..., Path]) -> None:
    write_config("def populate_run_data(self, context): return {'Energy': 1.5}")
    shown = terminal("run", "config.py", "--plain")
    assert shown.finish() == 0
    assert "run 4 of 4 (r_4) starts: Task=Network, Repetition=2" in shown.text
    assert shown.cursor_was_hidden is False


@pytest.mark.long
@pytest.mark.parametrize(("variable", "is_coloured"), [(None, True), ("NO_COLOR", False)])
def test_colour_can_be_forbidden(terminal: Callable, variable: str | None, is_coloured: bool) -> None:
    shown = terminal("check", "nowhere.py", environment={variable: "1"} if variable else {})
    assert shown.finish() == 2
    assert "error: nowhere.py: there is no such file" in shown.text
    assert ("\x1b[31m" in shown.raw or "\x1b[1;31m" in shown.raw) is is_coloured


@pytest.mark.long
def test_a_terminal_that_closes_ends_the_experiment_cleanly(
    terminal: Callable, write_config: Callable[..., Path], tmp_path: Path, robot_runner: Callable
) -> None:
    write_config(ENDLESS)
    shown = terminal("run", "config.py")
    shown.wait_for("waiting for Godot")
    shown.child.kill(signal.SIGHUP)
    shown.finish()
    facts = robot_runner("status", "config.py", "--json").json
    assert facts["holder"] is None
    assert facts["finished_at"] is not None
    assert (facts["done"], facts["failed"], facts["todo"]) == (0, 0, 4)


@pytest.mark.long
def test_a_changed_config_is_shown_and_asked_about_at_a_terminal(
    terminal: Callable, robot_runner: Callable, write_config: Callable[..., Path]
) -> None:
    write_config("def populate_run_data(self, context): return {'Energy': 1}", table=TWO_RUNS)
    assert robot_runner("run", "config.py", "--only", "r_1").code == 0
    write_config("def populate_run_data(self, context): return {'Energy': 2}", table=TWO_RUNS)
    refusing = terminal("run", "config.py")
    refusing.wait_for("Go on with it as it is now")
    refusing.child.sendline("n")
    assert refusing.finish() == 2
    agreeing = terminal("run", "config.py")
    agreeing.wait_for("Go on with it as it is now")
    agreeing.child.sendline("y")
    assert agreeing.finish() == 0


@pytest.mark.long
def test_a_table_that_disagrees_with_the_journal_is_asked_about_at_a_terminal(
    terminal: Callable, robot_runner: Callable, write_config: Callable[..., Path], tmp_path: Path
) -> None:
    write_config("def populate_run_data(self, context): return {'Energy': 7}", table=TWO_RUNS)
    assert robot_runner("run", "config.py").code == 0
    table = tmp_path / "results" / "trial" / "run_table.csv"
    executed = table.read_text(encoding="utf-8")
    table.write_text(executed.replace(",7\n", ",8\n", 1), encoding="utf-8")
    for said, code in (("", 2), ("j", 0)):
        asked = terminal("run", "config.py")
        asked.wait_for("Which one counts: the journal")
        asked.child.sendline(said)
        assert asked.finish() == code
    assert table.read_text(encoding="utf-8") == executed


@pytest.mark.long
def test_ctrl_c_says_what_it_does_and_what_another_would(
    terminal: Callable, write_config: Callable[..., Path], tmp_path: Path
) -> None:
    write_config("def launch_mission(self, context): context.clock.sleep(600)", table=TWO_RUNS)
    shown = terminal("run", "config.py")
    shown.wait_for("launch_mission")
    shown.child.sendintr()
    shown.wait_for("Interrupted: closing r_1")
    assert shown.finish() == 130
