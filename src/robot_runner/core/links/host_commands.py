"""Commands, copies and fetching on a host, here or over ssh: the same way, with different shells."""

from __future__ import annotations

import math
import shlex
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryFile
from typing import Protocol

from robot_runner.core.errors import CommandError, LinkError, did_you_mean
from robot_runner.core.events.context import RobotRunnerContext
from robot_runner.core.events.resources import CommandResult
from robot_runner.core.links.archived_files import TAR_MARGIN, Unpacked, pack, unpack
from robot_runner.core.links.declared_host import FETCHABLE, Host, is_fetchable
from robot_runner.core.links.host_program import MOST_KEPT, Ended, Program, last_lines, shell_path, shortened
from robot_runner.core.links.ssh_command import LET_EXECUTE, KeptConnection, for_any_shell
from robot_runner.core.secret_names import without_environment_secrets
from robot_runner.core.storage.guarded_files import make_folder, open_to_append
from robot_runner.core.words import shown_duration

_LAST_LINES = 5
#: The exit status of ssh where the connection fails; a command may have it, too.
_SSH_FAILED = 255
#: The exit status of a fetching shell where nothing matches.
_NOTHING = 66

# The command gets a session of its own, where the host can do that, so that it is ended with all that it started once
# our end of the input is closed: at the deadline, and when this process, or the connection, is gone.
_SUPERVISE = """\
s=; command -v setsid >/dev/null 2>&1 && s=setsid
cd "$HOME" 2>/dev/null
exec 3<&0
$s sh -c "$1" </dev/null 3<&- & job=$!
{ while read -r _; do :; done; trap '' TERM
kill -TERM "-$job" || kill -TERM "$job"; sleep 1
kill -KILL "-$job" || kill -KILL "$job"; } <&3 >/dev/null 2>&1 &
watch=$!
exec 3<&- 2>/dev/null
wait "$job"; status=$?
kill "$watch" 2>/dev/null
exit "$status"
"""
# Names are made relative to the root folder, so that tar has nothing to strip, and no name looks like an option.
_ARCHIVE = """\
set -- {pattern}
[ -e "$1" ] || [ -L "$1" ] || exit {nothing}
for f do shift; set -- "$@" ".$f"; done
cd / && exec tar -cf - "$@"
"""


class Shell(Protocol):
    """Starts shells on a host."""

    def is_connected(self) -> bool:
        """Return whether the host is still connected; asked after a failing command."""

    def command(self, remote: str, *, within_s: float) -> list[str]:
        """Return the command line by which the host's `sh` executes `remote`; connect within so many s."""

    def close(self) -> None:
        """Disconnect from the host; closing twice does nothing."""


class _LocalShell:
    def is_connected(self) -> bool:
        return True

    def command(self, remote: str, *, within_s: float) -> list[str]:
        del within_s
        return ["/bin/sh", "-c", for_any_shell(remote)]

    def close(self) -> None:
        pass


def open_shell(host: Host) -> Shell:
    """Return the `Shell` of a host, which connects once it is needed."""
    return _LocalShell() if host.is_local else KeptConnection(host.address, host.ssh_config)


@dataclass(slots=True)
class _OpenedHost:
    """A host as all callbacks of a run share it: its shell, and how many bytes may still be fetched."""

    shell: Shell
    room: int

    def close(self) -> None:
        self.shell.close()


