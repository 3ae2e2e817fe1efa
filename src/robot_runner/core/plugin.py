"""What a plugin is, what validation asks it, and which are installed: found by entry points, without being imported."""

from __future__ import annotations

import logging
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, ClassVar

from robot_runner.core.entry_points import EntryPoint, entry_points, named_entry_point
from robot_runner.core.errors import Finding, PluginError, did_you_mean
from robot_runner.core.events.context import RobotRunnerContext
from robot_runner.core.events.measure import Measure, Origin
from robot_runner.core.links.graph_names import GraphNeed
from robot_runner.core.storage.input_files import InputFile
from robot_runner.core.treatments import Bindable

_log = logging.getLogger(__name__)

#: The claim of who measures the computer that executes the run, or keeps it busy: no other run beside it.
THIS_MACHINE = "host:localhost"

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}")
_RESERVED_NAMES = frozenset({"config", "log", "operator", "robots"})


@dataclass(frozen=True, slots=True)
class Circumstances:
    """What a plugin's check may look at, before anything is executed.

    Attributes:
        robot: how the robot is to be reached, such as `"simulated"`, or None.
        factors: the treatments of each factor, by the factor's name.
        plugins: all plugins of the experiment, the one that is asked included.
        listed: the names of all plugins in the order in which the config lists them; those that cannot be built, and
            are not among `plugins`, stand last.
        robots: how each of several robots that take turns is reached; nothing where there is one.
    """

    robot: str | None = None
    factors: Mapping[str, Sequence[Any]] = field(default_factory=dict)
    plugins: Sequence[Plugin] = ()
    listed: Sequence[str] = ()
    robots: Sequence[str] = ()

    def before(self, plugin: Plugin) -> list[Plugin]:
        """Return the plugins that are listed before one, whose event callbacks are called before its own."""
        names = list(self.listed) or [each.name for each in self.plugins]
        earlier = names[: names.index(plugin.name)] if plugin.name in names else []
        return [each for each in self.plugins if each.name in earlier]


class Plugin(Bindable):
    """What systems and profilers share. A method named like an event is called at it and gets its context.

    Attributes:
        measures: what each run yields through this plugin; an instance may have others than its class, where they
            depend on its parameters (one for each domain, column or process).
        needs: one sentence: what must be there for it to work.
        bytes_per_run: about how much raw data it keeps of a run, so that a disk that is too small is found beforehand.
        smoke_parameters: what it may be made with for a smoke test, where that is less than what it is made with: a
            mission that is shorter, and otherwise the same.
        starts_nodes: whether it starts nodes of the robot's graph, so that what others need there may come with it.
        name: tells instances of one kind apart; names the plugin's raw-data folder.
    """

    measures: Sequence[Measure] = ()
    needs: ClassVar[str] = ""
    bytes_per_run: int = 0
    smoke_parameters: ClassVar[Mapping[str, float]] = MappingProxyType({})
    starts_nodes: bool = False

    def __init__(self, *, name: str | None = None) -> None:
        self.name = type(self).__name__ if name is None else name
        if refused := refused_name(self):
            raise refused

    def check(self, circumstances: Circumstances) -> Iterable[Finding]:
        """Return what stands in the way of using this plugin; nothing is changed by asking."""
        del circumstances
        return ()

    def required_graph(self, circumstances: Circumstances) -> Iterable[GraphNeed]:
        """Return what must be on the robot's graph before a run: topics, services and actions, by name and type.

        `robot-runner check`, and each execution before its first run, look whether it is there. Names are relative to
        the robot's namespace: the plugin's attribute `namespace`, where it has one.

        Example:
            >>> class Gripper(System):
            ...     def required_graph(self, circumstances):
            ...         yield GraphNeed.service("gripper/close", "std_srvs/Trigger", fix="Start the gripper's driver.")
        """
        del circumstances
        return ()

    def input_files(self) -> Iterable[InputFile]:
        """Return the files that this plugin reads, as it was given them: a replication needs them.

        They are kept with the experiment and go into its package; `robot_runner.plugins.input_file` finds them there.

        Example:
            >>> class Map(System):
            ...     def input_files(self):
            ...         yield InputFile(self.path)
        """
        return ()

    def duration_s(self, combination: Mapping[str, Any]) -> float | None:
        """Return how long this plugin's part of a run takes, s of real time; None where that is not known.

        What all plugins of an experiment say adds up, so that each counts what it does itself: a mission, or the time
        that a device needs to settle. A config may have a method of this name, too.

        Args:
            combination: the treatment of each factor; parameters that are bound to factors have their values already.
        """
        del combination
        return None

    def claims(self, robot: str | None) -> Iterable[str]:
        """Return what a run needs for itself because of this plugin: two runs with the same claim never overlap.

        A plugin that does not say claims the whole machine, so that nothing spoils its numbers without being declared.
        The robot of the experiment, and the hosts that it names, are claimed by the experiment itself.

        Args:
            robot: how the run's robot is reached, such as `"simulated"`, or None.

        Returns:
            texts such as `host:localhost` (this machine's processor, memory or energy), `host:pi@robot`,
            `serial:/dev/ttyUSB0`, `device:camera 0`; none where any number of such runs may go on side by side.

        Example:
            >>> class Scale(Profiler):
            ...     def claims(self, robot):
            ...         return ["serial:/dev/ttyUSB1"]
        """
        del robot
        return (THIS_MACHINE,)

    @property
    def knows_duration(self) -> bool:
        """Whether this kind of plugin has something to say of how long a run takes."""
        return type(self).duration_s is not Plugin.duration_s


