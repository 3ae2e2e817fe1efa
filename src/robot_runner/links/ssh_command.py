"""The system's own OpenSSH client: how it is called, and what its complaints ask for."""

from __future__ import annotations

import shutil
import subprocess
from typing import TYPE_CHECKING

from robot_runner.errors import Finding, LinkError

if TYPE_CHECKING:
    from pathlib import Path

__all__ = ["checked_destination", "complaint", "execute", "remedy", "ssh_command", "ssh_findings"]

#: Never ask a person; notice within 15 s that the other end is gone; leave out what the user's config may forward.
_OPTIONS = (
    *("-T", "-x", "-a"),
    *("-o", "BatchMode=yes"),
    *("-o", "ConnectTimeout=10"),
    *("-o", "ServerAliveInterval=5"),
    *("-o", "ServerAliveCountMax=3"),
    *("-o", "ClearAllForwardings=yes"),
    *("-o", "RemoteCommand=none"),
    *("-o", "LogLevel=ERROR"),
)
_CHECK_SECONDS = 15.0

_INSTALL = "Install the OpenSSH client (Debian, Ubuntu: sudo apt install openssh-client)."
_REMEDIES = (
    ("permission denied", "Give it this machine's key: ssh-copy-id {host}."),
    ("host key verification failed", "Connect once by hand, and say yes to its key: ssh {host}."),
    (
        "remote host identification has changed",
        "Find out why its key changed, then: ssh-keygen -R followed by its name.",
    ),
    ("could not resolve hostname", "Look at the name, and at the network."),
    ("connection refused", "Start the SSH server there (Debian, Ubuntu: sudo apt install openssh-server)."),
    ("timed out", "Look whether it is switched on, and at the network."),
    ("no route to host", "Look whether it is switched on, and at the network."),
)
_REMEDY = "Try it by hand: ssh {host} true."


def checked_destination(host: str) -> str:
    """Return the host as ssh takes it: `robot`, `pi@robot` or `ssh://pi@robot:2222`.

    Raises:
        LinkError: it is empty, holds blanks, or would pass for an option of ssh.

    Example:
        >>> checked_destination("pi@robot")
        'pi@robot'
    """
    if not host or host.startswith("-") or any(character.isspace() or character == "\0" for character in host):
        raise LinkError(
            f"{host!r} is no host that ssh could connect to",
            where="host",
            fix="Name it as for ssh: 'robot', 'pi@robot' or 'ssh://pi@robot:2222'; this machine is 'localhost'.",
        )
    return host


def ssh_command(host: str, remote: str, *, config: Path | None = None) -> list[str]:
    """Return the command line that executes `remote` on a host, with the user's ssh config or the one given.

    Raises:
        LinkError: the host's name cannot be.

    Example:
        >>> ssh_command("pi@robot", "true")[-3:]
        ['--', 'pi@robot', 'true']
    """
    own = [] if config is None else ["-F", str(config)]
    return ["ssh", *own, *_OPTIONS, "--", checked_destination(host), remote]


def remedy(host: str, complaint: str) -> str:
    """Return what mends what ssh complains of.

    Example:
        >>> remedy("pi@robot", "pi@robot: Permission denied (publickey).")
        "Give it this machine's key: ssh-copy-id pi@robot."
    """
    text = complaint.lower()
    known = (fix for sign, fix in _REMEDIES if sign in text)
    return next(known, _REMEDY).format(host=host)


def ssh_findings(where: str, host: str, *, config: Path | None = None) -> list[Finding]:
    """Return what stands in the way of executing something on a host: it is tried, and changes nothing there.

    Args:
        where: the plugin that asks.
        host: as ssh takes it.
        config: a file to take the place of the user's ssh config.
    """
    try:
        command = ssh_command(host, "exit 0", config=config)
    except LinkError as error:
        return [Finding.error(where, error.problem, error.fix)]
    if shutil.which("ssh") is None:
        return [Finding.error(where, f"{host} is reached by ssh, which is not installed", _INSTALL)]
    if config is not None and not config.is_file():
        return [Finding.error(where, f"there is no ssh config {config}", "Name a file that is there.")]
    problem = _tried(command)
    return (
        [] if problem is None else [Finding.error(where, f"{host} cannot be reached: {problem}", remedy(host, problem))]
    )


def _tried(command: list[str]) -> str | None:
    """Execute a command and return why it failed, or None if it did not."""
    try:
        return complaint(execute(command, timeout=_CHECK_SECONDS))
    except subprocess.TimeoutExpired:
        return f"it timed out after {_CHECK_SECONDS:g} s"


def execute(command: list[str], *, timeout: float) -> subprocess.CompletedProcess[bytes]:
    """Execute a command of `ssh_command` to its end, with nothing to read, for so many seconds at most.

    Raises:
        OSError: it cannot be started.
        subprocess.TimeoutExpired: it takes longer.
    """
    return subprocess.run(  # noqa: S603 - an argument list; the host's name was checked
        command,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        timeout=timeout,
        check=False,
        start_new_session=True,
    )


def complaint(done: subprocess.CompletedProcess[bytes]) -> str | None:
    """Return why a command failed, or None if it did not."""
    if done.returncode == 0:
        return None
    said = done.stderr.decode(errors="replace").strip().splitlines()
    return said[-1] if said else f"ssh ended with code {done.returncode}"
