"""What holds for every profiler, as tests for its author to inherit."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

from robot_runner.events.event import RobotRunnerEvents
from robot_runner.plugins.api.plugin import Profiler
from robot_runner.testing.plugin_contract import PluginContract, require

if TYPE_CHECKING:
    from pathlib import Path

    from robot_runner.events.context import RobotRunnerContext

__all__ = ["ProfilerContract"]


class ProfilerContract(PluginContract):
    """The facts that a profiler must keep to; pytest finds them in a subclass whose name begins with `Test`.

    Attributes:
        measuring_seconds: how long each run measures, s on the run's clock.

    Example:
        >>> from robot_runner.plugins.profilers import PsUtil
        >>> from robot_runner.testing import ProfilerContract
        >>> class TestPsUtil(ProfilerContract):
        ...     measuring_seconds = 2.0
        ...     def make_plugin(self):
        ...         return PsUtil(rate_hz=20.0)
    """

    measuring_seconds: ClassVar[float] = 1.0

    def mission(self, context: RobotRunnerContext) -> None:
        """Let time go by."""
        context.clock.sleep(self.measuring_seconds)

    def test_it_is_a_profiler(self) -> None:
        """Hold that it derives from `Profiler`, so that it hears events after the systems."""
        plugin = self.make_plugin()
        require(isinstance(plugin, Profiler), f"{plugin!r} does not derive from Profiler")

    def test_a_run_that_never_measured_is_closed(self, tmp_path: Path) -> None:
        """Hold that a run that fails before its measurement can be closed."""
        with self.rehearsal(tmp_path, self.make_plugin()) as (_, rehearsal):
            rehearsal.emit(RobotRunnerEvents.START_RUN)
            rehearsal.emit(RobotRunnerEvents.STOP_RUN)

    def test_a_measurement_of_no_length_does_no_harm(self, tmp_path: Path) -> None:
        """Hold that a mission that fails at once leaves a value or None, and no exception."""
        with self.rehearsal(tmp_path, self.make_plugin()) as (context, rehearsal):
            rehearsal.execute(lambda: None)
            declared = {measure.name for measure in self.make_plugin().measures}
            require(declared <= set(context.measures), f"it published {sorted(context.measures)} only")
