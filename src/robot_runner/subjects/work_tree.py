"""A work tree of one commit, built once and kept in the user's cache for all experiments that need it.

A copy of the commits that an experiment measures is kept in its folder, so that it can be repeated without the
repository: a bare repository that git clones like any other. It has no earlier commits: a history is large, and may
contain what nobody wants to publish.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
import time
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

from robot_runner.core.config.treatment_makers import Workshop
from robot_runner.core.errors import ExecutionError, StorageError
from robot_runner.core.execution.processes import stop_with_parent
from robot_runner.core.storage.git_repository import git, repository_state, uncommitted_changes, without_login
from robot_runner.core.storage.guarded_files import make_folder, open_to_read, open_to_write, read_bytes, replace
from robot_runner.core.storage.journal import utc_now
from robot_runner.core.storage.layout import user_folder
from robot_runner.core.storage.system_refusals import storage_errors
from robot_runner.core.words import one_line
from robot_runner.subjects.orphans import wake_supervisor
from robot_runner.subjects.supervised_program import Start, SupervisedProgram, Task, last_lines_of, locked

#: How long cloning may take, s.
_CLONING = 3600.0
#: How long a build may take to end once it is asked to, and what a killed execution has left of one, s.
_GRACE, _LEFT_BUILD = 1.0, 60.0
_LOOK = 0.1
#: Executes a build, its second argument; all that it prints goes to a file, its first.
_BUILDING = ("/bin/sh", "-c", 'exec /bin/sh -c "$1" >"$0" 2>&1')
_SHOWN_LINES = 5
_SHORT = 12  # digits of a hash that a person reads


def cache_folder() -> Path:
    """Return the folder of work trees, in the user's folder of caches; it may be emptied at any time."""
    return user_folder("XDG_CACHE_HOME") / "revisions"


