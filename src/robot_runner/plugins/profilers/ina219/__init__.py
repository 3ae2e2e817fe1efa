"""The power meter: an INA219 sensor behind a microcontroller, on a serial line or a card, or behind a kernel driver."""

from robot_runner.plugins.profilers.ina219.card import CardRecording, read_card
from robot_runner.plugins.profilers.ina219.profiler import Ina219

__all__ = ["CardRecording", "Ina219", "read_card"]
