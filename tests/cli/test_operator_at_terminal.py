"""A person who takes part, at a real (pseudo-)terminal, on plain lines, and from a second terminal."""

from __future__ import annotations

import json
import re
import subprocess
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from collections.abc import Callable

STEPS = """\
operator_steps = [
    OperatorStep("swap the battery", every=2, ask=[
        Question("voltage", float, unit="V", low=9, high=13),
        Question("remark", note=True, optional=True),
    ]),
    OperatorStep("place the robot", when_changes="Task"),
]

def launch_mission(self, context):
    while not Path("go").exists():
        context.clock.sleep(0.02)

def populate_run_data(self, context):
    return {"Energy": 2.5}
"""
TWO_RUNS = """\
    def create_run_table(self):
        return RunTableModel([Factor("Task", ["Video", "Network"])], data_columns=["Energy"])
"""


@pytest.mark.long
def test_steps_are_shown_and_answers_typed_without_disturbing_the_live_screen(
    terminal: Callable, write_config: Callable[..., Path], tmp_path: Path
) -> None:
    write_config(STEPS, table=TWO_RUNS)
    shown = terminal("run", "config.py")
    shown.wait_for(r"voltage \(V, 9 to 13\): ")
    assert shown.text.splitlines()[-6:] == [
        "Next is r_1, run 1 of 2: Task=Video",
        "2 runs left",
        "To do: swap the battery",
        "Answer when it is done, or in another terminal: robot-runner continue results/trial --answer",
        "voltage=...",
        "  voltage (V, 9 to 13):",
    ]
    assert "▶" not in shown.text, "the live part gives way"
    shown.child.sendline("14")
    shown.wait_for(r"voltage: 14 is above 13 V. Enter a number from 9 to 13 \(in V\)\.")
    shown.wait_for(r"voltage \(V, 9 to 13\): ")
    shown.child.sendline("11.8")
    shown.wait_for(r"remark \(may be left empty\): ")
    shown.child.sendline("")
    shown.wait_for("To do: place the robot")
    shown.wait_for("Press ENTER when it is done")
    shown.child.sendline("")
    shown.wait_for(r"launch_mission")
    (tmp_path / "go").touch()
    shown.wait_for("Next is r_2, run 2 of 2: Task=Network")
    shown.wait_for("1 run, (about|at least) ")
    shown.wait_for("Press ENTER when it is done")
    shown.child.sendline("")
    assert shown.finish() == 0
    rows = [line.split()[:4] for line in shown.text.splitlines() if line.startswith("  r_")]
    assert rows == [["r_1", "Video", "2.500", "11.80"], ["r_2", "Network", "2.500", "\N{EN DASH}"]]
    assert "voltage: entered by hand" in shown.text
    assert "voltage has no value" not in shown.text
    assert (tmp_path / "results" / "trial" / "run_table.csv").read_text().splitlines()[1].endswith(",2.5,11.8")


@pytest.mark.long
def test_ctrl_d_does_not_make_the_keyboard_deaf(
    terminal: Callable, write_config: Callable[..., Path], tmp_path: Path
) -> None:
    write_config(STEPS, table=TWO_RUNS)
    (tmp_path / "go").touch()
    shown = terminal("run", "config.py")
    shown.wait_for(r"voltage \(V, 9 to 13\): ")
    shown.child.sendeof()
    shown.child.sendline("11.8")
    shown.wait_for(r"remark \(may be left empty\): ")
    shown.child.sendline("")
    for _ in range(2):
        shown.wait_for("Press ENTER when it is done")
        shown.child.sendeof()
        shown.child.sendline("")
    assert shown.finish() == 0


@pytest.mark.long
def test_on_plain_lines_and_from_another_terminal(
    write_config: Callable[..., Path], tmp_path: Path, program: str, robot_runner: Callable
) -> None:
    write_config(STEPS, table=TWO_RUNS)
    (tmp_path / "go").touch()
    with subprocess.Popen(
        [program, "run", "config.py"], cwd=tmp_path, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, text=True
    ) as running:
        assert running.stdout is not None
        said = []
        try:
            for line in running.stdout:
                said.append(line.rstrip())
                if line.startswith("Waiting before run 1 of 2") and "--answer" in line:
                    self_told = json.loads(robot_runner("status", "results/trial", "--json").out)
                    told = robot_runner("status", "results/trial").out
                    bad = robot_runner("continue", "config.py", "--answer", "voltag=11", "--answer", "x")
                    assert robot_runner("continue", "config.py", "--answer", "voltage=11.8").code == 0
                elif line.startswith("Waiting before run"):
                    last = robot_runner("continue", "config.py")
            assert running.wait(timeout=60) == 0
        finally:
            running.kill()
    assert self_told["waiting_for"]["step"] == "swap the battery"
    assert "swap the battery, before r_1; then tell voltage (V, 9 to 13), remark (may be left empty)" in told
    assert "robot-runner continue results/trial --answer voltage=..." in told
    assert bad.code == 2
    for problem in (
        "'x' is not an answer",
        "--answer voltag: no question asks for this",
        "the question is not answered",
    ):
        assert problem in bad.err
    assert "Did you mean 'voltage'?" in bad.err
    assert last.out == "trial goes on: 'place the robot' is done.\n"
    assert said[1:5] == [
        "Next is r_1, run 1 of 2: Task=Video",
        "2 runs left",
        "To do: swap the battery",
        "Waiting before run 1 of 2. To go on: robot-runner continue results/trial --answer voltage=...",
    ]


@pytest.mark.long
def test_the_config_of_the_page_is_executed(terminal: Callable, tmp_path: Path) -> None:
    page = (Path(__file__).parents[2] / "docs" / "operator.md").read_text(encoding="utf-8")
    block, _, _ = re.findall(r"^```python\n(.*?)^```", page, re.MULTILINE | re.DOTALL)
    (tmp_path / "two_floors.py").write_text(block, encoding="utf-8")
    shown = terminal("run", "two_floors.py", "--only", "r_1", lines=60)
    for asked, said in (
        ("charge the camera", ""),
        (r"voltage \(V, 9 to 13\): ", "118"),
        ("118 is above 13 V.*voltage", "11.8"),
        ("lay the floor", ""),
        (r"dock \(A or B\): ", "b"),
        (r"remark \(may be left empty\): ", "it stood askew"),
    ):
        shown.wait_for(asked)
        if not asked.endswith(": "):
            shown.wait_for("Press ENTER|: ")
        shown.child.sendline(said)
    assert shown.finish() == 0
    row = next(line.split() for line in shown.text.splitlines() if line.startswith("  r_1"))
    assert row[:6] == ["r_1", "wood", "1", "23.60", "11.80", "B"]


@pytest.mark.long
def test_a_run_that_waits_for_what_is_typed_fails_with_what_asks_a_person(
    terminal: Callable, write_config: Callable[..., Path], tmp_path: Path
) -> None:
    write_config('def launch_mission(self, context):\n    input("How was it? ")\n', table=TWO_RUNS)
    shown = terminal("run", "config.py", "--only", "r_1")
    assert shown.finish() == 1
    assert "operator_steps" in " ".join(shown.text.split())
    log = (tmp_path / "results" / "trial" / "runs" / "r_1" / "log.txt").read_text(encoding="utf-8")
    assert 'input("How was it? ")' in log
    assert "EOFError: EOF when reading a line" in log
