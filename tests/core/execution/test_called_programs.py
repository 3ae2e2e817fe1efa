"""Programs that a run calls are noticed as they are started, and recorded with their versions."""

from __future__ import annotations

import json
import os
import shutil
import subprocess

import pytest
from tests.core.execution.conftest import execute_in

from robot_runner.core.storage.manifest import installed_system_packages
from robot_runner.replication.explanation import explain_run

CALLS = """
plugins = []

def __init__(self):
    self.plugins = [Meter()]

def launch_mission(self, context):
    import os
    import subprocess
    subprocess.run(["uname", "-m"], check=True, stdout=subprocess.DEVNULL)
    subprocess.run("sort /dev/null | cat", shell=True, check=True)
    os.system("true")
    try:
        subprocess.run(["not-there"], check=False)
    except OSError:
        pass

def populate_run_data(self): return {"Energy": 1.0}
"""
HEAD = """\
import subprocess
from pathlib import Path
from robot_runner import *
from robot_runner.plugins import Profiler


class Meter(Profiler):
    def start_measurement(self, context):
        subprocess.run([{own!r}], check=True)


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "trial"
    results_output_path = Path("results")
"""


@pytest.fixture
def own_program(tmp_path):
    """A program that no package of the system holds."""
    path = tmp_path / "wattmeter"
    path.write_text("#!/bin/sh\nexit 0\n", encoding="utf-8")
    path.chmod(0o755)
    return path


def test_each_program_is_recorded_once_with_its_version_and_who_called_it(tmp_path, own_program):
    executed = execute_in(tmp_path, CALLS, head=HEAD.format(own=str(own_program)))
    assert executed.finished.failed_count == 0, executed.finished.failures
    names = ("uname", "sort", "true")
    first = executed.table[0]["run_id"]
    called = [(each["path"], each["owner"]) for each in executed.journal("program") if each["run"] == first]
    assert sorted(path for path, _ in called) == sorted({path for path, _ in called})
    assert {(shutil.which(name), "config") for name in names} | {(str(own_program), "Meter")} <= set(called)
    assert not [path for path, _ in called if "not-there" in path]
    manifest = json.loads((executed.folder / "manifest.json").read_text("utf-8"))
    programs = manifest["programs"]
    assert programs[str(own_program)]["called_by"] == ["Meter"]
    assert programs[str(own_program)]["package"] is None
    digest = subprocess.run(["sha256sum", own_program], capture_output=True, text=True, check=True).stdout.split()[0]
    assert programs[str(own_program)]["sha256"] == digest
    told = [text for what, text in explain_run(executed.folder, first).facts if what == "Program"]
    assert f"{own_program} (SHA-256 {digest}), called by Meter" in told
    if shutil.which("dpkg-query"):
        version = _version("coreutils")
        for name in names:
            found = programs[shutil.which(name)]
            assert (found["package"], found["version"], found["called_by"]) == ("coreutils", version, ["config"])
        assert f"{shutil.which('uname')} (coreutils {version}), called by config" in told


@pytest.mark.skipif(
    shutil.which("dpkg-query") is None, reason="this is not Debian: the system's packages are not known"
)
def test_the_systems_packages_are_those_that_dpkg_lists(tmp_path):
    asked = ["dpkg-query", "-W", "-f", "${db:Status-Abbrev} ${Package} ${Version}\n"]
    told = subprocess.run(asked, capture_output=True, text=True, check=True).stdout
    listed = {tuple(line.split()[1:]) for line in told.splitlines() if line[1] in "iWtFU"}  # see ${db:Status-Abbrev}
    assert set(installed_system_packages().items()) <= listed
    assert {name for name, _ in listed} == set(installed_system_packages())
    assert installed_system_packages(tmp_path / "none") == {}


def test_packages_of_the_system_are_read_again_once_some_were_installed_meanwhile(tmp_path):
    status = tmp_path / "status"
    for count in (1, 2, 3):
        with status.open("a", encoding="utf-8") as file:
            file.write(f"Package: p{count}\nStatus: install ok installed\nVersion: 1.{count}\n\n")
        found = installed_system_packages(status)
        assert found == {f"p{each}": f"1.{each}" for each in range(1, count + 1)}
        found.clear()


def test_a_package_of_the_system_is_there_while_another_one_is_being_installed(tmp_path):
    there = ("installed", "triggers-pending", "triggers-awaited", "half-configured", "unpacked")
    gone = ("half-installed", "config-files", "not-installed")
    status = tmp_path / "status"
    status.write_text(
        "".join(f"Package: {each}\nStatus: install ok {each}\nVersion: 1.2\n\n" for each in (*there, *gone)), "utf-8"
    )
    assert set(installed_system_packages(status)) == set(there)


def _version(package):
    asked = ["dpkg-query", "-W", "-f", "${Version}", package]
    return subprocess.run(asked, capture_output=True, text=True, check=True, env=dict(os.environ)).stdout
