"""The supply rails that Linux' hwmon and IIO drivers show in /sys, found by name on any computer."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from robot_runner.core.errors import LinkError, did_you_mean
from robot_runner.meters.electrical_readings import ElectricalReading
from robot_runner.meters.ina219.sysfs import SHUNT_RANGES

if TYPE_CHECKING:
    from robot_runner.measuring.host import FileHost

#: The quantities of a rail, by their names in each of the two interfaces, and one step of a file in SI units. Sources:
#: Linux, Documentation/hwmon/sysfs-interface.rst and Documentation/ABI/testing/sysfs-bus-iio.
_HWMON = {"power": ("power", 1e-6), "energy": ("joules", 1e-6), "curr": ("current", 1e-3), "in": ("voltage", 1e-3)}
_IIO = {"power": ("power", 1e-3), "energy": ("joules", 1.0), "current": ("current", 1e-3), "voltage": ("voltage", 1e-3)}
#: The driver of PAC1931 to PAC1934 scales to uW and uJ instead. Source: Linux, drivers/iio/adc/pac1934.c: 3.2 V^2
#: divided by the shunt and by 2^28 steps is 0.011921 W for a shunt of 1 uohm, for which its scale is 11921.
_PAC193X, _IIO_OF_PAC193X = "pac193", {**_IIO, "power": ("power", 1e-6), "energy": ("joules", 1e-6)}
_HWMON_FILE = re.compile(r"(power|energy|curr|in)(\d+)_(input|average|label)")
_IIO_FILE = re.compile(r"in_(power|energy|current|voltage)(\d*)_(input|raw|scale|offset|label)|rail_name_(\d+)")

#: The channels of the INA2xx's IIO driver are its registers, not rails: shunt and bus voltage, power, current.
#: Source: Linux, drivers/iio/adc/ina2xx-adc.c.
_INA2XX_IIO = {("voltage", 1), ("power", 2), ("current", 3)}
#: An INA3221's in4 to in6 are the voltages of its shunts, and in7 is their sum; other chips have their shunt's voltage
#: in in0. Source: Linux, Documentation/hwmon/ina3221.rst and ina2xx.rst.
_INA3221_CHANNELS = (1, 2, 3)
#: The largest voltage at the shunt, V: an INA3221's is its register's last step, 4095 x 40 uV (SBOS576, register maps).
_SHUNT_RANGES = {**SHUNT_RANGES, "ina3221": 0.1638}
#: Half a step of hwmon's currents, A.
_HALF_STEP = 0.0005
#: Chips whose voltage and current of one number are those of one rail. Others without labels number each quantity by
#: itself: in1 is an auxiliary input (ltc4261), or the voltage of the second supply (ltc2992), as hwmon counts voltages
#: from 0 and all else from 1. Source: Linux, Documentation/hwmon/ltc*.rst.
_NUMBERED_ALIKE = ("ina", "ltc2945", "ltc4151", "ltc4215", "ltc4245", "ltc4260", "sq52206", "sy24655")
#: PMBus drivers name the quantities of one rail vin, iin, pin, or vout1, iout1, pout1.
_PMBUS = re.compile(r"[vip](in|out\d*)")


@dataclass(frozen=True, slots=True)
class RailFile:
    """A file of a driver, and the conversion of its number to SI units: `(number + offset) * scale`."""

    path: str
    scale: float
    offset: float = 0.0


@dataclass(frozen=True, slots=True)
class Rail:
    """A supply rail whose power, energy, current or voltage a driver shows.

    Attributes:
        name: the driver's label such as `VDD_IN`, else the chip's name; unique on its computer.
        chip: the driver's name for the chip, such as `ina3221`.
        files: a file for each available quantity: `power`, `voltage`, `current`, `joules`.
        status: for a battery, the file with its status, such as discharging; None for any other rail.
        largest: the largest current that the sensor can measure, A; None where that is unknown.

    Example:
        >>> rail = Rail("VDD_IN", "ina3221", {"voltage": RailFile("in1", 1e-3), "current": RailFile("curr1", 1e-3)})
        >>> rail.read({"in1": "5000", "curr1": "1500"}).power
        7.5
    """

    name: str
    chip: str
    files: Mapping[str, RailFile]
    status: str | None = None
    largest: float | None = None

    def is_clipped(self, reading: ElectricalReading) -> bool:
        """Whether a reading is at the end of the sensor's range, so that the true current is larger."""
        return self.largest is not None and abs(reading.current or 0.0) + _HALF_STEP >= self.largest

    @property
    def tells_power(self) -> bool:
        """Whether its energy can be measured."""
        return bool({"power", "joules"} & self.files.keys() or {"voltage", "current"} <= self.files.keys())

    def read(self, lines: Mapping[str, str | None]) -> ElectricalReading:
        """Return a reading from the lines of the files, by path; power is voltage times current if no file has it.

        It is also computed if a chip of the INA family measures a negative current: its power register has no sign
        (Linux, drivers/hwmon/ina2xx.c).

        Raises:
            ValueError: a file could not be read, or contains no number.
        """
        told = {quantity: _number(file, lines.get(file.path)) for quantity, file in self.files.items()}
        is_backwards = self.chip.startswith("ina") and told.get("current", 0.0) < 0
        if ("power" not in told or is_backwards) and {"voltage", "current"} <= told.keys():
            told["power"] = told["voltage"] * told["current"]
        return ElectricalReading(**told)


