"""What is sent is checked against its definition and completed."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot_runner.core.errors import LinkError
from robot_runner.ros.shapes import UNBOUNDED, Field, Shape, UpTo, completed, plain_type

VECTOR = Shape("geometry_msgs/Vector3", tuple(Field(axis, "float64") for axis in "xyz"))
TWIST = Shape("geometry_msgs/Twist", (Field("linear", VECTOR), Field("angular", VECTOR)))
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
    assert once["linear"] == {"x": 0.0, "y": 0.0, "z": 0.0, **vector}


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
    assert completed(Shape("std_srvs/Trigger"), {}, where="task/stop") == {}
    with pytest.raises(LinkError, match="no field 'data'") as caught:
        completed(Shape("std_srvs/Trigger"), {"data": True}, where="task/stop")
    assert "empty mapping" in caught.value.fix


def one(kind, value, **more):
    return completed(Shape("a/B", (Field("f", kind, **more),)), {"f": value}, where="topic")["f"]


def test_what_is_left_out_is_zero_empty_or_as_its_definition_says():
    kinds = ("bool", "uint8", "float32", "string", "time")
    shape = Shape("a/B", (*(Field(kind, kind) for kind in kinds), Field("w", "float64", default=1.0)))
    assert completed(shape, {}, where="topic") == {
        "bool": False,
        "uint8": 0,
        "float32": 0.0,
        "string": "",
        "time": {"sec": 0, "nanosec": 0},
        "w": 1.0,
    }
    many = Shape("a/B", (Field("s", "string", UNBOUNDED), Field("b", "uint8", 3), Field("v", VECTOR, 1)))
    assert completed(many, {}, where="topic") == {"s": [], "b": bytes(3), "v": [{"x": 0.0, "y": 0.0, "z": 0.0}]}


@pytest.mark.parametrize(
    ("kind", "least", "greatest"),
    [("int8", -128, 127), ("uint8", 0, 255), ("byte", 0, 255), ("int64", -(2**63), 2**63 - 1), ("uint16", 0, 65535)],
)
def test_whole_numbers_keep_to_the_range_of_their_kind(kind, least, greatest):
    assert one(kind, least) == least
    assert one(kind, greatest) == greatest
    for value in (least - 1, greatest + 1, 1.0, True, "1"):
        with pytest.raises(LinkError) as caught:
            one(kind, value)
        assert f"'f' is {value!r}" in caught.value.problem
        assert f"from {least} to {greatest}" in caught.value.fix


def test_floats_may_be_no_numbers_except_in_a_command():
    assert one("float64", math.inf) == math.inf
    assert math.isnan(one("float32", math.nan))
    assert one("float32", 3e38) == 3e38
    with pytest.raises(LinkError, match="not a float32"):
        one("float32", 1e39)
    with pytest.raises(LinkError, match="finite"):
        one("float64", 10**400)


def test_bytes_stay_bytes_whatever_they_are_given_as():
    assert one("uint8", [0, 255], count=UNBOUNDED) == b"\x00\xff"
    assert one("uint8", bytearray(b"ab"), count=2) == b"ab"
    assert one("int16", b"\x01", count=UNBOUNDED) == [1]
    with pytest.raises(LinkError, match=r"'f\[1\]' is 256"):
        one("uint8", [0, 256], count=UNBOUNDED)


def test_arrays_of_numpy_become_lists():
    numpy = pytest.importorskip("numpy")
    assert one("float32", numpy.array([1.0, 2.0]), count=UNBOUNDED) == [1.0, 2.0]
    assert one("int32", numpy.int64(7)) == 7
    assert one("bool", numpy.bool_(True)) is True


@pytest.mark.parametrize(
    ("count", "value", "problem", "fix"),
    [
        (3, [1.0], "1 elements", "Give 3."),
        (UpTo(2), [1.0, 2.0, 3.0], "3 elements", "2 at most"),
        (UNBOUNDED, 1.0, "'f' is 1.0", "a list"),
        (UNBOUNDED, "12", "'f' is '12'", "a list"),
        (UNBOUNDED, [1.0, "2"], "'f[1]' is '2'", "number"),
    ],
)
def test_an_array_of_the_wrong_size_or_kind_is_refused(count, value, problem, fix):
    with pytest.raises(LinkError) as caught:
        one("float64", value, count=count)
    assert problem in caught.value.problem
    assert fix in caught.value.fix


@pytest.mark.parametrize("kind", ["time", "duration"])
def test_stamps_have_seconds_and_nanoseconds(kind):
    assert one(kind, {"sec": 5}) == {"sec": 5, "nanosec": 0}
    with pytest.raises(LinkError, match=r"'f\.secs'") as caught:
        one(kind, {"secs": 5})
    assert "'sec'" in caught.value.fix
    with pytest.raises(LinkError, match=r"'f\.nanosec' is 1000000000"):
        one(kind, {"nanosec": 10**9})


def test_a_time_is_never_negative_and_a_duration_may_be():
    assert one("duration", {"sec": -1})["sec"] == -1
    with pytest.raises(LinkError):
        one("time", {"sec": -1})


def test_a_text_is_a_text_and_keeps_to_its_bound():
    assert one("string", "abc", limit=3) == "abc"
    for value, problem in (("abcd", "4 characters"), (b"abc", "b'abc'"), (None, "None")):
        with pytest.raises(LinkError, match=problem):
            one("string", value, limit=3)


def test_a_text_that_no_encoding_has_is_refused_before_a_client_library_trips_over_it():
    assert one("string", "caméra") == "caméra"
    with pytest.raises(LinkError, match=r"topic \(a/B\): field 'f': no encoding has the character '\\udcff'"):
        one("string", b"cam\xff".decode(errors="surrogateescape"))


def test_the_field_of_an_element_is_named_with_its_index():
    shape = Shape("a/Path", (Field("poses", VECTOR, UNBOUNDED),))
    with pytest.raises(LinkError, match=r"no field 'poses\[1\]\.X'") as caught:
        completed(shape, {"poses": [{}, {"X": 1}]}, where="path")
    assert "'x'" in caught.value.fix


def test_types_are_known_by_either_spelling():
    assert plain_type("geometry_msgs/msg/Twist") == plain_type("geometry_msgs/Twist") == "geometry_msgs/Twist"
    assert plain_type("std_srvs/srv/Trigger") == "std_srvs/Trigger"
