from __future__ import annotations

import os
import subprocess
from typing import TYPE_CHECKING

import pytest

from robot_runner.core.storage.git_repository import git, refused_repository, uncommitted_changes

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture
def repository(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    folder = tmp_path / "repository"
    (folder / "sub").mkdir(parents=True)
    (folder / "sub" / "file").write_text("".join(f"{line}\n" for line in range(20)))
    who = ("-c", "user.name=a", "-c", "user.email=a@b.example")
    for words in (("init", "--quiet"), ("add", "."), (*who, "commit", "--quiet", "--message=first")):
        assert git(*words, folder=folder).returncode == 0
    return folder


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give files to another user")
def test_a_repository_of_another_user_is_told_with_what_git_advises(repository: Path) -> None:
    assert refused_repository(repository / "sub") is None
    for path in (repository, repository / ".git"):
        os.chown(path, 65534, 65534)
    told = refused_repository(repository / "sub")
    assert told is not None
    assert told.where == str(repository)
    assert told.problem.startswith("the commit of the config cannot be recorded: fatal: detected dubious ownership")
    assert told.fix == f"Execute: git config --global --add safe.directory {repository}"


def test_a_repository_that_git_cannot_read_is_told(
    repository: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / ".git").write_text("gitdir: /not/mounted/.git/worktrees/study\n")  # a work tree in a container
    told = refused_repository(tmp_path)
    assert told is not None
    assert "not a git repository" in told.problem
    assert told.fix == f"Mount or clone all of it, or remove {tmp_path}/.git."
    (tmp_path / ".git").write_text("no gitdir\n")
    told = refused_repository(tmp_path)
    assert told is not None
    assert told.fix == f"Mount or clone all of it, or remove {tmp_path}/.git."
    monkeypatch.setenv("PATH", "/nowhere")
    told = refused_repository(repository)
    assert told is not None
    assert (told.problem, told.fix) == (
        "the commit of the config cannot be recorded: git is not installed",
        "Install git.",
    )
    (tmp_path / ".git").unlink()
    assert refused_repository(tmp_path) is None


@pytest.mark.parametrize(
    ("told_by_git", "is_readable", "fix"),
    [
        ("fatal: unable to access '.git/config': Permission denied", True, "Make all of the repository readable."),
        # So git says, too, of one that it may not look into (git 2.39.5).
        ("fatal: not a git repository: .git", False, "Make all of the repository readable."),
        ("fatal: bad config line 1 in file .git/config", True, ""),
    ],
)
def test_the_fix_of_a_repository_that_git_cannot_read_is_that_of_its_cause(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, told_by_git: str, *, is_readable: bool, fix: str
) -> None:
    """The superuser, whom nothing is refused, executes this test, too: so git and the system are scripted."""
    answer = subprocess.CompletedProcess([], 128, b"", told_by_git.encode())
    (tmp_path / ".git").mkdir()
    monkeypatch.setattr("robot_runner.core.storage.git_repository.git", lambda *_, **__: answer)
    monkeypatch.setattr("os.access", lambda *_: is_readable)
    told = refused_repository(tmp_path)
    assert told is not None
    assert (told.problem.rpartition("recorded: ")[2], told.fix) == (told_by_git, fix)


@pytest.mark.parametrize(
    "habit",
    ["diff.noprefix=true", "diff.mnemonicPrefix=true", "diff.context=0", "diff.relative=true", "color.ui=always"],
)
def test_uncommitted_changes_can_be_applied_whatever_the_user_likes_to_see(
    repository: Path, tmp_path: Path, habit: str
) -> None:
    git("config", "--global", *habit.split("="), folder=tmp_path)
    changed = repository / "sub" / "file"
    changed.write_text(changed.read_text().replace("7\n", "seven\n"))
    kept = uncommitted_changes(repository / "sub")
    assert git("clone", "--quiet", str(repository), str(tmp_path / "again"), folder=tmp_path).returncode == 0
    command = ["git", "-c", "diff.noprefix=false", "apply", "-"]
    subprocess.run(command, input=kept, cwd=tmp_path / "again", check=True, capture_output=True)
    assert (tmp_path / "again" / "sub" / "file").read_text() == changed.read_text()
