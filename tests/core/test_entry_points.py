"""What packages announce is found however they are installed, and as `importlib.metadata` finds it."""

from __future__ import annotations

import json
import sys
import tomllib
import zipfile
from importlib.metadata import entry_points as found_by_python
from pathlib import Path

import pytest
from tests.conftest import written_config

from robot_runner.core import entry_points as module
from robot_runner.core.config.preparation import prepare
from robot_runner.core.entry_points import EntryPoint, entry_points, named_entry_point
from robot_runner.core.errors import ExecutionError, PluginError
from robot_runner.core.execution.notices import SilentObserver
from robot_runner.core.execution.orchestrator import execute_experiment
from robot_runner.core.plugin import described_circumstances

ROOT = Path(__file__).parents[2]
GROUPS = ("systems", "profilers", "links", "dialects", "checks", "circumstances", "commands")

SOURCE = """\
def circumstances():
    return {"room_temperature": 295.0}

def broken():
    raise RuntimeError("the sensor is gone")
"""
ANNOUNCED = """\
[console_scripts]
stranger = stranger:main

# a comment
[robot_runner.circumstances]
weather = stranger:circumstances
broken=stranger:broken
lost = nowhere_at_all:circumstances

[other.group]
weather = stranger:circumstances
"""
METADATA = "Metadata-Version: 2.1\nName: Some.Stranger\nVersion: 2.1\n"


def ordinary(folder: Path) -> list[Path]:
    """Return what `sys.path` has where the package was copied into a folder of packages."""
    about = folder / "some_stranger-2.1.dist-info"
    about.mkdir()
    (folder / "stranger.py").write_text(SOURCE)
    (about / "METADATA").write_text(METADATA)
    (about / "entry_points.txt").write_text(ANNOUNCED)
    return [folder]


def editable(folder: Path) -> list[Path]:
    """Return what `sys.path` has where the package's source stays where it is, as by `pip install -e`."""
    ordinary(folder)
    source = folder / "source"
    source.mkdir()
    (folder / "stranger.py").rename(source / "stranger.py")
    return [folder, source]


def zipped(folder: Path) -> list[Path]:
    """Return what `sys.path` has where the package is a zip file, as a wheel is one."""
    ordinary(folder)
    path = folder / "some_stranger-2.1-py3-none-any.whl"
    with zipfile.ZipFile(path, "w") as archive:
        for file in sorted(folder.rglob("*")):
            if file.is_file() and file != path:
                archive.write(file, file.relative_to(folder))
    return [path]


@pytest.fixture
def clean(monkeypatch: pytest.MonkeyPatch) -> pytest.MonkeyPatch:
    monkeypatch.setattr(module, "_read_before", {})
    monkeypatch.delitem(sys.modules, "stranger", raising=False)
    return monkeypatch


@pytest.mark.parametrize("installed", [ordinary, editable, zipped])
def test_a_stranger_s_package_is_found_however_it_is_installed(installed, clean, tmp_path):
    for path in installed(tmp_path):
        clean.syspath_prepend(path)
    point = named_entry_point("circumstances", "weather")
    assert point is not None
    assert (point.value, point.package, point.version) == ("stranger:circumstances", "Some.Stranger", "2.1")
    assert point.load()() == {"room_temperature": 295.0}
    assert [each.name for each in entry_points("circumstances")] == ["ros", "broken", "lost", "weather"]


@pytest.mark.parametrize("group", GROUPS)
def test_as_much_is_found_as_python_finds(group):
    found = sorted((point.name, point.value) for point in entry_points(group))
    assert found == sorted({(point.name, point.value) for point in found_by_python(group=f"robot_runner.{group}")})
    assert found


@pytest.mark.parametrize("group", GROUPS)
def test_the_installation_here_announces_what_the_project_says(group):
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    own = {point.name: point.value for point in entry_points(group) if point.is_own}
    assert own == project["entry-points"][f"robot_runner.{group}"], "pip install -e . again"
    for point in entry_points(group):
        point.load()


def test_of_a_package_that_is_there_twice_the_first_counts(clean, tmp_path):
    for name, text in (("first", ""), ("second", ANNOUNCED)):
        (tmp_path / name).mkdir()
        ordinary(tmp_path / name)
        (tmp_path / name / "some_stranger-2.1.dist-info" / "entry_points.txt").write_text(text)
    clean.syspath_prepend(tmp_path / "second")
    clean.syspath_prepend(tmp_path / "first")
    assert named_entry_point("circumstances", "weather") is None


def test_no_package_can_take_a_name_of_ours(clean, tmp_path):
    ordinary(tmp_path)
    announced = "[robot_runner.commands]\nrun = stranger\n[robot_runner.links]\nsimulated = stranger:circumstances\n"
    (tmp_path / "some_stranger-2.1.dist-info" / "entry_points.txt").write_text(announced)
    clean.syspath_prepend(tmp_path)
    for group, name in (("commands", "run"), ("links", "simulated")):
        assert [point.is_own for point in entry_points(group) if point.name == name] == [True, False]
        assert named_entry_point(group, name).is_own


def test_what_pip_could_not_remove_and_what_cannot_be_read_is_passed_over(clean, tmp_path):
    ordinary(tmp_path)
    (tmp_path / "some_stranger-2.1.dist-info").rename(tmp_path / "~ome_stranger-2.1.dist-info")
    (tmp_path / "other-1.dist-info").write_text("no folder")
    (tmp_path / "odd-1.dist-info").mkdir()
    (tmp_path / "odd-1.dist-info" / "entry_points.txt").write_bytes(
        b"[robot_runner.commands]\n\xff\xfe\nno equals sign\n"
    )
    clean.syspath_prepend(tmp_path)
    clean.syspath_prepend(tmp_path / "not there")
    assert [point.name for point in entry_points("circumstances")] == ["ros"]
    assert all(point.is_own for point in entry_points("commands"))


