"""A package is executed again: the same runs in the same order from the same seed, and deviations are recorded."""

from __future__ import annotations

import hashlib
import json
import shutil
import sys
import zipfile
from pathlib import Path

import pytest
from tests.analysis.experiment_folders import two_tasks
from tests.legacy.earlier_configs import RUNNER, SHORT_TABLE
from tests.replication.small_experiment import SECRET, execute, own_modules, write_config

from robot_runner.cli.extension import ExtensionRequest, extend_experiment
from robot_runner.core.config.preparation import prepare
from robot_runner.core.design.extended_design import Additions
from robot_runner.core.errors import ConfigError, Finding, PackageError
from robot_runner.core.execution.notices import SilentObserver
from robot_runner.core.execution.orchestrator import execute_experiment
from robot_runner.core.execution.resumption import Resumption
from robot_runner.core.execution.systems_state import SystemsFile
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.manifest import read_manifest
from robot_runner.core.storage.run_table_reading import read_run_table
from robot_runner.core.storage.table_columns import TableLayout
from robot_runner.core.storage.table_schema import read_schema
from robot_runner.replication import replicating
from robot_runner.replication.differences import missing_modules
from robot_runner.replication.replicating import prepare_replication, replicated_folder
from robot_runner.replication.run_by_run import Sameness, identical_values

GROWING = """
from robot_runner import ExperimentConfig, Factor, RunProcess, RunTableModel

class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "growing"
    results_output_path = "results"
    run_process = RunProcess.IN_PROCESS

    def create_run_table(self):
        return RunTableModel([Factor("Task", ["Video", "Network"])], shuffle=True, data_columns=["Number"], warm_up=1)

    def populate_run_data(self, context):
        return {"Number": context.run_number}
"""


@pytest.fixture(autouse=True)
def _modules_of_its_own():
    with own_modules():
        yield


def _replicate(root, target, **deviations):
    replication = prepare_replication(root, target, deviations)
    finished = execute_experiment(replication.experiment, SilentObserver(), findings=replication.findings)
    assert finished.failed_count == finished.todo_count == 0, finished.failures
    return replication


@pytest.fixture(scope="module")
def replicated(packed, tmp_path_factory):
    """Return the original, its replication, and when each of the original's files was written before and afterwards."""
    original, target = tmp_path_factory.mktemp("original"), tmp_path_factory.mktemp("again")
    with zipfile.ZipFile(packed.path) as archive:
        archive.extractall(original)
    before = _written_at(original)
    with own_modules():
        _replicate(original, target)
    return original, target / "small", before, _written_at(original)


@pytest.fixture(scope="module")
def of_a_table_by_hand(tmp_path_factory):
    """Return an experiment with a run table written by hand and a parameter set by hand, and its replication."""
    config = write_config(tmp_path_factory.mktemp("study"))
    folder = config.parent / "results" / "small"
    folder.mkdir(parents=True)
    table = "run_id,Task,Repetition\nfirst,Network,1\nsecond,Network,2\nlast,Video,1\n"
    (folder / "run_table.csv").write_text(table, encoding="utf-8")
    original = execute(config, robot="simulated:task_power_factor=1.5")
    head, *rows = (original / "run_table.csv").read_text("utf-8").splitlines()
    counted = [f"{head},Collisions", *(f"{row},7" for row in rows)]  # by a person who looked on
    (original / "run_table.csv").write_text("\n".join(counted) + "\n", encoding="utf-8")
    with own_modules():
        return original, _replicate(original, tmp_path_factory.mktemp("again"))


def _written_at(folder):
    return {path: path.stat().st_mtime_ns for path in folder.rglob("*")}


def _runs(folder):
    files = ExperimentFolder.found_at(folder)
    rows = read_run_table(files.run_table, TableLayout.of_schema(read_schema(files.schema)))
    return [(rows.run_id(place), str(rows.combination(place)), rows.repetition(place)) for place in range(len(rows))]


def _change(path, change):
    facts = json.loads(path.read_text("utf-8"))
    change(facts)
    path.write_text(json.dumps(facts), encoding="utf-8")


