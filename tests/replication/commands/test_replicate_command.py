"""`robot-runner replicate` executes a package again, once it is verified and the user has said yes."""

from __future__ import annotations

import hashlib
import json
import shutil
import signal
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import pytest
from tests.command_line import PROGRAM
from tests.linked_environment import make_linked_environment
from tests.replication.small_experiment import own_modules

from robot_runner.replication.distributions import closure, packages_of_extra

ROOT = Path(__file__).parents[3]


@pytest.fixture(autouse=True)
def _modules_of_its_own():
    with own_modules():
        yield


@pytest.fixture
def package(packed, tmp_path):
    return Path(shutil.copy(packed.path, tmp_path / "small.zip"))


@pytest.fixture(scope="module")
def linked(tmp_path_factory):
    """An environment that can execute the experiment, and has none of what compares results."""
    names = closure({"rich", *packages_of_extra("robot-runner", "sim")})
    folder = tmp_path_factory.mktemp("linked") / "environment"
    make_linked_environment(folder, names, code=ROOT / "src")
    return folder


@pytest.mark.usefixtures("package")
class TestReplicate:
    @pytest.mark.long
    def test_it_ends_with_a_verdict_on_each_measure(self, robot_runner, tmp_path):
        answer = robot_runner("replicate", "small.zip", "--yes", "--bound", "2%")
        assert answer.code == 0, answer.err
        assert "verified: every file is as it was packed" in answer.out
        assert "The results are identical: every value of 4 runs" in answer.out
        assert "  Energy (J) is identical in all 4 runs, to the last digit.\n" in answer.out
        assert answer.out.endswith("The results are identical: every value of 4 runs, to the last digit.\n")
        folder = tmp_path / "small_replication"
        assert {path.name for path in folder.iterdir()} == {
            "package",
            "small",
            "comparison.html",
            "comparison.json",
            "verdict.json",
        }
        assert json.loads((folder / "comparison.json").read_text("utf-8"))["measures"]
        assert not list(folder.rglob("__pycache__"))

    def test_nothing_is_executed_before_somebody_has_said_yes(self, robot_runner, tmp_path):
        answer = robot_runner("replicate", "small.zip")
        assert answer.code == 2
        assert "add --yes" in answer.err
        assert [path.name for path in tmp_path.iterdir()] == ["small.zip"]

    @pytest.mark.long
    def test_a_user_who_says_no_is_not_asked_twice(self, terminal, tmp_path):
        screen = terminal("replicate", "small.zip")
        screen.wait_for("Execute the code of this package")
        screen.child.sendline("no")
        assert screen.finish() == 2
        assert [path.name for path in tmp_path.iterdir()] == ["small.zip"]

    @pytest.mark.long
    def test_what_differs_from_this_machine_is_shown_first(self, robot_runner, package):
        _rewrite(
            package, "environment/environment.json", b'"rich": {\n      "name": "rich",\n      "version": "', b"0."
        )
        answer = robot_runner("replicate", "small.zip")
        assert "This machine differs from the package's:" in answer.out
        assert "rich" in answer.out.partition("differs")[2]

    def test_an_experiment_that_nobody_sealed_is_called_no_package(self, robot_runner, experiment, tmp_path):
        answer = robot_runner("replicate", experiment, "--to", tmp_path / "again")
        assert "nobody can be asked whether the experiment's code may be executed" in answer.err
        said = answer.out + answer.err
        assert said.count("package") == said.count("and no package")

    @pytest.mark.long
    def test_an_experiment_that_nobody_sealed_says_so_and_a_deviation_gets_its_verdict(
        self, robot_runner, experiment, tmp_path
    ):
        folder, robot = shutil.copytree(experiment, tmp_path / "open"), "robot=simulated:task_power_factor=3"
        answer = robot_runner("replicate", folder, "--yes", "--set", robot, "--to", "again")
        assert answer.code == 3, answer.err
        assert "not sealed" in answer.out
        assert "nothing tells whether it was altered" in answer.err
        assert f"Deviates  {robot}" in answer.out
        energy = next(line for line in answer.out.splitlines() if line.strip().startswith("Energy"))
        assert "is different" in energy
        assert "the bound was 5 % (the default, as neither --bound nor the plan says what matters)" in energy
        assert answer.out.endswith("The results are different: Energy.\n")

    def test_the_container_is_built_by_commands_that_are_printed(self, robot_runner, tmp_path):
        answer = robot_runner("replicate", "small.zip", "--environment", "container")
        assert answer.code == 0
        assert "podman build -t small small_replication/package" in answer.out
        recipe = (tmp_path / "small_replication" / "package" / "Containerfile").read_text("utf-8")
        assert "\nARG BASE=docker.io/library/python:3." in recipe
        assert "no digest of its base image is known" in answer.err
        assert not (tmp_path / "small_replication" / "small").exists()

    def test_an_altered_package_is_refused_and_nothing_is_written(self, robot_runner, package, tmp_path):
        _rewrite(package, "config/small.py", b"Video", b"Videos", with_sums=False)
        answer = robot_runner("replicate", "small.zip", "--yes")
        assert answer.code == 2
        assert "the file was altered" in answer.err
        assert [path.name for path in tmp_path.iterdir()] == ["small.zip"]

    def test_a_name_that_leads_elsewhere_leads_nowhere(self, robot_runner, package, tmp_path):
        _rewrite(package, "package.json", b'"experiment": "', b"../../\\u001b[2J")
        answer = robot_runner("replicate", "small.zip", "--environment", "container")
        assert answer.code == 0, answer.err
        assert "\x1b" not in answer.out
        assert len(list(tmp_path.iterdir())) == 2  # the package, and a folder beside it

    def test_an_unknown_environment_is_refused(self, robot_runner):
        answer = robot_runner("replicate", "small.zip", "--environment", "vnev")
        assert (answer.code, "'venv'" in answer.err) == (2, True)

    def test_a_bound_that_is_none_is_refused_before_anything_is_executed(self, robot_runner, tmp_path):
        answer = robot_runner("replicate", "small.zip", "--yes", "--bound", "five")
        assert answer.code == 2
        assert "'five'" in answer.err
        assert [path.name for path in tmp_path.iterdir()] == ["small.zip"]


