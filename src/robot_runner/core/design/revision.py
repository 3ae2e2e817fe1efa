"""A revision of a git repository as a treatment: its name here, its work tree once the experiment has begun."""

from __future__ import annotations

import re

from robot_runner.core.errors import DesignError

#: What git's rules for names of references (git-check-ref-format) forbid, and what would pass for an option. `~` and
#: `^` count from a reference, and `@{...}` asks the reflog of one clone, which no other has.
_FORBIDDEN = re.compile(r"^-|\.\.|@\{|[\s\x00-\x1f\x7f:?*\[\\]")


def is_revision_name(value: object) -> bool:
    """Whether this can name a commit.

    Example:
        >>> [is_revision_name(each) for each in ("v1.0", "main~2", "--all", "v1..v2", 1.0)]
        [True, True, False, False, False]
    """
    return isinstance(value, str) and bool(value) and _FORBIDDEN.search(value) is None


class Revision:
    """One revision of a repository; it is written in the run table by its name.

    Which commit the name means is found out when the experiment begins, and kept from then on. Where a path is wanted,
    the object itself may stand for that of its work tree (`subprocess.run(..., cwd=revision)`, `Path(revision)`).

    Attributes:
        repository: the path or the URL of the repository.
        name: what git takes for a commit: a tag, a branch, the beginning of a hash.
        build: a command for the shell that builds it in its work tree; empty where nothing is to be built.

    Example:
        >>> version = Revision("~/planner", "v1.0", build="make")
        >>> str(version), version.is_prepared
        ('v1.0', False)
    """

    __slots__ = ("_commit", "_path", "build", "name", "repository")

    def __init__(self, repository: str, name: str, *, build: str = "") -> None:
        self.repository = repository
        self.name = name
        self.build = build
        self._commit = self._path = ""

    @property
    def is_prepared(self) -> bool:
        """Whether commit and path are known: from `before_experiment` on."""
        return bool(self._commit)

    @property
    def commit(self) -> str:
        """The hash of the commit.

        Raises:
            DesignError: the experiment has not begun.
        """
        return self._known(self._commit)

    @property
    def path(self) -> str:
        """The folder of its work tree, built.

        Raises:
            DesignError: the experiment has not begun.
        """
        return self._known(self._path)

    def prepare(self, *, commit: str, path: str) -> None:
        """Say which commit it is, and where its work tree is."""
        self._commit, self._path = commit, path

    def _known(self, value: str) -> str:
        if not value:
            fix = "Ask for it from before_experiment on."
            raise DesignError(f"the revision {self.name!r} has no work tree yet", where=self.repository, fix=fix)
        return value

    def __fspath__(self) -> str:
        return self.path

    def __str__(self) -> str:
        return self.name

    def __repr__(self) -> str:
        return f"Revision({self.repository!r}, {self.name!r})"

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Revision) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)

    @property
    def _key(self) -> tuple[str, str, str]:
        return (self.repository, self.name, self.build)
