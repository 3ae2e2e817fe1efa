"""Who is said to have had the processor: shares that were worked out by hand."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from tests.meters.machine.computer_copy import ComputerCopy

from robot_runner.measuring.on_board_session import REMOTE_COMMAND
from robot_runner.meters.machine.machine_state import MachineFiles, MachineState, ProcessTimes, SystemFiles
from robot_runner.meters.machine.others_load import Load, is_expected, load_between
from robot_runner.meters.machine.processor_state import Conditions

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

OURS = 100


def state(at: float, busy: float | None, *processes: ProcessTimes) -> MachineState:
    return MachineState(at, busy, 0.0, {each.pid: each for each in processes}, OURS, None, None, Conditions())


def process(pid: int, own: float, *, children: float = 0.0, parent: int = 1, started: str = "1") -> ProcessTimes:
    return ProcessTimes(pid, parent, f"p{pid}", started, False, own, children)


def load(before: MachineState, after: MachineState, *, words: Iterable[str] = (), subjects: Iterable[str] = ()) -> Load:
    return load_between(
        before,
        after,
        is_ours=lambda _: {OURS},
        command_lines=lambda pids: {pid: list(words) for pid in pids},
        subjects=list(subjects),
    )


def shares(found: Load) -> dict[int, float]:
    return {share.pid: round(share.percent, 6) for share in found.others}


def test_another_process_is_told_with_its_share_of_a_core() -> None:
    found = load(
        state(0.0, 100.0, process(OURS, 1.0), process(7, 40.0)),
        state(10.0, 108.1, process(OURS, 6.0), process(7, 43.1)),
    )
    assert shares(found) == {7: 31.0}
    assert found.ours == pytest.approx(50.0)
    assert found.unseen == pytest.approx(0.0)


def test_children_that_ended_meanwhile_count_for_their_parent_and_only_from_the_first_look_on() -> None:
    # A compiler (pid 8) had used 20 s before the first look and 2 s after it; make (pid 7) reaped it.
    found = load(
        state(0.0, None, process(7, 1.0), process(8, 20.0, parent=7)), state(10.0, None, process(7, 1.0, children=22.0))
    )
    assert shares(found) == {7: 20.0}


def test_a_whole_family_that_ended_counts_for_who_reaped_it_and_only_from_the_first_look_on() -> None:
    # A compiler (pid 9) had used 20 s before the first look and 2 s after it; make (pid 8) reaped it, and a shell make.
    before = state(0.0, None, process(7, 1.0), process(8, 0.5, parent=7), process(9, 20.0, parent=8))
    found = load(before, state(10.0, None, process(7, 1.0, children=23.0)))
    assert shares(found) == {7: 25.0}


def test_an_orphan_that_another_one_reaped_counts_no_more_than_the_processor_was_busy() -> None:
    # As above, but make ended first: the first process reaped the compiler, and its counter takes 20 s of before.
    before = state(0.0, 100.0, process(1, 3.0, children=5.0), process(8, 0.5, parent=7), process(9, 20.0, parent=8))
    found = load(before, state(10.0, 102.5, process(1, 3.0, children=27.0), process(7, 0.5, started="2")))
    assert shares(found) == {1: 20.0, 7: 5.0}
    assert found.unseen == pytest.approx(0.0)


def test_a_pid_that_went_to_another_process_begins_anew() -> None:
    found = load(state(0.0, None, process(7, 500.0)), state(10.0, None, process(7, 2.0, started="2")))
    assert shares(found) == {7: 20.0}


def test_what_no_visible_process_took_is_unseen() -> None:
    found = load(state(0.0, 0.0, process(OURS, 0.0)), state(10.0, 14.0, process(OURS, 2.0)))
    assert found.unseen == pytest.approx(120.0)
    assert found.foreign == pytest.approx(120.0)


def test_threads_of_the_kernel_are_nobodys_disturbance(tmp_path: Path) -> None:
    copy = ComputerCopy(tmp_path)
    files = MachineFiles(SystemFiles(tmp_path))
    copy.process(9, "kworker/0:1", ticks=100, flags=0x00200000 | 0x40)
    before = files.state()
    copy.process(9, "kworker/0:1", ticks=100_000, flags=0x00200000 | 0x40)
    found = load_between(before, files.state(), is_ours=lambda _: set(), command_lines=files.command_lines)
    assert found.others == ()


@pytest.mark.parametrize(
    "words",
    [
        ["/opt/ros/humble/lib/turtlebot3_node/turtlebot3_ros"],
        ["/usr/bin/python3", "ws/talker.py", "--ros-args", "-r", "__node:=talker"],
        ["ws/talker", "__name:=talker"],
        ["sh", "-c", REMOTE_COMMAND],
        ["python3", "-I", "-c", '"""Sample a Linux computer\'s utilisation or files from inside: ..."""'],
    ],
)
def test_robot_software_and_our_own_loops_are_expected(words: list[str]) -> None:
    assert is_expected(7, "any", words, ())


def test_what_is_measured_on_purpose_is_expected() -> None:
    assert is_expected(7, "planner", ["/opt/planner"], ["name:planner"])
    assert not is_expected(7, "updater", ["/opt/updater"], ["name:planner"])


def test_a_busy_process_that_is_expected_is_no_load_by_others() -> None:
    before, after = state(0.0, 0.0, process(7, 0.0)), state(10.0, 9.0, process(7, 9.0))
    assert load(before, after, words=["/opt/p7", "--ros-args"]).foreign == pytest.approx(0.0)
    assert load(before, after, subjects=["pid:7"]).foreign == pytest.approx(0.0)
    assert load(before, after).foreign == pytest.approx(90.0)
