"""Designs of order and blocks keep their plan through kills: registered, killed twice, resumed, packed, replicated."""

from __future__ import annotations

import csv
import json
import signal
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import pytest
from tests.process.conftest import wait_until

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from tests.command_line import Answer

FACTORS = {
    "Crossover('Robot', 'Period', washout_in_s=0.05)": {"Robot": "ABCD", "Period": "1234", "Task": "abcd"},
    "SplitPlot('Floor', 'Plot')": {"Plot": "123456", "Floor": "wc", "Task": "abc"},
    "LatinSquare('Day', 'Robot')": {"Day": "1234", "Robot": "ABCD", "Task": "abcd"},
}
#: One of them every time, all of them in `make soak`.
EACH = [pytest.param(each, marks=[pytest.mark.soak] * (not each.startswith("LatinSquare"))) for each in FACTORS]
BODY = """
analysis = AnalysisPlan("Energy")
claims = []
grace_in_s = 1

def create_run_table(self):
    from robot_runner.designs import Crossover, LatinSquare, SplitPlot
    factors = [Factor(name, list(texts)) for name, texts in FACTORS.items()]
    return RunTableModel(factors, shuffle=True, data_columns=["Energy"], design=DESIGN)

def launch_mission(self, context):
    import time
    context.combination["Task"]
    place = Path(__file__).parent
    if (place / "wanted").exists() and (place / "wanted").read_text() == context.run_id:
        (place / f"{context.run_id} moves").touch()
        time.sleep(60)

def populate_run_data(self, context):
    return {"Energy": 10.0 + context.run_number}
"""


def moved_through(folder: Path) -> list[tuple[str, str]]:
    lines = [json.loads(line) for line in (folder / "journal.jsonl").read_text(encoding="utf-8").splitlines()]
    return [(each["run"], each["status"]) for each in lines if each["kind"] == "attempt_finished"]


def planned(folder: Path) -> list[tuple[str, ...]]:
    with (folder / "run_table.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    left = {"status", "Energy"} | {name for name in rows[0] if name.endswith("_at")}
    return [tuple(text for name, text in row.items() if name not in left) for row in rows]


@pytest.mark.long
@pytest.mark.parametrize("design", EACH)
def test_a_design_of_order_is_the_same_after_kills_and_in_its_replication(
    start: Callable[..., Any],
    robot_runner: Callable[..., Answer],
    write_config: Callable[..., Path],
    tmp_path: Path,
    design: str,
) -> None:
    body = BODY.replace("FACTORS", repr(FACTORS[design])).replace("DESIGN", design)
    config = write_config(body, table="")
    answer = robot_runner("preregister", config)
    assert answer.code == 0, answer.err
    before: list[tuple[str, ...]] = []
    for run_id in ("r_3", "r_7"):
        (tmp_path / "wanted").write_text(run_id)
        experiment = start(config=config)
        experiment.wait_for(f"{run_id} moves")
        experiment.send(signal.SIGKILL)
        experiment.end()
        wait_until(lambda killed=experiment: not killed.processes(), "no process is left")
        now = planned(experiment.folder)
        assert before in ([], now)
        before = now
    (tmp_path / "wanted").unlink()
    last = start(config=config)
    assert last.end() == 0, last.output
    assert set(last.statuses) == {"Done"}
    assert planned(last.folder) == before
    done = [run_id for run_id, status in moved_through(last.folder) if status == "done"]
    numbers = [int(run_id.removeprefix("r_")) for run_id in done]
    assert sorted(numbers) == list(range(1, len(before) + 1)), "each run is done once"
    assert all(one < other for one, other in pairwise(numbers)), "in the order of the plan"
    assert [row["Energy"] for row in last.table] == [str(10.0 + number) for number in numbers]
    # The registration holds: nothing was changed, and nothing is left out of the analysis.
    out = tmp_path / "report"
    answer = robot_runner("report", last.folder, "--format", "json", "--figures", "none", "--output", out)
    assert answer.code == 0, answer.err
    report = json.loads((out / "report.json").read_text(encoding="utf-8"))
    assert report["statistics"]["is_planned"]
    assert report["statistics"]["measures"][0]["left_out"] == []
    assert not [each for each in report["threats"] if "registration" in each["title"].casefold()]
    # A reviewer executes the package: the same plan in the same order.
    answer = robot_runner("pack", last.folder, "--no-wheels", "--to", tmp_path / "package.zip")
    assert answer.code == 0, answer.err
    answer = robot_runner("replicate", tmp_path / "package.zip", "--to", tmp_path / "again", "--plain", "--yes")
    assert answer.code == 0, (answer.out, answer.err)
    again = next((tmp_path / "again").rglob("run_table.csv")).parent
    assert planned(again) == before
    assert [run_id for run_id, _ in moved_through(again)] == done
