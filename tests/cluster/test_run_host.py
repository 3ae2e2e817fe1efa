"""The process that executes runs on a worker, without a cluster and without a run."""

from __future__ import annotations

import errno
import os
import select
import shutil
import stat
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

pytest.importorskip("distributed")

from robot_runner.cluster import run_host
from robot_runner.core.config.preparation import prepare_or_refuse
from robot_runner.core.execution.run_records import RecordReader, RecordWriter
from robot_runner.core.execution.task import OutcomeBuilder, RunOutcome, RunTask
from robot_runner.core.execution.worker import described_task

if TYPE_CHECKING:
    from collections.abc import Callable

    from robot_runner.core.config.experiment import Experiment
    from robot_runner.core.storage.layout import ExperimentFolder

LEASE = 3600.0
#: As long as nothing ends a poll, s: whoever waits for longer goes on with a run of which nobody knows any more.
SOON = 2.0


class DrivingRun:
    """A run that says nothing: `drive` happens each time that somebody looks at it, and it ends once it is stopped."""

    descriptors = ()
    due = None

    def __init__(self, builder: OutcomeBuilder, drive: Callable[[], object], ends: Callable[[], object]) -> None:
        self._builder, self._drive, self._ends = builder, drive, ends
        self._stopped_because = ""
        self._looks = 0

    def advance(self) -> bool:
        self._drive()
        self._looks += 1
        return bool(self._stopped_because) or self._looks > 1

    def stop(self, because: str, *, is_interruption: bool = False) -> None:
        del is_interruption
        self._stopped_because = because

    def outcome(self) -> RunOutcome:
        return self._builder.outcome(ended_because=self._stopped_because)

    def close(self) -> None:
        self._ends()


class Polls:
    """Stands in for a poll at which nothing arrives: it takes no time, and keeps for how long it was to wait, ms."""

    def __init__(self) -> None:
        self.timeouts: list[float | None] = []

    def register(self, descriptor: int, events: int) -> None:
        """Take a descriptor."""

    def poll(self, timeout: float | None) -> list[tuple[int, int]]:
        self.timeouts.append(timeout)
        return []


def _replies(experiment: Experiment, folder: Path, requests: int, requested: int, told: int, tells: int) -> list[Any]:
    """Return what the process tells that is to execute a run."""
    task = described_task(experiment, RunTask("r_1", 1, 1, 1, {"Task": "Video"}, 1, 1, 1))
    order = {"token": "89ab", "until": time.clock_gettime(time.CLOCK_BOOTTIME) + LEASE, "task": task}
    RecordWriter(requested)("execute", order)
    run_host._Host(experiment, folder, None, {}, requests, RecordWriter(tells, waits=True)).serve()
    replies: list[Any] = RecordReader(told).read()[0]
    for each in (requests, told, tells):
        os.close(each)
    return replies


