"""The profiler of network traffic."""

from __future__ import annotations

import shutil
import signal
from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from operator import gt
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from robot_runner.core.errors import Finding, PluginError, did_you_mean
from robot_runner.core.events.context import RobotRunnerContext
from robot_runner.core.events.measure import Measure, Over
from robot_runner.measuring.measured_machine import machine_clock, simulation_findings
from robot_runner.measuring.meter_process import Ending, MeterProcess
from robot_runner.measuring.parameter_checks import check_list
from robot_runner.measuring.quality import Column
from robot_runner.measuring.series import Series, growth
from robot_runner.meters.counters import Counters, FileCounters, fall_count, unwrapped
from robot_runner.meters.machine.machine_state import text_in
from robot_runner.meters.polled import PolledProfiler

if TYPE_CHECKING:
    from robot_runner.core.plugin import Circumstances
    from robot_runner.measuring.periodic import Sampling

_COUNTERS = ("rx_bytes", "tx_bytes", "rx_packets", "tx_packets", "rx_dropped", "tx_dropped")
#: Counters are as wide as a machine word: on a 32-bit Raspberry Pi OS they wrap to 0 after 4 GiB.
_WORD = 1 << 32
#: How many bytes `capture` keeps of each packet: the headers, and little of the content.
_SNAP_LENGTH = 128
_GRACE = 5.0
_TRY = "Try it by hand: tshark -w test.pcapng, with the interfaces as -i. Or leave capture out."
_PERMIT = (
    "Let this user capture (Debian, Ubuntu): sudo dpkg-reconfigure wireshark-common, say yes; then sudo usermod -a -G "
    "wireshark $USER, and log in again. Or leave capture out."
)
#: How long tshark may take until it captures, s: a busy Raspberry Pi needs ten.
_STARTUP = 30.0


def wraps_at(counters: Sequence[Sequence[int]]) -> int | None:
    """Return the value at which counters of one interface wrap to 0; None if the interface was set up anew.

    In that case several of them fall at once, from any value, which on a 64-bit machine may be above 4 GiB.

    Example:
        >>> wraps_at([[4_294_967_000, 200], [1_000, 1_300]]), wraps_at([[4_294_967_000, 200], [1_000, 3]])
        (4294967296, None)
    """
    moments = pairwise(zip(*counters, strict=True))
    return None if any(sum(map(gt, sooner, later)) > 1 for sooner, later in moments) else _WORD


