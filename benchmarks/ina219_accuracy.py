"""How true the energy is that comes out of the power meter: the firmware, executed in simavr, sees known currents."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from tests.firmware.measuring import MISSIONS, OWN_HERTZ, SWING, VOLTS, Pulses, Sine, measure
from tests.firmware.raw_line import decoded, intact, read_until_unplugged
from tests.firmware.simulated_board import BoardClock, build, executed, missing_tools

from benchmarks.table import Row, print_table

if TYPE_CHECKING:
    from tests.firmware.measuring import Measured, Steps
    from tests.firmware.simulated_board import Build

_TEN_MINUTES = 600.0
_BOUND, _BOUND_WHEN_CORRUPT, _BOUND_IN_STEP = "0.5 %", "1 %", "2.5 %"
#: Loads in step with the samples, with the sensor's own conversions, with the beat of both, and faster than all.
_IN_STEP: tuple[tuple[str, Sine | Pulses], ...] = (
    ("sine, 200 Hz", Sine(0.8, 0.4, 200.0, 0.25)),
    ("10 % pulses, 200 Hz", Pulses(0.0, 1.0, 200.0, 0.1)),
    ("50 % pulses, 400 Hz", Pulses(0.2, 1.4, 400.0, 0.5)),
    ("10 % pulses, 235 Hz (the sensor's own)", Pulses(0.0, 1.0, OWN_HERTZ, 0.1)),
    ("10 % pulses, 35 Hz (their beat)", Pulses(0.0, 1.0, OWN_HERTZ - 200.0, 0.1)),
    ("10 % pulses, 1 kHz", Pulses(0.0, 1.0, 1000.0, 0.1)),
    ("10 % pulses, 20 kHz", Pulses(0.0, 1.0, 20_000.0, 0.1)),
)
_IN_STEP_SECONDS = 30.0


class _Outcome(NamedTuple):
    measured: Measured
    load: Steps | Sine | Pulses
    facts: dict[str, float]
    wall_s: float

    @property
    def error(self) -> str:
        return f"{100 * self.measured.error_of('Energy', self.load):+.4f} %"

    @property
    def joules(self) -> str:
        return f"{self.load.joules(self.measured.window):.2f} J"

    def sample(self, name: str) -> int:
        return int(self.measured.quality["samples"][name])


def main() -> None:
    """Print the error of the energy for each load, the samples lost, and what corruption costs."""
    if missing_tools():
        print(f"The power meter is not measured: {missing_tools()}.")
        return
    with tempfile.TemporaryDirectory() as folder:
        built = build(Path(folder))
        stepped = _executed(built, MISSIONS)
        swinging = _executed(built, SWING)
        slow = _executed(built, MISSIONS, skew=0.005)
        corrupt = _executed(built, MISSIONS, corrupt=0.01, seed=1)
        in_step = [(name, _executed(built, load, _IN_STEP_SECONDS)) for name, load in _IN_STEP]
        undetected, hit = _undetected(built, Path(folder) / "truth")
    rows = [
        Row("energy, stepped load", stepped.error, stepped.joules, "", _BOUND),
        Row("energy, sinusoidal load (3 Hz)", swinging.error, swinging.joules, "", _BOUND),
        Row("the same, resonator 0.5 % slow", slow.error, slow.joules, "", _BOUND),
        Row("samples lost", *_lost(stepped), "", "0"),
        Row("energy, stepped, 1 % of bytes corrupt", corrupt.error, corrupt.joules, "", _BOUND_WHEN_CORRUPT),
        Row("samples lost, 1 % of bytes corrupt", *_lost(corrupt), "", "those hit"),
        Row("corrupt frames taken for true ones", f"{undetected}", f"of {hit} hit", "", "0"),
        Row("simulated seconds a second", f"{_TEN_MINUTES / stepped.wall_s:.0f}", "1 (the real meter)"),
    ]
    for name, outcome in in_step:
        rows.append(Row(f"energy, {name}, {_IN_STEP_SECONDS:.0f} s", outcome.error, outcome.joules, "", _BOUND_IN_STEP))
    print_table(
        f"INA219: {_TEN_MINUTES / 60:.0f} minutes at 200 Hz, firmware in simavr, beside the analytic value", rows
    )


def _lost(outcome: _Outcome) -> tuple[str, str]:
    sent = outcome.sample("got") + outcome.sample("lost")
    return f"{outcome.sample('lost')}", f"of {sent}; {outcome.facts['corrupted']:.0f} bytes hit"


def _undetected(built: Build, truth: Path) -> tuple[int, int]:
    """Return how many frames were read that were never sent so, and how many were hit."""
    with executed(
        built, truth=truth, load=MISSIONS.words, volts=VOLTS, corrupt=0.01, seed=2, seconds=_TEN_MINUTES
    ) as board:
        received = read_until_unplugged(board)
        board.facts()
    untouched, hit = intact(truth.read_bytes(), received)
    return len(set(decoded(received)) - set(untouched)), hit


def _executed(built: Build, load: Steps | Sine | Pulses, seconds: float = _TEN_MINUTES, **settings: object) -> _Outcome:
    with tempfile.TemporaryDirectory() as name:
        folder, begun = Path(name), time.perf_counter()
        with executed(built, clock=BoardClock(folder / "clock"), load=load.words, volts=VOLTS, **settings) as board:
            measured = measure(board, folder, seconds)
            facts = board.facts()
        return _Outcome(measured, load, facts, time.perf_counter() - begun)


if __name__ == "__main__":
    main()
