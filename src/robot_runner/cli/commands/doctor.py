"""Say what is installed here, which extras, links, meters and devices can be used, and how to get the others.

Nothing is changed, and nothing moves. Exit code 0: whatever is here can be used; 1: something that is here cannot, such
as a serial line that belongs to a group which is not yours.
"""

from __future__ import annotations

import importlib.metadata
import os
import platform
import queue
import re
import shutil
import sys
import threading
import time
from argparse import Namespace
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import partial
from itertools import groupby
from pathlib import Path

from rich.text import Text

from robot_runner.cli.console import (
    UserConsole,
    complaints,
    is_on_path,
    output,
    print_folded,
    print_json,
    quiet_loading,
)
from robot_runner.cli.findings import installed_here
from robot_runner.cli.guard import SOME_FAILED
from robot_runner.cli.parser import Parser, add_json
from robot_runner.core.config.claims import usable_cores
from robot_runner.core.entry_points import EntryPoint
from robot_runner.core.errors import RobotRunnerError
from robot_runner.core.execution.left_systems import may_be_moving, robots_left
from robot_runner.core.late_annotations import needed_parameters, signature_of
from robot_runner.core.links.connect import link_findings
from robot_runner.core.links.kinds import installed_links
from robot_runner.core.plugin import Circumstances, installed_plugins, load_plugin
from robot_runner.core.storage.claim_locks import claiming_folders
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.words import enumerated, one_line

#: It can be used; it has to be told something before it can be asked; it is not here; it is here and cannot be used.
READY, UNTRIED, ABSENT, BROKEN = "ready", "untried", "absent", "broken"
#: All of it together, s: a driver that is well answers in a moment. And what is silent then, asked once more: on a
#: machine that is busy, importing a client library takes as long.
_DEADLINES_S = (20.0, 40.0)
_MARKS = {READY: ("✓", "green"), UNTRIED: ("○", "dim"), ABSENT: ("○", "dim"), BROKEN: ("✗", "bold red")}


def add_arguments(parser: Parser) -> None:
    """Add the command's arguments."""
    add_json(parser)


def execute(arguments: Namespace) -> int:
    """Print all diagnoses."""
    console = complaints()
    with quiet_loading():
        found = list(asked(questions(), tell=lambda text: console.print(text, style="dim")))
    if arguments.json:
        print_json({"found": [asdict(each) for each in found]})
    else:
        _print(output(), found)
    return SOME_FAILED if any(each.state == BROKEN for each in found) else 0


def _print(console: UserConsole, found: Sequence[Diagnosis]) -> None:
    for area, several in groupby(found, key=lambda each: each.area):
        console.print(Text(area, style="bold underline"))
        told = list(several)
        width = max(len(each.name) for each in told)
        for each in told:
            mark, style = _MARKS[each.state]
            print_folded(console, f"  {mark} {each.name.ljust(width)}  ", one_line(each.detail), style=style)
            if each.fix:
                print_folded(console, " " * (width + 6), one_line(each.fix), style="")
    broken = [each.name for each in found if each.state == BROKEN]
    verdict = f"To be fixed: {', '.join(broken)}." if broken else "Whatever is here can be used."
    console.tell(verdict, style="bold red" if broken else "bold green")


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """The diagnosis of one subject.

    Attributes:
        state: `ready`, `untried`, `absent` or `broken`.
        fix: one imperative; empty where there is nothing to do.
    """

    area: str
    name: str
    state: str
    detail: str = ""
    fix: str = ""


@dataclass(frozen=True, slots=True)
class Question:
    """A question of the diagnosis: `ask` returns state, detail and fix."""

    area: str
    name: str
    ask: Callable[[], tuple[str, str, str]]


def questions() -> list[Question]:
    """Return all questions, in the order in which the answers are printed."""
    return [
        Question("Program", "robot-runner", _program),
        Question("Program", "Python", lambda: (READY, f"{platform.python_version()} ({sys.executable})", "")),
        Question("Program", "system", _system),
        *(Question("Programs it calls", name, partial(_called, name, needed)) for name, needed in _PROGRAMS.items()),
        *(Question("Extras", extra, partial(_extra, extra, packages)) for extra, packages in _extras().items()),
        *(Question("Links", link, partial(_link, link)) for link in installed_links() if link not in _LOOKED_FOR),
        *(Question("Meters", each.name, partial(_meter, each)) for each in installed_plugins("profilers")),
        *device_questions(Path("/dev")),
        Question("Robots", "killed experiments", _left_moving),
    ]


