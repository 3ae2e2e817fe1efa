"""What is sent is checked against its definition and completed."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot_runner.errors import LinkError
from robot_runner.links.messages import DEFAULTS, completed

TWIST = "geometry_msgs/Twist"
FINITE = st.floats(allow_nan=False, allow_infinity=False)


def test_fields_that_are_left_out_take_their_default():
    assert completed(TWIST, {"angular": {"z": 2}}, where="cmd_vel") == {
        "linear": {"x": 0.0, "y": 0.0, "z": 0.0},
        "angular": {"x": 0.0, "y": 0.0, "z": 2.0},
    }


@given(st.fixed_dictionaries({}, optional={"x": FINITE, "y": FINITE, "z": FINITE}))
def test_a_completed_message_is_complete(vector):
    once = completed(TWIST, {"linear": vector}, where="cmd_vel")
    assert completed(TWIST, once, where="cmd_vel") == once
    assert once["linear"] == {**DEFAULTS[TWIST]["linear"], **vector}


def test_the_definitions_are_never_changed():
    completed(TWIST, {}, where="cmd_vel")["linear"]["x"] = 9.0
    assert completed(TWIST, {}, where="cmd_vel")["linear"]["x"] == 0.0


@pytest.mark.parametrize(
    ("message", "problem", "fix"),
    [
        ({"liner": {"x": 1}}, "'liner'", "'linear'"),
        ({"linear": {"X": 1}}, "'linear.X'", "'x'"),
        ({"linear": {"x": "1"}}, "'linear.x' is '1'", "finite number"),
        ({"linear": {"x": True}}, "'linear.x' is True", "finite number"),
        ({"linear": {"x": math.nan}}, "'linear.x' is nan", "finite number"),
        ({"linear": {"x": math.inf}}, "'linear.x' is inf", "finite number"),
        ({"linear": {"x": None}}, "'linear.x' is None", "finite number"),
        ({"linear": 0.2}, "linear is 0.2", "mapping"),
        ([0.2], "the message is", "mapping"),
    ],
)
def test_a_message_that_does_not_follow_its_definition_is_refused(message, problem, fix):
    with pytest.raises(LinkError) as caught:
        completed(TWIST, message, where="cmd_vel")
    assert problem in caught.value.problem
    assert fix in caught.value.fix
    assert "cmd_vel" in caught.value.where


def test_a_request_without_fields_takes_none():
    assert completed("std_srvs/Trigger", {}, where="task/stop") == {}
    with pytest.raises(LinkError, match="no field 'data'") as caught:
        completed("std_srvs/Trigger", {"data": True}, where="task/stop")
    assert "empty mapping" in caught.value.fix
