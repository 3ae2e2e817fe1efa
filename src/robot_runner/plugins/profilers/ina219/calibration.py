"""From the INA219's registers to volts, amperes and watts, on the host, so that raw data stay raw.

Source of all figures: Texas Instruments, INA219 data sheet SBOS448G, section 8.6.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable

__all__ = [
    "BUS_VOLT_PER_STEP",
    "POWER_ON_CONFIGURATION",
    "SHUNT_VOLT_PER_STEP",
    "Calibration",
    "Ranges",
]

#: One step of the shunt voltage register (0x01), V.
SHUNT_VOLT_PER_STEP = 10e-6
#: One step of the bus voltage register (0x02), V; the voltage stands in its bits 15 to 3.
BUS_VOLT_PER_STEP = 4e-3
#: The configuration of a sensor that was without power: 32 V, ±320 mV, single 12-bit conversions.
POWER_ON_CONFIGURATION = 0x399F

_BUS_SHIFT = 3
#: What the protocol promises where the device says nothing of itself: 16 V, ±320 mV, two conversions averaged.
_USUAL_CONFIGURATION = 0x1CCF


@dataclass(frozen=True, slots=True)
class Calibration:
    """What turns registers into currents.

    Attributes:
        shunt_ohm: resistance of the shunt, ohm; 0.1 on the common breakout boards.

    Example:
        >>> calibration = Calibration(shunt_ohm=0.1)
        >>> round(calibration.current(6130), 6), round(calibration.voltage(0x60E2), 6)
        (0.613, 12.4)
    """

    shunt_ohm: float = 0.1

    def current(self, shunt_raw: int) -> float:
        """Return the current through the shunt in amperes."""
        return shunt_raw * (SHUNT_VOLT_PER_STEP / self.shunt_ohm)

    def voltage(self, bus_raw: int) -> float:
        """Return the bus voltage behind the shunt in volts; the register's flags (bits 2 to 0) are ignored."""
        return (bus_raw >> _BUS_SHIFT) * BUS_VOLT_PER_STEP


@dataclass(frozen=True, slots=True)
class Ranges:
    """Where the registers end: a reading at the end may stand for more.

    Attributes:
        shunt: largest magnitude of the shunt voltage register.
        bus: largest voltage in the bus voltage register, in its steps.

    Example:
        >>> Ranges.of(0x1CCF)
        Ranges(shunt=32000, bus=4000)
    """

    shunt: int
    bus: int

    @classmethod
    def of(cls, configuration: int) -> Ranges:
        """Return the ranges that a configuration register sets; those of the protocol where it is 0, not known.

        The gain (bits 12 and 11) sets ±40, 80, 160 or 320 mV, bit 13 sets 16 or 32 V.
        """
        known = configuration or _USUAL_CONFIGURATION
        return cls(shunt=4000 << (known >> 11 & 3), bus=8000 if known & 0x2000 else 4000)

    def count_saturated(self, shunt_raw: Iterable[int], bus_raw: Iterable[int]) -> int:
        """Return how many samples have one of their readings at the end of its range."""
        pairs = zip(shunt_raw, bus_raw, strict=True)
        return sum(abs(shunt) >= self.shunt or bus >> _BUS_SHIFT >= self.bus for shunt, bus in pairs)
