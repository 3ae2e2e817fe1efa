"""How far work has come is told now and then where nobody sees a bar."""

from __future__ import annotations

from typing import TYPE_CHECKING

from robot_runner.cli.screens import progress_bars
from robot_runner.cli.screens.progress_bars import step_progress

if TYPE_CHECKING:
    import pytest


def test_a_log_has_a_line_now_and_then(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(progress_bars, "_BETWEEN_LINES_S", -1.0)
    with step_progress() as tell:
        tell("figures", 3, 1200)
    assert capsys.readouterr().err == "figures: 3 of 1,200\n"
    monkeypatch.setattr(progress_bars, "_BETWEEN_LINES_S", 3600.0)
    with step_progress() as tell:
        tell("figures", 4, 1200)
    assert capsys.readouterr().err == ""
