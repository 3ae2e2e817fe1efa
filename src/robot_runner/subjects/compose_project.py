"""The subject that is a project of Docker Compose."""

from __future__ import annotations

import re
import signal
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

from robot_runner.core.errors import Finding, PluginError
from robot_runner.core.words import one_line
from robot_runner.subjects.read_files import compose_input
from robot_runner.subjects.subject import Subject
from robot_runner.subjects.surroundings import holds_revision, word

if TYPE_CHECKING:
    import os

    from robot_runner.core.storage.input_files import InputFile

#: How long containers may take to stop, s: Docker gives each 10 s, and Compose stops one after another's dependants.
_GRACE = 30.0
_NAME = re.compile(r"[a-z0-9][a-z0-9_-]*")
_UNKNOWN_COMMAND = re.compile(r"unknown (?:command|shorthand flag)|is not a docker command", re.IGNORECASE)


class ComposeProject(Subject):
    """Brings the containers of a Compose file up, and takes them down again, with their networks.

    What the containers write goes to `stdout.txt`. A container that ends before it is stopped fails the run at once.
    Variables in the Compose file (`${ALGORITHM}`) take their values from `environment`, where `treatment(...)` may
    stand.

    Args:
        file: the Compose file.
        services: the only ones to bring up; empty for all.
        project: the project's name, unique on the machine; None for the plugin's name.
        is_built: whether images are built anew where their sources have changed.
        has_volumes_removed: whether its volumes are removed, too, so that each start begins with empty ones.
        stop_signal: the signal at which it ends.
        grace_s: how long it may take for that before it is killed with all that it started, s.
        **options: as of every `Subject`.

    Raises:
        PluginError: the project's name or a parameter is invalid.

    Example:
        >>> ComposeProject("compose.yaml", services=["planner"], project="nav").words()[-5:]
        ('up', '--force-recreate', '--remove-orphans', '--abort-on-container-exit', 'planner')
    """

    needs: ClassVar[str] = "Docker with its Compose plugin; on another computer Python 3.6 and a key for ssh."

    def __init__(
        self,
        file: str | os.PathLike[str],
        *,
        services: Sequence[str] = (),
        project: str | None = None,
        is_built: bool = False,
        has_volumes_removed: bool = False,
        stop_signal: signal.Signals = signal.SIGINT,
        grace_s: float = _GRACE,
        **options: Any,
    ) -> None:
        super().__init__(stop_signal=stop_signal, grace_s=grace_s, **options)
        if isinstance(services, str):
            raise PluginError(f"services is {services!r}", where=self.name, fix=f"Give a list: [{services!r}].")
        self.project = self.name.lower() if project is None else project
        if not _NAME.fullmatch(self.project):
            fix = "Use lower-case letters, digits, '_' and '-'."
            raise PluginError(f"a project of Compose cannot be named {self.project!r}", where=self.name, fix=fix)
        self.file = word(self.name, file)
        self._is_own = not holds_revision(file)
        self.services = tuple(services)
        self.is_built = is_built
        self.has_volumes_removed = has_volumes_removed

    def words(self) -> tuple[str, ...]:
        """Return the command that brings it up; containers left by a killed run are replaced."""
        build = ("--build",) if self.is_built else ()
        options = ("--force-recreate", "--remove-orphans", "--abort-on-container-exit")
        return (*self._compose, "up", *build, *options, *self.services)

    def last_words(self) -> tuple[str, ...]:
        """Return the command that takes it down."""
        volumes = ("--volumes",) if self.has_volumes_removed else ()
        return (*self._compose, "down", "--remove-orphans", *volumes)

    def files_read(self) -> Iterable[InputFile]:
        """Yield the Compose file, with the files beside it that it names, and those that its images are built from."""
        path = self.surroundings.own_path(self.file) if self._is_own else None
        return [] if path is None else [compose_input(path)]

    def program_findings(self, where: str) -> Iterable[Finding]:
        """Yield the errors of Docker itself about the Compose file, or that its daemon does not answer."""
        on = self.surroundings.on
        if self.surroundings.lacks("docker"):
            yield Finding.error(where, f"the program 'docker' is not there{on}", "Install Docker with Compose.")
            return
        config = self.surroundings.ask((*self._compose, "config", "--quiet"))
        if config.code != 0:
            said = _gist(config.complaint or config.said)
            lacking = _UNKNOWN_COMMAND.search(config.complaint + config.said)
            fix = "Install the Compose plugin of Docker." if lacking else "Correct the Compose file."
            yield Finding.error(where, f"docker compose refuses {self.file}{on}: {said}", fix)
        daemon = self.surroundings.ask(("docker", "version", "--format", "{{.Server.Version}}"))
        if daemon.code != 0:
            said = _gist(daemon.complaint or daemon.said)
            fix = "Start it, and see that you may use it: docker version."
            yield Finding.error(where, f"the daemon of Docker does not answer{on}: {said}", fix)

    @property
    def _compose(self) -> tuple[str, ...]:
        return ("docker", "compose", "--project-name", self.project, "--file", self.file)


def _gist(text: str) -> str:
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    return one_line(lines[0]) if lines else "no reason is given"