class WorkTree:
    """A work tree of one commit of a repository, and what was built in it.

    `copy` is a folder that may have a copy of the commit, for when the repository is not available any more.

    Attributes:
        folder: of the work tree; another commit, repository or command has another one.
    """

    def __init__(self, repository: str, commit: str, build: str, copy: Path | None = None) -> None:
        self.repository, self.commit, self._build, self._copy = repository, commit, build, copy
        key = hashlib.sha256(f"{repository}\0{commit}\0{build}".encode()).hexdigest()[:8]
        self._entry = cache_folder() / f"{_name_of(repository)}-{commit[:_SHORT]}-{key}"
        self.folder = self._entry / "tree"
        self._stamp = self._entry / "built.json"
        self._log = self._entry / "build.log"
        self._building = Start(self._entry / "building")

    def made(self, name: str, log: Path, workshop: Workshop) -> dict[str, Any]:
        """Make and build it, unless that was done before and nothing was changed since; return facts about the build.

        `log` gets a copy of what was printed; `name` is the revision's, for messages.

        Raises:
            ExecutionError: it cannot be made.
            StorageError: a file cannot be written.
            PluginError: the build cannot be started.
            KeyboardInterrupt: the user has interrupted it.
        """
        lock = self._entry.with_name(f"{self._entry.name}.lock")
        with locked(lock, partial(_await_others, workshop)), storage_errors(self.folder, "written"):
            facts = self._built_before()
            if facts is None:
                repository = without_login(self.repository)
                workshop.tell(f"Building {name} of {repository}" if self._build else f"Fetching {name}")
                facts = self._made_anew(name, workshop)
            if self._build:
                root = workshop.logs.parent
                make_folder(log.parent, root)
                with open_to_read(self._log) as printed, open_to_write(log, root) as kept:
                    shutil.copyfileobj(printed, kept)
            return facts

    def _made_anew(self, name: str, workshop: Workshop) -> dict[str, Any]:
        # A build that an execution has left which was killed would write into the new work tree.
        wake_supervisor(self._building.events)
        self._building.await_end(_LEFT_BUILD)
        self._building.end_orphans()
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
            # Some builds change files that are tracked by git.
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
        self._check_fetched(name)
        if (self.folder / ".gitmodules").exists():
            # Places of submodules may be relative to where the repository itself was cloned from.
            upstream = Path(self.repository).is_dir() and git("remote", "get-url", "origin", folder=self.repository)
            if upstream and upstream.returncode == 0:
                self._git(name, "remote", "set-url", "origin", upstream.stdout.decode().strip())
            self._git(name, "submodule", "--quiet", "update", "--init", "--recursive")
            self._git(name, "remote", "set-url", "origin", self.repository)

    def _check_fetched(self, name: str) -> None:
        """Check that files in Git LFS are there: without git-lfs, git checks their pointers out and says nothing."""
        listed = git("ls-files", "-z", "--", _IN_LFS, folder=self.folder, timeout=_PATIENCE).stdout.split(b"\0")
        for path in filter(Path.is_file, (self.folder / os.fsdecode(each) for each in listed if each)):
            with path.open("rb") as file:
                if file.read(len(_POINTER)) == _POINTER:
                    problem = f"{path.name!r} is in Git LFS, and only its pointer was fetched"
                    fix = "Install git-lfs, and execute: git lfs install."
                    raise ExecutionError(problem, where=f"revision {name!r}", fix=fix)

    def _clone(self, name: str, source: str) -> None:
        self._git(name, "clone", "--quiet", "--no-checkout", "--", source, str(self.folder), folder=self._entry)
        if git("cat-file", "-e", f"{self.commit}^{{commit}}", folder=self.folder).returncode != 0:
            self._git(name, "fetch", "--quiet", "origin", self.commit)  # it is in no branch and no tag

    def _git(self, name: str, *words: str, folder: Path | None = None) -> None:
        try:
            done = git(*words, folder=folder or self.folder, timeout=_CLONING, preexec_fn=stop_with_parent)
        except (OSError, subprocess.TimeoutExpired) as error:
            problem, fix = f"git {words[0]} failed: {error}", ""
            if isinstance(error, FileNotFoundError) and error.filename == "git":
                problem, fix = "git is not installed", "Install git: it fetches the commits that are compared."
            raise ExecutionError(problem, where=f"revision {name!r}", fix=fix) from error
        if done.returncode != 0:
            fix = "Try it by hand: git " + without_login(" ".join(words))
            raise ExecutionError(f"git {words[0]} failed: {refusal(done)}", where=f"revision {name!r}", fix=fix)

    def _execute_build(self, name: str, workshop: Workshop) -> None:
        task = Task(
            command=(*_BUILDING, str(self._log), self._build), environment={}, folder=str(self.folder), grace_s=_GRACE
        )
        program = SupervisedProgram(self._building.folder, task, name=f"revision {name!r}")
        try:
            while program.ended() is None and not workshop.is_interrupted():
                time.sleep(_LOOK)
        finally:
            ended = program.stop()  # with processes that it has left behind
        if workshop.is_interrupted():
            raise KeyboardInterrupt
        if ended.code != 0:
            said = last_lines_of(self._log, _SHOWN_LINES) or program.last_lines() or "it printed nothing"
            how = f"ended with exit code {ended.code}" if (ended.code or 0) > 0 else f"was ended: {ended.how}"
            fix = f"Look at {self._log}, and build it by hand in {self.folder}: {self._build}"
            raise ExecutionError(f"the build {how}: {said}", where=f"revision {name!r}", fix=fix)

    def _built_before(self) -> dict[str, Any] | None:
        """Return the facts about an earlier build; None where there was none, or files were changed since."""
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


def refusal(done: subprocess.CompletedProcess[bytes]) -> str:
    r"""Return the reason why git refused: the first line of what it wrote; further ones are consequences, or advice.

    Example:
        >>> said = b"warning: no HEAD\nPermission denied (publickey).\nfatal: Could not read from remote repository."
        >>> refusal(subprocess.CompletedProcess("git", 128, b"", said))
        'Permission denied (publickey).'
    """
    lines = [line.strip() for line in done.stderr.decode(errors="replace").splitlines() if line.strip()]
    reasons = [line for line in lines if not line.casefold().startswith("warning: ")] or lines
    return one_line(without_login(reasons[0])) if reasons else f"exit code {done.returncode}"


def _await_others(workshop: Workshop) -> None:
    """Wait while another experiment builds it."""
    if workshop.is_interrupted():
        raise KeyboardInterrupt
    time.sleep(_LOOK)


#: The largest copy that is kept in an experiment's folder, which people send to each other, bytes.
_LARGEST = 64 << 20
_SHA1 = 40  # digits of its hashes
_PATIENCE = 600.0  # s, for a few seconds of work on a slow disk
_SUBMODULE = "commit"  # what `git ls-tree` calls one
#: Which files are in Git LFS (gitattributes), and how a pointer to one begins (git-lfs, docs/spec.md).
_IN_LFS, _POINTER = ":(attr:filter=lfs)", b"version https://git-lfs.github.com/spec/"
#: So that every file is stored whole and none as a delta of another: the search for secrets reads them.
_WHOLE = ("-c", "repack.writeBitmaps=false", "-c", "repack.updateServerInfo=false", "repack", "-q", "-a", "-d", "-F")
#: A file that git leaves, which has paths of this machine.
_LEFT = "FETCH_HEAD"


