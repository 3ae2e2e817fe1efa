"""A revision of a git repository as a treatment, with its work tree once the experiment has begun."""

from __future__ import annotations

import re

from robot_runner.core.errors import DesignError

#: What git forbids in names of references (git-check-ref-format), and a leading `-`, which would be an option. `~` and
#: `^` are allowed, `@{...}` is not, as it depends on the reflog of one clone.
_FORBIDDEN = re.compile(r"^-|\.\.|@\{|[\s\x00-\x1f\x7f:?*\[\\]")


def is_revision_name(value: object) -> bool:
    """Return whether a value can be the name of a commit.

    Example:
        >>> [is_revision_name(each) for each in ("v1.0", "main~2", "--all", "v1..v2", 1.0)]
        [True, True, False, False, False]
    """
    return isinstance(value, str) and bool(value) and _FORBIDDEN.search(value) is None


class Revision:
    """One revision of a repository; its text in the run table is its name.

    The name is resolved to a commit when the experiment begins, once and for all. The object can be used as the path of
    its work tree (`subprocess.run(..., cwd=revision)`, `Path(revision)`).

    Attributes:
        repository: the path or the URL of the repository.
        name: a tag, a branch, or the beginning of a hash.
        build: a command for the shell that builds it in its work tree; empty for none.

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
        """The hash of the commit; raise a `DesignError` if the experiment has not begun."""
        return self._known(self._commit)

    @property
    def path(self) -> str:
        """The folder of its work tree, built; raise a `DesignError` if the experiment has not begun."""
        return self._known(self._path)

    def prepare(self, *, commit: str, path: str) -> None:
        """Set its commit and the path of its work tree."""
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