class HostCommands:
    """A host in a run; see `HostAccess`."""

    def __init__(self, name: str, host: Host, opened: _OpenedHost, context: RobotRunnerContext) -> None:
        self.shell = opened.shell
        self._opened = opened
        self._name = name
        self._host = host
        self._context = context

    def run(self, command: str | Sequence[str], *, timeout_s: float = 60.0, check: bool = True) -> CommandResult:
        """Execute a command to its end; see `HostAccess.run`."""
        text = command if isinstance(command, str) else shlex.join(map(str, command))
        program = Program(self._line(timeout_s, _SUPERVISE, text), has_lifeline=True)
        ended = program.follow(timeout_s)
        result = CommandResult(text, ended.exit_status, ended.output, ended.errors, ended.seconds)
        self._keep(result, is_in_time=ended.is_in_time)
        if ended.is_cut:
            problem = f"{shortened(text)!r} wrote more than {MOST_KEPT // 1_000_000} MB, of which the rest is not kept"
            self._warn(problem, "Have it write to a file there, and fetch that.")
        if not ended.is_in_time:
            raise self._failed(result, f"did not end within {timeout_s:g} s")
        self._refuse_unexecuted(ended, f"while {shortened(text)!r} was executed")
        if check and not result.is_success:
            raise self._failed(result, f"ended with exit status {result.exit_status}")
        return result

    def copy_to(self, source: Path | str, destination: str, *, timeout_s: float = 60.0) -> None:
        """Copy a file or a folder to the host; see `HostAccess.copy_to`."""
        local = Path(source)
        if not local.exists():
            fix = "Name a file or folder that is there."
            raise LinkError(f"there is no {local} to copy", where=self._name, fix=fix)
        above, _, name = destination.rstrip("/").rpartition("/")
        if not destination.startswith(("/", "~/")) or name in {"", "~", ".", ".."}:
            fix = "Give the whole path that it is to have there: '/...', or '~/...' in the home folder."
            raise LinkError(f"{destination!r} names no file", where=self._name, fix=fix)
        folder = shell_path(f"{above}/")
        script = f"mkdir -p {folder} && cd {folder} && rm -rf {shlex.quote(f'./{name}')} && exec tar -xf -"
        with TemporaryFile() as archive:
            try:
                pack(local, name, archive)
            except OSError as error:
                problem = f"{local} was not copied to {destination}: {error}"
                fix = "See that it can be read and is not written meanwhile, and that there is room for a copy here."
                raise LinkError(problem, where=self._name, fix=fix) from error
            ended = Program(self._line(timeout_s, script), source=archive).follow(timeout_s)
        self._refuse_unexecuted(ended, f"while {local} was copied")
        if ended.exit_status or not ended.is_in_time:
            why = last_lines(ended.errors, 1) if ended.is_in_time else f"it took longer than {timeout_s:g} s"
            fix = "Look at the path, the permissions and the room there."
            raise LinkError(f"{local} was not copied to {destination}: {why}", where=self._name, fix=fix)

    def fetch(self, *patterns: str, timeout_s: float = 60.0) -> list[Path]:
        """Fetch files into the run's folder; see `HostAccess.fetch`."""
        deadline = time.monotonic() + self._checked(timeout_s)
        came: list[Path] = []
        for pattern in map(str, patterns):
            if not is_fetchable(pattern):
                self._warn(f"{pattern!r} was not fetched: it is not a whole path there", FETCHABLE)
                continue
            seconds = deadline - time.monotonic()
            if seconds <= 0:
                self._warn(f"{pattern} was not fetched: {timeout_s:g} s were over", "Allow it more time.")
                continue
            came += self._fetched(pattern, seconds).files
        return came

    def _fetched(self, pattern: str, seconds: float) -> Unpacked:
        folder = self._folder
        most = self._opened.room
        script = _ARCHIVE.format(pattern=shell_path(pattern, is_pattern=True), nothing=_NOTHING)
        with TemporaryFile(dir=folder.parent) as archive:
            ended = Program(self._line(seconds, script), target=archive, most=most + TAR_MARGIN).follow(seconds)
            self._refuse_unexecuted(ended, f"while {pattern} was fetched")
            if ended.exit_status == _NOTHING:
                self._warn(f"there is no {pattern} to fetch", "Look at the path, and at what was to write it.")
                return Unpacked()
            unpacked = unpack(archive, folder, most)
        self._opened.room -= unpacked.size
        for problem in unpacked.problems:
            self._warn(f"of {pattern}, {problem}", "Fetch it by hand if it is needed.")
        if ended.is_too_much or unpacked.is_too_much:
            why = f"no more than {self._host.largest_fetch_mb:g} MB come of a run"
            self._warn(f"{pattern} was not fetched whole: {why}", "Raise largest_fetch_mb.")
        elif not ended.is_in_time:
            self._warn(f"{pattern} was not fetched whole within {seconds:.3g} s", "Allow it more time.")
        elif ended.exit_status:
            self._warn(f"{pattern} was not fetched whole: {last_lines(ended.errors, 1)}", "Look at its permissions.")
        return unpacked

    @property
    def _folder(self) -> Path:
        folder = self._context.run_folder / self._name
        make_folder(folder, self._context.experiment_folder)
        return folder

    def _line(self, seconds: float, program: str, *arguments: str) -> list[str]:
        if any("\0" in word for word in (program, *arguments)):
            problem = "no word of a command or path can hold a NUL character"
            raise LinkError(problem, where=self._name, fix="Leave it out.")
        remote = shlex.join(["exec", "sh", "-c", program, "robot-runner", *arguments])
        return self.shell.command(remote, within_s=self._checked(seconds))

    def _checked(self, timeout_s: float) -> float:
        if isinstance(timeout_s, bool) or not isinstance(timeout_s, int | float) or math.isnan(timeout_s):
            raise LinkError(f"timeout_s is {timeout_s!r}", where=self._name, fix="Give it a number of seconds.")
        return timeout_s

    def _warn(self, problem: str, fix: str) -> None:
        self._context.warn(f"host {self._name}: {problem}", fix=fix)

    def _keep(self, result: CommandResult, *, is_in_time: bool) -> None:
        """Append a command and what it wrote to the host's log of the run."""
        how = f"exit status {result.exit_status}" if is_in_time else "it did not end in time, and was ended"
        text = f"$ {result.command}\n{_whole_lines(result.output)}{_whole_lines(result.errors)}"
        with open_to_append(self._folder / "commands.log", self._context.experiment_folder) as file:
            said = f"{without_environment_secrets(text)}[{how}, {shown_duration(result.seconds)}]\n"
            file.write(said.encode("utf-8", "backslashreplace"))

    def _refuse_unexecuted(self, ended: Ended, meanwhile: str) -> None:
        if ended.exit_status == _SSH_FAILED and not self.shell.is_connected():
            said = last_lines(ended.errors, 1)
            problem = f"the connection was lost {meanwhile}{f': {said}' if said else ''}"
            raise LinkError(problem, where=self._name, fix="Check whether it is switched on, and at the network.")
        if ended.is_in_time and not ended.has_begun:
            said = last_lines(ended.errors or ended.output, 1)
            problem = f"the host did not execute the command{f': {said}' if said else ''}"
            raise LinkError(problem, where=self._name, fix=LET_EXECUTE)

    def _failed(self, result: CommandResult, how: str) -> CommandError:
        said = last_lines(result.errors or result.output, _LAST_LINES)
        problem = f"{shortened(result.command)!r} {how}{f': {said}' if said else ''}"
        fix = "Look at commands.log in the host's folder of the run, or allow it more time (timeout_s)."
        return CommandError(problem, where=self._name, fix=fix)


def _whole_lines(text: str) -> str:
    return text if not text or text.endswith("\n") else f"{text}\n"


def opened_host(hosts: Mapping[str, Host], name: str, context: RobotRunnerContext) -> HostCommands:
    """Return the host of this name; all callbacks of a run share its connection.

    Raises:
        LinkError: the config names no such host; the nearest is named.
    """
    host = hosts.get(name)
    if host is None:
        fix = did_you_mean(name, hosts) or f"Name it in the config: hosts = {{{name!r}: 'pi@robot'}}."
        raise LinkError(f"there is no host {name!r}", where="hosts", fix=fix)
    opened = context.resources.open(f"host {name}", lambda: _OpenedHost(open_shell(host), host.most_bytes))
    return HostCommands(name, host, opened, context)
