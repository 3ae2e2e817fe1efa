"""Frames of a rosbridge: JSON, CBOR and fragments."""

from __future__ import annotations

import json
import math

import pytest
from cbor2 import dumps
from hypothesis import given
from hypothesis import strategies as st

from robot_runner.ros import rosbridge_frames as frames
from robot_runner.ros.rosbridge_frames import FrameReader
from robot_runner.testing.rosbridge_graph import typed_array

VALUES = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**64), 2**64 - 1) | st.floats(allow_nan=False) | st.text() | st.binary(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
    max_leaves=12,
)


@pytest.mark.long
@given(VALUES)
def test_what_is_written_as_cbor_is_read(value):
    assert frames.read(dumps(value)) == value


# The examples of RFC 8949, appendix A.
@pytest.mark.parametrize(
    ("data", "value"),
    [
        ("1bffffffffffffffff", 18446744073709551615),
        ("3903e7", -1000),
        ("f93e00", 1.5),
        ("fa47c35000", 100000.0),
        ("fb7e37e43c8800759c", 1.0e300),
        ("f97c00", math.inf),
        ("5f42010243030405ff", b"\x01\x02\x03\x04\x05"),
        ("7f657374726561646d696e67ff", "streaming"),
        ("9f018202039f0405ffff", [1, [2, 3], [4, 5]]),
        ("bf61610161629f0203ffff", {"a": 1, "b": [2, 3]}),
    ],
)
def test_the_examples_of_the_standard_are_read(data, value):
    assert frames.read(bytes.fromhex(data)) == value


@pytest.mark.parametrize(
    "kind", ["uint16", "uint32", "uint64", "int8", "int16", "int32", "int64", "float32", "float64"]
)
def test_typed_arrays_are_lists(kind):
    assert frames.read(dumps(typed_array(kind, [1, 2, 3]))) == [1, 2, 3]


# Tags and layouts as in RFC 8746, 2.1.
@pytest.mark.parametrize(
    ("data", "value"),
    [
        ("d84043010203", b"\x01\x02\x03"),
        ("d84443010203", b"\x01\x02\x03"),
        ("d8414400010102", [1, 258]),
        ("d8454401000201", [1, 258]),
        ("d8484201ff", [1, -1]),
        ("d84944fffe0002", [-2, 2]),
        ("d84e48feffffff02000000", [-2, 2]),
        ("d850443e00c000", [1.5, -2.0]),
        ("d85144bfc00000", [-1.5]),
        ("d85648000000000000f83f", [1.5]),
        ("d85640", []),
        ("d9d9f701", 1),
    ],
)
def test_tags_of_either_byte_order_are_read(data, value):
    assert frames.read(bytes.fromhex(data)) == value


@pytest.mark.parametrize(
    "data", ["", "1b00", "61", "ff", "a101", "8201ff", "fc", "81" * 10_000, "1c", "61ff", "d8564100", "d84d01"]
)
def test_what_is_no_cbor_is_refused(data):
    with pytest.raises(ValueError, match=r".+"):
        frames.read(bytes.fromhex(data))


@given(st.binary())
def test_arbitrary_bytes_are_read_or_refused(data):
    try:
        frames.read(data)
    except ValueError:
        return


@given(st.text(min_size=1), st.permutations(range(4)))
def test_fragments_come_in_any_order(text, order):
    whole = json.dumps({"op": "publish", "topic": text})
    size = -(-len(whole) // 4)
    parts = [whole[at * size : (at + 1) * size] for at in range(4)]
    reader = FrameReader()
    read = [
        reader.read(json.dumps({"op": "fragment", "id": "1", "num": index, "total": 4, "data": parts[index]}))
        for index in order
    ]
    assert read == [None, None, None, {"op": "publish", "topic": text}]


@pytest.mark.parametrize(
    "frame", ["[]", "{}", "nothing", '{"op": 1}', '{"op": "fragment", "num": 3, "total": 2, "data": ""}']
)
def test_what_is_no_operation_is_refused(frame):
    with pytest.raises(ValueError, match=r".+"):
        FrameReader().read(frame)


def test_fragments_that_never_become_whole_hold_no_more_than_a_frame(monkeypatch):
    monkeypatch.setattr(frames, "LARGEST_FRAME", 1000)
    reader = FrameReader()
    for name in range(50):
        part = {"op": "fragment", "id": str(name), "num": 0, "total": 2, "data": "a" * 300}
        assert reader.read(json.dumps(part)) is None
    assert sum(len(text) for parts in reader._parts.values() for text in parts.values()) <= 1000


@pytest.mark.parametrize(
    "frame", ["[" * 100_000, '{"op":"fragment","id":"a","num":0,"total":1,"data":"' + "[" * 100_000 + '"}']
)
def test_an_operation_that_is_nested_too_deeply_is_none(frame):
    with pytest.raises(ValueError, match="nested too deeply"):
        FrameReader().read(frame)
