"""`robot-runner report` writes the report of an experiment and says where."""

from __future__ import annotations

import importlib
import json
import os
import sys

import pytest
from tests.analysis.experiment_folders import Folder, two_tasks


@pytest.fixture
def experiment(tmp_path):
    video, network = (870.1, 872.4, 869.0, 874.2), (834.0, 836.1, 833.2, 838.0)
    return two_tasks(tmp_path / "trial", video, network).root


@pytest.mark.long
def test_it_says_where_the_report_is(robot_runner, experiment):
    answer = robot_runner("report", "trial", "--figures", "none")
    assert answer.code == 0
    assert "trial/report/report.html" in answer.out
    assert "trial/report/tables/" in answer.out
    assert (experiment / "report" / "report.html").is_file()


@pytest.mark.long
def test_figures_are_made_in_the_formats_that_were_asked_for(robot_runner, experiment):
    assert robot_runner("report", "trial", "--figures", "svg,png").code == 0
    assert {path.suffix for path in (experiment / "report" / "figures").iterdir()} == {".svg", ".png"}


@pytest.mark.long
def test_letters_that_are_boxes_in_figures_are_told(robot_runner, tmp_path):
    rows = [(name, 1.0 + place) for place, name in enumerate("\U00012000bb\U00012000")]
    Folder(tmp_path / "trial", {"Task": ["\U00012000", "b"]}, rows, {"Energy": "J"}).write()
    answer = robot_runner("report", "trial", "--format", "md", "--figures", "none")
    assert answer.code == 0
    assert "no font of theirs is installed for \U00012000: in figures these are boxes" in answer.err
    assert "Noto Sans CJK" in answer.err
    assert robot_runner("report", "trial", "--format", "json").err == ""


def test_json_goes_to_a_file_as_the_other_formats_do(robot_runner, experiment, tmp_path):
    answer = robot_runner("report", "trial", "--format", "json", "--output", tmp_path / "out")
    assert answer.code == 0
    assert json.loads((tmp_path / "out" / "report.json").read_text())["experiment"] == "trial"


def test_measure_and_alpha_are_heard(robot_runner, experiment, tmp_path):
    words = ("report", "trial", "--format", "json", "--measure", "Energy", "--alpha", "0.01", "--output", tmp_path)
    assert robot_runner(*words).code == 0
    assert json.loads((tmp_path / "report.json").read_text())["statistics"]["alpha"] == 0.01


@pytest.mark.parametrize(
    ("words", "problem", "fix"),
    [
        (["--format", "pdf"], "'pdf'", "'html', 'md', 'json'"),
        (["--format", "jsn"], "'jsn'", "'json'"),
        (["--figures", "gif"], "'gif'", "'svg', 'pdf', 'png'"),
        (["--figures", ""], "''", "'svg', 'pdf', 'png'"),
        (["--measure", "Enery"], "'Enery'", "'Energy'"),
        (["--alpha", "2"], "alpha is 2.0", "between 0 and 1"),
    ],
)
def test_what_cannot_be_is_refused_with_a_way_out(robot_runner, experiment, words, problem, fix):
    answer = robot_runner("report", "trial", *words)
    assert answer.code == 2
    assert problem in answer.err
    assert fix in answer.err
    assert "Traceback" not in answer.err


def test_an_experiment_that_is_not_there_is_named(robot_runner, experiment):
    answer = robot_runner("report", "tial")
    assert answer.code == 2
    assert "'trial'" in answer.err


def test_without_its_libraries_it_names_the_extra(robot_runner, experiment, monkeypatch):
    # Importing the package anew also replaces the attribute of its parent, which is put back with the modules.
    monkeypatch.setattr("robot_runner.analysis", importlib.import_module("robot_runner.analysis"))
    for name in [name for name in sys.modules if name.startswith("robot_runner.analysis")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    monkeypatch.setattr("importlib.util.find_spec", _without("matplotlib"))
    answer = robot_runner("report", "trial")
    assert answer.code == 2
    assert "matplotlib is not installed" in answer.err
    assert "pip install 'robot-runner[analysis]'" in answer.err


def _without(missing):
    from importlib.util import find_spec

    return lambda name, package=None: None if name == missing else find_spec(name, package)


def test_its_help_imports_nothing_slow(robot_runner):
    before = set(sys.modules)
    assert robot_runner("report", "--help").code == 0
    new = {name.partition(".")[0] for name in set(sys.modules) - before}
    assert not new & {"pandas", "matplotlib", "scipy", "statsmodels"}


PLAN = """
measures = ["Energy"]
covariates = ["order"]
doubtful = "leave out"

[outliers]
median_deviations = 3
bounds = {Energy = [0, 5000]}

[[hypotheses]]
statement = "The task matters."
measure = "Energy"
factors = ["Task"]
"""


@pytest.mark.long
def test_a_plan_in_a_file_is_followed_and_all_is_exploratory(robot_runner, experiment, tmp_path):
    (tmp_path / "plan.toml").write_text(PLAN)
    words = ("report", "trial", "--format", "json", "--plan", tmp_path / "plan.toml", "--output", tmp_path)
    assert robot_runner(*words).code == 0
    statistics = json.loads((tmp_path / "report.json").read_text())["statistics"]
    energy = next(each for each in statistics["measures"] if each["name"] == "Energy")
    assert energy["test"]["method"] == "analysis of covariance"
    assert (statistics["is_planned"], energy["is_planned"], statistics["plan"]["covariates"]) == (
        False,
        False,
        ["order"],
    )
    assert [each["hypothesis"]["statement"] for each in statistics["hypotheses"]] == ["The task matters."]
    assert robot_runner(*words[:2], *words[4:], "--format", "md", "--figures", "none").code == 0
    said = (tmp_path / "report.md").read_text()
    assert "The plan was given for this report" in said
    assert "adjusted for order): all of it is exploratory." in said


@pytest.mark.parametrize(
    ("text", "problem", "fix"),
    [
        (PLAN.replace('"order"', '"ordr"'), "there is no measure 'ordr' that could be a covariate", "'order'"),
        (PLAN.replace("doubtful", "doubtfull"), "there is no choice 'doubtfull'", "'doubtful'"),
        (PLAN.replace("= 3", "= -3"), "median_deviations is -3", "above 0"),
        ("measures = ", "the file is not TOML", "Correct this line."),
        (None, "cannot be read", ""),
    ],
)
def test_a_plan_that_cannot_be_followed_is_refused(robot_runner, experiment, tmp_path, text, problem, fix):
    if text is not None:
        (tmp_path / "plan.toml").write_text(text)
    answer = robot_runner("report", "trial", "--plan", tmp_path / "plan.toml")
    assert answer.code == 2
    assert problem in answer.err
    assert fix in answer.err
    assert "Traceback" not in answer.err


@pytest.mark.parametrize(("command", "option"), [("report", "--output"), ("export", "--to")])
def test_an_experiment_that_cannot_be_written_names_the_option_for_another_place(
    robot_runner, experiment, monkeypatch, command, option
):
    """Others' results, archives and mounted packages are read-only; root, who may be testing, writes everywhere."""
    is_allowed = os.access
    monkeypatch.setattr(os, "access", lambda path, mode: not mode & os.W_OK and is_allowed(path, mode))
    answer = robot_runner(command, "trial")
    assert answer.code == 2
    assert answer.err == f"error: trial: the folder cannot be written\n  fix: Write elsewhere: {option} FOLDER.\n"
