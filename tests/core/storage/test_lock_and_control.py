from __future__ import annotations

import errno
import fcntl
import os
import resource
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from robot_runner.core.errors import ExecutionError, StorageError
from robot_runner.core.storage import lock
from robot_runner.core.storage.journal import Journal, read_journal
from robot_runner.core.storage.lock import (
    ExperimentLock,
    holder_of,
    is_requested,
    leave_request,
    send_continue,
    take_request,
)


def in_another_process(ask: object) -> str:
    """POSIX locks are a process's own: only another one is kept out by them."""
    reader, writer = os.pipe()
    pid = os.fork()
    if pid == 0:
        os.write(writer, str(ask()).encode())  # type: ignore[operator]
        os._exit(0)
    os.close(writer)
    said = os.read(reader, 4096).decode()
    os.close(reader)
    os.waitpid(pid, 0)
    return said


def hold(path: Path) -> subprocess.Popen[bytes]:
    """Have another process hold a lock until it is told something."""
    program = (
        "import sys; from pathlib import Path; from robot_runner.core.storage.lock import ExperimentLock\n"
        "with ExperimentLock(Path(sys.argv[1])): print(flush=True); sys.stdin.read()"
    )
    words = [sys.executable, "-P", "-c", program, str(path)]
    holder = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert holder.stdout is not None
    holder.stdout.readline()
    return holder


def refusal(path: Path) -> str:
    try:
        with ExperimentLock(path):
            return "taken"
    except ExecutionError as error:
        return str(error)


def test_a_lock_that_is_held_keeps_others_out_and_tells_who_holds_it(tmp_path: Path) -> None:
    path = tmp_path / ".lock"
    with ExperimentLock(path):
        said = in_another_process(lambda: refusal(path))
        assert f"process {os.getpid()}" in said
        assert in_another_process(lambda: holder_of(path).pid) == str(os.getpid())  # type: ignore[union-attr]
    assert in_another_process(lambda: refusal(path)) == "taken"
    assert holder_of(path) is None


def test_the_holder_may_ask_who_holds_a_lock_and_take_it_again_and_still_keeps_others_out(tmp_path: Path) -> None:
    """Closing any descriptor of a file lets go of the locks that a process has on it."""
    path = tmp_path / "experiment" / ".lock"
    path.parent.mkdir()
    with ExperimentLock(path):
        moved = path.parent.rename(tmp_path / "moved") / ".lock"
        (tmp_path / "link").symlink_to(moved.parent)
        for name in (moved, tmp_path / "link" / ".lock"):
            assert getattr(holder_of(name), "pid", None) == os.getpid()
            assert f"executed by process {os.getpid()}" in refusal(name)
            assert f"executed by process {os.getpid()}" in in_another_process(lambda: refusal(moved))
    assert holder_of(moved) is None
    assert refusal(moved) == "taken"


def test_a_lock_that_was_removed_is_taken_anew_unless_somebody_else_has_been_there(tmp_path: Path) -> None:
    path = tmp_path / ".lock"
    with ExperimentLock(path) as lock, Journal(tmp_path / "journal.jsonl") as journal:
        journal.append("experiment_started", flush=True)
        assert lock.look_after(journal) == []
        path.unlink()
        (finding,) = lock.look_after(journal)
        assert ".lock was removed while the experiment was executed: it is locked again" in finding.problem
        assert f"process {os.getpid()}" in in_another_process(lambda: refusal(path))
        assert lock.look_after(journal) == []
        path.unlink()
        journal._path.unlink()  # as `git clean` does
        journal.append("paused", flush=True)
        assert len(lock.look_after(journal)) == 1

        def execute() -> str:
            with ExperimentLock(path), Journal(journal._path) as other:
                other.append("experiment_started", flush=True)
            return "executed"

        path.unlink()
        assert in_another_process(execute) == "executed"
        with pytest.raises(ExecutionError, match="and another process has executed it since"):
            lock.look_after(journal)
    assert refusal(path) == "taken"


@pytest.mark.parametrize("moved", ["study", "study/journal.jsonl"])
def test_an_experiment_that_is_moved_while_it_is_executed_does_not_go_on_in_two_places(
    tmp_path: Path, moved: str
) -> None:
    folder = tmp_path / "study"
    folder.mkdir()
    with ExperimentLock(folder / ".lock") as lock, Journal(folder / "journal.jsonl") as journal:
        there = (tmp_path / moved).rename(tmp_path / "moved")
        folder.mkdir(exist_ok=True)  # as what a run keeps has it made again
        with pytest.raises(ExecutionError, match="moved or renamed") as caught:
            lock.look_after(journal)
        journal.append("paused", flush=True)  # what is told until then is kept where it is
    assert caught.value.where == str(folder)
    assert f"its journal is {there}" in caught.value.problem or not Path("/proc/self/fd").exists()
    assert '"paused"' in (there / "journal.jsonl" if there.is_dir() else there).read_text(encoding="utf-8")


