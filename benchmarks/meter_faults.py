"""Faults injected into power meters, on a serial line, a card, a driver and a virtual board: what is said of each."""

from __future__ import annotations

import random
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from rich import box
from rich.console import Console
from rich.table import Table
from tests.firmware.measuring import VOLTS, Steps, measure
from tests.firmware.simulated_board import BoardClock, build, executed, missing_tools
from tests.meters.scripted_driver import HWMON
from tests.meters.scripted_driver import measured as measured_by_driver
from tests.meters.scripted_meter import NOISE, ScriptedMeter, frame, hello, recording, sample

from robot_runner.core.errors import RobotRunnerError
from robot_runner.plugins.profilers import Ina219
from robot_runner.testing import Chunk, FakeClock, FakeLinks, FakeSerialLine, make_context, rehearse

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.firmware.simulated_board import Build

    from robot_runner.core.events.context import RobotRunnerContext

_SECONDS = 3.0
_END = 10.0


class Fault(NamedTuple):
    """A fault, or a control without one.

    Attributes:
        way: to the meter.
        name: what is wrong.
        execute: executes a run in a folder and returns its context.
        expected: what must stand in one of the sentences that are said; nothing may be said where it is empty.
    """

    way: str
    name: str
    execute: Callable[[Path], RobotRunnerContext]
    expected: str


class Answer(NamedTuple):
    """What was said of a fault, and whether the fault itself was told: for a control, whether nothing was said."""

    said: tuple[str, ...]
    is_right: bool


def answer(fault: Fault, folder: Path) -> Answer:
    """Inject a fault into a run in a folder, and return what was said."""
    try:
        said = tuple(finding.problem for finding in fault.execute(folder).broker.findings)
    except RobotRunnerError as error:
        said = (error.problem,)
    told = [problem for problem in said if fault.expected and fault.expected in problem]
    return Answer((*told, *(each for each in said if each not in told)), bool(told) if fault.expected else not said)


def _line(
    name: str,
    expected: str,
    chunks: list[Chunk],
    *,
    lost_at: float | None = None,
    seconds: float = _SECONDS,
    **given: Any,
) -> Fault:
    def execute(folder: Path) -> RobotRunnerContext:
        clock, profiler = FakeClock(), Ina219(**given)
        links = FakeLinks(serial=FakeSerialLine(clock, chunks, lost_at=lost_at))
        context = make_context(folder, profiler, links=links, clock=clock)
        rehearse(context, profiler, mission=lambda: clock.sleep(seconds))
        return context

    return Fault("serial line", name, execute, expected)


def _sent(watts: float = 8.0, *, end: float = _END, **script: Any) -> list[Chunk]:
    return ScriptedMeter(lambda _: watts, **script).chunks(start=0.0, end=end)


def _samples(count: int = 2000, **columns: Callable[[int], int]) -> list[Chunk]:
    """Return samples whose number, time stamp, and registers are given by functions of their place."""
    usual: dict[str, Callable[[int], int]] = {
        "number": lambda at: at,
        "stamp": lambda at: 5000 * at,
        "shunt": lambda at: 7200 + NOISE[at % 4],
        "bus": lambda _: 2775 << 3,
    }
    told = {**usual, **columns}
    frames = (sample(told["number"](at), told["stamp"](at), told["shunt"](at), told["bus"](at)) for at in range(count))
    return [Chunk(0.0, hello(0, 0)), *(Chunk(0.005 * at + 0.002, each) for at, each in enumerate(frames))]


def _noise(count: int, period: float, size: int, begin: float = 0.0) -> list[Chunk]:
    drawn = random.Random(5)
    return [Chunk(begin + period * at, drawn.randbytes(size)) for at in range(count)]


def _merged(*lines: list[Chunk]) -> list[Chunk]:
    return sorted((chunk for line in lines for chunk in line), key=lambda chunk: chunk.received_at)


def _until(moment: float, chunks: list[Chunk]) -> list[Chunk]:
    return [chunk for chunk in chunks if chunk.received_at < moment]


_GPS = b"$GPGGA,101010.00,4717.11,N,00833.91,E,1,08,1.0,499.6,M,48.0,M,,*47\r\n"

