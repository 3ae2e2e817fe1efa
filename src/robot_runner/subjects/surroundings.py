"""Where a subject is executed: the computer, the folder, the environment, and the file that is sourced first."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, Self

from robot_runner.core.design.revision import Revision
from robot_runner.core.errors import Finding, LinkError, PluginError, StorageError
from robot_runner.core.links.connect import graph_of_robot, is_simulated
from robot_runner.core.links.declared_host import LOCAL
from robot_runner.core.links.ssh_command import checked_destination, execute, ssh_command, ssh_findings
from robot_runner.core.storage.git_repository import repository_state
from robot_runner.core.storage.input_files import kept_copy
from robot_runner.core.storage.layout import user_folder
from robot_runner.core.words import enumerated
from robot_runner.subjects.supervised_program import NAME_A_FOLDER

#: How long a query of a program may take, s: roslaunch needs one second here and several on a small computer.
_PATIENCE = 30.0
_NO_PROGRAM = 127  # the exit code of a shell for a program that it does not find
#: Distinguishes our own answers from what a login shell writes because of its ~/.bashrc.
_LACKS = "robot-runner-lacks"


class Answer(NamedTuple):
    """The answer of a program to a query.

    Attributes:
        code: its exit code; None where it took too long, or could not be started.
        said: what it wrote to stdout.
        complaint: what it wrote to stderr, or why it could not be started.
    """

    code: int | None
    said: str
    complaint: str


def cache_findings(where: str) -> Iterator[Finding]:
    """Yield that the user's folder of caches cannot be made or written: locks and work trees are kept there."""
    try:
        folder = user_folder("XDG_CACHE_HOME")
    except StorageError as error:
        yield Finding.error(where, error.problem, error.fix)
        return
    existing = next(each for each in (folder, *folder.parents) if os.path.exists(each))  # noqa: PTH110 - others' homes
    if not (existing.is_dir() and os.access(existing, os.W_OK | os.X_OK)):
        yield Finding.error(where, f"your folder of caches, {folder}, cannot be written", NAME_A_FOLDER)


