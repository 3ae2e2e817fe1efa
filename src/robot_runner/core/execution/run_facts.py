"""Facts about runs beside their measures: programs called, values missing, factors not read, large logs."""

from __future__ import annotations

import os
import shlex
import shutil
import sys
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from types import FrameType
from typing import Any

from robot_runner.core.config.experiment import Experiment
from robot_runner.core.design.columns import REPETITION
from robot_runner.core.design.watched_combination import unread
from robot_runner.core.errors import Finding
from robot_runner.core.events.manager import RUN_EVENTS, RobotRunnerEvents
from robot_runner.core.events.measure import CONFIG_OWNER, OPERATOR_OWNER
from robot_runner.core.execution.task import AttemptStatus, Report, RunOutcome, RunTask
from robot_runner.core.storage.layout import ExperimentFolder, keep_log, keep_refused, keep_unknown_log
from robot_runner.core.storage.manifest import described_programs

#: Kinds of records: a program was called; software under test was started.
CALLED, _SUBJECT = "program", "subject"
#: The audit events (PEP 578) of starting a program, with the index of the program among their arguments.
_STARTS = {"subprocess.Popen": 0, "os.exec": 0, "os.posix_spawn": 0, "os.spawn": 1, "os.system": 0}
_SHELLS = frozenset({"sh", "bash", "dash"})
#: The size of a log from which on there is a warning, bytes: a hundred such runs fill the storage of a small computer.
_LARGE_LOG = 100_000_000


def notice_programs(experiment: Experiment, report: Report) -> None:
    """Report each program that this process starts from now on, once, with the owner of the callback.

    Only for the process of a run: an audit hook cannot be removed.
    """
    owners = {id(plugin): plugin.name for plugin in experiment.plugins} | {id(experiment.config): CONFIG_OWNER}
    seen: set[str] = set()

    def notice(event: str, arguments: tuple[Any, ...]) -> None:
        if event not in _STARTS:
            return
        with suppress(Exception):  # a fault in here must not keep the program from starting
            for path in _programs(event, arguments):
                if path not in seen and path != os.path.realpath(sys.executable):
                    seen.add(path)
                    report(CALLED, {"owner": _owner(owners, sys._getframe(1)), "path": path})  # noqa: SLF001

    sys.addaudithook(notice)


def _programs(event: str, arguments: tuple[Any, ...]) -> list[str]:
    """Return the paths of the programs that are started; for `sh -c`, also the first program of the command."""
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
    """Return the owner of the callback that a frame belongs to; empty if unknown, as in a thread of a library."""
    while frame is not None:
        who = owners.get(id(frame.f_locals.get("self")))
        if who is not None:
            return who
        frame = frame.f_back
    return ""


class ReportedFacts:
    """Records of runs that are kept elsewhere than in the journal, too.

    Clock offsets, the machines of a cluster and the programs that were called go into the manifest, refused values into
    the run's folder.
    """

    def __init__(self, folder: ExperimentFolder, manifest: dict[str, Any]) -> None:
        self._folder = folder
        self._manifest = manifest
        self._callers: dict[str, set[str]] = {}

    def take(self, run_id: str, kind: str, fields: Mapping[str, Any]) -> None:
        """Take a record of a run; most kinds are kept in the journal alone."""
        if kind == "clock":
            _note_clock(self._manifest, fields)
        elif kind == "machine":
            _note_machine(self._manifest, fields)
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


def _note_clock(manifest: dict[str, Any], facts: Mapping[str, Any]) -> None:
    """Update the manifest's `clocks` by the offset of a computer's clock before and after one run.

    The manifest has extremes only, so that it does not grow with the number of runs; the journal has each run's facts.
    `facts` are as a run reports them: `host`; `before` and `after`, each with `wall_offset` and `round_trip` in s;
    `uncertainty` in s; `drift` in parts of one.

    Example:
        >>> manifest = {}
        >>> before = {"wall_offset": 1.5, "round_trip": 0.002}
        >>> _note_clock(manifest, {"host": "pi", "before": before, "after": None, "uncertainty": 0.001, "drift": None})
        >>> manifest["clocks"]["pi"]["runs"], manifest["clocks"]["pi"]["largest_offset_s"]
        (1, 1.5)
    """
    offsets = [each for each in (facts["before"], facts["after"]) if each is not None]
    ahead = [each["wall_offset"] for each in offsets]
    known = manifest.setdefault("clocks", {}).get(facts["host"])
    so_far = known or {
        "runs": 0,
        "first_offset_s": ahead[0],
        "smallest_offset_s": ahead[0],
        "largest_offset_s": ahead[0],
        "largest_round_trip_s": 0.0,
        "largest_uncertainty_s": 0.0,
        "last_drift": None,
    }
    manifest["clocks"][facts["host"]] = so_far | {
        "runs": so_far["runs"] + 1,
        "smallest_offset_s": min(so_far["smallest_offset_s"], *ahead),
        "largest_offset_s": max(so_far["largest_offset_s"], *ahead),
        "last_offset_s": ahead[-1],
        "largest_round_trip_s": max(so_far["largest_round_trip_s"], *(each["round_trip"] for each in offsets)),
        "largest_uncertainty_s": max(so_far["largest_uncertainty_s"], facts["uncertainty"]),
        "last_drift": so_far["last_drift"] if facts["drift"] is None else facts["drift"],
    }


