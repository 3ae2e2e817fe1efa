"""The supervisor of a program, as it works on another computer: a program of its own with a lease."""

from __future__ import annotations

import json
import subprocess
import sys
from typing import TYPE_CHECKING

from tests.subjects.conftest import alive, gone
from tests.waiting import PATIENCE, wait_until

from robot_runner.subjects import supervisor

if TYPE_CHECKING:
    from collections.abc import Callable


def test_a_program_ends_at_once_where_who_waited_for_its_end_over_a_network_was_killed(
    rude_tree: Callable[..., list[str]], token: str
) -> None:
    task = {"command": rude_tree(), "environment": {}, "folder": None, "stdout": None, "stderr": None, "lease": 600}
    task |= {"stop_signal": 15, "stops_group": False, "grace": 600, "last": None, "last_seconds": 0}
    words = [sys.executable, "-I", supervisor.__file__]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as supervised:
        assert supervised.stdin is not None
        assert supervised.stdout is not None
        try:
            supervised.stdin.write(json.dumps(task).encode() + b"\n")
            supervised.stdin.flush()
            wait_until(lambda: len(alive(token)) >= 3, "it has started what it starts")
            supervised.stdin.write(b"stop\n")
            supervised.stdin.flush()
            assert not gone(token, within=0.5), "it has its grace"
            supervised.stdin.close()
            supervised.stdout.close()
            assert gone(token)
            assert supervised.wait(PATIENCE) == 0
        finally:
            supervised.kill()
