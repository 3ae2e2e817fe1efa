from __future__ import annotations

import time
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

pytestmark = pytest.mark.filterwarnings("ignore:.*multi-threaded:DeprecationWarning")

MEASURING = """
run_process = RunProcess.IN_PROCESS

def populate_run_data(self, context):
    return {"Energy": 1.5}
"""
BLOCKS = """\
    def create_run_table(self):
        factors = [Factor("Room", ["lab", "hall"]), Factor("Speed", [0.1, 10])]
        return RunTableModel(factors, repetitions=2, shuffle=True, seed=7, blocks="Room")
"""
DRAWN = """\
    def create_run_table(self):
        return RunTableModel([Factor("A", range(30))], shuffle=True, data_columns=["Energy"])
"""
DAYS = """\
    def create_run_table(self):
        from robot_runner.designs import Blocks

        factors = [Factor("Day", ["Mon", "Tue"]), Factor("Planner", ["straight", "astar"]), Factor("Speed", [0.1, 0.2])]
        return RunTableModel(factors, repetitions=2, design=Blocks("Day"))
"""
ODD = """\
    def create_run_table(self):
        return RunTableModel([Factor("Text", ["a, b", "two\\nlines", None, float("inf"), "[red]", "x" * 60])])
"""


def test_every_run_is_shown_in_its_order(robot_runner: Callable, write_config: Callable[..., Path]) -> None:
    write_config(table=BLOCKS)
    answer = robot_runner("plan", "config.py")
    assert answer.code == 0
    table, _, facts = answer.out.partition("\n\n")
    rows = [line.split() for line in table.splitlines()]
    assert rows[0] == ["run", "Room", "Speed", "Repetition", "block"]
    assert [row[0] for row in rows[1:]] == [f"r_{number}" for number in range(1, 9)]
    assert [row[1] for row in rows[1:]] == ["lab"] * 4 + ["hall"] * 4
    assert sorted(map(tuple, (row[1:4] for row in rows[1:]))) == sorted(
        (room, speed, repetition) for room in ("lab", "hall") for speed in ("0.1", "10") for repetition in "12"
    )
    assert "randomised within blocks of Room from seed 7" in facts
    assert "the config gives the seed: this order comes again each time" in facts


def test_numbers_stand_to_the_right_and_texts_to_the_left(
    robot_runner: Callable, write_config: Callable[..., Path]
) -> None:
    write_config(table=BLOCKS)
    header, *rows = robot_runner("plan", "config.py").out.partition("\n\n")[0].splitlines()
    end = header.index("Speed") + len("Speed")
    assert {row[:end].rstrip().split()[-1] for row in rows} == {"0.1", "10"}
    assert all(row[header.index("Room")] != " " for row in rows)


def test_the_combinations_of_a_block_are_told_apart_and_none_is_cut_off(
    robot_runner: Callable, write_config: Callable[..., Path]
) -> None:
    write_config(table=DAYS)
    answer = robot_runner("plan", "config.py")
    assert "Tue  straight, 0.1 · straight, 0.2 · astar, 0.1 · astar, 0.2\n" in answer.out, answer.out


def test_a_drawn_seed_can_be_given(robot_runner: Callable, write_config: Callable[..., Path], tmp_path: Path) -> None:
    config = write_config(table=DRAWN)
    answer = robot_runner("plan", "config.py", "--json")
    seed = answer.json["order"]["seed"]
    config.write_text(config.read_text().replace("shuffle=True", f"shuffle=True, seed={seed}"))
    again = robot_runner("plan", "config.py", "--json")
    assert again.json["runs"] == answer.json["runs"]
    assert (answer.json["seed_is_given"], again.json["seed_is_given"]) == (False, True)
    assert sorted(run["combination"]["A"] for run in again.json["runs"]) == list(range(30))
    assert not (tmp_path / "results").exists()


def test_how_to_repeat_a_drawn_order_is_told(robot_runner: Callable, write_config: Callable[..., Path]) -> None:
    write_config(table=DRAWN)
    assert "for this order write run_table.randomize_runs_order(" in robot_runner("plan", "config.py").out


@pytest.mark.long
def test_an_experiment_that_has_begun_keeps_its_order(
    robot_runner: Callable, write_config: Callable[..., Path], tmp_path: Path
) -> None:
    write_config(MEASURING, table=DRAWN)
    assert robot_runner("run", "config.py").code == 0
    lines = (tmp_path / "results" / "trial" / "run_table.csv").read_text().splitlines()
    place = lines[0].split(",").index("A")
    plan = robot_runner("plan", "config.py", "--json").json
    assert plan["is_begun"] is True
    assert [run["combination"]["A"] for run in plan["runs"]] == [int(line.split(",")[place]) for line in lines[1:]]
    assert "executing it goes on in this order" in robot_runner("plan", "config.py").out


