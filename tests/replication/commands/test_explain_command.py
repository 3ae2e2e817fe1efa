"""`robot-runner explain` says where each value of a run comes from."""

from __future__ import annotations

import pytest
from tests.replication.small_experiment import CONFIG


@pytest.mark.long
def test_a_measure_of_a_plugin_is_traced_to_its_raw_file(robot_runner, experiment):
    answer = robot_runner("explain", experiment, "r_3", "Energy")
    assert answer.code == 0, answer.err
    assert "simulated, not measured" in answer.out
    assert "Ina219 (robot-runner" in answer.out
    assert "runs/r_3/Ina219/samples.csv" in answer.out
    line = next(place for place, text in enumerate(CONFIG.splitlines(), start=1) if "Ina219()" in text)
    assert f"config/small.py:{line}" in answer.out
    assert "integral of power" in answer.out
    assert "attempt 1" in answer.out
    assert "CPU" not in answer.out.split("Energy")[0]


def test_a_treatment_is_shown_as_the_run_table_has_it(robot_runner, write_config):
    write_config(
        table="""
    def create_run_table(self):
        return RunTableModel([Factor("Speed", [0.1, 12345.678])], data_columns=["Energy"])
"""
    )
    assert robot_runner("run", "config.py").code == 0
    shown = [robot_runner("explain", "config.py", run, "Speed").out.split("\n\n")[1] for run in ("r_1", "r_2")]
    assert [each.splitlines()[0] for each in shown] == ["Speed  0.1  factor", "Speed  12345.678  factor"]


def test_the_only_experiment_here_need_not_be_named(robot_runner, write_config):
    write_config()
    assert robot_runner("run", "config.py").code == 0
    of_run = robot_runner("explain", "config.py", "r_1").out
    assert robot_runner("explain", "r_1").out == of_run
    assert robot_runner("explain", "r_1", "Energy").out == robot_runner("explain", "config.py", "r_1", "Energy").out
    assert robot_runner("explain").out == robot_runner("explain", "config.py").out
    assert "there is no run 'r_8'" in robot_runner("explain", "r_8").err
    assert "there is no such file or folder" in robot_runner("explain", "r_8.zip").err


def test_everything_is_explained_as_json(robot_runner, experiment):
    facts = robot_runner("explain", experiment, "r_1", "--json").json
    names = [each["name"] for each in facts["values"]]
    assert {"status", "start_run_at", "Task", "Repetition", "CPU", "Energy", "Phases", "MeanPower"} <= set(names)
    assert facts["run_id"] == "r_1"


def test_what_is_not_there_is_named_with_the_nearest(robot_runner, experiment):
    assert "'Energy'" in robot_runner("explain", experiment, "r_1", "Enrgy").err
    answer = robot_runner("explain", experiment, "r_9")
    assert answer.code == 2
    assert "'r_9'" in answer.err


@pytest.mark.long
def test_without_a_run_it_tells_what_acm_asks_for_from_facts(robot_runner, experiment, packed, unpacked):
    answer = robot_runner("explain", experiment)
    assert answer.code == 0, answer.err
    assert "+ Terms of use (met). CC-BY-4.0." in answer.out
    assert "- Verified: it is whole (not met). No SHA256SUMS: robot-runner pack makes it." in answer.out
    assert "4 of 4 runs are done" in answer.out
    of_package = robot_runner("explain", packed.path, "--json").json
    assert of_package == robot_runner("explain", unpacked, "--json").json
    assert of_package["name"] == "small"
    lines = {(each["badge"], each["what"]): (each["state"], each["fact"]) for each in of_package["badges"]}
    text = (unpacked / "BADGES.md").read_text(encoding="utf-8")
    assert text.count("| met |") == sum(state == "met" for state, _ in lines.values()) > 8
    functional = "Artifacts Evaluated: Functional"
    assert lines[functional, "Verified: it is whole"][0] == "met"
    assert "of them by the hash of their files" in lines[functional, "Exercisable: the software is pinned"][1]
    # What only people can say is never met by itself.
    of_others = [state for (badge, _), (state, _) in lines.items() if badge.startswith("Results")]
    assert of_others == ["for the reviewers to say"] * 2
    (unpacked / "BADGES.md").unlink()
    refused = robot_runner("explain", unpacked)
    assert (refused.code, "no such file" in refused.err) == (2, True)