#: The manifest has at most so many machines that differ, and so many names of places of each; the journal has all.
_MOST_MACHINES = _MOST_PLACES = 1000


def _note_machine(manifest: dict[str, Any], facts: Mapping[str, Any]) -> None:
    """Add the machine of a place on a cluster to the manifest's `machines`: equal ones are told once.

    `facts` are `place`, and `host` as `describe_host` returns it there.

    Example:
        >>> manifest = {}
        >>> for place in ("one/1", "one/2", "one/1"):
        ...     _note_machine(manifest, {"place": place, "host": {"cores": 2}})
        >>> manifest["machines"]
        [{'host': {'cores': 2}, 'places': ['one/1', 'one/2']}]
    """
    machines, host, place = manifest.setdefault("machines", []), dict(facts["host"]), str(facts["place"])
    alike = next((each for each in machines if each["host"] == host), None)
    if alike is None and len(machines) < _MOST_MACHINES:
        machines.append({"host": host, "places": [place]})
    elif alike is not None and place not in alike["places"] and len(alike["places"]) < _MOST_PLACES:
        alike["places"].append(place)


class UnreadFactors:
    """The factors that vary and that no run has read so far."""

    def __init__(self, experiment: Experiment) -> None:
        self._experiment = experiment
        self._unread: dict[str, Finding] | None = None

    @property
    def findings(self) -> tuple[Finding, ...]:
        """A warning for each of these factors, once a run is done."""
        return tuple((self._unread or {}).values())

    def take(self, task: RunTask, outcome: RunOutcome) -> tuple[Finding, ...]:
        """Return a warning for each factor that the first finished run did not read; later reads withdraw them."""
        if outcome.status is not AttemptStatus.DONE or not self._has_callbacks():
            return ()
        if self._unread is None:
            model = self._experiment.model
            blocks = model.design_facts.get("block_columns", ())  # a day, a period: nothing has to read it
            varied = [each.name for each in model.factors if len(each.treatments) > 1 and each.name not in blocks]
            # A factor of that name counts repetitions, as in the paper's Listing 1.
            self._unread = {
                name: unread(task.run_id, name)
                for name in varied
                if name not in outcome.readers and name.casefold() != REPETITION.casefold()
            }
            return tuple(self._unread.values())
        for name in outcome.readers:
            self._unread.pop(name, None)
        return ()

    def _has_callbacks(self) -> bool:
        """Return whether a run has any callback: a config without any is only planned so far."""
        return bool(self._experiment.events.subscribers(RobotRunnerEvents.BEFORE_RUN, *RUN_EVENTS))


def missing_measures(experiment: Experiment, task: RunTask, outcome: RunOutcome) -> list[Finding]:
    """Return a warning for each measure without a value, of a run that is done."""
    if outcome.status is not AttemptStatus.DONE:
        return []
    log = experiment.folder.log(task.run_id)
    published = {column: outcome.measures.get(column.name) for column in experiment.columns.in_table}
    return [
        Finding.warning(
            f"{task.run_id}, {column.owner}",
            f"{column.name} has no value",
            "`robot-runner explain RUN` gives the reasons." if found and found.doubts else _fix(column.owner, log),
        )
        for column, found in published.items()
        if column.owner != OPERATOR_OWNER  # a person is asked before some runs only
        if found is None or found.value is None
    ]


def left_logs(folder: ExperimentFolder, unfinished: Mapping[str, int]) -> list[Finding]:
    """Keep the logs of runs of an execution that was killed, and warn of logs that belong to no known run.

    `unfinished` has the runs whose attempts have no recorded end, each with its slot; 0 is on another machine.

    Raises:
        StorageError: it cannot be moved.
    """
    for run_id, slot in unfinished.items():
        if slot and not folder.log(run_id).exists():  # else the log at the slot is of a run that the journal lacks
            keep_log(folder.at_slot(slot), run_id)
    kept = [keep_unknown_log(folder.at_slot(slot)) for slot in folder.used_slots()]
    problem = "a run printed this of which the journal does not tell that it was begun"
    fix = "Where an older journal was put back, restore the newer one from a backup before you go on."
    return [Finding.warning(str(log), problem, fix) for log in kept if log is not None]


def large_log(log: Path) -> list[Finding]:
    """Return a warning where a log is so large that it fills disks, as each attempt keeps one, and a package has it."""
    try:
        size = log.stat().st_size
    except OSError:  # it has printed nothing
        return []
    if size < _LARGE_LOG:
        return []
    fix = "Print less, or pass the output of programs on to a file that the mission removes."
    return [Finding.warning(log.parent.name, f"the run has printed {size / 1e6:,.0f} MB, which {log.name} keeps", fix)]


def _fix(owner: str, log: Path) -> str:
    if owner == CONFIG_OWNER:
        return "Return it from populate_run_data."
    if log.exists():
        return "Look at the log of the run."
    return "Publish it in populate_run_data; where there is no value, tell why by context.doubt."
