"""Which programs an experiment calls: noticed as they are started, and described in the manifest once it has ended."""

from __future__ import annotations

import os
import shlex
import shutil
import sys
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from robot_runner.core.events.measure import CONFIG_OWNER
from robot_runner.core.execution.circumstances import note_clock
from robot_runner.core.storage.layout import keep_refused
from robot_runner.core.storage.system_packages import described_programs

if TYPE_CHECKING:
    from collections.abc import Mapping
    from types import FrameType

    from robot_runner.core.config.experiment import Experiment
    from robot_runner.core.execution.task import Report
    from robot_runner.core.storage.layout import ExperimentFolder

__all__ = ["CALLED", "ReportedFacts", "notice_programs"]

#: The kind of the record that says that a program was called, and which other one names a program.
CALLED, _SUBJECT = "program", "subject"
#: The events of Python's own that start a program (PEP 578), with the place of the program among their arguments.
_STARTS = {"subprocess.Popen": 0, "os.exec": 0, "os.posix_spawn": 0, "os.spawn": 1, "os.system": 0}
_SHELLS = frozenset({"sh", "bash", "dash"})


def notice_programs(experiment: Experiment, report: Report) -> None:
    """Report each program that this process starts from now on, once, with whose callback it was.

    It is for the process of a run, which ends with the run: Python cannot be told to stop it.
    """
    owners = {id(plugin): plugin.name for plugin in experiment.plugins} | {id(experiment.config): CONFIG_OWNER}
    seen: set[str] = set()

    def notice(event: str, arguments: tuple[Any, ...]) -> None:
        if event not in _STARTS:
            return
        with suppress(Exception):  # whatever is wrong with what is noticed, the program is to start
            for path in _programs(event, arguments):
                if path not in seen and path != os.path.realpath(sys.executable):
                    seen.add(path)
                    report(CALLED, {"owner": _owner(owners, sys._getframe(1)), "path": path})  # noqa: SLF001

    sys.addaudithook(notice)


def _programs(event: str, arguments: tuple[Any, ...]) -> list[str]:
    """Return the paths of the programs that are started: of a shell, the first program of its command, too."""
    if event == "os.system":
        words = ["/bin/sh", "-c", os.fsdecode(arguments[0])]
    else:
        given = next((each for each in arguments if isinstance(each, list | tuple)), ())
        words = [os.fsdecode(arguments[_STARTS[event]]), *map(os.fsdecode, given[1:])]
    found = [shutil.which(words[0])]
    if os.path.basename(words[0]) in _SHELLS and words[1:2] == ["-c"]:  # noqa: PTH119 - no path is made of it
        found += [shutil.which(word) for word in shlex.split(words[2])[:1]]
    return [os.path.abspath(path) for path in found if path]  # noqa: PTH100 - links are kept: they were called


def _owner(owners: Mapping[int, str], frame: FrameType | None) -> str:
    """Return whose callback a frame belongs to; empty where that cannot be told, as in a thread of a library."""
    while frame is not None:
        who = owners.get(id(frame.f_locals.get("self")))
        if who is not None:
            return who
        frame = frame.f_back
    return ""


class ReportedFacts:
    """What runs report that is kept elsewhere than in the journal, too.

    How clocks stood and which programs were called goes into the manifest, what was refused beside the run.

    Args:
        folder: the experiment's.
        manifest: what is changed, and written by others; what earlier executions called stays in it.
    """

    def __init__(self, folder: ExperimentFolder, manifest: dict[str, Any]) -> None:
        self._folder = folder
        self._manifest = manifest
        self._callers: dict[str, set[str]] = {}

    def take(self, run_id: str, kind: str, fields: Mapping[str, Any]) -> None:
        """Take what a run reports; most of it is kept in the journal alone."""
        if kind == "clock":
            note_clock(self._manifest, fields)
        elif kind == "refused":
            keep_refused(self._folder, run_id, fields)
        elif kind == CALLED:
            self._callers.setdefault(str(fields["path"]), set()).add(str(fields["owner"]))
        elif kind == _SUBJECT and fields.get("command") and not fields.get("host"):
            path = shutil.which(str(fields["command"][0]))
            if path is not None and os.path.realpath(path) != os.path.realpath(sys.executable):
                self._callers.setdefault(path, set()).add(str(fields.get("owner", "")))

    def describe_programs(self) -> None:
        """Bring the manifest's `programs` up to date: package, version and SHA-256 of each, and who called it."""
        if not self._callers:
            return
        known = self._manifest.get("programs")
        known = dict(known) if isinstance(known, dict) else {}
        for path, described in described_programs(self._callers).items():
            before = known[path].get("called_by") if isinstance(known.get(path), dict) else None
            callers = {*map(str, before or ()), *filter(None, self._callers[path])}
            known[path] = {**described, "called_by": sorted(callers)}
        self._manifest["programs"] = known
