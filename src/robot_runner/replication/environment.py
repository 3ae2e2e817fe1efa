"""The recorded environment of an experiment.

The manifest has the names and versions of the packages that were installed when the experiment was executed. If the
same version is installed while packing, more is known: its source, a fingerprint of its files and, for a package from
a local folder, its wheel. This module uses no network. It does not know the hashes of files from an index, since
installers do not keep them; `index_hashes` asks for them.
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from importlib.metadata import packages_distributions
from pathlib import Path
from typing import Any

from robot_runner.core.config.dialects import stand_in_modules
from robot_runner.core.config.local_modules import editable_folders
from robot_runner.core.config.source import tree_or_empty
from robot_runner.core.entry_points import EntryPoint, entry_points, named_entry_point
from robot_runner.core.errors import Finding
from robot_runner.core.storage.guarded_files import read_bytes
from robot_runner.core.storage.input_files import copies_in
from robot_runner.core.words import listed, one_line
from robot_runner.replication.distributions import (
    InstalledDistribution,
    canonical,
    closure,
    installed_distributions,
    spec_of,
)

_OUR_NAME = "robot-runner"
#: A package with its version. Pip would execute more than that: `-e PATH` on a line of its own, in another's manifest.
_PIN = re.compile(r"[a-z0-9](?:[a-z0-9.-]*[a-z0-9])?==[A-Za-z0-9][A-Za-z0-9.!+_-]*")
_GLIBC = ("manylinux2014", *(f"manylinux_2_{minor}" for minor in (17, 24, 26, 27, 28, 31, 34, 35, 36)))
#: Usual platforms of replications, by pip's tags: the oldest first, since its files fit most machines.
PLATFORMS: Mapping[str, tuple[str, ...]] = {
    "Linux on x86-64": tuple(f"{each}_x86_64" for each in _GLIBC),
    "Linux on aarch64": tuple(f"{each}_aarch64" for each in _GLIBC),
    "macOS on arm64": ("macosx_14_0_arm64",),
}


@dataclass(frozen=True, slots=True)
class PackageRecord:
    """One installed package.

    Attributes:
        is_needed: whether the experiment needs it, directly or through other packages.
        source: `index` (also if the installer left no note), `local`, `url` or `version control`; None if this version
            is not installed while packing, so that only its version is known.
        requirement: its line in a requirements file.
        sha256: of the file from which it was installed; None if unknown.
        fingerprint: of its installed files; None if unknown.
        imported_by: the parts of the experiment that import it: `config`, plugins, the robot.
    """

    name: str
    version: str
    is_needed: bool
    source: str | None
    requirement: str
    sha256: str | None = None
    fingerprint: str | None = None
    imported_by: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class RecordedEnvironment:
    """The environment in which an experiment was executed.

    Attributes:
        packages: the installed packages, by canonical name, sorted.
        local: the needed distributions that exist only on this machine.
        findings: on facts that are unknown.
        index_hashes: hashes of the files in a package index, by canonical name; empty if no index was asked.
    """

    manifest: Mapping[str, Any]
    packages: Mapping[str, PackageRecord]
    local: tuple[InstalledDistribution, ...] = ()
    findings: tuple[Finding, ...] = field(default=())
    index_hashes: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    @property
    def python(self) -> str:
        """The version of Python."""
        return one_line(str(self.manifest.get("software", {}).get("python", "")))

    @property
    def needed(self) -> tuple[PackageRecord, ...]:
        """The packages that the experiment needs, by name."""
        return tuple(each for each in self.packages.values() if each.is_needed)

    def without_hash(self, wheels: Mapping[str, str]) -> tuple[PackageRecord, ...]:
        """Return the packages without a known hash, by name."""
        return tuple(each for each in self.needed if not self._hashes(each, wheels))

    def _hashes(self, record: PackageRecord, wheels: Mapping[str, str]) -> tuple[str, ...]:
        name = canonical(record.name)
        known = wheels.get(name) or record.sha256
        return (known,) if known else self.index_hashes.get(name, ())

    def requirements(self, wheels: Mapping[str, str]) -> str:
        """Return the text of a requirements file.

        Args:
            wheels: the hash of each wheel in the package, by the canonical name of its distribution.
        """
        return "".join(f"{line}\n" for line in self._lines(wheels))

    def _lines(self, wheels: Mapping[str, str]) -> Iterator[str]:
        # With one hash in the file, pip demands hashes of all packages.
        is_complete = bool(self.needed) and not self.without_hash(wheels)
        yield f"# The packages that the experiment needs, as they were installed (Python {self.python})."
        if not is_complete:
            yield "# Not every file's hash is known, so that none can be demanded: those known are comments."
        if self.index_hashes:
            yield f"# The hashes are of the index's files for this Python, on: {', '.join(PLATFORMS)}."
        yield "# environment.json has a fingerprint of the installed files of each."
        if wheels:
            yield "# Some are in the folder wheels: pip install --find-links wheels -r requirements.txt"
        for each in self.needed:
            known = "".join(f" --hash=sha256:{digest}" for digest in self._hashes(each, wheels))
            yield f"{each.requirement}{'  #' if known and not is_complete else ''}{known}"

    def as_mapping(self, wheels: Mapping[str, str]) -> dict[str, Any]:
        """Return everything as plain data."""
        software = self.manifest.get("software", {})
        packages = {
            name: {
                "name": each.name,
                "version": each.version,
                "is_needed": each.is_needed,
                "source": each.source,
                "sha256": wheels.get(name) or each.sha256,
                "fingerprint": each.fingerprint,
                **({"imported_by": list(each.imported_by)} if each.imported_by else {}),
            }
            for name, each in self.packages.items()
        }
        return {
            "python": software.get("python"),
            "implementation": software.get("implementation"),
            "packages": packages,
            "system": software.get("system"),
            "system_packages": software.get("system_packages"),
            "programs": self.manifest.get("programs"),
            **{name: self.manifest.get(name) for name in ("robot", "ros", "host", "clocks")},
        }


def record_environment(manifest: Mapping[str, Any], config: Path) -> RecordedEnvironment:
    """Return the environment of an experiment, from its manifest and from the packages installed here.

    Args:
        manifest: the experiment's.
        config: the folder of its config file and local modules.
    """
    software = manifest.get("software", {})
    packages = dict(software.get("packages") or {})
    if software.get("robot_runner"):
        packages.setdefault(_OUR_NAME, software["robot_runner"])
    pins = dict(sorted((canonical(name), f"{canonical(name)}=={release}") for name, release in packages.items()))
    odd = sorted(name for name, pin in pins.items() if not _PIN.fullmatch(pin))
    recorded = {name: pin.partition("==")[2] for name, pin in pins.items() if name not in odd}
    installed = installed_distributions()
    same = {
        name: installed[name] for name in recorded if name in installed and installed[name].version == recorded[name]
    }
    # If it is packed in another environment, the dependencies between packages are unknown.
    needed = closure(_roots(manifest, config)) & set(recorded) if _OUR_NAME in same else set(recorded)
    imported = importers(manifest, config)
    records = {
        name: replace(_record(f"{name}=={release}", same.get(name), name in needed), imported_by=imported.get(name, ()))
        for name, release in recorded.items()
    }
    local = tuple(each for name, each in same.items() if name in needed and each.is_local)
    return RecordedEnvironment(manifest, records, local, tuple(_findings(recorded, same, needed, odd)))


def _roots(manifest: Mapping[str, Any], config: Path) -> set[str]:
    plugins = {str(each["package"]) for each in manifest.get("plugins", ()) if each.get("package")}
    makers = (each for each in entry_points("preparations") if manifest.get(each.name))
    brought = {each.package for each in (*_links(manifest), *makers)}
    return {_OUR_NAME, *plugins, *brought, *(owner for name in imported_names(config) for owner in owners_of(name))}


def _record(pinned: str, installed: InstalledDistribution | None, is_needed: bool) -> PackageRecord:
    name, _, release = pinned.partition("==")
    if installed is None:
        return PackageRecord(name, release, is_needed, None, pinned)
    source, requirement = _source(installed, pinned)
    fingerprint = None if installed.is_editable else installed.fingerprint
    return PackageRecord(name, release, is_needed, source, requirement, installed.archive_sha256, fingerprint)


def _source(installed: InstalledDistribution, pinned: str) -> tuple[str, str]:
    direct = installed.direct_url
    if not direct or installed.is_local:
        return "local" if direct else "index", pinned
    name, url = pinned.partition("==")[0], str(direct["url"])
    inside = f"#subdirectory={direct['subdirectory']}" if direct.get("subdirectory") else ""
    if "vcs_info" in direct:
        info = direct["vcs_info"]
        return "version control", f"{name} @ {info.get('vcs', 'git')}+{url}@{info.get('commit_id', '')}{inside}"
    return "url", f"{name} @ {url}{inside}"


def _findings(
    recorded: Mapping[str, str], same: Mapping[str, InstalledDistribution], needed: set[str], odd: Sequence[str]
) -> Iterator[Finding]:
    if odd:
        problem = f"the manifest names what cannot be a package with its version, and is left out: {listed(odd)}"
        yield Finding.warning("environment", problem, "Ask who executed the experiment whether the folder was changed.")
    unknown = sorted(needed - set(same))
    if not recorded:
        problem = "the manifest does not say what was installed"
        fix = "Write down in the citation or a README how the results were made."
    elif _OUR_NAME not in same:
        problem = "this is not the environment in which the experiment was executed: all that it had is listed"
        fix = "Pack where it was executed, to have fingerprints and local packages too."
    elif unknown:
        problem = f"another version is installed here than when it was executed, or none: {', '.join(unknown)}"
        fix = "Pack in the environment in which it was executed."
    else:
        return
    yield Finding.warning("environment", problem, fix)


#: Packages that every experiment imports, whatever its robot and plugins are.
_FRAME = ("robot_runner.core", "robot_runner.cli", "robot_runner.plugins", "robot_runner.testing")
#: The distributions of each top-level module.
_owners = cache(packages_distributions)


def importers(manifest: Mapping[str, Any], config: Path | None = None) -> dict[str, tuple[str, ...]]:
    """Return the parts of an experiment that import each package, by canonical name; only of packages installed here.

    Args:
        manifest: the experiment's; its plugins and its robot are examined.
        config: the folder of the config file and its local modules, if available.

    Raises:
        OSError: a file of the config cannot be read.
    """
    found: dict[str, list[str]] = {}
    for who, modules in _parts(manifest, config):
        for name in sorted(modules.difference(sys.stdlib_module_names)):
            for owner in owners_of(name):
                found.setdefault(canonical(owner), []).append(who)
    return {name: tuple(dict.fromkeys(names)) for name, names in found.items()}


def _parts(manifest: Mapping[str, Any], config: Path | None) -> Iterator[tuple[str, set[str]]]:
    yield from ((f"robot {link.name}", _reached(link.module)) for link in _links(manifest))
    for plugin in manifest.get("plugins") or ():
        yield str(plugin.get("name")), _reached(str(plugin.get("class", "")).partition(":")[0])
    if config is not None:
        yield "config", imported_names(config)


def _links(manifest: Mapping[str, Any]) -> Iterator[EntryPoint]:
    """Yield the kinds of links by which the robots of an experiment are reached, as far as they are installed."""
    robots = manifest.get("robots")
    reached = (manifest.get("robot"), *(robots.values() if isinstance(robots, Mapping) else ()))
    names = dict.fromkeys(str(each or "").partition(":")[0] for each in reached)
    yield from filter(None, (named_entry_point("links", name) for name in names))


def owners_of(module: str) -> list[str]:
    """Return the distributions of a top-level module; the module's own name if it is imported from a folder."""
    return _owners().get(module) or _editable_owners(module) or [module]


