from __future__ import annotations

import csv
import json
import os
import shutil
import subprocess
import time

import pytest
from tests.meters.fake_sysfs import write
from tests.meters.rehearsed import InRealTime
from tests.waiting import wait_until

from robot_runner.core.errors import PluginError
from robot_runner.core.events.context import SystemClock
from robot_runner.measuring.meter_process import Ending
from robot_runner.meters.command import Measured
from robot_runner.meters.perf_stat import parse_perf
from robot_runner.plugins import Circumstances, Window
from robot_runner.plugins.profilers import PerfStat
from robot_runner.testing import ProfilerContract, make_context, rehearse

# What perf 6.1 wrote for `perf stat -x ';' -I 200 -a -e task-clock,context-switches,cycles`, in a virtual machine that
# has no hardware counters; the row of cache-misses was added by hand after the format that `man perf-stat` gives.
RECORDED = """\
# started on Sat Nov 21 03:01:29 2026

     0.200243912;400.71;msec;task-clock;400705362;100.00;2.004;CPUs utilized
     0.200243912;628;;context-switches;400704330;100.00;1.567;K/sec
     0.200243912;<not supported>;;cycles;0;100.00;;
     0.200243912;33000;;cache-misses;200250000;50.00;;
"""


def _may_count() -> bool:
    if shutil.which("perf") is None:
        return False
    words = ["perf", "stat", "-a", "-e", "task-clock", "--", "true"]
    return subprocess.run(words, capture_output=True, timeout=30, check=False).returncode == 0


needs_perf = pytest.mark.skipif(not _may_count(), reason="needs perf, and the right to count on all processors")


@needs_perf
class TestPerfStatOnThisMachine(InRealTime, ProfilerContract):
    robot = None
    is_repeatable = False
    measuring_seconds = 0.1

    def make_plugin(self) -> PerfStat:
        return PerfStat(events=["task-clock", "context-switches"], interval_ms=100)


@pytest.fixture
def measure(tmp_path):
    def execute(mission, **settings):
        plugin = PerfStat(interval_ms=100, **settings)
        plugin.period_s = 0.3  # lets gaps pass, for a machine that is busy with other tests
        context = make_context(tmp_path, plugin, robot=None, clock=SystemClock())
        rehearse(context, plugin, mission=mission)
        return context

    return execute


def _busy(seconds: float) -> None:
    """Use so much CPU time, however long that takes."""
    end = time.process_time() + seconds
    while time.process_time() < end:
        pass


def test_a_clock_of_all_processors_says_that_it_counts_idle_ones():
    told = [each.description for each in PerfStat(events=["task-clock", "cycles"]).measures]
    assert ["idle ones too" in description for description in told] == [True, False]
    assert "idle" not in PerfStat(events=["task-clock"], pid=4711).measures[0].description


@needs_perf
def test_the_clocks_of_all_processors_tick_all_the_time(measure):
    context = measure(lambda: time.sleep(0.5), events=["task-clock"])
    window = json.loads((context.raw_data_folder / "quality.json").read_text())["window"]
    processors = os.cpu_count()
    assert context.measures["TaskClock"] == pytest.approx((window["end"] - window["start"]) * processors, rel=0.1)


@pytest.mark.long
@needs_perf
def test_the_clock_of_one_process_ticks_while_it_works(measure):
    begun = time.process_time()
    context = measure(lambda: _busy(0.5), events=["task-clock"], pid=os.getpid())
    assert 0.4 < context.measures["TaskClock"] < time.process_time() - begun + 0.1


@needs_perf
def test_what_is_counted_is_kept(measure):
    context = measure(lambda: time.sleep(0.2), events=["task-clock", "page-faults"])
    with (context.raw_data_folder / "samples.csv").open(newline="") as file:
        assert next(csv.reader(file)) == ["time_s", "task-clock", "page-faults"]
    assert context.measures["PageFaults"] >= 0


@needs_perf
def test_an_event_that_does_not_exist_is_refused_with_what_perf_says():
    (finding,) = PerfStat(events=["no-such-event"]).check(Circumstances())
    assert finding.is_error
    assert "no-such-event" in finding.problem


