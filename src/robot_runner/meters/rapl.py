"""The profiler of the energy counters of Intel and AMD processors."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice, pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from robot_runner.core.errors import Finding, PluginError, did_you_mean
from robot_runner.core.events.context import RobotRunnerContext
from robot_runner.core.events.measure import Measure, Over
from robot_runner.measuring.measured_machine import THIS_MACHINE, simulation_findings
from robot_runner.measuring.parameter_checks import check_list
from robot_runner.measuring.quality import Column
from robot_runner.measuring.series import Series, growth, longest_standstill
from robot_runner.meters.counters import Counters, FileCounters, fall_count, unwrapped
from robot_runner.meters.polled import PolledProfiler

if TYPE_CHECKING:
    from robot_runner.core.plugin import Circumstances
    from robot_runner.measuring.periodic import Sampling

POWERCAP = Path("/sys/class/powercap")
#: `intel-rapl:0` is a package, `intel-rapl:0:1` a domain within it, in hexadecimal; AMD processors have the same names.
#: The same package may appear once more as `intel-rapl-mmio:0`, which would count it twice.
_FOLDER = re.compile(r"intel-rapl:[\da-f]+(:[\da-f]+)?")
#: A die of a package. An AMD package has one counter, which Linux before 6.12 shows for each die (drivers/powercap/
#: intel_rapl_common.c, rapl_msrs_are_pkg_scope); an Intel processor has one for each die.
_DIE = re.compile(r"-die-\d+")
#: The domains that can be measured besides the packages.
_KINDS = {"core": "the cores", "uncore": "the graphics unit", "dram": "the memory", "psys": "the whole platform"}
_MAY_REST = "uncore"
#: The vendors with such packages, and with a counter for each core (MSR_AMD_CORE_ENERGY_STATUS). Linux' powercap shows
#: a single one for a package, as on Intel's processors: that of any core, on which it reads (intel_rapl_msr.c).
_AMD = ("AuthenticAMD", "HygonGenuine")
_LEAVE_OUT = "Leave 'core' out."
_ONE_CORE = "the counter `core` of an AMD processor is that of one of its cores: no value"
_MICRO = 1e-6
#: A counter is doubted if it stood still for this long, s, and for this share of the window: the processor updates it
#: about every millisecond (Intel, Software Developer's Manual, volume 3B, RAPL domains).
_STILL, _STILL_SHARE = 0.5, 0.05
#: More than a processor or its platform draws, W: a counter that would have counted as much until it wrapped was reset.
#: It may have counted for a little longer than between two readings, s.
_MOST_WATTS, _LATE = 3e3, 0.1
_FIRST_LINES = 10  # of /proc/cpuinfo: the vendor is in the second


@dataclass(frozen=True, slots=True)
class Domain:
    """A part of the machine with its own energy counter.

    Attributes:
        label: such as `package-0` or `package-0/dram`.
        kind: `package`, `core`, `uncore`, `dram` or `psys`.
        counter: the file with the counter, in microjoules.
        wraps_at: the value after which the counter wraps to 0, in microjoules.
    """

    label: str
    kind: str
    counter: Path
    wraps_at: int


def find_domains(root: Path = POWERCAP) -> list[Domain]:
    """Return the domains of a machine, in the order of their folders; a `PluginError` if one cannot be read."""
    folders = sorted(folder for folder in root.glob("intel-rapl:*") if _FOLDER.fullmatch(folder.name))
    try:
        return [_domain(folder) for folder in folders]
    except (OSError, ValueError) as error:
        problem = f"the energy counters cannot be read: {error}"
        raise PluginError(problem, where=str(root), fix="Look at what is in there.") from error


def _domain(folder: Path) -> Domain:
    name = (folder / "name").read_text(encoding="ascii").strip()
    parent = folder.name.rpartition(":")[0]
    is_within = parent != "intel-rapl"
    above = (folder.parent / parent / "name").read_text(encoding="ascii").strip() + "/" if is_within else ""
    wraps_at = int((folder / "max_energy_range_uj").read_text(encoding="ascii"))
    return Domain(above + name, name.partition("-")[0], folder / "energy_uj", wraps_at)


def permission_findings(name: str, root: Path, kinds: Sequence[str]) -> list[Finding]:
    """Return errors if domains of these kinds are missing, or may not be read."""
    where = f"plugin {name}"
    try:
        domains = find_domains(root)
    except PluginError as error:
        return [Finding.error(where, f"{error.where}: {error.problem}", error.fix)]
    if not domains:
        problem = f"there is no energy counter of a processor in {root}"
        fix = "Use it on an Intel or AMD machine, not a virtual one: sudo modprobe intel_rapl_msr."
        return [Finding.error(where, problem, fix)]
    there = sorted({domain.kind for domain in domains})
    missing = [kind for kind in kinds if kind not in there]
    problem = "this machine has no counter of the domain"
    findings = [Finding.error(where, f"{problem} {kind!r}", did_you_mean(kind, there)) for kind in missing]
    return [*findings, *_unreadable(where, root, domains)]


def _unreadable(where: str, root: Path, domains: Sequence[Domain]) -> list[Finding]:
    for domain in domains:
        try:
            domain.counter.read_bytes()
        except OSError as error:
            problem = f"{domain.counter} cannot be read: {error.strerror} (since Linux 5.10, only root may)"
            fix = f"Let it be read until the next restart: sudo chmod a+r {root}/intel-rapl*/energy_uj."
            return [Finding.error(where, problem, fix)]
    return []


def is_amd(cpuinfo: Path) -> bool:
    """Whether this file is that of a processor of AMD's design: its packages have one counter, whatever their dies."""
    if not cpuinfo.is_file():
        return False
    with cpuinfo.open(encoding="utf-8", errors="replace") as file:
        return any(vendor in line for line in islice(file, _FIRST_LINES) for vendor in _AMD)