def test_an_experiment_whose_folder_was_removed_and_made_anew_is_refused_and_its_journal_kept_there(
    tmp_path: Path,
) -> None:
    folder = tmp_path / "study"
    folder.mkdir()
    (tmp_path / "link").symlink_to(folder)
    for path in (folder, tmp_path / "link"):
        with ExperimentLock(path / ".lock") as lock:
            journal = Journal(path / "journal.jsonl", lock.successor)
            journal.append("experiment_started", flush=True)
            assert lock.look_after(journal) == []
            shutil.rmtree(folder)
            with pytest.raises(ExecutionError, match="folder was removed while it was executed"):
                lock.look_after(journal)
            folder.mkdir()  # as what a run keeps has it made again
            with pytest.raises(ExecutionError, match="folder was removed while it was executed"):
                lock.refuse_other_folder(journal)
            with pytest.raises(StorageError, match="its folder was made again since"):
                journal.close()
        (kept,) = folder.iterdir()
        assert [each["kind"] for each in read_journal(kept)] == ["experiment_started"]
        kept.unlink()


@pytest.mark.parametrize("number", [errno.ESTALE, errno.EACCES, errno.EIO])
def test_a_journal_whose_path_cannot_be_looked_at_was_not_moved(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    def refuse(path: Path, **_: object) -> None:
        raise OSError(number, os.strerror(number), str(path))  # as a share of a network may

    with Journal(tmp_path / "journal.jsonl") as journal:
        for look in ("stat", "lstat"):
            monkeypatch.setattr(Path, look, refuse)
        assert journal.moved_to == ""


def test_who_executes_an_experiment_whose_lock_was_removed_is_told(tmp_path: Path) -> None:
    path = tmp_path / ".lock"
    with ExperimentLock(path) as lock, Journal(tmp_path / "journal.jsonl") as journal:
        path.unlink()
        holder = hold(path)
        with pytest.raises(ExecutionError, match=f"and now the experiment is being executed by process {holder.pid}"):
            lock.look_after(journal)
        holder.communicate(b"go")
        assert lock.look_after(journal)


def test_a_lock_that_cannot_be_signed_is_refused_and_free(tmp_path: Path) -> None:
    unlimited = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, unlimited[1]))  # as on a full disk
    try:
        with pytest.raises(StorageError, match="cannot be written"), ExperimentLock(tmp_path / ".lock"):
            pass
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, unlimited)
    assert in_another_process(lambda: refusal(tmp_path / ".lock")) == "taken"


def test_a_holder_that_did_not_sign_is_another_process(tmp_path: Path) -> None:
    path = tmp_path / ".lock"
    with ExperimentLock(path):
        path.write_text("")
        with path.open("r+") as file:
            fcntl.lockf(file, fcntl.LOCK_EX)  # closing the file above has let go of it
            assert "is being executed by another process" in in_another_process(lambda: refusal(path))


def test_nobody_holds_a_lock_that_is_not_there(tmp_path: Path) -> None:
    assert holder_of(tmp_path / ".lock") is None


def test_a_lock_that_a_dead_process_signed_is_free(tmp_path: Path) -> None:
    path = tmp_path / ".lock"
    in_another_process(lambda: ExperimentLock(path).__enter__())
    assert path.read_text()
    with ExperimentLock(path):
        pass


def test_a_lock_in_a_folder_that_is_not_there_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(StorageError), ExperimentLock(tmp_path / "missing" / ".lock"):
        pass


def test_a_command_is_taken_once(tmp_path: Path) -> None:
    control = tmp_path / ".control"
    assert take_request(control) is None
    send_continue(control)
    assert take_request(control) is not None
    assert take_request(control) is None


def test_a_command_that_answers_one_question_is_left_alone_by_who_asks_another(tmp_path: Path) -> None:
    control = tmp_path / ".control"
    send_continue(control, asked=("r_3", "swap the battery"))
    assert take_request(control, ("r_3", "close the door")) is None
    assert take_request(control, ("r_3", "swap the battery")) is not None
    send_continue(control)  # of an older client
    assert take_request(control, ("r_3", "close the door")) is not None


def test_a_command_that_is_taken_back_while_it_is_read_was_not_taken(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    control = tmp_path / ".control"
    send_continue(control)
    text = control.read_bytes()

    def read(path: Path, **_: object) -> bytes:
        path.unlink()
        return text

    monkeypatch.setattr(lock, "read_bytes", read)
    assert take_request(control) is None


@pytest.mark.parametrize("nonsense", ["dance", '{"command": "dance"}'])
def test_what_no_command_of_ours_has_left_is_no_request(tmp_path: Path, nonsense: str) -> None:
    control = tmp_path / ".control"
    control.write_text(nonsense)
    assert take_request(control) is None
    assert not control.exists()


def test_a_folder_that_cannot_be_looked_at_asks_for_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    leave_request(tmp_path / "stop")

    def refuse(*_: object, **__: object) -> os.stat_result:
        raise OSError(errno.ENOTCONN, os.strerror(errno.ENOTCONN))

    with monkeypatch.context() as patched:
        patched.setattr(os, "stat", refuse)
        assert not is_requested(tmp_path / "stop")
    assert is_requested(tmp_path / "stop")


def test_where_the_file_system_has_no_locks_nobody_holds_one_and_nobody_can(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    with ExperimentLock(tmp_path / ".lock"):
        pass

    def refuse(*_: object) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(fcntl, "lockf", refuse)
    assert holder_of(tmp_path / ".lock") is None
    with pytest.raises(StorageError, match="offers no locks: No locks available"), ExperimentLock(tmp_path / ".lock"):
        pass
