"""Find the hashes of the files of recorded versions: in Robot Runner's lock if available, else through pip.

The lock is in the source folder from which Robot Runner was installed. It has the files of every platform, and needs
no network. For other packages, pip knows the index, the credentials, and which file fits; uv does not read pip's
settings. Only hashes and names of files are read from pip's report; their addresses are neither kept nor shown.
Nothing is built: the hashes of a package without a wheel stay unknown.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import unquote, urlsplit

from robot_runner.core.errors import Finding
from robot_runner.core.words import listed
from robot_runner.replication.distributions import canonical, installed_distributions
from robot_runner.replication.environment import PLATFORMS, PackageRecord, RecordedEnvironment

_DEADLINE_S = 300.0
#: The timeout of one connection. There are no retries: pip's own take minutes without a network.
_CONNECTION_S = 15
#: After so many misses without a hit, there is no index.
_MOST_MISSES = 3

#: A pinned package of a lock with its hashes on the lines below, in the form of uv and pip-tools.
_LOCKED = re.compile(r"^([\w.-]+)==([^\s;\\]+)[^\n]*\n((?: +--hash=sha256:[0-9a-f]{64}[ \\]*\n)+)", re.MULTILINE)
_HASH = re.compile(r"sha256:([0-9a-f]{64})")

_NO_WHEEL = "pip finds no wheel of that version"
_NO_INDEX = "no package index answers, or it has none of them"
_NO_PIP = "pip is not installed beside Robot Runner"
_NO_SHA256 = "the index does not give the SHA-256 of its file"
_OWN_FOLDER = "pip takes it from a folder of this machine, which others do not have"
#: Why the index is not asked for packages from other sources.
_NOT_ASKED = {
    "local": "the package was installed from a folder, and its wheel is not in the package",
    "url": "the package was installed from a URL, and the installer did not keep the hash",
    "version control": "the package was installed from version control, where pip checks no hash",
}


class IndexAnswer(NamedTuple):
    """By canonical name of a package: the sorted SHA-256 of its fitting files, or why there are none."""

    hashes: Mapping[str, tuple[str, ...]]
    lacking: Mapping[str, str]


def ask_index(pins: Sequence[str], python: str, *, deadline_s: float = _DEADLINE_S) -> IndexAnswer:
    """Return the hashes of the files of exactly these versions, for this platform and for other usual ones.

    Errors of pip or the network are not raised: the hashes are lacking then.

    Args:
        pins: requirements, such as `rich==13.7.1`.
        python: the version of Python for which the files are.
        deadline_s: the deadline of all dry runs together, s.
    """
    wanted = {canonical(pin.partition("==")[0]): pin for pin in sorted(pins)}
    if find_spec("pip") is None:
        return IndexAnswer({}, dict.fromkeys(wanted, _NO_PIP))
    with tempfile.TemporaryDirectory(prefix="robot-runner-index-") as folder:
        pip = _Pip(Path(folder), python, deadline_s)
        files = pip.files(wanted.values())
        lacking = {name: pip.gave_up or _NO_WHEEL for name in wanted if name not in files}
        if own := [wanted[name] for name, file in files.items() if file.fault == _OWN_FOLDER]:
            pip.hides_folders = True
            files |= pip.files(own)
        lacking |= {name: file.fault for name, file in files.items() if file.fault}
        hashes = {name: {file.sha256} for name, file in files.items() if not file.fault}
        compiled = [wanted[name] for name in hashes if not files[name].is_any]
        for platforms in PLATFORMS.values():
            for name, file in pip.files(compiled, platforms).items():
                if name in hashes and not file.fault:
                    hashes[name].add(file.sha256)
    return IndexAnswer({name: tuple(sorted(each)) for name, each in sorted(hashes.items())}, lacking)


def locked_hashes(pins: Iterable[str], folder: Path | None = None) -> dict[str, tuple[str, ...]]:
    """Return the hashes of exactly these versions in the lock, by canonical name.

    Args:
        pins: requirements, such as `rich==13.7.1`.
        folder: of the lock's files; if left out, that in the source folder from which Robot Runner was installed.
    """
    wanted = {(canonical(name), release) for name, _, release in (pin.partition("==") for pin in pins)}
    found: dict[str, tuple[str, ...]] = {}
    for path in sorted((_lock_folder() if folder is None else folder).glob("*.txt")):
        try:
            text = path.read_text(encoding="utf-8")
        except (OSError, ValueError):
            continue  # the index is asked instead
        for name, release, hashes in _LOCKED.findall(text):
            if (canonical(name), release) in wanted:
                found[canonical(name)] = tuple(sorted(_HASH.findall(hashes)))
    return found


def _lock_folder() -> Path:
    ours = installed_distributions().get("robot-runner")
    source = urlsplit(str(ours.direct_url.get("url", ""))) if ours else urlsplit("")
    return Path(unquote(source.path), "requirements") if source.scheme == "file" else Path(os.devnull)


def with_known_hashes(
    environment: RecordedEnvironment, asking: Callable[[int], None] | None = None
) -> tuple[RecordedEnvironment, Mapping[str, str]]:
    """Return the environment with the hashes of the lock and the index, and by name why others are lacking.

    Args:
        environment: the recorded one.
        asking: called before the index is asked, with the number of packages; None uses the lock alone.
    """
    pins = [each.requirement for each in environment.without_hash({}) if each.source not in _NOT_ASKED]
    locked = locked_hashes(pins)
    unknown = [pin for pin in pins if canonical(pin.partition("==")[0]) not in locked]
    if asking is None or not unknown:
        return replace(environment, index_hashes=locked), {}
    asking(len(unknown))
    hashes, lacking = ask_index(unknown, environment.python)
    return replace(environment, index_hashes={**locked, **hashes}), lacking


def findings_of_hashes(unknown: Iterable[PackageRecord], lacking: Mapping[str, str]) -> Iterator[Finding]:
    """Yield one finding for each reason why hashes are unknown.

    Args:
        unknown: the packages without a known hash.
        lacking: the reasons for the packages that the index was asked for.
    """
    names: dict[str, list[str]] = {}
    for each in unknown:
        why = lacking.get(canonical(each.name)) or _NOT_ASKED[str(each.source)]
        names.setdefault(why, []).append(each.name)
    for why, those in sorted(names.items()):
        fix = "Pack again where pip can get it as a wheel; until then no hash is demanded when it is replicated."
        count = f"{len(those)} of the packages needed: " if len(those) > 1 else ""
        yield Finding.warning("environment", f"no hash of {count}{listed(those)}: {why}", fix)


class _File(NamedTuple):
    """A file that pip would install.

    Attributes:
        is_any: whether it fits every platform.
        fault: why its hash is useless to others; empty if it is useful.
    """

    sha256: str
    is_any: bool
    fault: str

    @classmethod
    def of_download(cls, download: Mapping[str, Any]) -> _File:
        """Return the file for an entry in pip's report (PEP 610)."""
        url = urlsplit(str(download.get("url", "")))
        sha256 = str(download.get("archive_info", {}).get("hashes", {}).get("sha256", ""))
        fault = _OWN_FOLDER if url.scheme == "file" else "" if sha256 else _NO_SHA256
        return cls(sha256, url.path.endswith("-any.whl"), fault)


