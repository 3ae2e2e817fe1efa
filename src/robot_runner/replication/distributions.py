"""The installed Python distributions: their sources, their dependencies, and wheels of those from local folders.

Nobody else can get a distribution that was installed from a folder of this machine. Its wheel is made from the
installed files, not built from its source: the source may have changed since, and building executes its code, with
tools that may have to be downloaded.
"""

from __future__ import annotations

import ast
import base64
import csv
import hashlib
import json
import re
import sys
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO
from urllib.parse import urlsplit

from robot_runner.replication.plain_zip import PlainZip

if TYPE_CHECKING:
    from importlib.machinery import ModuleSpec

    from packaging.requirements import Requirement

#: Extras for the developers of a package, not for its users.
_NOT_FOR_USERS = frozenset({"dev", "develop", "doc", "docs", "lint", "test", "testing", "tests", "typing"})
#: Files that installers write, so that they differ between machines.
_WRITTEN_BY_INSTALLERS = frozenset(
    {"INSTALLER", "RECORD", "REQUESTED", "direct_url.json", "uv_build.json", "uv_cache.json"}
)
#: What lies beside the code of a package in a project's folder.
_NOT_OF_CODE = frozenset(
    {"benchmarks", "build", "conftest", "dist", "doc", "docs", "examples", "noxfile", "setup", "test", "tests"}
)
#: The module by which setuptools finds the code of an editable package that lies in no folder of its own.
_FINDER = re.compile(r"__editable___\w+_finder\.py")
_TAG = re.compile(r"^Tag: (\S+)$", re.MULTILINE)


def canonical(name: str) -> str:
    """Return a distribution's normalised name (PEP 503), by which names are compared.

    Example:
        >>> canonical("Annotated_Types")
        'annotated-types'
    """
    return re.sub(r"[-_.]+", "-", name).lower()


def spec_of(module: str) -> ModuleSpec | None:
    """Return where a top-level module is, which is not imported; None if it is not found."""
    try:
        return find_spec(module)
    except (ImportError, ValueError):
        return None


@dataclass(frozen=True, slots=True)
class InstalledDistribution:
    """One distribution that is installed here."""

    name: str
    version: str
    distribution: metadata.Distribution

    @property
    def direct_url(self) -> dict[str, Any]:
        """Its source, unless that is an index (PEP 610); empty then."""
        try:
            found = json.loads(self.distribution.read_text("direct_url.json") or "{}")
        except ValueError:
            return {}
        return found if isinstance(found, dict) else {}

    @property
    def is_local(self) -> bool:
        """Whether its source is a file or folder of this machine, so that nobody else can get it."""
        return urlsplit(str(self.direct_url.get("url", ""))).scheme == "file"

    @property
    def is_editable(self) -> bool:
        """Whether its code is still in the folder from which it was installed."""
        return bool(self.direct_url.get("dir_info", {}).get("editable"))

    @property
    def archive_sha256(self) -> str | None:
        """The SHA-256 of the file from which it was installed, if the installer kept it: not for files of an index."""
        info = self.direct_url.get("archive_info", {})
        algorithm, _, digest = str(info.get("hash", "")).partition("=")  # the older form, before `hashes`
        return info.get("hashes", {}).get("sha256") or (digest if algorithm == "sha256" else "") or None

    @property
    def fingerprint(self) -> str | None:
        """A hash of the hashes of its installed files in its RECORD; None if there are none.

        Files that an installer writes (byte code, scripts, its own notes) do not count, so that the same wheel has the
        same fingerprint wherever it is installed.
        """
        record = csv.reader((self.distribution.read_text("RECORD") or "").splitlines())
        lines = sorted(f"{name} {digest}" for name, digest, *_ in record if digest and _is_of_wheel(name))
        return hashlib.sha256("\n".join(lines).encode()).hexdigest() if lines else None


def _is_of_wheel(name: str) -> bool:
    is_outside = name.startswith("../")
    return not (is_outside or name.rpartition("/")[2] in _WRITTEN_BY_INSTALLERS or name.endswith(".pyc"))


def distributions_in(folders: list[str]) -> dict[str, InstalledDistribution]:
    """Return the distributions in these folders, by canonical name; the first of each name counts."""
    found: dict[str, InstalledDistribution] = {}
    for each in metadata.distributions(path=folders):
        facts = each.metadata  # read and parsed at each access
        if name := facts["Name"]:
            found.setdefault(canonical(name), InstalledDistribution(name, facts["Version"], each))
    return found


@cache
def installed_distributions() -> dict[str, InstalledDistribution]:
    """Return the distributions that are installed here, by canonical name."""
    return distributions_in(sys.path)


def closure(roots: Iterable[str]) -> set[str]:
    """Return the canonical names of these distributions and of all their dependencies.

    The dependencies of a distribution that is not installed are unknown. Extras of the roots count if all their
    requirements are installed, since installers do not record with which extras a distribution was installed.
    """
    pending = [(name, {"", *_extras(name)}) for name in map(canonical, roots)]
    seen: dict[str, set[str]] = {}
    while pending:
        name, extras = pending.pop()
        if extras <= seen.setdefault(name, set()):
            continue
        seen[name] |= extras
        asked = (each for each in _requirements(name) if _is_asked_by(extras, each))
        pending += [(canonical(each.name), {"", *each.extras}) for each in asked]
    return set(seen)


def _extras(name: str) -> set[str]:
    """Return the extras of a distribution that seem to have been installed with it."""
    installed = installed_distributions()
    known = installed[name].distribution.metadata if name in installed else None
    offered = set(known.get_all("Provides-Extra") or ()) - _NOT_FOR_USERS if known else set()
    asked = {extra: packages_of_extra(name, extra) for extra in offered}
    return {extra for extra, names in asked.items() if names and names <= installed.keys()}


