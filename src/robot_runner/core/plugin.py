"""The base classes of plugins, and finding installed ones by entry points, without importing them."""

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
from robot_runner.core.words import enumerated

_log = logging.getLogger(__name__)

#: The claim of a plugin that measures the computer that executes the run, or keeps it busy.
THIS_MACHINE = "host:localhost"

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}")
_RESERVED_NAMES = frozenset({"config", "log", "operator", "robots"})


@dataclass(frozen=True, slots=True)
class Circumstances:
    """What a plugin's check may look at, before anything is executed.

    Attributes:
        robot: how the robot is reached, such as `"simulated"`, or None.
        factors: the treatments of each factor, by the factor's name.
        plugins: all plugins of the experiment, the checked one included.
        listed: the names of all plugins in the order of the config; those that cannot be built, and are not among
            `plugins`, come last.
        robots: how each of several robots that take turns is reached; empty for one robot.
        has_run_table: whether there is a run table; where it could not be made, nothing is known of its factors.
    """

    robot: str | None = None
    factors: Mapping[str, Sequence[Any]] = field(default_factory=dict)
    plugins: Sequence[Plugin] = ()
    listed: Sequence[str] = ()
    robots: Sequence[str] = ()
    has_run_table: bool = True

    def before(self, plugin: Plugin) -> list[Plugin]:
        """Return the plugins that are listed before one, whose event callbacks are called before its own."""
        names = list(self.listed) or [each.name for each in self.plugins]
        earlier = names[: names.index(plugin.name)] if plugin.name in names else []
        return [each for each in self.plugins if each.name in earlier]


