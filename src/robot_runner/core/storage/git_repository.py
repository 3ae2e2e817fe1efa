"""The state of a git repository: the commit that is checked out, and the changes since. Nothing is changed."""

from __future__ import annotations

import os
import re
import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from robot_runner.core.errors import Finding

#: How long git may take to answer, s: on a cold disk and a large repository it has to look at every file.
_PATIENCE = 30.0
#: Of a longer diff only the hash is kept, bytes.
LARGEST_DIFF = 1 << 20
#: No questions for passwords, no locks for reading, messages in English; what is missing is not fetched in passing, as
#: by a program that the configuration of a copied repository names (git 2.39.4).
_ENVIRONMENT = {
    "GIT_NO_LAZY_FETCH": "1",
    "GIT_TERMINAL_PROMPT": "0",
    "GIT_OPTIONAL_LOCKS": "0",
    "GIT_SSH_COMMAND": "ssh -o BatchMode=yes -o ConnectTimeout=10",
    "LC_ALL": "C",
}
#: Variables that git sets for its hooks; with them, git would look at another repository.
_FOREIGN = ("GIT_DIR", "GIT_WORK_TREE", "GIT_INDEX_FILE", "GIT_OBJECT_DIRECTORY", "GIT_PREFIX")
#: What git advises where a repository belongs to another user.
ADVISED = re.compile(rb"git config \S+ --add safe\.directory .+")
_LOGIN = re.compile(r"(?<=://)[^/@]*@")


@dataclass(frozen=True, slots=True)
class RepositoryState:
    """A repository as it is checked out.

    Attributes:
        branch: the branch; empty where none is checked out.
        origin: where it was cloned from, without a name or a password; empty where that is not known.
        is_dirty: whether tracked files were changed since that commit. Untracked ones do not count: results are often
            written into the repository of their config.
    """

    commit: str
    branch: str
    origin: str
    is_dirty: bool

    def facts(self) -> dict[str, Any]:
        """Return the same as plain data, without what is empty."""
        facts = {"commit": self.commit, "branch": self.branch, "origin": self.origin}
        return {**{name: value for name, value in facts.items() if value}, "is_dirty": self.is_dirty}


def git(
    *words: str, folder: Path | str = ".", timeout: float = _PATIENCE, preexec_fn: Callable[[], object] | None = None
) -> subprocess.CompletedProcess[bytes]:
    """Execute one command of git to its end; `preexec_fn` as for `subprocess.run`, where this process has no threads.

    Raises:
        OSError: git is not installed, or the folder is not there.
        subprocess.TimeoutExpired: it takes longer.
    """
    inherited = {name: value for name, value in os.environ.items() if name not in _FOREIGN}
    return subprocess.run(  # noqa: S603 - an argument list
        # A monitor of the file system is a program that the repository's own configuration names.
        ["git", "-c", "core.fsmonitor=false", *words],  # noqa: S607 - the git that the user has
        cwd=folder,
        env={**inherited, **_ENVIRONMENT},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        timeout=timeout,
        check=False,
        start_new_session=True,
        preexec_fn=preexec_fn,
    )


def repository_state(folder: Path | str) -> RepositoryState | None:
    """Return the state of the repository that a folder belongs to.

    None where there is no git, no repository, no commit in it, or no answer.
    """
    commit = _answer(folder, "rev-parse", "--verify", "--quiet", "HEAD^{commit}")
    changed = _answer(folder, "status", "--porcelain", "--untracked-files=no") if commit else None
    if not commit or changed is None:
        return None
    branch = _answer(folder, "symbolic-ref", "--quiet", "--short", "HEAD") or ""
    origin = _answer(folder, "config", "--get", "remote.origin.url") or ""
    return RepositoryState(commit, branch, without_login(origin), bool(changed))


def refused_repository(folder: Path) -> Finding | None:
    """Return a warning where git does not read the repository that a folder is in, else None.

    In a container, the repository is often that of another user, or the part of a work tree that was not mounted.
    """
    above = folder.absolute()
    folders = (above, *above.parents)
    root = next((each for each in folders if os.path.exists(each / ".git")), None)  # noqa: PTH110 - never raises
    if root is None:  # as most often: git need not be asked
        return None
    problem, fix = "git is not installed", "Install git."
    try:
        answer = git("rev-parse", "--git-dir", folder=folder)
    except FileNotFoundError:
        pass
    except (OSError, subprocess.TimeoutExpired) as error:
        problem, fix = f"git does not answer: {error}", ""
    else:
        if answer.returncode == 0:
            return None
        problem, _, _ = answer.stderr.decode(errors="replace").strip().partition("\n")
        fix = _fix_of(root / ".git", problem, ADVISED.search(answer.stderr))
    return Finding.warning(str(root), f"the commit of the config cannot be recorded: {problem}", fix)


def _fix_of(place: Path, problem: str, advised: re.Match[bytes] | None) -> str:
    if advised:
        return f"Execute: {advised[0].decode(errors='replace')}"
    if "Permission denied" in problem or not os.access(place, os.R_OK):  # git takes the latter for no repository
        return "Make all of the repository readable."
    is_none = "not a git repository" in problem or "invalid gitfile" in problem
    return f"Mount or clone all of it, or remove {place}." if is_none else ""


def without_login(url: str) -> str:
    """Return a URL without the name and the password in it.

    Example:
        >>> without_login("https://me:secret@example.org/nav.git")
        'https://example.org/nav.git'
    """
    return _LOGIN.sub("", url)


def uncommitted_changes(folder: Path | str) -> bytes:
    """Return the changes since the commit that is checked out, for `git apply`; empty where git fails.

    Diff programs that the repository names are not executed, and the user's git configuration does not matter.
    """
    words = ("diff", "HEAD", "--binary", "--no-color", "--no-ext-diff", "--no-textconv", "--unified=3")
    prefixes = ("--src-prefix=a/", "--dst-prefix=b/")
    try:
        root = git("rev-parse", "--show-toplevel", folder=folder).stdout.decode(errors="surrogateescape").strip()
        return git(*words, *prefixes, folder=root or folder).stdout
    except (OSError, subprocess.TimeoutExpired):
        return b""


def _answer(folder: Path | str, *words: str) -> str | None:
    try:
        done = git(*words, folder=folder)
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout.decode(errors="replace").strip() if done.returncode == 0 else None