def packages_of_extra(name: str, extra: str) -> set[str]:
    """Return the canonical names of an extra's additional requirements; none if the distribution is not installed."""
    return {canonical(each.name) for each in _optional_requirements(name) if _is_asked_by({extra}, each)}


@cache  # the requirements of a distribution are needed for each of its extras, and are parsed at each access
def _requirements(name: str) -> tuple[Requirement, ...]:
    from packaging.requirements import Requirement  # noqa: PLC0415 - an extra

    known = installed_distributions().get(name)
    return tuple(map(Requirement, (known.distribution.requires if known else None) or ()))


@cache
def _optional_requirements(name: str) -> tuple[Requirement, ...]:
    return tuple(each for each in _requirements(name) if not _is_asked_by({""}, each))


def _is_asked_by(extras: set[str], requirement: Requirement) -> bool:
    marker = requirement.marker
    return marker is None or any(marker.evaluate({"extra": extra}) for extra in extras)


def wheel_of(distribution: InstalledDistribution) -> dict[str, Path]:
    """Return the files of a distribution's wheel by their names in it; none if its code cannot be found.

    Raises:
        OSError: a folder cannot be read.
    """
    named = [
        (name, Path(str(path.locate())))
        for path in distribution.distribution.files or ()
        if _is_of_wheel(name := path.as_posix())
    ]
    notes = {name: path for name, path in named if ".dist-info" in name.partition("/")[0]}
    installed = {name: path for name, path in named if name not in notes}
    code = dict(_editable_code(distribution)) if distribution.is_editable else installed
    files = {name: path for name, path in {**notes, **code}.items() if path.is_file()}
    return dict(sorted(files.items())) if code and notes else {}


def wheel_name(distribution: InstalledDistribution) -> str:
    """Return the file name of a distribution's wheel (PEP 427)."""
    tags = _TAG.findall(distribution.distribution.read_text("WHEEL") or "") or ["py3-none-any"]
    name = re.sub(r"[-_.]+", "_", distribution.name)
    joined = "-".join(".".join(dict.fromkeys(part)) for part in zip(*(tag.split("-") for tag in tags), strict=True))
    return f"{name}-{distribution.version}-{joined}.whl"


def write_wheel(files: Mapping[str, Path], target: Path | BinaryIO) -> None:
    """Write a wheel of these files, with its RECORD (PEP 376): the same files give the same bytes.

    Raises:
        OSError: a file cannot be read, or the wheel not be written.
    """
    record = f"{next(name.partition('/')[0] for name in files if '.dist-info/' in name)}/RECORD"
    wheel = PlainZip(target)
    for name, path in files.items():
        wheel.add(name, [path.read_bytes()])
    lines = [f"{each.name},sha256={_urlsafe(each.sha256)},{each.size}" for each in wheel.stored.values()]
    wheel.add(record, ["\n".join([*lines, f"{record},,"]).encode() + b"\n"])
    wheel.close()


def _urlsafe(sha256: str) -> str:
    return base64.urlsafe_b64encode(bytes.fromhex(sha256)).rstrip(b"=").decode()


def _editable_code(distribution: InstalledDistribution) -> Iterator[tuple[str, Path]]:
    """Yield the package's code: in the folders that its `.pth` file names, and where setuptools' finder has it."""
    listed = (distribution.distribution.read_text("top_level.txt") or "").split()
    announced = {point.module.partition(".")[0] for point in distribution.distribution.entry_points}
    known = {*listed, *announced, re.sub(r"[-.]+", "_", distribution.name)}
    places = [
        (top, root / top)
        for root in _path_entries(distribution)
        for top in sorted(known if listed else known | set(_modules_in(root)))
    ]
    for module, place in (*places, *_mapped(distribution)):
        name = module.replace(".", "/")
        for path in (place.with_name(f"{place.name}.py"), *sorted(place.rglob("*"))):
            if path.is_file() and not path.is_symlink() and path.suffix != ".pyc":
                inside = path.relative_to(place).as_posix() if place in path.parents else ""
                yield f"{name}/{inside}" if inside else f"{name}.py", path


def _modules_in(root: Path) -> Iterator[str]:
    """Yield the modules of a folder of code, for a build backend that lists none; the folder may be the project's."""
    for path in root.iterdir():
        name = path.name.removesuffix(".py")
        if name not in _NOT_OF_CODE and (path.suffix == ".py" or (path / "__init__.py").is_file()):
            yield name


def _path_entries(distribution: InstalledDistribution) -> Iterator[Path]:
    for path in distribution.distribution.files or ():
        if path.suffix == ".pth":
            lines = Path(str(path.locate())).read_text(encoding="utf-8").splitlines()
            yield from (Path(line.strip()) for line in lines if line.startswith("/"))


def _mapped(distribution: InstalledDistribution) -> Iterator[tuple[str, Path]]:
    """Yield each module with its folder, or its file without the suffix, as the finder of setuptools has them."""
    for path in distribution.distribution.files or ():
        if _FINDER.fullmatch(path.name):
            for node in ast.parse(Path(str(path.locate())).read_bytes()).body:
                match node:
                    case (
                        ast.Assign(targets=[ast.Name(id="MAPPING")], value=ast.Dict() as value)
                        | ast.AnnAssign(target=ast.Name(id="MAPPING"), value=ast.Dict() as value)
                    ):
                        yield from ((name, Path(place)) for name, place in ast.literal_eval(value).items())
