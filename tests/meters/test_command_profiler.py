from __future__ import annotations

import csv
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import pytest
from tests.meters.rehearsed import InRealTime, problems
from tests.packaged_inputs import only_in_a_package
from tests.python_program import first_lines

from robot_runner.core.errors import PluginError
from robot_runner.core.events.context import SystemClock
from robot_runner.core.events.measure import Origin
from robot_runner.measuring.meter_process import Ending, MeterProcess
from robot_runner.meters import command
from robot_runner.meters.command import Measured
from robot_runner.plugins import Circumstances, Measure, Window
from robot_runner.plugins.profilers import Aggregate, CommandColumn, CommandProfiler, TimeColumn
from robot_runner.testing import ProfilerContract, make_context, rehearse

#: Rows come each 20 ms; gaps of five times this are let pass, for a machine that is busy with other tests.
PATIENT = 0.3
METER = Path(__file__).with_name("meter_program.py")
CPU = Measure("CPU", "%", "Utilisation.")
COLUMNS = (
    CommandColumn("watts", Measure("Energy", "J", "Energy."), Aggregate.INTEGRAL),
    CommandColumn("percent", CPU),
    CommandColumn("energy_mJ", Measure("Counted", "J", "Energy by the counter."), Aggregate.INCREASE, factor=1e-3),
)


def profiler(*options: str, **settings) -> CommandProfiler:
    command = [sys.executable, str(METER), *options]
    return CommandProfiler(**{"command": command, "columns": COLUMNS, "period_s": PATIENT, **settings})


class TestCommandProfilerOnARealProgram(InRealTime, ProfilerContract):
    robot = None
    is_repeatable = False
    measuring_seconds = 0.1

    def make_plugin(self) -> CommandProfiler:
        return profiler()


@pytest.fixture
def measure(tmp_path):
    def execute(*options, seconds=0.3, **settings):
        # Half a minute without a row is let pass: what a meter that is slow costs is not the matter here.
        plugin = profiler(*options, **{"period_s": 6.0, **settings})
        context = make_context(tmp_path, plugin, robot=None, clock=SystemClock())
        rehearse(context, plugin, mission=lambda: time.sleep(seconds))
        return context

    return execute


def test_the_program_joins_the_graph_of_the_run_s_robot_and_not_that_of_the_shell(tmp_path, monkeypatch):
    monkeypatch.setenv("ROS_DOMAIN_ID", "3")
    tells = 'echo domain; while echo "$ROS_DOMAIN_ID"; do sleep 0.02; done'
    domain = CommandColumn("domain", Measure("Domain", "1", "Its domain."), Aggregate.LAST)
    plugin = CommandProfiler(command=["sh", "-c", tells], columns=[domain], period_s=6.0)
    context = make_context(tmp_path, plugin, robot="dds:domain=7", clock=SystemClock())
    rehearse(context, plugin, mission=lambda: time.sleep(0.3))
    assert context.measures["Domain"] == 7


def duration(context) -> float:
    window = json.loads((context.raw_data_folder / "quality.json").read_text())["window"]
    return window["end"] - window["start"]


@pytest.mark.parametrize("time_column", [None, TimeColumn("time_ms", unit=0.001)], ids=["arrival", "column"])
def test_columns_become_measures(measure, time_column):
    context = measure(time=time_column)
    seconds = duration(context)
    assert seconds >= 0.3
    assert context.measures["Energy"] == pytest.approx(5.0 * seconds)
    assert context.measures["CPU"] == pytest.approx(20.0)
    if time_column is not None:  # the time of arrival is as true as the machine has time
        assert context.measures["Counted"] == pytest.approx(5.0 * seconds, rel=1e-3)
    assert not [problem for problem in problems(context) if "program" in problem or "column" in problem]


def test_a_wall_clock_that_is_set_while_it_stamps_the_rows_is_told(tmp_path, monkeypatch):
    steps = [0.0]
    monkeypatch.setattr(command, "time", SimpleNamespace(time=lambda: time.time() + steps[0]))
    plugin = profiler(time=TimeColumn("time_ms", unit=0.001))
    context = make_context(tmp_path, plugin, robot=None, clock=SystemClock())
    rehearse(context, plugin, mission=lambda: (time.sleep(0.2), steps.__setitem__(0, 0.5)))
    assert any("the clock of the samples is known to 0.5" in problem for problem in problems(context))


