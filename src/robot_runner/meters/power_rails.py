"""The profiler of supply rails in Linux' drivers, here or on another computer."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

from robot_runner.core.errors import Finding, LinkError, PluginError
from robot_runner.core.events.context import RobotRunnerContext, SystemClock
from robot_runner.core.links.declared_host import LOCAL
from robot_runner.core.links.ssh_command import ssh_findings
from robot_runner.core.plugin import Circumstances
from robot_runner.measuring.devices import connect_host
from robot_runner.measuring.host import FileHost, RemoteHost, SamplingReport
from robot_runner.measuring.local_host import LocalHost
from robot_runner.measuring.measured_machine import Computer, machine_clock, simulation_findings
from robot_runner.measuring.periodic import HostSampler, Sampling
from robot_runner.measuring.ssh_host import SshHost
from robot_runner.meters.electrical import ElectricalProfiler
from robot_runner.meters.electrical_readings import Readings
from robot_runner.meters.polled import Meter, Sampler
from robot_runner.meters.sysfs_rails import Rail, choose_rails, find_rails

#: The status of a battery that supplies the computer. Source: Linux, Documentation/ABI/testing/sysfs-class-power.
_DISCHARGING = "Discharging"
#: Samples are doubted if the uncertainty of their clock exceeds this share of the window, as elsewhere.
_CLOCK_SHARE = 0.01


class _LocalRails(Meter[Readings]):
    def __init__(self, host: FileHost, rails: Sequence[Rail]) -> None:
        self._host = host
        self._rails = rails
        self._paths = _paths(rails)

    def read(self) -> Readings:
        return _understood(self._rails, self._paths, self._host.read_files(self._paths))


def _paths(rails: Sequence[Rail]) -> list[str]:
    return list(dict.fromkeys(file.path for rail in rails for file in rail.files.values()))


def _understood(rails: Sequence[Rail], paths: Sequence[str], lines: Sequence[str | None]) -> Readings:
    """Return the reading of each rail; a `ValueError` says that a file could not be read, or holds no number."""
    by_path = dict(zip(paths, lines, strict=True))
    return tuple(rail.read(by_path) for rail in rails)


class PowerRails(ElectricalProfiler):
    """Measures supply rails through Linux' drivers: hwmon and IIO, as a Jetson, a server and most carrier boards have.

    Any driver that shows power or energy works, and others whose voltage and current are known to be those of one rail:
    those of INA219, INA226, INA228, INA237, INA238, INA260 and INA3221, PMBus supplies, the power meter of ACPI, the
    supplies of some workstations.

    Args:
        rails: the names of the rails, such as `["VDD_IN"]`; None takes the only one with power.
        name: distinguishes several instances; None for the class's name.
        host: the computer: `localhost` for this machine, or as ssh takes it (`pi@robot`).
        ssh_config: a file that replaces your ssh config.
        rate_hz: readings a second, Hz; each is a transfer or more on the sensor's bus.
        root: the folder of sysfs.

    Raises:
        PluginError: the rails are not a list of names, two would yield measures with the same name, or the rate is not
            positive.

    Example:
        >>> [measure.name for measure in PowerRails(["VDD_IN", "VDD_GPU_SOC"], host="nvidia@jetson").measures][::4]
        ['Energy_VDD_IN', 'Energy_VDD_GPU_SOC']
    """

    needs: ClassVar[str] = "Linux with a driver that shows power or energy in hwmon or IIO, here or over ssh."

    def __init__(
        self,
        rails: Sequence[str] | None = None,
        *,
        name: str | None = None,
        host: str = LOCAL,
        ssh_config: str | Path | None = None,
        rate_hz: float = 20.0,
        root: str | Path = "/sys",
    ) -> None:
        if isinstance(rails, str) or (rails is not None and not rails):
            listed = [rails] if rails else ["VDD_IN"]
            fix = f"Give a list: rails={listed!r}, or leave it out for the only one."
            raise PluginError(f"rails is {rails!r}", where=name or type(self).__name__, fix=fix)
        channels = [re.sub(r"\W+", "_", rail).strip("_") for rail in rails or ("",)]
        if len(set(channels)) < len(channels):
            problem = f"two of the rails would yield measures of one name: {', '.join(rails or ())}"
            fix = "Name each once; measure alike ones with two plugins of different names."
            raise PluginError(problem, where=name or type(self).__name__, fix=fix)
        super().__init__(name=name, rate_hz=rate_hz, channels=channels)
        self.rails = None if rails is None else tuple(rails)
        self.host = host
        self.ssh_config = None if ssh_config is None else Path(ssh_config).expanduser()
        self.root = str(root).rstrip("/")
        # A row for a mission of 95 s takes some 20 bytes of time and 40 of each rail.
        self.bytes_per_run = round(95 * rate_hz * (20 + 40 * len(channels)))
        self._rails: Sequence[Rail] = ()
        self._states: set[tuple[str, str]] = set()  # of the batteries among them, at the beginning and at the end
        self._report = SamplingReport(rate=rate_hz)

    @property
    def measured_computer(self) -> Computer:
        """The computer whose rails are read."""
        return Computer(self.host, self.ssh_config)

    def claims(self, robot: str | None) -> Iterable[str]:
        """Return a claim of the measured computer."""
        del robot
        return (f"host:{self.host}",)

    def check(self, circumstances: Circumstances) -> Iterable[Finding]:
        """Return errors: the computer cannot be reached, or has no such rail."""
        where = f"plugin {self.name}"
        findings = [] if self.host == LOCAL else ssh_findings(where, self.host, config=self.ssh_config)
        if not findings:
            findings = list(self._rail_findings(where))
        return [*findings, *(simulation_findings(self.name, circumstances.robot) if self.host == LOCAL else ())]

    def start_run(self, context: RobotRunnerContext) -> None:
        """Connect and find the rails, before the robot moves; a `LinkError` says which cannot be reached or found."""
        super().start_run(context)
        self._report = SamplingReport(rate=self.rate_hz)
        host = self._connected(context)
        if isinstance(host, RemoteHost):
            host.connect()
        self._rails = choose_rails(find_rails(host, self.root), self.rails, where=self.name)
        self._states = set(self._statuses(host))

    def open(self, context: RobotRunnerContext) -> _LocalRails:
        """Return the rails of this machine."""
        return _LocalRails(self._connected(context), self._rails)

    def sampler(self, context: RobotRunnerContext) -> Sampler[Readings]:
        """Return a sampler: this machine reads once per call, another computer samples on its own."""
        if self.host == LOCAL:
            return super().sampler(context)
        host, paths, clock = self._connected(context), _paths(self._rails), machine_clock(context)
        return HostSampler(host, paths, partial(_understood, self._rails, paths), rate=self.rate_hz, clock=clock)

    def stop_measurement(self, context: RobotRunnerContext) -> None:
        """Fetch the samples."""
        is_first = self._sampling is None
        super().stop_measurement(context)
        if is_first:
            with suppress(LinkError):  # a lost connection is in the report
                self._states.update(self._statuses(self._connected(context)))
        if is_first and isinstance(self._sampler, HostSampler):
            self._report = self._sampler.report()
            if self._report.clock_facts is not None:
                context.note_clock(self._report.clock_facts)

    def doubts(self, sampling: Sampling[Readings]) -> Iterator[str]:
        """Yield doubts about the rails, the connection and the computer's clock."""
        yield from super().doubts(sampling)
        within = sampling.within().readings
        for place, rail in enumerate(self._rails):
            if clipped := sum(rail.is_clipped(readings[place]) for readings in within):
                at_its_end = f"rail {rail.name!r} was at the end of its sensor's range, {rail.largest:.3g} A"
                yield f"{at_its_end}, in {clipped} of {len(within)} readings: what was drawn is more"
        for name, status in sorted(self._states):
            if status != _DISCHARGING:
                of_battery = f"rail {name!r} is that of a battery whose status was {status!r}"
                yield f"{of_battery}: its power may be what goes into it, and not what is drawn"
        if self.host != LOCAL:
            yield from self._report.problems
            clock = self._report.clock
            if clock is not None and clock.uncertainty > _CLOCK_SHARE * sampling.window.duration:
                yield f"the clock of {self.host} is known to {clock.uncertainty:.3f} s only"

    def details(self) -> Mapping[str, Any]:
        """Return the files that were read, and facts about the sampling."""
        files = {
            rail.name: {"chip": rail.chip, **{quantity: file.path for quantity, file in rail.files.items()}}
            for rail in self._rails
        }
        report = {"form": self._report.form, "host_clock": self._report.clock_facts}
        return {**super().details(), "host": self.host, "rails": files, **report}

    def _statuses(self, host: FileHost) -> Iterator[tuple[str, str]]:
        batteries = [(rail.name, rail.status) for rail in self._rails if rail.status is not None]
        if batteries:
            names, paths = zip(*batteries, strict=True)
            told = zip(names, host.read_files(paths), strict=True)
            yield from ((name, status.strip()) for name, status in told if status is not None)

    def _counted(self, sampling: Sampling[Readings], place: int) -> float | None:
        """Return the increase of the rail's counter; None if an INA228 counted energy that flowed back as drawn.

        Its registers of energy and power have no sign (data sheet of the INA228, register map).
        """
        if self._rails[place].chip.startswith("ina"):
            currents = (readings[place].current for readings in sampling.within().readings)
            if any(current is not None and current < 0 for current in currents):
                return None
        return super()._counted(sampling, place)

    def _rail_findings(self, where: str) -> Iterator[Finding]:
        clock = SystemClock()
        host = LocalHost(clock) if self.host == LOCAL else SshHost(self.host, clock, config=self.ssh_config)
        try:
            chosen = choose_rails(find_rails(host, self.root), self.rails, where=where)
        except LinkError as error:
            yield Finding.error(where, error.problem, error.fix)
            return
        finally:
            host.close()
        for rail in chosen:
            if not rail.tells_power:
                only = f"rail {rail.name!r} reports its {' and '.join(rail.files)} only"
                yield Finding.warning(where, f"{only}: no value of energy and power")

    def _connected(self, context: RobotRunnerContext) -> FileHost:
        host = connect_host(context, self.host, ssh_config=self.ssh_config)
        if not isinstance(host, FileHost):
            fix = f"Name another host than {self.host!r}."
            raise LinkError("files of this computer cannot be read", where=self.name, fix=fix)
        return host
