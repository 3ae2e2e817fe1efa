"""Other processes are awaited until they have ended, or for as long as is said."""

from __future__ import annotations

import subprocess
import sys

from robot_runner.core.execution.processes import await_end


def test_a_process_may_be_awaited_for_longer_than_the_system_waits_at_once() -> None:
    with subprocess.Popen(
        [sys.executable, "-c", "import sys; sys.stdin.read()"], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as process:
        assert not await_end(process.pid, 0.0)
        assert process.stdin is not None
        process.stdin.close()
        assert await_end(process.pid, 1e9)
