"""A copy of the files of a computer, as Linux lays them out in /proc and /sys."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

CPU = "sys/devices/system/cpu"


class ComputerCopy:
    """An Intel laptop of two cores, a fan and one thermal zone that is broken."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.time(busy=6000, stolen=50)
        self.write("proc/vmstat", "nr_free_pages 5\npswpin 10\npswpout 20\npgfault 9")
        self.write("proc/pressure/memory", "some avg10=0.00 avg60=0.00 avg300=0.00 total=250000\nfull avg10=0.00")
        for core, frequency in enumerate((1_400_000, 1_600_000)):
            policy = f"{CPU}/cpufreq/policy{core}"
            self.write(f"{policy}/scaling_governor", "powersave")
            self.write(f"{policy}/scaling_available_governors", "performance powersave")
            self.clock(core, frequency, 2_400_000)
            self.write(f"{CPU}/cpu{core}/thermal_throttle/core_throttle_count", core + 1)
        self.write(f"{CPU}/intel_pstate/no_turbo", 0)
        thermal = "sys/class/thermal"
        self.write(f"{thermal}/thermal_zone0/temp", 61500)
        self.write(f"{thermal}/thermal_zone0/type", "x86_pkg_temp")
        self.write(f"{thermal}/thermal_zone1/temp", -274000)
        self.write(f"{thermal}/thermal_zone1/type", "iwlwifi_1")
        self.write(f"{thermal}/cooling_device0/type", "Processor")
        self.write(f"{thermal}/cooling_device0/cur_state", 0)
        self.write(f"{thermal}/cooling_device1/type", "Fan")
        self.write(f"{thermal}/cooling_device1/cur_state", 2)

    def clock(self, core: int, frequency: int, limit: int) -> None:
        """Show the frequency of a core, kHz, and the highest that is allowed."""
        for name, content in (("governor", "powersave"), ("cur_freq", frequency), ("max_freq", limit)):
            self.write(f"{CPU}/cpu{core}/cpufreq/scaling_{name}", content)

    def write(self, path: str, content: object) -> Path:
        file = self.root / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(f"{content}\n", encoding="ascii")
        return file

    def read(self, path: str) -> str:
        return (self.root / path).read_text(encoding="ascii").strip()

    def time(self, *, busy: int, stolen: int = 0) -> None:
        """Show the time of all cores, in ticks; time in interrupts belongs to no process."""
        self.write("proc/stat", f"cpu  {busy - 20} 10 10 90000 30 77 88 {stolen} 0 0\ncpu0 1 1 1 1 1 1 1 1 0 0")

    def process(self, pid: int, name: str, *, ticks: int, children: int = 0, parent: int = 1, flags: int = 0) -> None:
        """Show a process with its CPU time and that of its children, in ticks."""
        rest = f"S {parent} {pid} {pid} 0 -1 {flags} 0 0 0 0 {ticks - 4} 4 {children} 0 20 0 1 0 999 0 0"
        self.write(f"proc/{pid}/stat", f"{pid} ({name}) {rest}")
        self.write(f"proc/{pid}/cmdline", f"/usr/bin/{name}")
