"""Loads whose energy is known, and a run of the profiler on a board."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, cast

from robot_runner.measuring.devices import open_serial_line
from robot_runner.plugins import Window
from robot_runner.plugins.profilers import Ina219
from robot_runner.testing import make_context, rehearse

if TYPE_CHECKING:
    from pathlib import Path

    from tests.firmware.simulated_board import Board

    from robot_runner.core.events.context import RobotRunnerContext
    from robot_runner.measuring.serial_line import SerialPort
    from robot_runner.plugins import Plugin

VOLTS = 11.1
#: A cycle of the sensor's own: eight conversions of 0.532 ms of the shunt (SBOS448G, table 5).
OWN_HERTZ = 1 / (8 * 532e-6)


@dataclass(frozen=True)
class Steps:
    """A current that jumps: the phases of a mission."""

    steps: tuple[tuple[float, float], ...]

    @property
    def words(self) -> str:
        return ",".join(f"{begin}:{amperes}" for begin, amperes in self.steps)

    def repeated(self, times: int, period: float) -> Steps:
        """Return the same steps over and over, each time `period` seconds later."""
        shifts = [number * period for number in range(times)]
        return Steps(tuple((shift + begin, amperes) for shift in shifts for begin, amperes in self.steps))

    def joules(self, window: Window) -> float:
        ends = [*(begin for begin, _ in self.steps[1:]), math.inf]
        spans = [
            (amperes, min(end, window.end) - max(begin, window.start))
            for (begin, amperes), end in zip(self.steps, ends, strict=True)
        ]
        return VOLTS * sum(amperes * max(seconds, 0.0) for amperes, seconds in spans)


@dataclass(frozen=True)
class Sine:
    """A current that swings."""

    mean: float
    amplitude: float
    hertz: float
    phase: float = 0.0  # turns

    @property
    def words(self) -> str:
        return f"sine:{self.mean},{self.amplitude},{self.hertz},{self.phase}"

    def joules(self, window: Window) -> float:
        turn, shift = 2 * math.pi * self.hertz, 2 * math.pi * self.phase
        swing = self.amplitude / turn * (math.cos(turn * window.start + shift) - math.cos(turn * window.end + shift))
        return VOLTS * (self.mean * window.duration + swing)


@dataclass(frozen=True)
class Pulses:
    """A current that is switched on for a share of each period, as a motor's driver does."""

    low: float
    high: float
    hertz: float
    duty: float
    phase: float = 0.0  # turns

    @property
    def words(self) -> str:
        return f"pulses:{self.low},{self.high},{self.hertz},{self.duty},{self.phase}"

    def joules(self, window: Window) -> float:
        on = (self._periods_on(window.end) - self._periods_on(window.start)) / self.hertz
        return VOLTS * (self.low * window.duration + (self.high - self.low) * on)

    def _periods_on(self, until: float) -> float:
        turns = self.hertz * until + self.phase
        whole = math.floor(turns)
        return whole * self.duty + min(turns - whole, self.duty)


#: The paper's Fig. 4 in currents: a sleep, a movement, a task, a sleep that costs more than the first, a movement.
MISSION = Steps(((0.0, 0.685), (5.3, 0.946), (15.1, 0.73), (20.4, 0.856), (30.2, 0.73), (45.7, 0.946)))
#: Ten minutes of missions.
MISSIONS = MISSION.repeated(10, 60.7)
SWING = Sine(0.85, 0.25, 3.0)


@dataclass(frozen=True)
class Measured:
    """What the profiler made of a load."""

    context: RobotRunnerContext
    quality: dict[str, Any]

    @property
    def window(self) -> Window:
        return Window(**self.quality["window"])

    @property
    def problems(self) -> list[str]:
        return [finding.problem for finding in self.context.broker.findings]

    def error_of(self, measure: str, load: Steps | Sine | Pulses) -> float:
        """Return how far an energy is from the truth, in parts of one."""
        joules = self.context.measures[measure]
        assert isinstance(joules, float)
        return joules / load.joules(self.window) - 1.0


def metered(board: Board, folder: Path, *plugins: Plugin) -> RobotRunnerContext:
    """Return the context of a run on the board's clock, with the board's line open in it."""
    context = make_context(folder, *plugins, robot=None, clock=board.clock)
    board.clock.watch(cast("SerialPort", open_serial_line(context, board.port)))
    return context


def measure(board: Board, folder: Path, seconds: float, **parameters: Any) -> Measured:
    """Execute a run whose mission lasts so long on the board's clock, with the profiler on the board's port."""
    profiler = Ina219(port=board.port, **parameters)
    context = metered(board, folder, profiler)
    try:
        rehearse(context, profiler, mission=lambda: board.clock.sleep(seconds))
    finally:
        context.resources.close()
    return Measured(context, json.loads((context.raw_data_folder / "quality.json").read_text()))
