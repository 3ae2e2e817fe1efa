"""What must not get into the repository, and what its files say of each other."""

from __future__ import annotations

import os
import re
import subprocess
import tomllib
from pathlib import Path

import pytest
import yaml
from packaging.version import Version

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
# Spelt so that this file does not hold what it looks for. Ada is nobody: she is who packing must not name.
MACHINE_PATH = re.compile(r"(?<![A-Za-z0-9_.$~-])/(?:work|farm|root|home/(?!ada/)[a-z]\w*)/")


FOLDERS = ("src", "tests", "docs", "examples", "benchmarks", "robot", "scripts", ".ci")


def _tracked() -> list[Path]:
    try:
        listing = ["git", "ls-files", "-z", "--cached"]
        names = subprocess.run(listing, cwd=ROOT, capture_output=True, timeout=60, check=True).stdout.decode()
    except (OSError, subprocess.CalledProcessError):  # an unpacked archive, or a machine without git
        names = ""
    tracked = [ROOT / name for name in names.split("\0") if name]
    return [path for path in tracked or _own_files() if path.is_file()]


def _own_files() -> list[Path]:
    inside = [path for folder in FOLDERS for path in (ROOT / folder).rglob("*") if "__pycache__" not in path.parts]
    return [*ROOT.glob("*.*"), *inside]


def _lines_that_match(pattern: re.Pattern[str], files: list[Path]) -> list[str]:
    found = []
    for path in files:
        text = path.read_text(encoding="utf-8", errors="replace")
        lines = enumerate(text.splitlines(), start=1)
        found += [
            f"{path.relative_to(ROOT)}:{number}: {line.strip()}" for number, line in lines if pattern.search(line)
        ]
    return found


def test_no_file_names_a_path_of_one_machine() -> None:
    assert _lines_that_match(MACHINE_PATH, _tracked()) == []


@pytest.mark.parametrize("line", ["cd /ro" + "ot/x", 'open("/wo' + 'rk/x")', "/ho" + "me/ann/x"])
def test_a_path_of_one_machine_is_noticed(line: str) -> None:
    assert MACHINE_PATH.search(line)


def test_the_changelog_tells_of_this_version() -> None:
    changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    released = re.findall(r"^## \[(\d[^\]]*)\] - \d{4}-\d{2}-\d{2}$", changelog, re.MULTILINE)
    if Version(PROJECT["version"]).is_devrelease:
        assert re.search("^## .*", changelog, re.MULTILINE)[0] == "## [Unreleased]"
        assert Version(released[0]) < Version(PROJECT["version"])
    else:
        assert released[0] == PROJECT["version"]


def test_the_citation_names_this_version_and_the_paper() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert citation["cff-version"] == "1.2.0"
    assert {"message", "title", "authors"} <= citation.keys()
    assert citation["version"] == PROJECT["version"]
    assert citation["license"] == PROJECT["license"]
    paper = citation["preferred-citation"]
    assert [author["family-names"] for author in paper["authors"]] == ["Swanborn", "Malavolta"]
    assert paper["doi"] in PROJECT["urls"]["Paper"]


def test_a_person_and_ci_execute_the_same_command() -> None:
    commands = [line for line in (ROOT / ".ci" / "run").read_text().splitlines() if line and line[0] != "#"]
    assert commands[-1] == "make test TESTS=all"
    assert (ROOT / ".ci" / "run").stat().st_mode & 0o111


def test_a_choice_of_tests_that_is_not_known_is_refused() -> None:
    command = ["sh", str(ROOT / "scripts" / "checks.sh"), "all"]
    refused = subprocess.run(command, env={**os.environ, "TESTS": "long"}, capture_output=True, text=True, check=False)
    assert (refused.returncode, refused.stdout) == (2, "")
    assert "TESTS=long is not known" in refused.stderr
    assert "TESTS=all" in refused.stderr