def stand_in(folder, recorded=RECORDED) -> str:
    """Return a program that writes what was recorded, over and over, until it is interrupted."""
    heading, rows = recorded.split("\n\n")
    path = folder / "perf"
    path.write_text(
        "#!/bin/sh\n"
        'while [ "$1" != --output ] && [ $# -gt 1 ]; do shift; done\n'
        f"[ $# -gt 1 ] || {{ sed 's/^[^;]*;//' >&2 <<'END'\n{rows}END\nexit 0; }}\n"  # as without intervals
        "trap 'exit 0' INT\n"
        f"echo '{heading}' >\"$2\"\n"
        "n=0; while :; do n=$((n+1)); sleep 0.05\n"
        f'sed "s/ 0.200243912/ $((n*200+1000)).0e-3/" >>"$2" <<\'END\'\n{rows}END\ndone\n',
        encoding="ascii",
    )
    path.chmod(0o755)
    return str(path)


def wait_for_rows(context) -> None:
    """Wait until the stand-in has written some more."""
    output = context.raw_data_folder / "perf.csv"
    begun = output.read_text().count("\n")
    wait_until(lambda: output.read_text().count("\n") > begun + 12, "there are more rows")


def test_an_event_that_cannot_be_counted_is_named_and_one_that_was_scaled_too(tmp_path):
    events = ["task-clock", "cycles", "cache-misses"]
    plugin = PerfStat(events=events, interval_ms=100, program=stand_in(tmp_path))
    plugin.period_s = 6.0  # a machine that is busy for seconds costs no value
    context = make_context(tmp_path, plugin, robot=None, clock=SystemClock())
    rehearse(context, plugin, mission=lambda: wait_for_rows(context))
    problems = [finding.problem for finding in context.broker.findings]
    assert context.measures["Cycles"] is None
    assert context.measures["TaskClock"] is not None
    assert "this machine cannot count 'cycles'" in problems
    assert "'cache-misses' was counted in 50 % of the time only, and scaled up by perf" in problems


DIES = "perf adds up the energy of 2 dies, and each reports that of its whole package"


@pytest.mark.parametrize(
    ("vendor", "mask", "told"),
    [
        ("AuthenticAMD", "0,8", [("EnergyPkg", DIES)]),
        ("AuthenticAMD", "0-1", [("EnergyPkg", DIES)]),
        ("AuthenticAMD", "0", []),
        ("GenuineIntel", "0,8", []),
    ],
)
def test_energy_that_the_kernel_has_once_for_each_die_of_an_amd_package_is_doubted(tmp_path, vendor, mask, told):
    # Linux before 6.12: one processor of each die reads the one counter of its package (arch/x86/events/rapl.c).
    cpuinfo = write(tmp_path / "cpuinfo", f"processor\t: 0\nvendor_id\t: {vendor}")
    write(tmp_path / "bus/event_source/devices/power/cpumask", mask)
    for number in range(16):
        write(tmp_path / f"devices/system/cpu/cpu{number}/topology/physical_package_id", 0)
    plugin = PerfStat(events=["power/energy-pkg/", "cycles"], sysfs=tmp_path, cpuinfo=cpuinfo)
    window = Window(0.0, 1.0)
    measured = Measured([], [], window, window, Ending(0, was_asked=True, was_killed=False, complaint=""))
    assert list(plugin.column_doubts(measured)) == told


def test_times_that_perf_counts_in_nanoseconds_are_in_seconds():
    duration, user = PerfStat(events=["duration_time", "user_time"]).columns
    assert (duration.measure.unit, duration.factor, user.measure.unit, user.factor) == ("s", 1e-9, "s", 1e-9)


def test_recorded_rows_are_read():
    rows = [row for row in parse_perf(RECORDED.splitlines()) if row]
    assert [row.get("task-clock") for row in rows] == ["400.71", None, None, None]
    assert rows[2] == {"span": "0.200243912", "cycles": None, "cycles counted": None}


def test_a_decimal_comma_is_read_as_a_point(tmp_path):
    # What perf 6.1 writes in the locale de_DE.UTF-8.
    recorded = RECORDED.replace("400.71", "400,71").replace("100.00", "100,00").replace("50.00", "50,00")
    plugin = PerfStat(events=["task-clock", "cache-misses"], interval_ms=100, program=stand_in(tmp_path, recorded))
    plugin.period_s = 6.0  # a machine that is busy for seconds costs no value
    context = make_context(tmp_path, plugin, robot=None, clock=SystemClock())
    rehearse(context, plugin, mission=lambda: wait_for_rows(context))
    problems = [finding.problem for finding in context.broker.findings]
    assert context.measures["TaskClock"] is not None
    assert "'cache-misses' was counted in 50 % of the time only, and scaled up by perf" in problems


def test_a_comma_in_the_name_of_an_event_stays():
    (row,) = parse_perf(["     0.2;7;;cpu/event=0x3c,umask=0x0/;200;100,00;;"])
    assert row["cpu/event=0x3c,umask=0x0/"] == "7"


