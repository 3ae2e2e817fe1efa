"""What belongs to a run is known by the lock that it holds: a stranger who reads the same file is left alone."""

from __future__ import annotations

import errno
import fcntl
import itertools
import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from robot_runner.core.errors import StorageError
from robot_runner.core.execution.going_on import goes_on
from robot_runner.core.execution.left_processes import (
    RunMark,
    RunsElsewhere,
    await_left_processes,
    end_left_processes,
    left_processes,
    renew_mark,
    runs_elsewhere,
)
from robot_runner.core.execution.standby_lock import await_standby
from robot_runner.core.storage.layout import ExperimentFolder

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="other systems do not tell who holds a lock")

Started = subprocess.Popen[bytes]


@pytest.fixture
def opened_by(tmp_path: Path) -> Iterator[Callable[[str], Started]]:
    """Return what starts a program that opens the file of the mark, does something with it, and waits."""
    started: list[Started] = []

    def start(act: str) -> Started:
        program = (
            f"import fcntl, time; file = open({str(tmp_path / '.alive')!r}); {act}; print(flush=True); time.sleep(60)"
        )
        process = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE)
        started.append(process)
        assert process.stdout is not None
        process.stdout.readline()
        return process

    (tmp_path / ".alive").touch()
    yield start
    for process in started:
        process.kill()
        process.communicate()


@pytest.fixture
def locking() -> Iterator[Callable[[Path], Started]]:
    """Return what starts a program that locks a file, and takes no signal to end."""
    started: list[Started] = []

    def start(path: Path) -> Started:
        path.parent.mkdir(parents=True)
        program = (
            f"import fcntl, signal, time; file = open({str(path)!r}, 'w'); fcntl.flock(file, fcntl.LOCK_EX); "
            "signal.signal(signal.SIGTERM, signal.SIG_IGN); print(flush=True); time.sleep(60)"
        )
        process = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE)
        started.append(process)
        assert process.stdout is not None
        process.stdout.readline()
        return process

    yield start
    for process in started:
        process.kill()
        process.communicate()


def test_who_only_reads_the_file_of_the_mark_is_no_run_and_is_not_killed(
    tmp_path: Path, opened_by: Callable[[str], Started]
) -> None:
    folder = ExperimentFolder(tmp_path)
    backup = opened_by("file.read()")
    run = opened_by("fcntl.flock(file, fcntl.LOCK_SH)")
    assert left_processes(folder) == [run.pid]
    assert end_left_processes(folder) == [run.pid]
    assert run.wait(10) == -9
    assert backup.poll() is None


def test_a_slow_machine_is_no_earlier_execution_that_stood_by(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seconds = itertools.count(step=0.5)  # between any two looks at the clock
    monkeypatch.setattr("robot_runner.core.execution.standby_lock.time.monotonic", lambda: next(seconds))
    assert await_standby(ExperimentFolder(tmp_path)) is None


def test_what_the_runs_of_a_slot_are_marked_with_is_found_out_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = ExperimentFolder(tmp_path)
    RunMark(folder).close()
    monkeypatch.setattr(Path, "resolve", None)
    RunMark(folder).close()


def test_a_run_cannot_be_marked_where_the_file_system_offers_no_such_locks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(_descriptor: int, _kind: int) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(fcntl, "flock", refuse)
    opened = len(list(Path("/proc/self/fd").iterdir()))
    with pytest.raises(StorageError, match="the folder's file system offers no locks: No locks available") as refused:
        RunMark(ExperimentFolder(tmp_path))
    assert "results_output_path" in refused.value.fix
    assert len(list(Path("/proc/self/fd").iterdir())) == opened


def test_what_may_go_on_elsewhere_is_known_by_the_mark_that_was_left_for_it(tmp_path: Path) -> None:
    folder = ExperimentFolder(tmp_path)
    assert runs_elsewhere(folder) == []
    mark = tmp_path / ".probe-0123456789abcdef"
    mark.write_bytes(RunsElsewhere("cluster tcp://scheduler:8786", 33.0).content())
    mark.with_name(f"{mark.name}-fedcba9876543210").write_bytes(b"\xff what a worker answered to it")
    assert runs_elsewhere(folder) == [RunsElsewhere("cluster tcp://scheduler:8786", 33.0)]


@pytest.mark.parametrize(
    "content", [b"\xff\x00", b"[]", b'{"where": 1, "seconds": 5}', b'{"where": "x", "seconds": 1e300}']
)
def test_a_mark_that_says_nothing_sensible_is_waited_for_as_long_as_usual(tmp_path: Path, content: bytes) -> None:
    (tmp_path / ".probe-0123456789abcdef").write_bytes(content)
    assert runs_elsewhere(ExperimentFolder(tmp_path)) == [RunsElsewhere("another machine", 60.0)]


def test_what_is_left_of_a_run_is_found_in_a_folder_whose_name_is_no_text(tmp_path: Path) -> None:
    folder = ExperimentFolder(tmp_path / os.fsdecode(b"B\xfcro"))  # as an old disk has it
    folder.root.mkdir()
    program = "import time; print(flush=True); time.sleep(60)"
    environment = {"ROBOT_RUNNER_RUN_OF": str(folder.root)}
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, env=environment) as left:
        assert left.stdout is not None
        left.stdout.readline()
        assert left_processes(folder) == [left.pid]
        left.kill()