def _made_to_differ(package, name):
    """Have a package say that a distribution was of another version."""
    with zipfile.ZipFile(package) as archive:
        recorded = json.loads(archive.read("environment/environment.json"))["packages"][name]
    before = f'"name": "{recorded["name"]}",\n      "version": "{recorded["version"]}'
    _rewrite(package, "environment/environment.json", before.encode(), b".post9")


class TestEnvironments:
    @pytest.mark.long
    def test_what_the_experiment_imports_comes_first_and_the_rest_is_counted(self, robot_runner, package):
        _made_to_differ(package, "rich")
        _made_to_differ(package, "numpy")
        for name in ("scipy", "pandas", "matplotlib", "jinja2", "pint", "statsmodels"):
            _made_to_differ(package, name)
        answer = robot_runner("replicate", "small.zip")
        told = answer.out.partition("This machine differs from the package's:")[2]
        assert told.splitlines()[2].split()[0] == "numpy"
        assert "robot simulated" in told.splitlines()[2]
        assert "and 7 packages that the experiment does not import itself: --all-differences shows them" in told
        assert "scipy" not in told
        assert "scipy" in robot_runner("replicate", "small.zip", "--all-differences").out

    def test_who_imports_what_is_known_of_the_simulated_robot(self, package):
        with zipfile.ZipFile(package) as archive:
            packages = json.loads(archive.read("environment/environment.json"))["packages"]
        assert "robot simulated" in packages["mujoco"]["imported_by"]
        assert "robot simulated" in packages["numpy"]["imported_by"]
        assert {"Ina219", "config"} <= set(packages["robot-runner"]["imported_by"])
        assert "imported_by" not in packages["markdown-it-py"]

    @pytest.mark.long
    def test_the_packages_own_environment_is_offered_where_it_makes_a_difference(self, terminal, package, tmp_path):
        _made_to_differ(package, "numpy")
        screen = terminal("replicate", "small.zip", "--plain")
        screen.wait_for("Execute the code of this package")
        screen.child.sendline("y")
        screen.wait_for("Make the package's own environment first, as numpy differs here")
        assert not (tmp_path / "small_replication").exists()  # nothing is made before somebody has said yes
        screen.child.sendline("n")
        assert screen.finish() == 0
        assert "The results are identical" in screen.raw
        assert not (tmp_path / "small_replication" / "environment").exists()

    @pytest.mark.long
    def test_with_yes_it_is_made_and_that_it_cannot_be_is_said(self, robot_runner, package, monkeypatch):
        _made_to_differ(package, "numpy")
        monkeypatch.setenv("PIP_NO_INDEX", "1")  # nothing is fetched here
        answer = robot_runner("replicate", "small.zip", "--yes")
        assert answer.code == 2
        assert "The package's own environment is taken, as numpy differs here" in answer.out
        assert "the environment cannot be made" in answer.err
        assert "--environment here" in answer.err

    @pytest.mark.long
    def test_another_environment_executes_and_this_one_compares(self, package, linked, tmp_path):
        answer = subprocess.run(
            [PROGRAM, "replicate", "small.zip", "--yes", "--environment", linked, "--json"],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            timeout=200,
            check=False,
        )
        assert answer.returncode == 0, answer.stderr
        facts = json.loads(answer.stdout)
        assert (facts["verdict"], facts["environment"]) == ("identical", str(linked))
        assert "All 4 runs are done" in answer.stderr
        manifest = json.loads((Path(facts["replication"]) / "manifest.json").read_text("utf-8"))
        assert "pandas" not in manifest["software"]["packages"]  # it was executed there, without what compares

    @pytest.mark.long
    def test_a_stop_request_reaches_what_executes(self, package, linked, tmp_path):
        words = [PROGRAM, "replicate", "small.zip", "--yes", "--environment", linked, "--plain"]
        words += ["--set", "time_between_runs_in_ms=60000"]  # else all is over where the request comes late
        with subprocess.Popen(
            words, cwd=tmp_path, stdout=subprocess.PIPE, text=True, start_new_session=True
        ) as process:
            for line in process.stdout:
                if "run 1 of 4" in line:
                    break
            process.send_signal(signal.SIGTERM)  # to this process alone, as a supervisor does
            told = process.stdout.read()
            assert process.wait(60) == 130
        assert "Interrupted: " in told
        lines = (tmp_path / "small_replication" / "small" / "journal.jsonl").read_text("utf-8").splitlines()
        assert json.loads(lines[-1])["interrupted"] is True

    def test_an_environment_without_the_program_is_refused(self, robot_runner, tmp_path):
        (tmp_path / "empty").mkdir()
        answer = robot_runner("replicate", "small.zip", "--environment", "empty")
        assert answer.code == 2
        assert "Install robot-runner into it" in answer.err


