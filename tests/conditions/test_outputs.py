"""Texts are found in files that programs are writing, and files are complete when they are."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from contextlib import ExitStack
from types import SimpleNamespace
from typing import TYPE_CHECKING

import pytest

from robot_runner import Condition, ConditionError, file_complete, text_in
from robot_runner.conditions import outputs
from robot_runner.core.events.context import SystemClock
from robot_runner.testing import FakeClock, make_context

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from robot_runner import Look

PROGRAM = """
import sys, time
print("booting \\x1b[31m", flush=True)
time.sleep(0.3)
sys.stdout.write("listening on "); sys.stdout.flush()
time.sleep(0.2)
print("port 8080", flush=True)
time.sleep(60)
"""


@pytest.fixture
def watching(tmp_path: Path) -> Callable[[Condition], Callable[[], Look]]:
    context = make_context(tmp_path, clock=SystemClock(), robot=None)
    return lambda condition: condition.watch(context, ExitStack())


def test_a_text_is_found_in_the_output_of_a_program_however_it_was_flushed(tmp_path: Path) -> None:
    context = make_context(tmp_path, clock=SystemClock(), robot=None)
    with (context.run_folder / "server.txt").open("wb") as output:
        process = subprocess.Popen([sys.executable, "-c", PROGRAM], stdout=output)
    try:
        look = text_in("server.txt", re.compile(r"listening on port (\d+)")).wait(context, timeout_s=20.0)
        assert look.value == "listening on port 8080"
        with pytest.raises(ConditionError, match=re.escape("last line: 'listening on port 8080'")):
            text_in("server.txt", "never").wait(context, timeout_s=0.1)
    finally:
        process.kill()
        process.wait()


def test_only_what_is_new_counts_where_that_is_asked_for(
    watching: Callable[..., Callable[[], Look]], tmp_path: Path
) -> None:
    log = tmp_path / "system.log"
    log.write_text("ready\n")
    every, new = watching(text_in(log, "ready")), watching(text_in(log, "ready", new_only=True))
    assert every().holds
    assert not new().holds
    with log.open("a") as file:
        file.write("ready\n")
    assert new().holds


def test_a_file_that_begins_anew_is_read_from_its_beginning(
    watching: Callable[..., Callable[[], Look]], tmp_path: Path
) -> None:
    log = tmp_path / "system.log"
    log.write_text("a" * 100)
    look = watching(text_in(log, "ready", new_only=True))
    assert not look().holds
    log.write_text("ready")  # emptied, and written by the next start of the program
    assert look().holds

    look = watching(text_in(log, "fire"))
    assert not look().holds
    log.write_text("on fire by now")  # emptied, and longer than it was at the next look
    assert look().holds

    log.write_text("the server is rea")
    look = watching(text_in(log, "ready"))
    assert not look().holds
    log.write_text("dying\n")  # what stood there before does not go on
    assert look().seen == "last line: 'dying'"

    (tmp_path / "rotated.log").write_text("a" * 100)
    look = watching(text_in(tmp_path / "rotated.log", "ready"))
    assert not look().holds
    (tmp_path / "other").write_text("ready " + "b" * 200)
    (tmp_path / "other").replace(tmp_path / "rotated.log")
    assert look().holds


def test_a_text_that_was_found_stays_found_and_long_outputs_are_not_kept(
    watching: Callable[..., Callable[[], Look]], tmp_path: Path
) -> None:
    log = tmp_path / "system.log"
    log.write_bytes(b"ready\n" + b"\xff" * 3_000_000)
    look = watching(text_in(log, "never"))
    assert not look().holds
    log.write_bytes(b"x" * 2_000_000 + b"ready \xe2\x82")
    look = watching(text_in(log, "ready €"))
    assert not look().holds
    with log.open("ab") as file:
        file.write(b"\xac\n")
    assert look().holds
    log.unlink()
    assert look().holds


def test_a_text_is_found_wherever_it_stands_in_a_file_that_is_long_already(
    watching: Callable[..., Callable[[], Look]], tmp_path: Path
) -> None:
    log = tmp_path / "server.log"
    log.write_bytes(b"ready\n" + b"." * 3_000_000)
    assert watching(text_in(log, "ready"))().seen == "found 'ready'"


def test_nobody_waits_for_who_might_write_to_a_pipe(
    watching: Callable[..., Callable[[], Look]], tmp_path: Path
) -> None:
    os.mkfifo(tmp_path / "pipe")
    for condition in (text_in(tmp_path / "pipe", "ready"), file_complete(tmp_path / "pipe")):
        look = watching(condition)()
        assert not look.holds
        assert look.seen == "pipe is not a file"


def test_a_file_is_complete_when_its_size_is_steady(
    watching: Callable[..., Callable[[], Look]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock, path = FakeClock(), tmp_path / "map.pgm"
    monkeypatch.setattr(outputs, "time", SimpleNamespace(monotonic=clock.now))
    look = watching(file_complete(path, steady_s=0.4))
    path.write_bytes(b"")
    for _ in range(6):
        assert not look().holds
        clock.sleep(0.3)
        with path.open("ab") as file:
            file.write(b"0" * 1000)
    assert not look().holds
    clock.sleep(0.3)
    assert not look().holds
    clock.sleep(0.2)
    assert (look().holds, look().value) == (True, 6000)


def test_a_file_is_complete_once_it_ends_as_it_should(
    watching: Callable[..., Callable[[], Look]], tmp_path: Path
) -> None:
    look = watching(file_complete(tmp_path / "log.xml", end="</log>\n"))
    assert look().seen == "log.xml cannot be read: No such file or directory"
    for text in ("<", "<log>", "<log></log>"):
        (tmp_path / "log.xml").write_text(text)
        assert not look().holds
    (tmp_path / "log.xml").write_text("<log></log>\n")
    assert look().holds


@pytest.mark.parametrize(
    ("make", "problem"),
    [
        (lambda: text_in("log", ""), "no text is looked for"),
        (lambda: text_in("log", b"ready"), "b'ready' is not text"),
        (lambda: text_in("log", re.compile(b"ready")), "is not text"),
        (lambda: file_complete("log", steady_s=-1), "steady_s is -1"),
        (lambda: file_complete("log", steady_s="1"), "steady_s is '1'"),
        (lambda: file_complete("log", end=""), "no file ends with ''"),  # every file would
    ],
)
def test_what_no_file_can_have_is_refused(make: Callable[[], Condition], problem: str) -> None:
    with pytest.raises(ConditionError, match=re.escape(problem)):
        make()
