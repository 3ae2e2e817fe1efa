"""A package is executed again: the same runs in the same order from the same seed, and deviations are recorded."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from tests.replication.small_experiment import SECRET, execute, own_modules, write_config

from robot_runner.core.errors import ConfigError, PackageError
from robot_runner.core.execution.notices import SilentObserver
from robot_runner.core.execution.orchestrator import execute_experiment
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.manifest import read_manifest
from robot_runner.core.storage.run_table_reading import read_run_table
from robot_runner.core.storage.table_columns import TableLayout
from robot_runner.core.storage.table_schema import read_schema
from robot_runner.replication.replicating import identical_values, prepare_replication


@pytest.fixture(autouse=True)
def _modules_of_its_own():
    with own_modules():
        yield


def _replicate(root, target, **deviations):
    replication = prepare_replication(root, target, deviations)
    finished = execute_experiment(replication.experiment, SilentObserver(), findings=replication.findings)
    assert finished.failed_count == finished.todo_count == 0, finished.failures
    return replication


def _runs(folder):
    files = ExperimentFolder.found_at(folder)
    rows = read_run_table(files.run_table, TableLayout.of_schema(read_schema(files.schema)))
    return [(rows.run_id(place), str(rows.combination(place)), rows.repetition(place)) for place in range(len(rows))]


def _change(path, change):
    facts = json.loads(path.read_text("utf-8"))
    change(facts)
    path.write_text(json.dumps(facts), encoding="utf-8")


def test_the_same_runs_from_a_seed_that_was_drawn_yield_the_same_values(unpacked, tmp_path):
    replication = _replicate(unpacked, tmp_path / "again")
    folder = tmp_path / "again" / "small"
    assert replication.experiment.folder.root == folder
    assert _runs(folder) == _runs(unpacked)
    assert read_manifest(folder / "manifest.json")["seed"] == read_manifest(unpacked / "manifest.json")["seed"]
    same = identical_values(unpacked, folder)
    assert set(same) == {"CPU", "Memory", "Energy", "Phases"}
    assert all(each.is_complete for each in same.values())


def test_a_deviation_is_recorded_as_deliberate(unpacked, tmp_path):
    _replicate(unpacked, tmp_path, robot="simulated:task_power_factor=1.5")
    manifest = read_manifest(tmp_path / "small" / "manifest.json")
    assert manifest["replication"]["deviations"] == {"robot": "simulated:task_power_factor=1.5"}
    assert manifest["replication"]["identified_by"] == "SHA256SUMS"
    assert manifest["deviations"] == {"robot": "simulated:task_power_factor=1.5"}
    assert not identical_values(unpacked, tmp_path / "small")["Energy"].is_complete


def test_what_was_set_originally_is_set_again(tmp_path):
    original = execute(write_config(tmp_path / "study"), robot="simulated:task_power_factor=1.5")
    replication = _replicate(original, tmp_path / "again")
    assert replication.experiment.parameters.robot == "simulated:task_power_factor=1.5"
    assert replication.deviations == {}
    assert identical_values(original, tmp_path / "again" / "small")["Energy"].is_complete


def test_it_is_resumed_as_any_experiment(unpacked, tmp_path):
    _replicate(unpacked, tmp_path)
    folder = ExperimentFolder(tmp_path / "small")
    before = folder.run_table.read_text("utf-8")
    folder.run_table.write_text(before.replace("Done", "Failed", 1), encoding="utf-8")
    _replicate(unpacked, tmp_path)
    attempts = [line for line in folder.journal.read_text("utf-8").splitlines() if '"attempt_started"' in line]
    assert len(attempts) == 5


def test_it_goes_on_only_as_it_was_begun(unpacked, tmp_path):
    _replicate(unpacked, tmp_path)
    with pytest.raises(PackageError, match="begun with no --set"):
        prepare_replication(unpacked, tmp_path, {"robot": "simulated:task_power_factor=2"})


def test_another_experiment_in_the_folder_is_left_alone(unpacked, tmp_path):
    execute(write_config(tmp_path / "study"), results_output_path=str(tmp_path))
    with pytest.raises(PackageError, match="another experiment"):
        prepare_replication(unpacked, tmp_path, {})


def test_a_table_that_was_written_by_hand_is_executed_again_as_it_is(tmp_path):
    config = write_config(tmp_path / "study")
    folder = tmp_path / "study" / "results" / "small"
    folder.mkdir(parents=True)
    table = "run_id,Task,Repetition\nfirst,Network,1\nsecond,Network,2\nlast,Video,1\n"
    (folder / "run_table.csv").write_text(table, encoding="utf-8")
    original = execute(config)
    _replicate(original, tmp_path / "again")
    assert [run for run, _, _ in _runs(tmp_path / "again" / "small")] == ["first", "second", "last"]
    assert identical_values(original, tmp_path / "again" / "small")["Energy"].is_complete


def test_runs_that_the_config_plans_otherwise_here_are_those_of_the_package(unpacked, tmp_path):
    path = unpacked / "config" / "small.py"
    path.write_text(path.read_text("utf-8").replace("repetitions=2", "repetitions=3"), encoding="utf-8")
    replication = _replicate(unpacked, tmp_path)
    assert "plans other runs" in replication.findings[-1].problem
    assert _runs(tmp_path / "small") == _runs(unpacked)


def test_a_plugin_that_is_not_installed_is_named_with_its_package(unpacked, tmp_path):
    _change(
        unpacked / "manifest.json",
        lambda facts: facts["plugins"].append(
            {"name": "Lidar", "class": "lidar_of_ours.plugin:Lidar", "package": "lidar-of-ours", "version": "2.1"}
        ),
    )
    with pytest.raises(PackageError) as refused:
        prepare_replication(unpacked, tmp_path, {})
    assert "Lidar" in refused.value.where
    assert refused.value.fix == "Install it: pip install lidar-of-ours==2.1"
    assert not (tmp_path / "small").exists()


def test_a_module_that_is_not_installed_is_named_before_anything_is_executed(unpacked, tmp_path):
    path = unpacked / "config" / "packed_paces.py"
    path.write_text(f"open({str(tmp_path / 'executed')!r}, 'w')\nimport no_such_module\n", encoding="utf-8")
    with pytest.raises(PackageError, match="no_such_module"):
        prepare_replication(unpacked, tmp_path, {})
    assert not (tmp_path / "executed").exists()


def test_a_folder_without_config_cannot_be_executed(unpacked, tmp_path):
    shutil.rmtree(unpacked / "config")
    with pytest.raises(PackageError, match="is missing"):
        prepare_replication(unpacked, tmp_path, {})


def test_a_setting_that_was_replaced_is_asked_for(unpacked, tmp_path):
    def hide(facts):
        facts["executions"][-1]["deviations"] = {"wifi_password": "REDACTED"}

    _change(unpacked / "manifest.json", hide)
    with pytest.raises(PackageError, match="was replaced"):
        prepare_replication(unpacked, tmp_path, {})
    replication = prepare_replication(unpacked, tmp_path, {"wifi_password": SECRET})
    assert replication.experiment.config.wifi_password == SECRET


def test_what_cannot_be_set_is_refused(unpacked, tmp_path):
    with pytest.raises(ConfigError, match="'robott'"):
        prepare_replication(unpacked, tmp_path, {"robott": "simulated"})


def test_nothing_is_written_into_the_original(unpacked, tmp_path):
    before = {path: path.stat().st_mtime_ns for path in Path(unpacked).rglob("*")}
    _replicate(unpacked, tmp_path / "again")
    assert {path: path.stat().st_mtime_ns for path in Path(unpacked).rglob("*")} == before