@pytest.mark.long
def test_it_is_replicated_in_an_empty_folder_and_a_fresh_environment(packed, tmp_path):
    """The program is the one that the package brings, and it knows nothing of where it was packed."""
    folder = tmp_path / "elsewhere"
    folder.mkdir()
    package = shutil.copy(packed.path, folder / "small.zip")
    python = _fresh_environment(tmp_path / "fresh", Path(package))
    where = subprocess.run(
        [python, "-c", "import robot_runner; print(robot_runner.__file__)"], capture_output=True, text=True, check=True
    )
    assert str(tmp_path / "fresh") in where.stdout
    environment = {"PATH": "/usr/bin:/bin", "HOME": str(folder), "LANG": "C.UTF-8"}
    answer = subprocess.run(
        [python, "-m", "robot_runner", "replicate", "small.zip", "--yes"],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        timeout=100,
        check=False,
    )
    assert answer.returncode == 0, answer.stderr
    assert "The results are identical: every value of 4 runs, to the last digit." in answer.stdout
    assert answer.stdout.count("is identical in all 4 runs") == 4


@pytest.mark.soak
def test_the_whole_demo_is_replicated_identically(program, tmp_path):
    for words in (
        ["demo", "--folder", "demo"],
        ["pack", "demo/basic_experiment", "--no-hashes", "--to", "demo.zip"],
        ["replicate", "demo.zip", "--yes"],
    ):
        answer = subprocess.run(
            [program, *words], cwd=tmp_path, capture_output=True, text=True, timeout=600, check=False
        )
        assert answer.returncode == 0, answer.stderr
    assert "The results are identical: every value of 15 runs" in answer.stdout


