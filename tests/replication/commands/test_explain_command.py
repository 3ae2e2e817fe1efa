"""`robot-runner explain` says where each value of a run comes from."""

from __future__ import annotations

from tests.replication.small_experiment import CONFIG


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