def test_an_experiment_goes_on_as_long_as_software_that_went_on_through_its_runs_is_being_ended(
    tmp_path: Path, locking: Callable[[Path], Started]
) -> None:
    assert not goes_on(tmp_path)
    events = tmp_path / "subjects" / "Planner" / "1" / "events.jsonl"
    supervisor = locking(events)
    assert goes_on(tmp_path)
    supervisor.kill()
    supervisor.wait()
    assert not goes_on(tmp_path)


def test_an_experiment_goes_on_as_long_as_what_it_executed_beside_its_runs(
    tmp_path: Path, locking: Callable[[Path], Started]
) -> None:
    gate = locking(tmp_path / ".aside-x3kd81_q" / ".alive")
    assert goes_on(tmp_path)
    finding = await_left_processes(ExperimentFolder(tmp_path), 0.1)
    assert gate.wait(10) == -9
    assert finding is not None
    assert "its work beside runs was still going on and was waited for" in finding.problem
    assert not list(tmp_path.glob(".aside-*"))
    assert not goes_on(tmp_path)


def test_an_experiment_goes_on_as_long_as_a_program_that_a_run_of_it_has_started(tmp_path: Path) -> None:
    program = "import time; print(flush=True); time.sleep(60)"
    environment = {"ROBOT_RUNNER_RUN_OF": str(tmp_path)}
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, env=environment) as left:
        assert left.stdout is not None
        left.stdout.readline()
        assert goes_on(tmp_path)
        left.kill()
    assert not goes_on(tmp_path)


@pytest.mark.parametrize(("touched", "is_so"), [(0.0, True), (-20.0, True), (-34.0, False), (3600.0, False)])
def test_an_experiment_goes_on_elsewhere_until_the_leases_have_ended_that_somebody_renewed(
    tmp_path: Path, touched: float, is_so: bool
) -> None:
    mark = tmp_path / ".probe-0123456789abcdef"
    mark.write_bytes(RunsElsewhere("cluster tcp://scheduler:8786", 33.0).content())
    os.utime(mark, times=(0.0, time.time() + touched))
    assert goes_on(tmp_path) is is_so


@pytest.mark.parametrize("step", [3600.0, -3600.0, -1.7e9])
def test_an_experiment_goes_on_elsewhere_as_long_as_its_leases_however_the_clock_is_set_meanwhile(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step: float
) -> None:
    """Else another experiment would take its robot while a run elsewhere still commands it."""
    folder, mark = ExperimentFolder(tmp_path), tmp_path / ".probe-0123456789abcdef"
    wall, real, set_by, passed = time.time, time.clock_gettime, 0.0, 0.0
    monkeypatch.setattr(time, "time", lambda: wall() + set_by + passed)
    monkeypatch.setattr(time, "clock_gettime", lambda clock: real(clock) + passed)
    mark.write_bytes(RunsElsewhere("cluster tcp://scheduler:8786", 33.0).content())
    set_by = step
    assert goes_on(tmp_path), "it was set since"
    passed = 3600.0
    assert not goes_on(tmp_path)
    renew_mark(mark, folder)
    assert goes_on(tmp_path), "it was set before"
    set_by = 0.0
    assert goes_on(tmp_path), "it was set back to what it was"
    passed += 34.0
    assert not goes_on(tmp_path)


@pytest.mark.parametrize("booted_at", ["1" + 400 * "0", "1e300", "1e999", "true", "[]"])
def test_a_mark_of_runs_elsewhere_with_a_monstrous_moment_goes_by_the_clock_of_time_stamps(
    tmp_path: Path, booted_at: str
) -> None:
    mark = tmp_path / ".probe-0123456789abcdef"
    facts = json.loads(RunsElsewhere("cluster tcp://scheduler:8786", 33.0).content())
    mark.write_text(json.dumps(facts).replace(json.dumps(facts["booted_at"]), booted_at))
    assert goes_on(tmp_path)
    renew_mark(mark, ExperimentFolder(tmp_path))
    assert goes_on(tmp_path)


def test_after_a_reboot_the_clock_of_time_stamps_tells_whether_an_experiment_goes_on_elsewhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, mark = ExperimentFolder(tmp_path), tmp_path / ".probe-0123456789abcdef"
    mark.write_bytes(RunsElsewhere("cluster tcp://scheduler:8786", 33.0).content())
    renew_mark(mark, folder)
    os.utime(mark, times=(0.0, 0.0))  # by the clock as it was set before
    monkeypatch.setattr("robot_runner.core.execution.left_processes.this_boot", lambda: "another one")
    assert goes_on(tmp_path)
    wall = time.time
    monkeypatch.setattr(time, "time", lambda: wall() + 34.0)
    assert not goes_on(tmp_path)
