"""Functions in a thread of their own: returned, raised, gone on with, also in a forked process."""

from __future__ import annotations

import os
import signal
import threading
from contextlib import closing
from pathlib import Path

import pytest
from tests.waiting import PATIENCE, wait_until

from robot_runner.core.events.early_end import RunInterrupted
from robot_runner.ros.own_thread import OwnThread


def test_what_a_function_returns_or_raises_comes_to_the_caller():
    with closing(OwnThread()) as own:
        assert own.call(threading.get_ident) != threading.get_ident()
        with pytest.raises(ZeroDivisionError):
            own.call(lambda: 1 // 0)
        assert own.call(lambda: 2) == 2


def test_a_function_goes_on_where_its_caller_is_interrupted_and_the_next_one_waits_for_it():
    done, goes_on = [], threading.Event()

    def interrupt(*_):
        raise RunInterrupted

    def slow():
        signal.pthread_kill(threading.main_thread().ident, signal.SIGUSR1)
        goes_on.wait(PATIENCE)
        done.append("slow")

    earlier = signal.signal(signal.SIGUSR1, interrupt)
    try:
        with closing(OwnThread()) as own:
            with pytest.raises(RunInterrupted):
                own.call(slow)
            goes_on.set()
            own.call(lambda: done.append("next"))
    finally:
        signal.signal(signal.SIGUSR1, earlier)
    assert done == ["slow", "next"]


def test_a_forked_process_has_a_thread_of_its_own():
    own = OwnThread()
    own.call(int)
    child = os.fork()
    if child == 0:
        os._exit(own.call(lambda: 7))
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 7
    own.close()


def test_it_ends_once_it_is_closed():
    own = OwnThread()
    thread = Path(f"/proc/self/task/{own.call(threading.get_native_id)}")
    assert thread.exists()
    own.close()
    wait_until(lambda: not thread.exists())
