"""The part that a worker takes in an experiment, without a cluster."""

from __future__ import annotations

import asyncio
import json
import threading
import time
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any
from unittest.mock import Mock

import pytest

pytest.importorskip("distributed")

from tests.cluster.conftest import until

from robot_runner.cluster import on_worker
from robot_runner.testing import FakeClock

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

LEASE = 0.05
REQUEST = {"kind": "stop", "because": "interrupted", "is_interruption": True}


def _facts(tmp_path: Path) -> dict[str, Any]:
    probe = {"path": str(tmp_path / "no_probe"), "digest": ""}
    facts = {"session": "0123", "id": "4567", "snapshot": {}, "probe": probe, "grace": 1.0, "lease": 100.0}
    return facts | {"root": str(tmp_path / "root"), "runs": str(tmp_path / "root" / "runs")}


def _worker(tmp_path: Path) -> Any:
    callbacks = {name: Sampling() for name in ("profile", "profile-cycle", "heartbeat")}
    return SimpleNamespace(
        local_directory=str(tmp_path), periodic_callbacks=callbacks, loop=Mock(add_callback=lambda called: called())
    )


class Sampling:
    """What Dask's worker calls again and again, as long as it is started."""

    def __init__(self) -> None:
        self.is_started = True

    def is_running(self) -> bool:
        return self.is_started

    def stop(self) -> None:
        self.is_started = False

    def start(self) -> None:
        self.is_started = True


def test_what_a_killed_orchestrator_left_on_a_worker_is_removed_long_after_its_lease(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nobody says goodbye: a process of each of its threads would wait there, beside what it has written."""
    clock = FakeClock()  # a busy machine may take longer than a lease for anything
    monkeypatch.setattr(on_worker, "now_counting_suspension", clock.now)
    monkeypatch.setattr(on_worker, "_ABANDONED", 6)
    monkeypatch.setattr(on_worker, "HostProcess", lambda folder: Mock())
    on_worker.join(_facts(tmp_path) | {"lease": LEASE}, _worker(tmp_path))
    folder = tmp_path / "robot-runner-4567"
    on_worker.settle("0123", is_shared=False)
    for _ in range(40):
        on_worker.renew("0123")
        clock.sleep(LEASE / 4)
        time.sleep(LEASE / 4)  # for whoever looks whether it was renewed
    assert (folder / "snapshot.json").exists(), "as long as it is renewed"
    clock.sleep(LEASE * 6)
    until(lambda: not folder.exists(), "it is removed")
    with pytest.raises(KeyError):
        on_worker.renew("0123")


def test_a_renewal_that_a_worker_takes_when_it_wakes_up_after_its_lease_leaves_nothing_of_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It had been sent before; the orchestrator has the run executed elsewhere by now."""
    real, slept = time.clock_gettime, 0.0
    monkeypatch.setattr(time, "clock_gettime", lambda clock: real(clock) + slept * (clock == time.CLOCK_BOOTTIME))
    session, host = on_worker._Session(_facts(tmp_path), tmp_path), Mock()
    session._hosts.append(host)
    session.renew()
    slept = 200.0
    session.renew()
    host.ask.assert_called_with("lease", {"until": session._until})
    assert session._until < time.clock_gettime(time.CLOCK_BOOTTIME)


def test_an_attempt_that_was_stopped_before_it_began_never_begins(tmp_path: Path) -> None:
    """Dask holds it back as long as another experiment has the thread: whoever stops it does not wait for that."""
    told: list[dict[str, Any]] = []
    session = on_worker._Session(_facts(tmp_path), tmp_path)
    session.renew()
    assert session.stop("89ab", REQUEST) is False
    session.execute({"token": "89ab", "task": {}}, told.append)
    (message,) = told
    assert json.loads(message["told"])[1] == {"because": "interrupted", "is_interrupted": True, "seconds": 0.0}
    assert session.stop("89ab", REQUEST) is True


class Host:
    """A process that executes runs, as far as it is told something; `while_told` happens before that reaches it."""

    is_alive = True

    def __init__(self, while_told: Callable[[str], object] = lambda _: None) -> None:
        self.told: list[str] = []
        self._while_told = while_told

    def ask(self, kind: str, fields: dict[str, Any]) -> None:
        self._while_told(kind)
        self.told.append(kind)

    def followed(self, outgoing: object) -> dict[str, Any]:
        until(lambda: "stop" in self.told, "it is stopped")
        return {"because": "interrupted", "is_interrupted": True, "seconds": 1.0}


def test_an_attempt_that_is_stopped_while_its_process_is_looked_for_is_stopped_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    session = on_worker._Session(_facts(tmp_path), tmp_path)
    session.renew()
    host = Host()

    def looked_for() -> Host:
        assert session.stop("89ab", REQUEST) is True
        return host

    monkeypatch.setattr(session, "_free_host", looked_for)
    session.execute({"token": "89ab", "task": {}}, lambda _: None)
    assert host.told == ["execute", "stop"]


def test_an_attempt_that_is_stopped_while_it_is_ordered_from_its_process_is_stopped_afterwards(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A process that is told to stop what it was not told to execute passes over that."""
    session = on_worker._Session(_facts(tmp_path), tmp_path)
    session.renew()
    stopping = threading.Thread(target=session.stop, args=("89ab", REQUEST))

    def stop_first(kind: str) -> None:
        if kind == "execute":
            stopping.start()
            stopping.join(0.1)  # as long as that takes where nothing holds it back

    host = Host(stop_first)
    monkeypatch.setattr(session, "_free_host", lambda: host)
    session.execute({"token": "89ab", "task": {}}, lambda _: None)
    stopping.join()
    assert host.told == ["execute", "stop"]


def test_a_worker_that_cannot_load_the_experiment_says_why_before_it_gets_any_run(tmp_path: Path) -> None:
    """Else each such worker would cost a run an attempt, and enough of them a run that never began."""
    files = {"config.py": "import a_module_of_another_lab\n\nclass RobotRunnerConfig:\n    pass\n"}
    snapshot = {"config": "config.py", "files": files, "set": {}, "batches": "", "revisions": []}
    on_worker.join(_facts(tmp_path) | {"snapshot": snapshot}, _worker(tmp_path))
    on_worker.settle("0123", is_shared=False)
    found = asyncio.run(on_worker.unfitness("0123", 60))
    assert found is not None
    assert found.startswith("config.py:1: the config raised ModuleNotFoundError"), "and names the file as it is known"
    on_worker.leave("0123")
    until(lambda: not (tmp_path / "robot-runner-4567").exists(), "nothing is left")


def test_dask_does_not_sample_a_worker_that_executes_runs(tmp_path: Path) -> None:
    """Two hundredths of a core, which a profiler of the machine would take for the run's."""
    worker = _worker(tmp_path)
    worker.periodic_callbacks["profile-cycle"].stop()
    on_worker.join(_facts(tmp_path), worker)
    on_worker.join(_facts(tmp_path) | {"session": "another", "id": "89ab"}, worker)
    assert _sampled(worker) == ["heartbeat"]
    on_worker.leave("0123")
    until(lambda: not (tmp_path / "robot-runner-4567").exists(), "the one has left")
    assert _sampled(worker) == ["heartbeat"], "as long as another experiment is there"
    on_worker.leave("another")
    until(lambda: "profile" in _sampled(worker), "it goes on as before")
    assert _sampled(worker) == ["profile", "heartbeat"], "but for what was not sampled before"


def _sampled(worker: Any) -> list[str]:
    return [name for name, callback in worker.periodic_callbacks.items() if callback.is_running()]