class Rapl(PolledProfiler[Counters]):
    """Measures the energy of the processor of this machine with its own counters (RAPL, running average power limit).

    It measures the machine on which Robot Runner is executed, through Linux' powercap.

    Args:
        name: distinguishes several instances; None for the class's name.
        domains: to measure besides the packages: `core`, `uncore`, `dram`, `psys`, as far as the machine has them.
        rate_hz: readings a second, Hz; often enough to notice each wrap-around of a counter.
        root: the folder of the counters.
        cpuinfo: the file with the processor's vendor.

    Raises:
        PluginError: there is no such domain, or the rate is not positive.

    Example:
        >>> [measure.name for measure in Rapl(domains=["dram"]).measures]
        ['Energy', 'MeanPower', 'DramEnergy']
    """

    measures: Sequence[Measure] = (
        Measure(
            "Energy",
            "J",
            "Energy of all processor packages over the measured window, by their own counters.",
            over=Over.SUM,
        ),
        Measure("MeanPower", "W", "Energy divided by the duration of the measured window.", over=Over.MEAN),
    )
    measured_computer = THIS_MACHINE
    needs: ClassVar[str] = "Linux on an Intel or AMD machine, and the right to read /sys/class/powercap."
    bytes_per_run: int = 40_000  # 10 readings a second of 40 bytes for a mission of 95 s

    def __init__(
        self,
        *,
        name: str | None = None,
        domains: Sequence[str] = (),
        rate_hz: float = 10.0,
        root: str | Path = POWERCAP,
        cpuinfo: str | Path = "/proc/cpuinfo",
    ) -> None:
        super().__init__(name=name, rate_hz=rate_hz)
        check_list(self.name, domains=domains)
        for kind in domains:
            if kind not in _KINDS:
                raise PluginError(f"there is no domain {kind!r}", where=self.name, fix=did_you_mean(kind, _KINDS))
        self.domains = tuple(dict.fromkeys(domains))
        self.root = Path(root)
        self.cpuinfo = Path(cpuinfo)
        self.measures = (*type(self).measures, *map(_measure_of, self.domains))
        self._domains: list[Domain] = []

    def check(self, circumstances: Circumstances) -> Iterable[Finding]:
        """Return errors: no counters, no such domain, or no right to read them."""
        findings = permission_findings(self.name, self.root, ("package", *self.domains))
        if self._tells_of_one_core():
            findings.append(Finding.warning(f"plugin {self.name}", _ONE_CORE, _LEAVE_OUT))
        return [*findings, *simulation_findings(self.name, circumstances.robot)]

    def open(self, context: RobotRunnerContext) -> FileCounters:
        """Return the counters; a `PluginError` says that they cannot be read."""
        del context
        for finding in permission_findings(self.name, self.root, ("package", *self.domains)):
            raise PluginError(finding.problem, where=self.name, fix=finding.fix)
        found = [each for each in find_domains(self.root) if each.kind in {"package", *self.domains}]
        alike = {_DIE.sub("", each.label) if is_amd(self.cpuinfo) else each.label: each for each in reversed(found)}
        self._domains = [each for each in found if each in alike.values()]
        return FileCounters([each.counter for each in self._domains])

    def columns(self, sampling: Sampling[Counters]) -> Sequence[Column]:
        """Return the counters as they were read."""
        counts = zip(*sampling.readings, strict=True) if sampling.readings else ([] for _ in self._domains)
        return [
            Column(f"{each.label}_uJ", list(count), "%d") for each, count in zip(self._domains, counts, strict=True)
        ]

    def populate_run_data(self, context: RobotRunnerContext) -> None:
        """Publish the measures, with a doubt about one that can never have a value."""
        if self._tells_of_one_core():
            context.doubt(_ONE_CORE, fix=_LEAVE_OUT, measures=[_measure_of("core").name])
        super().populate_run_data(context)

    def values(self, sampling: Sampling[Counters]) -> Mapping[str, float | None]:
        """Return the energy of each kind of domain, and the mean power of the packages."""
        by_kind: dict[str, list[float]] = {kind: [] for kind in ("package", *self.domains)}
        for domain, counts in zip(self._domains, zip(*sampling.readings, strict=True), strict=True):
            wraps_at = _wraps_at(domain, sampling.times, counts)
            counted = growth(Series(sampling.times, unwrapped(counts, wraps_at)), sampling.window)
            if counted is None:
                return {}
            by_kind[domain.kind].append(counted * _MICRO)
        # A counter that stood still is dead, except that of the graphics unit, which may have been idle.
        joules = {kind: sum(each) for kind, each in by_kind.items() if all(each) or kind == _MAY_REST}
        if self._tells_of_one_core():
            joules.pop("core", None)
        told = {_measure_of(kind).name: joules.get(kind) for kind in self.domains}
        energy = joules.get("package")
        return {"Energy": energy, "MeanPower": energy and energy / sampling.window.duration, **told}

    def doubts(self, sampling: Sampling[Counters]) -> Iterator[str]:
        """Yield doubts if a counter stood still, or was reset, as when the computer is suspended."""
        within = sampling.within()
        for place, domain in enumerate(self._domains):
            counts = [reading[place] for reading in within.readings]
            if domain.kind != _MAY_REST:
                yield from _standstill(domain.label, within.times, counts, sampling.window.duration)
            wraps_at = _wraps_at(domain, within.times, counts)
            if fall_count(counts, wraps_at):
                yield f"the counter of {domain.label} was set back: what it counted shortly before that is lost"
            if not _is_possible(within.times, unwrapped(counts, wraps_at)):
                yield f"the counter of {domain.label} jumped ahead by more than can have been drawn"

    def _tells_of_one_core(self) -> bool:
        return "core" in self.domains and is_amd(self.cpuinfo)

    def details(self) -> Mapping[str, Any]:
        """Return the domains that were read, and the values at which their counters wrap."""
        return {"domains": [{"label": each.label, "wraps_at_uJ": each.wraps_at} for each in self._domains]}