def _number(file: RailFile, line: str | None) -> float:
    if line is None:
        raise ValueError(f"{file.path} could not be read")
    try:
        return (float(line) + file.offset) * file.scale
    except ValueError:
        raise ValueError(f"{file.path} holds {line!r}, which is not a number") from None


def find_rails(host: FileHost, root: str = "/sys") -> list[Rail]:
    """Return the rails of a computer, those of hwmon first.

    Args:
        host: the computer.
        root: the folder of its sysfs.

    Raises:
        LinkError: the computer cannot be reached, or the scale of a channel is not a number.
    """
    patterns = ("name", "*_input", "*_average", "*_label", "shunt*_resistor")
    hwmon = _files_of(host, f"{root}/class/hwmon/hwmon*", patterns)
    iio = _files_of(host, f"{root}/bus/iio/devices/iio:device*", ("name", "in_*", "rail_name_*"))
    addresses, batteries = _addresses(host, root), _batteries(host, root)
    found: list[tuple[Sequence[str], Rail]] = []
    for devices, rails_of in ((hwmon, _hwmon_rails), (iio, _iio_rails)):
        for folder, lines in devices.items():
            device = folder.rpartition("/")[2]
            chip = lines.get("name") or device
            rails = rails_of(folder, chip, lines)
            for fallback, label, files in rails:
                name = label or (chip if len(rails) == 1 else f"{chip}:{fallback}")
                placed = f"{name}@{addresses.get(device, device)}"
                rail = Rail(name, chip, files, batteries.get(folder), _largest_current(chip, files, lines))
                found.append(((name, placed, f"{placed}:{fallback}"), rail))
    taken = [name for names, _ in found for name in names]
    # Each has the first of its names that no other rail has.
    unique = (next((name for name in names if taken.count(name) == 1), names[-1]) for names, _ in found)
    return [replace(rail, name=name) for name, (_, rail) in zip(unique, found, strict=True)]


def _largest_current(chip: str, files: Mapping[str, RailFile], lines: Mapping[str, str]) -> float | None:
    """Return the largest current of a sensor of the INA family with its shunt, A; None if one is unknown."""
    if chip not in _SHUNT_RANGES or "current" not in files:
        return None
    number = re.sub(r"\D", "", files["current"].path.rpartition("/")[2])
    units = {f"shunt{number}_resistor": 1e-6, "shunt_resistor": 1e-6, "in_shunt_resistor": 1.0}
    with suppress(StopIteration, ValueError, ZeroDivisionError):
        return next(_SHUNT_RANGES[chip] / (float(lines[name]) * unit) for name, unit in units.items() if name in lines)
    return None


def choose_rails(rails: Sequence[Rail], names: Sequence[str] | None, *, where: str) -> list[Rail]:
    """Return the rails with these names, or the only one with power; else a `LinkError` lists all rails."""
    there = [rail.name for rail in rails]
    if names is None:
        powered = [rail for rail in rails if rail.tells_power]
        if len(powered) == 1:
            return powered
        if powered:
            listed = ", ".join(repr(rail.name) for rail in powered)
            raise LinkError(f"there are {len(powered)} rails", where=where, fix=f"Name those to measure, of: {listed}.")
        other = f", only voltages or currents: {', '.join(there)}" if rails else ""
        fix = "Load the driver of its power sensor (modprobe, or a device-tree overlay); `sensors` lists what there is."
        raise LinkError(f"no driver in /sys shows a rail with its power{other}", where=where, fix=fix)
    unknown = [name for name in names if name not in there]
    if unknown:
        missing = ", ".join(map(repr, unknown))
        near = " ".join(dict.fromkeys(did_you_mean(name, there) for name in unknown)) if there else ""
        listed = f"There are: {', '.join(map(repr, there))}." if there else "No driver in /sys shows any."
        raise LinkError(f"there is no rail {missing}", where=where, fix=f"{near} {listed}".strip())
    return [rails[there.index(name)] for name in names]


def _files_of(host: FileHost, folders: str, patterns: Iterable[str]) -> dict[str, dict[str, str]]:
    """Return the first lines of the files of each device, by the device's folder and the file's name."""
    paths = [path for pattern in patterns for path in host.list_files(f"{folders}/{pattern}")]
    devices: dict[str, dict[str, str]] = defaultdict(dict)
    for path, line in zip(paths, host.read_files(paths) if paths else (), strict=True):
        folder, _, name = path.rpartition("/")
        if line is not None:
            devices[folder][name] = line.strip()
    return dict(sorted(devices.items(), key=lambda item: _natural(item[0])))


