from __future__ import annotations

import time
import uuid
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from tests.core.links.ssh_server import SshServer

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

__all__ = ["alive", "gone"]


def alive(token: str) -> list[int]:
    """Return the processes on whose command line a word stands."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            if (
                token.encode() in (folder / "cmdline").read_bytes()
                and "\nState:\tZ" not in (folder / "status").read_text()
            ):
                found.append(int(folder.name))
        except OSError:
            continue
    return found


def gone(token: str, *, within: float = 20.0) -> bool:
    """Whether no such process is left, or none after so many seconds."""
    deadline = time.monotonic() + within
    while alive(token):
        if time.monotonic() > deadline:
            return False
        time.sleep(0.05)
    return True


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
