"""Verify a package: is it intact, of a known format, and executable?"""

from __future__ import annotations

import hashlib
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from io import StringIO
from itertools import chain
from pathlib import Path
from typing import Any, TypedDict
from unicodedata import normalize

from robot_runner.core.errors import Finding, PackageError
from robot_runner.core.storage.declared_shapes import faults_of, parsed_json
from robot_runner.core.storage.file_shapes import Manifest
from robot_runner.core.storage.guarded_files import JSON_LIMIT
from robot_runner.core.storage.manifest import FORMAT as MANIFEST_FORMAT
from robot_runner.core.storage.registration import checksum_of
from robot_runner.core.words import counted, listed
from robot_runner.replication import contents
from robot_runner.replication.opening import OpenPackage, is_package
from robot_runner.replication.plain_zip import Progress

#: The size limit of files that are read as a whole: descriptions and checksums, bytes.
_LARGEST_TEXT = 32 << 20
_MOST_FINDINGS = 20
#: The limit of reported lines that are not checksums: a file that is not a list of checksums has many.
_MOST_BAD_LINES = 100


class _Named(TypedDict, total=False):
    name: str


class _Description(TypedDict, total=False):
    format: int
    experiment: str | None
    left_out: list[_Named]
    replaced: list[_Named]


class _Package(TypedDict):
    version: str


class _KnownPackage(_Package, total=False):
    fingerprint: str | None


class _Host(TypedDict, total=False):
    memory_bytes: int | None


class _Ros(TypedDict):
    version: Any


class _RosWithPackages(_Ros, total=False):
    packages: dict[str, str] | None


class Environment(TypedDict, total=False):
    """The entries of `environment.json` that the comparison with this machine needs."""

    packages: dict[str, _KnownPackage] | None
    host: _Host | None
    ros: _RosWithPackages | None


_SHAPES: dict[str, Any] = {
    contents.DESCRIPTION: _Description,
    contents.ENVIRONMENT: Environment,
    contents.MANIFEST: Manifest,
}
_LARGEST = dict.fromkeys((*_SHAPES, contents.REGISTRATION), JSON_LIMIT)
_SUM = re.compile(r"([0-9a-f]{64})  (.+)")
_ALTERED = "Get it again from where it came from."


@dataclass(frozen=True, slots=True)
class Verification:
    """The result of verifying a package.

    Attributes:
        description: its `package.json`.
        manifest: the manifest of its experiment.
        environment: the environment of its experiment.
        file_count, size: the number of its files, and their size in bytes.
        findings: all problems.
    """

    where: Path
    description: Mapping[str, Any]
    manifest: Mapping[str, Any]
    environment: Mapping[str, Any]
    file_count: int
    size: int
    findings: tuple[Finding, ...]

    @property
    def is_intact(self) -> bool:
        """Whether there are no errors."""
        return not any(finding.is_error for finding in self.findings)

    @property
    def experiment(self) -> str:
        """The experiment's name."""
        return str(self.description.get("experiment") or self.manifest.get("experiment_name") or "")

    @property
    def has_config(self) -> bool:
        """Whether it has a config, and so can be executed again; imported results have none."""
        return bool((self.manifest.get("config") or {}).get("file"))


def verify_package(package: OpenPackage, progress: Progress = lambda _, __: None) -> Verification:
    """Read a whole package and compare it with its checksums and descriptions.

    Args:
        package: the opened package.
        progress: called with the number of bytes read and the total.

    Raises:
        PackageError: the file is too damaged to be read, is not a package, or has a newer format.
        StorageError: the file cannot be read.
    """
    description = _description(package)
    manifest: Mapping[str, Any] = {}
    environment: Mapping[str, Any] = {}
    findings = list(package.faults)
    if not findings:  # otherwise its files are not read
        sums, findings = _sums(package)
        findings += _differing_names(package, sums)
        findings += _differing_contents(package, sums, progress)
        manifest = _mapping(package, contents.MANIFEST, findings)
        environment = _mapping(package, contents.ENVIRONMENT, findings)
        findings += _malformed(package, contents.DESCRIPTION, description)
        findings += _malformed(package, contents.ENVIRONMENT, environment)
        findings += [*_malformed(package, contents.MANIFEST, manifest)] or _unfit(package, manifest)
        findings += _registration(package, manifest, findings)
    more = len(findings) - _MOST_FINDINGS
    if more > 0:
        findings[_MOST_FINDINGS:] = [Finding.error(str(package.where), f"there are {more:,} more faults", _ALTERED)]
    count, size = len(package.sizes), sum(package.sizes.values())
    return Verification(package.where, description, manifest, environment, count, size, tuple(findings))


def refuse_faults(verification: Verification) -> None:
    """Refuse a package that is not intact.

    Raises:
        PackageError: there are errors; carries every finding.
    """
    PackageError.refuse(finding for finding in verification.findings if finding.is_error)


