"""The load by other processes between two states of a computer."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePath
from typing import TYPE_CHECKING

from robot_runner.measuring.cpu_counters import counted_before
from robot_runner.measuring.local_host import matches

if TYPE_CHECKING:
    from robot_runner.meters.machine.machine_state import MachineState

_PERCENT = 100.0
#: How many of the busiest processes are listed: a reader would not read more.
_LOOKED_AT = 12
#: A process that took less than this share of a core, in percent, is not listed.
_NOTABLE = 1.0


@dataclass(frozen=True, slots=True)
class Share:
    """The CPU time of one process, with that of the children that ended meanwhile.

    Attributes:
        percent: of one core.
    """

    pid: int
    name: str
    percent: float


@dataclass(frozen=True, slots=True)
class Load:
    """The shares of the processor between two states, in percent of one core.

    Attributes:
        seconds: between the states.
        busy: all CPU time; None where it is unknown.
        ours: by the experiment's processes.
        others: processes that do not belong to the experiment, busiest first, without the least busy ones.
        unseen: by processes that are not visible: of another container, or another guest of the same kernel.
    """

    seconds: float
    busy: float | None
    ours: float
    others: tuple[Share, ...]
    unseen: float

    @property
    def foreign(self) -> float:
        """All CPU time of others than the experiment, as far as it is known."""
        return sum(share.percent for share in self.others) + self.unseen


#: The least time between two states, s: reading one takes longer.
_SHORTEST = 1e-3


def load_between(
    before: MachineState,
    after: MachineState,
    *,
    is_ours: Callable[[MachineState], set[int]],
    command_lines: Callable[[Sequence[int]], Mapping[int, Sequence[str]]],
    subjects: Sequence[str] = (),
) -> Load:
    """Return the load between two states.

    Args:
        before: the first state.
        after: the second one.
        is_ours: returns the pids of the experiment's own processes.
        command_lines: returns the command lines of processes.
        subjects: selectors of the measured processes (`process_selector`).
    """
    seconds = max(after.at - before.at, _SHORTEST)
    spent = _spent(before, after)
    own = is_ours(before) | is_ours(after)
    kernel = {pid for pid, process in after.processes.items() if process.is_kernel}
    candidates = {pid: each for pid, each in spent.items() if pid not in own | kernel}
    busiest = sorted(candidates, key=candidates.__getitem__, reverse=True)[:_LOOKED_AT]
    notable = [pid for pid in busiest if candidates[pid] / seconds * _PERCENT >= _NOTABLE]
    words = command_lines(notable) if notable else {}
    others = [
        Share(pid, after.processes[pid].name, candidates[pid] / seconds * _PERCENT)
        for pid in notable
        if not is_expected(pid, after.processes[pid].name, words[pid], subjects)
    ]
    busy = None if before.busy is None or after.busy is None else (after.busy - before.busy) / seconds * _PERCENT
    seen = sum(spent.values()) / seconds * _PERCENT
    return Load(
        seconds=seconds,
        busy=busy,
        ours=sum(spent.get(pid, 0.0) for pid in own) / seconds * _PERCENT,
        others=tuple(others),
        unseen=0.0 if busy is None else max(0.0, busy - seen),
    )


def is_expected(pid: int, name: str, words: Sequence[str], subjects: Sequence[str]) -> bool:
    """Whether a process that the experiment did not start belongs to it: robot software, or a measured process.

    Example:
        >>> is_expected(7, "talker", ["/opt/talker", "--ros-args", "-r", "__node:=talker"], ())
        True
        >>> is_expected(8, "chromium", ["/usr/bin/chromium"], ["name:talker"])
        False
    """
    is_robot_software = any(
        word == "--ros-args" or word.startswith(("__name:=", "__node:=", "/opt/ros/")) for word in words
    )
    return is_robot_software or _is_own_loop(words) or any(matches(one, pid, name, words) for one in subjects)


def _is_own_loop(words: Sequence[str]) -> bool:
    """Whether the command line is that of our sampling program (measuring/on_board)."""
    if len(words) < 2 or not PurePath(words[0]).name.startswith(("python", "sh", "dash", "bash")):  # noqa: PLR2004 - `sh -c`
        return False
    program = words[-1]
    return "Sample a Linux computer's utilisation" in program or '!= "#end"' in program


def _spent(before: MachineState, after: MachineState) -> dict[int, float]:
    """Return the CPU time of each process in `after`, s: its own, and that of children that ended meanwhile.

    If a process adopted an orphan, its counter includes CPU time from before the first state. So children count for no
    more than the processor was busy.
    """
    ended = {
        pid: (each.parent, each.own + each.children)
        for pid, each in before.processes.items()
        if pid not in after.processes or after.processes[pid].started != each.started
    }
    earlier = counted_before(ended)
    spent: dict[int, float] = {}
    by_children: dict[int, float] = {}
    for process in after.processes.values():
        old = before.processes.get(process.pid)
        own, children = (old.own, old.children) if old and old.started == process.started else (0.0, 0.0)
        spent[process.pid] = max(0.0, process.own - own)
        by_children[process.pid] = max(0.0, process.children - children - earlier.get(process.pid, 0.0))
    excess = 0.0
    if before.busy is not None and after.busy is not None:
        excess = sum(spent.values()) + sum(by_children.values()) - (after.busy - before.busy)
    for pid in sorted(by_children, key=by_children.__getitem__, reverse=True):
        counted = min(by_children[pid], max(0.0, by_children[pid] - excess))
        excess -= by_children[pid] - counted
        spent[pid] += counted
    return spent
