"""The records of a run on their way through the pipe."""

from __future__ import annotations

import json
import os
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import pytest
from tests.instructions import Instructions
from tests.waiting import PATIENCE

from robot_runner.core.errors import ExecutionError
from robot_runner.core.events.early_end import RunInterrupted
from robot_runner.core.execution import run_records
from robot_runner.core.execution.interruption import InterruptGate
from robot_runner.core.execution.run_records import FINISHED, RecordReader, RecordWriter, failure_fields


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux has pipes that keep writes apart")
def test_what_a_run_publishes_in_its_evaluation_crosses_the_pipe_in_one_write_and_what_a_mission_says_at_once() -> None:
    reading, writing = os.pipe2(os.O_DIRECT | os.O_NONBLOCK)  # a read returns one write, of at most 4096 bytes
    report = RecordWriter(writing)
    published = [("measure", {"name": f"Value {number}", "value": number}) for number in range(30)]

    for kind, fields in (
        ("event", {"event": "launch_mission"}),
        published[0],
        ("event", {"event": "populate_run_data"}),
    ):
        report(kind, fields)
        assert os.read(reading, 4096).count(b"\n") == 1
    for kind, fields in published:
        report(kind, fields)
    with pytest.raises(BlockingIOError):
        os.read(reading, 4096)
    report(FINISHED, {})

    arrived = [tuple(json.loads(line)) for line in os.read(reading, 4096).splitlines()]
    assert arrived == [*published, (FINISHED, {})]
    os.close(writing)
    os.close(reading)


def test_a_record_that_arrives_in_pieces_is_read_once_its_line_has_ended() -> None:
    """Each piece of a long one was copied with all before it: a text of 300 MB held the orchestrator up for minutes."""
    reading, writing = os.pipe()
    reader = RecordReader(reading)
    long = {"name": "Log", "value": 100_000 * "x"}
    line = json.dumps(["measure", long]).encode()
    for piece in (line[:40_000], line[40_000:80_000], line[80_000:]):
        os.write(writing, piece)
        assert reader.read() == ([], True)
    os.write(writing, b'\n["event", {}]\n["mea')
    assert reader.read() == ([("measure", long), ("event", {})], True)
    os.write(writing, b'sure", {}]\n')
    os.close(writing)
    assert reader.read() == ([("measure", {})], True)
    assert reader.read() == ([], False)
    os.close(reading)


def test_an_error_without_words_is_told_by_its_type_alone() -> None:
    assert failure_fields(AssertionError())["problem"] == "AssertionError"
    assert failure_fields(AssertionError("no map"))["problem"] == "AssertionError: no map"


def test_a_run_that_asks_its_user_is_told_who_asks_instead() -> None:
    problem = failure_fields(EOFError("EOF when reading a line"))["problem"]
    assert problem.startswith("EOFError: EOF when reading a line (nobody can type into a run: ")
    assert "operator_steps" in problem


def taken(report: RecordWriter, reading: int) -> list[tuple[str, dict[str, Any]]]:
    """End a run's report, which waits until all of it was taken, and return what arrived."""
    reader, arrived = RecordReader(reading), []
    end = threading.Thread(target=report, args=(FINISHED, {}))
    end.start()
    deadline = time.monotonic() + PATIENCE
    while not arrived or arrived[-1][0] != FINISHED:
        assert time.monotonic() < deadline, f"after {len(arrived)} records there came no more"
        arrived += reader.read()[0]
    end.join(PATIENCE)
    assert not end.is_alive()
    return arrived


def test_a_run_does_not_wait_for_an_orchestrator_that_does_not_read_and_loses_nothing_of_what_it_said() -> None:
    reading, writing = os.pipe()
    report = RecordWriter(writing)
    said = [("shared", {"number": number, "text": "x" * number}) for number in range(1000)]  # 500 kB: a pipe takes 64
    for kind, fields in said:
        report(kind, fields)

    assert taken(report, reading) == [*said, (FINISHED, {})]
    os.close(writing)
    os.close(reading)


def test_a_run_whose_orchestrator_is_gone_does_not_wait_with_what_it_holds() -> None:
    reading, writing = os.pipe()
    report = RecordWriter(writing)
    for number in range(1000):
        report("shared", {"number": number, "text": "x" * 1000})
    os.close(reading)
    report(FINISHED, {})
    os.close(writing)


def test_callbacks_do_not_fill_the_memory_for_an_orchestrator_that_never_reads_and_the_failure_is_told_once_it_does(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("robot_runner.core.execution.run_records._MOST_HELD", 100_000)
    reading, writing = os.pipe()
    report = RecordWriter(writing)
    said: list[tuple[str, dict[str, Any]]] = []

    def share(times: int) -> None:
        for _ in range(times):
            said.append(("shared", {"number": len(said), "text": "x" * 1000}))
            report(*said[-1])

    with pytest.raises(ExecutionError, match="does not take what the run tells"):
        share(1000)
    assert 100 < len(said) < 200
    said.append(("failure", {"problem": "the orchestrator does not take what the run tells"}))
    report(*said[-1])
    assert taken(report, reading) == [*said, (FINISHED, {})]
    share(1)  # once it reads, callbacks go on
    os.close(writing)
    os.close(reading)


def _told(at: int | None, act: Callable[[RecordWriter], object]) -> tuple[list[str], int]:
    """Act at an instruction of sending a long record; return what arrives, and how many instructions it has."""
    reader, writer = os.pipe()
    records, sent = RecordReader(reader), RecordWriter(writer)
    with suppress(RunInterrupted), Instructions(run_records.__file__, at=at, act=lambda _frame: act(sent)) as counted:
        sent("shared", {"values": "long" * 3_000})
    sent("window", {})
    sent.close()
    os.set_blocking(reader, True)
    kinds = [kind for kind, _ in records.read()[0]]
    os.close(reader)
    return kinds, counted.count


def test_a_record_that_is_interrupted_anywhere_is_neither_torn_nor_told_twice() -> None:
    def interrupt(_sent: RecordWriter) -> None:
        gate = InterruptGate()
        gate.request(at_once=True)

    kinds, count = _told(None, interrupt)
    assert kinds == ["shared", "window"]
    for at in range(1, count + 1):
        kinds, _ = _told(at, interrupt)
        assert kinds in (["shared", "window"], ["window"]), at


def test_a_signal_handler_may_tell_something_while_another_record_is_being_sent() -> None:
    def tell(sent: RecordWriter) -> None:
        sent("mission_stopped", {})

    _, count = _told(None, tell)
    for at in range(1, count + 1):
        kinds, _ = _told(at, tell)
        assert sorted(kinds) == ["mission_stopped", "shared", "window"], at
