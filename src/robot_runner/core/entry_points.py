"""Entry points of installed packages for Robot Runner, read without importing any of them.

`importlib.metadata` takes some 100 ms, too long for `robot-runner --help`. So the folders of metadata on `sys.path` are
read here, and it is used only for other entries, such as a zip file.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterable, Iterator
from importlib import import_module

TYPE_CHECKING = False  # `typing` takes longer to import than all of this
if TYPE_CHECKING:
    from typing import Any, TypeVar

    from robot_runner.core.errors import PluginError

    T = TypeVar("T")


_PREFIX = "robot_runner."
_METADATA = (".dist-info", ".egg-info")


class EntryPoint:
    """One entry point of an installed package; nothing of the package is imported before `load`.

    `value` is `module:object` or `module` alone; `distribution` returns the name and version of the package.

    Example:
        >>> EntryPoint("sqrt", "robot_runner.links", "math:sqrt", lambda: ("stdlib", "3")).load()(9)
        3.0
    """

    __slots__ = ("_distribution", "group", "name", "value")

    def __init__(self, name: str, group: str, value: str, distribution: Callable[[], tuple[str, str]]) -> None:
        self.name = name
        self.group = group
        self.value = value
        self._distribution = distribution

    @property
    def package(self) -> str:
        """The name of its distribution."""
        return self._distribution()[0]

    @property
    def version(self) -> str:
        """The version of that distribution."""
        return self._distribution()[1]

    @property
    def module(self) -> str:
        """The module that it is in."""
        return self.value.partition(":")[0].strip()

    @property
    def kind(self) -> str:
        """Its group without `robot_runner.`: `links`, `profilers` and so on."""
        return self.group.removeprefix(_PREFIX)

    @property
    def is_own(self) -> bool:
        """Whether it is Robot Runner's own."""
        return self.value.startswith(_PREFIX)

    @property
    def where(self) -> str:
        """Kind, name and package, for errors."""
        return f"{self.kind.removesuffix('s')} {self.name} ({self.value}, of {self.package} {self.version})"

    def load(self) -> Any:
        """Import its object.

        Raises:
            PluginError: this fails; names the package.
        """
        try:
            found: Any = import_module(self.module)
            for attribute in filter(None, self.value.partition(":")[2].partition("[")[0].strip().split(".")):
                found = getattr(found, attribute)
        except (Exception, SystemExit) as error:
            raise self.refusal(f"cannot be imported: {type(error).__name__}: {error}") from error
        return found

    def called(self, act: Callable[[], T]) -> T:
        """Return what `act` returns, which calls code of this package; what that raises is told to be the package's.

        Raises:
            PluginError: it raised, and neither an error of ours nor in a package of ours.
            SystemExit: it ended the program, which only a command may do.
        """
        try:
            return act()
        except (Exception, SystemExit) as error:
            from robot_runner.core.errors import RobotRunnerError  # noqa: PLC0415 - for a quick --help

            may_end = isinstance(error, SystemExit) and self.kind == "commands"
            if self.is_own or may_end or isinstance(error, RobotRunnerError | BrokenPipeError | MemoryError):
                raise
            raise self.refusal(f"raised {type(error).__name__}: {error}") from error

    def refusal(self, problem: str) -> PluginError:
        """Return the error for an entry point that cannot be used; `problem` completes "the plugin ..."."""
        from robot_runner.core.errors import PluginError  # noqa: PLC0415 - for a quick --help

        fix = f"Install or repair the package {self.package}."
        return PluginError(f"the {self.kind.removesuffix('s')} {problem}", where=self.where, fix=fix)


def instances_of(kind: type[T], returned: Iterable[T]) -> list[T]:
    """Return as a list what another package's code has returned.

    Raises:
        TypeError: an element is of another type.
    """
    found = list(returned)
    for each in found:
        if not isinstance(each, kind):
            raise TypeError(f"{each!r} is not of type {kind.__name__}")
    return found


