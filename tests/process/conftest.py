"""Real processes and real signals: an experiment is started as a user starts it, and something happens to it."""

from __future__ import annotations

import csv
import json
import os
import signal
import subprocess
import sys
import time
import uuid
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from tests.forked_program import MARK, RUNS, ForkedProgram
from tests.ros.real_graph import graph

from robot_runner.core.storage.outliving import ancestors, has_in_environment, process_stat, processes

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from tests.processor_wait import ProcessorWait

__all__ = ["graph"]

STREAMS = (subprocess.DEVNULL, subprocess.PIPE, subprocess.STDOUT)
#: How long something may take before a test gives up, s. It promises nothing: a busy machine may need most of it.
PATIENCE = 60.0


@dataclass
class Experiment:
    """An experiment in a process of its own."""

    config: Path
    process: subprocess.Popen[str]
    mark: str
    output: str = field(default="")
    others: frozenset[int] = frozenset()  # processes that were there before it began: none of its own is among them

    @property
    def folder(self) -> Path:
        return self.config.parent / "results" / "trial"

    @property
    def table(self) -> list[dict[str, str]]:
        with (self.folder / "run_table.csv").open(encoding="utf-8", newline="") as file:
            return list(csv.DictReader(file))

    @property
    def statuses(self) -> list[str]:
        return [row["status"] for row in self.table]

    def wait_for(self, name: str, *, meanwhile: Callable[[], object] = lambda: None) -> Path:
        """Wait until a callback has written the file `name` beside the config."""
        path = self.config.parent / name
        return wait_until(lambda: meanwhile() or (path.exists() and path), f"{name} is written")

    def text_of(self, name: str, *, meanwhile: Callable[[], object] = lambda: None) -> str:
        """Return what a file has once it has anything: who writes it creates it a moment before."""
        path = self.wait_for(name, meanwhile=meanwhile)
        wait_until(path.read_text, f"{name} has been written")
        return path.read_text()

    def stops_within_a_second(self, since: float, wait: ProcessorWait, name: str = "stopped") -> bool:
        """Whether the run wrote into the file `name` that it stopped a second at most after `since`.

        The time in which its processes waited for a processor does not count; `wait` was made before `since`. The file
        holds when the run stopped (s since the epoch), and how long its threads had waited by then.
        """
        stopped, waits = json.loads(self.text_of(name, meanwhile=wait.look))
        wait.add(waits)
        return stopped - since - wait.seconds < 1.0

    def send(self, number: signal.Signals) -> float:
        """Send a signal to the orchestrator alone; returns when it was sent."""
        os.kill(self.process.pid, number)
        return time.time()

    def end(self) -> int:
        """Wait for the end and return the exit code."""
        self.output, _ = self.process.communicate(timeout=PATIENCE)
        return self.process.returncode

    def processes(self) -> list[int]:
        """Return the processes that the experiment started, its own included, that still live."""
        mark = f"{MARK}={self.mark}".encode()
        # Those that were there before are not looked at again: tests ask a hundred times a second.
        return [pid for pid in processes() if pid not in self.others and has_in_environment(pid, mark)]

    def keeper(self) -> int:
        """Return the process that keeps the run which is being executed, once one is."""
        return next(iter(wait_until(lambda: self._children_of(self.process.pid), "a run is executed")))

    def run_process(self) -> int:
        """Return the process of the run: of its keeper's children the one that leads a group of its own."""
        return next(iter(wait_until(self._leaders, "the run has a group of its own")))

    def standby(self) -> int:
        """Return the process that stands by to make the robot safe: the keeper's other child."""
        return next(iter(wait_until(self._followers, "somebody stands by")))

    def _leaders(self) -> list[int]:
        return [pid for pid in self._children_of(self.keeper()) if process_stat(pid)[2:3] == [str(pid)]]

    def _followers(self) -> list[int]:
        self.run_process()  # before it has a group of its own, it looks like one of these
        keeper = self.keeper()
        return [pid for pid in self._children_of(keeper) if process_stat(pid)[2:3] == [str(keeper)]]

    def _children_of(self, parent: int) -> list[int]:
        return [pid for pid in self.processes() if process_stat(pid)[1:2] == [str(parent)]]

    def kill(self) -> bool:
        """Kill all of them, and return whether one lived."""
        found = self.processes()
        for pid in found:
            with suppress(ProcessLookupError):  # it has ended since
                os.kill(pid, signal.SIGKILL)
        return bool(found)

    def nobody_is_left(self) -> bool:
        """Wait until none of them lives."""
        return bool(wait_until(lambda: not self.processes(), "no process is left"))