def _description(package: OpenPackage) -> Mapping[str, Any]:
    where = f"{package.where}, {contents.DESCRIPTION}"
    if contents.DESCRIPTION not in package.sizes:
        problem = f"this is not a package of `robot-runner pack`: it has no {contents.DESCRIPTION}"
        raise PackageError(problem, where=str(package.where), fix=_way_to_a_package(package))
    try:
        found = parsed_json(_text(package, contents.DESCRIPTION, JSON_LIMIT))
    except (ValueError, RecursionError) as error:
        raise PackageError(f"the file cannot be read: {error}", where=where, fix=_ALTERED) from error
    if not isinstance(found, dict) or not isinstance(found.get("format"), int):
        raise PackageError("the file does not describe a package", where=where, fix=_ALTERED)
    if found["format"] > contents.FORMAT:
        problem = (
            f"the package has format {found['format']}, newer than {contents.FORMAT}, the newest that is known here"
        )
        raise PackageError(problem, where=where, fix="Update robot-runner.")
    return found


def _way_to_a_package(package: OpenPackage) -> str:
    """Return what to do where there is no package: name the one that lies deeper in it, if there is one."""
    sums = f"/{contents.SUMS}"
    is_folder = package.where.is_dir()
    inside = [
        name.removesuffix(sums)
        for name in package.sizes
        if name.endswith(sums) or (name.endswith(".zip") and (not is_folder or is_package(package.where / name)))
    ]
    if not inside or (package.faults and not is_folder):  # such a zip file is not to be unpacked
        return "Name a package; `robot-runner pack` makes one of an experiment's folder."
    nearest = min(inside, key=lambda name: (name.count("/"), name))
    if is_folder:
        return f"Name what lies in it: {package.where / nearest}"
    return f"Unpack it, and name what lies in it: {nearest}"


def read_text_of(package: OpenPackage, name: str) -> str:
    """Return the text of a file of a package.

    Raises:
        PackageError: the package has no such file, or the file is too large.
    """
    if name not in package.sizes:
        fix = "Pack it again with this version, or get the package again."
        raise PackageError("the package has no such file", where=f"{package.where}, {name}", fix=fix)
    return _text(package, name)


def _text(package: OpenPackage, name: str, limit: int = _LARGEST_TEXT) -> str:
    if package.sizes[name] > limit:
        problem = f"the file has {package.sizes[name]:,} bytes, more than any such file"
        raise PackageError(problem, where=f"{package.where}, {name}", fix=_ALTERED)
    return b"".join(package.blocks(name)).decode("utf-8", "replace")


def _sums(package: OpenPackage) -> tuple[dict[str, str], list[Finding]]:
    if contents.SUMS not in package.sizes:
        return {}, [Finding.error(f"{package.where}, {contents.SUMS}", "the file is missing", _ALTERED)]
    sums: dict[str, str] = {}
    findings: list[Finding] = []
    for number, line in enumerate(StringIO(_text(package, contents.SUMS)), start=1):
        found = _SUM.fullmatch(line.rstrip("\r\n"))
        if len(findings) >= _MOST_BAD_LINES:
            break
        if found is None:
            where = f"{package.where}, {contents.SUMS}:{number}"
            findings.append(Finding.error(where, "the line is not a checksum", _ALTERED))
        else:
            sums[found[2]] = found[1]
    return sums, findings


def _differing_names(package: OpenPackage, sums: Mapping[str, str]) -> Iterator[Finding]:
    missing, added = set(sums) - set(package.sizes), set(package.sizes) - set(sums) - {contents.SUMS}
    composed = {normalize("NFC", name): name for name in missing}
    otherwise = {name: there for name in added if (there := composed.get(_as_packed(name)))}
    added -= set(otherwise)
    for name in sorted(otherwise.values()):
        problem = "the name is written otherwise than when it was packed: another tool has copied or unpacked the file"
        fix = "Name the zip file as it was published, or unpack that by `unzip` on this machine."
        yield Finding.error(f"{package.where}, {name}", problem, fix)
    for name in sorted(missing - set(otherwise.values())):
        yield Finding.error(f"{package.where}, {name}", "the file is missing", _ALTERED)
    ours = {name.partition("/")[0] for name in sums}
    tops = Counter(top for top, slash, _ in (name.partition("/") for name in added) if slash and top not in ours)
    for top, count in sorted(tops.items()):
        problem = f"the folder, of {counted(count, 'file')}, is not part of the package"
        yield Finding.error(f"{package.where}, {top}", problem, "Remove it, or get the package again.")
    for name in sorted(added):
        if name.partition("/")[0] not in tops:
            problem = "the file is not part of the package"
            yield Finding.error(f"{package.where}, {name}", problem, "Remove it, or get the package again.")