def _fresh_environment(folder, package):
    """Make an environment with the package's wheel; the libraries are those of the tests, for want of a network."""
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", folder], check=True, timeout=60)
    site = next(folder.glob("lib/python*/site-packages"))
    with zipfile.ZipFile(package) as archive:
        wheels = [name for name in archive.namelist() if name.endswith(".whl")]
        assert [name.rpartition("/")[2].partition("-")[0] for name in wheels] == ["robot_runner"]
        wheel = archive.extract(wheels[0], folder)
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(site)
    (site / "libraries.pth").write_text(sysconfig.get_path("purelib") + "\n", encoding="utf-8")
    return str(folder / "bin" / "python")


def _rewrite(package, name, before, after, *, with_sums=True):
    """Write a package anew with one file changed; `before` is replaced, or followed where sums are made right."""
    beside = package.with_suffix(".new")
    with zipfile.ZipFile(package) as old, zipfile.ZipFile(beside, "w", zipfile.ZIP_DEFLATED) as new:
        content = old.read(name)
        assert before in content
        changed = content.replace(before, before + after if with_sums else after)
        sums = old.read("SHA256SUMS")
        if with_sums:
            digests = [hashlib.sha256(each).hexdigest().encode() for each in (content, changed)]
            sums = sums.replace(*digests)
        for entry in old.namelist():
            new.writestr(entry, {name: changed, "SHA256SUMS": sums}.get(entry, old.read(entry)))
    beside.replace(package)


@pytest.mark.long
def test_what_differs_when_it_goes_on_is_answered_with_options_that_it_takes(
    robot_runner, write_config, tmp_path, monkeypatch
):
    write_config(
        """
import os
pace = float(os.environ["PACE"])
def populate_run_data(self, context): return {"Energy": self.pace}
"""
    )
    monkeypatch.setenv("PACE", "1")
    assert robot_runner("run", "config.py").code == 0
    words = ("replicate", tmp_path / "results" / "trial", "--yes", "--without-verdict", "--to", "again")
    assert robot_runner(*words).code == 0
    monkeypatch.setenv("PACE", "2")
    refused = robot_runner(*words)
    assert refused.code == 2
    assert "pace: the value was 1.0 and is 2.0" in refused.err
    assert "fix: Have it be as it was when this replication was begun, or begin another: --to FOLDER." in refused.err
    assert "--accept-changes" not in refused.err
    monkeypatch.setenv("PACE", "1")
    (tmp_path / "again" / "trial" / "journal.jsonl").unlink()
    refused = robot_runner(*words)
    assert refused.code == 2
    assert "the journal has no end of them" in refused.err
    assert "fix: Restore run table and journal from a backup, or begin another replication: --to FOLDER." in refused.err
    assert "--table" not in refused.err


@pytest.mark.long
def test_results_are_not_kept_in_a_folder_that_an_environment_is_made_in_anew(robot_runner, write_config, tmp_path):
    write_config("def populate_run_data(self, context): return {'Energy': 1.0}")
    assert robot_runner("run", "config.py", "--set", "experiment_name=environment").code == 0
    words = ("replicate", tmp_path / "results" / "environment", "--yes", "--without-verdict", "--to", "again")
    refused = robot_runner(*words)
    assert refused.code == 2
    assert "the experiment is called 'environment', as a folder that replications make is" in refused.err
    assert "fix: Give the replication another name: --set experiment_name=environment_again\n" in refused.err
    assert robot_runner(*words, "--set", "experiment_name=environment_again").code == 0
    assert (tmp_path / "again" / "environment_again" / "run_table.csv").exists()