def asked(
    wanted: Sequence[Question],
    *,
    deadlines_s: tuple[float, float] = _DEADLINES_S,
    tell: Callable[[str], None] = lambda _: None,
) -> Iterator[Diagnosis]:
    """Yield the diagnoses, in order; all are made at once, and again where there was no answer in time.

    Each is asked in a thread of its own: drivers and daemons that hang are among what is looked for. The second
    deadline is for what was silent until the first, which `tell` is told; then it is broken.
    """
    answers: queue.SimpleQueue[tuple[int, Diagnosis]] = queue.SimpleQueue()
    found: dict[int, Diagnosis] = {}

    def ask(place: int, question: Question) -> None:
        try:
            state, detail, fix = question.ask()
        except Exception as error:  # noqa: BLE001 - of a stranger's plugin; the others are told all the same
            state, detail, fix = BROKEN, f"{type(error).__name__}: {error}", "Report it to who wrote it."
        answers.put((place, Diagnosis(question.area, question.name, state, detail, installed_here(fix))))

    first, second = deadlines_s
    for is_second, deadline_s in enumerate(deadlines_s):
        silent = [(place, question) for place, question in enumerate(wanted) if place not in found]
        if is_second and silent:
            names = enumerated([question.name for _, question in silent])
            tell(f"{names} did not answer within {first:g} s{_busy()}: asked once more, for {second:g} s at most")
        for each in silent:
            threading.Thread(target=ask, args=each, daemon=True).start()
        until = time.monotonic() + deadline_s
        # What was asked before may answer yet, and whichever answer comes first counts.
        while len(found) < len(wanted) and (left := until - time.monotonic()) > 0:
            with suppress(queue.Empty):
                found.setdefault(*answers.get(timeout=left))
    for place, question in enumerate(wanted):
        yield found.get(place) or _silent(question, deadlines_s)


def _silent(question: Question, deadlines_s: tuple[float, float]) -> Diagnosis:
    first, second = deadlines_s
    busy, fix = _busy(), "See whether its driver or daemon hangs."
    if busy:
        fix = f"Ask again once the machine is less busy. {fix}"
    problem = f"no answer came within {first:g} s, nor in {second:g} s more{busy}"
    return Diagnosis(question.area, question.name, BROKEN, problem, fix)


def _busy() -> str:
    """Return that more waits for a core of this machine than it has; empty where that is not so."""
    load, cores = os.getloadavg()[0], os.cpu_count() or 1
    return f" (this machine is busy: load {load:.1f} on {cores} cores)" if load > cores else ""


# The program itself, and the programs that it calls.

_PROGRAMS = {
    "ssh": "hosts and robots that are measured over ssh",
    "git": "revisions of software as treatments",
    "docker": "software under test in containers (ComposeProject)",
}


def _program() -> tuple[str, str, str]:
    version = f"{importlib.metadata.version('robot-runner')} ({Path(sys.argv[0]).absolute()})"
    if is_on_path(Path(sys.argv[0])):
        return READY, version, ""
    activate = Path(sys.executable).with_name("activate")
    fix = f"Say: . {activate}" if activate.exists() else f"Put {Path(sys.argv[0]).absolute().parent} on your PATH."
    return ABSENT, f"{version}: your shell does not find this one by the name robot-runner", fix


def _system() -> tuple[str, str, str]:
    system = platform.system()
    cores, usable = os.cpu_count() or 1, usable_cores()
    told = f"{platform.platform()}, {cores} cores" + (f", {usable} of them for this process" if usable < cores else "")
    if system == "Darwin":
        told += ": runs, robots over the network and serial meters work; what reads /proc or /sys does not"
    if system in {"Darwin", "Linux"}:
        return READY, told, ""
    return BROKEN, told, "Use Linux, macOS, or Windows' WSL 2."


def _called(name: str, needed: str) -> tuple[str, str, str]:
    path = shutil.which(name)
    return (READY, path, "") if path else (ABSENT, f"needed for {needed}", f"Install {name}.")


# Extras: optional dependencies of our own distribution.