@pytest.mark.long
def test_what_a_killed_replication_has_left_is_seen_to_as_soon_as_its_config_is_known(
    replicated, tmp_path, monkeypatch
):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    (tmp_path / "small").mkdir()
    file = SystemsFile(ExperimentFolder(tmp_path / "small"))
    file.begin("simulated", {"run_id": "r_1"})
    findings = prepare_replication(replicated[0], tmp_path, {}).findings
    assert any("an earlier execution was killed in r_1 (simulated)" in each.problem for each in findings)
    assert file.left() is None


def test_the_same_runs_from_a_seed_that_was_drawn_yield_the_same_values(replicated):
    original, folder, _, _ = replicated
    assert _runs(folder) == _runs(original)
    assert read_manifest(folder / "manifest.json")["seed"] == read_manifest(original / "manifest.json")["seed"]
    same = identical_values(original, folder)
    assert set(same) == {"CPU", "Memory", "Energy", "Phases"}
    assert all(each.is_complete for each in same.values())


@pytest.mark.long
def test_a_deviation_is_recorded_as_deliberate(unpacked, tmp_path):
    _replicate(unpacked, tmp_path, robot="simulated:task_power_factor=1.5")
    manifest = read_manifest(tmp_path / "small" / "manifest.json")
    assert manifest["replication"]["deviations"] == {"robot": "simulated:task_power_factor=1.5"}
    assert manifest["replication"]["identified_by"] == "SHA256SUMS"
    assert manifest["deviations"] == {"robot": "simulated:task_power_factor=1.5"}
    assert not identical_values(unpacked, tmp_path / "small")["Energy"].is_complete


@pytest.mark.parametrize("name", ["results_output_path", "registration"])
def test_what_a_replication_decides_itself_is_not_ignored_where_it_is_set(unpacked, tmp_path, name):
    with pytest.raises(PackageError, match="a replication takes no such setting"):
        prepare_replication(unpacked, tmp_path, {name: "elsewhere"})


@pytest.mark.long
def test_a_replication_asks_for_no_cluster_of_the_original(unpacked, tmp_path):
    their_own = {"cluster": "tcp://their-lab:8786"}
    _change(unpacked / "manifest.json", lambda manifest: manifest["executions"][-1].update(deviations=their_own))
    experiment = prepare_replication(unpacked, tmp_path, {}).experiment
    assert experiment.parameters.cluster is None
    assert "cluster" not in experiment.overrides


@pytest.mark.long
def test_what_was_set_originally_is_set_again(of_a_table_by_hand):
    original, replication = of_a_table_by_hand
    assert replication.experiment.parameters.robot == "simulated:task_power_factor=1.5"
    assert replication.experiment.replication["deviations"] == {}
    assert identical_values(original, replication.experiment.folder.root)["Energy"].is_complete


@pytest.mark.long
def test_it_is_resumed_as_any_experiment(unpacked, replicated, tmp_path):
    folder = ExperimentFolder(Path(shutil.copytree(replicated[1], tmp_path / "small")))
    before = folder.run_table.read_text("utf-8")
    folder.run_table.write_text(before.replace("Done", "Failed", 1), encoding="utf-8")
    history = folder.journal.read_text("utf-8")
    folder.journal.write_text(history.replace('"status":"done"', '"status":"failed"', 1), encoding="utf-8")
    assert _replicate(unpacked, tmp_path).experiment.folder.root == folder.root
    attempts = [line for line in folder.journal.read_text("utf-8").splitlines() if '"attempt_started"' in line]
    assert len(attempts) == 5


def test_it_goes_on_only_as_it_was_begun(unpacked, replicated, tmp_path):
    shutil.copytree(replicated[1], tmp_path / "small")
    with pytest.raises(PackageError, match="begun with no --set"):
        prepare_replication(unpacked, tmp_path, {"robot": "simulated:task_power_factor=2"})


def test_another_experiment_in_the_folder_is_left_alone(unpacked, experiment, tmp_path):
    shutil.copytree(experiment, tmp_path / "small")
    with pytest.raises(PackageError, match="another experiment"):
        prepare_replication(unpacked, tmp_path, {})


