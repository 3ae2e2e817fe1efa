"""A driver of the kernel on another computer, which shows what a test writes down."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from robot_runner.measuring.host import FileSample
from robot_runner.plugins.profilers import Ina219
from robot_runner.testing import FakeClock, make_context, rehearse

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    from robot_runner.core.events.context import RobotRunnerContext

    Lines = Callable[[float], tuple[str | None, ...]]

HWMON = {
    "name": "ina219",
    "in0_input": "61",
    "in1_input": "12400",
    "curr1_input": "613",
    "power1_input": "7600000",
    "shunt_resistor": "100000",
}


class ScriptedFiles:
    """A computer whose driver shows a power that is known at each moment."""

    is_simulated = False

    def __init__(self, clock: FakeClock, files: Mapping[str, str], lines_at: Lines) -> None:
        self.clock, self.files, self.lines_at = clock, files, lines_at
        self.rate = 0.0

    def list_files(self, pattern: str) -> list[str]:
        return ["/sys/class/hwmon/hwmon0/name"] if "hwmon" in pattern else []

    def read_files(self, paths: Sequence[str]) -> list[str | None]:
        return [self.files.get(path.rpartition("/")[2]) for path in paths]

    def sample_files(self, rate: float, paths: Sequence[str], *, is_streamed: bool = False) -> ScriptedSampler:
        del paths, is_streamed
        self.rate = rate
        return ScriptedSampler(self, self.clock.now(), rate)

    def sample_utilisation(self, rate: float) -> Any:
        raise NotImplementedError

    def close(self) -> None:
        pass


class ScriptedSampler:
    """Reads those files from its beginning to its stop."""

    def __init__(self, host: ScriptedFiles, start: float, rate: float) -> None:
        self.host, self.start, self.rate = host, start, rate
        self.end: float | None = None

    def stop(self) -> list[FileSample]:
        self.end = self.end or self.host.clock.now()
        count = round((self.end - self.start) * self.rate) + 1
        moments = [self.start + number / self.rate for number in range(count)]
        return [FileSample(moment, self.host.lines_at(moment)) for moment in moments]


def measured(
    folder: Path, lines_at: Lines, seconds: float = 10.0, files: Mapping[str, str] = HWMON, **parameters: Any
) -> tuple[RobotRunnerContext, ScriptedFiles]:
    """Execute a run with the profiler on such a driver."""
    clock = FakeClock(50.0)
    profiler = Ina219(sysfs="auto", host="pi@robot", **parameters)
    context = make_context(folder, profiler, robot=None, clock=clock)
    host = ScriptedFiles(clock, files, lines_at)
    context.resources.open("computer pi@robot None None", lambda: host)
    rehearse(context, profiler, mission=lambda: clock.sleep(seconds))
    return context, host
