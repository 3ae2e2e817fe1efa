"""The two kinds of plugin and what validation asks them."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar

from robot_runner.errors import PluginError

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from robot_runner.errors import Finding
    from robot_runner.events.context import RobotRunnerContext
    from robot_runner.events.measure import Measure

__all__ = ["Circumstances", "Plugin", "Profiler", "System"]

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}")
_RESERVED_NAMES = frozenset({"config", "log"})


@dataclass(frozen=True, slots=True)
class Circumstances:
    """What a plugin's check may look at, before anything is executed.

    Attributes:
        robot: how the robot is to be reached, such as `"simulated"`, or None.
        factors: the treatments of each factor, by the factor's name.
        plugins: all plugins of the experiment, the one that is asked included.
    """

    robot: str | None = None
    factors: Mapping[str, Sequence[Any]] = field(default_factory=dict)
    plugins: Sequence[Plugin] = ()


class Plugin:
    """What systems and profilers share. A method named like an event hears that event and gets its context.

    Attributes:
        measures: what each run yields through this plugin; an instance may have others than its class, where they
            depend on its parameters (one for each domain, column or process).
        needs: one sentence: what must be there for it to work.
        bytes_per_run: about how much raw data it keeps of a run, so that a disk that is too small is found beforehand.
        name: tells instances of one kind apart; names the plugin's raw-data folder.
    """

    measures: Sequence[Measure] = ()
    needs: ClassVar[str] = ""
    bytes_per_run: int = 0

    def __init__(self, *, name: str | None = None) -> None:
        chosen = type(self).__name__ if name is None else name
        if not isinstance(chosen, str) or not _NAME.fullmatch(chosen) or chosen in _RESERVED_NAMES:
            raise PluginError(
                f"a plugin cannot be named {chosen!r}",
                where=type(self).__name__,
                fix="Use letters, digits, '_' and '-' (64 at most); 'config' and 'log' are taken.",
            )
        self.name = chosen

    def check(self, circumstances: Circumstances) -> Iterable[Finding]:
        """Return what stands in the way of using this plugin; nothing is changed by asking."""
        del circumstances
        return ()


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
        """Stop whatever moves. Called after a failed run, once its closing events were heard; may be called twice."""


class Profiler(Plugin):
    """A plugin that measures between `start_measurement` and `stop_measurement`.

    It publishes its measures in `populate_run_data` and keeps raw samples in `context.raw_data_folder`.
    """
