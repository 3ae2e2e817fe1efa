"""Units as people write them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot_runner.analysis.importing.units import known_units, si_heading, split_heading, unit_of


@pytest.mark.parametrize(
    ("heading", "base", "symbol"),
    [
        ("power_mW", "power", "mW"),
        ("PACKAGE_ENERGY (J)", "PACKAGE_ENERGY", "J"),
        ("Voltage [V]", "Voltage", "V"),
        ("speed_m_s", "speed", "m/s"),
        ("misses_percent", "misses", "%"),
        ("temperature °C", "temperature", "degC"),
        ("cpu_energy_j", "cpu_energy", "J"),
        ("cpu_power_w", "cpu_power", "W"),
        ("orientation_w", "orientation_w", None),
        ("memory_mb", "memory", "MB"),
        ("cpu_util", "cpu_util", None),
        ("mem_usage", "mem_usage", None),
        ("_s", "_s", None),
    ],
)
def test_headings_are_split(heading, base, symbol):
    found, unit = split_heading(heading)
    assert (found, unit.symbol if unit else None) == (base, symbol)


@pytest.mark.parametrize(
    ("unit", "value", "si"),
    [("mW", 27146.0, 27.146), ("ms", 14.849, 0.014849), ("kWh", 1.0, 3.6e6), ("degC", 21.5, 294.65), ("MB", 2, 2e6)],
)
def test_values_in_si_are_rounded_once(unit, value, si):
    assert unit_of(unit).to_si(value) == si


@given(st.sampled_from(known_units()), st.floats(-1e9, 1e9))
def test_an_array_is_converted_as_a_number_is(symbol, value):
    unit = unit_of(symbol)
    assert unit.to_si(np.array([value]))[0] == unit.to_si(value)


def test_headings_in_si_say_so():
    assert si_heading("power_mW", unit_of("mW")) == "power_W"
    assert si_heading("cpu", unit_of("%")) == "cpu_percent"
    assert si_heading("count", unit_of("1")) == "count"
    assert si_heading(" as is ", None) == "as is"
