"""What a callback prints fails no run, wherever it goes."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from tests.conftest import written_config

from robot_runner.cli.main import main

if TYPE_CHECKING:
    from collections.abc import Callable

PRINTING = """
def before_run(self, context):
    print("ready", flush=True)
    {deed}
def populate_run_data(self): return {{"Energy": 1.0}}
"""


@pytest.fixture
def execute(tmp_path: Path) -> Callable[[str], int]:
    return lambda deed="pass": main([str(written_config(tmp_path, PRINTING.format(deed=deed))), "--plain"])


def test_a_disk_without_room_for_what_is_printed_ends_nothing_and_is_told_once(
    execute: Callable[..., int], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    with Path("/dev/full").open("w", encoding="utf-8") as full:
        monkeypatch.setattr(sys, "stdout", full)
        assert execute() == 0
    said = capsys.readouterr().err
    dropped = "output is dropped from here on (No space left on device); the experiment goes on\n"
    assert said.count(dropped) == 1
    assert "Traceback" not in said


@pytest.mark.parametrize("deed", ["import sys; sys.stdout.close()", "import sys; sys.stdout = sys.stderr = None"])
def test_a_callback_that_takes_the_streams_away_fails_no_run(
    execute: Callable[..., int], capsys: pytest.CaptureFixture[str], deed: str
) -> None:
    assert execute(deed) == 0
    assert "4 of 4" in capsys.readouterr().out
