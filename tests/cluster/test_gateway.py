"""The process that speaks to a cluster, with a cluster in its place."""

from __future__ import annotations

import asyncio
import json
import os
from typing import TYPE_CHECKING, Any
from unittest.mock import AsyncMock, Mock

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


MEASURE = {"name": "Energy", "value": 1.0, "owner": "Ina219", "origin": "measured"}
ENDED = {"because": "", "is_interrupted": False, "seconds": 1.0}


@pytest.mark.parametrize(
    ("told_of_it", "fault"),
    [
        ([[], {"because": ""}], "is_interrupted is missing"),
        ([[], {**ENDED, "files": 1, "bytes": "all", "list": 9}], "bytes is 'all', not a whole number"),
        ([[], {**ENDED, "files": 1, "bytes": 1}], "list is missing"),
        ([[], {**ENDED, "seconds": float("nan")}], "seconds is nan, not a finite number"),
        ([[], {"lost": None}], "lost is None, not a text"),
        ([[], 5], "it has no records, or no end"),
        ([[7], None], "a record has no kind, or no fields"),
        ([[["event", {"event": "start_run", "at": 5}]], None], "at is 5, not a moment"),
        ([[["failure", {"problem": None}]], None], "problem is None, not a text"),
        ([[["measure", {**MEASURE, "value": float("inf")}]], None], "value is inf, not a finite number"),
        ([[["measure", {**MEASURE, "origin": "guessed"}]], None], "origin is 'guessed', of which there is none"),
        ("[" * 100_000, "recursion"),
        (None, "NoneType"),
    ],
)
def test_an_attempt_whose_worker_tells_something_of_another_shape_is_lost(
    told: _Told, told_of_it: Any, fault: str
) -> None:
    """Nobody told that it was over: the experiment waited without end. Or it broke off, with all other runs."""

    async def over() -> None:
        member = Member("tcp://one:1", "one", 1, {}, id="1")  # whose lease ended long ago
        told.gateway._client = _Client()  # type: ignore[assignment]
        told.gateway._members[member.address] = member
        order = {"token": "89ab", "worker": "1", "name": "one", "address": member.address, "claims": [], "task": {}}
        told.gateway._begin({**order, "run": "r_1"})
        text = told_of_it if isinstance(told_of_it, str | None) else json.dumps(told_of_it)
        told.gateway._take_event((0.0, {"session": "0123", "token": "89ab", "first": 0, "told": text}))
        for _ in range(20):
            await asyncio.sleep(0)
        ((kind, fields),) = told.replies()
        assert (kind, fields["token"]) == ("over", "89ab")
        assert fields["lost"].startswith("what worker one told cannot be read: ")
        assert fault in fields["lost"]
        assert member.is_lost  # its lease ends, and with it the run, whatever that does

    asyncio.run(over())


def test_an_attempt_whose_worker_does_not_tell_how_much_it_has_told_before_is_lost(told: _Told) -> None:
    async def over() -> None:
        member = Member("tcp://one:1", "one", 1, {}, id="1")
        told.gateway._client = _Client()  # type: ignore[assignment]
        told.gateway._members[member.address] = member
        order = {"token": "89ab", "worker": "1", "name": "one", "address": member.address, "claims": [], "task": {}}
        told.gateway._begin({**order, "run": "r_1"})
        told.gateway._take_event((0.0, {"session": "0123", "token": "89ab", "told": "[[], null]"}))
        for _ in range(20):
            await asyncio.sleep(0)
        ((_, fields),) = told.replies()
        assert fields["lost"] == "what worker one told did not come whole"

    asyncio.run(over())


def test_an_attempt_whose_worker_sends_something_else_than_its_files_is_lost(told: _Told, tmp_path: Path) -> None:
    async def over() -> None:
        told.gateway._facts = {**told.gateway._facts, "root": str(tmp_path), "runs": str(tmp_path)}
        member = Member("tcp://one:1", "one", 1, {}, id="1")
        attempt = gateway._Attempt({"token": "89ab", "run": "r_1"}, member)
        told.gateway._client = Mock(run=AsyncMock(return_value={member.address: 5}))
        await told.gateway._end(attempt, {**ENDED, "files": 1, "bytes": 1, "list": 9})
        ((kind, fields),) = told.replies()
        assert kind == "over"
        assert "what it has left could not be brought home" in fields["lost"]

    asyncio.run(over())


def test_what_others_tell_under_the_same_topic_changes_nothing(told: _Told) -> None:
    for message in ("text", None, ["89ab"], {}, {"session": "0123", "token": ["89ab"], "told": "5"}):
        told.gateway._take_event((0.0, message))
    assert told.replies() == []
