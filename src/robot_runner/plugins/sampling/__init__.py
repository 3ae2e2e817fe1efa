"""Help for profilers: the measured window, integration over real time stamps, and the quality of samples."""

from robot_runner.plugins.sampling.device_clock import ClockMap, fit_clock
from robot_runner.plugins.sampling.integration import (
    energy,
    energy_from_mean_power,
    integrate,
    mean,
    mean_of_intervals,
)
from robot_runner.plugins.sampling.periodic import PeriodicSampler, Sampling
from robot_runner.plugins.sampling.quality import Jitter, SampleQuality, quality_of
from robot_runner.plugins.sampling.raw_files import Column, write_quality, write_samples
from robot_runner.plugins.sampling.reporting import report_quality
from robot_runner.plugins.sampling.series import Series
from robot_runner.plugins.sampling.window import Window, cut

__all__ = [
    "ClockMap",
    "Column",
    "Jitter",
    "PeriodicSampler",
    "SampleQuality",
    "Sampling",
    "Series",
    "Window",
    "cut",
    "energy",
    "energy_from_mean_power",
    "fit_clock",
    "integrate",
    "mean",
    "mean_of_intervals",
    "quality_of",
    "report_quality",
    "write_quality",
    "write_samples",
]
