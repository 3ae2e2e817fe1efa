"""Where a command is told no experiment or package, the only one here is meant, and never one of several."""

from __future__ import annotations

import shutil

import pytest


@pytest.mark.long
def test_an_experiment_is_packed_checked_and_replicated_without_naming_it(robot_runner, experiment, tmp_path):
    shutil.copytree(experiment, tmp_path / "study" / "small")
    assert robot_runner("pack", "--no-hashes").code == 0
    verified = robot_runner("verify")
    assert (verified.code, "intact" in verified.out) == (0, True)
    answer = robot_runner("replicate")  # of which nobody can be asked here
    assert answer.code == 2
    assert "add --yes" in answer.err
    (tmp_path / "small_replication" / "package").mkdir(parents=True)
    shutil.copy(tmp_path / "study" / "small" / "manifest.json", tmp_path / "small_replication" / "package")
    (tmp_path / "small_replication" / "package" / "SHA256SUMS").touch()
    assert robot_runner("pack", "--no-hashes").code == 0  # what was replicated is not meant


def test_several_or_none_are_refused_by_name(robot_runner, experiment, tmp_path):
    nothing = robot_runner("pack")
    assert (nothing.code, "there is no experiment here" in nothing.err) == (2, True)
    for name in ("one", "two"):
        shutil.copytree(experiment, tmp_path / name)
        (tmp_path / f"{name}.zip").touch()
    for command in ("pack", "status", "pause", "continue", "stop", "report", "export"):
        answer = robot_runner(command)
        assert (answer.code, "there are 2 experiments here" in answer.err) == (2, True)
        assert f"robot-runner {command} two" in answer.err
    for command in ("verify", "replicate"):
        answer = robot_runner(command)
        assert (answer.code, "there are 2 packages here" in answer.err) == (2, True)
        assert f"robot-runner {command} one.zip" in answer.err


def test_the_only_experiment_here_is_told_of_reported_and_exported(robot_runner, experiment, tmp_path):
    folder = tmp_path / "study" / "small"
    shutil.copytree(experiment, folder)
    (tmp_path / "closed").mkdir(mode=0)
    assert robot_runner("status").out == robot_runner("status", "study/small").out
    assert robot_runner("export").code == 0
    assert (folder / "export" / "datapackage.json").is_file()
    answer = robot_runner("pause")
    assert (answer.code, "study/small" in answer.err) == (2, True)


def test_runs_of_the_only_experiment_here_are_excluded_and_included_again(robot_runner, experiment, tmp_path):
    shutil.copytree(experiment, tmp_path / "study" / "small")
    answer = robot_runner("exclude", "r_1", "r_2", "--reason", "the door was open")
    assert (answer.code, answer.out.partition(".")[0]) == (0, "2 runs are excluded: r_1, r_2"), answer.err
    assert robot_runner("exclude", "study", "r_3", "--reason", "the door was open").code == 0
    assert robot_runner("include", "r_2").out == "1 run counts again: r_2.\n"
    assert "the run table has no such run" in robot_runner("include", "smalls", "r_2").err
    assert "there is no such file or folder" in robot_runner("include", "./smalls", "r_2").err
    shutil.copytree(experiment, tmp_path / "other")
    answer = robot_runner("include", "r_1", "r_3")
    assert "robot-runner include other r_1 r_3" in answer.err


def test_a_package_is_no_experiment_and_how_to_make_one_of_it_is_said(robot_runner, packed, tmp_path):
    shutil.copy(packed.path, tmp_path / "my study.zip")
    for words in (("compare", "my study.zip", "my study.zip"), ("report", "my study.zip"), ("status", "my study.zip")):
        answer = robot_runner(*words)
        assert (answer.code, "this is a package, and an experiment's folder is needed" in answer.err) == (2, True)
        assert "unzip -q 'my study.zip' -d 'my study'" in " ".join(answer.err.split())


def test_of_a_file_of_an_experiment_the_folder_is_told(robot_runner, experiment, tmp_path):
    shutil.copytree(experiment, tmp_path / "study")
    for name in ("run_table.csv", "journal.jsonl"):
        answer = robot_runner("report", f"study/{name}")
        assert (answer.code, "this is a file of an experiment, and its folder is needed" in answer.err) == (2, True)
        assert "Name it: study" in answer.err