def _editable_owners(module: str) -> list[str]:
    """Return the editable distribution with a module's code: many build backends do not note its modules."""
    place = place_of(module)
    parents = {place, *place.parents} if place is not None else set()
    return [name for folder, name in editable_folders().items() if folder in parents]


def place_of(module: str) -> Path | None:
    """Return the folder or the file of a top-level module, which is not imported; None if it is not found."""
    spec = spec_of(module)
    places = [*(spec.submodule_search_locations or ()), spec.origin] if spec else []
    return next((Path(place) for place in places if place), None)


def modules_to_install(config: Path) -> set[str]:
    """Return the top-level modules that a config imports unconditionally and that have to be installed.

    Those in its folder, Python's and ours have not.

    Raises:
        OSError: a file of the config cannot be read.
    """
    # Also modules in folders, which the config may add to the path; if it does not, importing them fails later.
    local = {part.removesuffix(".py") for path in config.rglob("*.py") for part in path.relative_to(config).parts}
    # The paper's configs import `plugins`, which exists while a config is loaded.
    there = {*local, *stand_in_modules(), "plugins", *sys.stdlib_module_names, "robot_runner"}
    return imported_names(config, unconditionally=True) - there


def imported_names(folder: Path, *, unconditionally: bool = False) -> set[str]:
    """Return the top-level modules that the Python files in a folder of configs import, found without executing them.

    The experiment's input files, such as a script under test, are skipped: they may be for another Python.

    Args:
        folder: the folder.
        unconditionally: whether to skip imports in `try`, `if`, `with` or `match`, such as those of type checkers.

    Raises:
        OSError: a file cannot be read.
        StorageError: the index of the files that the experiment reads cannot be read.
    """
    found: set[str] = set()
    read = copies_in(folder)
    for path in sorted(each for each in folder.rglob("*.py") if each.absolute() not in read):
        names = _imports(read_bytes(path), "", unconditionally=unconditionally)
        found.update(name.partition(".")[0] for name in names)
    return found