def test_a_process_that_sleeps_has_counted_nothing():
    # What perf 6.1 wrote of a process that slept (`--pid`).
    (row,) = parse_perf(["     0.200336515;<not counted>;msec;task-clock;0;100.00;;"])
    assert row == {"span": "0.200336515", "task-clock": "0", "task-clock counted": "100.00"}


@pytest.mark.parametrize("event", ["user_time", "system_time:u"])
def test_a_time_that_perf_knows_of_its_own_child_only_is_unknown_and_not_zero(event):
    # What perf 6.1 wrote (`--pid`, and `--all-cpus`) while processes kept all cores busy.
    (row,) = parse_perf([f"     0.200335777;<not counted>;ns;{event};0;100.00;;"])
    assert row[event] is None


@pytest.mark.parametrize(
    "counts",
    [
        (203_227_996, 200_331_791),
        (812_911_984, 801_327_164),  # what perf 6.1 wrote of a process (`--pid`) with four threads
        (0, 0),  # what perf 7.2 writes beside other events
    ],
)
def test_how_long_an_interval_took_is_told_by_its_ends_whatever_perf_counts(counts):
    spans = ("0.203227996", "0.403559787")
    events = ("task-clock;7;100.00;;", "duration_time;1;100.00;;")
    records = [f"     {span};{count};;{event}" for span, count in zip(spans, counts, strict=True) for event in events]
    told = [row["duration_time"] for row in parse_perf(records) if row and "duration_time" in row]
    assert [float(each) for each in told] == pytest.approx([203_227_996, 200_331_791])


def test_an_event_that_had_no_counter_in_an_interval_is_unknown_there_and_doubted():
    plugin = PerfStat(events=["cycles"])
    rows = parse_perf(["  0.2;500;;cycles;200;100.00;;", "  0.4;<not counted>;;cycles;0;0.00;;"])
    window = Window(0.0, 1.0)
    measured = Measured(rows, [0.2, 0.4], window, window, Ending(0, was_asked=True, was_killed=False, complaint=""))
    assert rows[1]["cycles"] is None
    assert any(
        "'cycles' was counted in 0 % of the time only" in problem for _, problem in plugin.column_doubts(measured)
    )


# After tools/perf/Documentation/intel-hybrid.txt: one event of a processor with two kinds of cores is counted for each.
HYBRID = """\
# started on Sat Nov 21 03:01:29 2026

     0.200243912;400.71;msec;task-clock;400705362;100.00;2.004;CPUs utilized
     0.200243912;6744979;;cpu_core/cycles/;400704330;100.00;;
     0.200243912;1965552;;cpu_atom/cycles/;400704330;100.00;;
"""


def test_an_event_of_a_processor_with_two_kinds_of_cores_is_that_of_both(tmp_path):
    plugin = PerfStat(events=["task-clock", "cycles"], interval_ms=100, program=stand_in(tmp_path, HYBRID))
    plugin.period_s = 6.0  # a machine that is busy for seconds costs no value
    assert [each for each in plugin.check(Circumstances()) if "only root" not in each.problem] == []
    context = make_context(tmp_path, plugin, robot=None, clock=SystemClock())
    rehearse(context, plugin, mission=lambda: wait_for_rows(context))
    ratio = context.measures["Cycles"] / context.measures["TaskClock"]
    assert ratio == pytest.approx((6_744_979 + 1_965_552) / 0.40071)
    assert [finding.problem for finding in context.broker.findings if "cycles" in finding.problem] == []


LINES_OF_KINDS = [
    "0.2;500;;cpu_core/cycles/;200;40.00;;",
    "0.2;700;;cpu_atom/cycles/;200;60.00;;",
    "0.2;9;;cpu_core/instructions/;200;100.00;;",
]


@pytest.mark.parametrize(("is_of_process", "cycles", "counted"), [(False, 1200.0, "40.00"), (True, 620.0, "100.00")])
def test_a_process_is_on_one_kind_of_cores_at_a_time_and_the_machine_on_both(is_of_process, cycles, counted):
    # perf scales both counts of a process up, by the time that it was on the other kind of cores.
    events = ["cycles", "cpu_core/instructions/"]
    rows = parse_perf(LINES_OF_KINDS, events=events, is_of_process=is_of_process)
    assert rows[0] is None
    assert rows[1] == {"span": "0.2", "cycles": pytest.approx(cycles), "cycles counted": counted}
    assert rows[2]["cpu_core/instructions/"] == "9"


