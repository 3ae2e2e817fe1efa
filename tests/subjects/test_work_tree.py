"""Copies of commits that lie in an experiment's folder, by real git."""

from __future__ import annotations

import errno
import fcntl
import os
import socket
import subprocess
import sys
import threading
from typing import TYPE_CHECKING
from unittest.mock import Mock

import pytest
from tests.subjects.conftest import gone

from robot_runner.core.config.treatment_makers import Workshop
from robot_runner.core.errors import ExecutionError, StorageError
from robot_runner.core.storage.git_repository import git
from robot_runner.subjects import work_tree
from robot_runner.subjects.work_tree import WorkTree, is_kept, kept_name

if TYPE_CHECKING:
    from pathlib import Path

    from tests.subjects.conftest import Repository


def said(folder: Path, *words: str) -> str:
    return git(*words, folder=folder).stdout.decode().strip()


def test_a_copy_has_the_commits_alone_and_can_be_cloned(repository: Repository, tmp_path: Path) -> None:
    repository.commit("newer")
    copy, wanted = tmp_path / "revisions/copy.git", [repository.commit_of(name) for name in ("main~1", "main")]
    assert is_kept(copy, dict.fromkeys(wanted, repository.folder))
    assert said(copy, "rev-list", "--all", "--count") == "2"
    assert all(str(tmp_path).encode() not in path.read_bytes() for path in copy.rglob("*") if path.is_file())
    subprocess.run(["git", "clone", "--quiet", copy, tmp_path / "clone"], check=True)
    assert said(tmp_path / "clone", "rev-parse", "HEAD") == wanted[-1]
    assert said(tmp_path / "clone", "show", f"{wanted[0]}:planner.sh").startswith("#!/bin/sh\necho new")


def test_a_copy_is_made_again_for_a_commit_that_it_lacks(repository: Repository, tmp_path: Path) -> None:
    copy, old, new = tmp_path / "copy.git", repository.commit_of("v1.0"), repository.commit_of("main")
    assert is_kept(copy, {old: repository.folder})
    before = (copy / "HEAD").stat().st_ino
    assert is_kept(copy, {old: tmp_path / "gone"})  # nothing has to be had for what is there
    assert (copy / "HEAD").stat().st_ino == before
    assert is_kept(copy, dict.fromkeys((old, new), repository.folder))
    assert said(copy, "rev-list", "--all", "--count") == "2"