def _as_packed(name: str) -> str:
    """Return a name in composed characters, as nearly all are: macOS may write an umlaut as two.

    A tool that does not mark a name in a zip file as UTF-8 has it read in the characters of MS-DOS.
    """
    with suppress(UnicodeError):
        name = name.encode("cp437").decode("utf-8")
    return normalize("NFC", name)


def _differing_contents(package: OpenPackage, sums: Mapping[str, str], progress: Progress) -> Iterator[Finding]:
    total, done = sum(package.sizes.values()), 0
    with_other_ends = []
    for name in sorted(set(sums) & set(package.sizes)):
        if package.sizes[name] > _LARGEST.get(name, package.sizes[name]):  # refused before it is read
            problem = f"the file has {package.sizes[name]:,} bytes, more than any such file"
            yield Finding.error(f"{package.where}, {name}", problem, _ALTERED)
            continue
        digest = hashlib.sha256()
        try:
            for block in package.blocks(name):
                digest.update(block)
                done += len(block)
                progress(min(done, total), total)
            if digest.hexdigest() == sums[name]:
                continue
            if sums[name] in _sums_with_other_line_ends(package.blocks(name)):
                with_other_ends.append(name)
                continue
        except PackageError as error:
            yield error.as_finding()
            continue
        yield Finding.error(f"{package.where}, {name}", "the file was altered: its SHA-256 differs", _ALTERED)
    if with_other_ends:
        problem = "nothing differs but the line ends, which git (`core.autocrlf`) and editors change"
        fix = "Get the zip file, or clone again: git clone -c core.autocrlf=false ..."
        yield Finding.error(f"{package.where}, {listed(with_other_ends)}", problem, fix)


def _sums_with_other_line_ends(blocks: Iterable[bytes]) -> tuple[str, str]:
    """Return what the SHA-256 of a file would be if all lines ended in LF, and in CR LF."""
    plain, marked, rest = hashlib.sha256(), hashlib.sha256(), b""
    for block in chain(blocks, (b"",)):
        text = rest + block
        rest = text[-1:] if block and text.endswith(b"\r") else b""  # the next block may begin with its LF
        text = text[: len(text) - len(rest)].replace(b"\r\n", b"\n")
        plain.update(text)
        marked.update(text.replace(b"\n", b"\r\n"))
    return plain.hexdigest(), marked.hexdigest()


def _mapping(package: OpenPackage, name: str, findings: list[Finding]) -> Mapping[str, Any]:
    if name not in package.sizes:
        return {}  # reported already, if the checksums list it
    try:
        found = parsed_json(_text(package, name, JSON_LIMIT))
    except (ValueError, RecursionError, PackageError) as error:
        findings.append(Finding.error(f"{package.where}, {name}", f"the file cannot be read: {error}", _ALTERED))
        return {}
    return found if isinstance(found, dict) else {}


def _malformed(package: OpenPackage, name: str, facts: Mapping[str, Any]) -> Iterator[Finding]:
    for fault in faults_of(facts, _SHAPES[name]) if facts else ():
        yield Finding.error(f"{package.where}, {name}", fault, _ALTERED)


def _registration(package: OpenPackage, manifest: Mapping[str, Any], findings: list[Finding]) -> Iterator[Finding]:
    """Yield an error if the package's registration is missing, or is not the one from the experiment's start."""
    stated = manifest.get("registration")
    if not isinstance(stated, dict):
        return
    where = f"{package.where}, {contents.REGISTRATION}"
    if contents.REGISTRATION not in package.sizes:
        yield Finding.error(where, "the registration is missing", _ALTERED)
        return
    found = _mapping(package, contents.REGISTRATION, findings)
    if found and not (checksum_of(found) == found.get("sha256") == stated.get("sha256")):
        problem = "the registration is not the one that the experiment began with: its checksum differs"
        yield Finding.error(where, problem, _ALTERED)


def _unfit(package: OpenPackage, manifest: Mapping[str, Any]) -> Iterator[Finding]:
    """Yield an error for each reason why the experiment could not be executed."""
    where = str(package.where)
    if not manifest:
        yield Finding.error(f"{where}, {contents.MANIFEST}", "the file is missing, or empty", _ALTERED)
        return
    if isinstance(manifest.get("format"), int) and manifest["format"] > MANIFEST_FORMAT:
        problem = f"the experiment in it has format {manifest['format']}, newer than {MANIFEST_FORMAT}"
        yield Finding.error(f"{where}, {contents.MANIFEST}", problem, "Update robot-runner.")
    config = (manifest.get("config") or {}).get("file")
    if config and f"config/{config}" not in package.sizes:
        yield Finding.error(f"{where}, config/{config}", "the config is missing", _ALTERED)
