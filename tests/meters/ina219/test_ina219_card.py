"""Recordings from the meter's card, written by hand from docs/ina219-protocol.md."""

from __future__ import annotations

import pytest
from tests.meters.scripted_meter import frame, hello, mark, recording, sample

from robot_runner.core.errors import LinkError
from robot_runner.meters.ina219.card import read_card
from robot_runner.meters.ina219.sample_stream import Trouble
from robot_runner.plugins import Window
from robot_runner.plugins.profilers import Ina219
from robot_runner.testing import FakeClock, make_context, rehearse

PERIOD = 5000
WATTS = 0.613 * 12.4


def written(tmp_path, *recordings: bytes, blank: int = 10):
    file = tmp_path / "INA219.BIN"
    file.write_bytes(b"".join(recordings) + bytes(512 * blank))
    return file


def test_each_switching_on_is_a_recording(tmp_path):
    found = read_card(written(tmp_path, recording(100), recording(300), recording(200)))
    assert [len(each.times) for each in found] == [100, 300, 200]
    assert [each.times[0] for each in found] == [0.0, 0.0, 0.0]
    assert found[1].times[-1] == pytest.approx(299 * 0.005)


def test_switching_on_is_found_however_long_the_recording_before_was(tmp_path):
    hours = 3 * 3600 * 1_000_000
    late = recording(50, start_us=hours % 2**32, first=40_000)
    assert [len(each.times) for each in read_card(written(tmp_path, recording(400), late, recording(100)))] == [
        450,
        100,
    ]


def test_a_recording_without_its_beginning_is_read_all_the_same(tmp_path):
    found = read_card(written(tmp_path, recording(100)[7:519].ljust(1024, b"\0")))
    assert len(found) == 1
    assert 25 < len(found[0].times) < 35


def test_what_the_power_cut_off_is_left_out(tmp_path):
    cut = recording(100)[:1024]
    (found,) = read_card(written(tmp_path, cut))
    assert len(found.times) == (1024 - 20) // 16
    assert found.stream.troubles()[Trouble.LOST] == 0


def test_marked_spans_are_those_between_the_marks(tmp_path):
    marks = [(20, True), (120, False), (150, True), (151, True), (170, False), (180, False), (190, True)]
    (found,) = read_card(written(tmp_path, recording(200, marks=marks)))
    assert [(span.start, span.end) for span in found.marked] == [
        pytest.approx((0.1, 0.6)),
        pytest.approx((0.75, 0.85)),
        pytest.approx((0.95, 0.995)),
    ]


def test_a_mark_before_the_first_sample_marks_from_the_first_sample_on(tmp_path):
    early = hello(0, 5000) + mark(0, 5000, is_on=True)
    whole = early + b"".join(sample(number, 5000 + number * PERIOD) for number in range(100))
    (found,) = read_card(written(tmp_path, whole))
    assert (found.marked[0].start, found.marked[0].end) == pytest.approx((0.0, 0.495))


def test_a_recording_can_be_evaluated_as_a_whole_or_in_part(tmp_path):
    (found,) = read_card(written(tmp_path, recording(401, noise=0)))
    assert found.evaluate().values()["Energy"] == pytest.approx(WATTS * 2.0)
    part = found.evaluate(Window(0.5, 1.25), shunt_ohm=0.2)
    assert part.values()["Energy"] == pytest.approx(WATTS * 0.75 / 2)
    assert any("0.1 ohm, not 0.2 ohm" in doubt for doubt in part.warnings())


@pytest.mark.parametrize("content", [b"", bytes(4096), b"#!/bin/sh\necho no recording\n"])
def test_a_file_without_a_recording_is_refused(tmp_path, content):
    (file := tmp_path / "INA219.BIN").write_bytes(content)
    with pytest.raises(LinkError, match="holds no recording") as caught:
        read_card(file)
    assert str(file) in caught.value.where


def test_a_file_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(LinkError, match="cannot be read"):
        read_card(tmp_path / "nothing.bin")


