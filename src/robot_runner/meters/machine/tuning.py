"""Sets up a Linux machine for measuring, and restores its settings, also after the experiment was killed."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

from robot_runner.core.errors import Finding, PluginError, did_you_mean
from robot_runner.core.storage.outliving import ancestors, started_at
from robot_runner.core.words import enumerated
from robot_runner.meters.machine.machine_state import ProcessTimes, text_in
from robot_runner.meters.machine.tuning_state import Change, Kept, state_file

_CPU = "sys/devices/system/cpu"
_CACHES = "proc/sys/vm/drop_caches"
#: Page cache, dentries and inodes (Linux, admin-guide/sysctl/vm, drop_caches).
_ALL_CACHES = "3"
_RESTORE = "Put it back: robot-runner tune --restore."
_AS_ROOT = "Execute it as root (sudo), or leave it out."


@dataclass(frozen=True, slots=True)
class Wishes:
    """The requested settings; None and empty leave a setting as it is.

    Attributes:
        governor: of the processor's frequency, such as `performance`.
        turbo: whether the processor may exceed its nominal frequency.
        cores: reserved for the experiment.
        drops_caches: whether the kernel drops its caches of files.
    """

    governor: str | None = None
    turbo: bool | None = None
    cores: tuple[int, ...] = ()
    drops_caches: bool = False


class Machine:
    """A machine that can be set up.

    Args:
        root: the folder with its `proc` and `sys`; tests have a copy elsewhere.
        state: the file of state; None takes the user's, or one beside the copy.
    """

    def __init__(self, root: Path = Path("/"), state: Path | None = None) -> None:
        self.root = root
        self.state = state or (state_file() if root == Path("/") else root / "tuned.json")

    def findings(self, where: str, wishes: Wishes) -> list[Finding]:
        """Return findings on why these settings cannot be made, without changing anything."""
        problems = [*self._governor_findings(where, wishes), *self._turbo_findings(where, wishes)]
        problems += self._core_findings(where, wishes)
        if wishes.drops_caches and not os.access(self.root / _CACHES, os.W_OK):
            problems.append(Finding.error(where, f"{self.root / _CACHES} cannot be written", _AS_ROOT))
        return [*problems, *self.left_behind(where, blocks=True)]

    def left_behind(self, where: str, *, blocks: bool = False) -> list[Finding]:
        """Return a finding if the machine is still set up, by hand or by another process; an error if that `blocks`."""
        try:
            kept = self._kept()
        except PluginError as error:
            return [error.as_finding()]
        if kept is None:
            return []
        if kept.owner is None:
            problem = "this machine was set up by robot-runner tune, and still is"
            return [Finding.error(where, problem, _RESTORE)] if blocks else [Finding.warning(where, problem, _RESTORE)]
        if self._is_alive(kept.owner):
            if kept.owner[0] in {1, *ancestors(os.getpid())}:  # a run in a fresh interpreter asks as well
                return []
            problem = f"this machine is set up by process {kept.owner[0]}, which goes on"
            return [Finding.error(where, problem, "Wait until it has ended.")] if blocks else []
        problem = f"this machine is still as process {kept.owner[0]} set it up, which was killed"
        fix = "It is put back before the first run." if blocks else _RESTORE
        return [Finding.warning(where, problem, fix)]

    @property
    def in_use_by(self) -> int | None:
        """The running process that has set it up, and will restore it; None where there is none."""
        kept = self._kept()
        return kept.owner[0] if kept is not None and kept.owner is not None and self._is_alive(kept.owner) else None

    def apply(self, wishes: Wishes, *, owner: int | None) -> None:
        """Set the machine up, after writing the previous settings to the file of state.

        Args:
            wishes: the settings.
            owner: the process that restores it; None if only the user does.

        Raises:
            PluginError: a running process has set it up already, or the kernel refuses; then it is as before.
        """
        where = str(self.state)
        errors = [finding for finding in self.left_behind(where, blocks=True) if finding.is_error]
        if errors:
            raise PluginError(errors[0].problem, where=where, fix=errors[0].fix)
        problems = self.restore()  # the settings that a killed process left
        if self._kept() is not None:
            raise PluginError(problems[0], where=where, fix=_AS_ROOT)
        kept = self._planned(wishes, owner)
        try:
            kept.write(self.state)
            for change in kept.changes:
                self._set(change)
            self._isolate(kept, wishes.cores)
        except BaseException:  # also Ctrl-C
            self.restore()
            raise

    def restore(self) -> list[str]:
        """Restore the previous settings, if there are any, and return problems.

        Settings that others have changed since are left as they are, and reported. If the kernel refuses, the file of
        state stays.

        Raises:
            PluginError: the file of state cannot be read.
        """
        kept = self._kept()
        if kept is None:
            return []
        problems = []
        refused: list[Change] = []
        for change in reversed(kept.changes):
            path = self.root / change.path
            try:
                now = _setting_in(path)
                if now == change.wanted:
                    path.write_text(change.before, encoding="ascii")
                elif now != change.before:
                    problems.append(f"{path} is {now!r} and not {change.wanted!r}, as it was set: it is left so")
            except OSError as error:
                problems.append(f"{path} cannot be put back to {change.before!r}: {error.strerror}")
                refused.insert(0, change)
        self._free(kept)
        if refused:
            replace(kept, changes=tuple(refused), everything=()).write(self.state)
        else:
            self.state.unlink(missing_ok=True)
        return problems

    def describe(self) -> dict[str, str]:
        """Return how the machine is set up, in words."""
        governors = dict.fromkeys(text_in(path) for path in self._governors())
        turbo = self._turbo()
        cores = sorted(_affinity(os.getpid()))
        kept = self._kept()
        return {
            "governor": enumerated(governors) if governors else "not told",
            "turbo": "not told" if turbo is None else {True: "on", False: "off"}[text_in(turbo[0]) == turbo[1]],
            "cores of this process": ", ".join(map(str, cores)) or "not told",
            "set up by robot-runner": "no" if kept is None else kept.who,
        }

    def drop_caches(self) -> None:
        """Make the kernel write modified data to disk and drop its caches of files; a `PluginError` if it may not."""
        os.sync()
        self._set(Change(_CACHES, "", _ALL_CACHES), is_kept=False)

    def _governors(self) -> list[Path]:
        return sorted((self.root / _CPU).glob("cpufreq/policy*/scaling_governor"))

    def _turbo(self) -> tuple[Path, str, str] | None:
        """Return the file of turbo, and its contents for on and for off."""
        for name, on, off in (("intel_pstate/no_turbo", "0", "1"), ("cpufreq/boost", "1", "0")):
            path = self.root / _CPU / name
            if path.is_file():
                return path, on, off
        return None

    def _governor_findings(self, where: str, wishes: Wishes) -> Iterator[Finding]:
        if wishes.governor is None:
            return
        governors = self._governors()
        if not governors:
            problem = "the CPU governor of this machine cannot be set: a virtual machine, or no cpufreq driver"
            yield Finding.error(where, problem, "Leave governor out.")
        for path in governors[:1]:
            known = text_in(path.with_name("scaling_available_governors")).split()
            if wishes.governor not in known:
                problem = f"there is no governor {wishes.governor!r}"
                yield Finding.error(where, problem, did_you_mean(wishes.governor, known))
            if not os.access(path, os.W_OK):
                yield Finding.error(where, f"{path} cannot be written", _AS_ROOT)

    def _turbo_findings(self, where: str, wishes: Wishes) -> Iterator[Finding]:
        if wishes.turbo is None:
            return
        turbo = self._turbo()
        if turbo is None:
            yield Finding.error(where, "the turbo of this machine cannot be switched", "Leave turbo out.")
        elif not os.access(turbo[0], os.W_OK):
            yield Finding.error(where, f"{turbo[0]} cannot be written", _AS_ROOT)

    def _core_findings(self, where: str, wishes: Wishes) -> Iterator[Finding]:
        if not wishes.cores:
            return
        if not hasattr(os, "sched_setaffinity"):
            yield Finding.error(where, "this system does not let a program choose its cores", "Leave cores out.")
            return
        there = sorted(os.sched_getaffinity(0))
        missing = sorted(set(wishes.cores) - set(there))
        if missing:
            problem = f"there is no core {enumerated(map(str, missing))} for this process"
            yield Finding.error(where, problem, f"Choose among {', '.join(map(str, there))}.")
        elif set(wishes.cores) == set(there):
            problem = f"cores has all {len(there)} cores"
            yield Finding.error(where, problem, "Leave at least one core to everything else.")

    def _planned(self, wishes: Wishes, owner: int | None) -> Kept:
        changes = []
        if wishes.governor is not None:
            changes += [self._change(path, wishes.governor) for path in self._governors()]
        if wishes.turbo is not None and (turbo := self._turbo()) is not None:
            changes.append(self._change(turbo[0], turbo[1] if wishes.turbo else turbo[2]))
        everything = sorted(_affinity(os.getpid())) if wishes.cores else []
        return Kept(
            boot=self._boot(),
            owner=None if owner is None else (owner, started_at(owner)),
            changes=tuple(changes),
            threads=dict(self._threads()) if wishes.cores else {},
            others=tuple(core for core in everything if core not in wishes.cores),
            everything=tuple(everything),
        )

    def _change(self, path: Path, wanted: str) -> Change:
        try:
            return Change(str(path.relative_to(self.root)), _setting_in(path), wanted)
        except OSError as error:
            problem = f"{path} cannot be read: {error.strerror}"
            raise PluginError(problem, where=str(path), fix="Make it readable, or leave its setting out.") from error

    def _set(self, change: Change, *, is_kept: bool = True) -> None:
        path = self.root / change.path
        try:
            path.write_text(change.wanted, encoding="ascii")
            found = text_in(path) if is_kept else change.wanted
        except OSError as error:
            problem = f"{path} cannot be set to {change.wanted!r}: {error.strerror}"
            raise PluginError(problem, where=str(path), fix=_AS_ROOT) from error
        if found != change.wanted:
            problem = f"{path} was set to {change.wanted!r} and is {found!r}"
            fix = "Find out which program sets it as well, such as power-profiles-daemon."
            raise PluginError(problem, where=str(path), fix=fix)

    def _threads(self) -> Iterator[tuple[int, tuple[str, list[int]]]]:
        """Yield each thread that is not the kernel's, with its start and the cores that it may use."""
        for path in (self.root / "proc").glob("[0-9]*/task/[0-9]*"):
            with suppress(ValueError):  # it has ended
                process = ProcessTimes.of_stat(text_in(path / "stat"))
                if not process.is_kernel and (cores := _affinity(process.pid)):
                    yield process.pid, (process.started, sorted(cores))

    def _isolate(self, kept: Kept, cores: tuple[int, ...]) -> None:
        """Keep the experiment on its cores, and other threads off them, as far as that is allowed."""
        if not cores:
            return
        ours = _own_threads()
        for thread, (_, before) in kept.threads.items():
            allowed = [core for core in before if core in (cores if thread in ours else kept.others)]
            if allowed:
                _allow(thread, allowed)

    def _free(self, kept: Kept) -> None:
        """Give each thread its cores back; one that was started since gets all cores."""
        if not kept.everything:
            return
        mine = set(kept.everything) - set(kept.others)
        for thread, (started, now) in self._threads():
            known = kept.threads.get(thread)
            if known is not None and known[0] == started:
                _allow(thread, known[1])
            elif set(now) <= set(kept.others) or set(now) <= mine:  # a new thread, which inherited them
                _allow(thread, list(kept.everything))

    def _kept(self) -> Kept | None:
        """Return the content of the file of state, if it is from since the machine started."""
        kept = Kept.read(self.state)
        return kept if kept is not None and kept.boot == self._boot() else None

    def _boot(self) -> str:
        return text_in(self.root / "proc/sys/kernel/random/boot_id")

    @staticmethod
    def _is_alive(owner: tuple[int, str]) -> bool:
        return bool(owner[1]) and started_at(owner[0]) == owner[1]


def _setting_in(path: Path) -> str:
    """Return what is set now; empty where that is gone, as of a core that was switched off; or raise an `OSError`."""
    try:
        return path.read_text(encoding="ascii", errors="replace").strip()
    except FileNotFoundError:
        return ""


def _own_threads() -> set[int]:
    with suppress(OSError):
        return {int(path.name) for path in Path("/proc/self/task").iterdir()}
    return {os.getpid()}


def _affinity(thread: int) -> set[int]:
    with suppress(OSError, AttributeError):
        return set(os.sched_getaffinity(thread))
    return set()


def _allow(thread: int, cores: list[int]) -> None:
    with suppress(OSError):  # the thread has ended, or belongs to another user
        os.sched_setaffinity(thread, cores)
