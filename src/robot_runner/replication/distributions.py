"""Wheels of distributions that were installed from a folder of this machine: nobody else could get them.

The same distribution gives the same bytes: files in order, without times.
"""

from __future__ import annotations

import base64
import hashlib
import json
import re
import zipfile
from dataclasses import dataclass
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

from robot_runner.replication.plain_zip import STAMP

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

__all__ = [
    "InstalledDistribution",
    "canonical",
    "closure",
    "installed_distributions",
    "record_hash",
    "wheel_name",
    "wheel_of",
    "write_wheel",
]


# The installed Python distributions: what each holds, where it came from, and what it needs.

#: Extras for who develops a package, not for who uses it.
_NOT_FOR_USERS = frozenset({"dev", "develop", "doc", "docs", "lint", "test", "testing", "tests", "typing"})
#: Written by whoever installs, so that they differ from machine to machine.
_WRITTEN_BY_INSTALLERS = frozenset(
    {"INSTALLER", "RECORD", "REQUESTED", "direct_url.json", "uv_build.json", "uv_cache.json"}
)


def canonical(name: str) -> str:
    """Return a distribution's name as comparing names takes it (PEP 503).

    Example:
        >>> canonical("Annotated_Types")
        'annotated-types'
    """
    return re.sub(r"[-_.]+", "-", name).lower()


@dataclass(frozen=True, slots=True)
class InstalledDistribution:
    """One distribution that is installed here."""

    name: str
    version: str
    distribution: metadata.Distribution

    @property
    def direct_url(self) -> dict[str, Any]:
        """Where it was installed from, where that was no index (PEP 610); empty otherwise."""
        try:
            found = json.loads(self.distribution.read_text("direct_url.json") or "{}")
        except ValueError:
            return {}
        return found if isinstance(found, dict) else {}

    @property
    def is_local(self) -> bool:
        """Whether it was installed from a file or folder of this machine, so that nobody else can get it."""
        return urlsplit(str(self.direct_url.get("url", ""))).scheme == "file"

    @property
    def is_editable(self) -> bool:
        """Whether its code is still in the folder that it was installed from."""
        return bool(self.direct_url.get("dir_info", {}).get("editable"))

    @property
    def archive_sha256(self) -> str | None:
        """The hash of the file that it was installed from, where the installer kept it: not for those of an index."""
        info = self.direct_url.get("archive_info", {})
        digest = info.get("hashes", {}).get("sha256") or str(info.get("hash", "")).removeprefix("sha256=")
        return digest or None

    @property
    def fingerprint(self) -> str | None:
        """A hash of the hashes of its installed files, as its RECORD has them; None where it has none.

        What an installer writes (byte code, scripts, its own notes) does not count, so that the same wheel has the same
        fingerprint wherever it is installed.
        """
        lines = sorted(self._hashes())
        return hashlib.sha256("\n".join(lines).encode()).hexdigest() if lines else None

    def _hashes(self) -> Iterator[str]:
        for path in self.distribution.files or ():
            is_outside = path.parts[0] == ".."
            if path.hash is None or is_outside or path.name in _WRITTEN_BY_INSTALLERS or path.suffix == ".pyc":
                continue
            yield f"{path.as_posix()} {path.hash.mode}={path.hash.value}"


@cache
def installed_distributions() -> dict[str, InstalledDistribution]:
    """Return what is installed here, by canonical name; what comes first on the path counts."""
    found: dict[str, InstalledDistribution] = {}
    for each in metadata.distributions():
        name = each.metadata["Name"]
        if name:
            found.setdefault(canonical(name), InstalledDistribution(name, each.version, each))
    return found


def closure(roots: Iterable[str]) -> set[str]:
    """Return the canonical names of these distributions and of everything that they need, as far as it is installed.

    Extras of the roots count where all that they ask for is installed: nobody keeps with which one they were installed.
    """
    from packaging.requirements import Requirement  # noqa: PLC0415 - an extra

    installed = installed_distributions()
    pending = [(name, frozenset({""}) | _extras(name)) for name in map(canonical, roots)]
    seen: dict[str, frozenset[str]] = {}
    while pending:
        name, extras = pending.pop()
        known = seen.get(name, frozenset())
        if name not in installed or (name in seen and extras <= known):
            continue
        seen[name] = known | extras
        for text in installed[name].distribution.requires or ():
            requirement = Requirement(text)
            if requirement.marker and not any(requirement.marker.evaluate({"extra": extra}) for extra in extras):
                continue
            pending.append((canonical(requirement.name), frozenset({"", *requirement.extras})))
    return set(seen)


def _extras(name: str) -> frozenset[str]:
    from packaging.requirements import Requirement  # noqa: PLC0415 - an extra

    installed = installed_distributions()
    if name not in installed:
        return frozenset()
    distribution = installed[name].distribution
    offered = set(distribution.metadata.get_all("Provides-Extra") or ()) - _NOT_FOR_USERS
    requirements = [Requirement(text) for text in distribution.requires or ()]

    def is_satisfied(extra: str) -> bool:
        asked = [each for each in requirements if each.marker and _is_for(each, extra)]
        return bool(asked) and all(canonical(each.name) in installed for each in asked)

    return frozenset(extra for extra in offered if is_satisfied(extra))


