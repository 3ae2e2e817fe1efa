"""The process that speaks to a cluster, with a cluster in its place."""

from __future__ import annotations

import asyncio
import json
import os
from typing import TYPE_CHECKING, Any

import pytest

pytest.importorskip("distributed")

from robot_runner.cluster import cluster_members, gateway
from robot_runner.cluster.cluster_members import Member
from robot_runner.core.execution.run_records import RecordReader

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path
    from types import TracebackType
    from typing import Self


class _Future:
    """Of a task that Dask holds back: it ends when it is let go of."""

    def __init__(self) -> None:
        self._is_released = asyncio.Event()

    async def exception(self) -> None:
        await self._is_released.wait()
        raise asyncio.CancelledError

    def release(self) -> None:
        self._is_released.set()


class _Client:
    """Of a scheduler that has nobody who could begin a task."""

    scheduler_comm = None

    async def __aenter__(self) -> Self:
        self.scheduler_comm = _Connection()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        pass

    async def run_on_scheduler(self, ask: Any) -> None:
        raise ModuleNotFoundError(f"No module named {ask.__module__!r}")

    def submit(self, *_: Any, **__: Any) -> _Future:
        return _Future()


class _Connection:
    interval = 0.0


class _Told:
    """A gateway, and what it tells the orchestrator."""

    def __init__(self) -> None:
        self._requests = os.pipe()
        self._replies = os.pipe()
        self._reader = RecordReader(self._replies[0])
        facts = {"session": "0123", "lease": 1.0, "closing": 1.0, "address": "tcp://scheduler:8786"}
        self.gateway = gateway.Gateway(facts, self._requests[0], self._replies[1])

    def replies(self) -> list[tuple[str, dict[str, Any]]]:
        return self._reader.read()[0]

    def close(self) -> None:
        for each in (*self._requests, *self._replies):
            os.close(each)


@pytest.fixture
def told() -> Iterator[_Told]:
    made = _Told()
    yield made
    made.close()


def test_a_scheduler_without_robot_runner_is_told_before_any_run_is_ordered(
    told: _Told, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It unpickles each task: every run of the experiment would be lost, one after another."""

    async def connected(_: gateway.Gateway) -> _Client:
        return _Client()

    monkeypatch.setattr(gateway.Gateway, "_connected", connected)
    asyncio.run(told.gateway._follow())
    ((kind, fields),) = told.replies()
    assert kind == "unconnected"
    assert "the scheduler cannot pass runs on to the workers: ModuleNotFoundError" in fields["because"]
    assert fields["fix"].startswith("Install Robot Runner there")


def test_an_attempt_whose_worker_has_not_begun_it_is_over_as_soon_as_it_is_stopped(
    told: _Told, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another experiment has the worker's thread, perhaps for hours: Ctrl-C does not wait for that."""

    async def answer_of(*_: Any) -> bool:
        return False

    async def stopped() -> None:
        member = Member("tcp://one:1", "one", 1, {}, id="1")
        told.gateway._client = _Client()  # type: ignore[assignment]
        told.gateway._members[member.address] = member
        order = {"token": "89ab", "worker": "1", "name": "one", "address": member.address, "claims": [], "task": {}}
        told.gateway._begin(order)
        request = {"token": "89ab", "because": "interrupted", "is_interruption": True}
        await told.gateway._stop(told.gateway._attempts["89ab"], "stop", request)
        await asyncio.sleep(0)
        assert not member.is_lost

    monkeypatch.setattr(cluster_members, "answer_of", answer_of)
    asyncio.run(stopped())
    over = {"token": "89ab", "because": "interrupted", "is_interrupted": True, "seconds": 0.0}
    assert told.replies() == [("over", over)]


@pytest.mark.parametrize(
    "ended",
    [
        {"because": None},
        {"because": None, "is_interrupted": False, "seconds": 1.0, "files": 1, "bytes": "all", "list": 9},
        {"because": None, "is_interrupted": False, "seconds": 1.0, "files": 1, "bytes": 1},
        [],
    ],
    ids=["without a duration", "a text for a size", "without a list", "no mapping"],
)
def test_an_attempt_whose_worker_tells_its_end_wrongly_is_lost(told: _Told, tmp_path: Path, ended: Any) -> None:
    """Nobody told that it was over: the experiment waited for it without end, as its worker's lease was renewed."""

    async def over() -> None:
        told.gateway._facts = {**told.gateway._facts, "root": str(tmp_path), "runs": str(tmp_path)}
        member = Member("tcp://one:1", "one", 1, {}, id="1")  # whose lease ended long ago
        told.gateway._client = _Client()  # type: ignore[assignment]
        told.gateway._members[member.address] = member
        order = {"token": "89ab", "worker": "1", "name": "one", "address": member.address, "claims": [], "task": {}}
        told.gateway._begin({**order, "run": "r_1"})
        message = {"session": "0123", "token": "89ab", "first": 0, "told": json.dumps([[], ended])}
        told.gateway._take_event((0.0, message))
        for _ in range(20):
            await asyncio.sleep(0)
        ((kind, fields),) = told.replies()
        assert (kind, fields["token"]) == ("over", "89ab")
        assert "what it has left could not be brought home" in fields["lost"]

    asyncio.run(over())
