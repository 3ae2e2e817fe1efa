"""The commit of the config and of the software under test: told by the folder, and by its package."""

from __future__ import annotations

import json

from tests.command_line import robot_runner
from tests.subjects.conftest import Repository, own_cache, repository

from robot_runner.replication.opening import open_package, unpack
from robot_runner.replication.packing import pack

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
