from __future__ import annotations

import subprocess
import time
import uuid
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from tests.core.links.ssh_server import SshServer
from tests.waiting import PATIENCE

from robot_runner.core.storage.outliving import process_stat, processes

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

__all__ = ["alive", "gone"]


def alive(token: str) -> list[int]:
    """Return the processes on whose command line a word stands."""
    found = []
    for pid in processes():
        with suppress(OSError):
            if token.encode() in Path(f"/proc/{pid}/cmdline").read_bytes() and process_stat(pid)[:1] not in ([], ["Z"]):
                found.append(pid)
    return found


def gone(token: str, *, within: float = PATIENCE) -> bool:
    """Whether no such process is left, or none after so many seconds."""
    deadline = time.monotonic() + within
    while alive(token):
        if time.monotonic() > deadline:
            return False
        time.sleep(0.05)
    return True


@pytest.fixture(autouse=True)
def own_cache(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    """Keep work trees and locks in a cache of the test's own."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))


@pytest.fixture
def token() -> str:
    """Return a word that stands on the command lines of this test's processes, and on no other."""
    return f"subject-{uuid.uuid4().hex}"


@pytest.fixture
def rude_tree(tmp_path: Path, token: str) -> Callable[..., list[str]]:
    """Return what writes a program that starts a tree: a child that ignores SIGTERM, and one with its own session."""

    def write(last: str = "sleep 1000", *, is_rude: bool = True) -> list[str]:
        script = tmp_path / "tree.sh"
        trap = "trap '' TERM INT\n" if is_rude else ""
        script.write_text(
            f"{trap}"
            f"sh -c \"trap '' TERM INT; while :; do sleep 0.2; done\" {token} &\n"
            f"setsid sh -c \"trap '' TERM HUP; while :; do sleep 0.2; done\" {token} &\n"
            f'echo "started with $*"\n{last}\n'
        )
        return ["sh", str(script), token]

    return write


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SshServer]:
    """Yield a real sshd on loopback."""
    started = SshServer(tmp_path_factory.mktemp("sshd"))
    yield started
    started.stop()


class Repository:
    """A git repository with two versions of a planner: the tag `v1.0`, which is old, and the branch `main`."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        folder.mkdir()
        self.git("init", "--quiet", "--initial-branch=main")
        self.commit("old")
        self.git("tag", "-a", "v1.0", "-m", "the first")
        self.commit("new")

    def commit(self, word: str) -> None:
        planner = self.folder / "planner.sh"
        planner.write_text(f"#!/bin/sh\necho {word} plans $1; exec sleep 100\n")
        planner.chmod(0o755)
        self.git("add", "planner.sh")
        self.git("commit", "--quiet", "-m", word)

    def commit_of(self, name: str) -> str:
        return self.git("rev-parse", f"{name}^{{commit}}").strip()

    def git(self, *words: str) -> str:
        identity = ["-c", "user.name=Ada", "-c", "user.email=ada@example.org"]
        done = subprocess.run(["git", *identity, *words], cwd=self.folder, check=True, capture_output=True, text=True)
        return done.stdout


@pytest.fixture
def repository(tmp_path: Path, own_cache: None) -> Repository:
    """Return a repository."""
    del own_cache
    return Repository(tmp_path / "repository")
