"""The command shows what it understood before it writes."""

from __future__ import annotations

import json
import signal

import pytest
from tests.analysis.importing.foreign_folder import make_earlier_folder, write

from robot_runner.analysis import load_results
from robot_runner.analysis.importing import adoption
from robot_runner.cli.main import main


@pytest.fixture
def root(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return make_earlier_folder(tmp_path / "earlier")


def test_a_dry_run_shows_and_writes_nothing(root, tmp_path, capsys):
    assert main(["import", str(root), "--dry-run"]) == 0
    shown = capsys.readouterr().out
    for part in (
        "earlier: what was understood of run_table.csv",
        "3 done, 1 to do",
        "power_mW in mW",
        "integral(power.csv:power_mW) (guessed)",
        "unit not known",
        "Nothing was written",
    ):
        assert part in shown
    assert [path.name for path in tmp_path.iterdir()] == ["earlier"]


def test_without_a_terminal_it_wants_a_yes(root, tmp_path, capsys):
    assert main(["import", str(root)]) == 2
    assert "add --yes" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["earlier"]


def test_with_a_yes_it_writes_and_lists_the_differences(root, tmp_path, capsys):
    assert main(["import", str(root), "--yes"]) == 0
    shown = capsys.readouterr().out
    assert "energy_J: 1 of 3 runs differ by more than 0.1%" in shown
    assert "run_2: 30 J in the table, 24 J recomputed (-20.00%)" in shown
    assert len(load_results(tmp_path / "earlier_imported").done) == 3


def test_nobody_is_told_to_go_on_with_results_that_were_imported(root, tmp_path, capsys):
    assert main(["import", str(root), "--yes"]) == 0
    capsys.readouterr()
    assert main(["status", "earlier_imported"]) == 0
    shown = capsys.readouterr().out
    assert "State imported: the runs were executed elsewhere, and there is no config with which to go on" in " ".join(
        shown.split()
    )
    assert "Left" not in shown
    assert main(["replicate", "earlier_imported", "--yes"]) == 2
    refused = capsys.readouterr()
    assert "earlier_imported: there is no config: these results were made elsewhere" in refused.err
    assert refused.out == ""
    assert [path.name for path in tmp_path.iterdir() if path.name.endswith("_replication")] == []


def test_a_recomputed_value_has_its_own_unit_beside_a_column_in_another_one(root, capsys):
    table = root / "run_table.csv"
    table.write_text(table.read_text().replace("energy_J", "energy_mJ"))
    assert main(["import", str(root), "--yes"]) == 0
    assert "run_2: 0.03 J in the table, 24 J recomputed" in capsys.readouterr().out
    assert main(["explain", "earlier_imported", "run_2"]) == 0
    shown = [" ".join(line.split()) for line in capsys.readouterr().out.splitlines()]
    assert "energy_mJ 30.00 mJ measure" in shown
    assert "energy_mJ (recomputed, J) 24.00 measure" in shown


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_that_ends_it_leaves_nothing_half_written(number, root, tmp_path, monkeypatch, capsys):
    def stop(*_):
        assert [path.name for path in tmp_path.iterdir() if path.name.startswith(".earlier_imported.")]
        signal.raise_signal(number)

    def unheard(*_):
        raise AssertionError

    monkeypatch.setattr(adoption, "write_manifest", stop)
    earlier = signal.signal(number, unheard)
    try:
        assert main(["import", str(root), "--yes"]) == 130
        assert signal.getsignal(number) is unheard
    finally:
        signal.signal(number, earlier)
    assert "interrupted" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["earlier"]


def unsure(tmp_path):
    rows = "".join(f"{n % 7 == 0:d},{n}.25\n" for n in range(12))
    write(tmp_path / "doubt" / "run_table.csv", f"level,energy_J\n{rows}")
    return str(tmp_path / "doubt")


def test_the_preview_shows_columns_with_role_unit_confidence_and_first_rows(tmp_path, capsys):
    assert main(["import", unsure(tmp_path), "--dry-run"]) == 0
    shown = [" ".join(line.split()) for line in capsys.readouterr().out.splitlines()]
    for line in (
        "column role unit sure? row 1 row 2 row 3 because",
        "level factor unsure 1 0 0 2 numbers before the measures, unevenly repeated",
        "energy_J measure J sure 0.25 1.25 2.25 numbers that differ in most runs",
        "Design 2 (level), 2 to 10 runs a combination: 12 runs",
    ):
        assert line in shown


def test_a_yes_is_refused_where_something_is_not_sure(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["import", unsure(tmp_path), "--yes", "--to", "ours"]) == 2
    complaint = capsys.readouterr().err
    assert "column 'level' is taken for a factor: 2 numbers before the measures, unevenly repeated" in complaint
    assert "--factor level, --measure level or --ignore level" in complaint
    assert not (tmp_path / "ours").exists()
    assert main(["import", unsure(tmp_path), "--yes", "--to", "ours", "--measure", "level"]) == 0
    assert load_results("ours").measures == ("level", "energy_J")


def test_json_has_each_column_with_its_reason_and_the_questions(tmp_path, capsys):
    assert main(["import", unsure(tmp_path), "--dry-run", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["columns"][1] == {
        "name": "energy_J",
        "role": "measure",
        "unit": "J",
        "confidence": "sure",
        "reason": "numbers that differ in most runs",
    }
    assert [each["problem"].partition(":")[0] for each in told["questions"]] == ["column 'level' is taken for a factor"]


@pytest.mark.parametrize(("answer", "code"), [("y", 0), ("n", 2), ("", 2)])
def test_at_a_terminal_it_asks(root, tmp_path, monkeypatch, answer, code):
    monkeypatch.setattr("robot_runner.analysis.commands.import_.terminal_input", lambda: 0)
    monkeypatch.setattr("builtins.input", lambda question: answer)
    assert main(["import", str(root), "--to", "ours"]) == code
    assert (tmp_path / "ours").exists() is (code == 0)


def test_everything_can_be_said_by_options(tmp_path, capsys):
    root = tmp_path / "made by hand"
    write(root / "runs.csv", "nr;what;spent;who;again\n1;video;0,5;me;0\n2;network;0,25;you;0\n")
    for number in (1, 2):
        write(root / "raw" / f"run{number}" / "meter.csv", "when;value\n0;900\n1000;900\n")
    said = [
        *("--name", "Rover", "--table", "runs.csv", "--run-id", "nr", "--factor", "what", "--measure", "spent"),
        *("--repetition", "again", "--ignore", "who", "--unit", "spent=mWh", "--run-folder", "raw/run{run_id}"),
        *("--samples", "meter.csv:when:ms", "--sample-unit", "meter.csv:value=mW", "--origin", "measured"),
        *("--recompute", "spent=integral(meter.csv:value)", "--no-guess", "--to", str(tmp_path / "ours"), "--yes"),
        *("--save-description", str(tmp_path / "said.toml"), "--json"),
    ]
    assert main(["import", str(root), *said]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["factors"] == {"what": ["video", "network"]}
    assert told["differences"][0]["recomputed"] == pytest.approx(0.9)
    results = load_results(tmp_path / "ours")
    assert (results.name, results.unit("spent")) == ("Rover", "mWh")
    assert results.samples()["value_W"].tolist() == [0.9] * 4
    assert 'time_unit = "ms"' in (tmp_path / "said.toml").read_text("utf-8")


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        (["--unit", "energy"], "'energy' names no unit"),
        (["--unit", "energy=Jule"], "'Jule' is not a unit that is known"),
        (["--samples", "power.csv"], "'power.csv' names no column"),
        (["--samples", "power.csv:t:weeks"], "times cannot be in 'weeks'"),
        (["--sample-unit", "power=mW"], "'power=mW' names no file"),
        (["--recompute", "energy"], "'energy' is not a recipe"),
        (["--description", "none.toml"], "cannot be read"),
    ],
)
def test_slips_are_refused_with_a_fix(root, capsys, words, problem):
    assert main(["import", str(root), "--dry-run", *words]) == 2
    complaint = capsys.readouterr().err
    assert problem in complaint
    assert "fix:" in complaint


def test_export_names_the_data_package(root, tmp_path, capsys):
    main(["import", str(root), "--yes", "--to", "ours"])
    capsys.readouterr()
    assert main(["export", "ours", "--to", "out", "--json"]) == 0
    files = json.loads(capsys.readouterr().out)["files"]
    assert files[-1].endswith("datapackage.json")
    assert all((tmp_path / name).exists() for name in files)