def named(experiment: Experiment, part: bytes) -> list[int]:
    """Return the processes of an experiment on whose command line something stands."""
    return [pid for pid in experiment.processes() if part in command_line(pid)]


def command_line(pid: int) -> bytes:
    """Return it as /proc shows it; empty where the process has ended since it was looked for."""
    with suppress(OSError):
        return Path(f"/proc/{pid}/cmdline").read_bytes()
    return b""


def kill_together(pids: Iterable[int]) -> None:
    """Kill processes so that none of them has the time to do anything about the death of another.

    One that has ended since it was looked for needs no signal.

    Children come first: where a parent dies, Linux continues stopped processes of a group that is orphaned by that.
    """
    doomed = sorted(pids, key=lambda pid: len(list(ancestors(pid))), reverse=True)
    for number in (signal.SIGSTOP, signal.SIGKILL):
        for pid in doomed:
            with suppress(ProcessLookupError):
                os.kill(pid, number)


def wait_until(holds: Callable[[], Any], what: str) -> Any:
    deadline = time.monotonic() + PATIENCE
    while time.monotonic() < deadline:
        if result := holds():
            return result
        time.sleep(0.01)
    raise AssertionError(f"after {PATIENCE} s it is not so that {what}")


@pytest.fixture
def start(write_config: Callable[..., Path], request: pytest.FixtureRequest) -> Iterator[Callable[..., Experiment]]:
    """Return what writes a config and starts it in a session of its own; whatever is left at the end is killed."""
    started: list[Experiment] = []
    request.node.user_properties.append(("faults", 1))

    def begin(body: str = "", *arguments: str, config: Path | None = None, wrapper: tuple[str, ...] = ()) -> Experiment:
        path = config or write_config(body)
        mark, others = uuid.uuid4().hex, frozenset(processes())
        words = ["run", str(path), "--plain", *arguments]
        streams: dict[str, Any] = dict(zip(("stdin", "stdout", "stderr"), STREAMS, strict=True))
        streams["env"] = {**os.environ, MARK: mark}
        if wrapper:
            command = [*wrapper, sys.executable, "-m", "robot_runner", *words]
            process = subprocess.Popen(command, text=True, start_new_session=True, **streams)
        else:
            process = ForkedProgram("robot_runner", words, RUNS, text=True, **streams)
        started.append(Experiment(path, process, mark, others=others))
        return started[-1]

    yield begin
    for experiment in started:
        wait_until(lambda each=experiment: not each.kill(), "all that was left is dead")
        said, _ = experiment.process.communicate(timeout=PATIENCE)
        sys.stdout.write(experiment.output or said)  # pytest shows it where a test fails


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Say how many faults were injected, and how many of these were not survived."""
    injected = lost = 0
    by_whom: Counter[str] = Counter()
    for outcome in ("passed", "failed"):
        for report in terminalreporter.stats.get(outcome, []):
            if report.when == "call":
                counts = Counter[str]()
                for name, count in getattr(report, "user_properties", ()):
                    counts[name] += count if name.startswith("faults") else 0
                injected += counts["faults"]
                lost += counts["faults"] if outcome == "failed" else 0
                by_whom += Counter({name: count for name, count in counts.items() if name != "faults"})
    if injected:
        terminalreporter.write_line(f"{injected} faults injected, {lost} not survived")
    for name, count in by_whom.most_common():
        terminalreporter.write_line(f"  {name.removeprefix('faults ')}: {count}")
