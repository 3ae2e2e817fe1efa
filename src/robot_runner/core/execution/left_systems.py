"""Cleaning up after an execution that was killed, by the next one, before it does anything else.

Processes that are still alive are awaited and ended (`left_processes`), the standby included, as two must not command
one robot. Where a run was killed with its keeper and its standby, its systems are made safe now: a robot carries out
its last command for ever.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import fields, replace
from pathlib import Path

from robot_runner.core.config.claims import Claims, held_claims
from robot_runner.core.config.experiment import Experiment
from robot_runner.core.config.plugin_checks import announced_findings
from robot_runner.core.errors import ExecutionError, Finding, LinkError, RobotRunnerError, StorageError, errors_first
from robot_runner.core.execution.going_on import goes_on
from robot_runner.core.execution.interruption import Interruption
from robot_runner.core.execution.left_processes import (
    await_left_processes,
    end_left_processes,
    left_processes,
    marked_folders,
)
from robot_runner.core.execution.run_events import made_safe_of_their_own
from robot_runner.core.execution.standby import Standby
from robot_runner.core.execution.standby_lock import await_standby, await_standby_at
from robot_runner.core.execution.systems_state import Care, LeftCopy, LeftSystems, SystemsFile, left_copies
from robot_runner.core.execution.task import RunTask
from robot_runner.core.execution.worker import task_of
from robot_runner.core.links.commanded_topics import MAY_BE_MOVING, STOP_BY_HAND
from robot_runner.core.links.connect import is_simulated, robot_on_graph
from robot_runner.core.plugin import System
from robot_runner.core.storage.claim_locks import HeldClaims, claim_holders
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.lock import ExperimentLock, holder_of
from robot_runner.core.storage.shared_claims import may_be_one
from robot_runner.core.treatments import bind
from robot_runner.core.words import enumerated

#: Said where no command is on the disk: the power may have failed before one was written.
_TOLD_NOTHING = "no command of it is known, so that the robot was told nothing now"


def see_to_it_first(experiment: Experiment) -> list[Finding]:
    """See to what is left before a robot's graph is looked at, which takes seconds; for `prepare`.

    Return what was done, with an error where something cannot be done, or a stop request came meanwhile. Nothing is,
    where others have what this experiment claims: its execution waits, or says so.
    """
    folder, earlier = experiment.folder, dict[Path, None]()
    is_ours = bool(_left_in(folder))
    if not (is_ours or left_copies()):
        return []

    def is_at_work(root: Path) -> bool:
        earlier[root] = None
        return goes_on(root, counts_orphans=False)

    held = held_claims(Claims(experiment.parameters, experiment.plugins, experiment.events), experiment.model)
    found: list[Finding] = []
    with Interruption() as interruption, ExitStack() as opened:
        try:
            name = experiment.parameters.experiment_name
            opened.enter_context(HeldClaims(held, name, folder.root, None, is_at_work))
            if is_ours:
                opened.enter_context(ExperimentLock(folder.lock))
        except (ExecutionError, StorageError):
            pass  # others have it
        else:
            try:
                with told_if_refused() as found:
                    found.extend(see_to_what_others_left(experiment, earlier, held))
                    found.extend(see_to_what_is_left(experiment) if is_ours else ())
            except ExecutionError as error:
                return [*error.findings]
    if interruption.is_requested:  # no exception: what was done is to be told
        found.append(Finding.error("", "interrupted before the first run", "Start the experiment again."))
    return found


def see_to_what_is_left(experiment: Experiment) -> list[Finding]:
    """End what a killed execution has left, and make its systems safe, before anything else; return what was done.

    Raises:
        ExecutionError: something cannot be ended; or a system cannot be made safe, which is raised only once, as a
            person has to do it then.
    """
    folder = experiment.folder
    awaited = [await_left_processes(folder, experiment.parameters.grace_in_s), await_standby(folder)]
    found = [each for each in awaited if each is not None]
    return _told([*found, *_ended_by_rooms(folder.root, lambda _: True), *_made_safe_late(experiment)])


def see_to_what_others_left(experiment: Experiment, roots: Iterable[Path], claims: Iterable[str]) -> list[Finding]:
    """Stop robots that killed executions of other experiments left moving, before this one uses them.

    That is tried once, and not of one that is being executed again. Their systems are not known here: the next
    execution of their own experiment makes them safe. This one has claimed the robots by now; `roots` are the folders
    of those that had claimed something before.

    Raises:
        ExecutionError: a robot cannot be stopped.
    """
    ours, late, findings = [*claims], [], []

    def may_command(robot: str) -> bool:
        claim = _claim_of(robot)
        return claim is not None and any(may_be_one(claim, each) for each in ours)

    for root in roots:
        try:
            findings += _end_what_is_left(root, may_command)
            folder = ExperimentFolder.found_at(root)
            found = [] if holder_of(folder.lock) else _left_in(folder)  # it may command by now what it has claimed
        except OSError as error:  # a share that does not answer any more, say
            problem = f"whether a killed execution has left something there is not known: {error.strerror}"
            findings.append(Finding.warning(str(root), problem, "Check whether its robot stands still."))
            continue
        except ValueError:  # a damaged record: no folder has such a name
            continue
        for slot, left in found:
            if left.robot is not None and may_command(left.robot) and not left.is_told:
                late.append((_late_standby(experiment, slot, left, (), is_for_all=False), slot, left))
    copies = [
        (_late_standby(experiment, ExperimentFolder(each.original.parent), each.left, (), is_for_all=False), each)
        for each in _left_elsewhere({*roots, experiment.folder.root})
        if each.left.robot is not None and may_command(each.left.robot)
    ]
    for standby in (*(each[0] for each in late), *(each[0] for each in copies)):
        standby.begin(None)
    for standby, slot, left in late:
        standby.wait()
        findings.append(_finding_of_other(standby, str(slot.root), left))
        SystemsFile(slot).leave(left)
        standby.state.close()
    for standby, copy in copies:
        standby.wait()
        findings.append(_finding_of_other(standby, str(copy.original.parent), copy.left, is_gone=True))
        copy.remove()
        standby.state.close()
    return _told(findings)


def _left_elsewhere(known: Collection[Path]) -> Iterator[LeftCopy]:
    """Yield what killed runs have left, unless their folder is among the known ones, or is still in use.

    A folder that cannot be read, as on a network share that does not answer, counts as gone.
    """
    for each in left_copies():
        root = each.original.parent
        is_there = os.path.exists(each.original)  # noqa: PTH110 - `Path.exists` raises where the system cannot tell
        if not is_there or not (root in known or holder_of(ExperimentFolder(root).lock) or goes_on(root)):
            yield each


def robots_left(known: Collection[Path] = ()) -> list[Finding]:
    """Return a warning for each robot that killed executions have left, perhaps moving; not of the known folders.

    A robot that is claimed is in use: its experiment goes on in a folder that was renamed, or another has stopped it.
    """
    fix = "Start an experiment that uses it, which stops it before anything else, or stop it by hand."
    return [
        Finding.warning(f"{each.original.parent}: {each.left.run_id}", f"{MAY_BE_MOVING}: {each.left.in_words}", fix)
        for each in _left_elsewhere(known)
        if (claim := _claim_of(each.left.robot)) is None or not claim_holders([claim])
    ]


def _told(findings: list[Finding]) -> list[Finding]:
    """Return the findings; where one is an error, raise all of them, as the others would not be shown later."""
    if any(each.is_error for each in findings):
        raise ExecutionError.of_findings(errors_first(findings))
    return findings


def _ended_by_rooms(root: Path, may_command: Callable[[str], bool]) -> list[Finding]:
    """Let rooms end the programs that they started for all runs of a killed execution, and stop its robots."""
    what = "ending what was left"
    return announced_findings("left_behind", lambda point: point.load()(root, may_command), what)


def _end_what_is_left(root: Path, may_command: Callable[[str], bool]) -> list[Finding]:
    """End the processes of a killed execution of another experiment, unless that is being executed again.

    A process that may drive a robot which this experiment could not stop afterwards is left alone, and is an error.
    """
    folder = ExperimentFolder.found_at(root)
    if not folder.journal.exists():
        return []
    killed, findings = list[int](), list[Finding]()
    try:
        with ExperimentLock(folder.lock):
            for each in marked_folders(folder):
                left = SystemsFile(each).left()
                if left is None or left.robot is None or may_command(left.robot):
                    killed += end_left_processes(each)
                    await_standby_at(each)  # a run that was stopped, say, has a standby, which acts now
                elif going_on := left_processes(each):
                    findings.append(_left_driving(root, left.robot, going_on))
            findings += _ended_by_rooms(root, may_command)
    except (ExecutionError, StorageError):  # it is executed again, and has ended that itself; or was removed
        return []
    if killed:
        problem = f"an earlier execution was killed; what was left of it was killed: {', '.join(map(str, killed))}"
        findings.insert(0, Finding.warning(str(root), problem))
    return findings


def _left_driving(root: Path, robot: str, pids: Sequence[int]) -> Finding:
    left = f"process {enumerated(map(str, pids))} of a killed execution is alive"
    problem = f"{left} and may drive a robot ({robot}) that this experiment has not claimed"
    fix = "Start that experiment again, which ends the process and makes the systems safe."
    return Finding.error(str(root), problem, fix)


def _finding_of_other(standby: Standby, root: str, left: LeftSystems, *, is_gone: bool = False) -> Finding:
    where = f"{root}: {left.run_id}"
    if standby.state.care is not Care.MADE_SAFE:
        reason = standby.state.reason or "the process that was to do it died"
        problem = f"{MAY_BE_MOVING}: {left.in_words}; it cannot be told to stand still now: {reason}"
        return Finding.error(where, problem, STOP_BY_HAND)
    fix, systems = "Check where it stands.", sorted(left.systems)
    if systems and is_gone:
        fix = f"Check where it stands, and see to {enumerated(systems)} by hand: the experiment's folder is gone."
    elif systems:
        fix = f"Check where it stands, and start that experiment again, which makes {enumerated(systems)} safe."
    done = f"its robot was told to stand still now{_as_far(standby.state.reason)}" if left.commanded else _TOLD_NOTHING
    return Finding.warning(where, f"{left.in_words}; {done}", fix)


def _as_far(reason: str) -> str:
    return f", as far as it could be: {reason}" if reason else ""


def _left_in(folder: ExperimentFolder) -> list[tuple[ExperimentFolder, LeftSystems]]:
    slots = map(folder.at_slot, folder.used_slots())
    return [(slot, left) for slot in slots if (left := SystemsFile(slot).left()) is not None]


def _made_safe_late(experiment: Experiment) -> list[Finding]:
    """Make the systems of killed runs safe, all at the same time, where no standby was left to do it."""
    found = _left_in(experiment.folder)
    late, findings = [], []
    with ExitStack() as held:
        for slot, left in found:
            if refusal := _refused(experiment, left, held):
                findings.append(refusal)
            else:
                late.append((_late_standby(experiment, slot, left, made_safe_of_their_own(experiment)), left))
        for standby, _ in late:
            standby.begin(None)
        for standby, left in late:
            standby.wait()
            findings.append(_finding(standby, left))
            standby.state.close()
    for slot, _ in found:
        SystemsFile(slot).remove()
    return findings


@contextmanager
def told_if_refused() -> Iterator[list[Finding]]:
    """Yield a list for findings on those systems; an error that refuses the execution gets them, too."""
    findings: list[Finding] = []
    try:
        yield findings
    except RobotRunnerError as error:
        error.findings = (*error.findings, *findings)
        raise


def _refused(experiment: Experiment, left: LeftSystems, held: ExitStack) -> Finding | None:
    """Claim the robot of that run, unless this execution has; return a finding where another experiment uses it."""
    claim = _claim_of(left.robot)
    if claim is None:
        return None
    ours = held_claims(Claims(experiment.parameters, experiment.plugins, experiment.events), experiment.model)
    # Its claim file is not even opened: a process that closes a file which it has locked loses its lock.
    if any(may_be_one(claim, each) for each in ours):
        return None
    try:
        held.enter_context(HeldClaims([claim], experiment.parameters.experiment_name, experiment.folder.root))
    except ExecutionError as error:
        fix = "Check where the robot stands, once that experiment has ended."
        return Finding.warning(left.run_id, f"{left.in_words}; nothing was done now: {error.problem}", fix)
    return None


def _claim_of(robot: str | None) -> str | None:
    """Return the claim on a robot; None where there is none, it is simulated, or it cannot be reached."""
    with suppress(LinkError):  # one that cannot be reached at all says so as it is made safe
        return None if robot is None or is_simulated(robot) else f"robot:{robot_on_graph(robot)}"
    return None


def _late_standby(
    experiment: Experiment,
    slot: ExperimentFolder,
    left: LeftSystems,
    systems: Sequence[System],
    *,
    is_for_all: bool = True,
) -> Standby:
    """Return a standby, with the treatments of a run, that makes its systems safe and stops its robot."""
    of_run = replace(experiment, folder=slot, parameters=experiment.parameters.but(robot=left.robot))
    task = _task_of(experiment, left)
    standby = Standby(systems, of_run, task, is_for_all=is_for_all)
    for each in standby.systems:
        with suppress(Exception):  # a system that cannot be built raises in its `make_safe`, which is reported
            bind(each, task.combination)
    for commanded in left.commanded:
        standby.state.add_commanded(commanded)
    standby.state.set(Care.RUN)
    return standby


def _task_of(experiment: Experiment, left: LeftSystems) -> RunTask:
    """Return the run's task; where the config or its record has changed, with the texts of its treatments."""
    with suppress(RobotRunnerError, AttributeError, LookupError, TypeError, ValueError):
        return task_of(experiment, left.task)
    told = {each.name: left.task[each.name] for each in fields(RunTask) if each.name in left.task}
    treatments = left.task.get("combination")
    known = treatments.items() if isinstance(treatments, dict) else ()
    combination = {name: each[-1] for name, each in known if isinstance(each, list) and each}
    unknown = dict.fromkeys(("run_number", "run_count", "attempt", "repetition", "experiment_seed", "run_seed"), 1)
    return RunTask(**{**unknown, **told, "combination": combination})


