"""What is built for a release has the version of its tag."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
COMMIT = ("-c", "user.name=Ada", "-c", "user.email=ada@example.org", "commit", "--quiet", "--allow-empty", "-m", "x")


@pytest.fixture
def clone(tmp_path: Path) -> Path:
    """A repository without a tag, whose hatchling says version 0.1.0 and notes that it built."""
    (tmp_path / "scripts").mkdir()
    shutil.copy(ROOT / "scripts" / "dist.sh", tmp_path / "scripts")
    hatchling = tmp_path / ".venv" / "bin" / "hatchling"
    hatchling.parent.mkdir(parents=True)
    hatchling.write_text('#!/bin/sh\n[ "$1" = version ] && echo 0.1.0 || echo built\n', encoding="utf-8")
    hatchling.chmod(0o755)
    _git(tmp_path, "init", "--quiet")
    _git(tmp_path, *COMMIT)
    return tmp_path


def _git(clone: Path, *words: str) -> None:
    subprocess.run(["git", *words], cwd=clone, check=True, timeout=60)


def _dist(clone: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        ["sh", "scripts/dist.sh"],
        cwd=clone,
        env={"PATH": os.environ["PATH"], **environment},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


def test_without_a_tag_it_is_built_for_a_trial(clone):
    assert _dist(clone).stdout == "built\n"


def test_outside_a_repository_it_is_built_too(clone):
    shutil.rmtree(clone / ".git")
    assert _dist(clone, GIT_CEILING_DIRECTORIES=str(clone.parent)).stdout == "built\n"


def test_under_its_tag_it_is_built(clone):
    _git(clone, "tag", "v0.1.0")
    assert _dist(clone).stdout == "built\n"
    assert _dist(clone, TAG="v0.1.0").stdout == "built\n"


def test_under_another_tag_it_is_not_built(clone):
    _git(clone, "tag", "v0.2.0")
    for answer in (_dist(clone), _dist(clone, TAG="v0.3.0")):
        assert answer.returncode == 1
        assert "but pyproject.toml says version 0.1.0" in answer.stderr
        assert answer.stdout == ""
