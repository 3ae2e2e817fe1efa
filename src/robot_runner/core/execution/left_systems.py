"""What an execution that was killed has left, seen to by the next one before anything else is done.

Processes that are still alive are awaited and ended (`left_over`), and so is who makes systems safe, as two must not
command one robot. Where a run was killed with all who would have made its systems safe, that is done now: a robot
carries out its last command for ever.
"""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import fields, replace
from pathlib import Path

from robot_runner.core.config.claims import Claims, held_claims
from robot_runner.core.config.experiment import Experiment
from robot_runner.core.config.plugin_checks import failed_check
from robot_runner.core.entry_points import entry_points
from robot_runner.core.errors import (
    ExecutionError,
    Finding,
    LinkError,
    RobotRunnerError,
    StorageError,
    errors_first,
)
from robot_runner.core.execution.left_over import (
    await_left_over,
    end_left_over,
    go_on_elsewhere,
    has_locked,
    is_alive,
    is_subject_left,
    left_over,
    marked_folders,
)
from robot_runner.core.execution.standby import LONGEST, Standby, locked_by, made_safe_of_their_own
from robot_runner.core.execution.systems_state import Care, LeftSystems, SystemsFile
from robot_runner.core.execution.task import RunTask
from robot_runner.core.execution.worker import task_of
from robot_runner.core.links.commanded_topics import MAY_BE_MOVING, STOP_BY_HAND
from robot_runner.core.links.connect import is_simulated, robot_on_graph
from robot_runner.core.plugin import System
from robot_runner.core.storage.claim_locks import HeldClaims
from robot_runner.core.storage.guarded_files import remove
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.lock import ExperimentLock, holder_of
from robot_runner.core.storage.lock_files import was_open_to_strangers
from robot_runner.core.storage.shared_claims import may_be_one
from robot_runner.core.treatments import bind
from robot_runner.core.words import enumerated

#: How long who makes systems safe may take to die once it was killed, s.
_DYING = 5.0
#: How often we look whether it has ended, s.
_LOOK = 0.02
#: The power may have failed before a command was on the disk.
_TOLD_NOTHING = "no command of it is known, so that the robot was told nothing now"


def see_to_what_is_left(experiment: Experiment) -> list[Finding]:
    """See to what a killed execution has left, before anything else is done: processes end, and systems are made safe.

    Returns:
        what was done.

    Raises:
        ExecutionError: something cannot be ended; or a system cannot be made safe, which is told once, as a person is
            to do it then.
    """
    folder = experiment.folder
    awaited = [await_left_over(folder, experiment.parameters.grace_in_s), await_standby(folder)]
    found = [each for each in awaited if each is not None]
    return _told([*found, *_ended_by_rooms(folder.root, lambda _: True), *_made_safe_late(experiment)])


def see_to_what_others_left(experiment: Experiment, roots: Iterable[Path], claims: Iterable[str]) -> list[Finding]:
    """Have robots that killed executions of other experiments left moving stand still, before this one uses them.

    That is done, or told, once. Their systems are not known here: their own experiment's next execution makes them
    safe.

    Args:
        experiment: that claims the robots by now.
        roots: the folders of the experiments that had claimed something before.
        claims: of this experiment.

    Raises:
        ExecutionError: a robot cannot be told to stand still.
    """
    ours, late, findings = [*claims], [], []

    def may_command(robot: str) -> bool:
        claim = _claim_of(robot)
        return claim is not None and any(may_be_one(claim, each) for each in ours)

    for root in roots:
        try:
            findings += _end_what_is_left(root, may_command)
            found = _left_in(ExperimentFolder.found_at(root))
        except OSError as error:  # a share that does not answer any more, say
            problem = f"whether a killed execution has left something there is not known: {error.strerror}"
            findings.append(Finding.warning(str(root), problem, "Look whether its robot stands still."))
            continue
        for slot, left in found:
            if left.robot is not None and may_command(left.robot) and not left.is_told:
                late.append((_late_standby(experiment, slot, left, (), is_for_all=False), slot, left))
    for standby, _, _ in late:
        standby.begin(None)
    for standby, slot, left in late:
        standby.wait()
        findings.append(_finding_of_other(standby, slot, left))
        standby.state.close()
    return _told(findings)


def _told(findings: list[Finding]) -> list[Finding]:
    """Return them; but raise all of them where a robot may be moving, as nobody is told of the others again."""
    if any(each.is_error for each in findings):
        raise ExecutionError.of_findings(errors_first(findings))
    return findings


