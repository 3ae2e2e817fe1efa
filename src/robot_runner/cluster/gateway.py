"""The process that speaks to the cluster for an orchestrator: `python -m robot_runner.cluster.gateway`.

Dask's client has threads, and the orchestrator has none. So it starts this process, sends it orders through a pipe, and
gets records and ends of runs back:

    orchestrator ── begin, stop, kill ──> gateway ── tasks, leases, pieces ──> scheduler ──> workers
                 <── joined, gone, records, over ──

**Leases.** Nobody knows of a worker that does not answer whether its run goes on. So each worker has a lease, which the
gateway renews as long as the worker answers; a run whose lease ends is stopped there (`run_host.py`). An attempt on a
worker that is lost is told to be over only when its lease and the time to close the run have passed: until then nobody
executes the run a second time. (Gray and Cheriton, Leases, SOSP 1989; each side counts on its own clock.)

**At most once.** A task is bound to one worker, and tells which; Dask does not retry it. A worker refuses what was
meant for another one, and what it has begun before.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import sys
import time
from collections.abc import Mapping
from concurrent.futures import CancelledError
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from distributed import Client, Future

from robot_runner.cluster import cluster_members, on_worker
from robot_runner.cluster.cluster_checks import cluster_settings
from robot_runner.cluster.piped_process import Replies
from robot_runner.cluster.raw_data_transfer import TransferError, bring_home
from robot_runner.cluster.run_host import ended_unbegun
from robot_runner.cluster.worker_messages import read_message
from robot_runner.core.errors import StorageError
from robot_runner.core.execution.left_processes import renew_mark
from robot_runner.core.execution.run_records import RecordReader
from robot_runner.core.storage.layout import ExperimentFolder

#: How many runs are brought home at a time: this many pieces are in memory.
_TRANSFERS = 4
#: How often it is looked which workers there are, s; with many of them less often, as the answer grows with them.
_LOOK, _WORKERS_A_SECOND = 1.0, 100
#: How long the end of a task may come before what the worker has told of the run, s.
_LATE = 10.0
#: How long workers are told that the experiment has ended, s; their leases end as well.
_GOODBYE = 5.0
#: How long Dask's client holds back what follows a message, to send it together with more, s: by default 10 ms, in
#: which a worker without a run would wait.
_TOGETHER = 0.0005


@dataclass(slots=True)
class _Attempt:
    order: dict[str, Any]
    member: cluster_members.Member
    future: Future | None = None
    received: int = 0
    is_over: bool = False
    is_ending: bool = False
    killed: asyncio.Event = field(default_factory=asyncio.Event)

    @property
    def token(self) -> str:
        return str(self.order["token"])


class Gateway:
    """Speaks to the cluster.

    Args:
        facts: `address`, `session`, `root` of the experiment's folder, `runs` in it, `closing` (how long the end of a
            run may take once it is asked to stop, s), what workers are told (`worker_facts`), and the settings of
            `lease` and `patience`, both in s, and `in_place`.
        requests: a descriptor from which the orchestrator's requests are read.
        replies: a descriptor that takes what is told to it.
    """

    def __init__(self, facts: Mapping[str, Any], requests: int, replies: int) -> None:
        self._facts = facts
        self._session: str = facts["session"]
        self._requests = RecordReader(requests)
        self._descriptor = requests
        self._replies = Replies(replies)
        self._members: dict[str, cluster_members.Member] = {}
        self._attempts: dict[str, _Attempt] = {}
        self._transfers = asyncio.Semaphore(_TRANSFERS)
        self._is_ending = asyncio.Event()
        self._client: Client | None = None
        self._tasks: set[asyncio.Task[None]] = set()
        self._done: list[Future] = []

    async def serve(self) -> None:
        """Speak to the cluster until the orchestrator ends this, or is gone; begin anew where the scheduler is lost."""
        self._replies.tell("settings", {name: self._facts[name] for name in ("lease", "patience")})
        asyncio.get_running_loop().add_reader(self._descriptor, self._take_requests)
        ending = asyncio.create_task(self._is_ending.wait())
        while not self._is_ending.is_set():
            following = asyncio.create_task(self._follow())
            await asyncio.wait([following, ending], return_when=asyncio.FIRST_COMPLETED)
            if not following.done():
                await self._say_goodbye()
                following.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await following
            if not self._is_ending.is_set():
                self._lose_all("the scheduler is out of reach")
                await asyncio.wait([ending], timeout=_LOOK)
        await self._replies.flushed()

    async def _follow(self) -> None:
        """Follow what the cluster does, until its scheduler is lost."""
        because, fix = "", ""
        try:
            async with await self._connected() as self._client:
                connection = self._client.scheduler_comm
                connection.interval = _TOGETHER
                await self._look_at_scheduler(self._client)
                self._replies.tell("connected", {})
                self._client.subscribe_topic(on_worker.TOPIC, self._take_event)
                while self._client.scheduler_comm is connection:  # Dask makes another, without tasks
                    await self._look_for_workers(self._client)
                    await asyncio.sleep(max(_LOOK, len(self._members) / _WORKERS_A_SECOND))
        except (OSError, TimeoutError) as error:
            silent = f"it has not answered for {self._facts['lease']:g} s"
            because = f"the scheduler cannot be reached: {str(error) or silent}"
        except cluster_members.UnansweredError as error:
            because = f"the scheduler cannot pass runs on to the workers: {error}"
            fix = "Install Robot Runner there as it is here (with the extra `cluster`), and start the scheduler again."
        finally:
            self._client = None
        if because:
            self._replies.tell("unconnected", {"because": because, "fix": fix})

    async def _connected(self) -> Client:
        """Return a client of the scheduler.

        Raises:
            OSError: it cannot be reached.
            TimeoutError: it takes the connection and says nothing, for which Dask itself would wait without end.
        """
        lease = self._facts["lease"]
        client = Client(self._facts["address"], asynchronous=True, set_as_default=False, timeout=lease)
        try:
            async with asyncio.timeout(2 * lease):
                return await client
        except TimeoutError as error:
            await client.close()
            raise TimeoutError(f"it has not answered for {2 * lease:g} s") from error

    async def _look_at_scheduler(self, client: Client) -> None:
        """Check whether the scheduler can unpickle our tasks: else each of them would fail, and with it each run.

        Raises:
            UnansweredError: it cannot.
        """
        try:
            async with asyncio.timeout(4 * self._facts["lease"]):  # it may have to import all of it
                await client.run_on_scheduler(on_worker.be_there)
        except (ImportError, AttributeError) as error:
            raise cluster_members.UnansweredError(f"{type(error).__name__}: {error}") from error

    async def _look_for_workers(self, client: Client) -> None:
        async with asyncio.timeout(self._facts["lease"]):
            identity = await client.scheduler.identity(n_workers=-1)
        workers = identity["workers"]
        for address in set(self._members) - set(workers):
            self._lose(self._members[address], f"worker {self._members[address].name} is gone")
        for address, facts in workers.items():
            if address not in self._members:
                member = self._members[address] = cluster_members.Member(
                    address, str(facts["name"]), facts["nthreads"], facts["resources"]
                )
                self._go_on(self._keep(client, member))

    async def _keep(self, client: Client, member: cluster_members.Member) -> None:
        """Have a worker join, and renew its lease as long as it answers."""
        self._replies.tell("joining", {"address": member.address})
        try:
            findings = await cluster_members.joined(client, member, self._facts)
            if findings:
                self._replies.tell("refused", {"address": member.address, "findings": findings})
                return
            self._replies.tell("joined", member.facts())
            folder, mark = self._facts["root"], self._facts["worker_facts"]["probe"]["path"]
            while not (member.is_lost or self._is_ending.is_set()):
                member.renewed = time.monotonic()
                with contextlib.suppress(OSError):  # other experiments see by it since when nobody looks after the runs
                    renew_mark(Path(mark), ExperimentFolder(Path(folder)))
                await cluster_members.answer_of(client, member, self._facts["lease"], on_worker.renew, self._session)
                await asyncio.sleep(self._facts["lease"] / 4)
        except cluster_members.ANSWER as error:
            lease = self._facts["lease"]
            if not member.has_joined:
                findings = [] if member.is_lost else cluster_members.refusal_of(member, lease, error)
                self._replies.tell("refused", {"address": member.address, "findings": findings})
            self._lose(member, cluster_members.why_unanswered(member, lease, error))

    def _take_requests(self) -> None:
        requests, is_open = self._requests.read()
        for kind, fields in requests:
            if kind == "begin":
                self._begin(fields)
            elif kind == "end":
                self._is_ending.set()
            elif (attempt := self._attempts.get(fields["token"])) is not None:
                self._go_on(self._stop(attempt, kind, fields))
        if not is_open:  # the orchestrator is gone
            asyncio.get_running_loop().remove_reader(self._descriptor)
            self._is_ending.set()

    def _begin(self, order: dict[str, Any]) -> None:
        member = self._members.get(order["address"])
        if self._client is None or member is None or member.is_lost or member.id != order["worker"]:
            lost = {"lost": f"worker {order['name']} is gone", "is_certain": True}  # it was not begun
            self._replies.tell("over", {"token": order["token"], **lost})
            return
        attempt = self._attempts[order["token"]] = _Attempt(order, member)
        attempt.future = self._client.submit(
            on_worker.execute,
            {"session": self._session, **{name: order[name] for name in ("token", "worker", "task")}},
            key=f"robot-runner-{order['token']}",
            workers=[member.address],
            allow_other_workers=False,
            resources={claim: 1 for claim in order["claims"] if claim in member.resources} or None,
            pure=False,
            retries=0,
        )
        self._go_on(self._await_task(attempt))
        # Only now, as the scheduler holds back what follows a message within some milliseconds: the worker would wait.
        while self._done:
            self._done.pop().release()

    async def _await_task(self, attempt: _Attempt) -> None:
        """Wait for the end of Dask's task; what the worker has told of the run comes before it."""
        assert attempt.future is not None  # noqa: S101 - it was submitted
        try:
            error = await attempt.future.exception()
        except (asyncio.CancelledError, CancelledError, OSError):  # the scheduler forgot it, and its worker did not
            if not attempt.is_over:
                self._lose(attempt.member, "the connection to the scheduler was lost")
            return
        if error is None and not attempt.is_ending:
            await asyncio.sleep(_LATE)
            error = RuntimeError("its worker did not tell how it ended")
        if not attempt.is_ending:
            self._go_on(self._tell_lost(attempt, str(error) or type(error).__name__))

    async def _stop(self, attempt: _Attempt, kind: str, request: dict[str, Any]) -> None:
        if kind == "kill":
            attempt.killed.set()
        client, member, lease, asked = self._client, attempt.member, self._facts["lease"], {"kind": kind, **request}
        if client is not None and not member.is_lost:
            with contextlib.suppress(*cluster_members.ANSWER):
                is_begun = await cluster_members.answer_of(
                    client, member, lease, on_worker.stop, self._session, attempt.token, asked
                )
                if not is_begun and not attempt.is_ending:
                    self._tell_unbegun(attempt, request)

    def _tell_unbegun(self, attempt: _Attempt, request: Mapping[str, Any]) -> None:
        """Tell that an attempt is over which its worker had no thread for yet, and does not begin any more."""
        attempt.is_over = attempt.is_ending = True
        self._forget(attempt)
        self._replies.tell("over", {"token": attempt.token, **ended_unbegun(request)})

    def _take_event(self, event: tuple[float, Any]) -> None:
        message = event[1] if isinstance(event[1], dict) else {}  # any client of the scheduler may tell something here
        attempt = self._attempts.get(str(message.get("token")))
        if message.get("session") != self._session or attempt is None or attempt.is_ending:
            return
        try:
            records, ended = read_message(message["told"])
        except (LookupError, ValueError) as error:
            self._lose(attempt.member, f"what worker {attempt.member.name} told cannot be read: {error}")
            return
        if message.get("first") != attempt.received:
            self._lose(attempt.member, f"what worker {attempt.member.name} told did not come whole")
            return
        attempt.received += len(records)
        if records:
            self._replies.tell("records", {"token": attempt.token, "records": records})
        if ended is not None:
            attempt.is_ending = True
            self._go_on(self._end(attempt, ended))

    async def _end(self, attempt: _Attempt, ended: dict[str, Any]) -> None:
        """Bring home what an attempt has left, and tell that it is over."""
        if "lost" in ended:
            if ended.get("is_unfit"):
                self._replies.tell("aside", {"worker": attempt.member.id, "because": ended["lost"]})
            await self._tell_lost(attempt, ended["lost"], is_certain=ended.get("is_certain", False))
            return
        over = {name: ended[name] for name in ("because", "is_interrupted", "seconds")}
        if ended.get("files"):
            try:
                await self._brought_home(attempt, ended)
            except StorageError as error:
                over["because"] = f"what it has left could not be brought home: {error}"
            except (TransferError, LookupError, TypeError, ValueError, *cluster_members.ANSWER) as error:
                because = str(error) or type(error).__name__
                await self._tell_lost(attempt, f"what it has left could not be brought home: {because}")
                return
        self._tell_over(attempt, over)

    async def _brought_home(self, attempt: _Attempt, ended: Mapping[str, Any]) -> None:
        client, lease, session = self._client, self._facts["lease"], self._session

        async def read(name: str, offset: int, size: int) -> tuple[bytes, str]:
            if client is None:
                raise OSError("the scheduler is out of reach")
            ask = on_worker.read_piece
            piece, digest = await cluster_members.answer_of(
                client, attempt.member, lease, ask, session, attempt.token, name, offset, size
            )
            return piece, digest

        root = Path(self._facts["root"])
        async with self._transfers:
            await bring_home(read, ended, Path(self._facts["runs"]) / attempt.order["run"], root)
        if client is not None:
            await cluster_members.answer_of(client, attempt.member, lease, on_worker.discard, session, attempt.token)

    def _lose_all(self, because: str) -> None:
        self._done.clear()  # with the scheduler that knew them
        for member in list(self._members.values()):
            self._lose(member, because)

    def _lose(self, member: cluster_members.Member, because: str) -> None:
        """Take a worker for lost; its attempts are over once its lease has ended and its runs are closed."""
        if self._members.get(member.address) is member:
            del self._members[member.address]
        if member.is_lost:
            return
        member.is_lost = True
        if member.has_joined:
            self._replies.tell("gone", {"worker": member.id, "name": member.name, "because": because})
        for attempt in [each for each in self._attempts.values() if each.member is member]:
            self._go_on(self._tell_lost(attempt, because))

    async def _tell_lost(self, attempt: _Attempt, because: str, *, is_certain: bool = False) -> None:
        """Tell that an attempt is lost, once its run has ended in any case: at once where that is certain."""
        if attempt.is_over:
            return
        attempt.is_over = attempt.is_ending = True
        end = 0.0 if is_certain else attempt.member.renewed + self._facts["lease"] + self._facts["closing"]
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(attempt.killed.wait(), max(0.0, end - time.monotonic()))
        self._forget(attempt)
        self._replies.tell("over", {"token": attempt.token, "lost": because, "is_certain": is_certain})

    def _tell_over(self, attempt: _Attempt, over: dict[str, Any]) -> None:
        if not attempt.is_over:
            attempt.is_over = True
            self._attempts.pop(attempt.token, None)
            self._done += [] if attempt.future is None else [attempt.future]
            self._replies.tell("over", {"token": attempt.token, **over})

    def _forget(self, attempt: _Attempt) -> None:
        self._attempts.pop(attempt.token, None)
        if attempt.future is not None:
            attempt.future.release()  # so that the scheduler forgets the task as well

    async def _say_goodbye(self) -> None:
        client = self._client
        if client is None:
            return
        here = [each for each in self._members.values() if each.id and not each.is_lost]  # or are about to join
        answers = (cluster_members.answer_of(client, each, _GOODBYE, on_worker.leave, self._session) for each in here)
        await asyncio.gather(*answers, return_exceptions=True)

    def _go_on(self, steps: Any) -> None:
        task = asyncio.create_task(steps)
        self._tasks.add(task)  # the loop itself holds no task
        task.add_done_callback(self._tasks.discard)


def main(requests: int, replies: int) -> None:
    """Be the gateway of one experiment; its facts are the first request."""
    os.setsid()  # Ctrl-C is the orchestrator's: it says what becomes of the runs
    reader = RecordReader(requests)
    while not (begun := reader.read())[0]:
        if not begun[1]:
            return
        time.sleep(0.01)
    facts, settings = begun[0][0][1], cluster_settings()
    worker_facts = facts["worker_facts"] | {"lease": settings["lease"]}
    asyncio.run(Gateway(facts | settings | {"worker_facts": worker_facts}, requests, replies).serve())


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))
