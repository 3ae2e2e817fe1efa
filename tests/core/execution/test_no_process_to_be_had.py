"""Where the system allows no more processes, that is said, and nothing of the attempt stays open."""

from __future__ import annotations

import errno
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from robot_runner.core.errors import ExecutionError

if TYPE_CHECKING:
    from collections.abc import Callable


def _open_descriptors() -> set[str]:
    return {each.name for each in Path("/dev/fd").iterdir()}


@pytest.fixture
def refused(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Return what has the system refuse a fork, as it does once a user has as many processes as are allowed."""
    fork, orchestrator = os.fork, os.getpid()

    def refuse(*, of_the_orchestrator: bool) -> None:
        def no_fork() -> int:
            if (os.getpid() == orchestrator) == of_the_orchestrator:
                raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN))
            return fork()

        monkeypatch.setattr(os, "fork", no_fork)

    return refuse


def test_an_orchestrator_that_may_not_fork_says_so_and_leaves_nothing_open(
    execute: Callable[..., Any], refused: Callable[..., None]
) -> None:
    execute()  # whatever is opened once is open now
    before = _open_descriptors()
    refused(of_the_orchestrator=True)
    with pytest.raises(ExecutionError, match="no process can be started") as caught:
        execute(experiment_name="another")
    assert "ulimit -u" in caught.value.fix
    assert _open_descriptors() == before


def test_a_keeper_that_may_not_fork_fails_the_run_with_the_reason(
    execute: Callable[..., Any], refused: Callable[..., None]
) -> None:
    refused(of_the_orchestrator=False)
    executed = execute()
    assert [row["status"] for row in executed.table] == ["Failed"] * 4
    assert "no process can be started" in str(executed.finished.failures[0])
