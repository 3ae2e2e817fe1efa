from __future__ import annotations

import math
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot_runner.core.errors import PluginError
from robot_runner.ros.turtlebot3.mission import CircularMission, PhaseKind
from robot_runner.ros.turtlebot3.motion import Ramp
from robot_runner.ros.turtlebot3.steered_robot import Task


def test_the_mission_of_the_paper_takes_95_seconds():
    assert CircularMission().seconds == pytest.approx(95.0)


def test_the_phases_are_those_of_figure_4():
    kinds = " ".join(phase.kind.value for phase in CircularMission().phases)
    assert kinds == "sleep forward sleep task sleep task sleep task sleep rotate forward sleep"


def test_each_kind_of_phase_takes_its_own_time():
    mission = CircularMission(sleep_s=1.0, drive_s=2.0, task_s=3.0, rotate_s=4.0)
    seconds = {phase.kind: phase.seconds for phase in mission.phases}
    assert seconds == {PhaseKind.SLEEP: 1.0, PhaseKind.FORWARD: 2.0, PhaseKind.TASK: 3.0, PhaseKind.ROTATE: 4.0}


@pytest.mark.parametrize("treatment", ["Video", "video", "VIDEO", Task.VIDEO.value])
def test_a_treatment_names_its_task_whatever_its_case(treatment):
    assert Task.named(treatment) is Task.VIDEO


@pytest.mark.parametrize("treatment", ["Vidoe", "", None, 3])
def test_what_is_no_task_names_none(treatment):
    assert Task.named(treatment) is None


@pytest.mark.parametrize(
    ("parameters", "problem"),
    [
        ({"sleep_s": 0.0}, "sleep_s is 0.0"),
        ({"task_s": -1.0}, "task_s is -1.0"),
        ({"drive_s": math.inf}, "drive_s is inf"),
        ({"speed": 0.3}, "speed is 0.3"),
        ({"rotate_s": 0.5}, "rotate_s is 0.5"),
    ],
)
def test_what_the_robot_cannot_do_is_refused(parameters, problem):
    with pytest.raises(PluginError, match=problem):
        CircularMission(**parameters)


def test_a_turn_that_is_too_fast_is_refused_with_the_shortest_time_that_it_may_take():
    with pytest.raises(PluginError) as refused:
        CircularMission(rotate_s=1)
    least = float(re.search(r"at least ([\d.]+) s", refused.value.fix)[1])
    assert CircularMission(rotate_s=least).turn.cruise <= 2.84
    with pytest.raises(PluginError):
        CircularMission(rotate_s=least - 0.02)


@given(
    way=st.floats(-10.0, 10.0),
    seconds=st.floats(0.1, 100.0),
    shares=st.tuples(st.floats(0.0, 1.0), st.floats(0.0, 1.0)),
)
def test_a_ramp_goes_all_the_way_without_turning_back(way, seconds, shares):
    ramp = Ramp(way, seconds)
    sooner, later = (ramp.at(share * seconds)[0] for share in sorted(shares))
    assert 0.0 <= math.copysign(1.0, way) * sooner <= math.copysign(1.0, way) * later + 1e-9
    assert ramp.at(0.0) == (0.0, 0.0)
    assert ramp.at(seconds) == (way, 0.0)


@given(way=st.floats(0.1, 10.0), seconds=st.floats(1.0, 100.0), share=st.floats(0.01, 0.99))
def test_a_ramps_speed_is_the_slope_of_its_way(way, seconds, share):
    ramp, time, step = Ramp(way, seconds), share * seconds, 1e-5 * seconds
    slope = (ramp.at(time + step)[0] - ramp.at(time - step)[0]) / (2 * step)
    assert ramp.at(time)[1] == pytest.approx(slope, abs=1e-3 * abs(ramp.cruise))


def test_a_ramp_cruises_at_the_speed_it_was_asked_for():
    assert Ramp.cruising(0.2, 10.0).at(5.0)[1] == pytest.approx(0.2)