class Plugin(Bindable):
    """The base of systems and profilers. A method named like an event is its callback, and gets its context.

    Attributes:
        measures: what each run yields through this plugin; those of an instance may depend on its parameters (one for
            each domain, column or process).
        needs: in one sentence, what it needs to work.
        bytes_per_run: about how much raw data it keeps of a run, so that a full disk is noticed beforehand.
        smoke_parameters: parameters for a smoke test, where these are smaller than the given ones: a shorter mission
            that is otherwise the same.
        starts_nodes: whether it starts nodes of the robot's graph, which others may need.
        is_for_all_runs: whether runs need what its `before_experiment` sets up on this machine; workers of a cluster
            lack it.
        name: unique among the plugins of an experiment; names the plugin's raw-data folder.
    """

    measures: Sequence[Measure] = ()
    needs: ClassVar[str] = ""
    bytes_per_run: int = 0
    smoke_parameters: ClassVar[Mapping[str, float]] = MappingProxyType({})
    starts_nodes: bool = False
    is_for_all_runs: bool = False

    def __init__(self, *, name: str | None = None) -> None:
        self.name = type(self).__name__ if name is None else name
        if refused := refused_name(self):
            raise refused

    def __repr__(self) -> str:
        return f"{type(self).__name__}(...)"  # without an address, as messages show it

    def check(self, circumstances: Circumstances) -> Iterable[Finding]:
        """Return findings on why this plugin cannot be used, without changing anything."""
        del circumstances
        return ()

    def required_graph(self, circumstances: Circumstances) -> Iterable[GraphNeed]:
        """Return what must be on the robot's graph before a run: topics, services and actions, by name and type.

        `robot-runner check`, and each execution before its first run, check that it is there. Names are relative to the
        robot's namespace: the plugin's attribute `namespace`, if it has one.

        Example:
            >>> from robot_runner.plugins import System
            >>> class Gripper(System):
            ...     def required_graph(self, circumstances):
            ...         yield GraphNeed.service("gripper/close", "std_srvs/Trigger", fix="Start the gripper's driver.")
        """
        del circumstances
        return ()

    def input_files(self) -> Iterable[InputFile]:
        """Return the files that this plugin reads, by the given paths: a replication needs them.

        They are kept with the experiment and are part of its package; `robot_runner.plugins.input_file` finds them.

        Example:
            >>> from robot_runner.plugins import System
            >>> class Map(System):
            ...     def input_files(self):
            ...         yield InputFile(self.path)
        """
        return ()

    def duration_s(self, combination: Mapping[str, Any]) -> float | None:
        """Return how long this plugin's part of a run takes, s of real time; None where that is not known.

        The times of all plugins are added up, so that each counts only its own part: a mission, or the time that a
        device needs to settle. A config may have a method of this name, too.

        Args:
            combination: the treatment of each factor; parameters that are bound to factors have their values already.
        """
        del combination
        return None

    def claims(self, robot: str | None) -> Iterable[str]:
        """Return what a run needs for itself because of this plugin: two runs with the same claim never overlap.

        By default a plugin claims the whole machine, so that nothing disturbs its numbers unless it is declared. The
        experiment itself claims its robot and its hosts.

        Args:
            robot: how the run's robot is reached, such as `"simulated"`, or None.

        Returns:
            texts such as `host:localhost` (this machine's processor, memory or energy), `host:pi@robot`,
            `serial:/dev/ttyUSB0`, `device:camera 0`; none where any number of such runs may go on side by side.

        Example:
            >>> from robot_runner.plugins import Profiler
            >>> class Scale(Profiler):
            ...     def claims(self, robot):
            ...         return ["serial:/dev/ttyUSB1"]
        """
        del robot
        return (THIS_MACHINE,)

    @property
    def knows_duration(self) -> bool:
        """Whether this kind of plugin overrides `duration_s`."""
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
    fix = f"Use letters, digits, '_' and '-' (64 at most); {enumerated(map(repr, sorted(_RESERVED_NAMES)))} are taken."
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

        Where the run's process died, it is called in another one, in which only `stand_by` has opened anything.
        """

    def stand_by(self, context: RobotRunnerContext) -> None:
        """Prepare `make_safe` in the process that calls it should the run die; called while the run executes.

        Open what takes long to open, and move, publish and measure nothing. Exceptions are ignored: `make_safe` is
        called all the same.
        """


class Profiler(Plugin):
    """A plugin that measures between `start_measurement` and `stop_measurement`.

    It publishes its measures in `populate_run_data` and keeps raw samples in `context.raw_data_folder`.

    Attributes:
        probe_s: how long it is tried before the first run, s of real time, by its own callbacks and without a mission;
            None for one that cannot measure without the mission, or that only has totals.
        not_probed: measures that have no value then, such as those of software that only a run starts.
    """

    #: Five readings at 10 Hz, and a hundred of a power meter: enough to know whether it works.
    probe_s: float | None = 0.5
    not_probed: Sequence[str] = ()


#: How many readings a probe should have.
_PROBED_READINGS = 3
#: The longest window of a probe, s.
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
    """Return the default origin of values: with a simulated robot, those of systems and of the config are simulated.

    `plugin` publishes them; None is the config. A profiler may measure something else than the robot.
    """
    is_of_robot = plugin is None or isinstance(plugin, System)
    return Origin.SIMULATED if is_simulated and is_of_robot else Origin.MEASURED


def load_plugin(point: EntryPoint) -> type[Plugin]:
    """Import the class of an installed plugin.

    Raises:
        PluginError: the import fails, or the object is not a plugin of its kind.
    """
    found: Any = point.load()
    expected = GROUPS[point.kind]
    if not (isinstance(found, type) and issubclass(found, expected)):
        fix = f"Derive it from robot_runner.plugins.{expected.__name__}."
        raise PluginError(f"{found!r} is not a {expected.__name__}", where=point.where, fix=fix)
    return found


def with_parts(plugins: Iterable[object], seen: tuple[object, ...] = ()) -> Iterator[Plugin]:
    """Yield plugins, each followed by the plugins that it contains, as a system of joint missions does."""
    for plugin in plugins:
        if not isinstance(plugin, Plugin) or any(plugin is each for each in seen):
            continue
        yield plugin
        for value in vars(plugin).values():
            yield from with_parts(value if isinstance(value, tuple | list) else (value,), (*seen, plugin))


def installed_plugins(kind: str | None = None) -> tuple[EntryPoint, ...]:
    """Return the installed plugins (with `kind`, only `systems` or `profilers`), our own first, by kind and name."""
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
    """Return what packages add to a manifest, by the name of the entry point: plain data, or None.

    Each is a function without parameters in the group `robot_runner.circumstances`. One that fails is logged and left
    out, so that it does not prevent the experiment.
    """
    described: dict[str, Any] = {}
    for point in entry_points("circumstances"):
        try:
            described.setdefault(point.name, point.load()())
        except (Exception, SystemExit) as error:  # noqa: BLE001 - a stranger's code
            raised = type(error).__name__
            _log.warning("%s: the circumstances cannot be described: %s: %s", point.where, raised, error)
    return described
