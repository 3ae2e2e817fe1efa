"""Which screen fits where the output goes."""

from __future__ import annotations

import sys
import time
from typing import TYPE_CHECKING

from robot_runner.cli.console import is_live_terminal, output
from robot_runner.cli.screens.live import LiveScreen
from robot_runner.cli.screens.plain import PlainScreen

if TYPE_CHECKING:
    from robot_runner.config.experiment import Experiment

__all__ = ["Screen", "screen_for"]

Screen = LiveScreen | PlainScreen


def screen_for(experiment: Experiment, *, plain: bool) -> Screen:
    """Return the live screen on a terminal, and plain lines elsewhere or where they are asked for."""
    kind = LiveScreen if is_live_terminal(sys.stdout) and not plain else PlainScreen
    return kind(output(), experiment, time.monotonic)