def _finding(standby: Standby, left: LeftSystems) -> Finding:
    reason = standby.state.reason
    gone = left.systems.difference(each.name for each in standby.systems)
    if standby.state.care is Care.MADE_SAFE and not gone:
        done = f"that was done now{_as_far(reason)}" if left.commanded or standby.systems else _TOLD_NOTHING
        return Finding.warning(left.run_id, f"{left.in_words}; {done}", "Check where the robot stands.")
    if gone:
        reason = f"the config has no {enumerated(sorted(gone))} any more"
    reason = reason or "the process that was to do it died"
    problem = f"{MAY_BE_MOVING}: {left.in_words}; it cannot be done now either: {reason}"
    return Finding.error(left.run_id, problem, STOP_BY_HAND)


def may_be_moving(folder: ExperimentFolder) -> list[Finding]:
    """Return a warning for each run that was killed with all processes that would have stopped its robot.

    That is a run, with its keeper and standby, or what a room has started for all runs.
    """
    if holder_of(folder.lock) is not None:
        return []
    fix = "Start the experiment again, which does it before anything else, or stop it by hand."
    left = [Finding.warning(each.run_id, f"{MAY_BE_MOVING}: {each.in_words}", fix) for _, each in _left_in(folder)]
    left += announced_findings("left_moving", lambda point: point.load()(folder.root), "looking at what was left")
    return [] if left and goes_on(folder.root, counts_orphans=False) else left