def refused_name(plugin: Plugin) -> PluginError | None:
    """Return why a plugin's name is refused, or is missing because its `__init__` did not call that of its base.

    Example:
        >>> refused_name(System(name="Lamp")) is None
        True
    """
    where, name = type(plugin).__name__, getattr(plugin, "name", None)
    if name is None:
        fix = "Call super().__init__(name=name) in its __init__; in __post_init__ of a dataclass."
        return PluginError("the plugin has no name", where=where, fix=fix)
    if isinstance(name, str) and _NAME.fullmatch(name) and name not in _RESERVED_NAMES:
        return None
    fix = "Use letters, digits, '_' and '-' (64 at most); 'config' and 'log' are taken."
    return PluginError(f"a plugin cannot be named {name!r}", where=where, fix=fix)


class System(Plugin):
    """A plugin that operates a robot.

    Example:
        >>> class Lamp(System):
        ...     def launch_mission(self, context):
        ...         context.share(lamp="on")
        >>> Lamp(name="desk").name
        'desk'
    """

    def make_safe(self, context: RobotRunnerContext) -> None:
        """Stop whatever moves. Called after a failed run, once its closing events are over; may be called twice.

        Where the run's process died, it is called in another one, which was not connected before but for `stand_by`.
        """

    def stand_by(self, context: RobotRunnerContext) -> None:
        """Get ready for `make_safe` in the process that calls it should the run die; called while the run executes.

        Open what takes long to open, and move, publish and measure nothing. What is raised here is passed over:
        `make_safe` is called all the same, with nothing opened.
        """


class Profiler(Plugin):
    """A plugin that measures between `start_measurement` and `stop_measurement`.

    It publishes its measures in `populate_run_data` and keeps raw samples in `context.raw_data_folder`.

    Attributes:
        probe_s: how long it is tried before the first run, s of real time, by its own callbacks and without a mission;
            None for one that can tell nothing without the mission, or that only has totals.
        not_probed: measures that it cannot know then, such as those of software that only a run starts.
    """

    #: Five readings at 10 Hz, and a hundred of a power meter: enough to know whether it speaks.
    probe_s: float | None = 0.5
    not_probed: Sequence[str] = ()


#: How many readings a probe is to see.
_PROBED_READINGS = 3
#: A user does not wait longer than this for a probe, s.
_LONGEST_PROBE = 10.0


def probe_window(rate_hz: float) -> float | None:
    """Return how long a profiler of this rate is to be probed, s; None where that takes too long.

    Example:
        >>> probe_window(200.0), probe_window(1.0), probe_window(0.1)
        (0.5, 3.0, None)
    """
    seconds = max(0.5, _PROBED_READINGS / rate_hz)
    return seconds if seconds <= _LONGEST_PROBE else None


#: The entry-point group of each kind of plugin, and the class that a plugin of that kind derives from.
GROUPS: dict[str, type[Plugin]] = {"systems": System, "profilers": Profiler}


def usual_origin(plugin: Plugin | None, *, is_simulated: bool) -> Origin:
    """Return where values come from of which nothing is said: those of a simulated robot never pass for measured.

    Args:
        plugin: that publishes them; None for the config. A profiler may measure something else beside the robot.
        is_simulated: whether the robot is.
    """
    is_of_robot = plugin is None or isinstance(plugin, System)
    return Origin.SIMULATED if is_simulated and is_of_robot else Origin.MEASURED


def load_plugin(point: EntryPoint) -> type[Plugin]:
    """Import the class of an installed plugin.

    Raises:
        PluginError: the import fails, or what it finds is no plugin of its kind.
    """
    found: Any = point.load()
    expected = GROUPS[point.kind]
    if not (isinstance(found, type) and issubclass(found, expected)):
        fix = f"Derive it from robot_runner.plugins.{expected.__name__}."
        raise PluginError(f"{found!r} is no {expected.__name__}", where=point.where, fix=fix)
    return found


def with_parts(plugins: Iterable[object], seen: tuple[object, ...] = ()) -> Iterator[Plugin]:
    """Yield plugins, each before those that it is made of, as systems are whose missions go on together."""
    for plugin in plugins:
        if not isinstance(plugin, Plugin) or any(plugin is each for each in seen):
            continue
        yield plugin
        for value in vars(plugin).values():
            yield from with_parts(value if isinstance(value, tuple | list) else (value,), (*seen, plugin))


def installed_plugins(kind: str | None = None) -> tuple[EntryPoint, ...]:
    """Return what is installed, our own first, sorted by kind and name; `kind` keeps it to `systems` or `profilers`."""
    return tuple(point for each in (GROUPS if kind is None else (kind,)) for point in entry_points(each))


def find_plugin(kind: str, name: str) -> type[Plugin]:
    """Return the class of the installed plugin of this kind and name.

    Raises:
        PluginError: none has this name; the nearest is named. Or it cannot be used.
    """
    point = named_entry_point(kind, name)
    if point is None:
        fix = did_you_mean(name, [each.name for each in installed_plugins(kind)])
        raise PluginError(f"no plugin named {name!r} is installed", where=f"plugins.{kind}.{name}", fix=fix)
    return load_plugin(point)


def described_circumstances() -> dict[str, Any]:
    """Return what packages add to a manifest of the circumstances, by the name of each: plain data, or None.

    Each is a function without parameters, announced in the group `robot_runner.circumstances`. One that fails is
    logged and left out: an experiment is worth more than its description.
    """
    described: dict[str, Any] = {}
    for point in entry_points("circumstances"):
        try:
            described.setdefault(point.name, point.load()())
        except Exception as error:  # noqa: BLE001 - a stranger's code
            _log.warning("%s: the circumstances cannot be described: %s", point.where, error)
    return described
