"""Whether values depend on the order of plugins: on the embedded robot, and on the meter's firmware in real time."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from tests.firmware.measuring import VOLTS, Steps
from tests.firmware.simulated_board import build, executed, missing_tools

from benchmarks.table import Row, print_table
from robot_runner.core.events.context import SystemClock
from robot_runner.plugins import Profiler, Window
from robot_runner.plugins.profilers import Battery, Ina219, PsUtil, RosTopics
from robot_runner.plugins.systems import BasicTurtlebot3
from robot_runner.testing import make_context, rehearse

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from robot_runner.core.events.context import RobotRunnerContext
    from robot_runner.core.events.measure import MeasureValue
    from robot_runner.plugins import Plugin

_LATE_S = 3.0
_MISSION_S = 10.0
_AMPERES = 0.865  # 9.6 W at 11.1 V
_BOUND, _SAME_WINDOW = "0.05 %", "1 ms"
_MAKERS: tuple[Callable[[], Profiler], ...] = (Ina219, PsUtil, Battery, lambda: RosTopics({"odom": 30.0}))


class Late(Profiler):
    """Needs its time to start and to stop."""

    def start_measurement(self, context: RobotRunnerContext) -> None:
        context.clock.sleep(_LATE_S)

    def stop_measurement(self, context: RobotRunnerContext) -> None:
        context.clock.sleep(_LATE_S)


class _Outcome(NamedTuple):
    values: dict[str, MeasureValue]
    mission: Window
    told: list[Window]

    @property
    def furthest(self) -> float:
        """How far an edge of a plugin's window is from that of the mission at most, s."""
        edges = [(one.start - self.mission.start, one.end - self.mission.end) for one in self.told]
        return max((abs(edge) for pair in edges for edge in pair), default=0.0)


def main() -> None:
    """Print values by order, beside their truth."""
    print_table("Order of plugins, embedded robot: mission of 95 s", list(_on_the_embedded_robot()))
    if missing_tools():
        print(f"The power meter is not measured: {missing_tools()}.")
        return
    with tempfile.TemporaryDirectory() as folder:
        built = build(Path(folder))
        rows = []
        for label, is_late_first in (("listed before", True), ("listed behind", False)):
            with executed(built, load=Steps(((0.0, _AMPERES),)).words, volts=VOLTS, pace=1) as board:
                meter = Ina219(port=board.port)
                rows += _in_real_time(label, [Late(), meter] if is_late_first else [meter, Late()])
    title = f"Constant {_AMPERES * VOLTS:.2f} W in real time, beside a profiler that starts {_LATE_S:g} s late"
    print_table(title, rows)


def _on_the_embedded_robot() -> list[Row]:
    orders = [(*_MAKERS, Late), (Late, *_MAKERS), (*_MAKERS[::-1], Late), (*_MAKERS[2:], Late, *_MAKERS[:2])]
    outcomes = [_executed([BasicTurtlebot3(task="Video", task_factor=None), *(make() for make in o)]) for o in orders]
    first = outcomes[0]
    changed = sum(each.values[name] != value for each in outcomes[1:] for name, value in first.values.items())
    compared = len(first.values) * (len(outcomes) - 1)
    return [
        Row("energy", f"{first.values['Ina219.Energy']} J", f"{outcomes[1].values['Ina219.Energy']} J", "", "equal"),
        Row("CPU", f"{first.values['CPU']} %", f"{outcomes[1].values['CPU']} %", "", "equal"),
        Row(f"values that {len(orders)} orders changed", f"{changed}", f"of {compared} compared", "", "0"),
        Row(
            f"windows of {len(first.told)} plugins, furthest from the mission",
            f"{max(each.furthest for each in outcomes) * 1000:.3f} ms",
            "",
            "",
            _SAME_WINDOW,
        ),
    ]


def _in_real_time(label: str, plugins: Sequence[Profiler]) -> list[Row]:
    outcome = _executed(plugins, robot=None, seconds=_MISSION_S)
    energy, truth = outcome.values["Energy"], _AMPERES * VOLTS * outcome.mission.duration
    if not isinstance(energy, float):
        return [Row(f"energy, {label}", "no value", f"{truth:.4f} J", "", _BOUND)]
    error = f"{100 * (energy / truth - 1):+.4f} %"
    return [
        Row(f"energy, {label}", f"{energy:.4f} J", f"{truth:.4f} J", error, _BOUND),
        Row("its window, furthest from the mission", f"{outcome.furthest * 1000:.3f} ms", "", "", _SAME_WINDOW),
    ]


def _executed(plugins: Sequence[Plugin], *, robot: str | None = "simulated", seconds: float = 0.0) -> _Outcome:
    with tempfile.TemporaryDirectory() as name:
        clock = SystemClock() if robot is None else None
        context = make_context(Path(name), *plugins, robot=robot, clock=clock)
        try:
            published = rehearse(context, *plugins, mission=lambda: context.clock.sleep(seconds))
        finally:
            context.resources.close()
        notes = [context.run_path / each.name / "quality.json" for each in plugins]
        told = [Window(**json.loads(note.read_text())["window"]) for note in notes if note.exists()]
        if context.window is None:
            raise RuntimeError("there was no mission")
        return _Outcome(dict(published), context.window, told)


if __name__ == "__main__":
    main()
