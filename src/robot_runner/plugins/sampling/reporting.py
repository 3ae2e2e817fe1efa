"""What a profiler says about its own samples: kept with the raw data, and warned of where it is poor."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from robot_runner.plugins.sampling.raw_files import write_quality

if TYPE_CHECKING:
    from collections.abc import Mapping

    from robot_runner.events.context import RobotRunnerContext
    from robot_runner.plugins.sampling.quality import SampleQuality
    from robot_runner.plugins.sampling.window import Window

__all__ = ["report_quality"]

_FILE = "quality.json"
_FIX = "Look at the plugin's raw samples before you use this run."


def report_quality(
    context: RobotRunnerContext,
    quality: SampleQuality,
    window: Window,
    *,
    fix: str = _FIX,
    details: Mapping[str, Any] | None = None,
) -> bool:
    """Keep the quality in the raw-data folder as `quality.json`, warn of what is poor, and say whether it suffices.

    The warnings reach the end of the run, the journal, and the schema of the run table.

    Args:
        context: the run's.
        quality: of the samples.
        window: that they are about.
        fix: what the reader of a warning can do, in one sentence.
        details: plain facts to keep beside, such as the sensor's settings.

    Returns:
        Whether a value may be computed from the samples (`SampleQuality.is_sufficient`).
    """
    write_quality(context.raw_data_folder / _FILE, quality, window, details or {})
    for problem in quality.warnings():
        context.warn(problem, fix=fix)
    return quality.is_sufficient