def test_what_is_too_large_or_lies_in_other_repositories_or_cannot_be_had_is_not_kept(
    repository: Repository, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = repository.commit_of("main")
    repository.git("update-index", "--add", "--cacheinfo", f"160000,{first},planner_library")
    repository.git("commit", "--quiet", "-m", "with a submodule")
    clones = {"submodule": {repository.commit_of("main"): repository.folder}, "gone": {first: tmp_path / "gone"}}
    assert not any(is_kept(tmp_path / name, each) for name, each in clones.items())
    monkeypatch.setattr(work_tree, "_LARGEST", 10)
    assert not is_kept(tmp_path / "large", {first: repository.folder})
    assert not [path for path in tmp_path.iterdir() if path.name.lstrip(".").startswith(("submodule", "gone", "large"))]


def test_looking_into_a_copy_that_somebody_has_prepared_executes_nothing(
    repository: Repository, tmp_path: Path
) -> None:
    copy, lacking = tmp_path / "copy.git", "a" * 40
    assert is_kept(copy, {repository.commit_of("main"): repository.folder})
    (copy / "config").write_text(
        "[core]\n\trepositoryformatversion = 1\n\tbare = true\n[extensions]\n\tpartialClone = origin\n"
        f'[remote "origin"]\n\turl = {repository.folder}\n\tpromisor = true\n'
        f"\tuploadpack = touch {tmp_path}/executed; git-upload-pack\n"
    )
    assert not is_kept(copy, {lacking: tmp_path / "gone"})
    assert not (tmp_path / "executed").exists()


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give files to another user")
def test_a_copy_in_another_users_folder_is_built_from_and_its_configuration_is_not(
    repository: Repository, tmp_path: Path
) -> None:
    copy, wanted = tmp_path / "copy.git", repository.commit_of("main")
    assert is_kept(copy, {wanted: repository.folder})
    (copy / "config").write_text("[core]\n\tbare = maybe\n")  # git refuses such a one
    (copy / "objects/info").mkdir(exist_ok=True)
    (copy / "objects/info/alternates").write_text("/nowhere\n")
    for path in (copy, *copy.rglob("*")):
        os.chown(path, 65534, 65534)
    tree = WorkTree(str(tmp_path / "gone"), wanted, "", copy)
    tree.made("main", tmp_path / "build.log", Workshop(tmp_path, lambda: False, print))
    assert (tree.folder / "planner.sh").read_text().startswith("#!/bin/sh\necho new")
    assert said(tree.folder, "remote", "get-url", "origin") == str(tmp_path / "gone")
    assert {each.name for each in tree.folder.parent.iterdir()} == {"tree", "built.json"}


def test_each_repository_has_a_copy_of_its_own() -> None:
    places = [
        "/home/ada/planner",
        "/home/ada/lab/planner",
        "https://example.org/planner.git",
        "/home/ada/gr\udcf6\udcdfe",
    ]
    assert len({kept_name(place) for place in places}) == 4


#: Makes the work tree of a commit of a repository.
MAKING = """
import sys
from pathlib import Path
from robot_runner.core.config.treatment_makers import Workshop
from robot_runner.subjects.work_tree import WorkTree
WorkTree(sys.argv[1], "a" * 40, "").made("main", Path("log"), Workshop(Path(), lambda: False, print))
"""


def test_that_git_is_missing_is_said_with_the_way_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tree = WorkTree(str(tmp_path / "planner"), "a" * 40, "")
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(ExecutionError) as refused:
        tree.made("v1.0", tmp_path / "log", Workshop(tmp_path, lambda: False, print))
    assert refused.value.problem == "git is not installed"
    assert refused.value.fix.startswith("Install git")


@pytest.mark.long
@pytest.mark.skipif(sys.platform != "linux", reason="other systems do not tell of a parent's death")
def test_a_repository_that_is_being_cloned_is_left_alone_once_the_execution_is_killed(token: str) -> None:
    with socket.create_server(("127.0.0.1", 0)) as silent:  # as a slow network
        place = f"git://127.0.0.1:{silent.getsockname()[1]}/{token}"
        process = subprocess.Popen([sys.executable, "-c", MAKING, place])
        connection, _ = silent.accept()
        with connection:
            process.kill()
            process.wait(60)
            assert gone(token)  # it would write where the next execution makes its own


def test_a_work_tree_is_made_anew_once_what_an_earlier_execution_has_left_of_its_build_has_ended(
    repository: Repository, tmp_path: Path
) -> None:
    tree = WorkTree(str(repository.folder), repository.commit_of("main"), "ls -a >seen.txt")
    workshop = Workshop(tmp_path, lambda: False, print)
    tree.made("main", tmp_path / "log", workshop)
    (tree.folder.parent / "built.json").unlink()
    (tree.folder / "left").touch()
    (events,) = tree.folder.parent.rglob("events.jsonl")
    with events.open("a") as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        timer = threading.Timer(0.3, lambda: (tree.folder / "late").touch() or held.close())
        timer.start()
        tree.made("main", tmp_path / "log", workshop)
    timer.join()
    assert {"left", "late"}.isdisjoint((tree.folder / "seen.txt").read_text().split())


@pytest.mark.parametrize("is_log", [False, True])
def test_what_the_disk_does_not_take_of_a_work_tree_is_named(
    repository: Repository, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, is_log: bool
) -> None:
    tree, log = WorkTree(str(repository.folder), repository.commit_of("main"), "true"), tmp_path / "log"
    refusal = OSError(errno.ENOSPC, "No space left on device")
    if is_log:
        monkeypatch.setattr(work_tree.shutil, "copyfileobj", Mock(side_effect=refusal))
    else:
        monkeypatch.setattr(WorkTree, "_built_before", Mock(side_effect=refusal))
    named = log if is_log else tree.folder
    with pytest.raises(StorageError, match=f"{named}: the file cannot be written: No space left") as caught:
        tree.made("main", log, Workshop(tmp_path, lambda: False, print))
    assert caught.value.fix == "Make room on the disk, then try again."


def test_the_log_of_a_build_replaces_no_file_to_which_a_link_in_the_experiments_folder_leads(
    repository: Repository, tmp_path: Path
) -> None:
    own, logs = tmp_path / "own.txt", tmp_path / "trial" / "revisions"
    own.write_text("mine")
    logs.mkdir(parents=True)
    (logs / "v1.0.log").symlink_to(own)
    tree = WorkTree(str(repository.folder), repository.commit_of("main"), "true")
    with pytest.raises(StorageError, match="this is a symbolic link"):
        tree.made("main", logs / "v1.0.log", Workshop(logs, lambda: False, print))
    assert own.read_text() == "mine"


POINTER = "version https://git-lfs.github.com/spec/v1\noid sha256:4d7a214614ab2935c943f9e0ff69d22e\nsize 12345\n"


def with_a_file_in_lfs(repository: Repository) -> str:
    """Commit a pointer, as `git lfs` leaves it in each commit."""
    (repository.folder / ".gitattributes").write_text("*.bin filter=lfs diff=lfs merge=lfs -text\n")
    (repository.folder / "weights.bin").write_text(POINTER)
    repository.git("add", "--all")
    repository.commit("in Git LFS")
    return repository.commit_of("main")


def test_a_revision_whose_files_in_git_lfs_were_not_fetched_is_refused(repository: Repository, tmp_path: Path) -> None:
    tree = WorkTree(str(repository.folder), with_a_file_in_lfs(repository), "")
    with pytest.raises(ExecutionError, match="is in Git LFS, and only its pointer was fetched") as caught:
        tree.made("main", tmp_path / "log", Workshop(tmp_path, lambda: False, print))
    assert caught.value.problem.startswith("'weights.bin' ")
    assert caught.value.fix == "Install git-lfs, and execute: git lfs install."


def test_a_revision_with_files_in_git_lfs_is_made_where_that_is_installed_and_not_kept(
    repository: Repository, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("GIT_CONFIG_COUNT", "2")
    for number, (name, value) in enumerate({"smudge": "echo the weights", "clean": f"printf '{POINTER}'"}.items()):
        monkeypatch.setenv(f"GIT_CONFIG_KEY_{number}", f"filter.lfs.{name}")
        monkeypatch.setenv(f"GIT_CONFIG_VALUE_{number}", value)
    commit = with_a_file_in_lfs(repository)
    tree = WorkTree(str(repository.folder), commit, "")
    tree.made("main", tmp_path / "log", Workshop(tmp_path, lambda: False, print))
    assert (tree.folder / "weights.bin").read_text() == "the weights\n"
    assert not is_kept(tmp_path / "copy.git", {commit: tree.folder})  # it would have the pointers alone


@pytest.fixture
def library(tmp_path: Path) -> Path:
    """Return a bare repository for a submodule, beside which others can lie."""
    subprocess.run(["git", "init", "--quiet", "--bare", tmp_path / "upstream/library.git"], check=True)
    return tmp_path / "upstream/library.git"


def with_a_submodule(repository: Repository, library: Path, url: str) -> str:
    repository.git("push", "--quiet", str(library), "main")
    (repository.folder / ".gitmodules").write_text(f'[submodule "library"]\n\tpath = library\n\turl = {url}\n')
    repository.git("add", ".gitmodules")
    repository.git("update-index", "--add", "--cacheinfo", f"160000,{repository.commit_of('main')},library")
    repository.commit("with a submodule")
    return repository.commit_of("main")


def test_a_submodule_beside_the_upstream_of_a_folder_is_found(
    repository: Repository, library: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in (("COUNT", "1"), ("KEY_0", "protocol.file.allow"), ("VALUE_0", "always")):
        monkeypatch.setenv(f"GIT_CONFIG_{name}", value)
    repository.git("remote", "add", "origin", (library.parent / "planner.git").as_uri())
    tree = WorkTree(str(repository.folder), with_a_submodule(repository, library, "../library.git"), "")
    tree.made("main", tmp_path / "log", Workshop(tmp_path, lambda: False, print))
    assert (tree.folder / "library/planner.sh").is_file()


def test_a_submodule_that_cannot_be_fetched_is_refused_with_the_reason_of_git(
    repository: Repository, library: Path, tmp_path: Path
) -> None:
    tree = WorkTree(str(repository.folder), with_a_submodule(repository, library, "file:///nowhere/library.git"), "")
    with pytest.raises(ExecutionError, match="git submodule failed: fatal: transport 'file' not allowed"):
        tree.made("main", tmp_path / "log", Workshop(tmp_path, lambda: False, print))
