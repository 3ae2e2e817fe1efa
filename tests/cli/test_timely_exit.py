"""What a callback has left running is named at the end, and does not keep the program for ever."""

from __future__ import annotations

import subprocess
import sys

import pytest

PROGRAM = """
import atexit, multiprocessing, threading, time
from robot_runner.cli.timely_exit import leave_in_time
{left}
leave_in_time({code}, 0.5, 0.5)
raise SystemExit({code})
"""


@pytest.mark.parametrize(
    ("left", "named"),
    [
        ("threading.Thread(target=time.sleep, args=(60,), name='uploader').start()", "thread 'uploader'"),
        ("atexit.register(time.sleep, 60)", "a function that a callback registered with atexit"),
        ("multiprocessing.get_context('fork').Process(target=time.sleep, args=(60,)).start()", "(ForkProcess-1)"),
    ],
)
def test_what_keeps_the_program_is_named_and_it_ends_with_its_own_exit_code(left: str, named: str) -> None:
    words = [sys.executable, "-P", "-c", PROGRAM.format(left=left, code=3)]
    # Both streams are pipes: they end once no process is left that holds them.
    ended = subprocess.run(words, capture_output=True, text=True, timeout=50, check=False)
    assert ended.returncode == 3
    assert ended.stderr.count("the program waits for") == 1
    assert named in ended.stderr


def test_a_program_that_nothing_keeps_ends_without_a_word() -> None:
    program = PROGRAM.format(left="", code=0).replace("0.5, 0.5", "10.0, 10.0")
    words = [sys.executable, "-P", "-c", program]
    ended = subprocess.run(words, capture_output=True, text=True, timeout=50, check=True)
    assert ended.stderr == ""


def test_where_no_thread_can_be_started_the_exit_code_is_that_of_the_program() -> None:
    refused = 'threading.Thread.start = lambda self: (_ for _ in ()).throw(RuntimeError("can\'t start new thread"))'
    words = [sys.executable, "-P", "-c", PROGRAM.format(left=refused, code=3)]  # as `ulimit -u` has it
    ended = subprocess.run(words, capture_output=True, text=True, timeout=50, check=False)
    assert (ended.returncode, ended.stderr) == (3, "")