def kept_name(repository: str) -> str:
    """Return the name of the copy of a repository, which is unique."""
    digest = hashlib.sha256(repository.encode("utf-8", "surrogateescape")).hexdigest()
    return f"{_name_of(repository)}-{digest[:8]}.git"


def _name_of(repository: str) -> str:
    return Path(repository.rstrip("/")).name.removesuffix(".git") or "repository"


def is_kept(target: Path, clones: Mapping[str, Path]) -> bool:
    """Make a copy of some commits, unless there is one; return whether there is one now.

    There is none where the commits are too large, or have submodules, which are commits of other repositories, or files
    in Git LFS, whose pointers alone are in the commits. `target` is to be a bare repository; `clones` has a repository
    with each commit, by its hash.
    """
    try:
        if target.is_dir() and all(_worked(target, "cat-file", "-e", f"{commit}^{{commit}}") for commit in clones):
            return True
        if not _is_small(clones):
            return False
        part = target.with_name(f".{target.name}.tmp")
        shutil.rmtree(part, ignore_errors=True)
        part.mkdir(parents=True)
        is_made = all(_worked(part, *words) for words in _steps(clones))
        if is_made:
            (part / _LEFT).unlink(missing_ok=True)
            shutil.rmtree(target, ignore_errors=True)
            part.replace(target)
        else:
            shutil.rmtree(part, ignore_errors=True)
    except (OSError, subprocess.TimeoutExpired):
        return False
    return is_made


def take_over(kept: Path, target: Path, *, digits: int) -> None:
    """Make a repository of the user's own with the commits of a copy, such as one in a package.

    Git refuses to clone a repository in a folder of another user, as its configuration may name programs. So only
    commits are taken from it, and the branches that lead to them. The hashes of its commits have so many `digits`.

    Raises:
        OSError: git is not installed, or the repository cannot be written.
        StorageError: something in the copy is not a regular file.
    """
    target.mkdir(parents=True)
    kind = "sha1" if digits == _SHA1 else "sha256"
    git("init", "-q", "--bare", "--template=", f"--object-format={kind}", folder=target)
    places = [kept / name for name in ("HEAD", "packed-refs", "shallow")]
    places += [path for name in ("objects", "refs") for path in sorted((kept / name).rglob("*"))]
    for path in places:
        below = path.relative_to(kept)
        if path.is_file() and below.parts[1:2] != ("info",):  # which may name other folders with objects
            (target / below).parent.mkdir(parents=True, exist_ok=True)
            replace(target / below, read_bytes(path, kept, limit=2 * _LARGEST), target, is_lasting=False)


def _steps(clones: Mapping[str, Path]) -> list[tuple[str, ...]]:
    # No template, as it may have hooks, which are programs. Branches, as only these and tags are cloned, and a tag
    # would change the output of `git describe`.
    fetch = ("-c", "gc.auto=0", "-c", "protocol.version=2", "fetch", "-q", "--no-tags", "--depth=1")
    return [
        ("init", "-q", "--bare", "--template="),
        *((*fetch, clone.as_uri(), f"{commit}:refs/heads/kept-{commit[:12]}") for commit, clone in clones.items()),
        ("symbolic-ref", "HEAD", f"refs/heads/kept-{[*clones][-1][:12]}"),  # what a clone checks out
        (*_WHOLE, "--window=0", "--depth=0"),
    ]


def _is_small(clones: Mapping[str, Path]) -> bool:
    """Whether these commits hold all of their files, which are not too large in all."""
    sizes: dict[str, int] = {}
    for commit, clone in clones.items():
        if git("ls-files", "--", _IN_LFS, folder=clone, timeout=_PATIENCE).stdout:
            return False
        listed = git("ls-tree", "-r", "-l", "-z", commit, folder=clone, timeout=_PATIENCE)
        for line in filter(None, listed.stdout.split(b"\0")):
            _, kind, digest, size = line.partition(b"\t")[0].decode().split()
            if kind == _SUBMODULE:
                return False
            sizes[digest] = int(size)
        if listed.returncode != 0:
            return False
    return sum(sizes.values()) <= _LARGEST


def _worked(folder: Path, *words: str) -> bool:
    return git(*words, folder=folder, timeout=_PATIENCE).returncode == 0
