"""Other processes are awaited until they have ended, or for as long as is said."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from typing import TYPE_CHECKING, Any

import pytest

from robot_runner.core.execution.processes import await_an_end, await_end

if TYPE_CHECKING:
    from collections.abc import Callable


@pytest.fixture(params=[errno.ENOSYS, errno.EPERM, errno.EMFILE], ids=errno.errorcode.get)
def no_descriptor(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Have the system refuse descriptors of processes, as Linux before 5.3, a container, or one with too many open."""

    def refuse(_: int) -> int:
        raise OSError(request.param, os.strerror(request.param))

    monkeypatch.setattr(os, "pidfd_open", refuse, raising=False)


def test_a_process_may_be_awaited_for_longer_than_the_system_waits_at_once() -> None:
    with subprocess.Popen(
        [sys.executable, "-c", "import sys; sys.stdin.read()"], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as process:
        assert not await_end(process.pid, 0.0)
        assert process.stdin is not None
        process.stdin.close()
        assert await_end(process.pid, 1e9)


@pytest.mark.usefixtures("no_descriptor")
def test_where_the_system_has_no_descriptors_of_processes_their_ends_are_looked_for() -> None:
    with subprocess.Popen([sys.executable, "-c", "raise SystemExit(3)"]) as process:
        assert await_an_end([os.getpid(), process.pid], 60.0) == [process.pid]
        assert not await_end(os.getpid(), 0.0)
        assert process.wait() == 3  # who waits has not taken it


@pytest.mark.usefixtures("no_descriptor")
def test_runs_are_executed_where_the_system_has_no_descriptors_of_processes(execute: Callable[..., Any]) -> None:
    assert [row["status"] for row in execute().table] == ["Done"] * 4