@pytest.mark.long
def test_what_was_done_to_a_robot_is_told_also_where_the_replication_is_refused_then(
    unpacked, experiment, tmp_path, monkeypatch
):
    shutil.copytree(experiment, tmp_path / "small")
    done = Finding.warning("r_1", "the robot was commanded to stand still now", "Check where it stands.")
    monkeypatch.setattr(replicating, "see_to_it_first", lambda _: [done])
    with pytest.raises(PackageError, match="another experiment") as refused:
        prepare_replication(unpacked, tmp_path, {})
    assert done in refused.value.findings


def test_a_table_that_was_written_by_hand_is_executed_again_as_it_is(of_a_table_by_hand):
    original, replication = of_a_table_by_hand
    folder = replication.experiment.folder.root
    assert [run for run, _, _ in _runs(folder)] == ["first", "second", "last"]
    assert identical_values(original, folder)["Energy"].is_complete
    assert "Collisions" not in (folder / "run_table.csv").read_text("utf-8")


@pytest.mark.long
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


def test_modules_from_elsewhere_are_needed_no_more(tmp_path, monkeypatch):
    elsewhere = tmp_path / "elsewhere" / "tools_of_all_studies"
    elsewhere.mkdir(parents=True)
    (elsewhere / "__init__.py").touch()
    (elsewhere / "numbers.py").write_text("def number(context):\n    return 7 * context.run_number\n", encoding="utf-8")
    config = tmp_path / "study" / "study.py"
    config.parent.mkdir()
    reached = GROWING.replace(
        "from robot_runner", f"import sys\nsys.path.append({str(elsewhere.parent)!r})\nfrom robot_runner", 1
    )
    body = "from tools_of_all_studies.numbers import number\n        return {'Number': number(context)}"
    config.write_text(reached.replace('return {"Number": context.run_number}', body), encoding="utf-8")
    monkeypatch.setattr(sys, "path", [*sys.path])
    with own_modules():
        original = execute(config)
    shutil.rmtree(tmp_path / "elsewhere")
    _replicate(original, tmp_path / "again")
    assert identical_values(original, tmp_path / "again" / "growing") == {"Number": Sameness(runs=2, identical=2)}


def test_modules_in_a_folder_that_the_config_adds_to_the_path_are_none_that_have_to_be_installed(tmp_path):
    config = tmp_path / "config"
    (config / "src" / "parts_of_it").mkdir(parents=True)
    for name in ("words_of_it.py", "parts_of_it/__init__.py"):
        (config / "src" / name).touch()
    (config / "study.py").write_text(
        "import sys\nsys.path.insert(0, 'src')\nimport parts_of_it, words_of_it, of_nobody\n"
    )
    (finding,) = missing_modules(tmp_path, {})
    assert "of_nobody" in finding.problem


def test_that_the_config_was_changed_while_the_original_was_executed_is_said(tmp_path: Path) -> None:
    config = tmp_path / "growing.py"
    config.write_text(GROWING, encoding="utf-8")
    experiment = prepare(config).experiment
    execute_experiment(experiment, SilentObserver(), resumption=Resumption(only=("r_1",)))
    config.write_text(GROWING.replace("context.run_number", "7 * context.run_number"), encoding="utf-8")
    experiment = prepare(config).experiment
    execute_experiment(experiment, SilentObserver(), resumption=Resumption(accept_changes=True))
    (told,) = prepare_replication(tmp_path / "results/growing", tmp_path / "again", {}).findings
    assert told.problem == (
        "the config was changed while the original was executed: runs that were done before are executed by its last "
        "version here"
    )
    assert "diff -r" in told.fix


