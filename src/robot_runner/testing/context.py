"""A run's context for a test, with the gate for measures that a real run has."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

from robot_runner.events.broker import MeasureBroker
from robot_runner.events.columns import CONFIG_OWNER, resolve_columns
from robot_runner.events.context import RobotRunnerContext
from robot_runner.events.resources import Resources
from robot_runner.links.connect import SIMULATED, open_clock
from robot_runner.testing.clock import FakeClock

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from robot_runner.events.clock import Clock
    from robot_runner.events.measure import Measure, MeasureValue
    from robot_runner.events.resources import Closable
    from robot_runner.links.host import HostLink
    from robot_runner.links.robot import RobotLink
    from robot_runner.links.serial import SerialLine
    from robot_runner.plugins.api.plugin import Plugin

__all__ = ["FakeLinks", "RecordingBroker", "context_for", "make_context"]


class RecordingBroker(MeasureBroker):
    """The broker of a real run, which also keeps what it would report.

    Attributes:
        records: what happened, oldest first, each with its kind (`measure`, `refused`, `shared`, `finding`).

    Example:
        >>> from robot_runner.events.measure import Measure, Origin
        >>> broker = RecordingBroker({"Scale": [Measure("Mass", "kg", "Mass of the robot.")]})
        >>> broker.publish("Scale", "Mass", 1.0, Origin.MEASURED)
        >>> broker.values
        {'Mass': 1.0}
    """

    def __init__(self, measures_by_plugin: Mapping[str, Sequence[Measure]], *, run_id: str = "r_1") -> None:
        columns, _ = resolve_columns(None, measures_by_plugin)
        self.records: list[tuple[str, dict[str, Any]]] = []
        super().__init__(run_id, columns, lambda kind, fields: self.records.append((kind, fields)))

    @property
    def values(self) -> dict[str, MeasureValue]:
        """The values published so far, by column."""
        return {name: published.value for name, published in self.measures.items()}


class FakeLinks:
    """What a test has stand in for the links of a robot; plugins get them as they would get real ones.

    Args:
        robot: for `connect_robot`.
        serial: for `open_serial_line`.
        host: for `connect_host`.
        namespace: the robot's.

    Example:
        >>> from robot_runner.testing import FakeClock, FakeHostLink
        >>> links = FakeLinks(host=FakeHostLink(FakeClock()))
    """

    def __init__(
        self,
        *,
        robot: RobotLink | None = None,
        serial: SerialLine | None = None,
        host: HostLink | None = None,
        namespace: str = "",
    ) -> None:
        key = namespace.strip("/") or "/"
        named = {f"robot {key}": robot, f"serial {key}": serial, f"host {key}": host}
        self._links: dict[str, Closable] = {name: link for name, link in named.items() if link is not None}

    def plant(self, resources: Resources) -> None:
        """Have the run find these links opened already."""
        resources.open("simulation", _NoSimulation)
        for key, link in self._links.items():
            resources.open(key, partial(_itself, link))


def _itself(link: Closable) -> Closable:
    return link


class _NoSimulation:
    """Stands where the simulation of a run would be, so that none is started."""

    def close(self) -> None:
        """Do nothing."""


def make_context(
    folder: Path,
    *plugins: Plugin,
    robot: str | None = SIMULATED,
    links: FakeLinks | None = None,
    clock: Clock | None = None,
    combination: Mapping[str, Any] | None = None,
    run_seed: int = 1,
) -> RobotRunnerContext:
    """Return the context of a run for the first of `plugins`; `context_for` makes those of the others.

    The measures that the plugins declare are the only ones that can be published. Close `context.resources`
    when done, as the end of a run does.

    Args:
        folder: where the run's folder is made, such as pytest's `tmp_path`.
        plugins: the plugins of the experiment; without any, the context is the config's.
        robot: how the robot is reached.
        links: stand in for the robot's links; without them the embedded robot is used, where `robot` names it.
        clock: the run's clock; left out, a `FakeClock` where `links` are given, else that of the robot.
        combination: the treatment of each factor.
        run_seed: the seed of the run.

    Raises:
        LinkError: `robot` cannot be reached.

    Example:
        >>> from pathlib import Path
        >>> context = make_context(Path("unused"), robot=None, combination={"Task": "Video"})
        >>> context.owner, context.combination["Task"]
        ('config', 'Video')
    """
    resources = Resources()
    if links is not None:
        links.plant(resources)
    elif clock is None and robot is not None:
        clock = open_clock(robot, resources, seed=run_seed)
    return RobotRunnerContext(
        experiment_name="test",
        experiment_folder=folder,
        robot=robot,
        run_id="r_1",
        run_number=1,
        run_count=1,
        attempt=1,
        combination=combination or {},
        repetition=1,
        run_seed=run_seed,
        run_path=folder / "runs" / "r_1",
        clock=clock or FakeClock(),
        resources=resources,
        owner=plugins[0].name if plugins else CONFIG_OWNER,
        broker=RecordingBroker({plugin.name: plugin.measures for plugin in plugins}),
    )


def context_for(plugin: Plugin, context: RobotRunnerContext) -> RobotRunnerContext:
    """Return the same run's context for another plugin."""
    return replace(context, owner=plugin.name)
