"""The installed Python distributions: what each holds, where it came from, and what it needs."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from dataclasses import dataclass
from functools import cache
from importlib import metadata
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

__all__ = ["InstalledDistribution", "canonical", "closure", "installed_distributions", "record_hash"]

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
