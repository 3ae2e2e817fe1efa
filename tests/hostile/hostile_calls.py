"""Calls the program on what is hostile, each call in a process of its own that is watched from outside.

Executed as a program, it is the server that all calls are forked from: libraries are imported once, and the memory of
a call is that of the call alone.
"""

from __future__ import annotations

import gc
import importlib
import json
import os
import resource
import signal
import subprocess
import sys
import time
import unicodedata
from dataclasses import dataclass, field
from importlib.metadata import entry_points
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Self

from robot_runner.core.links.connect import preload_robot
from robot_runner.replication.distributions import installed_distributions
from robot_runner.replication.environment import owners_of

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

#: A call that computes for longer, or sleeps for longer, hangs, s.
PATIENCE_S = 10.0
#: The most memory that a call may hold, bytes.
MOST_MEMORY = 512 << 20
_LOOK_S = 0.02
_ORDINARY = {0, 1, 2}
_GROUPS = ("checks", "circumstances", "commands", "companions", "profilers", "systems")
_OF_PACKAGES = (
    "robot_runner.legacy.earlier_tools",
    "robot_runner.replication.packing",
    "rocrate.rocrate",
    "xmlrpc.client",
)
_OF_RESULTS = (
    "matplotlib.backends.backend_svg",
    "matplotlib.figure",
    "pyarrow.pandas_compat",
    "robot_runner.analysis.comparison.comparing",
    "robot_runner.analysis.recomputing.recomputations",
    "robot_runner.analysis.report.writing",
    "statsmodels.formula.api",
)


@dataclass(frozen=True)
class Call:
    """How a call ended."""

    words: tuple[str, ...]
    code: int
    is_hang: bool
    memory: int
    out: bytes
    err: bytes

    def faults(self) -> list[str]:
        """Return what it should not have done."""
        found = []
        if self.is_hang:
            found.append("hang")
        elif self.code not in _ORDINARY:
            found.append(f"exit {self.code}")
        if self.memory > MOST_MEMORY:
            found.append(f"memory {self.memory >> 20} MiB")
        if escapes(self.out) or escapes(self.err):
            found.append("escape")
        if "--json" in self.words and self.code == 0 and not _is_json(self.out):
            found.append("no JSON")
        return found


def escapes(said: bytes) -> set[str]:
    """Return the characters of a text that command a terminal, and bytes that are no text."""
    text = said.decode("utf-8", "surrogateescape")
    return {each for each in set(text) - {"\n", "\t"} if unicodedata.category(each) in {"Cc", "Cf", "Cs"}}


def _is_json(said: bytes) -> bool:
    try:
        json.loads(said, parse_constant=lambda name: 1 / 0 if name else None)
    except (ValueError, ZeroDivisionError):
        return False
    return True


