"""What is said of a computer after a run, with the figures that stood in its files."""

from __future__ import annotations

from dataclasses import replace

import pytest

from robot_runner.meters.machine.machine_doubts import MachineReport, Thresholds
from robot_runner.meters.machine.machine_state import MachineState
from robot_runner.meters.machine.others_load import Load, Share
from robot_runner.meters.machine.processor_state import Conditions

CALM = Conditions(
    governors=("performance",),
    is_turbo=False,
    frequency=1.5e9,
    limit=1.5e9,
    temperature=55.0,
    throttle_counts=(4, 0),
    is_held_back=False,
    is_under_voltage=False,
    over_currents=3,
)
FIRST = MachineState(0.0, 100.0, 2.0, {}, 1, 1000, 0.5, CALM)
LAST = replace(FIRST, at=10.0, busy=105.0)
QUIET = Load(seconds=10.0, busy=50.0, ours=45.0, others=(Share(9, "sshd", 2.0),), unseen=1.0)


def problems(
    *, last: MachineState = LAST, load: Load = QUIET, polled: tuple[Conditions, ...] = (), host: str = ""
) -> list[str]:
    looks = (FIRST.conditions, *polled, last.conditions)
    return MachineReport(host, "r_7", FIRST, last, load, looks, Thresholds()).problems()


def conditions(**changed: object) -> MachineState:
    return replace(LAST, conditions=replace(CALM, **changed))


def test_a_package_that_was_throttled_is_not_counted_once_for_each_of_its_cores() -> None:
    # Each core has a counter of its package, too; here the package was throttled twice, and one core once more.
    before = replace(FIRST, conditions=replace(CALM, throttle_counts=(4, 9, 0, 9)))
    after = conditions(throttle_counts=(7, 11, 2, 11))
    report = MachineReport("", "r_7", before, after, QUIET, (before.conditions,), Thresholds())
    assert report.problems()[0].startswith("the processor was throttled for heat 3 times during r_7")
    assert report.facts()["throttlings"] == 3


def test_a_quiet_computer_is_not_worth_a_word() -> None:
    assert problems() == []


def test_one_process_is_named_with_its_share() -> None:
    load = replace(QUIET, others=(Share(1234, "chromium", 31.4), Share(9, "sshd", 1.0)))
    assert problems(load=load) == ["another process (chromium, pid 1234) took 31 % of a core during r_7"]
    assert problems(load=load, host="pi@robot")[0].startswith("on pi@robot another process (chromium")


def test_several_processes_and_those_that_cannot_be_seen_are_one_sentence() -> None:
    load = replace(
        QUIET, others=(Share(7, "make", 80.0), Share(8, "dockerd", 20.0), Share(9, "sshd", 1.0)), unseen=50.0
    )
    who = "make, pid 7: 80 %; dockerd, pid 8: 20 %; processes that cannot be seen from here: 50 %"
    assert problems(load=load) == [f"other processes took 151 % of a core during r_7 ({who})"]


def test_ticks_of_a_very_short_run_are_no_load() -> None:
    assert problems(load=replace(QUIET, seconds=0.05, others=(Share(7, "make", 40.0),))) == []


@pytest.mark.parametrize(
    ("last", "said"),
    [
        (replace(LAST, stolen=3.0), "the hypervisor gave 10.0 % of a core to others during r_7 (steal time)"),
        (replace(LAST, swapped=1300), "1.2 MB went to swap or came from there during r_7"),
        (replace(LAST, stalled=1.25), "processes waited 0.75 s of 10.0 s for memory during r_7"),
        (
            conditions(throttle_counts=(7, 0), temperature=97.0),
            "the processor was throttled for heat 3 times during r_7 (the hottest zone had 97 °C)",
        ),
        (
            conditions(is_held_back=True),
            "the kernel or the firmware held the processor back during r_7 (the hottest zone had 55 °C)",
        ),
        (conditions(firmware_flags=0b0101), "the firmware reported under-voltage and throttling during r_7"),
        (
            conditions(over_currents=5),
            "the processor was throttled for its current or its voltage 2 times during r_7",
        ),
        (conditions(governors=("powersave",)), "the CPU governor changed from performance to powersave during r_7"),
        (conditions(is_turbo=True), "turbo went from off to on during r_7"),
        (conditions(limit=0.6e9), "the highest frequency that is allowed went from 1,500 to 600 MHz during r_7"),
    ],
)
def test_each_disturbance_is_told_with_its_figure(last: MachineState, said: str) -> None:
    assert problems(last=last) == [said]


def test_what_was_swapped_is_reckoned_by_the_pages_of_the_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mmap.PAGESIZE", 16_384)  # a Raspberry Pi 5
    assert problems(last=replace(LAST, swapped=1100)) == ["1.6 MB went to swap or came from there during r_7"]


def test_what_was_seen_only_on_the_way_is_told_too() -> None:
    assert problems(polled=(replace(CALM, is_under_voltage=True),)) == [
        "the firmware reported under-voltage during r_7"
    ]


def test_flags_that_were_there_before_the_run_are_not_of_the_run() -> None:
    first = replace(FIRST, conditions=replace(CALM, firmware_flags=0b0001))
    last = conditions(firmware_flags=0b0001)
    polled = (first.conditions,)
    assert MachineReport("", "r_7", first, last, QUIET, polled, Thresholds()).problems() == []


def test_flags_that_the_kernel_has_taken_back_since_are_told() -> None:
    # The kernel asks the firmware every two seconds, and has it forget what has happened (drivers/hwmon/
    # raspberrypi-hwmon.c): the flags of one look are about the two seconds before it.
    first = replace(FIRST, conditions=replace(CALM, firmware_flags=0b0001))
    polled = (CALM, replace(CALM, firmware_flags=0b0101), CALM)
    report = MachineReport("", "r_7", first, LAST, QUIET, polled, Thresholds())
    assert report.problems() == ["the firmware reported under-voltage and throttling during r_7"]
    assert report.facts()["firmware"] == ["under-voltage", "throttling"]


def test_a_computer_that_tells_nothing_is_not_doubted() -> None:
    nothing = MachineState(0.0, None, None, {}, None, None, None, Conditions())
    silent = Load(10.0, None, 0.0, (), 0.0)
    report = MachineReport("", "r_7", nothing, replace(nothing, at=10.0), silent, (), Thresholds())
    assert report.problems() == []
    assert report.facts()["frequency_hz"] is None
