"""The records of a run on their way through the pipe."""

from __future__ import annotations

import json
import os
import sys
import threading
from typing import Any

import pytest

from robot_runner.core.execution.run_records import FINISHED, RecordReader, RecordWriter


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


def test_a_run_does_not_wait_for_an_orchestrator_that_does_not_read_and_loses_nothing_of_what_it_said() -> None:
    reading, writing = os.pipe()
    report = RecordWriter(writing)
    said = [("shared", {"number": number, "text": "x" * number}) for number in range(1000)]  # 500 kB: a pipe takes 64
    for kind, fields in said:
        report(kind, fields)

    reader = RecordReader(reading)
    arrived: list[tuple[str, dict[str, Any]]] = []
    end = threading.Thread(target=report, args=(FINISHED, {}))  # the last one waits until all have been taken
    end.start()
    while not arrived or arrived[-1][0] != FINISHED:
        arrived += reader.read()[0]
    end.join()
    assert arrived == [*said, (FINISHED, {})]
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