@pytest.mark.parametrize(
    ("ahead", "told"), [(1.5, "1.5 s after"), (3600.0, "1 h 00 min after"), (-7200.0, "2 h 00 min before")]
)
def test_rows_that_are_stamped_by_a_wrong_clock_are_doubted_and_told_as_such(measure, ahead, told):
    context = measure("--ahead", str(ahead), time=TimeColumn("time_ms", unit=0.001), period_s=PATIENT)
    (problem,) = [each for each in problems(context) if "stamped" in each]
    assert problem == f"rows are stamped {told} they arrived: by another clock, time zone or unit"
    assert not [each for each in problems(context) if "set back" in each]


def test_the_output_may_be_a_file(measure):
    context = measure("--output", "{output}", output="meter.csv")
    assert context.measures["CPU"] == pytest.approx(20.0)
    assert (context.raw_data_folder / "meter.csv").read_text().startswith("time_ms,watts")


def test_an_output_that_cannot_be_read_costs_its_values_and_says_why(tmp_path):
    plugin = CommandProfiler(
        command=["sh", "-c", "mkdir {output}; exec sleep 60"], columns=COLUMNS, output="rows.csv", startup_s=0.1
    )
    context = make_context(tmp_path, plugin, robot=None, clock=SystemClock())
    rehearse(context, plugin, mission=lambda: time.sleep(0.1))
    assert context.measures["Energy"] is None
    assert problems(context) == ["the program's output cannot be read: rows.csv: Is a directory"]


def test_what_the_program_says_in_between_is_no_row(measure):
    context = measure("--mutters")
    assert context.measures["CPU"] == pytest.approx(20.0)


@pytest.mark.parametrize(
    ("cell", "told"), [("N/A", "'N/A'"), ('"5,0"', "'5,0'"), ("5.0 W", "'5.0 W'"), ("nan", "'nan'")]
)
def test_a_column_that_holds_no_numbers_has_no_value_and_says_why(measure, cell, told):
    context = measure("--watts", cell)
    assert (context.measures["Energy"], context.measures["CPU"]) == (None, pytest.approx(20.0))
    (problem,) = (each for each in problems(context) if "no number" in each)
    assert problem.endswith(f"rows hold no number in column 'watts', the first {told}")


def test_what_one_column_lacks_makes_no_other_one_doubtful(measure):
    context = measure("--watts", "N/A")
    doubted = [fields["measures"] for _, fields in context.broker.records if "no number" in fields.get("problem", "")]
    assert doubted == [["Energy"]]


def _rows_of_ten_seconds(cells, column=COLUMNS[0]):
    plugin = CommandProfiler(command=["meter"], columns=[column], period_s=0.1)
    times = [number / 10 for number in range(-1, 102)]
    window = Window(0.0, 10.0)
    ending = Ending(0, was_asked=True, was_killed=False, complaint="")
    rows = [{column.source: cells(time)} for time in times]
    plugin._measured = measured = Measured(rows, times, window, window, ending)
    return plugin._evaluated(window), [*plugin.doubts(measured), *(told for _, told in plugin.column_doubts(measured))]


def test_numbers_that_cover_a_part_of_the_window_pass_for_no_value_of_the_whole():
    values, doubts = _rows_of_ten_seconds(lambda time: "5.0" if time < 3.0 else "")
    assert values == {}
    assert doubts == ["71 of 101 rows hold no number in column 'watts'"]


def test_a_single_text_among_numbers_is_told_and_costs_no_value():
    values, doubts = _rows_of_ten_seconds(lambda time: "err" if time == 3.0 else "5.0")
    assert values["Energy"] == pytest.approx(50.0)
    assert doubts == ["1 of 101 rows hold no number in column 'watts', the first 'err'"]


def test_a_counter_that_is_set_back_has_no_value_and_says_why():
    values, doubts = _rows_of_ten_seconds(lambda time: str(time % 4.0 + 3.0), COLUMNS[2])
    assert values["Counted"] is None
    assert doubts == ["the counter in column 'energy_mJ' was set back: no value"]


