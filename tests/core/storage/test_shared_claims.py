"""Claims against other users of a machine: who holds one is named, and another user can do no more than keep us out."""

from __future__ import annotations

import fcntl
import os
import signal
import stat
import subprocess
import sys
import uuid
from contextlib import ExitStack, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import pytest

from robot_runner.core.errors import ExecutionError
from robot_runner.core.storage import shared_claims
from robot_runner.core.storage.claim_locks import HeldClaims
from robot_runner.core.storage.shared_claims import hold_against_users

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

as_root = pytest.mark.skipif(os.geteuid() != 0, reason="only root can become a second user")
#: `nobody` on Linux: no rights but everybody's.
_OTHER = 65534


@pytest.fixture
def claim() -> str:
    return f"serial:/dev/{uuid.uuid4().hex}"


@pytest.fixture
def folder(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Yield a folder as `/run/lock` is, which other users reach: it takes the place of that."""
    if os.geteuid() != 0:
        pytest.skip("only root can make a folder of root's")
    # Not below pytest's own folder, which each session of pytest closes to other users as it begins.
    with TemporaryDirectory() as reached:
        Path(reached).chmod(0o711)
        place = Path(reached) / "everybody"
        place.mkdir()
        place.chmod(0o1777)
        monkeypatch.setattr(shared_claims, "_FOLDERS", (place,))
        monkeypatch.delenv("ROBOT_RUNNER_LOCKS")
        yield place


@contextmanager
def another_user(act: Callable[[], object]) -> Iterator[int]:
    """Have another user do something; yield the process, which stays until the block ends."""
    (begun, say), (wait, end) = os.pipe(), os.pipe()
    pid = os.fork()
    if pid == 0:
        code = 1
        try:
            os.close(end)
            os.setgroups([])
            os.setgid(_OTHER)
            os.setuid(_OTHER)
            act()
            os.write(say, b".")
            os.read(wait, 1)
            code = 0
        finally:
            os._exit(code)
    os.close(wait)
    os.close(say)
    try:
        assert os.read(begun, 1) == b"."
        yield pid
    finally:
        os.close(begun)
        os.close(end)
        os.waitpid(pid, 0)


def held(claim: str) -> list[str]:
    with ExitStack() as opened:
        return list(hold_against_users(claim, opened))


def test_the_folder_of_all_users_may_be_reached_through_a_link_as_on_macos(
    claim: str, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    link = folder.with_name("tmp")
    link.symlink_to(folder)
    monkeypatch.setattr(shared_claims, "_FOLDERS", (folder / "not there", link))
    with ExitStack() as opened:
        assert list(hold_against_users(claim, opened)) == []
        assert len(list(folder.iterdir())) == 1


@as_root
def test_what_another_user_has_claimed_is_refused_with_their_name_until_they_end(folder: Path, claim: str) -> None:
    opened = ExitStack()
    with another_user(lambda: list(hold_against_users(claim, opened))) as pid:
        (who,) = held(claim)
        assert who == f"an experiment of nobody (process {pid})"
        assert held("serial:/dev/other") == []
        with pytest.raises(ExecutionError, match=f"{claim} is in use by an experiment of nobody"):
            HeldClaims([claim], "study", folder).__enter__()
    assert held(claim) == []


@as_root
def test_one_graph_is_not_claimed_by_two_users_under_its_own_name_and_a_robots(folder: Path) -> None:
    with another_user(lambda: list(hold_against_users("robot:domain 0", ExitStack()))):
        assert held("robot:domain 0/alice")
        assert held("robot:domain 01") == []


def test_what_an_experiment_has_started_holds_its_claim_when_it_was_killed(folder: Path, claim: str) -> None:
    script = f"""
import os, time
from contextlib import ExitStack
from pathlib import Path
from robot_runner.core.storage import shared_claims
shared_claims._FOLDERS = (Path({str(folder)!r}),)
list(shared_claims.hold_against_users({claim!r}, ExitStack()))
if os.fork():
    print("held", flush=True)
time.sleep(600)
"""
    with subprocess.Popen(
        [sys.executable, "-c", script], stdout=subprocess.PIPE, text=True, start_new_session=True
    ) as first:
        assert first.stdout is not None
        assert first.stdout.readline() == "held\n"
        first.kill()
        os.waitid(os.P_PID, first.pid, os.WEXITED | os.WNOWAIT)
        (path,) = folder.iterdir()
        descriptor = os.open(path, os.O_RDONLY)
        with pytest.raises(BlockingIOError):
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        os.close(descriptor)
        os.killpg(first.pid, signal.SIGKILL)


def test_two_experiments_of_one_user_hold_it_together_and_the_last_one_removes_the_file(
    folder: Path, claim: str
) -> None:
    before = os.umask(0o077)
    try:
        first = ExitStack()
        assert list(hold_against_users(claim, first)) == []
    finally:
        os.umask(before)
    (path,) = folder.iterdir()
    assert stat.S_IMODE(path.stat().st_mode) == 0o644, "others may look whether it is held"
    assert held(claim) == []
    assert path.exists()
    first.close()
    assert not path.exists()


@as_root
@pytest.mark.parametrize("put", ["file", "link", "pipe", "folder"])
def test_who_takes_the_place_of_our_file_keeps_us_out_and_is_named(folder: Path, claim: str, put: str) -> None:
    with ExitStack() as opened:
        list(hold_against_users(claim, opened))
        (path,) = folder.iterdir()
    victim = folder.parent / "victim"
    makes = {
        "file": path.touch,
        "link": lambda: path.symlink_to(victim),
        "pipe": lambda: os.mkfifo(path),
        "folder": path.mkdir,
    }
    with another_user(makes[put]):
        (who,) = held(claim)
    assert who == f"nobody, who has put {path} in our place"
    assert not victim.exists()
    assert path.lstat().st_uid == _OTHER


def test_a_file_of_ours_that_was_linked_to_in_that_place_keeps_its_permissions(folder: Path, claim: str) -> None:
    with ExitStack() as opened:
        list(hold_against_users(claim, opened))
        (path,) = folder.iterdir()
    private = folder.parent / "private"
    private.touch(mode=0o600)
    path.hardlink_to(private)  # which some systems, such as macOS, let any user do
    assert held(claim) == [f"another user, who has put {path} in our place"]
    assert private.stat().st_mode & 0o777 == 0o600


@as_root
def test_who_locks_our_file_keeps_us_out_and_is_named(
    folder: Path, claim: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shared_claims, "_BETWEEN", 0.0)
    opened = ExitStack()
    assert list(hold_against_users(claim, opened)) == []
    (path,) = folder.iterdir()
    path.touch()

    def lock() -> None:
        fcntl.flock(os.open(path, os.O_RDONLY), fcntl.LOCK_SH)

    with another_user(lock):
        opened.close()
        assert path.exists()
        assert held(claim) == [], "a shared lock is in nobody's way"

    def lock_alone() -> None:
        fcntl.flock(os.open(path, os.O_RDONLY), fcntl.LOCK_EX)

    path.touch(mode=0o644)
    with another_user(lock_alone) as pid:
        assert held(claim) == [f"nobody (process {pid}), who keeps {path} locked"]


@as_root
def test_a_file_that_is_not_its_users_own_keeps_nobody_out(folder: Path, claim: str) -> None:
    def forge() -> None:
        with ExitStack() as opened:
            list(hold_against_users(claim, opened))
            (path,) = folder.iterdir()
            forged = folder / path.name.replace(str(_OTHER), "1000")
        forged.touch()
        fcntl.flock(os.open(forged, os.O_RDONLY), fcntl.LOCK_EX)
        os.mkfifo(folder / path.name.replace(str(_OTHER), "1001"))
        (folder / path.name.replace(str(_OTHER), "1002")).symlink_to(forged)

    with another_user(forge):
        assert held(claim) == []


def test_where_users_have_no_folder_in_common_nothing_is_done(
    folder: Path, claim: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for mode in (0o777, 0o1755):
        folder.chmod(mode)
        assert held(claim) == []
    link = folder.parent / "link"
    link.symlink_to(folder)
    monkeypatch.setattr(shared_claims, "_FOLDERS", (link, folder / "missing"))
    assert held(claim) == []
    assert list(folder.iterdir()) == []


def test_a_claim_that_is_longer_than_a_file_name_is_held(folder: Path) -> None:
    long = f"robot:rosbridge {'x' * 300}"
    with ExitStack() as opened:
        assert list(hold_against_users(long, opened)) == []
        assert len(list(folder.iterdir())) == 1


def test_the_environment_names_another_folder_or_none_and_one_that_is_unfit_is_told(
    folder: Path, claim: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    other = folder.parent / "other"
    other.mkdir()
    monkeypatch.setenv("ROBOT_RUNNER_LOCKS", str(other))
    with HeldClaims([claim], "study", folder) as holding:
        (finding,) = holding.findings
    reason = f"ROBOT_RUNNER_LOCKS is to name a folder of root with mode 1777 ({other})"
    assert finding.problem == f"other users who claim {claim} are not kept out: {reason}"
    assert not finding.is_error
    monkeypatch.setenv("ROBOT_RUNNER_LOCKS", "")
    with HeldClaims([claim], "study", folder) as holding:
        assert holding.findings == []
        assert [*folder.iterdir(), *other.iterdir()] == []


@as_root
def test_a_folder_that_the_environment_names_keeps_others_out(
    folder: Path, claim: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shared_claims, "_FOLDERS", ())
    monkeypatch.setenv("ROBOT_RUNNER_LOCKS", str(folder))
    with another_user(lambda: list(hold_against_users(claim, ExitStack()))):
        assert held(claim)