@pytest.mark.parametrize(
    ("value", "problem"),
    [
        ("nowhere_at_all:it", "the link cannot be imported: ModuleNotFoundError: No module named 'nowhere_at_all'"),
        ("math:nothing", "the link cannot be imported: AttributeError"),
    ],
)
def test_what_cannot_be_imported_names_its_package(value, problem):
    with pytest.raises(PluginError) as refused:
        EntryPoint("odd", "robot_runner.links", value, lambda: ("some-package", "1.0")).load()
    assert refused.value.problem.startswith(problem)
    assert refused.value.where == f"link odd ({value}, of some-package 1.0)"
    assert refused.value.fix == "Install or repair the package some-package."


@pytest.mark.parametrize("raised", ["RuntimeError", "SystemExit"])
def test_circumstances_that_cannot_be_described_are_logged_and_take_no_experiment_down(clean, tmp_path, caplog, raised):
    for path in ordinary(tmp_path):
        clean.syspath_prepend(path)
    (tmp_path / "stranger.py").write_text(SOURCE.replace("RuntimeError", raised))
    described = described_circumstances()
    assert described["weather"] == {"room_temperature": 295.0}
    assert described.keys() == {"ros", "weather"}
    assert "the sensor is gone" in caplog.text
    assert "nowhere_at_all" in caplog.text


def test_a_path_among_the_folders_of_modules_is_passed_over_as_an_import_does(clean, tmp_path):
    known = entry_points("systems")
    clean.setattr(sys, "path", [*sys.path, tmp_path])
    assert entry_points("systems") == known


RAISING = """\
class Stranger:
    description, takes_address, is_simulated = "a robot", False, False

    def _raised(self, *given, **named):
        raise RuntimeError("the sensor is gone")

    recognise = stand_in_modules = findings = open_robot = open_clock = prepare = __call__ = _raised

stranger = Stranger()
"""
ODD = """\
class Stranger:
    description, takes_address, is_simulated = "a robot", False, False

    def _odd(self, *given, **named):
        return ["a text"]

    recognise = stand_in_modules = findings = open_robot = open_clock = prepare = __call__ = _odd

stranger = Stranger()
"""
OTHER = "stranger = object()\n"
ENDING = RAISING.replace("RuntimeError", "SystemExit")


@pytest.mark.parametrize(
    "source",
    [RAISING, ODD, OTHER, ENDING],
    ids=["raises", "returns something else", "is something else", "ends the program"],
)
@pytest.mark.parametrize("group", ["dialects", "links", "checks", "companions", "preparations", "left_behind"])
def test_what_a_stranger_s_package_does_wrong_is_told_to_be_its_fault(clean, tmp_path, group, source):
    (tmp_path / "site").mkdir()
    ordinary(tmp_path / "site")
    (tmp_path / "site" / "stranger.py").write_text(source)
    announced = f"[robot_runner.{group}]\nodd = stranger:stranger\n"
    (tmp_path / "site" / "some_stranger-2.1.dist-info" / "entry_points.txt").write_text(announced)
    clean.syspath_prepend(tmp_path / "site")
    config = written_config(tmp_path, 'robot = "odd"' if group == "links" else "")
    prepared = prepare(config)
    findings = list(prepared.findings)
    if prepared.experiment is not None:
        findings += told_by_execution(prepared.experiment)
    (told,) = [each for each in findings if "of Some.Stranger 2.1" in each.where]
    assert told.where.startswith(f"{group.removesuffix('s')} odd")
    assert told.is_error is (group != "dialects")  # our own configs need none


@pytest.mark.parametrize("faulty", ["raise RuntimeError", "raise SystemExit(0)", "return 5", "return ['a text']"])
def test_a_stranger_s_package_that_cannot_make_treatments_is_told_to_be_at_fault(clean, tmp_path, faulty):
    (tmp_path / "site").mkdir()
    ordinary(tmp_path / "site")
    source = "def findings(factors, known): return []\n\ndef prepare(factors, known, workshop): " + faulty + "\n"
    (tmp_path / "site" / "stranger.py").write_text(source)
    announced = "[robot_runner.preparations]\nodd = stranger\n"
    (tmp_path / "site" / "some_stranger-2.1.dist-info" / "entry_points.txt").write_text(announced)
    clean.syspath_prepend(tmp_path / "site")
    (told,) = told_by_execution(prepare(written_config(tmp_path, "")).experiment)
    assert told.where == "preparation odd (stranger, of Some.Stranger 2.1)"
    assert told.is_error


def test_a_broken_plugin_of_the_name_of_a_used_class_keeps_no_experiment_from_being_executed(clean, tmp_path):
    (tmp_path / "site").mkdir()
    ordinary(tmp_path / "site")
    announced = "[robot_runner.profilers]\nRig = nowhere_at_all:Rig\n"
    (tmp_path / "site" / "some_stranger-2.1.dist-info" / "entry_points.txt").write_text(announced)
    clean.syspath_prepend(tmp_path / "site")
    config = written_config(tmp_path, "plugins = [Rig()]")
    config.write_text("from robot_runner.plugins import Profiler\n\nclass Rig(Profiler): pass\n\n" + config.read_text())
    assert not any(finding.is_error for finding in told_by_execution(prepare(config).experiment))
    (used,) = json.loads(next(tmp_path.rglob("manifest.json")).read_text())["plugins"]
    assert (used["name"], used["package"]) == ("Rig", None)


def told_by_execution(experiment):
    try:
        return execute_experiment(experiment, SilentObserver()).findings
    except (ExecutionError, PluginError) as refused:
        return refused.findings
