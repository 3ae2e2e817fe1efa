"""The workers of a cluster as the gateway knows them: how it calls them, and how they join an experiment."""

from __future__ import annotations

import asyncio
import hashlib
import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from robot_runner.cluster import on_worker
from robot_runner.cluster.raw_data_transfer import PIECE
from robot_runner.cluster.worker_versions import compared, described_versions
from robot_runner.core.errors import Finding, StorageError
from robot_runner.core.storage import guarded_files
from robot_runner.core.storage.input_files import INDEX, copies_in
from robot_runner.core.storage.layout import ExperimentFolder

if TYPE_CHECKING:
    from distributed import Client


class UnansweredError(Exception):
    """A worker answered with an exception, or not at all."""


#: How many pieces of files are sent together at most.
_MOST_PIECES = 500

#: What is raised where a worker does not answer as it should.
ANSWER = (UnansweredError, OSError, TimeoutError)


@dataclass(slots=True)
class Member:
    """A worker.

    Attributes:
        address: Dask's.
        name: the one that it was started with, or its address.
        threads: how many runs it executes at a time.
        resources: those that it was started with, as in `--resources "robot:alice=1"`.
        id: of its part in the experiment: another worker at the same address has another id, and so has this worker
            when it joins again after it was lost.
        host, machine: the name of its machine, and what that is (`describe_host`).
        renewed: when it was asked last to renew its lease, s on the monotonic clock.
    """

    address: str
    name: str
    threads: int
    resources: Mapping[str, float]
    id: str = ""
    host: str = ""
    machine: Mapping[str, Any] = field(default_factory=dict)
    renewed: float = field(default=float("-inf"))
    is_lost: bool = False
    has_joined: bool = False

    def facts(self) -> dict[str, Any]:
        """Return what the orchestrator needs of these, as plain data."""
        return {
            "address": self.address,
            "name": self.name,
            "worker": self.id,
            "host": self.host,
            "machine": dict(self.machine),
            "threads": self.threads,
            "resources": sorted(self.resources),
        }


async def answer_of(client: Client, member: Member, seconds: float, ask: Callable[..., Any], *arguments: Any) -> Any:
    """Call a function on a worker, beside its tasks, and return what it returns.

    Raises:
        UnansweredError: the function raised an exception there.
        OSError: the worker, or the scheduler, is out of reach.
        TimeoutError: the call took longer than `seconds`.
    """
    async with asyncio.timeout(seconds):
        answers = await client.run(ask, *arguments, workers=[member.address], on_error="return")
    answer = answers[member.address]
    if isinstance(answer, OSError) and answer.errno is None:  # Dask's own; what the function came upon has a number
        raise answer
    if isinstance(answer, BaseException):
        raise UnansweredError(f"{type(answer).__name__}: {answer}") from answer
    return answer


def why_unanswered(member: Member, lease: float, error: Exception) -> str:
    """Return in words what happened to a worker, from the error, one of `ANSWER`, that a call raised."""
    if isinstance(error, TimeoutError):
        return f"worker {member.name} has not answered for {lease:g} s"
    if isinstance(error, OSError):
        return f"the connection to worker {member.name} was lost"
    return f"worker {member.name} does not take part any more: {error}"


def refusal_of(member: Member, lease: float, error: Exception) -> list[dict[str, str]]:
    """Return, as plain findings, that a worker cannot join: so the user learns why nothing is executed there."""
    because = str(error) if isinstance(error, UnansweredError) else why_unanswered(member, lease, error)
    fix = "Correct this there; it is asked again until it joins."
    return [_plain(Finding.warning(f"worker {member.name}", f"cannot join: {because}", fix))]


async def joined(client: Client, member: Member, facts: Mapping[str, Any]) -> list[dict[str, str]]:
    """Have a worker join the experiment; return what keeps it from joining, as plain findings.

    Raises:
        UnansweredError, OSError, TimeoutError: as in `answer_of`, once Robot Runner is known to be installed there.
    """
    lease = facts["lease"]
    try:
        described = await answer_of(client, member, lease * 4, on_worker.describe)
    except UnansweredError as error:
        problem = f"Robot Runner cannot be used there: {error}"
        fix = "Install it there as it is here (with the extra `cluster`), and start the worker again."
        return [_plain(Finding.warning(f"worker {member.name}", problem, fix))]
    # One of an earlier version does not tell what its machine is, and is refused for its version below.
    member.host, member.machine = described["host"], described.get("machine") or {}
    if found := compared(described_versions(), described["versions"], member.name):
        return [_plain(each) for each in found]
    member.id = os.urandom(8).hex()
    answered = await answer_of(client, member, lease * 4, on_worker.join, {**facts["worker_facts"], "id": member.id})
    is_shared = _is_answered(Path(facts["root"]), answered) and facts["in_place"]
    if not is_shared:
        try:
            for pieces in _inputs_in(Path(facts["root"])):
                await answer_of(client, member, lease, on_worker.take_inputs, facts["session"], pieces)
        except StorageError as error:
            return [_plain(finding) for finding in error.findings]
    await answer_of(client, member, lease, partial(on_worker.settle, is_shared=is_shared), facts["session"])
    if unfitness := await _unfitness(client, member, facts):  # found now, so that it does not cost a run an attempt
        await answer_of(client, member, lease, on_worker.leave, facts["session"])
        fix = "Correct this there, and start the worker again."
        return [_plain(Finding.warning(f"worker {member.name}", f"executes no runs: {unfitness}", fix))]
    member.has_joined = True
    return []


async def _unfitness(client: Client, member: Member, facts: Mapping[str, Any]) -> str:
    """Return why a worker cannot execute runs, once it has tried to load the experiment; empty where it can."""
    session, lease, found = facts["session"], facts["lease"], None
    while found is None:
        found = await answer_of(client, member, lease, on_worker.unfitness, session, lease / 4)
    return str(found)


def _inputs_in(root: Path) -> Iterator[list[tuple[str, bytes]]]:
    """Yield the copies of the files that an experiment reads, and their index, some pieces at a time."""
    kept = ExperimentFolder(root).config
    pieces: list[tuple[str, bytes]] = []
    room = PIECE
    for path in sorted(copies_in(kept) | ({kept / INDEX} if (kept / INDEX).exists() else set())):
        with guarded_files.open_to_read(path, root) as file:
            is_begun = False
            while (piece := file.read(room)) or not is_begun:  # an empty file is a file as well
                is_begun = True
                pieces.append((path.relative_to(kept).as_posix(), piece))
                room -= len(piece)
                if room <= 0 or len(pieces) == _MOST_PIECES:
                    yield pieces
                    pieces, room = [], PIECE
    if pieces:
        yield pieces


def _is_answered(root: Path, answered: Mapping[str, str]) -> bool:
    """Return whether the worker's answer to the probe is in our folder: then it reads and writes the same files."""
    name = answered["answer"]
    if not name or "/" in name:
        return False
    with suppress(StorageError):  # there is none, or a link or a pipe in its place
        content = guarded_files.read_bytes(root / name, root, limit=64)
        guarded_files.remove(root / name, root)
        return hashlib.sha256(content).hexdigest() == answered["digest"]
    return False


def _plain(finding: Finding) -> dict[str, str]:
    return {"where": finding.where, "problem": finding.problem, "fix": finding.fix}