_REQUIREMENT = re.compile(r"(?P<name>[\w.-]+).*;.*extra == ['\"](?P<extra>[\w-]+)['\"]")
#: Those of who changes Robot Runner, and the one that stands for all others; so do those that name extras alone.
_NOT_TOLD = ("dev", "all")


def _extras() -> Mapping[str, Sequence[str]]:
    found: dict[str, list[str]] = {}
    for line in importlib.metadata.requires("robot-runner") or ():
        match = _REQUIREMENT.match(line)
        if match and match["name"] != "robot-runner" and match["extra"] not in _NOT_TOLD:
            found.setdefault(match["extra"], []).append(match["name"])
    return found


def _extra(extra: str, packages: Sequence[str]) -> tuple[str, str, str]:
    missing = [name for name in packages if not _is_installed(name)]
    if missing:
        return ABSENT, f"without {enumerated(missing)}", f"Install it: pip install 'robot-runner[{extra}]'"
    return READY, "", ""


def _is_installed(package: str) -> bool:
    try:
        importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return False
    return True


# Links and meters: each is asked by the check that validation asks of it, too.

#: A link that looks for the others.
_LOOKED_FOR = ("auto",)
#: A robot that no meter takes for a simulated one: what it says then is about this machine.
_REAL_ROBOT = "ros1"


def _link(link: str) -> tuple[str, str, str]:
    for finding in link_findings(link):
        return ABSENT, finding.problem, finding.fix
    return READY, "", ""


def _left_moving() -> tuple[str, str, str]:
    """Report robots that killed experiments may have left moving, of the last holders of claims."""
    folders = claiming_folders()
    left = [(root, each) for root in folders for each in may_be_moving(ExperimentFolder.found_at(root))]
    found = [(f"{each.problem} ({root})", each.fix) for root, each in left]
    found += [(f"{each.problem} ({each.where})", each.fix) for each in robots_left(folders)]
    if not found:
        return READY, "none has left a robot that may be moving", ""
    return BROKEN, "; ".join(problem for problem, _ in found), found[0][1]


def _meter(installed: EntryPoint) -> tuple[str, str, str]:
    try:
        kind = load_plugin(installed)
    except RobotRunnerError as error:
        return BROKEN, error.problem, error.fix
    parameters = signature_of(kind).parameters
    needed = needed_parameters(kind)
    if needed:  # it cannot be asked, so that it is not known whether its package is there
        told = " ".join(f"--set {name}=..." for name in needed)
        return UNTRIED, f"has to be told {enumerated(needed)}", f"Try it: robot-runner try {installed.name} {told}"
    try:
        plugin = kind(**({"host": "localhost"} if "host" in parameters else {}))
    except RobotRunnerError as error:  # it needs one parameter of several
        return UNTRIED, f"has to be told more: {error.problem}", error.fix
    for finding in plugin.check(Circumstances(robot=_REAL_ROBOT)):
        if finding.is_error:
            return ABSENT, finding.problem, finding.fix
    return READY, "", ""


# Devices: whether there are any, and whether this user may open them.

_DEVICES = {
    "serial lines": ("ttyUSB*", "ttyACM*", "ttyAMA*", "serial0"),
    "I2C buses": ("i2c-*",),
    "cameras": ("video*",),
}


def device_questions(folder: Path) -> list[Question]:
    """Return the questions about devices in a folder, which is `/dev`."""
    return [Question("Devices", kind, partial(_devices, folder, patterns)) for kind, patterns in _DEVICES.items()]


def _devices(folder: Path, patterns: Sequence[str]) -> tuple[str, str, str]:
    found = sorted({path for pattern in patterns for path in folder.glob(pattern)})
    closed = [path for path in found if not os.access(path, os.R_OK | os.W_OK)]
    if closed:
        groups = " and ".join(dict.fromkeys(map(_group_of, closed)))
        fix = f"Join the group and log in again: sudo usermod -aG {groups.replace(' and ', ',')} $USER"
        return BROKEN, f"{enumerated(map(str, closed))} cannot be opened: they belong to the group {groups}", fix
    return (READY, enumerated(map(str, found)), "") if found else (ABSENT, "none is connected", "")


def _group_of(path: Path) -> str:
    try:
        return path.group()
    except KeyError:
        return str(path.stat().st_gid)