@pytest.mark.parametrize("head", ["", "import random\nrandom.seed(hash(__file__) % 1000)\n"])
def test_a_shuffled_config_of_an_earlier_tool_is_replicated_from_its_seed(tmp_path: Path, head: str) -> None:
    table = SHORT_TABLE.replace("[10, 20]", "list(range(30))").replace("data_columns", "shuffle=True, data_columns")
    config = tmp_path / "study.py"
    config.write_text(f"{head}{RUNNER}{table}", encoding="utf-8")
    original = prepare(config, {"results_output_path": str(tmp_path / "results")}).experiment
    execute_experiment(original, SilentObserver())
    experiment, findings = prepare_replication(original.folder.root, tmp_path / "again", {})
    assert [run.run_id for run in experiment.model.plan()] == [run.run_id for run in original.model.plan()]
    assert (experiment.model.seed, experiment.model.seed_is_given) == (original.model.seed, bool(head))
    assert not [finding.problem for finding in findings if "plans other runs" in finding.problem]
    assert not experiment.folder.run_table.exists()  # the config plans it: it is none that was written by hand


def test_a_module_that_the_config_can_do_without_need_not_be_installed(tmp_path: Path) -> None:
    (tmp_path / "config").mkdir()
    (tmp_path / "config" / "study.py").write_text(
        "import sys\nfrom contextlib import suppress\nfrom typing import TYPE_CHECKING\n"
        "try:\n    import faster_of_nobody\nexcept ImportError:\n    faster_of_nobody = None\n"
        "with suppress(ImportError):\n    import prettier_of_nobody\n"
        "if TYPE_CHECKING:\n    from types_of_nobody import Node\n"
        "if sys.version_info >= (3, 8):\n    import json\nelse:\n    import older_of_nobody\n"
        "def drive():\n    try:\n        import driver_of_nobody\n    except ModuleNotFoundError:\n        pass\n"
        "    import wheels_of_nobody\n"
    )
    (finding,) = missing_modules(tmp_path, {})
    assert "the config imports wheels_of_nobody" in finding.problem


@pytest.mark.parametrize(
    ("packed", "fix"),
    [
        (None, "pip install Lab.Watt==2.3"),
        ("lab_watt-2.3-py3-none-any.whl", "pip install '{wheel}'"),
        ("lab_watt-2.2-py3-none-any.whl", "pip install Lab.Watt==2.3"),
    ],
)
def test_a_plugin_that_is_missing_is_installed_from_the_package_where_that_has_it(
    tmp_path: Path, packed: str | None, fix: str
) -> None:
    root = tmp_path / "a package"
    (root / "config").mkdir(parents=True)
    wheel = root / "environment" / "wheels" / str(packed)
    if packed:
        wheel.parent.mkdir(parents=True)
        wheel.touch()
    plugin = {"name": "B", "class": "lab_watt_of_ours:LabWatt", "package": "Lab.Watt", "version": "2.3"}
    (finding,) = missing_modules(root, {"plugins": [plugin]})
    assert finding.problem == "LabWatt, of Lab.Watt, is not installed"
    assert fix.format(wheel=wheel) in finding.fix