def _is_for(requirement: Any, extra: str) -> bool:
    return bool(requirement.marker.evaluate({"extra": extra})) and not requirement.marker.evaluate({"extra": ""})


def record_hash(data: bytes) -> str:
    """Return a hash as a RECORD has it (PEP 376)."""
    return "sha256=" + base64.urlsafe_b64encode(hashlib.sha256(data).digest()).rstrip(b"=").decode()


_NOT_OF_THE_WHEEL = frozenset({"INSTALLER", "RECORD", "REQUESTED", "direct_url.json", "uv_build.json", "uv_cache.json"})
_TAG = re.compile(r"^Tag: (\S+)$", re.MULTILINE)


def wheel_of(distribution: InstalledDistribution) -> dict[str, Path]:
    """Return the files of its wheel by their names in it; nothing where they cannot be told.

    Raises:
        OSError: a folder cannot be read.
    """
    information = _information_folder(distribution)
    if information is None:
        return {}
    files = {f"{information.name}/{path.relative_to(information).as_posix()}": path for path in _below(information)}
    code = dict(_editable_code(distribution) if distribution.is_editable else _installed_code(distribution))
    if not code:
        return {}
    return dict(sorted({**code, **{name: path for name, path in files.items() if _is_of_wheel(path)}}.items()))


def wheel_name(distribution: InstalledDistribution) -> str:
    """Return what the file of its wheel is called (PEP 427)."""
    tags = _TAG.findall(distribution.distribution.read_text("WHEEL") or "") or ["py3-none-any"]
    name = re.sub(r"[-_.]+", "_", distribution.name)
    joined = "-".join(".".join(dict.fromkeys(part)) for part in zip(*(tag.split("-") for tag in tags), strict=True))
    return f"{name}-{distribution.version}-{joined}.whl"


def write_wheel(files: dict[str, Path], target: Path) -> None:
    """Write a wheel of these files, with its RECORD.

    Raises:
        OSError: a file cannot be read, or the wheel not be written.
    """
    information = next(name.partition("/")[0] for name in files if ".dist-info/" in name)
    record = []
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, path in files.items():
            data = path.read_bytes()
            record.append(f"{name},{record_hash(data)},{len(data)}")
            archive.writestr(_entry(name), data)
        name = f"{information}/RECORD"
        archive.writestr(_entry(name), "\n".join([*record, f"{name},,"]) + "\n")


def _entry(name: str) -> zipfile.ZipInfo:
    entry = zipfile.ZipInfo(name, STAMP)
    entry.compress_type = zipfile.ZIP_DEFLATED
    entry.create_system = 3
    entry.external_attr = 0o644 << 16
    return entry


def _information_folder(distribution: InstalledDistribution) -> Path | None:
    for path in distribution.distribution.files or ():
        if path.name == "METADATA" and path.parent.name.endswith(".dist-info"):
            return Path(str(distribution.distribution.locate_file(path.parent)))
    return None


def _is_of_wheel(path: Path) -> bool:
    return path.name not in _NOT_OF_THE_WHEEL


def _installed_code(distribution: InstalledDistribution) -> Iterator[tuple[str, Path]]:
    for path in distribution.distribution.files or ():
        is_code = path.parts[0] != ".." and ".dist-info" not in path.parts[0] and path.suffix != ".pyc"
        located = Path(str(distribution.distribution.locate_file(path)))
        if is_code and located.is_file():
            yield path.as_posix(), located


def _editable_code(distribution: InstalledDistribution) -> Iterator[tuple[str, Path]]:
    """Yield the code in the folder that the installed `.pth` file names: what the installed package imports."""
    tops = _top_names(distribution)
    for root in _path_entries(distribution):
        for top in sorted(tops):
            for path in (root / f"{top}.py", *(_below(root / top) if (root / top).is_dir() else ())):
                if path.is_file() and path.suffix != ".pyc" and "__pycache__" not in path.parts:
                    yield path.relative_to(root).as_posix(), path


def _path_entries(distribution: InstalledDistribution) -> Iterator[Path]:
    for path in distribution.distribution.files or ():
        if path.suffix == ".pth":
            text = Path(str(distribution.distribution.locate_file(path))).read_text(encoding="utf-8")
            yield from (Path(line.strip()) for line in text.splitlines() if line.startswith("/"))


def _top_names(distribution: InstalledDistribution) -> set[str]:
    listed = (distribution.distribution.read_text("top_level.txt") or "").split()
    announced = {point.module.partition(".")[0] for point in distribution.distribution.entry_points}
    return {*listed, *announced, re.sub(r"[-.]+", "_", distribution.name)}


def _below(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*") if path.is_file() and not path.is_symlink())
