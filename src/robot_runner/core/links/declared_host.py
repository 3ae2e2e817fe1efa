"""The hosts of a config: how each is reached, what is fetched from it, when it is rebooted."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Any

from robot_runner.core.design.numeric_range import is_number
from robot_runner.core.errors import ConfigError, Finding, LinkError
from robot_runner.core.events.condition import Condition

#: The name of this machine as a host.
LOCAL = "localhost"
#: A host's name names a folder in each run's folder.
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}")
_LOCAL = frozenset({LOCAL, "local"})
_MEGABYTE = 1_000_000


#: What a path has to be that is fetched.
FETCHABLE = "Begin the path with '/' or, for the home folder there, '~/'."


def is_fetchable(pattern: object) -> bool:
    """Return whether a pattern can name files of a host."""
    return isinstance(pattern, str) and pattern.startswith(("/", "~/")) and "\0" not in pattern


class Reboot(Enum):
    """When a host is rebooted: never, before the first run, where a block begins, or before each run."""

    NEVER = "never"
    ONCE = "once"
    PER_BLOCK = "per_block"
    PER_RUN = "per_run"


@dataclass(frozen=True, slots=True, kw_only=True)
class Host:
    """A computer that takes part in an experiment: `context.host(name)` executes commands there.

    Attributes:
        address: `"local"` for this machine; any other as for ssh: `"robot"`, `"pi@robot"`, `"ssh://pi@robot:2222"`.
        ssh_config: replaces your ssh config; relative to where the program is started.
        fetch: result files, which are fetched when a run stops, also a failed one.
        fetch_within_s: how long that may take, s; after a failure no longer than the config's `grace_in_s` leaves.
        largest_fetch_mb: how much may be fetched of one run, in millions of bytes.
        reboot: when it is rebooted.
        reboot_command: reboots it.
        back_within_s: how long it may take until it answers again, s.
        ready: a condition that must hold after it answers, before the next run begins.

    Raises:
        ConfigError: values are invalid; `findings` lists all of them.

    Example:
        >>> Host(address="pi@robot", fetch=["~/.ros/log/latest/*.log"]).is_local
        False
    """

    address: str
    ssh_config: Path | None = None
    fetch: tuple[str, ...] = ()
    fetch_within_s: float = 60.0
    largest_fetch_mb: float = 1000.0
    reboot: Reboot = Reboot.NEVER
    reboot_command: str = "sudo -n reboot"
    back_within_s: float = 300.0
    ready: Condition | None = field(default=None)

    def __post_init__(self) -> None:
        set_to = object.__setattr__
        is_one = isinstance(self.fetch, str) or not isinstance(self.fetch, Iterable)
        several = (self.fetch,) if is_one else self.fetch
        set_to(self, "fetch", tuple(str(each) if isinstance(each, Path) else each for each in several))
        if isinstance(self.ssh_config, str | Path):
            set_to(self, "ssh_config", Path(os.path.expanduser(self.ssh_config)))  # noqa: PTH111  # as of an unknown user
        ConfigError.refuse(self._findings())

    @property
    def is_local(self) -> bool:
        """Whether it is this machine."""
        return self.address in _LOCAL

    @property
    def most_bytes(self) -> int:
        """How many bytes may be fetched of one run."""
        return int(self.largest_fetch_mb * _MEGABYTE)

    def _findings(self) -> Iterator[Finding]:
        where = f"Host({self.address!r})"
        if (refused := _refused(self.address)) is not None:
            yield Finding.error(where, refused.problem, refused.fix)
        for name in ("fetch_within_s", "largest_fetch_mb", "back_within_s"):
            value = getattr(self, name)
            if not is_number(value) or value <= 0:
                yield Finding.error(where, f"{name} is {value!r}", f"Give {name} a number above 0.")
        if not isinstance(self.ssh_config, Path | None):
            yield Finding.error(where, f"ssh_config is {self.ssh_config!r}", "Name a file.")
        if not isinstance(self.ready, Condition | None):
            yield Finding.error(where, f"ready is {self.ready!r}", "Give a condition, as a Gate takes one.")
        for pattern in self.fetch:
            if not is_fetchable(pattern):
                yield Finding.error(where, f"fetch names {pattern!r}", FETCHABLE)
        yield from self._reboot_findings(where)

    def _reboot_findings(self, where: str) -> Iterator[Finding]:
        if not isinstance(self.reboot, Reboot):
            kinds = ", ".join(f"Reboot.{each.name}" for each in Reboot)
            yield Finding.error(where, f"reboot is {self.reboot!r}", f"Give one of {kinds}.")
        elif self.reboot is not Reboot.NEVER and self.is_local:
            fix = "Leave reboot out: this machine executes the experiment."
            yield Finding.error(where, f"reboot is Reboot.{self.reboot.name} for this machine", fix)
        elif self.reboot is not Reboot.NEVER and not (self.reboot_command and isinstance(self.reboot_command, str)):
            fix = "Give the command that restarts it there."
            yield Finding.error(where, f"reboot_command is {self.reboot_command!r}", fix)


def are_hosts(value: Any) -> bool:
    """Whether a value can be the config's `hosts`: names with addresses or `Host(...)`."""
    return isinstance(value, Mapping) and all(
        isinstance(name, str) and _NAME.fullmatch(name) and (isinstance(each, Host) or _refused(each) is None)
        for name, each in value.items()
    )


def _refused(address: Any) -> LinkError | None:
    from robot_runner.core.links.ssh_command import checked_destination  # noqa: PLC0415 - slow, and seldom needed

    try:
        checked_destination(address if isinstance(address, str) else "")
    except LinkError as error:
        return error
    return None


def named_hosts(value: Mapping[str, str | Host]) -> dict[str, Host]:
    """Return well-formed hosts by name, each as a `Host`."""
    return {name: each if isinstance(each, Host) else Host(address=each) for name, each in value.items()}


def host_findings(where: str, name: str, host: Host, robot: str | None) -> list[Finding]:
    """Return findings on why a host cannot be used; it is tried without changing anything there."""
    from robot_runner.core.links.ssh_command import ssh_findings  # noqa: PLC0415 - slow, and seldom needed

    place = f"{where}.hosts[{name!r}]"
    found = [] if host.is_local else ssh_findings(place, host.address, config=host.ssh_config)
    if host.ready is not None:
        found += host.ready.check(robot)
    return found
