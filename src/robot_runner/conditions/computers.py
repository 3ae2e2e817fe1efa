"""Conditions of computers, here or over ssh: a process is there, a host answers, its processor is throttled."""

from __future__ import annotations

import os
import re
import shutil
from abc import abstractmethod
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, replace
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from robot_runner.core.errors import ConditionError, Finding, LinkError, Severity
from robot_runner.core.events.condition import Condition, Look, LookAgain
from robot_runner.core.events.context import RobotRunnerContext, SystemClock
from robot_runner.core.links.declared_host import LOCAL
from robot_runner.core.links.ssh_command import checked_destination, ssh_findings
from robot_runner.measuring.host import process_selector

if TYPE_CHECKING:  # loaded once a computer is looked at: naming a condition does not need them
    from robot_runner.measuring.local_host import LocalHost
    from robot_runner.measuring.ssh_host import SshHost

_PSUTIL = "Install it: pip install 'robot-runner[psutil]'."


@dataclass(frozen=True)
class ComputerName:
    """A computer, and how it is reached.

    Attributes:
        host: `localhost` for this machine, or as ssh takes it.
        ssh_config: a file to take the place of the user's ssh config.

    Raises:
        LinkError: the name cannot be that of a host.
    """

    host: str = LOCAL
    ssh_config: Path | None = None

    @classmethod
    def named(cls, host: str, ssh_config: str | Path | None) -> ComputerName:
        """Return the computer that a user names."""
        if host != LOCAL:
            checked_destination(host)
        return cls(host, None if ssh_config is None else Path(ssh_config).expanduser())

    def __str__(self) -> str:
        return "this machine" if self.host == LOCAL else self.host

    @property
    def every_s(self) -> float:
        """How often it is looked at, s; another computer less often, as each look disturbs what is measured there."""
        return 0.5 if self.host == LOCAL else 2.0

    def open(self, opened: ExitStack) -> LocalHost | SshHost:
        """Return a link that no profiler shares; it connects at first use."""
        from robot_runner.measuring.local_host import LocalHost  # noqa: PLC0415  # see above
        from robot_runner.measuring.ssh_host import SshHost  # noqa: PLC0415  # see above

        clock = SystemClock()
        link = LocalHost(clock) if self.host == LOCAL else SshHost(self.host, clock, config=self.ssh_config)
        opened.callback(link.close)
        return link

    def check(self, what: str) -> Iterator[Finding]:
        """Yield findings on why the computer cannot be reached; `what` is the condition."""
        if self.host == LOCAL:
            return
        can_ever = shutil.which("ssh") is not None and (self.ssh_config is None or self.ssh_config.is_file())
        for finding in ssh_findings(f"condition {what!r}", self.host, config=self.ssh_config):
            # A computer that is switched off now may be what is waited for.
            yield replace(finding, severity=Severity.WARNING) if can_ever else finding


def process_running(process: str | int, *, host: str = LOCAL, ssh_config: str | Path | None = None) -> Condition:
    """Return the condition that a process is there; one that has ended and was not reaped yet is not.

    Args:
        process: its name, its number, or `node:/talker` (a ROS node, by the name on its command line).
        host: the computer, as ssh takes it; left out, this machine.
        ssh_config: a file to take the place of the user's ssh config.

    Raises:
        ConditionError: it is software under test, whose processes only profilers find.
        LinkError: the process or the host cannot be named so.

    Example:
        >>> print(process_running("talker", host="pi@robot"))
        the process talker is there on pi@robot
    """
    selector = process_selector(process)
    if selector.startswith("subject:"):
        fix = "Give its program's name or number, or node:/name."
        raise ConditionError(f"{process!r} is for profilers", where="process_running", fix=fix)
    return _ProcessRunning(selector, ComputerName.named(host, ssh_config))


def host_answers(host: str, *, ssh_config: str | Path | None = None) -> Condition:
    """Return the condition that a computer answers over ssh.

    Args:
        host: the computer, as ssh takes it.
        ssh_config: a file to take the place of the user's ssh config.

    Raises:
        LinkError: the host cannot be named so.

    Example:
        >>> print(host_answers("pi@robot"))
        pi@robot answers
    """
    return _HostAnswers(ComputerName.named(host, ssh_config))


def throttled(*, host: str = LOCAL, ssh_config: str | Path | None = None) -> Condition:
    """Return the condition that the processor of a computer is throttled, because of heat or of its power supply.

    It is read from Linux's counters of thermal throttling, and from the firmware of a Raspberry Pi.

    Args:
        host: the computer, as ssh takes it; left out, this machine.
        ssh_config: a file to take the place of the user's ssh config.

    Raises:
        LinkError: the host cannot be named so.

    Example:
        >>> print(throttled(host="pi@robot"))
        the processor of pi@robot is throttled
    """
    return _Throttled(ComputerName.named(host, ssh_config))


class _OfComputer(Condition):
    """A condition of one computer; connecting is tried again while it fails."""

    computer: ComputerName
    is_outside = True
    #: Whether it is known not to hold where the computer does not answer.
    silence_tells: ClassVar[bool] = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "every_s", self.computer.every_s)

    def check(self, robot: str | None) -> Iterable[Finding]:
        del robot
        yield from self.computer.check(str(self))

    def watch(self, context: RobotRunnerContext, opened: ExitStack) -> LookAgain:
        del context
        look_at = self.looker(self.computer.open(opened))

        def look() -> Look:
            try:
                return look_at()
            except LinkError as error:
                return Look(holds=False, seen=f"{self.computer}: {error.problem}", is_known=self.silence_tells)

        return look

    @abstractmethod
    def looker(self, link: LocalHost | SshHost) -> Callable[[], Look]:
        """Return a function that looks; it may raise a LinkError."""


