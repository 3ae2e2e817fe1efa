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
        ("speed_km_h", "speed_km_h", None),
        ("throughput_MB_s", "throughput_MB_s", None),
        ("use_kwh_km", "use_kwh_km", None),
        ("use_J_km", "use_J_km", None),
        ("charge_A_h", "charge_A_h", None),
        ("received_bytes_s", "received_bytes_s", None),
        ("tokens_s", "tokens_s", None),
        ("torque_N_m", "torque_N_m", None),
        ("position_N_m", "position_N", "m"),
        ("lap_A_s", "lap_A", "s"),
        ("power_at_500_rpm_W", "power_at_500_rpm", "W"),
        ("latency_at_10_Hz_s", "latency_at_10_Hz", "s"),
        ("time_per_frame_s", "time_per_frame", "s"),
        ("fan_rpm_percent", "fan_rpm", "%"),
        ("power_avg_W", "power_avg", "W"),
        ("motor_temp_C", "motor_temp", "degC"),
        ("vitamin_C", "vitamin_C", None),
        ("attempt_C", "attempt_C", None),
        ("template (C)", "template (C)", None),
        ("temp_rise_C", "temp_rise_C", None),
        ("temp_C_std", "temp_C_std", None),
        ("TempRise (°C)", "TempRise (°C)", None),
        ("sunrise_temp_C", "sunrise_temp", "degC"),
        ("Delta T (degC)", "Delta T (degC)", None),
        ("misses_percent", "misses", "%"),
        ("temperature °C", "temperature", "degC"),
        ("cpu_energy_j", "cpu_energy", "J"),
        ("cpu_power_w", "cpu_power", "W"),
        ("orientation_w", "orientation_w", None),
        ("memory_mb", "memory", "MB"),
        ("cpu_util", "cpu_util", None),
        ("mem_usage", "mem_usage", None),
        ("_s", "_s", None),
        ("time(s)", "time", "s"),
        ("Core(s)", "Core(s)", None),
        ("Dauer (s)", "Dauer", "s"),
        ("Laufzeit[s]", "Laufzeit", "s"),
        ("cpu (%)", "cpu", "%"),
        ("cpu_usage [avg %]", "cpu_usage", "%"),
        ("Battery Power* [uW] (Delta)", "Battery Power* (Delta)", "uW"),
        ("Peak_Memory_KB_RSS", "Peak_Memory_RSS", "KB"),
        ("energy_kJ_per_km", "energy", "kJ/km"),
        ("Throughput (ops/sec)", "Throughput", "ops/sec"),
        ("Total Energy (Watt⋅sec)", "Total Energy", "Watt⋅sec"),
        ("Energy Consumption (Joule)", "Energy Consumption", "J"),
        ("Joules", "Joules", "J"),
        ("estimated_CO2_kg", "estimated_CO2", "kg"),
        ("latency_min", "latency_min", None),
        ("time (min)", "time", "min"),
        ("time (m)", "time (m)", None),
        ("temp [C]", "temp", "degC"),
        ("Battery Temperature [1/10 C]", "Battery Temperature [1/10 C]", None),
        ("power [10 mW]", "power [10 mW]", None),
        ("energy (x1000 J)", "energy (x1000 J)", None),
        ("var_energy_J", "var_energy_J", None),
        ("Carbon intensity (gCO2/kWh)", "Carbon intensity (gCO2/kWh)", None),
        ("power (min)", "power (min)", None),
        ("accel_x (g)", "accel_x (g)", None),
        ("acc_x_g", "acc_x_g", None),
        ("mass (g)", "mass", "g"),
        ("light (a.u.)", "light (a.u.)", None),
        ("x (base link)", "x (base link)", None),
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


@pytest.mark.parametrize(
    ("written", "si", "value", "converted"),
    [
        ("mWh", "J", 2.0, 7.2),
        ("°C", "K", 20.0, 293.15),
        ("count/s", "1/s", 3.0, 3.0),
        ("fps", "1/s", 30.0, 30.0),
        ("MiB", "B", 1.0, 1048576.0),
        ("kB/s", "B/s", 2.0, 2000.0),
        ("J/m", "J/m", 2.0, 2.0),
        ("kJ/km", "J/m", 2.0, 2.0),
        ("W*h", "J", 1.0, 3600.0),
        ("N*m", "N*m", 2.0, 2.0),
        ("m/s^2", "m/s^2", 9.8, 9.8),
        ("rpm", "rad/s", 60.0, 6.283185307179586),
        ("mAh", "C", 1000.0, 3600.0),
        ("Nm", "N*m", 2.0, 2.0),
        ("mNm", "N*m", 2.0, 0.002),
        ("px", "pixel", 2.0, 2.0),
        ("cycles", "1", 2.0, 2.0),
        ("points/s", "1/s", 2.0, 2.0),
        ("%", "%", 12.5, 12.5),
    ],
)
def test_units_are_converted_part_by_part(written, si, value, converted):
    unit = unit_of(written)
    assert unit.si == si
    assert unit.to_si(value) == pytest.approx(converted)


NO_UNITS = ["", "2", "C", "G", "foo", "dBm", "J + W", "avg %", "joules/mission", "__import__('os')"]
NO_UNITS += ["a.u.", "N/A", "units", "unit/s", "db", "link", "hand", "pin", "pi", "pp", "EU"]


#: The first would be computed for years, the next lie beyond what a float can hold, or are 0 there.
NO_UNITS += ["s^9^9^9", "s³³³³", "(s^9)^9^9", "km^999", "kW^99", "mm^999", "m^1e9", "Ym^9*Ym^9", "qm^9*qm^9"]


@pytest.mark.parametrize("text", NO_UNITS)
def test_what_is_no_unit_or_could_be_several_is_none(text):
    assert unit_of(text) is None


def test_powers_of_one_digit_are_read():
    assert [unit_of(text).si for text in ("m/s^2", "V²", "Hz^(1/2)", "m**2")] == ["m/s^2", "V^2", "Hz^0.5", "m^2"]


@pytest.mark.parametrize("heading", ["Speed ( )", "Speed [\t]", "Speed [ ] (x)"])
def test_empty_brackets_are_no_unit(heading):
    assert split_heading(heading) == (heading, None)


@given(st.sampled_from(known_units()), st.floats(-1e9, 1e9))
def test_an_array_is_converted_as_a_number_is(symbol, value):
    unit = unit_of(symbol)
    assert unit.to_si(np.array([value]))[0] == unit.to_si(value)


def test_headings_in_si_say_so():
    assert si_heading("power_mW", unit_of("mW")) == "power_W"
    assert si_heading("cpu", unit_of("%")) == "cpu_percent"
    assert si_heading("count", unit_of("1")) == "count"
    assert si_heading("energy [kJ/km]", unit_of("kJ/km")) == "energy_J_per_m"
    assert si_heading(" as is ", None) == "as is"
