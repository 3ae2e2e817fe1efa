"""A work tree of one commit, built once and kept in the user's cache for all experiments that need it."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import signal
import subprocess
import time
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from robot_runner.core.errors import ExecutionError, StorageError
from robot_runner.core.storage.git_repository import git, repository_state, uncommitted_changes, without_login
from robot_runner.core.storage.journal import utc_now
from robot_runner.core.words import one_line
from robot_runner.subjects.kept_repository import take_over
from robot_runner.subjects.supervised_program import locked, tail, user_cache

if TYPE_CHECKING:
    from robot_runner.core.config.treatment_makers import Workshop

#: How long cloning may take, s.
_CLONING = 3600.0
_LOOK = 0.1
_SHOWN_LINES = 5
_SHORT = 12  # digits of a hash that a person reads


def cache_folder() -> Path:
    """Return where work trees are kept: in the user's folder of caches. It may be emptied at will."""
    return user_cache() / "revisions"


class WorkTree:
    """A work tree of one commit of a repository, and what was built in it.

    Args:
        repository: a path or a URL.
        commit: the hash.
        build: a command for the shell; empty for none.
        copy: a folder that may hold a copy of the commit, for where the repository cannot be had any more.

    Attributes:
        folder: where it is; another commit, repository or command has another one.
    """

    def __init__(self, repository: str, commit: str, build: str, copy: Path | None = None) -> None:
        self.repository, self.commit, self._build, self._copy = repository, commit, build, copy
        key = hashlib.sha256(f"{repository}\0{commit}\0{build}".encode()).hexdigest()[:8]
        name = Path(repository.rstrip("/")).name.removesuffix(".git") or "repository"
        self._entry = cache_folder() / f"{name}-{commit[:_SHORT]}-{key}"
        self.folder = self._entry / "tree"
        self._stamp = self._entry / "built.json"
        self._log = self._entry / "build.log"

    def made(self, name: str, log: Path, workshop: Workshop) -> dict[str, Any]:
        """Make and build it, unless that was done before and nothing was changed since; return facts of the building.

        Args:
            name: the revision's, for messages.
            log: gets a copy of what was printed.
            workshop: of the experiment.

        Raises:
            ExecutionError: it cannot be made.
            KeyboardInterrupt: the user has interrupted it.
        """
        with locked(self._entry.with_name(f"{self._entry.name}.lock"), partial(_await_others, workshop)):
            facts = self._built_before()
            if facts is None:
                workshop.tell(
                    f"Building {name} of {without_login(self.repository)}" if self._build else f"Fetching {name}"
                )
                facts = self._made_anew(name, workshop)
            if self._build:
                log.parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(self._log, log)
            return facts

    def _made_anew(self, name: str, workshop: Workshop) -> dict[str, Any]:
        if self._entry.exists():
            shutil.rmtree(self._entry)
        self._entry.mkdir(parents=True)
        started = time.monotonic()
        self._check_out(name)
        if self._build:
            self._execute_build(name, workshop)
        state = repository_state(self.folder)
        facts = {
            "built_at": utc_now(),
            "seconds": round(time.monotonic() - started, 3),
            # Some builds change files that git keeps.
            "is_dirty": state is not None and state.is_dirty,
        }
        self._stamp.write_text(json.dumps({"facts": facts, "changes": self._changes()}), encoding="utf-8")
        return facts

    def _check_out(self, name: str) -> None:
        try:
            self._clone(name, self.repository)
        except ExecutionError as refused:
            if self._copy is None or not self._copy.is_dir():
                raise
            shutil.rmtree(self.folder, ignore_errors=True)
            own = self._entry / "copy.git"
            try:
                take_over(self._copy, own, digits=len(self.commit))
                self._clone(name, str(own))
                self._git(name, "remote", "set-url", "origin", self.repository)
            except (ExecutionError, StorageError, OSError):  # a package leaves out what holds secrets
                raise refused from None
            finally:
                shutil.rmtree(own, ignore_errors=True)
        self._git(name, "checkout", "--quiet", "--detach", self.commit)
        if (self.folder / ".gitmodules").exists():
            self._git(name, "submodule", "--quiet", "update", "--init", "--recursive")

    def _clone(self, name: str, source: str) -> None:
        self._git(name, "clone", "--quiet", "--no-checkout", "--", source, str(self.folder), folder=self._entry)
        if git("cat-file", "-e", f"{self.commit}^{{commit}}", folder=self.folder).returncode != 0:
            self._git(name, "fetch", "--quiet", "origin", self.commit)  # no branch and no tag has it

    def _git(self, name: str, *words: str, folder: Path | None = None) -> None:
        try:
            done = git(*words, folder=folder or self.folder, timeout=_CLONING)
            said = done.stderr.decode(errors="replace").strip()
        except (OSError, subprocess.TimeoutExpired) as error:
            raise ExecutionError(f"git {words[0]} failed: {error}", where=f"revision {name!r}") from error
        if done.returncode != 0:
            last = one_line(without_login(said.splitlines()[-1])) if said else f"exit code {done.returncode}"
            fix = "Try it by hand: git " + without_login(" ".join(words))
            raise ExecutionError(f"git {words[0]} failed: {last}", where=f"revision {name!r}", fix=fix)

    def _execute_build(self, name: str, workshop: Workshop) -> None:
        with self._log.open("wb") as log:
            process = subprocess.Popen(  # noqa: S603 - the user's own command
                ["/bin/sh", "-c", self._build],
                cwd=self.folder,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
        try:
            while process.poll() is None and not workshop.is_interrupted():
                with suppress(subprocess.TimeoutExpired):
                    process.wait(_LOOK)
        finally:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)  # also what it has left behind
            code = process.wait()
        if workshop.is_interrupted():
            raise KeyboardInterrupt
        if code != 0:
            lines = [line.strip() for line in tail(self._log).splitlines() if line.strip()]
            said = one_line(" | ".join(lines[-_SHOWN_LINES:])) or "it printed nothing"
            fix = f"Look at {self._log}, and build it by hand in {self.folder}: {self._build}"
            raise ExecutionError(f"the build ended with exit code {code}: {said}", where=f"revision {name!r}", fix=fix)

    def _built_before(self) -> dict[str, Any] | None:
        """Return the facts of an earlier building; None where there was none, or files were changed since."""
        try:
            stamp = json.loads(self._stamp.read_text(encoding="utf-8"))
            facts, changes = dict(stamp["facts"]), stamp["changes"]
        except (OSError, ValueError, KeyError, TypeError):
            return None
        state = repository_state(self.folder)
        is_same = state is not None and state.commit == self.commit and changes == self._changes()
        return facts if is_same else None

    def _changes(self) -> str:
        return hashlib.sha256(uncommitted_changes(self.folder)).hexdigest()


def _await_others(workshop: Workshop) -> None:
    """Let another experiment build it meanwhile."""
    if workshop.is_interrupted():
        raise KeyboardInterrupt
    time.sleep(_LOOK)