#: What is imported in these may be missing: `try: import cupy`, `if TYPE_CHECKING:`, `with suppress(ImportError):`.
_CONDITIONAL = (ast.Try, ast.TryStar, ast.If, ast.With, ast.Match)


@cache
def _reached(module: str) -> set[str]:
    """Return the top-level modules that a module imports, directly or through modules of its own package."""
    top = module.partition(".")[0]
    found, pending, seen = {top}, [module], set()
    while pending:
        file = _file_of(pending.pop())
        if file is None or file in seen:
            continue
        seen.add(file)
        for imported in _imports_of(*file):
            first = imported.partition(".")[0]
            if first != top:
                found.add(first)
            elif not imported.startswith(_FRAME):
                pending.append(imported)
    return found


@cache
def _file_of(module: str) -> tuple[Path, str] | None:
    """Return the file and package of a module or, if the name is an object's, of its module; nothing is imported."""
    top, *rest = module.split(".")
    spec = spec_of(top)
    for folder in spec.submodule_search_locations or () if spec else ():
        place, package = Path(folder), top
        for part in rest:
            if not (place / part).is_dir():
                file = place / f"{part}.py"
                return (file if file.is_file() else place / "__init__.py"), package
            place, package = place / part, f"{package}.{part}"
        return place / "__init__.py", package
    return (Path(spec.origin), "") if spec and not rest and spec.origin and spec.has_location else None


@cache  # the modules of our own that several plugins share are dear to parse
def _imports_of(file: Path, package: str) -> tuple[str, ...]:
    try:
        return tuple(_imports(file.read_bytes(), package))
    except OSError:
        return ()


def _imports(content: bytes, package: str, *, unconditionally: bool = False) -> Iterable[str]:
    """Yield the full names of a file's imports, also those in functions; nothing if the file is not valid Python."""
    for node in _statements(tree_or_empty(content), unconditionally=unconditionally):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and (not node.level or package):
            above = package.split(".")[: len(package.split(".")) - node.level + 1] if node.level else []
            module = ".".join([*above, *([node.module] if node.module else [])])
            yield from (f"{module}.{alias.name}" for alias in node.names)


def _statements(tree: ast.Module, *, unconditionally: bool) -> Iterator[ast.AST]:
    """Yield all nested statements: a tenth of the nodes of `ast.walk`, since expressions import nothing."""
    pending: list[ast.AST] = [tree]
    while pending:
        node = pending.pop()
        yield node
        if unconditionally and isinstance(node, _CONDITIONAL):
            continue
        for part in ("body", "orelse", "finalbody", "handlers", "cases"):
            pending += getattr(node, part, ())