def test_nothing_is_executed_to_find_out_whether_a_plugin_is_installed(tmp_path, monkeypatch):
    for where, text in (("strange_package", "raise RuntimeError"), ("config", "")):
        (tmp_path / where).mkdir()
        (tmp_path / where / "__init__.py").write_text(text, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    assert missing_modules(tmp_path, {"plugins": [{"name": "P", "class": "strange_package.plugin:P"}]}) == []


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


def test_nothing_is_written_into_the_original(replicated):
    _, _, before, after = replicated
    assert after == before


@pytest.mark.long
def test_a_name_that_the_config_makes_from_the_time_is_that_of_the_original(tmp_path):
    named = GROWING.replace('"growing"', "f\"growing_{__import__('time').time_ns()}\"")
    (tmp_path / "study.py").write_text(named, encoding="utf-8")
    original = execute(tmp_path / "study.py")
    again = prepare_replication(original, tmp_path / "again", {}).experiment
    assert again.folder.root == tmp_path / "again" / original.name
    assert again.overrides == {}


def test_an_experiment_that_was_extended_is_executed_again_with_its_batches(tmp_path):
    config = tmp_path / "study.py"
    config.write_text(GROWING, encoding="utf-8")
    original = execute(config)
    for added in (Additions(2, {"Task": ["Audio"]}), Additions(3)):
        extend_experiment(prepare(config, is_for_here=False).experiment, ExtensionRequest(added=added, seed=3))
    execute(config)
    target = tmp_path / "again"
    again, journal = target / "growing", target / "growing" / "journal.jsonl"
    assert prepare_replication(original, target, {}).findings == ()
    journal.write_bytes(journal.read_bytes().splitlines(keepends=True)[0])  # killed before the record of the last batch
    _replicate(original, target)  # what an earlier try has left is gone on with
    assert _runs(again) == _runs(original)
    assert len(_runs(again)) == 3 + 5 + 4
    manifest, was = (read_manifest(ExperimentFolder(folder).manifest) for folder in (again, original))
    assert manifest["design"] == was["design"]
    assert [batch["batch"] for batch in manifest["design"]["batches"]] == [1, 2, 3]
    assert identical_values(original, again) == {"Number": Sameness(runs=9, identical=9)}
    (again / "run_table.csv").unlink()
    execute_experiment(prepare_replication(original, target, {}).experiment, SilentObserver())
    assert _runs(again) == _runs(original)


@pytest.mark.long
def test_a_replication_has_the_repetitions_that_were_added_until_the_original_was_precise(tmp_path):
    config = tmp_path / "study.py"
    body = GROWING.replace("import ExperimentConfig", "import ExperimentConfig, Precision").replace(
        "shuffle=True,", "shuffle=True, repetitions=3,"
    )
    rule = '    repeat_until = Precision("Number", half_width=4, at_most=8)\n    results_output_path'
    config.write_text(body.replace("    results_output_path", rule), encoding="utf-8")
    original = execute(config)  # its values grow with the number of the run: it becomes less precise with each
    assert len(_runs(original)) == 1 + 2 * 8
    _replicate(original, tmp_path / "again")
    again = tmp_path / "again" / "growing"
    assert _runs(again) == _runs(original)
    manifest, was = (read_manifest(ExperimentFolder(folder).manifest) for folder in (again, original))
    assert (manifest["design"], manifest["repeat_until"]) == (was["design"], was["repeat_until"])
    assert manifest["repeat_until"]["least"] == 3


@pytest.mark.long
def test_a_run_in_an_interpreter_of_its_own_writes_into_the_replication_and_knows_added_treatments(tmp_path):
    config = tmp_path / "study.py"
    told = "    def launch_mission(self, context):\n"
    told += '        (context.run_folder / "task").write_text(context.combination["Task"])\n'
    config.write_text(GROWING.replace("IN_PROCESS", "SPAWN") + told, encoding="utf-8")
    original = execute(config)
    request = ExtensionRequest(added=Additions(treatments={"Task": ["Audio"]}), seed=3)
    extend_experiment(prepare(config, is_for_here=False).experiment, request)
    execute(config)
    before = _written_at(original)
    _replicate(original, tmp_path / "again")
    assert _written_at(original) == before
    assert (tmp_path / "again" / "growing" / "runs" / "r_3" / "task").read_text("utf-8") == "Audio"


def test_of_several_executions_of_one_package_the_one_that_was_set_so_is_found(tmp_path):
    original = two_tasks(tmp_path / "original", (1.0,), (3.0,)).root
    digest = hashlib.sha256((original / "manifest.json").read_bytes()).hexdigest()
    target = tmp_path / "to"
    for day, name in enumerate(("a", "b", "c"), start=1):
        deviations = {"experiment_name": name} if name == "b" else {}
        manifest = {"replication": {"sha256": digest, "deviations": deviations}}
        manifest["executions"] = [{"started_at": f"2026-02-0{day}T12:00:00.000Z"}]
        two_tasks(target / name, (1.0,), (3.0,), manifest=manifest)
    assert replicated_folder(target, original, {"experiment_name": "b"}).name == "b"
    assert replicated_folder(target, original, {}).name == "c"
    with pytest.raises(PackageError, match="not executed again here"):
        replicated_folder(target, original, {"experiment_name": "d"})