@pytest.mark.long
def test_an_order_that_was_changed_by_hand_is_not_called_randomised(
    robot_runner: Callable, write_config: Callable[..., Path], tmp_path: Path
) -> None:
    write_config(MEASURING, table=DRAWN)
    robot_runner("run", "config.py")
    table = tmp_path / "results" / "trial" / "run_table.csv"
    heading, *rows = table.read_text().splitlines()
    table.write_text("\n".join([heading, *reversed(rows)]) + "\n", encoding="utf-8")
    for _ in range(2):  # before it is noticed by an execution, and after
        shown = robot_runner("plan", "config.py")
        assert "randomised" not in shown.out
        assert "as in results/trial/run_table.csv" in shown.out
        assert "were put into another order by hand" in shown.err
        assert robot_runner("run", "config.py").code == 0
    place = heading.split(",").index("run_id")
    planned = [run["run_id"] for run in robot_runner("plan", "config.py", "--json").json["runs"]]
    assert planned == [row.split(",")[place] for row in reversed(rows)]


def test_where_the_table_has_other_treatments_than_the_config_plans_it_is_the_plan(
    robot_runner: Callable, write_config: Callable[..., Path], tmp_path: Path
) -> None:
    write_config(MEASURING)
    robot_runner("run", "config.py", "--only", "r_1")
    table = tmp_path / "results" / "trial" / "run_table.csv"
    table.write_text(table.read_text("utf-8").replace("Network,2", "Video,2"), "utf-8")
    for options in (["--accept-changes"], []):  # before it is accepted, and after
        shown = robot_runner("plan", "config.py")
        assert "r_4" in shown.out
        assert "as in results/trial/run_table.csv" in shown.out
        assert "run r_4, column 'Task': the table has 'Video', the plan 'Network'" in shown.err
        assert robot_runner("plan", "config.py", "--json").json["runs"][3]["combination"] == {"Task": "Video"}
        assert robot_runner("run", "config.py", *options).code == 0


def test_a_table_made_by_hand_is_the_plan(
    robot_runner: Callable, write_config: Callable[..., Path], tmp_path: Path
) -> None:
    write_config(table=DRAWN)
    folder = tmp_path / "results" / "trial"
    folder.mkdir(parents=True)
    (folder / "run_table.csv").write_text("run_id,status,A\nfirst,-,3\nsecond,-,3\n", encoding="utf-8")
    answer = robot_runner("plan", "config.py")
    rows = [line.split() for line in answer.out.partition("\n\n")[0].splitlines()]
    assert rows == [["run", "A"], ["first", "3"], ["second", "3"]]
    assert "as in results/trial/run_table.csv" in answer.out
    assert robot_runner("plan", "config.py", "--json").json["run_table"] == str(folder / "run_table.csv")


def test_odd_treatments_stay_in_their_line_and_are_valid_json(
    robot_runner: Callable, write_config: Callable[..., Path]
) -> None:
    write_config(table=ODD)
    rows = robot_runner("plan", "config.py").out.partition("\n\n")[0].splitlines()
    assert [row[5:] for row in rows[1:]] == ["a, b", "two\\nlines", "None", "inf", "[red]", "x" * 27 + "…"]
    runs = robot_runner("plan", "config.py", "--json").json["runs"]
    assert [run["combination"]["Text"] for run in runs[:5]] == ["a, b", "two\nlines", None, "inf", "[red]"]


def test_a_plan_needs_no_robot(robot_runner: Callable, write_config: Callable[..., Path]) -> None:
    write_config("required_ros_version = 1\nrequired_ros_distro = 'melodic'")
    assert robot_runner("check", "config.py").code == 2
    assert robot_runner("plan", "config.py").code == 0


def test_what_is_wrong_with_the_run_table_refuses_the_plan(
    robot_runner: Callable, write_config: Callable[..., Path]
) -> None:
    write_config(table='    def create_run_table(self):\n        return RunTableModel([Factor("A", [])])\n')
    answer = robot_runner("plan", "config.py")
    assert (answer.code, answer.out) == (2, "")
    assert "the factor has no treatments" in answer.err


@pytest.mark.long
def test_of_a_long_table_head_and_tail_are_shown_and_all_of_it_by_option(
    robot_runner: Callable, write_config: Callable[..., Path], terminal: Callable
) -> None:
    write_config(table=DRAWN.replace("range(30)", "range(1000)"))
    short = robot_runner("plan", "config.py").out.partition("\n\n")[0].splitlines()
    assert len(short) == 1 + 20 + 1 + 5
    assert short[21] == "… 975 runs left out: --all shows them …"
    assert len(robot_runner("plan", "config.py", "--all").out.partition("\n\n")[0].splitlines()) == 1001
    shown = terminal("plan", "config.py")
    assert shown.finish() == 0
    assert "975 runs left out: --all shows them" in shown.text
    assert "\nr_1000 " in shown.text
    whole = terminal("plan", "config.py", "--all", lines=1100)
    assert whole.finish() == 0
    assert sum(line.startswith("r_") for line in whole.text.splitlines()) == 1000


