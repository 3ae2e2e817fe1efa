"""Execute the tests, each few files of one room in a process of their own, several processes at once.

`execute_tests.py [--processes N] [arguments of pytest]`. A process that imports the tests of one room stays small:
one that has imported all tests holds 340 MB, and each fork of it, of which a run takes two, costs 20 ms of processor
time and not 3 (docs/decisions/0062-small-processes-for-the-tests.md).
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tempfile
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

__all__ = ["Answer", "Batch", "batches_of", "main"]

_PYTEST = str(Path(sys.executable).with_name("pytest"))
#: Where the processes keep what is made once for all of them: tests/made_once.py.
_SHARED = "ROBOT_RUNNER_TESTS_FOLDER"
#: Fewer files waste imports, more leave some processors idle at the end.
_FILES = 12
_NOTHING_CHOSEN = 5  # pytest's exit status where no test was chosen: all tests of a batch are `soak`, say
#: What pytest counts, in the order of its last line.
_KINDS = ("failed", "passed", "skipped", "deselected", "xfailed", "xpassed", "error")
_COUNTED = re.compile(rf"(\d+) ({'|'.join(_KINDS)})s?\b")
_PROGRESS = re.compile(r"[.sxXEFR]+\s*(\[ *\d+%\])?")


@dataclass(frozen=True, slots=True)
class Batch:
    """Test files of one room, which one process executes.

    Attributes:
        name: the room's folder, and which part of it where there are several.
        files: at least one.
    """

    name: str
    files: tuple[Path, ...]

    @property
    def size(self) -> int:
        """How many bytes the files hold: what is long takes long, by and large."""
        return sum(file.stat().st_size for file in self.files)


@dataclass(frozen=True, slots=True)
class Answer:
    """What pytest answered for a batch: its exit status, and what it wrote to both streams."""

    batch: Batch
    status: int
    output: str

    @property
    def is_good(self) -> bool:
        """Whether no test failed, and pytest came to its end."""
        return self.status == _NOTHING_CHOSEN or (self.status == 0 and bool(self.counts))

    @property
    def summary(self) -> str:
        """The last line: how many tests did what, and in how many seconds."""
        return (self.output.strip().splitlines() or ["nothing was said"])[-1]

    @property
    def remarks(self) -> list[str]:
        """What was said beside the progress: figures, and why tests were skipped."""
        lines = [line for line in self.output.strip().splitlines()[:-1] if line and not line.startswith("===")]
        return [line for line in lines if not _PROGRESS.fullmatch(line)]

    @property
    def counts(self) -> Counter[str]:
        """How many tests passed, failed, were skipped."""
        return Counter({word: int(number) for number, word in _COUNTED.findall(self.summary)})


def batches_of(folder: Path) -> list[Batch]:
    """Return all test files below a folder in batches, the largest first; none holds files of two rooms."""
    files = sorted(folder.rglob("test_*.py"))
    rooms = groupby(files, lambda file: folder / file.relative_to(folder).parts[0])
    batches = [batch for room, members in rooms for batch in _batches_of_room(room, list(members))]
    return sorted(batches, key=lambda batch: batch.size, reverse=True)


def _batches_of_room(room: Path, files: list[Path]) -> list[Batch]:
    count = -(-len(files) // _FILES)
    parts = [files[len(files) * part // count : len(files) * (part + 1) // count] for part in range(count)]
    names = [f"{room} ({part} of {count})" if count > 1 else str(room) for part in range(1, count + 1)]
    return [Batch(name, tuple(part)) for name, part in zip(names, parts, strict=True)]


def _processes() -> int:
    """Return how many processes fit: tests wait half of their time for processes, robots and clocks."""
    return min(8, 2 * (os.cpu_count() or 1))


def _executed(batch: Batch, words: list[str], shared: str) -> Answer:
    # Each has a folder of its own for temporary files; the cache of the last failures is one file for all.
    command = [_PYTEST, "-q", "--color=no", "-p", "no:cacheprovider", *words, *map(str, batch.files)]
    answer = subprocess.run(
        command,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        env={**os.environ, _SHARED: shared},
        text=True,
        errors="replace",
        check=False,
    )
    return Answer(batch, answer.returncode, answer.stdout)


def _all_executed(batches: list[Batch], words: list[str], processes: int) -> list[Answer]:
    """Execute all batches, and print each as it ends."""
    answers = []
    with tempfile.TemporaryDirectory(prefix="rr-tests-") as shared, ThreadPoolExecutor(processes) as executor:
        futures = [executor.submit(_executed, batch, words, shared) for batch in batches]
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
    print(f"  {verdict}  {answer.batch.name}: {answer.summary}", flush=True)
    if not answer.is_good:
        print(answer.output, flush=True)


def main() -> int:
    """Execute the tests below tests/ and return 1 where one failed or none was executed."""
    parser = argparse.ArgumentParser(description="Execute the tests in several processes; other words are pytest's.")
    parser.add_argument("--processes", type=int, default=_processes(), help="how many at once (default: %(default)s)")
    chosen, words = parser.parse_known_args()
    began = time.monotonic()
    answers = _all_executed(batches_of(Path("tests")), words, max(1, chosen.processes))
    for line in sorted({line for answer in answers if answer.is_good for line in answer.remarks}):
        print(line)
    counts = sum((answer.counts for answer in answers), Counter[str]())
    told = ", ".join(f"{counts[kind]} {kind}" for kind in _KINDS if counts[kind]) or "no tests ran"
    print(f"{told} in {time.monotonic() - began:.2f}s")
    return 0 if counts["passed"] and all(answer.is_good for answer in answers) else 1


if __name__ == "__main__":
    sys.exit(main())
