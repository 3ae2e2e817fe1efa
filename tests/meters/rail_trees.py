"""Trees of /sys as Linux' drivers lay them out, in a folder of a test."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tests.meters.fake_sysfs import write

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

# NVIDIA Jetson Orin NX developer kit, JetPack 6: hwmon driver ina3221, labels of the device tree. in4 to in6 are
# the voltages of the shunts (uV), and curr4 is the sum that the driver adds.
JETSON_ORIN = {
    "name": "ina3221",
    "in1_label": "VDD_IN",
    "in1_input": "5000",
    "curr1_input": "1520",
    "in2_label": "VDD_CPU_GPU_CV",
    "in2_input": "5000",
    "curr2_input": "400",
    "in3_label": "VDD_SOC",
    "in3_input": "4992",
    "curr3_input": "250",
    "in4_input": "7600",
    "in5_input": "2000",
    "in6_input": "1250",
    "in7_input": "10850",
    "in7_label": "sum of shunt voltages",
    "curr4_input": "2170",
    "curr1_crit": "32760",
    "shunt1_resistor": "5000",
    "samples": "16",
}
# NVIDIA Jetson Nano and Xavier, JetPack 4: IIO driver ina3221x, values that are processed already.
JETSON_NANO = {
    "name": "ina3221x",
    "rail_name_0": "POM_5V_IN",
    "in_voltage0_input": "5104",
    "in_current0_input": "432",
    "in_power0_input": "2204",
    "in_power0_trigger_input": "2204",
    "rail_name_1": "POM_5V_GPU",
    "in_voltage1_input": "5104",
    "in_current1_input": "8",
    "in_power1_input": "40",
}
# The hwmon driver ina2xx, for which in0 is the voltage of the shunt.
INA226 = {
    "name": "ina226",
    "in0_input": "6",
    "in1_input": "12400",
    "curr1_input": "613",
    "power1_input": "7600000",
    "shunt_resistor": "10000",
    "update_interval": "34",
}
INA260 = {"name": "ina260", "in1_input": "12400", "curr1_input": "613", "power1_input": "7600000"}
# The hwmon driver ina238, which has an energy counter for an INA228.
INA238 = {
    "name": "ina238",
    "in0_input": "6",
    "in1_input": "12400",
    "curr1_input": "613",
    "power1_input": "7600000",
    "temp1_input": "31000",
    "shunt_resistor": "10000",
}
INA237 = {**INA238, "name": "ina237"}
INA228 = {**INA238, "name": "ina228", "energy1_input": "123456789"}
INA2XX = (INA226, INA260, INA237, INA238, INA228)
# The IIO driver ina2xx-adc: raw registers with a scale each; channel 0 is the voltage of the shunt.
INA226_IIO = {
    "name": "ina226",
    "in_voltage0_raw": "2452",
    "in_voltage0_scale": "0.002500000",
    "in_voltage1_raw": "9920",
    "in_voltage1_scale": "1.250000000",
    "in_power2_raw": "304",
    "in_power2_scale": "25.000000000",
    "in_current3_raw": "613",
    "in_current3_scale": "1.000000000",
    "in_shunt_resistor": "0.010000000",
    "in_sampling_frequency": "455",
}
# The IIO driver pac1934 with a shunt of 10 milliohm, whose channels have labels and energy counters. Its scales of
# power and energy are 11921 by the shunt in microohm: 3.2 V^2 at the end of both ranges by 2^28 steps, in uW and uJ.
PAC1934 = {
    "name": "pac1934",
    "in_voltage1_raw": "10240",
    "in_voltage1_scale": "0.488281250",
    "in_voltage1_label": "VBAT",
    "in_current1_raw": "6554",
    "in_current1_scale": "0.152500000",
    "in_power1_raw": "4194304",
    "in_power1_scale": "1.192100000",
    "in_energy1_raw": "838860800",
    "in_energy1_scale": "1.192100000",
    "in_energy1_en": "1",
}
# The IIO driver axp20x-adc, which numbers voltages and currents each by themselves: the second voltage is that of a
# thermistor, the third that of a pin, the second current charges the battery, and the third discharges it.
AXP209 = {
    "name": "axp20x-adc",
    "in_voltage2_raw": "1500",
    "in_voltage_scale": "1.700000000",
    "in_voltage3_raw": "1000",
    "in_current2_raw": "600",
    "in_current2_scale": "0.500000",
    "in_current3_raw": "2000",
    "in_current3_scale": "0.500000",
}
# The hwmon driver ltc4261: in1 and in2 are auxiliary inputs. And ltc4222, whose voltages are two for each current.
LTC4261 = {"name": "ltc4261", "in1_input": "1830", "in2_input": "1250", "curr1_input": "900"}
LTC4222 = {
    "name": "ltc4222",
    "in1_input": "12000",
    "in2_input": "1020",
    "in3_input": "5000",
    "in4_input": "1100",
    "curr1_input": "800",
    "curr2_input": "2000",
}
# The hwmon driver ltc2992: as hwmon counts voltages from 0 and all else from 1, in1 is that of the second supply.
LTC2992 = {
    "name": "ltc2992",
    "in0_input": "12000",
    "in1_input": "5000",
    "in2_input": "700",
    "curr1_input": "1000",
    "curr2_input": "2000",
    "power1_input": "12000000",
    "power2_input": "10000000",
}
LTC4151 = {"name": "ltc4151", "in1_input": "24000", "in2_input": "310", "curr1_input": "500"}
# A PMBus supply, whose labels say which of its numbers belong together.
PMBUS = {
    "name": "ltc3880",
    "in1_label": "vin",
    "in1_input": "48000",
    "in2_label": "vout1",
    "in2_input": "12000",
    "curr1_label": "iin",
    "curr1_input": "300",
    "curr2_label": "iout1",
    "curr2_input": "1100",
    "power1_label": "pout1",
    "power1_input": "13200000",
}
# The battery of a laptop (power_supply_hwmon): its power has no sign, and what it means says the supply's own status.
BATTERY = {
    "name": "BAT0",
    "in0_input": "17280",
    "power1_input": "14800000",
    "device/type": "Battery",
    "device/status": "Discharging",
}
ACPI_METER = {"name": "power_meter", "power1_average": "184000000", "power1_average_interval": "1000"}
# A driver whose power does not belong to the voltage of the same number.
AMDGPU = {
    "name": "amdgpu",
    "in0_label": "vddgfx",
    "in0_input": "756",
    "power1_label": "PPT",
    "power1_average": "9000000",
    "temp1_label": "edge",
    "temp1_input": "41000",
}
THERMAL = {"name": "cpu_thermal", "temp1_input": "45000"}


class RailTree:
    """A /sys of a test.

    Attributes:
        root: its folder.
    """

    def __init__(self, root: Path) -> None:
        self.root = root
        self._count = {"hwmon": 0, "iio": 0}

    def hwmon(self, files: Mapping[str, str], *, address: str | None = None) -> Path:
        """Lay out a device of hwmon, with its address on the I2C bus as the kernel links it."""
        name = f"hwmon{self._number('hwmon')}"
        return self._lay_out(name, self.root / "class" / "hwmon" / name, "hwmon", files, address)

    def iio(self, files: Mapping[str, str], *, address: str | None = None) -> Path:
        """Lay out a device of IIO."""
        name = f"iio:device{self._number('iio')}"
        return self._lay_out(name, self.root / "bus" / "iio" / "devices" / name, "", files, address)

    def _number(self, kind: str) -> int:
        self._count[kind] += 1
        return self._count[kind] - 1

    def _lay_out(self, name: str, link: Path, within: str, files: Mapping[str, str], address: str | None) -> Path:
        device = self.root / "devices" / "platform" / (address or f"acpi-{name}")
        folder = device / within / name
        for each, content in files.items():
            write(folder / each, content)
        link.parent.mkdir(parents=True, exist_ok=True)
        link.symlink_to(folder)
        if address is not None:
            bus = self.root / "bus" / "i2c" / "devices" / address
            bus.parent.mkdir(parents=True, exist_ok=True)
            bus.symlink_to(device)
        return folder
