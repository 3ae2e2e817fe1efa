"""The recording on an SD card: the same frames as on the line, in a file that a computer can read."""

from __future__ import annotations

import os
import shutil
import subprocess

import pytest
from tests.firmware.card_image import make_card
from tests.firmware.measuring import MISSION, VOLTS, measure, metered

from robot_runner.core.errors import LinkError
from robot_runner.meters.ina219.card import read_card
from robot_runner.meters.ina219.sample_stream import Trouble
from robot_runner.plugins.profilers import Ina219
from robot_runner.testing import FakeClock, make_context, rehearse

PATH = os.environ.get("PATH", "") + ":/usr/sbin:/sbin"  # where Debian keeps what formats

each_file_system = pytest.mark.parametrize(
    ("bits", "is_partitioned"),
    [
        (16, True),
        pytest.param(16, False, marks=pytest.mark.soak),
        pytest.param(32, True, marks=pytest.mark.soak),
        (32, False),
    ],
)


def record(board, tmp_path, card, seconds: float, **settings) -> bytes:
    """Let the board record and return what it sent up the line meanwhile."""
    truth = tmp_path / "truth"
    with board(card=card.path, truth=truth, load=MISSION.words, volts=VOLTS, **settings) as meter:
        measured = measure(meter, tmp_path, seconds)
        assert meter.facts()["lamp"] == 1
    assert measured.problems == []
    return truth.read_bytes()


@pytest.mark.long
@each_file_system
def test_the_file_holds_what_went_up_the_line(board, tmp_path, bits, is_partitioned):
    card = make_card(tmp_path / "card", bits=bits, is_partitioned=is_partitioned)
    sent = record(board, tmp_path, card, 3.0)
    kept = card.content().rstrip(b"\0")
    assert sent.startswith(kept)
    assert len(sent) - len(kept) < 2 * 512  # what was not yet a whole block when the power went


@pytest.mark.long
@pytest.mark.skipif(
    not (shutil.which("mkfs.fat", path=PATH) and shutil.which("mcopy")),
    reason="no tools for FAT are installed (Debian: apt install dosfstools mtools)",
)
@pytest.mark.parametrize(("bits", "size"), [pytest.param(16, 32, marks=pytest.mark.soak), (32, 40)])
def test_a_card_that_was_formatted_and_filled_by_others_is_written_and_stays_sound(board, tmp_path, bits, size):
    card, zeros, copy = tmp_path / "card", tmp_path / "zeros", tmp_path / "INA219.BIN"
    for file, megabytes in ((card, size), (zeros, 1)):
        file.touch()
        os.truncate(file, megabytes * 2**20)
    tool("mkfs.fat", "-F", bits, card)
    tool("mcopy", "-i", card, zeros, "::INA219.BIN")
    with board(card=card, load=MISSION.words, volts=VOLTS) as meter:
        measure(meter, tmp_path, 3.0)
    tool("mcopy", "-i", card, "::INA219.BIN", copy)
    tool("fsck.fat", "-n", card)
    (recording,) = read_card(copy)
    assert recording.stream.troubles()[Trouble.LOST] == 0
    assert len(recording.times) > 480


def tool(name: str, *words: object) -> None:
    program = shutil.which(name, path=PATH)
    assert program is not None
    subprocess.run([program, *map(str, words)], capture_output=True, timeout=30, check=True)