@dataclass(frozen=True)
class _ProcessRunning(_OfComputer):
    selector: str
    computer: ComputerName

    def __str__(self) -> str:
        kind, _, value = self.selector.partition(":")
        named = {"pid": "process", "name": "the process", "node": "the process of node"}[kind]
        return f"{named} {value} is there{'' if self.computer.host == LOCAL else f' on {self.computer}'}"

    def check(self, robot: str | None) -> Iterable[Finding]:
        yield from super().check(robot)
        if self.computer.host == LOCAL and not Path("/proc/self/stat").exists() and find_spec("psutil") is None:
            problem = "psutil, which lists the processes here, is missing"
            yield Finding.error(f"condition {str(self)!r}", problem, _PSUTIL)

    def looker(self, link: LocalHost | SshHost) -> Callable[[], Look]:
        def look() -> Look:
            pids = self._found(link)
            shown = ", ".join(map(str, pids[:3])) + (" and others" if len(pids) > 3 else "")  # noqa: PLR2004
            return Look(bool(pids), f"process {shown}" if pids else "no such process", len(pids))

        return look

    def _found(self, link: LocalHost | SshHost) -> list[int]:
        from robot_runner.measuring.local_host import LocalProcesses, matches  # noqa: PLC0415  # see above

        kind, _, value = self.selector.partition(":")
        listed = link.list_files(f"/proc/{value if kind == 'pid' else '[0-9]*'}/stat")
        if self.computer.host == LOCAL and not listed and not Path("/proc/self/stat").exists():
            return sorted(each.pid for each in LocalProcesses(import_module("psutil"), [self.selector]).counters())
        folders = [path.removesuffix("/stat") for path in listed]
        texts = link.read_files([*listed, *(f"{folder}/cmdline" for folder in folders)]) if listed else []
        states, lines = texts[: len(folders)], texts[len(folders) :]
        pids = [int(folder.rpartition("/")[2]) for folder in folders]
        known = zip(pids, states, lines, strict=True)
        return sorted(
            pid
            for pid, state, line in known
            if (name := _name_of_alive(state or "")) is not None
            and matches(self.selector, pid, name, [word for word in (line or "").split("\0") if word])
        )


def _name_of_alive(state: str) -> str | None:
    """Return the name of a process from its stat: pid, (name), state (proc_pid_stat(5)); None if it has ended."""
    name, _, rest = state.partition("(")[2].rpartition(")")
    return None if rest.strip()[:1] in {"", "Z", "X"} else name


@dataclass(frozen=True)
class _HostAnswers(_OfComputer):
    computer: ComputerName
    silence_tells: ClassVar[bool] = True

    def __str__(self) -> str:
        return f"{self.computer} answers"

    def looker(self, link: LocalHost | SshHost) -> Callable[[], Look]:
        def look() -> Look:
            link.read_files([os.devnull])
            return Look(holds=True, seen=f"{self.computer} answers")

        return look


#: The throttling state of a Raspberry Pi's firmware. Bit 0 is under-voltage, bits 1 to 3 are frequency capped,
#: throttled and soft temperature limit, all at this moment. Source: Raspberry Pi documentation, vcgencmd get_throttled.
#: On a Raspberry Pi 5 it is `soc@107c000000` (raspberrypi/linux, bcm2712.dtsi).
_FIRMWARE = "/sys/devices/platform/soc*/soc*:firmware/get_throttled"
_HELD_BACK_NOW = 0b1111
_COUNTERS = "/sys/devices/system/cpu/cpu[0-9]*/thermal_throttle/*_throttle_count"


@dataclass(frozen=True)
class _Throttled(_OfComputer):
    computer: ComputerName

    def __str__(self) -> str:
        return f"the processor of {self.computer} is throttled"

    def looker(self, link: LocalHost | SshHost) -> Callable[[], Look]:
        before: dict[str, int] = {}

        def look() -> Look:
            nonlocal before
            firmware, counters = link.list_files(_FIRMWARE)[:1], link.list_files(_COUNTERS)
            texts = link.read_files([*firmware, *counters])
            flags, counts = (texts[0] if firmware else None), texts[len(firmware) :]
            if flags is None and not counts:
                seen = f"{self.computer} does not report whether its processor is throttled"
                return Look(holds=False, seen=seen, is_known=False)
            told = {path: int(text) for path, text in zip(counters, counts, strict=True) if text and text.isdigit()}
            # A core that came online again has counted before; and each core counts the events of all of them.
            grown = max((count - before.get(path, count) for path, count in told.items()), default=0)
            before |= told
            now = int(flags, 16) & _HELD_BACK_NOW if re.fullmatch(r"(0x)?[0-9a-fA-F]+", flags or "") and flags else 0
            is_held_back = bool(now) or grown > 0
            how = f"throttled (firmware {now:#x}, counted {max(grown, 0)} times since the look before)"
            return Look(is_held_back, how if is_held_back else "not throttled", is_held_back)

        return look
