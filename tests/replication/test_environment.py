"""What is known of an environment is recorded, and what is not is said."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import zipfile
from importlib import metadata
from pathlib import Path
from types import SimpleNamespace

import pytest
from tests.python_program import first_lines
from tests.replication.small_index import tiny_wheel
from tests.waiting import wait_until

from robot_runner.core.errors import PackageError
from robot_runner.core.storage.manifest import describe_host, describe_software
from robot_runner.replication import environment, virtual_environments
from robot_runner.replication.differences import differing_environment, differing_packages, remaining_differences
from robot_runner.replication.distributions import (
    InstalledDistribution,
    closure,
    installed_distributions,
    wheel_name,
    wheel_of,
    write_wheel,
)
from robot_runner.replication.environment import importers, record_environment
from robot_runner.replication.virtual_environments import make_environment
from robot_runner.ros.ros_environment import describe_ros


@pytest.fixture
def manifest():
    return {"software": describe_software(), "host": describe_host(), "robot": "simulated"}


@pytest.mark.parametrize(
    ("info", "sha256"),
    [
        ({"hashes": {"sha256": "ab"}}, "ab"),
        ({"hash": "sha256=ab"}, "ab"),  # as pip wrote it until 22.3
        ({"hash": "md5=ab"}, None),
        ({"hashes": {"md5": "ab"}}, None),
        ({}, None),
    ],
)
def test_of_the_archive_that_a_distribution_was_installed_from_the_sha_256_is_taken_and_no_other_hash(info, sha256):
    kept = {"url": "https://example.org/a-1-py3-none-any.whl", "archive_info": info}
    distribution = SimpleNamespace(read_text=lambda _: json.dumps(kept))
    assert InstalledDistribution("a", "1", distribution).archive_sha256 == sha256


@pytest.mark.parametrize(
    ("direct", "requirement"),
    [
        (
            {"url": "https://example.org/lab.git", "vcs_info": {"vcs": "git", "commit_id": "c0ffee"}},
            "lab-tools @ git+https://example.org/lab.git@c0ffee#subdirectory=python/tools",
        ),
        (
            {"url": "https://example.org/lab.tar.gz", "archive_info": {}},
            "lab-tools @ https://example.org/lab.tar.gz#subdirectory=python/tools",
        ),
    ],
)
def test_what_was_installed_from_a_folder_of_a_repository_is_required_from_that_folder(
    tmp_path, monkeypatch, direct, requirement
):
    notes = {"direct_url.json": json.dumps({**direct, "subdirectory": "python/tools"})}
    installed = InstalledDistribution("lab-tools", "1.0", SimpleNamespace(read_text=notes.get))
    monkeypatch.setattr(environment, "installed_distributions", lambda: {"lab-tools": installed})
    recorded = record_environment({"software": {"packages": {"lab-tools": "1.0"}}}, tmp_path)
    assert recorded.packages["lab-tools"].requirement == requirement


@pytest.mark.long
def test_what_the_program_needs_is_told_from_what_happens_to_be_installed(manifest, tmp_path):
    (tmp_path / "config.py").write_text("import pexpect\n", encoding="utf-8")
    needed = {each.name for each in record_environment(manifest, tmp_path).needed}
    assert {"robot-runner", "rich", "numpy", "pexpect", "ptyprocess"} <= needed
    assert not {"ruff", "mypy", "pytest"} & needed
    assert "mdurl" in closure(["rich"])


@pytest.mark.parametrize("reached", [{"robot": "wire:speed=9"}, {"robots": {"a": "wire:9", "b": "simulated"}}])
@pytest.mark.parametrize("facts", [{}, {"paints": {"red": "#f00"}}])
def test_a_package_that_brings_the_robot_s_link_or_makes_treatments_is_needed(tmp_path, monkeypatch, reached, facts):
    about = tmp_path / "site" / "lab_wire-1.0.dist-info"
    about.mkdir(parents=True)
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: lab-wire\nVersion: 1.0\n", encoding="utf-8")
    group = "preparations]\npaints" if facts else "links]\nwire"
    (about / "entry_points.txt").write_text(f"[robot_runner.{group} = lab_wire:WIRE\n", encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path / "site")
    assert "lab-wire" in environment._roots(reached | facts, tmp_path)
    assert "lab-wire" not in environment._roots({"robot": "simulated"}, tmp_path)


@pytest.mark.parametrize("rig", ["from .rig import Rig", "from lab_arm.rig import Rig", "from lab_arm import Rig"])
def test_what_a_plugin_imports_by_relative_imports_of_its_modules_is_found(tmp_path, monkeypatch, rig):
    package = tmp_path / "lab_arm"
    (package / "parts").mkdir(parents=True)
    modules = {"__init__": "from .rig import Rig", "arm": rig, "rig": "from .parts.grip import Grip"}
    modules |= {"parts/__init__": "", "parts/grip": "from ..line import Line", "line": "import yaml"}
    for name, text in modules.items():
        (package / f"{name}.py").write_text(text, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    for kept in (environment._reached, environment._file_of, environment._imports_of):
        kept.cache_clear()
    manifest = {"plugins": [{"name": "Arm", "class": "lab_arm.arm:Arm"}]}
    assert importers(manifest) == {"lab-arm": ("Arm",), "pyyaml": ("Arm",)}


def test_each_module_is_parsed_once_however_many_plugins_import_it(monkeypatch):
    read, parsed = [], environment.tree_or_empty
    monkeypatch.setattr(environment, "tree_or_empty", lambda content: [read.append(content), parsed(content)][1])
    for kept in (environment._reached, environment._file_of, environment._imports_of):
        kept.cache_clear()
    plugins = ["robot_runner.meters.psutil:PsUtil", "robot_runner.meters.ina219.profiler:Ina219"]
    importers({"plugins": [{"name": each.partition(":")[2], "class": each} for each in plugins]})
    assert len(read) == len(set(read)) > 10


@pytest.mark.long
def test_what_it_needs_and_was_uninstalled_since_is_listed(manifest, tmp_path):
    (tmp_path / "config.py").write_text("import left_pad\nimport rich\n", encoding="utf-8")
    manifest["software"]["packages"] |= {"left_pad": "1.0", "unrelated": "1.0"}
    environment = record_environment(manifest, tmp_path)
    assert "left-pad==1.0" in [each.requirement for each in environment.needed]
    assert "unrelated" not in [each.name for each in environment.needed]
    (finding,) = environment.findings
    assert "left-pad" in finding.problem


@pytest.mark.long
def test_a_hash_is_required_only_where_all_are_known(manifest, tmp_path):
    environment = record_environment(manifest, tmp_path)
    some = environment.requirements({"robot-runner": "ab" * 32})
    assert "robot-runner==" in some
    assert f"  # --hash=sha256:{'ab' * 32}" in some
    every = environment.requirements(dict.fromkeys(environment.packages, "ab" * 32))
    assert f"rich=={environment.packages['rich'].version} --hash=sha256:{'ab' * 32}" in every.splitlines()


@pytest.mark.long
@pytest.mark.parametrize(("name", "release"), [("x\n-e /tmp/theirs\ny", "1"), ("x", "1\n-e /tmp/theirs"), ("-r", "1")])
def test_nothing_but_packages_with_their_versions_is_asked_of_pip(tmp_path, name, release):
    software = {
        "python": "3.11\n-e /tmp/theirs",
        "packages": {name: release, "rich": "13.7.1", "odd.name": "1!2.0+lab"},
    }
    recorded = record_environment({"software": software}, tmp_path)
    assert set(recorded.packages) == {"rich", "odd-name"}
    pinned = [line for line in recorded.requirements({}).splitlines() if not line.startswith("#")]
    assert pinned == ["odd-name==1!2.0+lab", "rich==13.7.1"]
    assert recorded.findings[0].problem.startswith("the manifest names what cannot be a package with its version")


def test_an_environment_of_another_machine_is_said_to_be_one(manifest, tmp_path):
    manifest["software"]["robot_runner"] = "0.0.1"
    manifest["software"]["packages"] = {"robot_runner": "0.0.1", "rich": "1.0", "left_pad": "1.0"}
    environment = record_environment(manifest, tmp_path)
    assert [each.requirement for each in environment.needed] == ["left-pad==1.0", "rich==1.0", "robot-runner==0.0.1"]
    assert "not the environment" in environment.findings[0].problem


@pytest.mark.long
def test_a_wheel_of_a_local_package_can_be_imported_elsewhere(tmp_path):
    distribution = installed_distributions()["robot-runner"]
    if not distribution.is_local:
        pytest.skip("robot-runner is not installed from a folder here")
    wheel = tmp_path / wheel_name(distribution)
    write_wheel(wheel_of(distribution), wheel)
    again = tmp_path / "again.whl"
    write_wheel(wheel_of(distribution), again)
    assert wheel.read_bytes() == again.read_bytes()
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(tmp_path / "site")
    code = "import robot_runner.core.errors as e; print(e.__file__)"
    answer = subprocess.run(
        [sys.executable, "-c", code],
        env={"PYTHONPATH": str(tmp_path / "site")},
        capture_output=True,
        text=True,
        check=True,
    )
    assert answer.stdout.startswith(str(tmp_path / "site"))


def _editable(site: Path, project: Path, notes: dict[str, str]) -> InstalledDistribution:
    """Write what an editable installation of version 0.1 of `lab-tools` leaves, and return it."""
    files = {"METADATA": "Name: lab-tools\nVersion: 0.1\n", "WHEEL": "Tag: py3-none-any\n"}
    files["direct_url.json"] = json.dumps({"url": project.as_uri(), "dir_info": {"editable": True}})
    files = {f"lab_tools-0.1.dist-info/{name}": text for name, text in files.items()} | notes
    files["lab_tools-0.1.dist-info/RECORD"] = "".join(f"{name},,\n" for name in files)
    for name, text in files.items():
        (site / name).parent.mkdir(parents=True, exist_ok=True)
        (site / name).write_text(text, encoding="utf-8")
    distribution = metadata.PathDistribution(site / "lab_tools-0.1.dist-info")
    return InstalledDistribution("lab-tools", "0.1", distribution)


@pytest.mark.parametrize("has_finder", [False, True])
def test_an_editable_package_whose_modules_have_other_names_is_packed_with_its_code(tmp_path, monkeypatch, has_finder):
    project = tmp_path / "lab"
    for name in ("labtools/parts/__init__.py", "labtools/__init__.py", "labtools/data.csv", "grip.py", "setup.py"):
        (project / name).parent.mkdir(parents=True, exist_ok=True)
        (project / name).write_text("", encoding="utf-8")
    (project / "tests").mkdir()
    (project / "tests/__init__.py").touch()
    notes = {"_lab_tools.pth": f"{project}\n"}  # as hatchling, flit and uv write it, without a list of modules
    if has_finder:  # as setuptools does where the code lies beside other files
        mapping = {"labtools": str(project / "labtools"), "grip": str(project / "grip")}
        notes = {
            "__editable__.lab_tools-0.1.pth": "import __editable___lab_tools_0_1_finder as it; it.install()",
            "__editable___lab_tools_0_1_finder.py": f"MAPPING: dict[str, str] = {mapping!r}\n",
            "lab_tools-0.1.dist-info/top_level.txt": "labtools\ngrip\n",
        }
    code = [name for name in wheel_of(_editable(tmp_path / "site", project, notes)) if "dist-info" not in name]
    assert code == ["grip.py", "labtools/__init__.py", "labtools/data.csv", "labtools/parts/__init__.py"]
    monkeypatch.syspath_prepend(project)
    monkeypatch.setattr(environment, "editable_folders", lambda: {project: "lab-tools"})
    assert environment.owners_of("labtools") == environment.owners_of("grip") == ["lab-tools"]
    assert environment.owners_of("nobodys") == ["nobodys"]


@pytest.mark.long
def test_the_same_environment_does_not_differ(manifest, tmp_path):
    environment = record_environment(manifest, tmp_path).as_mapping({})
    assert differing_environment(environment, robot="simulated") == []


@pytest.mark.long
def test_each_kind_of_difference_is_named(manifest, tmp_path):
    environment = record_environment(manifest, tmp_path).as_mapping({})
    environment["python"] = "3.9.1"
    environment["host"] = {**environment["host"], "processor": "Cortex-A72", "memory_bytes": 1 << 30, "governor": "x"}
    environment["ros"] = {"version": 2, "distro": "jazzy", "packages": {}}
    environment["packages"]["rich"]["version"] = "1.0"
    environment["packages"]["numpy"]["fingerprint"] = "00"
    environment["packages"]["gone"] = {"name": "gone", "version": "2.0", "is_needed": True}
    found = {each.what: (each.original, each.here) for each in differing_environment(environment, robot="rosbridge")}
    assert found["Robot"] == ("simulated", "rosbridge")
    assert found["Python"][0] == "3.9.1"
    assert found["Processor"][0] == "Cortex-A72"
    assert found["Memory"][0] == "1.0 GiB"
    assert found["ROS"] == ("2 jazzy", "-")
    assert found["rich"][0] == "1.0"
    assert found["numpy"][1].endswith("with other files")
    assert found["gone"] == ("2.0", "-")


def test_ros_packages_are_found_with_their_versions(tmp_path):
    for prefix, name, version in (("overlay", "nav2", "2.0.0"), ("base", "nav2", "1.0.0"), ("base", "rclpy", "7.1.1")):
        folder = tmp_path / prefix / "share" / name
        folder.mkdir(parents=True)
        (folder / "package.xml").write_text(f"<package><version> {version} </version></package>", encoding="utf-8")
    path = f"{tmp_path / 'overlay'}:{tmp_path / 'base'}"
    found = describe_ros({"ROS_VERSION": "2", "ROS_DISTRO": "jazzy", "AMENT_PREFIX_PATH": path})
    assert found == {
        "version": 2,
        "distro": "jazzy",
        "middleware": None,
        "packages": {"nav2": "2.0.0", "rclpy": "7.1.1"},
    }
    assert describe_ros({}) is None


@pytest.mark.long
def test_an_environment_is_made_of_the_packages_own_wheels(tmp_path):
    root = tmp_path / "package"
    tiny_wheel(root / "environment" / "wheels")
    (root / "environment" / "requirements.txt").write_text("tiny==1.0\n", encoding="utf-8")
    environment = {"packages": {"tiny": {"name": "tiny", "version": "1.0", "is_needed": True}}}
    folder = tmp_path / "made"
    with pytest.MonkeyPatch.context() as patched:
        patched.setenv("PIP_NO_INDEX", "1")
        make_environment(root, folder, environment)
        (root / "environment" / "requirements.txt").unlink()
        make_environment(root, folder, environment)  # made already
    assert remaining_differences(folder, environment) == []
    environment["packages"]["tiny"]["version"] = "2.0"
    assert [each.here for each in remaining_differences(folder, environment)] == ["1.0"]


def test_an_environment_gets_its_own_pip_where_there_is_none_beside_us(tmp_path, monkeypatch):
    called = []
    folder = tmp_path / "made"
    folder.mkdir()
    monkeypatch.setattr(virtual_environments, "find_spec", lambda _: None)
    monkeypatch.setattr(virtual_environments, "_call", lambda words, *_: called.append(words))
    (tmp_path / "environment").mkdir()
    (tmp_path / "environment" / "requirements.txt").write_text("tiny==1.0\n", encoding="utf-8")
    make_environment(tmp_path, folder, {})
    assert "--without-pip" not in called[0]
    assert called[1][:4] == [str(folder / "bin" / "python"), "-m", "pip", "install"]


@pytest.mark.long
def test_what_pip_said_is_shown_where_an_environment_cannot_be_made(tmp_path):
    root = tmp_path / "package"
    tiny_wheel(root / "environment" / "wheels")
    (root / "environment" / "requirements.txt").write_text("no-such-package==1.0\n", encoding="utf-8")
    with pytest.MonkeyPatch.context() as patched:
        patched.setenv("PIP_NO_INDEX", "1")
        with pytest.raises(PackageError, match="No matching distribution"):
            make_environment(root, tmp_path / "made", {})


def test_an_uninstalled_package_is_a_difference():
    environment = {"packages": {"a": {"version": "1", "is_needed": True}, "b": {"version": "1", "is_needed": False}}}
    assert [each.what for each in differing_packages(environment, {})] == ["a"]


def test_another_python_installs_by_a_pip_of_its_own_as_ours_may_not_know_it(tmp_path, monkeypatch):
    called = []
    monkeypatch.setattr(virtual_environments, "_call", lambda words, *_: called.append([str(word) for word in words]))
    monkeypatch.setattr(virtual_environments.shutil, "which", lambda name: f"/opt/bin/{name}")
    root = tmp_path / "package"
    (root / "environment").mkdir(parents=True)
    (root / "environment" / "requirements.txt").write_text("tiny==1.0\n", encoding="utf-8")
    own = f"{sys.version_info.major}.{sys.version_info.minor}.0"
    for version, python in ((own, sys.executable), ("3.99.1", "/opt/bin/python3.99")):
        (tmp_path / version).mkdir()
        make_environment(root, tmp_path / version, {"python": version})
        made, installed = called[-2:]
        inside = str(tmp_path / version / "bin" / "python")
        assert made[:3] == [python, "-m", "venv"]
        assert ("--without-pip" in made) == (version == own)
        before = [sys.executable, "-m", "pip", "--python", inside] if version == own else [inside, "-m", "pip"]
        assert installed[: len(before)] == before


#: A program of another environment that counts how often it is asked to stop.
COUNTING = """\
{first_lines}import signal, sys
if "--help" not in sys.argv:
    signal.pthread_sigmask(signal.SIG_BLOCK, {{signal.SIGINT}})
    print("ready", flush=True)
    patience_s = 60.0
    while signal.sigtimedwait({{signal.SIGINT}}, patience_s) is not None:
        print("asked", flush=True)
        patience_s = 1.5