def _wraps_at(domain: Domain, times: Sequence[float], counts: Sequence[int]) -> int | None:
    """Return the value at which a counter wraps; None if one of its falls was a reset, as of a suspended computer."""
    return domain.wraps_at if _is_possible(times, unwrapped(counts, domain.wraps_at)) else None


def _is_possible(times: Sequence[float], totals: Sequence[float]) -> bool:
    steps = zip(pairwise(times), pairwise(totals), strict=True)
    return all(
        (later - sooner) * _MICRO <= _MOST_WATTS * (end - start + _LATE) for (start, end), (sooner, later) in steps
    )


def _standstill(label: str, times: Sequence[float], counts: Sequence[int], duration: float) -> Iterator[str]:
    """Yield a doubt if a counter stood still, throughout or for so long that some of the energy may be missing."""
    still = longest_standstill(times, counts)
    if 1 < len(still) == len(counts):
        yield f"the counter of {label} stood still at {counts[0]} uJ: no value"
    elif still and (seconds := still[-1] - still[0]) > max(_STILL, _STILL_SHARE * duration):
        yield f"the counter of {label} stood still for {seconds:.1f} s: its energy may lack what was used then"


def _measure_of(kind: str) -> Measure:
    told = f"Energy of {_KINDS[kind]} over the measured window, by its own counter."
    return Measure(f"{kind.capitalize()}Energy", "J", told, over=Over.SUM)
