"""Nobody but the owner of an experiment, or the group that shares it, can keep it from being executed."""

from __future__ import annotations

import errno
import os
import stat
import subprocess
import sys
from contextlib import contextmanager
from typing import TYPE_CHECKING

import pytest

from robot_runner.core.errors import ExecutionError, StorageError
from robot_runner.core.storage.lock import ExperimentLock, holder_of
from robot_runner.core.storage.lock_files import open_to_lock

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

#: Holds a lock until its input ends.
_HOLD = """
import fcntl, os, sys
file = os.open(sys.argv[1], getattr(os, sys.argv[2]))
fcntl.lockf(file, getattr(fcntl, sys.argv[3]) | fcntl.LOCK_NB)
print(flush=True)
sys.stdin.read()
"""


@contextmanager
def held(path: Path, opened: str, kind: str) -> Iterator[None]:
    command = [sys.executable, "-c", _HOLD, str(path), opened, kind]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == b"\n"
        yield


def rights(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


def outcome_elsewhere(path: Path) -> str:
    """Return what another process of ours says when it takes the lock."""
    script = (
        "import sys; from pathlib import Path; from robot_runner.core.storage.lock import ExperimentLock\n"
        "from robot_runner.core.errors import ExecutionError\n"
        "try:\n    with ExperimentLock(Path(sys.argv[1])): print('taken')\n"
        "except ExecutionError as error: print(error)"
    )
    return subprocess.run([sys.executable, "-c", script, str(path)], check=True, capture_output=True, text=True).stdout


def test_a_shared_lock_by_who_may_only_read_does_not_block_and_ours_holds_afterwards(tmp_path: Path) -> None:
    path = tmp_path / ".lock"
    path.touch(0o644)  # as earlier versions made it
    with held(path, "O_RDONLY", "LOCK_SH"):
        assert holder_of(path) is None
        with ExperimentLock(path):
            assert rights(path) == 0o600
            assert f"executed by process {os.getpid()}" in outcome_elsewhere(path)
        assert "taken" in outcome_elsewhere(path)
    assert sorted(each.name for each in tmp_path.iterdir()) == [".lock"]


def test_an_exclusive_lock_of_an_earlier_version_is_honoured(tmp_path: Path) -> None:
    path = tmp_path / ".lock"
    path.touch(0o644)
    with held(path, "O_RDWR", "LOCK_EX"):
        assert holder_of(path) is not None
        with pytest.raises(ExecutionError, match="the experiment is being executed"), ExperimentLock(path):
            pass
    assert holder_of(path) is None


def test_a_lock_file_that_everybody_may_write_is_not_relied_upon(tmp_path: Path) -> None:
    path = tmp_path / ".lock"
    path.touch()
    path.chmod(0o666)  # by git or tar: we never made one
    with held(path, "O_RDWR", "LOCK_EX"), ExperimentLock(path):
        assert f"executed by process {os.getpid()}" in outcome_elsewhere(path)
    assert rights(path) == 0o600


def test_a_file_system_whose_files_all_have_the_same_permissions_is_no_fault(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(errno.EPERM, "Operation not permitted")

    monkeypatch.setattr(os, "fchmod", refuse)
    tmp_path.chmod(0o777)
    path = tmp_path / ".lock"
    path.touch()
    path.chmod(0o777)  # as all files of such a file system
    with ExperimentLock(path):
        assert f"executed by process {os.getpid()}" in outcome_elsewhere(path)
    assert "taken" in outcome_elsewhere(path)


_STRANGER = """
import fcntl, os, sys, time
while True:
    try:
        file = os.open(sys.argv[1], os.O_RDONLY)
    except FileNotFoundError:
        break
    try:
        fcntl.lockf(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        time.sleep(0.002)
    except OSError:
        pass
    os.close(file)
"""
_TAKER = """
import os, sys, time
from pathlib import Path
from robot_runner.core.errors import ExecutionError
from robot_runner.core.storage.lock import ExperimentLock
path = Path(sys.argv[1])
mark, ends, times = path.with_name("inside"), time.monotonic() + 1.5, 0
while time.monotonic() < ends:
    try:
        with ExperimentLock(path):
            os.close(os.open(mark, os.O_CREAT | os.O_EXCL))
            mark.unlink()
            times += 1
    except ExecutionError:
        pass
print(times)
"""


@pytest.mark.long
def test_of_many_that_replace_a_lock_at_once_one_at_a_time_holds_it(tmp_path: Path) -> None:
    path = tmp_path / ".lock"
    path.touch(0o644)
    with subprocess.Popen([sys.executable, "-c", _STRANGER, str(path)]) as stranger:
        command = [sys.executable, "-c", _TAKER, str(path)]
        taken = 0
        several = [subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) for _ in range(3)]
        for each in several:
            out, errors = each.communicate(timeout=60)
            assert (each.returncode, errors) == (0, b"")
            taken += int(out)
        assert taken > 0
        path.unlink()
        assert stranger.wait(10) == 0


@pytest.mark.parametrize(
    ("of_folder", "umask", "of_lock"), [(0o700, 0o022, 0o600), (0o755, 0o000, 0o600), (0o2770, 0o022, 0o660)]
)
def test_the_group_that_may_write_in_the_folder_may_lock_in_it(
    tmp_path: Path, of_folder: int, umask: int, of_lock: int
) -> None:
    tmp_path.chmod(of_folder)
    before = os.umask(umask)
    try:
        os.close(open_to_lock(tmp_path / ".alive", tmp_path))
        with ExperimentLock(tmp_path / ".lock"):
            pass
    finally:
        os.umask(before)
    assert rights(tmp_path / ".alive") == rights(tmp_path / ".lock") == of_lock


@pytest.mark.parametrize("plant", [os.mkfifo, lambda path: path.symlink_to("/dev/zero"), lambda path: path.mkdir()])
def test_what_is_no_file_is_no_lock(tmp_path: Path, plant: Callable[[Path], None]) -> None:
    plant(tmp_path / ".lock")
    assert holder_of(tmp_path / ".lock") is None
    with pytest.raises(StorageError), ExperimentLock(tmp_path / ".lock"):
        pass


def test_the_target_of_a_linked_lock_is_not_truncated(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("years of work", encoding="utf-8")
    (root := tmp_path / "experiment").mkdir()
    (root / ".lock").symlink_to(tmp_path / "thesis.tex")
    with pytest.raises(StorageError, match="symbolic link"), ExperimentLock(root / ".lock"):
        pass
    assert (tmp_path / "thesis.tex").read_text(encoding="utf-8") == "years of work"