class Network(PolledProfiler[Counters]):
    """Counts bytes and packets through the network interfaces of this machine.

    Args:
        name: distinguishes several instances; None for the class's name.
        interfaces: their names, such as `wlan0`; None for all with a device behind them (no loopback, no bridges).
        capture: whether tshark also keeps the packets, as `capture.pcapng`.
        capture_filter: which packets to keep, in tcpdump's syntax, such as `udp port 7400`.
        rate_hz: readings a second, Hz.
        root: the folder of the interfaces.

    Raises:
        PluginError: interfaces is empty, or the rate is not positive.

    Example:
        >>> Network(interfaces=["wlan0"]).measures[0].name
        'Received'
    """

    measures: Sequence[Measure] = (
        Measure("Received", "B", "Bytes received over the measured window, all interfaces together.", over=Over.SUM),
        Measure("Sent", "B", "Bytes sent over the measured window, all interfaces together.", over=Over.SUM),
        Measure("PacketsReceived", "1", "Packets received over the measured window.", over=Over.SUM),
        Measure("PacketsSent", "1", "Packets sent over the measured window.", over=Over.SUM),
        Measure("PacketsDropped", "1", "Packets that the interfaces dropped over the measured window.", over=Over.SUM),
    )
    needs: ClassVar[str] = "Linux; for capture=True also tshark, and the right to capture."

    def __init__(
        self,
        *,
        name: str | None = None,
        interfaces: Sequence[str] | None = None,
        capture: bool = False,
        capture_filter: str = "",
        rate_hz: float = 2.0,
        root: str | Path = "/sys/class/net",
    ) -> None:
        super().__init__(name=name, rate_hz=rate_hz)
        check_list(self.name, interfaces=() if interfaces is None else interfaces)
        if interfaces is not None and not interfaces:
            fix = "Give a list of names, such as ['wlan0'], or leave it out."
            raise PluginError(f"interfaces is {interfaces!r}", where=self.name, fix=fix)
        self.interfaces = None if interfaces is None else tuple(dict.fromkeys(interfaces))
        self.capture = capture
        self.capture_filter = capture_filter
        self.root = Path(root)
        # 2 readings a second of 80 bytes for a mission of 95 s; a capture of 100 packets a second for as long.
        self.bytes_per_run = 15_000 + (2_000_000 if capture else 0)
        self._names: list[str] = []
        self._indices: list[str] = []
        self._capturing: MeterProcess | None = None
        self._ending: Ending | None = None

    def check(self, circumstances: Circumstances) -> Iterable[Finding]:
        """Return errors: no such interface, or no tshark although packets are to be kept."""
        where = f"plugin {self.name}"
        findings = [Finding.error(where, error.problem, error.fix) for error in self._faults()]
        if self.capture and shutil.which("tshark") is None:
            fix = "Install it: sudo apt install tshark. Or leave capture out."
            findings.append(Finding.error(where, "capture=True needs the program 'tshark', which is not there", fix))
        return [*findings, *simulation_findings(self.name, circumstances.robot)]

    def start_run(self, context: RobotRunnerContext) -> None:
        """Discard the results of the run before."""
        super().start_run(context)
        self._ending = None

    def open(self, context: RobotRunnerContext) -> FileCounters:
        """Return the counters of the interfaces, and begin to capture if asked; a `PluginError` says why it cannot."""
        for fault in self._faults():
            raise fault
        self._names = self._chosen()
        self._indices = list(map(self._index, self._names))
        interfaces = [self.root / name / "statistics" for name in self._names]
        counters = FileCounters([interface / counter for interface in interfaces for counter in _COUNTERS])
        if self.capture:
            self._begin_capture(context)
        return counters

    def _begin_capture(self, context: RobotRunnerContext) -> None:
        """Start tshark and wait until it captures."""
        folder = context.raw_data_folder
        capture = folder / "capture.pcapng"
        tshark = MeterProcess(self._tshark(capture), output=None, folder=folder, clock=machine_clock(context))
        self._capturing = tshark  # before it is awaited: the run may end meanwhile
        # tshark begins its file once it captures.
        if tshark.wait(lambda: capture.exists() and capture.stat().st_size > 0, seconds=_STARTUP):
            return
        self._capturing = None
        ending = tshark.stop(signal.SIGINT, grace=_GRACE)
        problem, fix = f"tshark did not begin to capture within {_STARTUP:g} s", _TRY
        if not ending.was_asked:
            complaint = _complaint(tshark.said) or ending.complaint
            problem = f"tshark ended with exit code {ending.exit_code}: {complaint}"
            fix = _PERMIT if "permission" in complaint else _TRY
        raise PluginError(problem, where=self.name, fix=fix)

    def stop_run(self, context: RobotRunnerContext) -> None:
        """End the capture, and write the raw samples."""
        capturing, self._capturing = self._capturing, None
        if capturing is not None:
            self._ending = capturing.stop(signal.SIGINT, grace=_GRACE)
        super().stop_run(context)

    def columns(self, sampling: Sampling[Counters]) -> Sequence[Column]:
        """Return the counters as they were read."""
        return [
            Column(f"{name}_{counter}", counts, "%d")
            for name, its in zip(self._names, self._counts(sampling), strict=True)
            for counter, counts in zip(_COUNTERS, its, strict=True)
        ]

    def values(self, sampling: Sampling[Counters]) -> Mapping[str, float | None]:
        """Return the counts of all interfaces together."""
        totals = dict.fromkeys(_COUNTERS, 0)
        for its in self._counts(sampling):
            for counter, counts in zip(_COUNTERS, its, strict=True):
                grown = growth(Series(sampling.times, unwrapped(counts, wraps_at(its))), sampling.window)
                if grown is None:
                    return {}
                totals[counter] += round(grown)
        return {
            "Received": totals["rx_bytes"],
            "Sent": totals["tx_bytes"],
            "PacketsReceived": totals["rx_packets"],
            "PacketsSent": totals["tx_packets"],
            "PacketsDropped": totals["rx_dropped"] + totals["tx_dropped"],
        }

    def doubts(self, sampling: Sampling[Counters]) -> Iterable[str]:
        """Yield doubts if an interface appeared or was set up anew, or if tshark failed."""
        for name in sorted(set(self._chosen()).difference(self._names)):
            yield f"interface {name!r} was plugged in meanwhile, and nothing of it is counted"
        for name, index, its in zip(self._names, self._indices, self._counts(sampling.within()), strict=True):
            if self._index(name) not in {index, ""}:
                yield f"interface {name!r} is another one now: its counters are those of two"
            elif any(fall_count(each, wraps_at(its)) for each in its):
                yield f"interface {name!r} was set up again: what it counted shortly before that is lost"
        if self._ending is not None and (
            not self._ending.was_asked or self._ending.exit_code not in {0, -signal.SIGINT}
        ):
            yield f"tshark ended with exit code {self._ending.exit_code}: {self._ending.complaint}"

    def details(self) -> Mapping[str, Any]:
        """Return the interfaces that were read."""
        return {"interfaces": self._names, "is_captured": self.capture}

    def _counts(self, sampling: Sampling[Counters]) -> list[list[list[int]]]:
        """Return the readings of each counter of each interface."""
        width = len(_COUNTERS)
        begins = range(0, len(self._names) * width, width)
        return [[[each[at + place] for each in sampling.readings] for place in range(width)] for at in begins]

    def _index(self, name: str) -> str:
        """Return the kernel's number of an interface, which is unique until the machine restarts."""
        return text_in(self.root / name / "ifindex")

    def _there(self) -> list[str]:
        return sorted(path.name for path in self.root.glob("*") if (path / "statistics").is_dir())

    def _chosen(self) -> list[str]:
        if self.interfaces is not None:
            return list(self.interfaces)
        there = self._there()
        return [name for name in there if (self.root / name / "device").exists()]

    def _faults(self) -> list[PluginError]:
        there = self._there()
        missing = [name for name in self.interfaces or () if name not in there]
        faults = [
            PluginError(f"there is no interface {name!r}", where=self.name, fix=did_you_mean(name, there))
            for name in missing
        ]
        if not self._chosen():
            fix = f"Name some in `interfaces`; there are: {', '.join(map(repr, there)) or 'none'}."
            faults.append(PluginError("no interface has a device behind it", where=self.name, fix=fix))
        return faults

    def _tshark(self, path: Path) -> list[str]:
        chosen = [word for name in self._names for word in ("-i", name)]
        kept = ["-f", self.capture_filter] if self.capture_filter else []
        return ["tshark", "-q", "-n", *chosen, *kept, "-s", str(_SNAP_LENGTH), "-w", str(path)]


def _complaint(said: str) -> str:
    r"""Return why tshark does not capture: its first complaint, as advice and the number of packets follow it.

    Example:
        >>> _complaint("Capturing on 'lo'\ntshark: You may not.\nPlease check ...\ntshark: \n0 packets captured\n")
        'You may not.'
    """
    told = (line.removeprefix("tshark:").strip() for line in said.splitlines() if line.startswith("tshark:"))
    return next(filter(None, told), "")
