"""The locks in requirements/ hold what pyproject.toml asks for, with hashes, and say nothing of where it comes from."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from packaging.markers import default_environment
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

if TYPE_CHECKING:
    from collections.abc import Iterator

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
PURPOSES = {"demo": "sim,analysis,replication", "test": "dev"}  # the extras of each
PYTHONS = ("3.11", "3.12", "3.13", "3.14")
HASH = re.compile(r"--hash=sha256:[0-9a-f]{64}")

each_purpose = pytest.mark.parametrize("purpose", PURPOSES)
each_python = pytest.mark.parametrize("python", PYTHONS)


def _text(purpose: str) -> str:
    return (ROOT / "requirements" / f"{purpose}.txt").read_text(encoding="utf-8")


def _entries(purpose: str) -> list[str]:
    """The entries of a lock, each on one line."""
    lines = [line for line in _text(purpose).splitlines() if not line.lstrip().startswith("#")]
    return [entry for entry in "\n".join(lines).replace("\\\n", " ").splitlines() if entry.strip()]


def _holds(requirement: Requirement, python: str, extra: str = "") -> bool:
    environment = {**default_environment(), "python_version": python, "python_full_version": f"{python}.9"}
    return requirement.marker is None or requirement.marker.evaluate({**environment, "extra": extra})


def _locked(purpose: str, python: str) -> dict[str, str]:
    """The version of each package that is installed for one Python on this system."""
    requirements = [Requirement(entry.split("--hash")[0]) for entry in _entries(purpose)]
    return {each.name: str(each.specifier).removeprefix("==") for each in requirements if _holds(each, python)}


def _asked(words: list[str], python: str) -> Iterator[Requirement]:
    """What the project asks for; its own extras are followed."""
    for requirement in map(Requirement, words):
        if not _holds(requirement, python):
            continue
        if requirement.name == PROJECT["project"]["name"]:
            for extra in requirement.extras:
                yield from _asked(PROJECT["project"]["optional-dependencies"][extra], python)
        else:
            yield requirement


@each_purpose
def test_no_lock_names_where_packages_come_from(purpose: str) -> None:
    assert "://" not in _text(purpose)
    options = {word.partition("=")[0] for entry in _entries(purpose) for word in entry.split() if word[0] == "-"}
    assert options == {"--hash"}


@each_purpose
def test_each_requirement_has_one_version_and_hashes(purpose: str) -> None:
    entries = _entries(purpose)
    assert entries
    assert [entry for entry in entries if not re.match(r"[a-z0-9-]+==[0-9][^ ]* ", entry)] == []
    assert [entry for entry in entries if not HASH.search(entry) or HASH.sub("", entry).count("--hash")] == []


@each_python
def test_the_tests_need_what_the_demo_needs_in_the_same_versions(python: str) -> None:
    assert _locked("demo", python).items() <= _locked("test", python).items()


@each_purpose
@each_python
def test_the_lock_holds_what_the_project_asks_for(purpose: str, python: str) -> None:
    extra = f"{PROJECT['project']['name']}[{PURPOSES[purpose]}]"
    words = [extra, *PROJECT["project"]["dependencies"], *PROJECT["dependency-groups"]["build"]]
    locked = _locked(purpose, python)
    lacking = [
        str(each)
        for each in _asked(words, python)
        if not each.specifier.contains(locked.get(canonicalize_name(each.name), "0"))
    ]
    assert lacking == [], "execute `make lock`"


def test_what_builds_the_project_is_locked_too() -> None:
    assert set(PROJECT["build-system"]["requires"]) <= set(PROJECT["dependency-groups"]["build"])