def test_a_column_that_is_filled_in_now_and_then_is_no_doubt():
    values, doubts = _rows_of_ten_seconds(lambda time: "5.0" if round(time * 10) % 3 == 0 else "")
    assert (values["Energy"], doubts) == (pytest.approx(50.0), [])


@pytest.mark.parametrize(
    ("time", "moments", "told"),
    [
        (None, [n // 2 for n in range(20)], "10 of 20"),  # each row twice
        (TimeColumn("second"), [*range(10), 9], "1 of 11"),  # the last one
        (None, [n / 2 for n in range(21)], ""),  # a program that is faster than was said
        (TimeColumn("second"), [n / 2 for n in range(21)], ""),
        (None, [0, 1, 2, 3, 5, 5, 6, 7, 8, 9, 10], ""),  # a row that was held up
        (TimeColumn("second"), [n // 3 for n in range(29)], "19 of 29"),  # each row three times
        (TimeColumn("second"), [*range(10), *range(10), *[1, 4, 4, 8] * 2], ""),  # events, stamped in whole seconds
    ],
)
def test_a_sum_of_rows_that_the_program_repeats_is_doubted(time, moments, told):
    columns = [CommandColumn("count", Measure("Seen", "1", "Things."), Aggregate.SUM), CommandColumn("count", CPU)]
    moments = sorted(moments)
    rows = [{"count": "3", **({"second": str(moment)} if time else {})} for moment in moments]
    plugin = CommandProfiler(command=["meter"], columns=columns, time=time)
    ending = Ending(0, was_asked=True, was_killed=False, complaint="")
    measured = Measured(rows, moments, Window(0.5, 10.0), Window(0.0, 10.0), ending)
    problem = f"{told} rows are the same as the row before, at the same moment: each of them counts in the sum"
    assert list(plugin.column_doubts(measured)) == ([("Seen", problem)] if told else [])


def test_what_becomes_of_a_column_is_told_with_its_measure():
    columns = [
        CommandColumn("mJ", Measure("Energy", "J"), Aggregate.INCREASE, factor=1e-3),
        CommandColumn("watts", Measure("Power", "W", "Of the whole rack.")),
    ]
    assert [measure.description for measure in CommandProfiler(command=["meter"], columns=columns).measures] == [
        "Column 'mJ': increase of a counter over the measured window, times 0.001.",
        "Of the whole rack. Column 'watts': mean over the measured window.",
    ]


def test_raw_output_and_samples_are_kept(measure):
    context = measure()
    with (context.raw_data_folder / "samples.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == ["time_s", "watts", "percent", "energy_mJ"]
    assert {row["watts"] for row in rows} == {"5.000000"}
    assert (context.raw_data_folder / "stdout.txt").read_text().count("\n") == len(rows) + 1
    assert (context.raw_data_folder / "stderr.txt").read_text() == "bye\n"
    facts = json.loads((context.raw_data_folder / "quality.json").read_text())
    assert facts["program"] == {"exit_code": 0, "was_asked": True, "was_killed": False, "complaint": "bye"}


def test_a_program_that_ends_at_once_fails_the_run_with_what_it_said(measure):
    with pytest.raises(PluginError, match="exit code 3: no sensor was found"):
        measure("--fails")


def test_a_program_that_is_not_there_fails_the_run(measure):
    with pytest.raises(PluginError, match="'no-such-meter' cannot be started"):
        measure(command=["no-such-meter"])


def test_a_program_that_dies_half_way_costs_its_values_and_not_the_run(measure):
    context = measure("--dies-after", "5", seconds=1.0, period_s=0.05)
    assert set(context.measures.values()) == {None}
    assert "the program ended by itself, with exit code 4: the sensor was lost" in problems(context)


def test_a_last_row_that_was_torn_within_a_number_is_no_row(measure):
    # Three cells as in the heading, and a power of 5 W of which 500 W are left.
    rows = "time,percent,watts\\n0,20,500\\n1,20,500\\n2,20,500\\n"
    script = f"printf '{rows}'; trap 'printf 3,20,5; exit 0' INT; while :; do sleep 0.05; done"
    context = measure(command=["bash", "-c", script], columns=COLUMNS[:1], period_s=PATIENT)
    with (context.raw_data_folder / "samples.csv").open(newline="") as file:
        assert [row["watts"] for row in csv.DictReader(file)] == ["500.000000"] * 3


def test_a_program_that_says_nothing_costs_its_values_and_not_the_run(measure):
    context = measure("--silent", startup_s=0.05, period_s=PATIENT)
    assert set(context.measures.values()) == {None}
    assert any("no sample arrived" in problem for problem in problems(context))


ROWS_WITHOUT_FLUSHING = """
import signal, sys, time
signal.signal(signal.SIGINT, lambda *_: sys.exit())
rows = {rows}
rows.write("watts\\n")
while True:
    rows.write("5.0\\n")
    time.sleep(0.02)
"""


def test_a_script_that_does_not_flush_is_read_while_it_measures(measure, monkeypatch):
    monkeypatch.delenv("PYTHONUNBUFFERED", raising=False)
    script = ROWS_WITHOUT_FLUSHING.format(rows="sys.stdout")
    context = measure(command=[sys.executable, "-c", script], columns=COLUMNS[:1])
    assert context.measures["Energy"] is not None
    assert problems(context) == []


def test_a_program_that_keeps_its_rows_back_is_told_how_to_write_them(measure):
    script = ROWS_WITHOUT_FLUSHING.format(rows="open(1, 'w')")
    context = measure(command=[sys.executable, "-c", script], columns=COLUMNS[:1], startup_s=0.3, period_s=PATIENT)
    assert context.measures["Energy"] is None
    [told] = [problem for problem in problems(context) if "kept" in problem]
    assert told.endswith("rows back until it ended: have it flush each (such as by `stdbuf -oL`), or name their times")


@pytest.mark.parametrize(("period", "seconds"), [(6.0, 7.2), (60.0, 12.0)])
def test_the_row_that_covers_the_end_of_the_mission_is_awaited_from_a_slow_program_too(
    measure, monkeypatch, period, seconds
):
    awaited, wait = [], MeterProcess.wait

    def noted(self, is_enough, *, seconds):
        awaited.append(seconds)
        return wait(self, is_enough, seconds=seconds)

    monkeypatch.setattr(MeterProcess, "wait", noted)
    measure(period_s=period)
    assert awaited[-1] == pytest.approx(seconds)


def test_a_program_writes_decimal_points_whatever_the_users_language(measure, monkeypatch):
    monkeypatch.setenv("LC_NUMERIC", "de_DE.UTF-8")
    written = 'if [ "$LC_NUMERIC" = C ]; then echo 7.5; else echo 7,5; fi'  # as printf and awk do
    script = f"echo watts; while :; do {written}; sleep 0.05; done"
    context = measure(command=["bash", "-c", script], columns=COLUMNS[:1], startup_s=0.5, seconds=0.5)
    assert context.measures["Energy"] == pytest.approx(7.5 * context.window.duration)


def test_numbers_with_a_decimal_comma_are_told_to_be_no_rows(measure):
    script = "echo watts,volts; while :; do echo 7,5,12,1; sleep 0.05; done"
    context = measure(command=["bash", "-c", script], columns=COLUMNS[:1], startup_s=0.2, period_s=PATIENT)
    assert context.measures["Energy"] is None
    [told] = [problem for problem in problems(context) if "is a row" in problem]
    assert told.startswith("none of ")
    assert told.endswith("lines of its output is a row, such as '7,5,12,1' (cells as in the heading, decimal points)")


def test_a_program_that_is_deaf_is_killed(measure):
    begun = time.monotonic()
    context = measure("--deaf", grace_s=0.1)
    assert time.monotonic() - begun < 60.0
    assert "the program did not end on SIGINT and had to be killed" in problems(context)
    assert context.measures["CPU"] == pytest.approx(20.0)


def test_what_the_program_has_started_ends_with_it(measure, tmp_path):
    note = tmp_path / "child"
    measure("--leaves-child", str(note))
    deadline = time.monotonic() + 60.0
    while _is_alive(int(note.read_text())) and time.monotonic() < deadline:
        time.sleep(0.01)
    assert not _is_alive(int(note.read_text()))


def _is_alive(pid: int) -> bool:
    try:
        state = Path(f"/proc/{pid}/stat").read_text()
    except FileNotFoundError:
        return False
    return state.rpartition(")")[2].split()[0] != "Z"


@pytest.mark.skipif(sys.platform != "linux", reason="asks the kernel of Linux")
def test_a_program_ends_when_the_run_is_killed(tmp_path):
    script = (
        "import sys, time; from pathlib import Path; from robot_runner.core.events.context import SystemClock\n"
        "from robot_runner.measuring.meter_process import MeterProcess\n"
        f"MeterProcess([sys.executable, {str(METER)!r}], output=None, clock=SystemClock(),\n"
        f"             folder=Path({str(tmp_path)!r}))\n"
        "time.sleep(60)"
    )
    run = subprocess.Popen([sys.executable, "-c", script])
    deadline = time.monotonic() + 60.0
    output = tmp_path / "stdout.txt"
    while (not output.exists() or output.read_text().count("\n") < 2) and time.monotonic() < deadline:
        time.sleep(0.01)
    meter = int(output.read_text().splitlines()[1].split(",")[-1])
    assert _is_alive(meter)
    run.kill()
    run.wait(60)
    while _is_alive(meter) and time.monotonic() < deadline:
        time.sleep(0.01)
    assert not _is_alive(meter)


def test_a_separator_that_comes_in_pieces_ends_a_record_as_a_whole_one_does(tmp_path):
    output = tmp_path / "rows"
    meter = MeterProcess(["sleep", "60"], output=output, folder=tmp_path, clock=SystemClock(), separator=";;")
    with output.open("ab", buffering=0) as file:
        for piece in (b"1", b",2;;;", b"4;", b";5"):  # no whole one follows the last, which is split
            file.write(piece)
            assert meter.wait(lambda: meter._offset == file.tell(), seconds=60.0)
    meter.stop(signal.SIGINT, grace=1.0)
    assert [(each.text, each.is_ended) for each in meter.records] == [("1,2", True), (";4", True), ("5", False)]


def test_a_program_of_another_user_is_ended_through_sudo(tmp_path, monkeypatch):
    log = tmp_path / "sudo.log"
    sudo = tmp_path / "sudo"
    sudo.write_text(
        f"{first_lines()}import os, signal, sys\n"
        f"print(*sys.argv[1:], file=open({str(log)!r}, 'a'))\n"
        "os.kill(int(sys.argv[-1]), getattr(signal, 'SIG' + sys.argv[3][1:]))\n"
    )
    sudo.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}{os.environ['PATH']}")
    (folder := tmp_path / "raw").mkdir()
    meter = MeterProcess([sys.executable, str(METER)], output=None, folder=folder, clock=SystemClock())
    assert meter.wait(lambda: len(meter.records) > 1, seconds=10.0)
    kill = os.kill

    def forbid(pid, number):
        if number:
            raise PermissionError
        kill(pid, number)

    monkeypatch.setattr(os, "kill", forbid)
    ending = meter.stop(signal.SIGINT, grace=5.0)
    assert (ending.exit_code, ending.was_killed) == (0, False)
    assert "-n kill -INT -- " in log.read_text()


def test_a_column_that_is_not_there_is_told_with_those_that_are(measure):
    column = CommandColumn("milliwatts", Measure("Power", "W", "Power."))
    context = measure(columns=[column])
    assert context.measures["Power"] is None
    assert "the program's output has no column 'milliwatts'; it has 'time_ms', 'watts'" in problems(context)[0]


def test_a_parse_function_that_raises_costs_its_values_and_not_the_run(measure):
    def broken(_):
        raise ZeroDivisionError("of all things")

    context = measure(parse=broken, startup_s=0.1)
    assert set(context.measures.values()) == {None}
    assert problems(context) == ["the program's output cannot be read: ZeroDivisionError: of all things"]


def test_values_carry_the_origin_that_was_given(measure):
    context = measure(origin=Origin.ESTIMATED)
    assert {published.origin for published in context.broker.measures.values()} == {Origin.ESTIMATED}


def test_a_run_that_was_never_measured_publishes_no_values(tmp_path):
    plugin = profiler()
    context = make_context(tmp_path, plugin, robot=None)
    plugin.populate_run_data(context)
    assert set(context.measures.values()) == {None}


def test_the_check_names_the_program_that_is_missing_and_how_to_get_it():
    (finding,) = profiler(command=["no-such-meter"], install="Buy one.").check(Circumstances())
    assert finding.is_error
    assert "'no-such-meter'" in finding.problem
    assert finding.fix == "Buy one."


@pytest.mark.parametrize(
    ("settings", "problem"),
    [
        ({"command": []}, "command is empty"),
        ({"columns": []}, "columns yield the measures"),
        (
            {"command": ["meter", "-o", "rows.csv"], "output": "rows.csv"},
            "output is 'rows.csv', and .* has no {output}",
        ),
        ({"command": ["meter", "-o", "{output}"]}, "output is None, and .* has {output}"),
        ({"columns": COLUMNS[0]}, "columns is CommandColumn"),
        ({"columns": [COLUMNS[0], COLUMNS[0]]}, "columns yield the measures"),
        ({"period_s": 0.0}, "period_s is 0.0"),
        ({"grace_s": -1.0}, "grace_s is -1.0"),
        ({"time": "when"}, "time is 'when' .* Give time a TimeColumn"),
        ({"columns": ["watts"]}, "columns\\[0\\] is 'watts' .* Give columns\\[0\\] a CommandColumn"),
        ({"origin": "estimated"}, "origin is 'estimated' .* Origin.ESTIMATED"),
        ({"exit_codes": 0}, "exit_codes is 0 .* exit_codes=\\[0\\]"),
        ({"exit_codes": None}, "exit_codes is None .* exit_codes=\\[0\\]"),
        ({"exit_codes": ["0"]}, "exit_codes is \\['0'\\] .* exit_codes=\\[0\\]"),
        ({"stop_signal": "signal.SIGTERM"}, "'signal.SIGTERM', which is no member .* stop_signal=signal.SIGTERM\\."),
        ({"stop_signal": "term"}, "'term', which is no member .* stop_signal=signal.SIGTERM\\."),
        ({"stop_signal": 35}, "35, which is no member .* stop_signal=signal.SIGINT\\."),
        ({"stop_signal": [2]}, "\\[2\\], which is no member .* stop_signal=signal.SIGINT\\."),
        ({"stop_signal": True}, "True, which is no member .* stop_signal=signal.SIGINT\\."),
        ({"separator": ""}, "separator is '' .* Give the text that ends a record"),
        ({"separator": None}, "separator is None .* Give the text that ends a record"),
        ({"parse": "csv"}, "parse is 'csv' .* Give parse a function, or leave it out"),
        ({"output": 3}, "output is 3 .* Give output a str"),
    ],
)
def test_what_cannot_be_is_refused(settings, problem):
    with pytest.raises(PluginError, match=problem):
        profiler(**settings)


def test_the_script_that_measures_is_kept_with_the_modules_beside_it_and_found_again(tmp_path, monkeypatch):
    study = tmp_path / "study"
    study.mkdir()
    (study / "calibration.py").write_text("FACTOR = 60.0\n")
    (study / "meter.py").write_text(
        "import time, calibration\n"
        "print('watts', flush=True)\n"
        "while True:\n"
        "    print(calibration.FACTOR, flush=True)\n"
        "    time.sleep(0.02)\n"
    )
    monkeypatch.chdir(study)
    watts = CommandColumn("watts", Measure("Power", "W", "Power."), Aggregate.LAST)
    meter = CommandProfiler(command=[sys.executable, "meter.py"], columns=[watts], period_s=PATIENT)
    with only_in_a_package(meter.input_files(), study, study, monkeypatch) as working:
        assert {each.name for each in working.rglob("*.py")} == {"meter.py", "calibration.py"}
        context = make_context(tmp_path / "run", meter, robot=None, clock=SystemClock())
        measures = rehearse(context, meter, mission=lambda: time.sleep(0.05))
    assert measures["Power"] == 60.0
