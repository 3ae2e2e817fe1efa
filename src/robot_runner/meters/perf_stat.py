"""The profiler of events of the processor and the kernel, with Linux' perf."""

from __future__ import annotations

import os
import re
import signal
import subprocess
from collections.abc import Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import ClassVar

from robot_runner.core.errors import Finding
from robot_runner.core.events.measure import Measure
from robot_runner.core.plugin import Circumstances
from robot_runner.measuring.measured_machine import THIS_MACHINE, simulation_findings
from robot_runner.measuring.parameter_checks import check_list, check_numbers
from robot_runner.meters.command import CommandProfiler, Measured
from robot_runner.meters.command_output import Aggregate, CommandColumn, Row, TimeColumn, TimeKind
from robot_runner.meters.machine.machine_state import text_in
from robot_runner.meters.rapl import is_amd

_INSTALL = "Install it: sudo apt install linux-perf (Debian), linux-tools-generic (Ubuntu)."
_DEFAULT_EVENTS = ("task-clock", "context-switches", "page-faults", "instructions", "cycles", "cache-misses")
#: An event that was counted for less than this percentage of the time is doubted; perf extrapolates the rest.
_FULL_TIME, _ALL_TIME = 90.0, 100.0
#: The units of perf's times (tools/perf/util: the clocks in ms, its own three in ns).
_OF_SECOND = MappingProxyType(
    {"task-clock": 1e-3, "cpu-clock": 1e-3, "duration_time": 1e-9, "user_time": 1e-9, "system_time": 1e-9}
)
#: On all processors these count idle time, too: the result is the window times the number of processors.
_CLOCKS = ("task-clock", "cpu-clock")
#: The energy of all packages, and no other energy.
_PACKAGES = "power/energy-pkg"
_SEPARATOR = ";"  # events may have commas in their names
_COUNTED = " counted"
_NOT_SUPPORTED, _NOT_COUNTED = "<not supported>", "<not counted>"
#: perf takes these from the resource usage of its ended child: in intervals they are unknown, and perf writes
#: `<not counted>` with 100 % however busy the machine is (perf 6.1; later versions read them from /proc).
_OF_ITS_CHILD = ("user_time", "system_time")
#: perf 6.1 counts it once for each thread of a process, and 7.2 not at all together with other events.
_DURATION = "duration_time"
_TRIAL_SECONDS = 10.0
#: The highest /proc/sys/kernel/perf_event_paranoid with which a user may count on all processors (man perf_event_open).
_MOST_PARANOID = 0


#: An event of a processor with several kinds of cores, such as `cpu_core/cycles/u` for `cycles:u`: perf counts it for
#: each kind by itself (tools/perf/Documentation/intel-hybrid.txt).
_OF_A_KIND = re.compile(r"[^/]+/([^/]+)/(\w*)")


def parse_perf(records: Sequence[str], *, events: Sequence[str] = (), is_of_process: bool = False) -> list[Row | None]:
    """Return one row for each event and interval of `perf stat -I ... -x ;`.

    perf writes `<not counted>` in two cases (tools/perf/util/stat-display.c): with 100 %, the process did not execute
    in the interval, so the count is 0; with less, other events had the counters, so the count is unknown. It is also
    unknown for user_time and system_time, which perf does not count in intervals.

    Args:
        records: lines of its output.
        events: that were asked for: one that is counted for several kinds of cores has one row, by this name.
        is_of_process: whether perf counted for a process, not on all processors.

    Example:
        >>> parse_perf(["     1.000116;2003.19;msec;task-clock;2003192961;100.00;2.000;CPUs utilized"])
        [{'span': '1.000116', 'task-clock': '2003.19', 'task-clock counted': '100.00'}]
        >>> parse_perf(["     1.000116;<not supported>;;cycles;0;100.00;;"])
        [{'span': '1.000116', 'cycles': None, 'cycles counted': None}]
    """
    rows: list[Row | None] = []
    last: dict[str, int] = {}  # the place of each event's last row
    before = now = 0.0
    for place, record in enumerate(records):
        row = _row(record.split(_SEPARATOR))
        rows.append(row)
        if row is None:
            continue
        if (span := float(row["span"] or 0)) != now:
            before, now = now, span
        event = _asked_name(next(name for name in row if name != "span"), events)
        row = {name: row[each] for name, each in zip(("span", event, event + _COUNTED), row, strict=True)}
        sooner = rows[last[event]] if event in last else None
        if sooner is not None and sooner["span"] == row["span"]:
            row = _added(sooner, row, event, is_of_process=is_of_process)
            rows[last[event]] = None
        rows[place] = {**row, **_timed(row, now - before)}
        last[event] = place
    return rows


def _asked_name(event: str, events: Sequence[str]) -> str:
    """Return the name by which an event was asked for, where it is that of one kind of cores."""
    match = None if event in events else _OF_A_KIND.fullmatch(event)
    whole = ":".join(filter(None, match.groups())) if match else event
    return whole if whole in events else event