def _ended_by_rooms(root: Path, may_command: Callable[[str], bool]) -> list[Finding]:
    """Have rooms end what they have started for all runs of a killed execution, and stop robots that it commanded."""
    found: list[Finding] = []
    for point in entry_points("left_behind"):
        try:
            found += point.load()(root, may_command)
        except Exception as error:  # noqa: BLE001 - a stranger's code; what it raises is a finding like others
            found.append(failed_check(point.where, error, "it"))
    return found


def _end_what_is_left(root: Path, may_command: Callable[[str], bool]) -> list[Finding]:
    """End what a killed execution of another experiment has left alive, where nobody is there who would.

    What may drive a robot that nobody could stop then goes on, which is an error: it uses what this one has claimed.
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
                    killed += end_left_over(each)
                elif going_on := left_over(each):
                    findings.append(_left_driving(root, left.robot, going_on))
            findings += _ended_by_rooms(root, may_command)
    except (ExecutionError, StorageError):  # it is executed again, and has ended that itself; or was removed
        return []
    if killed:
        problem = f"an earlier execution was killed; what was left of it was killed: {', '.join(map(str, killed))}"
        findings.insert(0, Finding.warning(str(root), problem))
    return findings


def _left_driving(root: Path, robot: str, pids: Sequence[int]) -> Finding:
    what = f"it may drive a robot ({robot}) that this experiment has not claimed: process {enumerated(map(str, pids))}"
    fix = "Start that experiment again, which ends it and makes its systems safe."
    return Finding.error(str(root), f"what is left of a killed execution goes on; {what}", fix)


def _finding_of_other(standby: Standby, slot: ExperimentFolder, left: LeftSystems) -> Finding:
    where = f"{slot.root}: {left.run_id}"
    SystemsFile(slot).leave(left)
    if standby.state.care is not Care.MADE_SAFE:
        reason = standby.state.reason or "the process that was to do it died"
        problem = f"{MAY_BE_MOVING}: {left.in_words}; it cannot be told to stand still now: {reason}"
        return Finding.error(where, problem, STOP_BY_HAND)
    fix, systems = "Look where it stands.", sorted(left.systems)
    if systems:
        fix = f"Look where it stands, and start that experiment again, which makes {enumerated(systems)} safe."
    done = f"its robot was told to stand still now{_as_far(standby.state.reason)}" if left.commanded else _TOLD_NOTHING
    return Finding.warning(where, f"{left.in_words}; {done}", fix)


def _as_far(reason: str) -> str:
    return f", as far as it could be: {reason}" if reason else ""


def _left_in(folder: ExperimentFolder) -> list[tuple[ExperimentFolder, LeftSystems]]:
    slots = map(folder.at_slot, folder.used_slots())
    return [(slot, left) for slot in slots if (left := SystemsFile(slot).left()) is not None]


def _made_safe_late(experiment: Experiment) -> list[Finding]:
    """Make safe, all at once, what runs of a killed execution have left, as nobody was left who would have."""
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
    """Yield a list of what was done about those systems: it is told with whatever refuses the execution, too."""
    findings: list[Finding] = []
    try:
        yield findings
    except RobotRunnerError as error:
        error.findings = (*error.findings, *findings)
        raise


def _refused(experiment: Experiment, left: LeftSystems, held: ExitStack) -> Finding | None:
    """Return who uses the robot of that run by now; else claim it, where this execution has not."""
    claim = None if left.robot is None else _claim_of(left.robot)
    if claim is None:
        return None
    ours = held_claims(Claims(experiment.parameters, experiment.plugins, experiment.events), experiment.model)
    # Not even looked at: a process that closes a file which it has locked loses its lock.
    if any(may_be_one(claim, each) for each in ours):
        return None
    try:
        held.enter_context(HeldClaims([claim], experiment.parameters.experiment_name, experiment.folder.root))
    except ExecutionError as error:
        fix = "Look where the robot stands, once that experiment has ended."
        return Finding.warning(left.run_id, f"{left.in_words}; nothing was done now: {error.problem}", fix)
    return None


def _claim_of(robot: str) -> str | None:
    """Return what tells a robot from others; None where it is none that is shared."""
    with suppress(LinkError):  # one that cannot be reached at all says so as it is made safe
        return None if is_simulated(robot) else f"robot:{robot_on_graph(robot)}"
    return None


def _late_standby(
    experiment: Experiment,
    slot: ExperimentFolder,
    left: LeftSystems,
    systems: Sequence[System],
    *,
    is_for_all: bool = True,
) -> Standby:
    """Return who makes systems safe that a run has left, and its robot stand still, with its treatments."""
    of_run = replace(experiment, folder=slot, parameters=experiment.parameters.but(robot=left.robot))
    task = _task_of(experiment, left)
    standby = Standby(systems, of_run, task, is_for_all=is_for_all)
    for each in standby.systems:
        with suppress(Exception):  # one that cannot be built then says in its `make_safe` what it lacks
            bind(each, task.combination)
    for topic, message_type in left.commanded:
        standby.state.add_commanded(topic, message_type)
    standby.state.set(Care.RUN)
    return standby


def _task_of(experiment: Experiment, left: LeftSystems) -> RunTask:
    """Return the run, with the texts of its treatments where the config has these no more, or another version told."""
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
        return Finding.warning(left.run_id, f"{left.in_words}; {done}", "Look where the robot stands.")
    if gone:
        reason = f"the config has no {enumerated(sorted(gone))} any more"
    reason = reason or "the process that was to do it died"
    problem = f"{MAY_BE_MOVING}: {left.in_words}; it cannot be done now either: {reason}"
    return Finding.error(left.run_id, problem, STOP_BY_HAND)


def may_be_moving(folder: ExperimentFolder) -> list[Finding]:
    """Return that a robot may be moving, for each run that was killed with all who would have made its systems safe."""
    left = [each for _, each in _left_in(folder)]
    if not left or holder_of(folder.lock) is not None or goes_on(folder.root, counts_orphans=False):
        return []
    fix = "Start the experiment again, which does it before anything else, or stop it by hand."
    return [Finding.warning(each.run_id, f"{MAY_BE_MOVING}: {each.in_words}", fix) for each in left]


def goes_on(root: Path, *, counts_orphans: bool = True) -> bool:
    """Return whether anything goes on of an experiment that nobody executes.

    That is a run, here or on another machine, or what was done beside the runs; software under test; or who makes
    systems safe.

    Args:
        root: the folder of the experiment.
        counts_orphans: whether that is also so where programs alone are left of a run, with nobody who ends them.
    """
    with suppress(OSError, StorageError, ValueError):  # of a folder that cannot be looked at, that is not known
        folder = ExperimentFolder.found_at(root)
        if holder_of(folder.lock):
            return False
        marked = marked_folders(folder)
        is_here = any(is_alive(each) or locked_by(each) is not None for each in marked)
        is_left = counts_orphans and any(map(left_over, marked))
        return is_here or is_left or is_subject_left(folder) or go_on_elsewhere(folder)
    return False


def await_standby(folder: ExperimentFolder) -> Finding | None:
    """Wait until nobody of an earlier execution makes its systems safe; kill who does so for too long.

    Two processes must not command one robot. Where all of an execution was killed, its standby may still be at work
    when the next one begins.

    Returns:
        that it was waited for, and how long; None where nobody stood by.

    Raises:
        ExecutionError: it is still there afterwards; that takes another user's process.
    """
    began = time.monotonic()
    # All of them are awaited, whichever stood by.
    if not any([_await_at(slot) for slot in map(folder.at_slot, folder.used_slots())]):  # noqa: C419
        return None
    waited = time.monotonic() - began
    problem = f"an earlier execution was killed; its systems were still being made safe, which took {waited:.1f} s"
    return Finding.warning(str(folder.root), problem, "Look where the robot stands.")


def _await_at(slot: ExperimentFolder) -> bool:
    """Wait until nobody stands by at a slot; return whether anybody did."""
    began, stood_by = time.monotonic(), False
    while (pid := locked_by(slot)) is not None:
        stood_by = True
        waited = time.monotonic() - began
        if waited > LONGEST:
            _kill(pid, slot)
        if waited > LONGEST + _DYING:
            problem = "systems of an earlier execution are still being made safe, and that cannot be ended from here"
            raise ExecutionError(problem, where=str(slot.root), fix=f"End process {pid} by hand.")
        time.sleep(_LOOK)
    if was_open_to_strangers(slot.standing_by, slot.root):  # as earlier versions made it
        remove(slot.standing_by, slot.root)
    return stood_by


def _kill(pid: int, folder: ExperimentFolder) -> None:
    """Kill the standby, and only the standby, whatever number stands in the file."""
    if pid > 1 and (sys.platform != "linux" or has_locked(pid, folder.standing_by.resolve())):
        with suppress(ProcessLookupError, PermissionError):
            os.kill(pid, signal.SIGKILL)