_ON_THE_LINE = (
    _line("no fault: a constant load", "", _sent()),
    _line(
        "no fault: a load that jumps", "", ScriptedMeter(lambda at: 7.0 if at < 2 else 10.0).chunks(start=0.0, end=_END)
    ),
    _line("no fault: the largest current in range", "", _sent(35.4)),
    _line("no fault: a resonator 0.5 % slow, 30 s", "", _sent(end=40.0, skew=0.005), seconds=30.0),
    _line("no fault: power within the declared limits", "", _sent(), plausible_w=(2, 30)),
    _line("nothing is sent", "no byte came", []),
    _line("wrong baud rate: random bytes", "none of it frames: wrong baud rate", _noise(200, 0.05, 350)),
    _line("another device: a GPS receiver", "none of it frames", [Chunk(0.1 * at, _GPS) for at in range(100)]),
    _line(
        "frames of a later version only",
        "another version",
        [Chunk(0.01 * at, frame(0x21, at, b"later")) for at in range(900)],
    ),
    _line(
        "the baud rate changes half way",
        "on the line held no frame",
        _merged(_sent(end=1.5), _noise(100, 0.05, 300, 1.6)),
    ),
    _line("bytes between the frames", "belonged to no frame", _merged(_sent(), _noise(50, 0.1, 5, 0.051))),
    _line("registers stuck from the beginning", "read the same", _sent(noise=0)),
    _line(
        "registers stuck from some moment on",
        "read the same",
        _samples(shunt=lambda at: 7200 + (NOISE[at % 4] if at < 300 else 0)),
    ),
    _line("1 % of the samples lost", "samples were lost", _sent(left_out=set(range(50, 2000, 100)))),
    _line("frames damaged", "damaged and left out", _sent(damaged={100, 200, 300})),
    _line("samples sent twice", "received twice", _merged(_sent(), _sent(says_hello=False))),
    _line("a gap inside the mission", "the largest gap", _sent(left_out=set(range(200, 225)))),
    _line("a gap at the mission's beginning", "the largest gap", _sent(left_out=set(range(2, 26)))),
    _line("a gap at the mission's end", "the largest gap", _until(2.9, _sent())),
    _line("the meter dies half way", "do not cover", _until(1.5, _sent())),
    _line("half of the samples", "samples were lost", _sent(left_out=set(range(1, 2000, 2)))),
    _line(
        "a restart",
        "restarted once",
        _merged(
            _until(1.0, _sent(first_stamp=9_000_000)),
            [Chunk(chunk.received_at + 1.02, chunk.data) for chunk in _sent(end=8.0)],
        ),
    ),
    _line("the device's clock 3 % slow, 30 s", "3.1 % slow", _sent(end=40.0, skew=0.03), seconds=30.0),
    _line("the device's clock 5 % fast, 30 s", "4.8 % fast", _sent(end=40.0, skew=-0.05), seconds=30.0),
    _line("the device's clock stands still", "stood still", _samples(stamp=lambda at: 5000 * min(at, 200))),
    _line("sample numbers stand still", "carried the number", _samples(number=lambda _: 7)),
    _line("a current beyond the range", "the energy is at least", _sent(40.0)),
    _line("a voltage beyond the range", "the energy is at least", _samples(bus=lambda _: 4000 << 3)),
    _line("the sensor wired the wrong way round", "are swapped", _sent(-8.0)),
    _line("no voltage on the bus", "show no voltage", _samples(bus=lambda _: 0)),
    _line("power above the declared limits", "outside the plausible", _sent(33.0), plausible_w=(2, 30)),
    _line("power below the declared limits", "outside the plausible", _sent(0.5), plausible_w=(2, 30)),
    _line(
        "the sensor does not answer the device",
        "its sensor did not",
        [Chunk(at, hello(200 * at, 0, configuration=0)) for at in range(9)],
    ),
    _line(
        "the sensor lost its power",
        "without power",
        _merged(_sent(), [Chunk(1.0, hello(200, 995_000, configuration=0x399F))]),
    ),
    _line("another shunt than the meter says", "its shunt has", _sent(), shunt_ohm=0.05),
    _line("another rate than the meter says", "samples at 200 Hz", _sent(), rate_hz=100.0),
    _line("the cable is pulled out", "unplugged", _sent(), lost_at=1.0),
)


def _card(name: str, expected: str, data: bytes | None, *, before: bytes | None = None) -> Fault:
    def execute(folder: Path) -> RobotRunnerContext:
        file, clock = folder / "INA219.BIN", FakeClock()
        if before is not None:
            file.write_bytes(before)
        profiler = Ina219(card=str(file))
        context = make_context(folder, profiler, robot=None, clock=clock)

        def mission() -> None:
            clock.sleep(2.0)
            if data is not None:
                file.write_bytes(data)

        rehearse(context, profiler, mission=mission)
        return context

    return Fault("card", name, execute, expected)


_MARKS = [(100, True), (500, False)]
_RECORDED = recording(600, marks=_MARKS)


def _card_sent(shunt: Callable[[int], int]) -> bytes:
    pieces = [hello(0, 5000)]
    for at in range(600):
        pieces += [
            frame(0x13, at, (5000 * at + 5000).to_bytes(4, "little") + bytes([on])) for mark, on in _MARKS if mark == at
        ]
        pieces.append(sample(at, 5000 * at + 5000, shunt(at)))
    return b"".join(pieces)


_ON_THE_CARD = (
    _card("no fault: a recording with its mark", "", _RECORDED),
    _card("the file does not come", "no new recording came", None),
    _card("only the file of an earlier run", "no new recording came", None, before=_RECORDED),
    _card("the file of another device", "holds no recording", _GPS * 100),
    _card("no mark", "has no mark", recording(600)),
    _card("a mark of half a second", "the mark lasted 0.5 s", recording(600, marks=[(100, True), (200, False)])),
    _card("registers stuck", "read the same", recording(600, marks=_MARKS, noise=0)),
    _card("a block that was written badly", "lost", _RECORDED[:4096] + bytes(512) + _RECORDED[4608:]),
    _card("a current beyond the range", "the energy is at least", _card_sent(lambda _: 32000)),
    _card("the sensor wired the wrong way round", "are swapped", _card_sent(lambda at: -6000 - at % 3)),
)


