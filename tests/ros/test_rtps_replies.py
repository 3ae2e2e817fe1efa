"""Replies in RTPS messages: whole, in fragments, for others, and broken."""

from __future__ import annotations

import io
import struct

import pytest

from robot_runner.ros import rtps_replies
from robot_runner.ros.rtps_replies import RequestId, RtpsReplies, captured_messages

SERVER, CLIENT = bytes(range(12)), bytes(range(100, 116))
OWN = bytes(12)
WRITER, READER = b"\0\0\x14\x03", b"\0\0\x02\x04"
OURS = RequestId(CLIENT, 2**32 + 7)


class Heard:
    def __init__(self, awaited=(OURS,)):
        self.replies, self.met = [], []
        self.reading = RtpsReplies(set(awaited).__contains__, lambda *reply: self.replies.append(reply), self.meet)

    def meet(self, writer, reader):
        self.met.append((writer, reader))

    def read(self, *submessages):
        self.reading.read(message(*submessages), OWN)
        return self.replies


def message(*submessages):
    return b"RTPS\2\2\1\x0f" + SERVER + b"".join(submessages)


def submessage(kind, flags, body, order="<"):
    return struct.pack(f"{order}BBH", kind, flags | (order == "<"), len(body)) + body


def inline_qos(order="<", request=OURS, parameter=0x800F):
    others = struct.pack(f"{order}HHI", 0x71, 4, 0)
    identity = request.client + struct.pack(f"{order}iI", request.number >> 32, request.number & (2**32 - 1))
    return others + struct.pack(f"{order}HH", parameter, 24) + identity + struct.pack(f"{order}HH", 1, 0)


def data(content, order="<", **of):
    head = struct.pack(f"{order}HH", 0, 16) + READER + WRITER + struct.pack(f"{order}iI", 0, 1)
    return submessage(0x15, 0x06, head + inline_qos(order, **of) + content, order)


def fragment(whole, first, size=256, count=1, sample=1):
    head = struct.pack("<HH", 0, 28) + READER + WRITER + struct.pack("<iI", 0, sample)
    head += struct.pack("<IHHI", first, count, size, len(whole))
    return submessage(0x16, 0x02, head + inline_qos() + whole[(first - 1) * size : (first - 1 + count) * size])


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("parameter", [0x0083, 0x800F])
def test_a_reply_is_found_with_the_request_that_it_answers(order, parameter):
    time = submessage(0x09, 0, bytes(8))
    assert Heard().read(time, data(b"\0\1\0\0yes", order, parameter=parameter)) == [(OURS, b"\0\1\0\0yes")]


def test_a_reply_to_another_client_or_another_request_is_left_out():
    heard = Heard()
    heard.read(data(b"no", request=RequestId(bytes(16), OURS.number)))
    heard.read(data(b"no", request=RequestId(CLIENT, 7)))
    heard.read(data(b"no", parameter=0x0070))
    assert not heard.replies


def test_fragments_in_any_order_and_twice_make_one_reply():
    whole = bytes(range(250)) * 4
    heard = Heard()
    for first, count in ((3, 2), (1, 1), (1, 1)):
        assert not heard.read(fragment(whole, first, count=count))
    assert heard.read(fragment(whole, 2)) == [(OURS, whole)]


def test_replies_of_which_nothing_more_comes_take_no_more_memory_than_one_may(monkeypatch):
    monkeypatch.setattr(rtps_replies, "_LARGEST", 10_000)
    heard, whole = Heard(), bytes(range(250)) * 16
    for sample in range(1, 100):
        heard.read(fragment(whole, 1, sample=sample))
    assert sum(len(each.data) for each in heard.reading._fragments.values()) <= 10_000
    assert heard.read(*(fragment(whole, 1 + 4 * part, count=4, sample=1) for part in range(4))) == [(OURS, whole)]


def test_who_sends_to_our_reader_is_told():
    heard = Heard()
    heartbeat = submessage(0x07, 0x03, READER + WRITER + bytes(20))
    heard.read(heartbeat)
    heard.read(submessage(0x0E, 0, CLIENT[:12]), heartbeat)  # to another participant
    heard.read(submessage(0x07, 0x03, bytes(4) + WRITER + bytes(20)))  # to all readers
    assert heard.met == [(SERVER + WRITER, OWN + READER)]


def test_what_is_cut_short_or_lies_about_its_size_is_left_out():
    heard = Heard()
    whole = message(data(b"\0\1\0\0yes"))
    for end in range(len(whole)):
        heard.reading.read(whole[:end], OWN)
    for first, size, count, told in ((0, 256, 1, 500), (9, 256, 1, 500), (1, 1, 1, 500), (1, 256, 1, 2**32 - 1)):
        head = struct.pack("<HH", 0, 28) + READER + WRITER + struct.pack("<iIIHHI", 0, 1, first, count, size, told)
        heard.read(submessage(0x16, 0x02, head + inline_qos() + bytes(500)))
    heard.read(struct.pack("<BBH", 0x15, 7, 60000))
    assert not heard.replies


def test_packets_are_read_out_of_a_capture_until_it_ends():
    packets = [message(data(b"one")), message()]
    capture = bytes(24)
    for each in packets:
        capture += struct.pack("=IIII", 1, 2, len(each) + 28, len(each) + 28) + bytes(28) + each
    assert list(captured_messages(io.BytesIO(capture + b"\0\0"))) == packets
