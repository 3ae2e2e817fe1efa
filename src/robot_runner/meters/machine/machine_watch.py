"""The profiler that watches measured computers for disturbances that make their measures doubtful."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Collection, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import ClassVar

from robot_runner.core.errors import LinkError
from robot_runner.core.events.context import RobotRunnerContext, SystemClock
from robot_runner.core.links.declared_host import LOCAL
from robot_runner.core.plugin import Plugin, Profiler
from robot_runner.measuring.devices import connect_host
from robot_runner.measuring.host import FileHost, RemoteHost
from robot_runner.measuring.measured_machine import Computer, concerned
from robot_runner.measuring.parameter_checks import check_list, check_numbers
from robot_runner.measuring.periodic import PeriodicSampler
from robot_runner.meters.machine.machine_doubts import MachineReport, Thresholds
from robot_runner.meters.machine.machine_state import MachineFiles, MachineState, SystemFiles
from robot_runner.meters.machine.others_load import Load, load_between
from robot_runner.meters.machine.processor_state import Conditions

_USUAL = Thresholds()
#: The period of reading frequency and temperature of this machine, s: heat takes longer than that to build up, and a
#: reading of sixteen cores takes about a millisecond, 0.02 % of a core.
_PERIOD = 5.0
#: The same of a Raspberry Pi, whose kernel takes the firmware's flags back after two seconds, s.
_PERIOD_OF_FLAGS = 1.0
_FIX = "End what else runs there, or keep it off the cores of the experiment (Tune), and repeat the run."


class MachineWatch(Profiler):
    """Watches measured computers, and doubts their measures if other processes, heat or throttling disturbed them.

    It is added automatically if a profiler measures a computer (`watch_machines = False` turns it off); list it to
    watch further computers or to set other thresholds. It reads /proc and /sys twice, before all other profilers begin
    and after they have ended, and every five seconds (on a Raspberry Pi each second) the frequency and temperature of
    this machine.

    Args:
        name: distinguishes several instances; None for the class's name.
        hosts: computers to watch besides those that profilers measure: `localhost`, or as ssh takes them.
        load: the CPU time of others from which on it is reported, percent of one core.
        root: the folder with this machine's `proc` and `sys`.

    Example:
        >>> MachineWatch(hosts=["localhost"], load=25.0).name
        'MachineWatch'
    """

    needs: ClassVar[str] = "Linux's /proc and /sys; if a file is missing, its information is left out."
    bytes_per_run: int = 1_500  # one file of facts for each computer

    def __init__(
        self,
        *,
        name: str | None = None,
        hosts: Sequence[str] = (LOCAL,),
        load: float = _USUAL.load,
        root: str | Path = "/",
    ) -> None:
        super().__init__(name=name)
        check_list(self.name, hosts=hosts)
        check_numbers(self.name, load=load)
        self.hosts = tuple(hosts)
        self.thresholds = Thresholds(load=load)
        self.root = Path(root)
        self._orchestrator = os.getpid()  # a run that is forked inherits it
        self._measuring: tuple[Plugin, ...] = ()
        self._watched: list[_WatchedComputer] = []

    def attach(self, plugins: Iterable[Plugin]) -> None:
        """Note the plugins that may measure a computer; which computer it is, is known in each run."""
        self._measuring = tuple(plugins)

    def claims(self, robot: str | None) -> Iterable[str]:
        """Return no claims, as watching disturbs nothing."""
        del robot
        return ()

    def start_run(self, context: RobotRunnerContext) -> None:
        """Find the files of each computer, so that reading them takes little time."""
        self._watched = []
        for computer in self._computers():
            try:
                self._watched.append(self._found(context, computer))
            except LinkError as error:
                context.warn(f"{computer.host} cannot be watched: {error.problem}", fix=error.fix)

    def start_measurement(self, context: RobotRunnerContext) -> None:
        """Read the first state, before other profilers begin."""
        del context
        for watched in self._watched:
            watched.begin()

    def stop_measurement(self, context: RobotRunnerContext) -> None:
        """Read the last state of this machine, now that other profilers have ended."""
        del context
        for watched in self._watched:
            if watched.is_here:
                watched.end()

    def stop_run(self, context: RobotRunnerContext) -> None:
        """Read the last state of computers over ssh: their sessions are free once all samples were fetched."""
        for watched in self._watched:
            watched.end(_started_there(context, watched.computer.host))
        reports = self._reports(context.run_id)
        for host, report in reports:
            path = context.raw_data_folder / f"{re.sub(r'[^A-Za-z0-9.-]+', '_', host)}.json"
            path.write_text(json.dumps(report.facts(), indent=2, allow_nan=False) + "\n", encoding="utf-8")

    def populate_run_data(self, context: RobotRunnerContext) -> None:
        """Doubt the measures of each computer with a disturbance."""
        for watched in self._watched:
            for problem in watched.complaints:
                context.warn(f"{watched.computer.host} could not be watched: {problem}")
        for host, report in self._reports(context.run_id):
            problems = report.problems()
            owners = [name for name, computer in concerned(self._measuring) if computer.host == host]
            if problems and owners:
                for owner in owners:
                    context.broker.doubt(owner, "; ".join(problems), _FIX, ())
            elif problems:
                context.warn("; ".join(problems), fix=_FIX)

    def _computers(self) -> list[Computer]:
        """Return each computer once, with the connection of the first profiler that measures it."""
        named = [Computer(host) for host in self.hosts]
        by_host: dict[str, Computer] = {}
        for computer in (*(each for _, each in concerned(self._measuring)), *named):
            known = by_host.get(computer.host, computer)
            by_host[computer.host] = replace(known, subjects=(*known.subjects, *computer.subjects))
        return list(by_host.values())

    def _found(self, context: RobotRunnerContext, computer: Computer) -> _WatchedComputer:
        if computer.host == LOCAL:
            return _WatchedComputer(computer, MachineFiles(SystemFiles(self.root)), self._orchestrator)
        link = connect_host(context, computer.host, ssh_config=computer.ssh_config, form=computer.form)
        if isinstance(link, RemoteHost):
            link.connect()
        if not isinstance(link, FileHost):
            raise LinkError("the computer's files cannot be read", where=computer.host, fix="Watch another computer.")
        return _WatchedComputer(computer, MachineFiles(link), None)

    def _reports(self, run_id: str) -> list[tuple[str, MachineReport]]:
        reports = [(each.computer.host, each.report(run_id, self.thresholds)) for each in self._watched]
        return [(host, report) for host, report in reports if report is not None]


class _WatchedComputer:
    """One computer during one run.

    Attributes:
        computer: with its connection.
        complaints: the reasons why a state could not be read.
    """

    def __init__(self, computer: Computer, files: MachineFiles, orchestrator: int | None) -> None:
        self.computer = computer
        self.complaints: list[str] = []
        self._files = files
        self._orchestrator = orchestrator
        self._before: MachineState | None = None
        self._after: MachineState | None = None
        self._load: Load | None = None
        self._started: tuple[int, ...] = ()
        self._poller: PeriodicSampler[Conditions] | None = None

    @property
    def is_here(self) -> bool:
        return self._orchestrator is not None

    def begin(self) -> None:
        self._before, self._after = self._look(), None
        if self.is_here and self._files.processor.changing:
            period = _PERIOD_OF_FLAGS if self._files.processor.has_firmware else _PERIOD
            self._poller = PeriodicSampler(self._files.conditions, rate=1 / period, clock=SystemClock())
            self._poller.start()

    def end(self, started: Collection[int] = ()) -> None:
        """Read the last state; a second call does nothing.

        Args:
            started: software under test that the experiment has started on another computer, by process id.
        """
        self._started = tuple(started)
        if self._before is None or self._after is not None:
            return
        self._after = self._look()
        if self._after is None:
            self._before = None
            return
        try:
            self._load = load_between(
                self._before,
                self._after,
                is_ours=self._own,
                command_lines=self._files.command_lines,
                subjects=self.computer.subjects,
            )
        except LinkError as error:
            self.complaints.append(error.problem)

    def report(self, run_id: str, thresholds: Thresholds) -> MachineReport | None:
        """Return the report; None if a state is missing."""
        if self._before is None or self._after is None or self._load is None:
            return None
        polled = self._poller.stop().readings if self._poller else ()
        looks = (self._before.conditions, *polled, self._after.conditions)
        host = "" if self.is_here else self.computer.host
        return MachineReport(host, run_id, self._before, self._after, self._load, looks, thresholds)

    def _look(self) -> MachineState | None:
        try:
            return self._files.state()
        except LinkError as error:
            self.complaints.append(error.problem)
            return None

    def _own(self, state: MachineState) -> set[int]:
        """Return the experiment's processes: the orchestrator, the keeper, the run, and all that they started."""
        if self._orchestrator is None:
            found = _descendants(state, state.reader)
            for pid in self._started:  # with orphans, which their supervisor adopted
                process = state.processes.get(pid)
                found |= _descendants(state, process.parent if process else None)
            return found
        above = state.processes.get(os.getppid())  # in a fresh interpreter the orchestrator's pid is unknown
        return _descendants(state, self._orchestrator) | {os.getpid(), os.getppid(), above.parent if above else 0}


def _started_there(context: RobotRunnerContext, host: str) -> list[int]:
    """Return the pids of software that plugins have started on a computer: they share `host` and `pid`."""
    told = [shared for shared in context.plugin_data.values() if shared.get("host") == host]
    return [pid for shared in told if isinstance(pid := shared.get("pid"), int)]


def _descendants(state: MachineState, ancestor: int | None) -> set[int]:
    children: dict[int, list[int]] = {}
    for process in state.processes.values():
        children.setdefault(process.parent, []).append(process.pid)
    found: set[int] = set()
    left = [] if ancestor is None else [ancestor]
    while left:
        pid = left.pop()
        found.add(pid)
        left += [child for child in children.get(pid, ()) if child not in found]
    return found