@pytest.mark.long
def test_each_switching_on_is_a_recording_behind_the_last(board, tmp_path):
    card = make_card(tmp_path / "card")
    for _ in range(3):
        record(board, tmp_path, card, 2.0)
    recordings = read_card(card.copy_to(tmp_path / "INA219.BIN"))
    assert [len(each.times) // 100 for each in recordings] == [3, 3, 3]
    assert [each.stream.troubles()[kind] for each in recordings for kind in (Trouble.LOST, Trouble.RESTART)] == [0] * 6
    # What a sample averages lies before its stamp: half a period, and a conversion.
    assert [each.times[0] for each in recordings] == pytest.approx([-(2.5e-3 + 8 * 532e-6)] * 3)


@pytest.mark.long
def test_the_marked_span_is_written_to_its_end_and_its_energy_is_right(board, tmp_path):
    card = make_card(tmp_path / "card")
    record(board, tmp_path, card, 8.0, marks="3,7")
    (recording,) = read_card(card.copy_to(tmp_path / "INA219.BIN"))
    (marked,) = recording.marked
    assert marked.duration == pytest.approx(4.0, abs=0.011)
    joules = recording.evaluate(marked).values()["Energy"]
    assert joules == pytest.approx(VOLTS * (0.685 * 2.3 + 0.946 * 1.7), rel=0.005)


@pytest.mark.long
def test_a_card_that_is_busy_for_a_quarter_of_a_second_costs_no_frame(board, tmp_path):
    card = make_card(tmp_path / "card")
    record(board, tmp_path, card, 5.0, card_busy="0.25,9")
    (recording,) = read_card(card.copy_to(tmp_path / "INA219.BIN"))
    assert recording.stream.troubles()[Trouble.LOST] == 0
    assert len(recording.times) > 850


@pytest.mark.long
def test_only_the_part_of_a_file_that_lies_on_end_is_written(board, tmp_path):
    card = make_card(tmp_path / "card", clusters=(5, 6, 40, 41, 7, 8))
    before = card.path.read_bytes()
    record_until_full(board, tmp_path, card)
    at = (card.first_data + 3 * 4) * 512
    after = card.path.read_bytes()
    assert after[:at] + after[at + 4096 :] == before[:at] + before[at + 4096 :]
    assert any(after[at + 3584 : at + 4096])


def record_until_full(board, tmp_path, card) -> None:
    with board(card=card.path, load=MISSION.words, volts=VOLTS) as meter:
        measured = measure(meter, tmp_path, 4.0)
        assert meter.facts()["lamp"] == 0
    assert measured.problems == []  # the line goes on


@pytest.mark.long
def test_a_full_file_is_left_as_it_is(board, tmp_path):
    card = make_card(tmp_path / "card", clusters=(5, 6))
    record_until_full(board, tmp_path, card)
    full = card.content()
    record_until_full(board, tmp_path, card)
    assert card.content() == full


@pytest.mark.long
def test_a_card_without_the_file_is_left_alone_and_the_line_goes_on(board, tmp_path):
    card = make_card(tmp_path / "card", clusters=())
    before = card.path.read_bytes()
    record_until_full(board, tmp_path, card)
    assert card.path.read_bytes() == before


@pytest.mark.long
def test_a_run_is_measured_from_a_card_that_is_copied_after_its_mission(board, tmp_path):
    card, copy = make_card(tmp_path / "card"), tmp_path / "INA219.BIN"
    with board(card=card.path, load=MISSION.words, volts=VOLTS, marks="2,7") as meter:
        profiler = Ina219(card=str(copy), card_patience_s=5.0)
        context = make_context(tmp_path, profiler, robot=None, clock=meter.clock)
        switched_on = Ina219(name="line", port=meter.port)
        other = metered(meter, tmp_path, switched_on)
        switched_on.start_measurement(other)
        meter.clock.sleep(1.0)

        def mission():
            meter.clock.sleep(6.0)
            card.copy_to(copy)

        measures = dict(rehearse(context, profiler, mission=mission))
        other.resources.close()
    assert measures["Energy"] == pytest.approx(VOLTS * (0.685 * 3.3 + 0.946 * 1.7), rel=0.005)
    assert [finding.problem for finding in context.broker.findings] == []


def test_a_recording_of_the_run_before_is_not_taken_for_this_one(tmp_path):
    copy = tmp_path / "INA219.BIN"
    copy.write_bytes(bytes(512))
    profiler = Ina219(card=str(copy), card_patience_s=2.0)
    clock = FakeClock()
    context = make_context(tmp_path, profiler, robot=None, clock=clock)
    with pytest.raises(LinkError, match="no new recording came within 2 s"):
        rehearse(context, profiler, mission=lambda: clock.sleep(1.0))
