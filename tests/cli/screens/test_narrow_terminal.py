"""A terminal of 60 columns, as a phone has it: words stay whole, and nothing is left out in silence."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pexpect
import pytest

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

pytestmark = pytest.mark.filterwarnings("ignore:.*multi-threaded:DeprecationWarning")

COLUMNS = 60
MEASURES = ["Energy", "AnotherMeasure", "YetAnotherMeasure"]
TABLE = f"""\
    def create_run_table(self):
        return RunTableModel([Factor("Task", ["Video", "Network"])], data_columns={MEASURES}, seed=1)
"""
ASKING = """\
def before_run(self, context):
    print("get ready")
    self.volts = float(input("Battery voltage? "))

def launch_mission(self, context):
    import time
    time.sleep(0.3)

def populate_run_data(self, context):
    return {"Energy": self.volts, "AnotherMeasure": 1.0, "YetAnotherMeasure": 2.0}
"""
SIDE_BY_SIDE = """\
workers = 2
claims = []

def launch_mission(self, context):
    while not Path("seen").exists():
        context.clock.sleep(0.02)
"""


def draw_on(shown: Any, seconds: float) -> None:
    """Let the screen be drawn for a moment longer."""
    with pytest.raises(pexpect.TIMEOUT):
        shown.child.expect("no screen says this", timeout=seconds)


@pytest.mark.long
def test_what_is_typed_in_a_callback_stands_beneath_the_table_and_columns_without_room_are_named(
    terminal: Callable, write_config: Callable[..., Path]
) -> None:
    write_config(ASKING, table=TABLE)
    shown = terminal("run", "config.py", columns=COLUMNS)
    shown.wait_for("Battery voltage")
    draw_on(shown, 0.5)
    shown.child.send("12.1")
    draw_on(shown, 0.3)
    lines = shown.text.splitlines()
    assert lines[-1] == "12.1", "nothing is drawn around what is typed"
    assert not any("━" in line for line in lines), "the progress line has given way"
    shown.child.send("\r")
    shown.wait_for("Battery voltage")
    shown.child.send("11.9\r")
    assert shown.finish() == 0
    lines = [line.rstrip() for line in shown.text.splitlines()]
    words = " ".join(shown.text.split())
    assert "too narrow for YetAnotherMeasure and took; run_table.csv has all measures" in words
    assert [line.split() for line in lines if line.startswith("  r_")] == [
        ["r_1", "Video", "12.10", "1.000"],
        ["r_2", "Network", "11.90", "1.000"],
    ]


@pytest.mark.long
def test_a_table_that_fits_announces_nothing(terminal: Callable, write_config: Callable[..., Path]) -> None:
    write_config(ASKING.replace('float(input("Battery voltage? "))', "1.0"), table=TABLE)
    shown = terminal("run", "config.py", columns=100)
    assert shown.finish() == 0
    assert "too narrow" not in shown.text


@pytest.mark.long
def test_each_of_several_places_has_one_line(
    terminal: Callable, write_config: Callable[..., Path], tmp_path: Path
) -> None:
    write_config(SIDE_BY_SIDE)
    shown = terminal("run", "config.py", "--only", "r_1,r_2", columns=COLUMNS)
    shown.wait_until_shown("launch_mission", times=2)
    places = [line.split() for line in shown.text.splitlines() if line.startswith("  slot")]
    (tmp_path / "seen").touch()
    assert [place[:4] for place in places] == [["slot", "1", "▶", "r_1:"], ["slot", "2", "▶", "r_2:"]]
    assert all("launch_mission" in place for place in places)
    assert shown.finish() == 0


@pytest.mark.long
@pytest.mark.parametrize(
    "words",
    [
        ["check", "config.py"],
        ["run", "config.py", "--plain"],
        ["try", "CodeCarbon"],
        ["--help"],
        ["replicate", "--help"],
        ["chek"],
    ],
    ids=" ".join,
)
def test_no_word_is_broken(
    robot_runner: Callable, terminal: Callable, write_config: Callable[..., Path], words: list[str]
) -> None:
    write_config("time_between_runs_in_ms = 'what on earth'\natempts = 3")
    answer = robot_runner(*words)
    shown = terminal(*words, columns=COLUMNS, lines=300)
    shown.finish()
    assert all(len(line) <= COLUMNS for line in shown.text.splitlines())
    if "replicate" in words:  # argparse folds what it says of each option in its own way
        assert "the same seed." in " ".join(shown.text.split())
        return
    assert shown.text.split() == (answer.out + answer.err).split()


@pytest.mark.long
def test_a_warning_while_runs_are_executed_is_folded_beneath_itself(
    terminal: Callable, write_config: Callable[..., Path]
) -> None:
    write_config("def launch_mission(self, context):\n    pass\n")  # nothing reads the factor
    shown = terminal("run", "config.py", columns=COLUMNS)
    shown.finish()
    lines = shown.text.splitlines()
    first = next(place for place, line in enumerate(lines) if line.startswith("warning: "))
    assert lines[first + 1].startswith(" " * len("warning: "))
