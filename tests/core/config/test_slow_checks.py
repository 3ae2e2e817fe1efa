"""A check that hangs is told by its name while it is waited for."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import pytest

from robot_runner.core.config import slow_checks
from robot_runner.core.config.plugin_checks import asked
from robot_runner.core.errors import Finding


@pytest.mark.timeout(300, method="thread")  # by a signal, the alarm is in use
@pytest.mark.parametrize(("handler", "hint"), [(signal.default_int_handler, "; Ctrl-C ends it"), (lambda *_: None, "")])
def test_a_check_that_takes_long_is_told_by_the_name_of_its_plugin(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, handler: Callable[..., None], hint: str
) -> None:
    """Where Ctrl-C is only noted, as while a robot is stopped that was left moving, it ends nothing."""

    def hangs() -> list[Finding]:
        deadline = time.monotonic() + 30
        while not caplog.messages and time.monotonic() < deadline:
            time.sleep(0.01)
        return [Finding.warning("Lidar", "it was there after all", "")]

    monkeypatch.setattr(slow_checks, "PATIENCE", 0.05)
    earlier, before = signal.getsignal(signal.SIGALRM), signal.signal(signal.SIGINT, handler)
    try:
        assert asked("Lidar", hangs) == [Finding.warning("Lidar", "it was there after all", "")]
    finally:
        signal.signal(signal.SIGINT, before)
    assert caplog.messages == [f"Lidar: the check has taken 0.05 s so far, and is waited for{hint}"]
    assert signal.getitimer(signal.ITIMER_REAL)[0] == 0
    assert signal.getsignal(signal.SIGALRM) is earlier


def test_an_alarm_that_somebody_has_set_is_left_alone() -> None:
    rung = []
    earlier = signal.signal(signal.SIGALRM, lambda *_: rung.append(1))
    try:
        signal.setitimer(signal.ITIMER_REAL, 3600)
        assert asked("Lidar", list) == []
        assert signal.getitimer(signal.ITIMER_REAL)[0] > 3000
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, earlier)


@pytest.mark.timeout(300, method="thread")
def test_a_blocked_alarm_is_not_set_as_it_would_end_the_program_once_it_is_let_through() -> None:
    set_to: list[float] = []
    blocked = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGALRM})
    try:
        assert asked("Lidar", lambda: set_to.append(signal.getitimer(signal.ITIMER_REAL)[0]) or []) == []
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, blocked)
    assert set_to == [0]


@pytest.mark.timeout(300, method="thread")
def test_no_alarm_is_left_after_a_quick_check_which_would_end_the_program() -> None:
    earlier, set_to = signal.getsignal(signal.SIGALRM), []
    assert asked("Lidar", lambda: set_to.append(signal.getitimer(signal.ITIMER_REAL)[0]) or []) == []
    assert set_to[0] > 0
    assert signal.getitimer(signal.ITIMER_REAL)[0] == 0
    assert signal.getsignal(signal.SIGALRM) is earlier


@pytest.mark.timeout(300, method="thread")
def test_a_check_in_another_thread_which_may_set_no_alarm_is_made_all_the_same() -> None:
    with ThreadPoolExecutor(1) as executor:
        assert executor.submit(asked, "Lidar", list).result() == []