class _Pip:
    """Dry runs of pip, one after another, with one deadline for all.

    Attributes:
        gave_up: why the last query was not completed; empty if it was.
        hides_folders: whether to override pip's settings besides the index: `find-links` and extra indexes.
    """

    def __init__(self, folder: Path, python: str, deadline_s: float) -> None:
        self._folder = folder
        self._python = ["--python-version", python] if re.fullmatch(r"\d+(\.\d+){1,2}", python) else []
        self._deadline_s, self._ends_at = deadline_s, time.monotonic() + deadline_s
        self.gave_up = ""
        self.hides_folders = False

    def files(self, pins: Iterable[str], platforms: Iterable[str] = ()) -> dict[str, _File]:
        """Return the files of the packages that pip finds, by their canonical names.

        Pip answers for all packages or for none. If it fails, it is asked again without the package that it names or,
        if it names none, for each half.
        """
        self.gave_up = ""
        found: dict[str, _File] = {}
        pending, misses = [list(pins)], 0
        while pending and not self.gave_up:
            if not (group := pending.pop()):
                continue
            report, complaint = self._dry_run(group, platforms)
            culprits = set(group) & set(re.split(r"[\s,;:]+", complaint))
            if report is not None:
                found |= report
            elif len(group) == 1 or len(culprits) == 1:
                pending.append([pin for pin in group if culprits and pin not in culprits])
                misses += 1
            else:
                half = len(group) // 2
                pending += [group[half:], group[:half]]
            if misses == _MOST_MISSES and not found:
                self.gave_up = self.gave_up or _NO_INDEX
        return found

    def _dry_run(self, pins: list[str], platforms: Iterable[str]) -> tuple[dict[str, _File] | None, str]:
        """Return the files that pip would install, or None and pip's error message if it cannot get all of them."""
        wanted, report = self._folder / "requirements.txt", self._folder / "report.json"
        wanted.write_text("".join(f"{pin}\n" for pin in pins), encoding="utf-8")
        report.unlink(missing_ok=True)
        try:
            finished = subprocess.run(  # noqa: S603 - words of our own, and pinned names that a manifest recorded
                [*self._words(platforms), "--report", str(report), "-r", str(wanted)],
                stdin=subprocess.DEVNULL,
                capture_output=True,
                encoding="utf-8",
                errors="replace",
                env=self._variables(),
                timeout=max(0.0, self._ends_at - time.monotonic()),
                check=False,
            )
        except subprocess.TimeoutExpired:
            self.gave_up = f"there was no answer within {self._deadline_s:.0f} s"
            return None, ""
        if finished.returncode or not report.exists():
            return None, finished.stderr
        entries = json.loads(report.read_text(encoding="utf-8")).get("install", ())
        return {canonical(each["metadata"]["name"]): _File.of_download(each["download_info"]) for each in entries}, ""

    def _words(self, platforms: Iterable[str]) -> list[str]:
        pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-input", "--disable-pip-version-check"]
        quick = ["--retries", "0", "--timeout", str(_CONNECTION_S)]
        # Wheels only: to get the metadata of a source package, pip builds it, which executes its code.
        only = ["--dry-run", "--ignore-installed", "--no-deps", "--only-binary", ":all:"]
        target = ["--target", str(self._folder / "nothing")]  # demanded with --platform; not written
        return [*pip, *quick, *only, *target, *self._python, *(f"--platform={each}" for each in platforms)]

    def _variables(self) -> dict[str, str]:
        if not self.hides_folders:
            return dict(os.environ)
        # Pip ignores an empty variable and uses its settings; another location overrides them.
        nowhere = self._folder / "nowhere"
        nowhere.mkdir(exist_ok=True)
        return {**os.environ, "PIP_FIND_LINKS": nowhere.as_uri(), "PIP_EXTRA_INDEX_URL": nowhere.as_uri()}