WIDE = """
    def create_run_table(self):
        columns = [f"Measure{number}" for number in range(60)]
        return RunTableModel([Factor("Prompt", ["p" * 500, "q" * 300]), Factor("B", range(50_000))],
                             shuffle=True, seed=7, data_columns=columns)
"""


@pytest.mark.long
def test_many_runs_with_wide_treatments_are_planned_in_bounded_time_and_width(
    robot_runner: Callable, write_config: Callable[..., Path]
) -> None:
    write_config(table=WIDE)
    began = time.process_time()
    out = robot_runner("plan", "config.py").out
    took = time.process_time() - began
    assert "99,975 runs left out" in out
    assert "100,000 runs: Prompt (2) x B (50,000)" in out
    assert max(map(len, out.splitlines())) < 250
    assert "ppp…" in out
    assert "Measure11 and 48 more" in out
    assert took < 10  # about 1 s


@pytest.mark.long
def test_columns_that_do_not_fit_are_named(write_config: Callable[..., Path], terminal: Callable) -> None:
    write_config(table=BLOCKS)
    shown = terminal("plan", "config.py", columns=27)
    assert shown.finish() == 0
    assert "No room for: Repetition, block." in " ".join(shown.text.split())


def test_a_plan_that_may_be_repeated_says_until_when_and_how_often(
    robot_runner: Callable, write_config: Callable[..., Path]
) -> None:
    body = 'repeat_until = Precision("Energy", half_width="5 %", at_most=30)\ndef duration_s(self, context): return 60'
    table = BLOCKS.replace("repetitions=2", "repetitions=5, data_columns=['Energy']")
    write_config(body, table=table)
    answer = robot_runner("plan", "config.py")
    until = "until the mean of Energy in each combination is known to ± 5 %; at least 5, at most 30 repetitions"
    assert until in " ".join(answer.out.split())
    assert "how often it is repeated until it is precise" in answer.out
    assert "r_20" in answer.out
    assert "r_21" not in answer.out
    assert robot_runner("plan", "config.py", "--json").json["repeat_until"] == until
    checked = " ".join(robot_runner("check", "config.py").out.split())
    assert "hold at 95 % for values that are near to normal, in 88 to 95 % for skewed ones" in checked
    assert until in checked


@pytest.mark.long
def test_where_the_run_table_is_lost_runs_that_are_done_take_no_time(
    robot_runner: Callable, write_config: Callable[..., Path], tmp_path: Path
) -> None:
    write_config(MEASURING)
    robot_runner("run", "config.py", "--skip", "r_4")
    before = robot_runner("plan", "config.py", "--json").json
    (tmp_path / "results" / "trial" / "run_table.csv").unlink()
    answer = robot_runner("plan", "config.py", "--json")
    (finding,) = answer.json.pop("findings")
    assert "the run table is missing" in finding["problem"]
    assert answer.json["duration"]["parts"] == before["duration"]["parts"]
    assert "1 run" in answer.json["duration"]["parts"][0]
    assert {**answer.json, "findings": []} == before


@pytest.mark.long
def test_runs_that_the_journal_has_and_the_table_not_yet_take_no_time(
    robot_runner: Callable, write_config: Callable[..., Path], tmp_path: Path
) -> None:
    write_config(MEASURING)
    robot_runner("run", "config.py", "--skip", "r_4")
    folder = tmp_path / "results" / "trial"
    older, journal = (folder / "run_table.csv").read_text(), folder / "journal.jsonl"
    count = len(journal.read_text().splitlines())
    robot_runner("run", "config.py")
    lines = journal.read_text().splitlines(keepends=True)
    later = [line for line in lines[count:] if '"kind":"table_written"' not in line]
    journal.write_text("".join([*lines[:count], *later]))
    (folder / "run_table.csv").write_text(older)
    assert "none (no run is to be executed)" in robot_runner("plan", "config.py").out


def test_the_measures_of_a_plan_are_the_columns_of_its_run_table(
    robot_runner: Callable, write_config: Callable[..., Path], tmp_path: Path
) -> None:
    write_config("""
quality_columns = True
operator_steps = [OperatorStep("look at it", ask=[Question("Mood")])]
operation_type = OperationType.SEMI
""")
    answer = robot_runner("plan", "config.py", "--json").json
    assert [each["name"] for each in answer["measures"]] == ["Energy", "Energy.quality", "Mood", "Mood.quality"]
