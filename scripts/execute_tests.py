"""Execute the tests, each few files of one room in a process of their own, several processes at once.

`execute_tests.py [--processes N] [arguments of pytest]`. A process that imports the tests of one room stays small:
one that has imported all tests holds 340 MB, and each fork of it, of which a run takes two, costs 20 ms of processor
time and not 3 (docs/decisions/0062-small-processes-for-the-tests.md).
"""

from __future__ import annotations

import argparse
import os
import re
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

__all__ = ["Answer", "Batch", "batches_of", "main", "ros2_batches_of"]

_PYTHON = Path(sys.executable)
#: Has rclpy beside what this Python has: scripts/set_up.sh makes it, where a ROS 2 is published.
_ROS2_PYTHON = Path(sys.prefix, "ros2", "bin", "python")
#: What a file has whose tests need rclpy: their mark, or a graph of ROS 2 (tests/ros/real_graph.py).
_OF_ROS2 = re.compile(r"\bmark\.ros2\b|\bover(_pairs)?\([^)]*\"ros2\"")
#: Where the processes keep what is made once for all of them: tests/made_once.py.
_SHARED = "ROBOT_RUNNER_TESTS_FOLDER"
#: Fewer files waste a start and imports each, a second of processor time, more leave processors idle at the end.
_FILES = 20
#: Rooms of few lines that take long: Chromium, a simulated chip, killed processes, whole experiments. They begin first:
#: otherwise they would end alone, with idle processors beside them.
_LONG = {
    *("adaptive", "cluster", "conditions", "docs", "examples", "firmware", "hostile", "page", "process"),
    *("replication", "repository", "subjects"),
}
_NOTHING_CHOSEN = 5  # pytest's exit status where no test was chosen: all tests of a batch are `soak`, say
#: What pytest counts, in the order of its last line.
_KINDS = ("failed", "passed", "skipped", "deselected", "xfailed", "xpassed", "error")
_COUNTED = re.compile(rf"(\d+) ({'|'.join(_KINDS)})s?\b")
#: Behind it may stand what libraries print while Python ends.
_SUMMARY = re.compile(r"((\d+ \w+(, )?)+|no tests ran) in [\d.]+s( \(.*\))?")
_PROGRESS = re.compile(r"[.sxXEFR]+\s*(\[ *\d+%\])?")


@dataclass(frozen=True, slots=True)
class Batch:
    """Test files of one room, which one process executes.

    Attributes:
        name: the room's folder, and which part of it where there are several.
        files: at least one.
        python: that executes it; the one with rclpy executes the tests that need it, and no others.
    """

    name: str
    files: tuple[Path, ...]
    python: Path = _PYTHON

    @property
    def weight(self) -> tuple[bool, int]:
        """How long it may take: whether its room is known to, and how many bytes the files hold."""
        room = Path(self.name.rpartition(" (")[0] or self.name).name
        return room in _LONG, sum(file.stat().st_size for file in self.files)


@dataclass(frozen=True, slots=True)
class Answer:
    """What pytest answered for a batch.

    Attributes:
        batch: that was executed.
        status: pytest's exit status.
        output: what it wrote to both streams.
        span: when it began and ended, s since the first batch began.
    """

    batch: Batch
    status: int
    output: str
    span: tuple[float, float]

    @property
    def is_good(self) -> bool:
        """Whether no test failed, and pytest came to its end."""
        return self.status == _NOTHING_CHOSEN or (self.status == 0 and bool(self.counts))

    @property
    def summary(self) -> str:
        """The line that says how many tests did what, and in how many seconds; the last one where there is none."""
        lines = self.output.strip().splitlines() or ["nothing was said"]
        return next(filter(_SUMMARY.fullmatch, reversed(lines)), lines[-1])

    @property
    def remarks(self) -> list[str]:
        """What was said beside the progress: figures, and why tests were skipped."""
        lines = [line for line in self.output.strip().splitlines() if line and not line.startswith("===")]
        return [line for line in lines if line != self.summary and not _PROGRESS.fullmatch(line)]

    @property
    def counts(self) -> Counter[str]:
        """How many tests passed, failed, were skipped."""
        return Counter({word: int(number) for number, word in _COUNTED.findall(self.summary)})


def batches_of(folder: Path) -> list[Batch]:
    """Return all test files below a folder in batches, the longest first; none holds files of two rooms."""
    files = sorted(folder.rglob("test_*.py"))
    rooms = groupby(files, lambda file: folder / file.relative_to(folder).parts[0])
    batches = [batch for room, members in rooms for batch in _batches_of_room(room, list(members))]
    return sorted(batches, key=lambda batch: batch.weight, reverse=True)