@dataclass(frozen=True, slots=True)
class Surroundings:
    """Where a subject is executed.

    Attributes:
        folder: a path, or a value that becomes one, such as a revision, which is built when the experiment begins.
        host: another computer in one of ssh's forms; None for this one.
    """

    folder: Any
    environment: Mapping[str, str | None]
    setup: str | None
    host: str | None
    ssh_config: Path | None

    @classmethod
    def of(
        cls,
        plugin: str,
        *,
        folder: Any,
        environment: Mapping[str, Any],
        setup: str | Path | None,
        host: str | None,
        ssh_config: str | Path | None,
    ) -> Self:
        """Return the surroundings that a config names; raise a `PluginError` if a parameter is invalid."""
        if folder is not None and not isinstance(folder, str | os.PathLike):
            fix = "Give a path, or bind it to Factor.revisions(...)."
            raise PluginError(f"folder is {folder!r}", where=plugin, fix=fix)
        if not isinstance(environment, Mapping):
            fix = "Give a mapping: {'NAME': value}."
            raise PluginError(f"environment is {environment!r}", where=plugin, fix=fix)
        host = None if host == LOCAL else host
        try:
            checked_destination(host or LOCAL)
        except LinkError as error:
            raise PluginError(error.problem, where=plugin, fix=error.fix) from error
        if host is None and ssh_config is not None:
            raise PluginError("ssh_config is given, and no host", where=plugin, fix="Leave ssh_config out.")
        for name in environment:
            if not isinstance(name, str) or not name or {"=", "\0"} & set(name):
                fix = "Give a mapping: {'NAME': value}."
                raise PluginError(f"a variable of environment cannot be named {name!r}", where=plugin, fix=fix)
        variables = {name: None if value is None else word(plugin, value) for name, value in environment.items()}
        config = None if ssh_config is None else Path(ssh_config).expanduser()
        return cls(folder, variables, None if setup is None else str(setup), host, config)

    @property
    def path(self) -> str | None:
        """The folder's path; None for the default."""
        if self.folder is None:
            return None
        path = os.fspath(self.folder)
        if self.host is not None:
            return str(path)
        own = Path(str(path)).expanduser()
        return str(kept_copy(own) or own)

    @property
    def own_folder(self) -> Path | None:
        """The folder as it is named; None where none is named, or where it is another computer's or a revision's."""
        is_own = self.folder is not None and self.host is None and not isinstance(self.folder, Revision)
        return Path(os.fspath(self.folder)).expanduser() if is_own else None

    def own_path(self, name: str) -> Path | None:
        """Return a path that is relative to the folder as one that is valid here.

        None where it is on another computer, or in the work tree of a revision, which is kept as a whole.
        """
        path = Path(name)
        if self.host is not None or (isinstance(self.folder, Revision) and not path.is_absolute()):
            return None
        return (self.own_folder or Path()) / path

    def found(self, word: str) -> str:
        """Return a word of a command or of the environment; a file of which a package has a copy is named as that copy.

        Such a file may be named after `=`, as in `map:=hall.yaml`.
        """
        before, equals, name = word.rpartition("=")
        for start, each in (("", word), (before + equals, name)):
            path = self.own_path(each) if {".", "/"} & {*each} else None  # else it is not a path
            if path is not None and (copy := kept_copy(path)) is not None:
                return f"{start}{copy}"
        return word

    @property
    def on(self) -> str:
        """The end of a sentence that says on which other computer it is; empty for this one."""
        return f" on {self.host}" if self.host else ""

    def wrapped(self, words: Sequence[str]) -> tuple[str, ...]:
        """Return a command that sources the setup file first."""
        own = None if self.setup is None else str(Path(self.setup).expanduser())
        copy = None if own is None else self.found(own)
        return _shell_words([self.found(each) for each in words], self.setup if copy == own else copy)

    def findings(self, where: str) -> Iterator[Finding]:
        """Yield what is wrong with the surroundings, whatever is executed there."""
        yield from cache_findings(where)
        if self.host is not None and isinstance(self.folder, Revision):
            problem = f"revisions are built on this machine, and the subject is executed on {self.host}"
            yield Finding.error(where, problem, "Leave host out, or name a folder over there.")
        elif self.host is not None:
            yield from self._host_findings(where)
        elif is_known(self.folder):
            folder = Path(self.path or ".")
            if not folder.is_dir():
                yield Finding.error(where, f"there is no folder {str(folder)!r}", "Make it, or name another.")
            elif self.setup is not None and not (folder / self.found(str(Path(self.setup).expanduser()))).is_file():
                yield Finding.error(where, f"there is no file {self.setup!r} to source", "Build the workspace first.")

    def _host_findings(self, where: str) -> Iterator[Finding]:
        found = ssh_findings(where, str(self.host), config=self.ssh_config)
        yield from found
        if found:
            return
        tests = [("python3 is not there", "command -v python3", "Install it there: it watches over the subject.")]
        if self.path is not None:
            tests.append((f"there is no folder {self.path!r}", f"cd {_quoted(self.path)}", "Make it there."))
        if self.setup is not None:
            test = f"{self._entered()}test -f {_quoted(self.setup)}"
            tests.append((f"there is no file {self.setup!r} to source", test, "Build the workspace there."))
        # All in one connection, as each takes a while.
        script = "; ".join(f"({test}) >/dev/null 2>&1 || echo {_LACKS} {n}" for n, (_, test, _) in enumerate(tests))
        for number in re.findall(rf"{_LACKS} (\d+)", self._over_there(script).said):
            problem, _, fix = tests[int(number)]
            yield Finding.error(where, f"{self.host}: {problem}", fix)

    def ask(self, words: Sequence[str]) -> Answer:
        """Execute a command in these surroundings, and return its answer."""
        wrapped = self.wrapped(words)
        if self.host is not None:
            variables = [f"{name}={value}" for name, value in self.environment.items() if value is not None]
            without = [word for name, value in self.environment.items() if value is None for word in ("-u", name)]
            return self._over_there(self._entered() + shlex.join(["env", *without, *variables, *wrapped]))
        try:
            done = subprocess.run(  # noqa: S603 - an argument list
                wrapped,
                stdin=subprocess.DEVNULL,
                capture_output=True,
                timeout=_PATIENCE,
                check=False,
                start_new_session=True,
                cwd=self.path,
                env=self.local_environment,
            )
            return _answer(done)
        except subprocess.TimeoutExpired:
            return Answer(None, "", f"it did not answer within {_PATIENCE:g} s")
        except OSError as error:
            return Answer(_NO_PROGRAM, "", f"{wrapped[0]}: {error.strerror}")

    @property
    def local_environment(self) -> dict[str, str]:
        """The environment of a program on this machine."""
        return {name: value for name, value in {**os.environ, **self.variables}.items() if value is not None}

    @property
    def variables(self) -> dict[str, str | None]:
        """The variables of a program, in addition to the inherited ones."""
        return {name: None if value is None else self.found(value) for name, value in self.environment.items()}

    def lacks(self, program: str) -> bool:
        """Whether a program is missing, as far as that can be known without executing it."""
        if self.host is not None or self.setup is not None:
            return self.ask(["sh", "-c", 'command -v "$0"', program]).code != 0
        program = self.found(program)
        if "/" in program:
            # Absolute: ./planner would lose its ./ and be looked for on the PATH.
            return shutil.which(str((Path(self.path or ".") / program).absolute())) is None
        return shutil.which(program, path=self.local_environment.get("PATH")) is None

    def facts(self) -> dict[str, Any]:
        """Return the surroundings as plain data, without what has its default."""
        facts = {"host": self.host, "folder": self.path, "setup": self.setup, "environment": dict(self.environment)}
        state = repository_state(self.path) if self.path is not None and self.host is None else None
        facts |= {"repository": state.facts()} if state is not None else {}
        return {name: value for name, value in facts.items() if value}

    def _entered(self) -> str:
        return f"cd {_quoted(self.path)} && " if self.path is not None else ""

    def _over_there(self, script: str) -> Answer:
        try:
            done = execute(ssh_command(str(self.host), script, config=self.ssh_config), timeout=_PATIENCE)
            return _answer(done)
        except subprocess.TimeoutExpired:
            return Answer(None, "", f"{self.host} did not answer within {_PATIENCE:g} s")
        except OSError as error:
            return Answer(None, "", f"ssh: {error.strerror}")


