"""The evaluation of the sensor's raw registers, as they come up a serial line or from an SD card."""

from __future__ import annotations

from array import array
from dataclasses import asdict
from operator import mul
from typing import TYPE_CHECKING, Any

from robot_runner.plugins.profilers.ina219.calibration import POWER_ON_CONFIGURATION, Calibration, Ranges
from robot_runner.plugins.profilers.ina219.evaluation import Evaluation
from robot_runner.plugins.sampling.quality import quality_of
from robot_runner.plugins.sampling.raw_files import Column
from robot_runner.plugins.sampling.series import Series

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from robot_runner.plugins.profilers.ina219.stream import SampleStream
    from robot_runner.plugins.sampling.window import Window

__all__ = ["DEFAULT_RATE", "DEFAULT_SHUNT", "evaluate_registers"]

#: What holds where neither the user nor the device says otherwise: the paper's 200 Hz, and the shunt of the common
#: breakout boards.
DEFAULT_RATE = 200.0
DEFAULT_SHUNT = 0.1


def evaluate_registers(
    stream: SampleStream,
    times: Sequence[float],
    window: Window,
    *,
    shunt_ohm: float | None = None,
    rate_hz: float | None = None,
    is_simulated: bool = False,
) -> Evaluation:
    """Return the samples of a stream in physical units; what is None is taken from the device's hello.

    Args:
        stream: the samples.
        times: when each was taken, s.
        window: the measured one, on the clock of `times`.
        shunt_ohm: resistance of the shunt, ohm.
        rate_hz: nominal rate, Hz.
        is_simulated: whether a simulated sensor took them.
    """
    hello = stream.hello
    shunt = shunt_ohm or (hello.shunt_ohm if hello else 0.0) or DEFAULT_SHUNT
    rate = rate_hz or (float(hello.rate_hz) if hello else 0.0) or DEFAULT_RATE
    calibration = Calibration(shunt)
    current = array("d", map(calibration.current, stream.shunt_raw))
    voltage = array("d", map(calibration.voltage, stream.bus_raw))
    ranges = Ranges.of(hello.configuration if hello else 0)
    return Evaluation(
        window=window,
        power=Series(times, array("d", map(mul, current, voltage))),
        quality=quality_of(
            times,
            window,
            rate,
            duplicates=stream.duplicates,
            lost=stream.lost,
            corrupt=stream.counts.corrupt,
            saturated=ranges.count_saturated(stream.shunt_raw, stream.bus_raw),
        ),
        columns=(
            Column("shunt_raw", stream.shunt_raw, "%d"),
            Column("bus_raw", stream.bus_raw, "%d"),
            Column("current_A", current),
            Column("voltage_V", voltage, "%.3f"),
        ),
        details=_details(stream, shunt, rate),
        doubts=tuple(_doubts(stream, shunt, rate)),
        is_simulated=is_simulated,
    )


def _details(stream: SampleStream, shunt: float, rate: float) -> dict[str, Any]:
    return {
        "shunt_ohm": shunt,
        "rate_hz": rate,
        "restarts": stream.restarts,
        "line": asdict(stream.counts),
        "hello": None if stream.hello is None else asdict(stream.hello),
    }


def _doubts(stream: SampleStream, shunt: float, rate: float) -> Iterator[str]:
    if stream.restarts:
        times = "once" if stream.restarts == 1 else f"{stream.restarts} times"
        yield f"the power meter was restarted {times}"
    if stream.counts.foreign_versions:
        yield "the power meter speaks another version of the protocol"
    if 0 in stream.configurations:
        yield "the power meter answered, its sensor did not: look at the four wires between them"
    if POWER_ON_CONFIGURATION in stream.configurations:
        yield "the sensor was without power for a moment and measured in another range for up to a second"
    hello = stream.hello
    if hello is None:
        return
    if abs(hello.shunt_ohm - shunt) > 0.001 * shunt:
        yield f"the power meter says that its shunt has {hello.shunt_ohm:g} ohm, not {shunt:g} ohm"
    if hello.rate_hz != rate:
        yield f"the power meter says that it samples at {hello.rate_hz} Hz, not at {rate:g} Hz"