def test_a_run_ends_as_soon_as_its_worker_wakes_up_after_its_lease(
    write_config: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The steady clock stood still meanwhile: by it most of the lease is left, while others execute the run again."""
    real, slept, polls = time.clock_gettime, [0.0], Polls()
    monkeypatch.setattr(time, "clock_gettime", lambda clock: real(clock) + slept[0] * (clock == time.CLOCK_BOOTTIME))
    monkeypatch.setattr(select, "poll", lambda: polls)
    monkeypatch.setattr(run_host, "_lack_of_room", lambda _: "")
    (requests, requested), (told, tells) = os.pipe(), os.pipe()

    def begun(_experiment: Experiment, _task: RunTask, builder: OutcomeBuilder, _watch: object) -> DrivingRun:
        return DrivingRun(builder, lambda: slept.append(slept.pop() + LEASE), lambda: os.close(requested))

    monkeypatch.setattr(run_host, "begin_run", begun)
    experiment = prepare_or_refuse(write_config(), {})
    replies = _replies(experiment, tmp_path, requests, requested, told, tells)
    assert ("ended", {"lost": run_host.GONE, "is_certain": True}) in replies
    assert all(each is not None and each < SOON * 1000 for each in polls.timeouts[1:2]), "a poll counts no suspension"


@pytest.mark.parametrize("because", ["", "the mission took more than 95 s"])
def test_a_file_that_the_worker_may_not_read_fails_its_run_and_keeps_nothing_else_from_coming_home(
    write_config: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, because: str
) -> None:
    """As where a container has written it as root: another worker would have no better luck."""
    opened = Path.open

    def refusing(path: Path, mode: str = "r", *arguments: Any, **options: Any) -> Any:
        if path.name == "metadata.yaml" and mode == "rb":
            raise PermissionError(errno.EACCES, "Permission denied", str(path))
        return opened(path, mode, *arguments, **options)

    def write(run: Path) -> None:
        (run / "bag").mkdir(parents=True)
        for name in ("bag/metadata.yaml", "energy.csv"):
            (run / name).write_text("1")

    monkeypatch.setattr(Path, "open", refusing)
    replies, _ = _replies_of_run(write_config, tmp_path, monkeypatch, write, because)
    (ended,) = [fields for kind, fields in replies if kind == "ended"]
    assert "lost" not in ended
    assert ended["files"] == 2, "energy.csv, and the log"
    problem = "'bag/metadata.yaml' may not be read by the worker's user, and stayed on the worker, where it was removed"
    assert ended["because"] == (because or problem)
    (records,) = [fields["records"] for kind, fields in replies if kind == "records"]
    assert [fields["problem"] for kind, fields in records if kind == "finding"] == [problem]


def test_a_run_that_has_locked_its_folder_comes_home_with_its_log(
    write_config: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shutil, "copyfile", _copied_where_writable)
    replies, folder = _replies_of_run(write_config, tmp_path, monkeypatch, _locked)
    (ended,) = [fields for kind, fields in replies if kind == "ended"]
    assert (ended["because"], ended["files"]) == ("", 2), "energy.csv, and the log"
    assert not folder.current_log.exists()


def test_a_run_that_cannot_be_kept_leaves_nothing_to_the_next_one(
    write_config: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Which would append to its log, and find its files."""
    monkeypatch.setattr(shutil, "copyfile", _copied_where_writable)
    monkeypatch.setattr(run_host, "open_up", lambda _: None)  # as where the folder is another user's
    replies, folder = _replies_of_run(write_config, tmp_path, monkeypatch, _locked)
    (ended,) = [fields for kind, fields in replies if kind == "ended"]
    assert "lost" not in ended
    assert ended["because"].startswith("what the run left on the worker cannot be kept: [Errno 13] Permission denied")
    assert not folder.current_log.exists()
    assert os.geteuid() or not folder.run("r_1").exists(), "root removes what is in a locked folder"


def _locked(run: Path) -> None:
    run.mkdir(parents=True)
    (run / "energy.csv").write_text("1")
    run.chmod(0o555)


def _copied_where_writable(source: Path, target: Path) -> None:
    """Copy a file as a user does who is not root: not into a locked folder."""
    if not target.parent.stat().st_mode & stat.S_IWUSR:
        raise PermissionError(errno.EACCES, "Permission denied", str(target))
    target.write_bytes(source.read_bytes())


def _replies_of_run(
    write_config: Callable[..., Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    write: Callable[[Path], None],
    because: str = "",
) -> tuple[list[Any], ExperimentFolder]:
    """Return what is told of a run that has printed a line and written into its folder, and the experiment's folder."""
    monkeypatch.setattr(run_host, "_lack_of_room", lambda _: "")
    monkeypatch.setattr(run_host, "_LOOK_AT_LEASE", 0.0)  # nothing else ends a poll here
    (requests, requested), (told, tells) = os.pipe(), os.pipe()
    experiment = prepare_or_refuse(write_config(), {})
    folder = experiment.folder

    def begun(_experiment: Experiment, task: RunTask, builder: OutcomeBuilder, _watch: object) -> DrivingRun:
        write(folder.run(task.run_id))
        folder.current_log.write_text("on the way")
        run = DrivingRun(builder, lambda: None, lambda: os.close(requested))
        run.stop(because)
        return run

    monkeypatch.setattr(run_host, "begin_run", begun)
    return _replies(experiment, tmp_path, requests, requested, told, tells), folder
