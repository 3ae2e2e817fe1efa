"""Tasks are started and stopped one at a time, in processes that outlive nobody, and what fails is answered."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from robot_runner_onboard.computation import fibonacci
from robot_runner_onboard.errors import TaskError
from robot_runner_onboard.task_desk import TaskDesk
from robot_runner_onboard.worker import Worker

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

COMPUTATION = [sys.executable, "-m", "robot_runner_onboard.computation"]
SOURCE = Path(__file__).parents[3] / "robot" / "robot_runner_onboard" / "src"


def saying(code: str) -> list[str]:
    return [sys.executable, "-c", textwrap.dedent(code)]


def until(holds: Callable[[], object], seconds: float = 60.0) -> bool:
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        if holds():
            return True
        time.sleep(0.01)
    return False


def is_alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def cpu_seconds(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


@pytest.fixture(autouse=True)
def importable(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", str(SOURCE))


@pytest.fixture
def desk() -> Iterator[Callable[..., TaskDesk]]:
    made: list[TaskDesk] = []

    def make(**commands: list[str]) -> TaskDesk:
        made.append(TaskDesk({name: lambda command=command: command for name, command in commands.items()}))
        return made[-1]

    yield make
    for each in made:
        each.stop_all()


def test_the_sequence_is_that_of_fibonacci() -> None:
    assert [fibonacci(terms) for terms in range(1, 9)] == [0, 1, 1, 2, 3, 5, 8, 13]


def test_the_computation_keeps_a_core_busy_until_it_is_stopped(desk: Any) -> None:
    tasks = desk(computation=COMPUTATION)
    assert tasks.start("computation") == (True, "computation started")
    pid = tasks.worker_pid
    assert until(lambda: cpu_seconds(pid) > 0.2)
    success, message = tasks.stop("computation")
    assert success
    assert message.startswith("computation stopped: ")
    assert int(message.split()[2]) > 0
    assert not is_alive(pid)


def test_one_task_at_a_time_is_going_on(desk: Any) -> None:
    tasks = desk(computation=COMPUTATION, other=COMPUTATION)
    assert tasks.start("computation")[0]
    assert tasks.start("other") == (False, "computation is running already")
    assert tasks.stop("other") == (False, "other is not running")
    assert tasks.stop_all()[0]
    assert tasks.stop("computation") == (False, "computation is not running")


def test_that_nothing_runs_is_no_fault_of_who_stops_everything(desk: Any) -> None:
    assert desk(computation=COMPUTATION).stop_all() == (True, "nothing was running")


def test_the_services_are_those_that_the_mission_calls(desk: Any) -> None:
    services = desk(computation=COMPUTATION).services()
    assert set(services) == {"task/stop", "task/computation/start", "task/computation/stop"}
    assert services["task/computation/start"]() == (True, "computation started")
    assert services["task/stop"]()[0]


def test_what_keeps_a_task_from_starting_is_answered(desk: Any) -> None:
    tasks = desk(lost=["/no/such/program"], failing=saying("print('@failed the lens cap is on')"))
    success, message = tasks.start("lost")
    assert not success
    assert "/no/such/program cannot be started" in message
    assert tasks.start("failing") == (False, "failing cannot be started: the lens cap is on")
    assert tasks.worker_pid is None


def test_what_fails_in_the_middle_is_answered_when_it_is_stopped(desk: Any) -> None:
    tasks = desk(failing=saying("print('@ready'); print('@failed the cable came off')"), computation=COMPUTATION)
    assert tasks.start("failing")[0]
    assert tasks.stop("failing") == (False, "failing failed: the cable came off")
    assert tasks.start("computation")[0]


def test_a_task_that_died_does_not_keep_another_from_starting(desk: Any) -> None:
    tasks = desk(computation=COMPUTATION)
    assert tasks.start("computation")[0]
    os.kill(tasks.worker_pid, signal.SIGKILL)
    assert until(lambda: tasks.worker_pid is None)
    assert tasks.start("computation") == (True, "computation started")


def test_a_worker_that_is_killed_is_a_failure() -> None:
    worker = Worker(COMPUTATION)
    os.kill(worker.pid, signal.SIGKILL)
    with pytest.raises(TaskError, match="it ended with code -9; the log of its node says why"):
        worker.stop()


def test_a_worker_that_does_not_begin_in_time_is_killed() -> None:
    with pytest.raises(TaskError, match=r"it did not begin within 0\.2 s"):
        Worker(saying("import time; time.sleep(60)"), patience=0.2)


def test_a_worker_that_does_not_end_in_time_is_killed() -> None:
    worker = Worker(saying("import time; print('@ready', flush=True); time.sleep(60)"))
    with pytest.raises(TaskError, match=r"it did not end within 0\.2 s and was killed"):
        worker.stop(patience=0.2)
    assert not is_alive(worker.pid)


def test_no_task_outlives_its_node() -> None:
    node = f"""
    import time
    from robot_runner_onboard.worker import Worker
    worker = Worker({COMPUTATION!r})
    print(worker.pid, flush=True)
    time.sleep(60)
    """
    with subprocess.Popen(saying(node), stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        pid = int(process.stdout.readline())
        assert is_alive(pid)
        process.kill()
    assert until(lambda: not is_alive(pid))