"""
EXECUTING = """\
import sys
from pathlib import Path
from robot_runner.replication.virtual_environments import execute_with
sys.exit(execute_with(Path(sys.argv[1]), ["replicate"], quietly="--quietly", output=None))
"""


@pytest.mark.long
def test_ctrl_c_asks_the_program_of_another_environment_once_and_not_twice_which_would_kill_its_run(tmp_path):
    program = tmp_path / "program"
    program.write_text(COUNTING.format(first_lines=first_lines()), encoding="utf-8")
    program.chmod(0o755)
    words = [sys.executable, "-c", EXECUTING, str(program)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True, start_new_session=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        os.killpg(process.pid, signal.SIGINT)  # as a terminal does
        assert process.stdout.read() == "asked\n"
    assert process.returncode == 0


@pytest.mark.long
@pytest.mark.skipif(sys.platform != "linux", reason="other systems do not tell a program that its parent is gone")
def test_the_program_of_another_environment_closes_its_run_where_who_started_it_is_killed(tmp_path):
    program, told = tmp_path / "robot-runner", tmp_path / "told"
    program.write_text(
        f"#!/bin/sh\n[ $2 = --help ] && exit\ntrap 'echo closed >\"{told}\"; exit' TERM\n"
        f'touch "{told}.begun"\nwhile :; do sleep 0.05; done\n'
    )
    program.chmod(0o755)
    name = virtual_environments.__name__
    code = f"from {name} import execute_with\nexecute_with({str(program)!r}, ['run', 'it'], quietly='-q', output=None)"
    with subprocess.Popen([sys.executable, "-c", code]) as starter:
        wait_until(lambda: Path(f"{told}.begun").exists(), "it was started")
        starter.kill()
    wait_until(told.exists, "it was told to end")


def test_a_wheel_that_a_killed_replication_left_does_not_keep_the_next_from_making_its_environment(
    tmp_path, monkeypatch
):
    monkeypatch.setattr(virtual_environments, "wheel_of", lambda _: {"tiny-1.dist-info/METADATA": Path(__file__)})
    installed = []
    monkeypatch.setattr(virtual_environments, "_make", lambda *asked: installed.append(zipfile.is_zipfile(left)))
    left = tmp_path / wheel_name(installed_distributions()["robot-runner"])
    left.write_bytes(b"half of a wheel")
    virtual_environments.make_comparison_environment(tmp_path / "comparison")
    assert installed == [True]
    assert not left.exists()