def _answer(done: subprocess.CompletedProcess[bytes]) -> Answer:
    return Answer(done.returncode, done.stdout.decode(errors="replace"), done.stderr.decode(errors="replace"))


def is_known(value: Any) -> bool:
    """Whether a path is known now: that of a revision is, once the experiment has begun."""
    return not isinstance(value, Revision) or value.is_prepared


def holds_revision(value: Any) -> bool:
    """Whether a value names something in the work tree of a revision."""
    return isinstance(value, Revision) or (isinstance(value, list | tuple) and any(map(holds_revision, value)))


def word(plugin: str, value: Any) -> str:
    """Return a value as a word of a command or of an environment; a list has the parts of one word.

    Raises:
        PluginError: it cannot be a word.

    Example:
        >>> word("nav", ["--speed=", 0.2])
        '--speed=0.2'
    """
    if isinstance(value, list | tuple):
        return "".join(word(plugin, part) for part in value)
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, os.PathLike):
        value = os.fspath(value) if is_known(value) else str(value)
    if isinstance(value, str | int | float) and "\0" not in str(value):
        return str(value)
    raise PluginError(f"{value!r} is not a word of a command", where=plugin, fix="Give texts, numbers or paths.")


def _quoted(path: str) -> str:
    """Return a path quoted for a shell, which still expands a `~` at its beginning."""
    return f"~/{shlex.quote(path[2:])}" if path.startswith("~/") else shlex.quote(path)


def started_once_findings(where: str, factors: Collection[str], robots: Sequence[str]) -> Iterator[Finding]:
    """Yield why a subject that is started once for all runs cannot fit all of them.

    `factors` are those to which its parameters are bound; several robots take turns.
    """
    for factor in [*factors][:1]:
        problem = f"the subject is started once for all runs, and bound to the factor {factor!r}"
        yield Finding.error(where, problem, "Start it in each run: per='run'.")
    with suppress(LinkError):  # which is told of the robot itself
        graphs = dict.fromkeys(graph_of_robot(each) for each in robots if not is_simulated(each))
        if len(graphs) > 1:
            first, *others = graphs
            problem = f"it is started once for all runs, on one graph ({first}), and robots are on {enumerated(others)}"
            yield Finding.warning(where, problem, "Start it in each run, on the graph of its robot: per='run'.")


def _shell_words(command: Sequence[str], setup: str | None) -> tuple[str, ...]:
    """Return the command that sources a file first, such as the setup file of a ROS workspace.

    Example:
        >>> _shell_words(["ros2", "topic", "list"], "install/setup.bash")[-4:]
        ('install/setup.bash', 'ros2', 'topic', 'list')
    """
    if setup is None:
        return tuple(command)
    shell = "bash" if setup.endswith(".bash") else "sh"
    home, file = ("~/", setup[2:]) if setup.startswith("~/") else ("", setup if "/" in setup else f"./{setup}")
    # Within a function, as such a file would otherwise take our arguments for its own.
    return (shell, "-c", f'load() {{ . {home}"$0"; }}; load && exec "$@"', file, *command)
