"""The commit of the config and of the software under test: told by the folder, and by its package."""

from __future__ import annotations

import json
import shutil
from collections import Counter

import pytest
from tests.command_line import robot_runner
from tests.subjects.conftest import Repository, own_cache, repository

from robot_runner.core.storage.git_repository import git
from robot_runner.core.storage.journal import Journal
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.replication.cleaning import Search
from robot_runner.replication.opening import open_package, unpack
from robot_runner.replication.packing import pack
from robot_runner.replication.redaction import Redactor
from robot_runner.replication.replicating import made_for

__all__ = ["own_cache", "repository", "robot_runner"]

CONFIG = """\
from robot_runner import *
from robot_runner.plugins.systems import Program


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "versions"
    results_output_path = "../results"
    plugins = [Program(["./planner.sh", "quickly"], name="Planner", folder=treatment("Version"), ready="plans")]

    def create_run_table(self):
        return RunTableModel([Factor.revisions("Version", REPOSITORY, ["v1.0", "main"])], shuffle=False)
"""


@pytest.mark.long
def test_commits_are_told_by_the_folder_and_by_its_package(robot_runner, repository: Repository, tmp_path):
    old, new = (repository.commit_of(name)[:12] for name in ("v1.0", "main"))
    repository.git("remote", "add", "origin", "https://example.org/planner.git")
    (repository.folder / "planner.sh").write_text("#!/bin/sh\npassword = 'hunter22-very-secret'\n")
    config = repository.folder / "study.py"
    config.write_text(CONFIG.replace("REPOSITORY", repr(str(repository.folder))))
    answer = robot_runner("run", config)
    assert answer.code == 0, answer.err
    folder = tmp_path / "results/versions"

    told = " ".join(robot_runner("explain", folder, "r_1", "Version").out.split())
    changed = "with changes that were not committed"
    assert f"Commit {new} (main of https://example.org/planner.git), {changed}" in told
    assert "Subject Planner: ./planner.sh quickly (output in runs/r_1/Planner)" in told
    assert f"Revision v1.0 is {old} ({repository.folder})" in told

    assert robot_runner("report", folder, "--figures", "none").code == 0
    page = next((folder / "report").glob("*.html")).read_text()
    assert f"{new} (main of https://example.org/planner.git), {changed}" in page
    assert "Version v1.0" in page

    package = tmp_path / "versions.zip"
    pack(folder, package)
    answer = robot_runner("verify", package)
    assert answer.code == 0, answer.out + answer.err
    with open_package(package) as opened:
        unpack(opened, tmp_path / "unpacked")
    unpacked = tmp_path / "unpacked"
    assert f"- Commit of the config: {new} (main of" in (unpacked / "README.md").read_text()
    (diff,) = (unpacked / "config").glob("uncommitted-*.diff")
    assert "+password" in diff.read_text()
    assert "hunter22" not in diff.read_text()
    repository.git("checkout", "--quiet", "--", "planner.sh")
    repository.commit("newer")
    answer = robot_runner("replicate", package, "--to", tmp_path / "replicated", "--yes")
    again = tmp_path / "replicated/versions/runs/r_2/Planner/stdout.txt"
    assert again.read_text().startswith("new plans"), answer.out + answer.err

    crate = json.loads((unpacked / "ro-crate-metadata.json").read_text())["@graph"]
    sources = {each["version"][:12] for each in crate if each["@type"] == "SoftwareSourceCode"}
    assert sources == {old, new}


@pytest.mark.long
def test_an_experiment_is_repeated_without_the_repository_of_its_revisions(
    robot_runner, repository: Repository, tmp_path, monkeypatch
):
    study = tmp_path / "study"
    study.mkdir()
    (study / "study.py").write_text(CONFIG.replace("REPOSITORY", repr(str(repository.folder))))
    old, new = (repository.commit_of(name) for name in ("v1.0", "main"))
    assert robot_runner("run", study / "study.py").code == 0
    package = tmp_path / "versions.zip"
    answer = robot_runner("pack", tmp_path / "results/versions", "--no-wheels", "--to", package)
    assert answer.code == 0
    assert "no copy of" not in answer.err
    shutil.rmtree(repository.folder)
    shutil.rmtree(tmp_path / "results")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "another_cache"))
    words = ("--yes", "--environment", "here", "--without-verdict")
    answer = robot_runner("replicate", package, "--to", tmp_path / "replicated", *words)
    assert answer.code == 0, answer.out + answer.err
    again = tmp_path / "replicated/versions"
    outputs = [(again / f"runs/r_{number}/Planner/stdout.txt").read_text().split()[0] for number in (1, 2)]
    assert outputs == ["old", "new"]
    facts = json.loads((again / "manifest.json").read_text())["revisions"]["Version"]
    assert [each["commit"] for each in facts.values()] == [old, new]
    # What was repeated can be packed and repeated as well.
    kept = again / "revisions" / facts["main"]["kept"]
    assert all(git("cat-file", "-e", commit, folder=kept).returncode == 0 for commit in (old, new))


