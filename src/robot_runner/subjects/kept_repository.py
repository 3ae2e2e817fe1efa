"""A copy of the commits that an experiment measures, in its folder, so that it can be repeated without the repository.

It is a bare repository that git clones like any other. What came before these commits is not in it: the history of a
repository is large, and may hold what nobody wants to publish.
"""

from __future__ import annotations

import hashlib
import shutil
import subprocess
from collections.abc import Mapping
from pathlib import Path

from robot_runner.core.storage.git_repository import git
from robot_runner.core.storage.guarded_files import read_bytes, replace

#: What is larger is no part of an experiment's folder, which people send to each other, bytes.
_LARGEST = 64 << 20
_SHA1 = 40  # digits of its hashes
_PATIENCE = 600.0  # s, for a few seconds of work on a slow disk
_SUBMODULE = "commit"  # what `git ls-tree` calls one
#: Every file is stored whole and none as a delta against another one, so that the search for secrets can read it.
_WHOLE = ("-c", "repack.writeBitmaps=false", "-c", "repack.updateServerInfo=false", "repack", "-q", "-a", "-d", "-F")
#: What git leaves of the making: it tells paths of this machine.
_LEFT = "FETCH_HEAD"


def kept_name(repository: str) -> str:
    """Return the name of the copy of a repository, other than that of any other one."""
    name = Path(repository.rstrip("/")).name.removesuffix(".git") or "repository"
    return f"{name}-{hashlib.sha256(repository.encode('utf-8', 'surrogateescape')).hexdigest()[:8]}.git"


def is_kept(target: Path, clones: Mapping[str, Path]) -> bool:
    """Make a copy of some commits, unless it is there; return whether it is.

    It is not where the commits are too large, or have submodules, which are commits of other repositories.

    Args:
        target: the folder of the copy, a bare repository.
        clones: where each commit can be had, by its hash.
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

    Git refuses to clone a repository in a folder of another user, and rightly so: its configuration may name programs.
    So nothing is taken of it but commits, and the branches that lead to them.

    Args:
        kept: the copy.
        target: the folder of the new one.
        digits: of the hashes of its commits.

    Raises:
        OSError: git is not installed, or it cannot be written.
        StorageError: something in the copy is no regular file.
    """
    target.mkdir(parents=True)
    git(
        "init",
        "-q",
        "--bare",
        "--template=",
        f"--object-format={'sha1' if digits == _SHA1 else 'sha256'}",
        folder=target,
    )
    places = [kept / name for name in ("HEAD", "packed-refs", "shallow")]
    places += [path for name in ("objects", "refs") for path in sorted((kept / name).rglob("*"))]
    for path in places:
        below = path.relative_to(kept)
        if path.is_file() and below.parts[1:2] != ("info",):  # which may name other folders with objects
            (target / below).parent.mkdir(parents=True, exist_ok=True)
            replace(target / below, read_bytes(path, kept, limit=2 * _LARGEST), target, is_lasting=False)


def _steps(clones: Mapping[str, Path]) -> list[tuple[str, ...]]:
    # Without a template there are no hooks, which are programs. Branches, as only these and tags are cloned, and a tag
    # would change what `git describe` says.
    fetch = ("-c", "gc.auto=0", "-c", "protocol.version=2", "fetch", "-q", "--no-tags", "--depth=1")
    return [
        ("init", "-q", "--bare", "--template="),
        *((*fetch, clone.as_uri(), f"{commit}:refs/heads/kept-{commit[:12]}") for commit, clone in clones.items()),
        (*_WHOLE, "--window=0", "--depth=0"),
    ]


def _is_small(clones: Mapping[str, Path]) -> bool:
    """Whether these commits have no submodules, and their files are not too large in all."""
    sizes: dict[str, int] = {}
    for commit, clone in clones.items():
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
