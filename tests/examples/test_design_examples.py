"""Each design's example is executed on the simulated robot; what chose its runs is kept, and resuming changes none."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from tests.long_cases import soak_but

from robot_runner.cli.main import main

if TYPE_CHECKING:
    from collections.abc import Callable

pytestmark = pytest.mark.filterwarnings("ignore:.*multi-threaded:DeprecationWarning")

EXAMPLES = Path(__file__).parents[2] / "examples" / "designs"

#: How many runs each example has.
RUNS = {
    "box_behnken": 14,
    "central_composite": 10,
    "covering_array": 10,
    "d_optimal": 7,
    "fractional_factorial": 8,
    "latin_hypercube": 6,
    "one_factor_at_a_time": 5,
    "sobol": 8,
}


@pytest.fixture
def executed(tmp_path: Path) -> Callable[..., int]:
    def execute(name: str, *more: str) -> int:
        settings = ["--set", "drive_s=0.5", "--set", f"results_output_path={tmp_path}"]
        return main([str(EXAMPLES / f"{name}.py"), *settings, *more])

    return execute


def rows_of(folder: Path) -> list[dict[str, str]]:
    with (folder / "run_table.csv").open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def planned_in(folder: Path) -> list[tuple[str, ...]]:
    design = json.loads((folder / "manifest.json").read_text(encoding="utf-8"))["design"]
    return [tuple(row[name] for name in ("run_id", *design["factors"])) for row in rows_of(folder)]


@pytest.mark.long
@pytest.mark.parametrize("name", soak_but({"central_composite", "one_factor_at_a_time"}, RUNS))
def test_the_example_of_a_design_is_executed_and_resumed_with_the_same_runs(
    name: str, executed: Callable[..., int], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / name
    assert executed(name, "--only", "r_1") == 0
    before = planned_in(folder)
    assert executed(name) == 0, capsys.readouterr()
    assert planned_in(folder) == before, "the order is drawn, and a resumed experiment keeps it"
    table = rows_of(folder)
    assert len(table) == RUNS[name]
    assert {row["status"] for row in table} == {"Done"}
    assert all(float(row["Energy"]) > 0 for row in table)
    design: dict[str, Any] = json.loads((folder / "manifest.json").read_text(encoding="utf-8"))["design"]
    assert design["parameters"]["kind"] == design["facts"]["kind"] == name


@pytest.mark.long
def test_a_design_is_shown_in_words_registered_and_extended_by_repetitions(
    executed: Callable[..., int],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    config = tmp_path / "study.py"
    config.write_text((EXAMPLES / "fractional_factorial.py").read_text(encoding="utf-8"), encoding="utf-8")
    assert main(["plan", str(config)]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert (
        "8 runs, fractional factorial; the full factorial has 16: Task (2) x Speed (2) x Pause (2) x Work (2)" in shown
    )
    assert "Resolution 4: main effects can be told from interactions of two factors" in shown
    assert "Aliases Task x Speed = Pause x Work; Task x Pause = Speed x Work; Task x Work = Speed x Pause" in shown
    assert main(["plan", str(config), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["design"]["facts"]["resolution"] == 4
    assert main(["preregister", str(config)]) == 0
    content = json.loads((tmp_path / "study.registration.json").read_text(encoding="utf-8"))
    assert len(content["design"]["combinations"]) == 8
    changed = config.read_text(encoding="utf-8").replace("resolution=4", "resolution=3")
    config.write_text(changed, encoding="utf-8")
    capsys.readouterr()
    main(["check", str(config)])
    assert "parameters of the design" in capsys.readouterr().out
    assert executed("one_factor_at_a_time", "--only", "r_1") == 0
    settings = ["--set", f"results_output_path={tmp_path}"]
    example = str(EXAMPLES / "one_factor_at_a_time.py")
    assert main(["extend", example, *settings, "--repetitions", "2"]) == 0
    assert len(rows_of(tmp_path / "one_factor_at_a_time")) == 10
    assert main(["extend", example, *settings, "--treatments", "Speed=0.1"]) == 2
    assert "chose its combinations" in capsys.readouterr().err


@pytest.mark.long
def test_a_conditional_factor_stands_in_the_table_by_a_word_and_units_in_the_schema(
    executed: Callable[..., int], tmp_path: Path
) -> None:
    assert executed("d_optimal", "--only", "Task=Network") == 0
    table = rows_of(tmp_path / "d_optimal")
    assert all((row["Work"] == "inactive") == (row["Task"] != "Computation") for row in table)
    assert not [row for row in table if (row["Task"], row["Speed"]) == ("Network", "0.2")]
    long = [float(row["Duration"]) for row in table if row["Task"] == "Network"]
    assert min(long) > 8, "the parameter that is bound to it has its default, 10 s"
    schema = json.loads((tmp_path / "d_optimal" / "run_table.schema.json").read_text(encoding="utf-8"))
    fields = {field["name"]: field for field in schema["fields"]}
    assert "m/s" in json.dumps(fields["Speed"])
    assert "inactive unless Task is Computation" in fields["Work"]["description"]
