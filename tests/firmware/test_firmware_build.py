"""The firmware can be built as people build it: with make alone, and with the Arduino core as the Arduino IDE does."""

from __future__ import annotations

import configparser
import re
import shutil
import subprocess
from pathlib import Path

import pytest
import yaml
from tests.firmware.measuring import MISSION, VOLTS, measure
from tests.firmware.simulated_board import FIRMWARE, BoardClock, Build, build_firmware, executed

CORE = Path("/usr/share/arduino/hardware/arduino/avr")
# As in the core's platform.txt and boards.txt, for the Nano.
SHARED = [
    *("-c", "-g", "-Os", "-w", "-ffunction-sections", "-fdata-sections", "-flto", "-mmcu=atmega328p"),
    *("-DF_CPU=16000000L", "-DARDUINO=10819", "-DARDUINO_AVR_NANO", "-DARDUINO_ARCH_AVR"),
    *(f"-I{CORE}/cores/arduino", f"-I{CORE}/variants/eightanaloginputs"),
]
C = ["avr-gcc", *SHARED, "-std=gnu11", "-fno-fat-lto-objects"]
CPP = ["avr-g++", *SHARED, "-std=gnu++11", "-fpermissive", "-fno-exceptions", "-fno-threadsafe-statics"]
CPP += ["-DDECIMAL_DIG=__DECIMAL_DIG__"]  # Debian's compiler is older than the IDE's and lacks it in C++
LINK = ["avr-gcc", "-w", "-Os", "-g", "-flto", "-fuse-linker-plugin", "-Wl,--gc-sections", "-mmcu=atmega328p"]


def execute(*command: object) -> str:
    done = subprocess.run([str(word) for word in command], capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def compiled(source: Path, folder: Path) -> Path:
    target = folder / f"{source.name}.o"
    execute(*(C if source.suffix == ".c" else CPP), source, "-o", target)
    return target


def built_as_the_ide_does(folder: Path) -> Path:
    """Compile the sketch with Arduino.h before it, its other files as they are; link all with the core's archive."""
    sketch = folder / "ina219.ino.cpp"
    sketch.write_text("#include <Arduino.h>\n" + (FIRMWARE / "ina219.ino").read_text())
    for source in FIRMWARE.glob("*.[ch]"):
        shutil.copy(source, folder)
    own = [compiled(source, folder) for source in [sketch, *sorted(folder.glob("*.c"))]]
    (folder / "core").mkdir()
    sources = [each for suffix in ("c", "cpp") for each in sorted((CORE / "cores/arduino").glob(f"*.{suffix}"))]
    core = [compiled(source, folder / "core") for source in sources]
    execute("avr-gcc-ar", "rcs", folder / "core.a", *core)
    execute(*LINK, "-o", folder / "sketch.elf", *own, folder / "core.a", "-lm")
    return folder / "sketch.elf"


@pytest.mark.long
@pytest.mark.skipif(
    not CORE.is_dir(), reason="the Arduino core is not installed (Debian: apt install arduino-core-avr)"
)
def test_the_sketch_works_when_it_is_built_with_the_arduino_core(built, tmp_path):
    (tmp_path / "sketch").mkdir()
    sketch = Build(built_as_the_ide_does(tmp_path / "sketch"), built.board)
    with executed(sketch, clock=BoardClock(tmp_path / "clock"), load=MISSION.words, volts=VOLTS) as meter:
        measured = measure(meter, tmp_path, 5.0)
    assert abs(measured.error_of("Energy", MISSION)) < 0.001
    assert measured.problems == []


@pytest.mark.long
def test_the_memory_that_is_left_is_enough_for_the_stack(built, board, tmp_path):
    _, data, bss = map(int, execute("avr-size", built.firmware).splitlines()[1].split()[:3])
    with board(load=MISSION.words, volts=VOLTS) as meter:
        measure(meter, tmp_path, 5.0)
        used = meter.facts()["stack"]
    assert 0 < used < 2048 - data - bss - 256


def test_line_and_bus_have_the_speed_that_was_promised(board, tmp_path):
    with board(load=MISSION.words, volts=VOLTS) as meter:
        measure(meter, tmp_path, 0.1)
        facts = meter.facts()
    assert facts["baud"] == pytest.approx(115200, rel=0.025)
    assert facts["bus_hertz"] == pytest.approx(400_000, rel=0.01)


@pytest.mark.long
def test_another_rate_can_be_built_and_is_kept(built, tmp_path):
    quick = Build(build_firmware(tmp_path / "quick", flags="-DSAMPLE_RATE_HZ=400UL"), built.board)
    with executed(quick, clock=BoardClock(tmp_path / "clock"), load=MISSION.words, volts=VOLTS) as meter:
        measured = measure(meter, tmp_path, 4.0)
    assert measured.quality["rate_hz"] == 400
    assert (measured.quality["samples"]["got"], measured.problems) == (pytest.approx(1600, abs=2), [])


@pytest.mark.long
def test_a_battery_above_16_volts_can_be_measured_with_the_wide_range(built, tmp_path):
    wide = Build(build_firmware(tmp_path / "wide", flags="-DSENSOR_CONFIGURATION=0x3CCFU"), built.board)
    with executed(wide, clock=BoardClock(tmp_path / "clock"), load="0:0.5", volts=25.0) as meter:
        measured = measure(meter, tmp_path, 2.0)
    assert measured.context.measures["MeanPower"] == pytest.approx(12.5, rel=1e-3)
    assert measured.problems == []


@pytest.mark.usefixtures("built")
def test_a_rate_that_the_timer_cannot_keep_is_refused_by_the_compiler(tmp_path):
    with pytest.raises(AssertionError, match="SAMPLE_RATE_HZ must divide"):
        build_firmware(tmp_path / "odd", flags="-DSAMPLE_RATE_HZ=300UL")


def test_platformio_finds_the_sketch_beside_its_settings_and_builds_nothing_else():
    settings = configparser.ConfigParser()
    settings.read(FIRMWARE / "platformio.ini")
    assert (FIRMWARE / settings["platformio"]["src_dir"]).resolve() == FIRMWARE
    assert settings["env:nano"]["build_src_filter"].split() == ["+<*.ino>", "+<*.c>"]
    assert {settings[name]["board"] for name in ("env:nano", "env:nano-old")} == {"nanoatmega328new", "nanoatmega328"}


def test_the_profiles_of_arduino_cli_are_those_of_its_documentation():
    project = yaml.safe_load((FIRMWARE / "sketch.yaml").read_text())
    assert project["default_profile"] in project["profiles"]
    for profile in project["profiles"].values():
        assert profile["fqbn"].startswith("arduino:avr:nano:cpu=")
        assert all(re.fullmatch(r"[\w-]+:[\w-]+ \([\d.]+\)", each["platform"]) for each in profile["platforms"])