@pytest.mark.long
def test_a_password_in_a_revision_is_found_by_pack_and_one_in_its_history_is_in_no_package(
    robot_runner, repository: Repository, tmp_path, monkeypatch
):
    planted = repository.folder / "settings.ini"
    planted.write_text("password = hunter22-very-secret\n")
    repository.git("add", "settings.ini")
    repository.commit("with a password")
    repository.git("tag", "careless")
    repository.git("rm", "--quiet", "settings.ini")
    repository.commit("without")
    study = tmp_path / "study"
    study.mkdir()
    text = CONFIG.replace("REPOSITORY", repr(str(repository.folder)))
    (study / "study.py").write_text(text)
    assert robot_runner("run", study / "study.py").code == 0
    answer = robot_runner("pack", tmp_path / "results/versions", "--no-wheels", "--to", tmp_path / "careful.zip")
    assert answer.code == 0, answer.err
    (study / "study.py").write_text(text.replace('"main"', '"careless"').replace('= "versions"', '= "careless"'))
    assert robot_runner("run", study / "study.py").code == 0
    answer = robot_runner("pack", tmp_path / "results/careless", "--no-wheels", "--to", tmp_path / "careless.zip")
    told = " ".join((answer.out + answer.err).split())
    assert "the file holds password (1), and nothing in it can be replaced" in told
    assert "revisions of factor 'Version': the package has no copy of v1.0, careless" in told
    shutil.rmtree(repository.folder)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "another_cache"))
    answer = robot_runner("replicate", tmp_path / "careless.zip", "--to", tmp_path / "again", "--yes")
    assert answer.code == 2
    assert f"repository '{repository.folder}' does not exist" in answer.err


def test_what_git_packs_as_deltas_or_broke_off_is_told_as_not_searched(repository: Repository, tmp_path):
    long = "".join(f"line {number}\n" for number in range(500))
    for word in ("old", "new"):
        (repository.folder / "map.txt").write_text(f"{long}password = {word}-very-secret\n")
        repository.git("add", "map.txt")
        repository.commit(word)
    repository.git("repack", "--quiet", "-a", "-d", "-F")
    (path,) = repository.folder.glob(".git/objects/pack/*.pack")
    redactor = Redactor.knowing(set(), home=tmp_path)
    (why,) = Search(path, redactor).unread
    assert "the pack holds deltas between files, which cannot be looked through" in why
    repository.git("repack", "--quiet", "-a", "-d", "-F", "--window=0")
    (path,) = repository.folder.glob(".git/objects/pack/*.pack")
    assert (found := Search(path, redactor)).found == Counter({"password": 2})
    assert found.unread == []
    (tmp_path / "half.pack").write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    (why,) = Search(tmp_path / "half.pack", redactor).unread
    assert "the pack ends too early" in why


def test_a_journal_in_which_a_stranger_wrote_anything_of_revisions_is_no_fault_of_ours(tmp_path):
    files = ExperimentFolder(tmp_path)
    wild = {"Version": "x", "Map": {"main": 3, "old": {"kept": ["a"]}, "new": {"kept": "a.git"}}}
    with Journal(files.journal) as journal:
        journal.append("prepared", treatments={"revisions": wild, "others": 7})
    assert made_for(files)["revisions"]["Map"]["new"]["kept"] == str(tmp_path / "revisions/a.git")
    with Journal(files.journal) as journal:
        journal.append("prepared", treatments={"revisions": 7})
    assert made_for(files)["revisions"] == 7