class CallServer:
    """Calls the program.

    Args:
        scratch: a folder of its own, for what is printed and for temporary files.
        packages_only: whether no command is called that reads results. What those need is the most of the memory, of
            which each fork copies the tables.
    """

    def __init__(self, scratch: Path, *, packages_only: bool = False) -> None:
        self._scratch = scratch
        self._number = 0
        scratch.mkdir(parents=True, exist_ok=True)
        environment = os.environ | {
            "HOME": str(scratch / "home"),
            "TMPDIR": str(scratch),
            "MPLCONFIGDIR": str(scratch / "matplotlib"),
            "PYTHONDONTWRITEBYTECODE": "1",
            "OPENBLAS_NUM_THREADS": "1",
        }
        self._process = subprocess.Popen(
            [sys.executable, __file__, *(() if packages_only else _OF_RESULTS)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=environment,
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *raised: object) -> None:
        self._to.close()
        self._process.wait(30)
        self._from.close()

    @property
    def _to(self) -> IO[str]:
        assert self._process.stdin is not None
        return self._process.stdin

    @property
    def _from(self) -> IO[str]:
        assert self._process.stdout is not None
        return self._process.stdout

    def call(self, words: Sequence[str], folder: Path) -> Call:
        """Call the program with these words in a folder, with nobody at its input."""
        out, err = self._scratch / "out", self._scratch / "err"
        self._number += 1
        request = {"words": list(words), "folder": str(folder), "out": str(out), "err": str(err)}
        self._to.write(json.dumps({**request, "number": self._number}) + "\n")
        self._to.flush()
        # A test that ran out of time left its last answer behind.
        while (told := json.loads(self._from.readline()))["number"] != self._number:
            pass
        return Call(tuple(words), told["code"], told["is_hang"], told["memory"], out.read_bytes(), err.read_bytes())


@dataclass
class Tally:
    """What came of many calls."""

    subjects: int = 0
    calls: int = 0
    faults: dict[str, list[str]] = field(default_factory=dict)
    largest_memory: int = 0

    def take(self, name: str, call: Call) -> None:
        """Count a call."""
        self.calls += 1
        self.largest_memory = max(self.largest_memory, call.memory)
        for fault in call.faults():
            self.note(fault, f"{name}: {' '.join(call.words[:1])}: {call.err.decode(errors='replace')[-300:]}")

    def note(self, fault: str, where: str) -> None:
        """Count a fault."""
        self.faults.setdefault(fault.partition(" ")[0], []).append(f"{fault}, {where}")

    def count(self, kind: str) -> int:
        """Return how many faults of a kind there were."""
        return len(self.faults.get(kind, ()))

    def as_mapping(self) -> dict[str, Any]:
        """Return everything as plain data."""
        return {"subjects": self.subjects, "calls": self.calls, "faults": self.faults, "memory": self.largest_memory}

    def in_words(self, what: str) -> str:
        """Return the figures that are promised."""
        others = {kind: len(each) for kind, each in self.faults.items() if kind not in _PROMISED}
        more = "".join(f", {count} {kind}" for kind, count in others.items())
        return (
            f"{self.subjects} {what}, {self.calls} calls: {self.count('written')} writes outside, "
            f"{self.count('hang')} hangs, {self.count('escape')} escapes, {self.count('exit')} exits of a fault, "
            f"{self.count('memory')} above 512 MiB (at most {self.largest_memory >> 20} MiB){more}"
        )


_PROMISED = {"written", "hang", "escape", "exit", "memory"}


def snapshot(folder: Path) -> dict[str, tuple[Any, ...]]:
    """Return what a folder that nobody may change holds."""
    found: dict[str, tuple[Any, ...]] = {}
    for path in sorted(folder.rglob("*")):
        status = path.lstat()
        content = path.read_bytes() if path.is_file() and not path.is_symlink() else b""
        found[str(path.relative_to(folder))] = (status.st_mode, status.st_size, status.st_mtime_ns, hash(content))
    return found


def _serve() -> None:
    """Execute one call after another: each is forked, watched, and ended with what it started."""
    _import_libraries((*_OF_PACKAGES, *sys.argv[1:]))
    for line in sys.stdin:
        request = json.loads(line)
        pid = os.fork()
        if pid == 0:
            _be_called(request)
        is_hang, status, used = _watched(pid)
        code = os.waitstatus_to_exitcode(status)
        answer = {"code": code, "is_hang": is_hang, "memory": used.ru_maxrss * 1024, "number": request["number"]}
        sys.stdout.write(json.dumps(answer) + "\n")
        sys.stdout.flush()


def _import_libraries(names: Sequence[str]) -> None:
    """Import what is registered and what commands import when they need it, which each call would do anew otherwise."""
    for group in _GROUPS:
        for registered in entry_points(group=f"robot_runner.{group}"):
            registered.load()
    for name in names:
        importlib.import_module(name)
    preload_robot("simulated")
    owners_of("robot_runner"), installed_distributions()  # what is installed is looked at once a process, too
    gc.collect()
    gc.freeze()  # no call collects what it has not made


def _be_called(request: Mapping[str, Any]) -> None:
    code = 71
    try:
        os.setsid()
        resource.setrlimit(resource.RLIMIT_AS, (4 << 30, 4 << 30))
        resource.setrlimit(resource.RLIMIT_FSIZE, (256 << 20, 256 << 20))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        for descriptor, name, flags in (
            (0, os.devnull, os.O_RDONLY),
            (1, request["out"], os.O_WRONLY | os.O_CREAT | os.O_TRUNC),
            (2, request["err"], os.O_WRONLY | os.O_CREAT | os.O_TRUNC),
        ):
            opened = os.open(name, flags, 0o600)
            os.dup2(opened, descriptor)
            os.close(opened)
        os.chdir(request["folder"])
        sys.argv = ["robot-runner", *request["words"]]
        from robot_runner.cli.main import main

        code = main(request["words"])
        sys.stdout.flush()
        sys.stderr.flush()
    finally:
        os._exit(code)


def _watched(pid: int) -> tuple[bool, int, resource.struct_rusage]:
    """Wait for a process; one that computes or sleeps for too long is killed. Waiting for the machine is neither."""
    asleep, ticks = 0.0, os.sysconf("SC_CLK_TCK")
    looked = time.monotonic()
    while True:
        found, status, used = os.wait4(pid, os.WNOHANG)
        if found:
            return False, status, used
        time.sleep(_LOOK_S)
        now = time.monotonic()
        fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii", errors="replace").rpartition(")")[2].split()
        if fields[0] in "SDT":
            asleep += now - looked
        looked = now
        computed = (int(fields[11]) + int(fields[12])) / ticks
        if asleep > PATIENCE_S or computed > PATIENCE_S:
            os.killpg(pid, signal.SIGKILL)
            _, status, used = os.wait4(pid, 0)
            return True, status, used


if __name__ == "__main__":
    _serve()