def test_a_process_may_be_on_any_of_three_kinds_of_cores():
    counts = (("0", "20.00"), ("0", "30.00"), ("600", "50.00"))
    lines = [f"0.2;{count};;{kind}/cycles/;0;{share};;" for kind, (count, share) in zip("abc", counts, strict=True)]
    row = parse_perf(lines, events=["cycles"], is_of_process=True)[-1]
    assert row == {"span": "0.2", "cycles": pytest.approx(300.0), "cycles counted": "100.00"}


@pytest.mark.parametrize(("other", "share"), [("<not supported>", "100.00"), ("<not counted>", "0.00")])
def test_what_one_kind_of_cores_does_not_count_is_unknown_of_the_machine(other, share):
    lines = [LINES_OF_KINDS[0], f"0.2;{other};;cpu_atom/cycles/;0;{share};;"]
    assert parse_perf(lines, events=["cycles"])[1]["cycles"] is None
    row = parse_perf(lines, events=["cycles"], is_of_process=True)[1]
    assert row == {"span": "0.2", "cycles": 500.0, "cycles counted": "40.00"}


def test_an_interval_in_which_no_kind_of_cores_was_counted_is_doubted():
    plugin = PerfStat(events=["cycles"], pid=4711)
    lines = [f"0.4;<not counted>;;{kind}/cycles/;0;0.00;;" for kind in ("cpu_core", "cpu_atom")]
    rows = parse_perf([*LINES_OF_KINDS[:2], *lines], events=["cycles"], is_of_process=True)
    told, window = [row for row in rows if row], Window(0.0, 1.0)
    measured = Measured(told, [0.2, 0.4], window, window, Ending(0, was_asked=True, was_killed=False, complaint=""))
    assert told[1]["cycles"] is None
    assert any("'cycles' was counted in 0 % of the time" in problem for _, problem in plugin.column_doubts(measured))


def test_what_a_user_may_count_in_user_space_only_is_told_of_two_kinds_of_cores_as_well(tmp_path):
    recorded = HYBRID.replace("/cycles/", "/cycles/u")
    plugin = PerfStat(events=["task-clock", "cycles"], pid=os.getpid(), program=stand_in(tmp_path, recorded))
    (finding,) = plugin.check(Circumstances())
    assert finding.problem == "'cycles' may be counted in user space only, without the kernel: no value"


def test_measures_are_named_after_events():
    plugin = PerfStat(events=["L1-dcache-loads", "power/energy-pkg/", "instructions:u", "cpu-clock"])
    assert [(measure.name, measure.unit) for measure in plugin.measures] == [
        ("L1DcacheLoads", "1"),
        ("EnergyPkg", "J"),
        ("InstructionsU", "1"),
        ("CpuClock", "s"),
    ]


def test_a_machine_without_perf_is_told_how_to_get_it():
    (finding,) = PerfStat(program="no-such-perf").check(Circumstances())
    assert "apt install linux-perf" in finding.fix


def test_a_kernel_that_lets_only_root_count_is_told_with_the_command_that_mends_it(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    paranoia = write(tmp_path / "perf_event_paranoid", 2)
    (finding,) = PerfStat(program="sh", paranoia=paranoia).check(Circumstances())
    assert finding.problem == "kernel.perf_event_paranoid is 2: only root may count on all processors"
    assert "sysctl kernel.perf_event_paranoid=0" in finding.fix


def test_what_the_machine_cannot_count_is_a_warning_of_the_check(tmp_path):
    plugin = PerfStat(events=["task-clock", "cycles"], pid=os.getpid(), program=stand_in(tmp_path))
    findings = [finding for finding in plugin.check(Circumstances()) if "cycles" in finding.problem]
    assert [finding.is_error for finding in findings] == [False]


def test_what_the_kernel_lets_a_user_count_in_user_space_only_is_a_warning_of_the_check(tmp_path):
    # What perf 6.1 wrote for a user with kernel.perf_event_paranoid at 2: it had put `:u` behind each event by itself.
    recorded = RECORDED.replace("task-clock", "task-clock:u")
    plugin = PerfStat(events=["task-clock", "cache-misses"], pid=os.getpid(), program=stand_in(tmp_path, recorded))
    (finding,) = [each for each in plugin.check(Circumstances()) if "user space" in each.problem]
    assert "'task-clock'" in finding.problem
    assert not finding.is_error
    assert "sysctl kernel.perf_event_paranoid=1" in finding.fix
    assert "'task-clock:u'" in finding.fix


@pytest.mark.parametrize("settings", [{"events": "cycles"}, {"interval_ms": 0}, {"events": []}])
def test_what_cannot_be_is_refused(settings):
    with pytest.raises(PluginError):
        PerfStat(**settings)