def _added(row: Row, other: Row, event: str, *, is_of_process: bool) -> Row:
    """Return the counts of two kinds of cores as one.

    A process is on one of them at a time, and perf scales each count up to all the time: that is undone.
    """
    counts, shares = ([each[name] for each in (row, other)] for name in (event, event + _COUNTED))
    if is_of_process:
        pairs = zip(counts, shares, strict=True)
        told = [(float(count), float(share or 0)) for count, share in pairs if count is not None]
        counted = sum(share for _, share in told)
        total = sum(count * share for count, share in told) / counted if counted else None
        return {"span": row["span"], event: total, event + _COUNTED: f"{counted:.2f}"}
    if None in counts:
        return {"span": row["span"], event: None, event + _COUNTED: None if None in shares else "0.00"}
    least = min(float(share or 0) for share in shares)
    return {"span": row["span"], event: sum(float(count or 0) for count in counts), event + _COUNTED: f"{least:.2f}"}


def _timed(row: Row, seconds: float) -> Row:
    """Return a row's duration from the interval's ends, if it has one: perf's own count of it may be wrong."""
    told = [name for name in row if name.startswith(_DURATION) and not name.endswith(_COUNTED)]
    return dict.fromkeys(told, f"{seconds / _OF_SECOND[_DURATION]:.0f}")


def _row(cells: Sequence[str]) -> Row | None:
    if len(cells) < 6 or cells[0].lstrip().startswith("#"):  # noqa: PLR2004 - time, count, unit, event, run time, share
        return None
    time, count, _, event, _, share = (cell.strip() for cell in cells[:6])
    count, share = count.replace(",", "."), share.replace(",", ".")  # perf writes the decimal sign of the language
    if count == _NOT_SUPPORTED:
        return {"span": time, event: None, event + _COUNTED: None}
    if count == _NOT_COUNTED:
        is_nothing = float(share or 0) >= _ALL_TIME and not event.startswith(_OF_ITS_CHILD)
        return {"span": time, event: "0" if is_nothing else None, event + _COUNTED: share}
    return {"span": time, event: count, event + _COUNTED: share}


