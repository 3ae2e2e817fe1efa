"""The workers of a cluster as the gateway knows them: how each is asked, and what it takes to join an experiment."""

from __future__ import annotations

import asyncio
import hashlib
import os
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from robot_runner.cluster import on_worker
from robot_runner.cluster.worker_versions import compared, described_versions
from robot_runner.core.errors import Finding, StorageError
from robot_runner.core.storage import guarded_files

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from distributed import Client


class UnansweredError(Exception):
    """A worker answered with an exception, or not at all."""


#: What is raised where a worker does not answer as it should.
ANSWER = (UnansweredError, OSError, TimeoutError)


@dataclass(slots=True)
class Member:
    """A worker.

    Attributes:
        address: Dask's.
        name: what it was called when it was started, or its address.
        threads: how many runs it executes at a time.
        resources: what it was started with, as in `--resources "robot:alice=1"`.
        id: of the part that it takes in the experiment; another worker at the same address has another, and so has this
            one once it was lost.
        host: the name of its machine.
        renewed: when it was asked last to renew its lease, s on the monotonic clock.
    """

    address: str
    name: str
    threads: int
    resources: Mapping[str, float]
    id: str = ""
    host: str = ""
    renewed: float = field(default=float("-inf"))
    is_lost: bool = False
    has_joined: bool = False

    def facts(self) -> dict[str, Any]:
        """Return the same for the orchestrator."""
        return {
            "address": self.address,
            "name": self.name,
            "worker": self.id,
            "host": self.host,
            "threads": self.threads,
            "resources": sorted(self.resources),
        }


async def answer_of(client: Client, member: Member, seconds: float, ask: Callable[..., Any], *arguments: Any) -> Any:
    """Call a function on a worker, beside its tasks, and return what it returns.

    Raises:
        UnansweredError: it raised something there.
        OSError: the worker, or the scheduler, is out of reach.
        TimeoutError: it took longer than that many seconds.
    """
    async with asyncio.timeout(seconds):
        answers = await client.run(ask, *arguments, workers=[member.address], on_error="return")
    answer = answers[member.address]
    if isinstance(answer, OSError):
        raise answer
    if isinstance(answer, BaseException):
        raise UnansweredError(f"{type(answer).__name__}: {answer}") from answer
    return answer


async def joined(client: Client, member: Member, facts: Mapping[str, Any]) -> list[dict[str, str]]:
    """Have a worker join the experiment; return what keeps it from that, as plain findings.

    Raises:
        UnansweredError, OSError, TimeoutError: as `answer_of` says, once it is known that Robot Runner is there.
    """
    lease = facts["lease"]
    try:
        described = await answer_of(client, member, lease * 4, on_worker.describe)
    except UnansweredError as error:
        problem = f"Robot Runner cannot be used there: {error}"
        fix = "Install it there as it is here (with the extra `cluster`), and start the worker again."
        return [_plain(Finding.warning(f"worker {member.name}", problem, fix))]
    member.host = described["host"]
    if found := compared(described_versions(), described["versions"], member.name):
        return [_plain(each) for each in found]
    member.id = os.urandom(8).hex()
    answered = await answer_of(client, member, lease * 4, on_worker.join, {**facts["worker_facts"], "id": member.id})
    is_shared = _is_answered(Path(facts["root"]), answered) and facts["in_place"]
    await answer_of(client, member, lease, _settle, facts["session"], is_shared)
    member.has_joined = True
    return []


def _settle(session: str, is_shared: bool) -> None:
    on_worker.settle(session, is_shared=is_shared)


def _is_answered(root: Path, answered: Mapping[str, str]) -> bool:
    """Return whether the worker's answer to the probe stands in our folder: it reads and writes the same files."""
    name = answered["answer"]
    if not name or "/" in name:
        return False
    with suppress(StorageError):  # it is not there, or a link or a pipe stands there
        content = guarded_files.read_bytes(root / name, root, limit=64)
        guarded_files.remove(root / name, root)
        return hashlib.sha256(content).hexdigest() == answered["digest"]
    return False


def _plain(finding: Finding) -> dict[str, str]:
    return {"where": finding.where, "problem": finding.problem, "fix": finding.fix}
