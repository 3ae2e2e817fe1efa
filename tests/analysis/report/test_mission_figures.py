"""Sampled measures over the mission, in whichever order their samples were written."""

from __future__ import annotations

import numpy as np
import pytest
from tests.analysis.experiment_folders import two_tasks

from robot_runner.analysis.report.material import Material
from robot_runner.analysis.report.mission_figures import mission_courses, sampled_measures
from robot_runner.analysis.results import load_results
from robot_runner.analysis.statistics.experiment_statistics import analyse


def _courses(root, rows):
    folder = two_tasks(root, (1.0, 2.0), (3.0, 4.0))
    folder.write_samples("Meter", "samples.csv", "time_s,power_W", lambda place: rows)
    results = load_results(folder.root)
    material = Material(results, analyse(results))
    return mission_courses(material, sampled_measures(results)[0], material.order)


@pytest.mark.long
def test_samples_that_are_out_of_order_or_at_no_time_make_the_same_course(tmp_path):
    rows = [f"{second},{second * second}" for second in range(10)]
    straight = _courses(tmp_path / "straight", rows)
    for name, odd in (("back", rows[::-1]), ("mixed", [*rows[1::2], *rows[::2], "inf,5", "nan,5"])):
        found = _courses(tmp_path / name, odd)
        assert list(found.firsts) == list(straight.firsts)
        for treatment, course in straight.firsts.items():
            assert found.firsts[treatment].label == course.label
            assert np.array_equal(found.firsts[treatment].middle, course.middle)
