"""Each design that decides order or blocks has an example, which is executed whole."""

from __future__ import annotations

import csv
import json
from itertools import pairwise
from pathlib import Path

import pytest
from tests.long_cases import soak_but

from robot_runner.analysis.report.writing import ReportFormat, write_report
from robot_runner.cli.main import main

pytestmark = pytest.mark.filterwarnings("ignore:.*multi-threaded:DeprecationWarning")

EXAMPLES = Path(__file__).parents[2] / "examples" / "designs"
#: How many runs each has, and what of its layout `plan` says.
EXPECTED = {
    "latin_square": (9, "Day \\ Battery  A"),
    "graeco_latin_square": (9, "Computation · "),
    "incomplete_blocks": (21, "each pair together 1 time, efficiency 0.778"),
    "crossover": (16, "each treatment follows each other one in 1 unit"),
    "split_plot": (18, "in 6 whole plots"),
}


@pytest.mark.long
@pytest.mark.parametrize("name", soak_but({"split_plot"}, EXPECTED))
def test_an_example_shows_its_layout_is_executed_and_is_analysed(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    config = str(EXAMPLES / f"{name}.py")
    assert main(["plan", config]) == 0
    runs, said = EXPECTED[name]
    assert said in capsys.readouterr().out
    assert main([config, "--set", f"results_output_path={tmp_path}", "--set", "workers=2"]) == 0
    answer = capsys.readouterr()
    assert answer.err == ""
    assert "  ! " not in answer.out, "nothing looks odd"
    with (tmp_path / name / "run_table.csv").open(encoding="utf-8", newline="") as file:
        table = list(csv.DictReader(file))
    assert len(table) == runs
    assert {row["status"] for row in table} == {"Done"}
    if name == "split_plot":
        assert sum(one["Floor"] != other["Floor"] for one, other in pairwise(table)) <= 5
    facts = json.loads((tmp_path / name / "manifest.json").read_text(encoding="utf-8"))["design"]["facts"]
    assert facts["layout"]
    report = write_report(tmp_path / name, ReportFormat.JSON, output=tmp_path / "out").document
    assert facts["kind"].replace("_", " ") in report.read_text(encoding="utf-8")
    assert main(["plan", config, "--set", f"results_output_path={tmp_path}"]) == 0, "and again from the table on disk"
