from __future__ import annotations

import json

from robot_runner.core.events.window import Window
from robot_runner.measuring.quality import quality_of, report_quality
from robot_runner.plugins import Measure, Profiler
from robot_runner.testing import make_context


class Scale(Profiler):
    measures = (Measure("Mass", "kg", "Mass of the robot."),)


def report(folder, times):
    context, window = make_context(folder, Scale(), robot=None), Window(0.0, 10.0)
    quality = quality_of(times, window, 1.0, saturated=1)
    return context, report_quality(context, quality, window, fix="Weigh it again.", details={"range_kg": 5.0})


def test_poor_quality_becomes_a_finding_of_the_run(tmp_path):
    context, is_sufficient = report(tmp_path, [0.0, 1.0, 2.0, 9.0, 10.0])
    assert not is_sufficient
    problems = [(finding.where, finding.problem, finding.fix) for finding in context.broker.findings]
    assert problems[0] == ("r_1, Scale", "5 samples arrived of 10 expected", "Weigh it again.")
    assert len(problems) == 3


def test_the_record_is_kept_with_the_raw_data(tmp_path):
    context, is_sufficient = report(tmp_path, [float(number) for number in range(11)])
    assert is_sufficient
    facts = json.loads((context.raw_data_folder / "quality.json").read_text())
    assert facts["window"] == {"start": 0.0, "end": 10.0}
    assert facts["samples"]["saturated"] == 1
    assert facts["samples"]["jitter"] == {"p50": 0.0, "p95": 0.0, "p99": 0.0}
    assert facts["range_kg"] == 5.0