class PerfStat(CommandProfiler):
    """Counts events of processor and kernel with `perf stat`: on the whole machine, or of one process.

    Args:
        name: distinguishes several instances; None for the class's name.
        events: names from `perf list`, such as `instructions` or `power/energy-pkg/`.
        pid: the process to count for; None for all processors.
        interval_ms: time between two readings, ms.
        program: the program, if it is not on the PATH.
        paranoia: the file with the kernel's limit on what users may count.
        sysfs: the folder of sysfs.
        cpuinfo: the file with the processor's vendor.

    Raises:
        PluginError: there are no events, two yield one measure, or the interval is not positive.

    Example:
        >>> [(each.name, each.unit) for each in PerfStat(events=["cache-misses", "task-clock"]).measures]
        [('CacheMisses', '1'), ('TaskClock', 's')]
    """

    measures: Sequence[Measure] = ()
    measured_computer = THIS_MACHINE
    needs: ClassVar[str] = "Linux' perf, and the right to count (kernel.perf_event_paranoid)."

    def __init__(
        self,
        *,
        name: str | None = None,
        events: Sequence[str] = _DEFAULT_EVENTS,
        pid: int | None = None,
        interval_ms: int = 200,
        program: str = "perf",
        paranoia: Path = Path("/proc/sys/kernel/perf_event_paranoid"),
        sysfs: Path = Path("/sys"),
        cpuinfo: Path = Path("/proc/cpuinfo"),
    ) -> None:
        check_numbers(name or "PerfStat", interval_ms=interval_ms)
        check_list(name or "PerfStat", events=events)
        self.events = tuple(events)
        self.pid = pid
        self.paranoia = paranoia
        self.sysfs = sysfs
        self.cpuinfo = cpuinfo
        scope = ["--all-cpus"] if pid is None else ["--pid", str(pid)]
        counting = [program, "stat", "-x", _SEPARATOR, "-e", ",".join(self.events)]
        self._trial = [*counting, *(scope if pid is None else ()), "--", "true"]
        super().__init__(
            name=name,
            command=[*counting, "-I", str(interval_ms), *scope, "--output", "{output}"],
            output="perf.csv",
            columns=[
                CommandColumn(event, _measure_of(event, pid), Aggregate.SUM, _seconds(event) or 1.0)
                for event in self.events
            ],
            parse=partial(parse_perf, events=self.events, is_of_process=pid is not None),
            time=TimeColumn("span", TimeKind.SINCE_START),
            period_s=interval_ms / 1000,
            stop_signal=signal.SIGINT,
            install=_INSTALL,
        )
        # For each event a line of 70 bytes 5 times a second for a mission of 95 s, and the samples.
        self.bytes_per_run = 60_000 * len(self.events)

    def check(self, circumstances: Circumstances) -> Iterable[Finding]:
        """Return errors: no perf, no right to count, no such event; and warnings of events that this machine lacks."""
        findings = list(super().check(circumstances))
        if not findings:
            findings = self._refused_scope() or self._refused_events()
        return [*findings, *simulation_findings(self.name, circumstances.robot)]

    def column_doubts(self, measured: Measured) -> Iterator[tuple[str, str]]:
        """Yield doubts about events that were not counted, or only for a part of the time."""
        yield from super().column_doubts(measured)
        for event in self.events:
            name = _measure_of(event).name
            told = [row[event] for row in measured.rows if event in row]
            shares = [float(share) for row in measured.rows if (share := row.get(event + _COUNTED))]
            if told and not shares:
                yield name, f"this machine cannot count {event!r}"
            elif shares and min(shares) < _FULL_TIME:
                yield name, f"{event!r} was counted in {min(shares):.0f} % of the time only, and scaled up by perf"
            if event.startswith(_PACKAGES) and (dies := self._dies_alike()):
                yield name, f"perf adds up the energy of {dies} dies, and each reports that of its whole package"

    def _dies_alike(self) -> int:
        """Return on how many dies the kernel reads the counters of fewer AMD packages, as Linux before 6.12; else 0."""
        mask = text_in(self.sysfs / "bus/event_source/devices/power/cpumask")  # such as `0,8-9`
        ranges = [list(map(int, each.split("-"))) for each in mask.split(",") if each]
        dies = sum(each[-1] - each[0] + 1 for each in ranges)
        files = (self.sysfs / "devices/system/cpu").glob("cpu[0-9]*/topology/physical_package_id")
        return dies if is_amd(self.cpuinfo) and dies > len(set(map(text_in, files))) else 0

    def _refused_scope(self) -> list[Finding]:
        if self.pid is not None or os.geteuid() == 0 or not self.paranoia.exists():
            return []
        level = int(self.paranoia.read_text(encoding="ascii"))
        if level <= _MOST_PARANOID:
            return []
        problem = f"kernel.perf_event_paranoid is {level}: only root may count on all processors"
        fix = f"Allow it: sudo sysctl kernel.perf_event_paranoid={_MOST_PARANOID}. Or give a pid of your own."
        return [Finding.error(f"plugin {self.name}", problem, fix)]

    def _refused_events(self) -> list[Finding]:
        """Count for a moment, and return findings on the events that perf does not support."""
        where = f"plugin {self.name}"
        try:
            trial = subprocess.run(  # noqa: S603 - the user's own program
                self._trial,
                capture_output=True,
                text=True,
                timeout=_TRIAL_SECONDS,
                check=False,
                stdin=subprocess.DEVNULL,
            )
        except (OSError, subprocess.TimeoutExpired) as error:
            return [
                Finding.error(where, f"perf cannot be tried: {error}", "Execute it by hand: " + " ".join(self._trial))
            ]
        if trial.returncode:
            said = " ".join(trial.stderr.split())[:200]
            return [Finding.error(where, f"perf refuses: {said}", "Choose events that `perf list` names.")]
        # If perf may count user space only, it appends `:u` to an event by itself, and so writes another name.
        in_user_space = {f"{event}:u": event for event in self.events}
        lines = [f"0;{line}" for line in trial.stderr.splitlines()]  # without intervals, perf writes no times
        told = {
            name: cell
            for row in parse_perf(lines, events=[*self.events, *in_user_space])
            if row
            for name, cell in row.items()
        }
        refused = [event for event in self.events if told.get(event + _COUNTED, "") is None]
        problem = "this machine cannot count"
        partly = [event for name, event in in_user_space.items() if name in told and event not in refused]
        in_part = "may be counted in user space only, without the kernel: no value"
        fix = "Allow it: sudo sysctl kernel.perf_event_paranoid=1. Or ask for that: {!r}."
        return [
            *(Finding.warning(where, f"{problem} {event!r}: no value", "Leave it out.") for event in refused),
            *(Finding.warning(where, f"{event!r} {in_part}", fix.format(f"{event}:u")) for event in partly),
        ]


def _measure_of(event: str, pid: int | None = None) -> Measure:
    words = [word for word in re.split(r"[^A-Za-z0-9]+", event.removeprefix("power/")) if word]
    name = "".join(word[:1].upper() + word[1:] for word in words)
    unit = "s" if _seconds(event) else "J" if event.startswith("power/energy") else "1"
    idle = ": all processors together, idle ones too" if pid is None and event in _CLOCKS else ""
    return Measure(name, unit, f"{event} over the measured window, by perf{idle}.")


def _seconds(event: str) -> float | None:
    """Return perf's unit for an event as a share of a second; None if the event is not a time."""
    return _OF_SECOND.get(event.partition(":")[0])