def _natural(text: str) -> list[tuple[int, str]]:
    """Return a key that sorts `hwmon10` behind `hwmon9`."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", text)]


def _addresses(host: FileHost, root: str) -> dict[str, str]:
    """Return the address of each device on an I2C bus, such as `1-0040`, which stays when device numbers change."""
    bus = f"{root}/bus/i2c/devices"
    paths = [*host.list_files(f"{bus}/*/hwmon/hwmon*/name"), *host.list_files(f"{bus}/*/iio:device*/name")]
    return {path.split("/")[-2]: path.removeprefix(f"{bus}/").partition("/")[0] for path in paths}


def _batteries(host: FileHost, root: str) -> dict[str, str]:
    """Return the status file of each battery, by its folder of hwmon.

    Most drivers show power without a sign: charging looks the same as discharging. Source: Linux,
    Documentation/ABI/testing/sysfs-class-power.
    """
    types = host.list_files(f"{root}/class/hwmon/hwmon*/device/type")
    told = zip(types, host.read_files(types) if types else (), strict=True)
    devices = [path.removesuffix("/type") for path, kind in told if (kind or "").strip() == "Battery"]
    return {device.removesuffix("/device"): f"{device}/status" for device in devices}


#: A rail before it has a unique name: its name if it has no label, its label, and its files.
_Found = tuple[str, str, dict[str, RailFile]]


def _hwmon_rails(folder: str, chip: str, lines: Mapping[str, str]) -> list[_Found]:
    files: dict[tuple[str, int], RailFile] = {}
    labels: dict[tuple[str, int], str] = {}
    for name in lines:
        match = _HWMON_FILE.fullmatch(name)
        if match is None or _is_shunt(chip, match[1], int(match[2])):
            continue
        place = match[1], int(match[2])
        if match[3] == "label":
            labels[place] = lines[name]
        elif match[3] == "input" or place not in files:  # an average is used if there is no instantaneous value
            files[place] = RailFile(f"{folder}/{name}", _HWMON[match[1]][1])
    rails: dict[str, _Found] = {}
    for kind in _HWMON:
        for place in sorted(place for place in files if place[0] == kind):
            label = labels.get(place, "")
            key = _rail_key(chip, kind, label, place[1])
            if key in rails and _HWMON[kind][0] in rails[key][2]:  # another rail of the same label
                key = f"{key}#{place[1]}"
            fallback, known, quantities = rails.setdefault(key, (f"{kind}{place[1]}", label, {}))
            quantities[_HWMON[kind][0]] = files[place]
            rails[key] = fallback, known or label, quantities
    return list(rails.values())


def _is_shunt(chip: str, kind: str, number: int) -> bool:
    if kind != "in" or not chip.startswith("ina"):
        return False
    return number not in _INA3221_CHANNELS if chip.startswith("ina3221") else number == 0


def _rail_key(chip: str, kind: str, label: str, number: int) -> str:
    """Return a key that all quantities of one rail share."""
    if not label or chip.startswith("ina"):
        return f"#{number}" if kind != "in" or chip.startswith(_NUMBERED_ALIKE) else f"in#{number}"
    match = _PMBUS.fullmatch(label)
    return match[1] if match else label


def _iio_rails(folder: str, chip: str, lines: Mapping[str, str]) -> list[_Found]:
    is_ina2xx = chip.startswith("ina") and "in_shunt_resistor" in lines
    rails: dict[str, _Found] = {}
    for name in sorted(lines, key=_natural):
        match = _IIO_FILE.fullmatch(name)
        if match is None or match[3] not in {"input", "raw"}:
            continue
        kind, number = match[1], int(match[2] or 0)
        if is_ina2xx and (kind, number) not in _INA2XX_IIO:
            continue
        # Without power, numbers of voltages and currents may have nothing in common: drivers/iio/adc/axp20x_adc.c.
        has_power = any(f"in_power{match[2]}_{end}" in lines for end in ("input", "raw"))
        key = "" if is_ina2xx else match[2] if has_power or kind != "voltage" else f"{kind}{match[2]}"
        label = lines.get(f"rail_name_{match[2]}") or lines.get(f"in_{kind}{match[2]}_label") or ""
        fallback, known, quantities = rails.setdefault(key, (f"{kind}{match[2]}", label, {}))
        quantity, unit = (_IIO_OF_PAC193X if chip.startswith(_PAC193X) else _IIO)[kind]
        quantities[quantity] = _iio_file(f"{folder}/{name}", kind, match, unit, lines)
        rails[key] = fallback, known or label, quantities
    return list(rails.values())


def _iio_file(path: str, kind: str, match: re.Match[str], unit: float, lines: Mapping[str, str]) -> RailFile:
    """Return a channel's file: a processed value has the interface's unit, a raw one a scale and an offset."""
    if match[3] == "input":
        return RailFile(path, unit)

    def setting(what: str, otherwise: float) -> float:
        name = next((name for name in (f"in_{kind}{match[2]}_{what}", f"in_{kind}_{what}") if lines.get(name)), None)
        try:
            return float(lines[name]) if name else otherwise
        except ValueError as error:
            fix = "Look at the sensor's files there."
            problem = f"{name} holds {lines[name or '']!r}, which is not a number"
            raise LinkError(problem, where=path, fix=fix) from error

    return RailFile(path, setting("scale", 1.0) * unit, setting("offset", 0.0))