#: Cache: for each entry of `sys.path`, the packages by normalised name with their entry points.
_read_before: dict[str, list[tuple[str, list[EntryPoint]]]] = {}
#: Cache: name and version by folder of metadata; reading our own takes a third of a millisecond.
_known_before: dict[str, tuple[str, str]] = {}


def entry_points(group: str) -> list[EntryPoint]:
    """Return the entry points of a group, sorted by name, Robot Runner's own first.

    If a package is on `sys.path` twice, the first one counts, as for an import. `group` is its name after
    `robot_runner.`, such as `links`.
    """
    full, seen, found = f"{_PREFIX}{group}", set(), []
    for entry in sys.path:
        if not isinstance(entry, str):  # a `Path` that a config has put there, which imports ignore, too
            continue
        if entry not in _read_before:
            _read_before[entry] = list(_packages_at(entry))
        for package, announced in _read_before[entry]:
            if package not in seen:
                seen.add(package)
                found += [point for point in announced if point.group == full]
    return sorted(found, key=lambda point: (not point.is_own, point.name))


def named_entry_point(group: str, name: str) -> EntryPoint | None:
    """Return the first entry point of this name in a group, so that no package can replace Robot Runner's own."""
    return next((point for point in entry_points(group) if point.name == name), None)


def _packages_at(entry: str) -> Iterator[tuple[str, list[EntryPoint]]]:
    folder = entry or os.curdir
    if os.path.isfile(folder) or folder.endswith(".egg"):  # noqa: PTH113 - `pathlib` takes too long to import
        yield from _packages_in_archive(folder)
        return
    try:
        names = sorted(os.listdir(folder))  # noqa: PTH208 - as above
    except OSError:
        return
    for name in names:
        if name.endswith(_METADATA) and not name.startswith("~"):  # left by pip where it could not remove a package
            path = os.path.join(folder, name)  # noqa: PTH118 - as above
            yield _normalised(name.partition("-")[0].removesuffix(".egg")), _points_in(path)


def _normalised(package: str) -> str:
    return package.lower().replace("-", "_").replace(".", "_")


def _points_in(metadata: str) -> list[EntryPoint]:
    try:
        with open(f"{metadata}/entry_points.txt", encoding="utf-8", errors="replace") as file:  # noqa: PTH123 - as above
            text = file.read()
    except OSError:  # most packages announce nothing
        return []
    return list(_parsed(text, lambda: _distribution_at(metadata))) if f"[{_PREFIX}" in text else []


def _parsed(text: str, distribution: Callable[[], tuple[str, str]]) -> Iterator[EntryPoint]:
    group = ""
    for line in map(str.strip, text.splitlines()):
        if line.startswith("[") and line.endswith("]"):
            group = line[1:-1].strip()
        elif group.startswith(_PREFIX) and not line.startswith("#"):
            name, equals, value = line.partition("=")
            if equals:
                yield EntryPoint(name.strip(), group, value.strip(), distribution)


def _distribution_at(metadata: str) -> tuple[str, str]:
    from importlib.metadata import Distribution  # noqa: PLC0415 - only where it is shown

    if metadata not in _known_before:
        found = Distribution.at(metadata)
        _known_before[metadata] = (_told(found.metadata["Name"]), _told(found.metadata["Version"]))
    return _known_before[metadata]


def _packages_in_archive(path: str) -> Iterator[tuple[str, list[EntryPoint]]]:
    from importlib.metadata import distributions  # noqa: PLC0415 - archives on sys.path are rare

    for found in distributions(path=[path]):
        about = (_told(found.metadata["Name"]), _told(found.metadata["Version"]))
        text = found.read_text("entry_points.txt") or ""
        yield _normalised(about[0]), list(_parsed(text, lambda about=about: about))  # type: ignore[misc]


def _told(text: str | None) -> str:
    return text or "unknown"