def _batches_of_room(room: Path, files: list[Path]) -> list[Batch]:
    count = -(-len(files) // _FILES)
    parts = [files[len(files) * part // count : len(files) * (part + 1) // count] for part in range(count)]
    names = [f"{room} ({part} of {count})" if count > 1 else str(room) for part in range(1, count + 1)]
    return [Batch(name, tuple(part)) for name, part in zip(names, parts, strict=True)]


def ros2_batches_of(folder: Path) -> list[Batch]:
    """Return the test files with tests that need rclpy, a batch for each room; none where no Python beside has it."""
    if not _ROS2_PYTHON.exists():
        return []
    files = [file for file in sorted(folder.rglob("test_*.py")) if _OF_ROS2.search(file.read_text(encoding="utf-8"))]
    rooms = groupby(files, lambda file: folder / file.relative_to(folder).parts[0])
    return [Batch(f"{room} (ROS 2)", tuple(members), _ROS2_PYTHON) for room, members in rooms]


def _processes() -> int:
    """Return how many processes fit: tests wait two thirds of their time for processes, robots and clocks."""
    return min(8, 3 * (os.cpu_count() or 1))


def _executed(batch: Batch, marks: str, words: list[str], shared: str, start: float) -> Answer:
    # Each has a folder of its own for temporary files; the cache of the last failures is one file for all.
    # The plugin of anyio, which comes with others' packages, would import asyncio into each.
    command = [str(batch.python), "-m", "pytest", "-q", "--color=no", "-p", "no:cacheprovider", "-p", "no:anyio"]
    chosen = " and ".join(f"({mark})" for mark in (marks, "ros2" * (batch.python == _ROS2_PYTHON)) if mark)
    began = time.monotonic() - start
    answer = subprocess.run(
        [*command, *(("-m", chosen) if chosen else ()), *words, *batch.files],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        env={**os.environ, _SHARED: shared},
        text=True,
        errors="replace",
        check=False,
    )
    return Answer(batch, answer.returncode, answer.stdout, (began, time.monotonic() - start))


def _all_executed(batches: list[Batch], marks: str, words: list[str], processes: int) -> list[Answer]:
    """Execute all batches, and print each as it ends."""
    answers = []
    with tempfile.TemporaryDirectory(prefix="rr-tests-") as shared, ThreadPoolExecutor(processes) as executor:
        start = time.monotonic()
        futures = [executor.submit(_executed, batch, marks, words, shared, start) for batch in batches]
        try:
            for future in as_completed(futures):
                answers.append(answer := future.result())
                _tell(answer)
        except KeyboardInterrupt:
            executor.shutdown(wait=False, cancel_futures=True)  # Ctrl-C reached the processes as well
            raise
    return answers


def _tell(answer: Answer) -> None:
    verdict = "ok    " if answer.is_good else "FAILED"
    began, ended = answer.span
    print(f"  {verdict}  {answer.batch.name}: {answer.summary}, from {began:.0f} to {ended:.0f} s", flush=True)
    if not answer.is_good:
        print(answer.output, flush=True)


def _told_work(seconds: float) -> str:
    """Say how long processors computed for the tests, and whether any was left idle."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    computed, there = used.ru_utime + used.ru_stime, seconds * (os.cpu_count() or 1)
    return f"{computed:.0f} s of processor time, {computed / there:.0%} of what was there"


def main() -> int:
    """Execute the tests below tests/ and return 1 where one failed or none was executed."""
    parser = argparse.ArgumentParser(description="Execute the tests in several processes; other words are pytest's.")
    parser.add_argument("--processes", type=int, default=_processes(), help="how many at once (default: %(default)s)")
    parser.add_argument("-m", dest="marks", default="", help="which tests, by their marks, as pytest takes it")
    chosen, words = parser.parse_known_args()
    # A shell has what it starts in the background ignore Ctrl-C, and `nohup` that a terminal was closed: all that tests
    # send these signals to would inherit that.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
    began = time.monotonic()
    tests = Path("tests")
    batches = [*ros2_batches_of(tests), *batches_of(tests)]  # those of ROS 2 wait most of their time
    answers = _all_executed(batches, chosen.marks, words, max(1, chosen.processes))
    for line in sorted({line for answer in answers if answer.is_good for line in answer.remarks}):
        print(line)
    print(_told_work(time.monotonic() - began))
    counts = sum((answer.counts for answer in answers), Counter[str]())
    told = ", ".join(f"{counts[kind]} {kind}" for kind in _KINDS if counts[kind]) or "no tests ran"
    print(f"{told} in {time.monotonic() - began:.2f}s")
    return 0 if counts["passed"] and all(answer.is_good for answer in answers) else 1


if __name__ == "__main__":
    sys.exit(main())