def test_a_recording_of_a_sensor_that_never_answered_has_no_energy(tmp_path):
    (found,) = read_card(written(tmp_path, hello(0, 5000).ljust(512, b"\0")))
    with pytest.raises(LinkError, match="no samples"):
        found.evaluate()


def run(tmp_path, mission=None, seconds=2.0, **parameters):
    clock, profiler = FakeClock(), Ina219(card=str(tmp_path / "INA219.BIN"), **parameters)
    context = make_context(tmp_path, profiler, robot=None, clock=clock)

    def whole():
        clock.sleep(seconds)
        if mission:
            mission()

    rehearse(context, profiler, mission=whole)
    return context


MARKED = recording(600, marks=[(100, True), (500, False)])


def test_a_run_takes_the_newest_marked_span_of_a_file_that_came_meanwhile(tmp_path):
    written(tmp_path, recording(300))
    old = recording(600, marks=[(10, True), (590, False)])
    context = run(tmp_path, lambda: written(tmp_path, old, MARKED))
    assert context.measures["Energy"] == pytest.approx(WATTS * 2.0)
    assert context.broker.findings == ()
    assert (context.raw_data_folder / "samples.csv").exists()


def test_a_file_that_comes_late_is_waited_for(tmp_path):
    clock, profiler = FakeClock(), Ina219(card=str(tmp_path / "INA219.BIN"), card_patience_s=60.0)
    context = make_context(tmp_path, profiler, robot=None, clock=clock)
    clock.at(30.0, lambda: written(tmp_path, MARKED))
    measures = rehearse(context, profiler, mission=lambda: clock.sleep(2.0))
    assert measures["MeanPower"] == pytest.approx(WATTS)
    assert clock.now() == pytest.approx(30.0, abs=1.0)


def test_a_file_that_is_still_being_copied_is_waited_for(tmp_path):
    clock, profiler = FakeClock(), Ina219(card=str(tmp_path / "INA219.BIN"), card_patience_s=60.0)
    context = make_context(tmp_path, profiler, robot=None, clock=clock)
    for part in range(1, 11):
        clock.at(29.4 + part * 0.4, lambda part=part: written(tmp_path, MARKED[: len(MARKED) * part // 10], blank=0))
    measures = rehearse(context, profiler, mission=lambda: clock.sleep(2.0))
    assert measures["Energy"] == pytest.approx(WATTS * 2.0)
    assert context.broker.findings == ()


def test_a_file_that_goes_on_growing_is_refused(tmp_path):
    clock, profiler = FakeClock(), Ina219(card=str(tmp_path / "INA219.BIN"))
    context = make_context(tmp_path, profiler, robot=None, clock=clock)
    clock.every(0.3, lambda: written(tmp_path, MARKED, blank=round(clock.now() * 10)))
    with pytest.raises(LinkError, match="is still being written"):
        rehearse(context, profiler, mission=lambda: clock.sleep(2.0))


def test_a_file_that_was_there_before_is_not_taken_for_this_run(tmp_path):
    written(tmp_path, MARKED)
    with pytest.raises(LinkError, match="no new recording came within 3 s"):
        run(tmp_path, card_patience_s=3.0)


def test_a_recording_without_a_mark_is_not_guessed_at(tmp_path):
    with pytest.raises(LinkError, match="has no mark") as caught:
        run(tmp_path, lambda: written(tmp_path, recording(600)))
    assert "D4" in caught.value.fix


def test_a_mark_that_lasted_much_longer_than_the_run_is_doubted(tmp_path):
    context = run(tmp_path, lambda: written(tmp_path, MARKED), seconds=20.0)
    assert [finding.problem for finding in context.broker.findings] == [
        "the mark lasted 2.0 s and the measurement 20.0 s: is it this run's?"
    ]


def test_unknown_frames_in_a_recording_are_left_out(tmp_path):
    whole = hello(0, 5000) + sample(0, 5000) + frame(0x17, 1, b"future") + sample(1, 10_000)
    (found,) = read_card(written(tmp_path, whole))
    assert (len(found.times), found.stream.troubles()[Trouble.LOST]) == (2, 0)