def _driver(
    name: str,
    expected: str,
    lines: Callable[[float], tuple[str | None, ...]],
    *,
    shunt: str = "100000",
    **given: Any,
) -> Fault:
    def execute(folder: Path) -> RobotRunnerContext:
        context, _ = measured_by_driver(folder, lines, 10.0, {**HWMON, "shunt_resistor": shunt}, **given)
        return context

    return Fault("driver", name, execute, expected)


def _shown(moment: float, *, watts: float = 7.6, volts: float = 12.4) -> tuple[str, ...]:
    """Return what hwmon shows: power in µW, current in mA, voltage in mV; with noise."""
    milli_ampere = round(1000 * watts / 12.4) + NOISE[round(moment * 50) % 4]
    return str(round(milli_ampere * volts * 1000)), str(milli_ampere), str(round(volts * 1000))


_UNREADABLE = (None, None, None)
_BEHIND_THE_DRIVER = (
    _driver("no fault: a constant load", "", _shown),
    _driver("readings stuck", "read the same", lambda at: _shown(min(at, 54.0))),
    _driver("readings fail for a moment", "readings failed", lambda at: _UNREADABLE if 52 < at < 52.1 else _shown(at)),
    _driver("the driver falls silent", "do not cover", lambda at: _shown(at) if at < 53 else _UNREADABLE),
    _driver("the driver was told of another shunt", "was told of a shunt", _shown, shunt="10000", shunt_ohm=0.1),
    _driver("no voltage on the bus", "show no voltage", lambda at: _shown(at, volts=0.0)),
    _driver("the sensor wired the wrong way round", "are swapped", lambda at: _shown(at, watts=-7.6)),
    _driver("a current beyond the range", "the energy is at least", lambda _: ("39680000", "3200", "12400")),
    _driver(
        "power above the declared limits",
        "outside the plausible",
        lambda at: _shown(at, watts=33.0),
        plausible_w=(2, 30),
    ),
)


def board_faults(built: Build) -> tuple[Fault, ...]:
    """Return the faults that a virtual board with the real firmware takes, once that was built."""

    def board(name: str, expected: str, seconds: float = 4.0, **settings: object) -> Fault:
        def execute(folder: Path) -> RobotRunnerContext:
            given = {"load": Steps(((0.0, 0.8),)).words, "volts": VOLTS, **settings}
            with executed(built, clock=BoardClock(folder / "clock"), **given) as meter:
                return measure(meter, folder, seconds).context

        return Fault("firmware", name, execute, expected)

    return (
        board("no fault: a constant load", ""),
        board("no fault: a sensor 10 % slow", "", slowness=0.1),
        board("the sensor's wires off for half a second", "lost", away="2,2.5"),
        board("the sensor's wires off from the beginning", "its sensor did not", away="0.001"),
        board("the sensor without power for a moment", "without power", faint="2.5"),
        board("registers stuck", "read the same", stuck="2"),
        board("a current beyond the range", "the energy is at least", load="0:3.5"),
        board("a voltage beyond the range", "the energy is at least", volts=17.0),
        board("the sensor wired the wrong way round", "are swapped", load="0:-0.8"),
        board("1 % of the bytes corrupted", "damaged", corrupt=0.01, seed=1),
        board("the resonator 3 % slow", "3.0 % slow", 20.0, skew=0.03),
    )


FAULTS = (*_ON_THE_LINE, *_ON_THE_CARD, *_BEHIND_THE_DRIVER)


def main() -> None:
    """Print each fault, what was said of it, and whether that was right."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        faults = (*FAULTS, *(() if missing_tools() else board_faults(build(folder / "built"))))
        answers = []
        for number, fault in enumerate(faults):
            (place := folder / str(number)).mkdir()
            answers.append(answer(fault, place))
    table = Table(title="Faults of power meters", title_justify="left", box=box.SIMPLE_HEAD)
    for heading in ("way", "fault", "noticed", "what was said"):
        table.add_column(heading)
    for fault, one in zip(faults, answers, strict=True):
        right = "yes" if fault.expected else "silent"
        table.add_row(fault.way, fault.name, right if one.is_right else "NO", one.said[0] if one.said else "")
    console = Console(width=170, highlight=False, markup=False)
    console.print(table)
    rights = [one.is_right for fault, one in zip(faults, answers, strict=True) if fault.expected]
    quiet = [one.is_right for fault, one in zip(faults, answers, strict=True) if not fault.expected]
    console.print(f"{sum(rights)} of {len(rights)} faults noticed; {sum(quiet)} of {len(quiet)} controls silent.")
    if missing_tools():
        console.print(f"Without the firmware's faults: {missing_tools()}.")


if __name__ == "__main__":
    main()
