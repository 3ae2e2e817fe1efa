"""Measures are recomputed from logs as meters write them: counters that start again, process ids in names of files."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from tests.analysis.importing.foreign_folder import write

from robot_runner.analysis.importing.adoption import Adoption, adopt
from robot_runner.analysis.importing.description import ImportDescription, parse_recipe
from robot_runner.analysis.importing.understanding import understand

if TYPE_CHECKING:
    from pathlib import Path

TABLE = "__run_id,__done,task,duration_s\nrun_0,DONE,video,2\nrun_1,DONE,network,2\n"


def adopted(folder: Path, recipe: str, *logs: str) -> Adoption:
    write(folder / "run_table.csv", TABLE)
    for number, log in enumerate(logs):
        write(folder / f"run_{number}" / "meter.csv", log)
    said = ImportDescription(recipes=(parse_recipe(f"Total={recipe}"),))
    return adopt(understand(folder, said), folder.with_name("ours"))


def totals(adoption: Adoption) -> list[float | None]:
    return [run.recomputed["Total"] for run in adoption.runs]


def counter(*joules: float) -> str:
    return "Time,PACKAGE_ENERGY (J)\n" + "".join(f"{each},{count}\n" for each, count in enumerate(joules))


def test_the_change_of_a_counter_that_started_again_bridges_that_step(tmp_path):
    # 90 J a second from 253,144 J on; 262,144 J is 0 again, after 100 s.
    wrapped = counter(*((253144.0 + 90 * second) % 262144 for second in range(201)))
    found = adopted(tmp_path / "theirs", "change(meter.csv:PACKAGE_ENERGY (J))", wrapped, counter(90.0, 150.0, 210.0))
    assert totals(found) == pytest.approx([18000.0, 120.0])
    told = "PACKAGE_ENERGY (J) of meter.csv starts again from a low count in 1 of 2 runs (run_0)"
    assert found.warnings[0] == f"{told}: its change bridges that step, and is missing where the step is long"


def test_the_change_of_a_counter_that_started_again_in_a_long_step_is_missing(tmp_path):
    logs = counter(262000.0, 262100.0, 44.0, 90.0), counter(90.0, 150.0, 210.0)
    assert totals(adopted(tmp_path / "theirs", "change(meter.csv:PACKAGE_ENERGY (J))", *logs)) == [None, 120.0]


@pytest.mark.parametrize(
    ("joules", "change"), [((100.0, 90.0, 40.0), -60.0), ((0.0, 0.0, 5.0), 5.0), ((-3.0, -1.0, -2.5), 0.5)]
)
def test_what_falls_as_a_battery_does_or_stands_at_zero_has_not_started_again(tmp_path, joules, change):
    found = adopted(tmp_path / "theirs", "change(meter.csv:PACKAGE_ENERGY (J))", counter(*joules), counter(1.0, 2.0))
    assert totals(found) == [change, 1.0]
    assert found.warnings == ()


@pytest.mark.parametrize(("how", "expected"), [("integral", 42.0), ("time_mean", 21.0)])
def test_samples_of_one_moment_count_as_their_mean(tmp_path, how, expected):
    # Whole seconds, as a logger prints that is faster: the last of a second is no better than the others.
    watts = (("10:22:22", (10, 20, 30)), ("10:22:23", (20, 20, 26)), ("10:22:24", (0, 30, 30)))
    log = "timestamp,power (W)\n" + "".join(f"{time},{each}\n" for time, values in watts for each in values)
    found = adopted(tmp_path / "theirs", f"{how}(meter.csv:power (W))", log, log)
    assert totals(found) == pytest.approx([expected, expected])
    told = "meter.csv has 3 samples to each time, and times 1 s apart, in 2 of 2 runs (run_0 and run_1)"
    assert found.warnings == (f"{told}: durations and integrals are not known better than that",)


def test_a_power_that_comes_of_a_counter_that_wrapped_around_is_missing_and_told(tmp_path):
    steady = [f"2023-10-21 22:{second // 60:02}:{second % 60:02},40.0" for second in range(120)]
    wrapped = [*steady[:50], "2023-10-21 22:00:50,-262096.2", *steady[51:]]
    logs = ("\n".join(["Date,Total Power", *rows, ""]) for rows in (wrapped, steady))
    found = adopted(tmp_path / "theirs", "integral(meter.csv:Total Power)", *logs)
    assert totals(found) == [4760.0, 4760.0]
    told = "1 power of meter.csv is far below 0, as where a counter wraps around, and is missing here"
    assert found.warnings[0] == f"{told}, in 1 of 2 runs (run_0)"


@pytest.mark.parametrize(
    ("watts", "least"),
    [([0.5, *[-12.0] * 5], -12.0), ([*[0.0] * 120, -0.001], -0.001)],
    ids=["a battery that discharges", "noise about zero"],
)
def test_powers_may_be_below_zero(tmp_path, watts, least):
    rows = "".join(f"{second},{each}\n" for second, each in enumerate(watts))
    found = adopted(
        tmp_path / "theirs", "min(meter.csv:power (W))", f"time_s,power (W)\n{rows}", "time_s,power (W)\n0,1\n1,2\n"
    )
    assert totals(found) == [least, 1.0]
