"""The profiler that measures CPU and memory utilisation of a computer and of its processes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import ClassVar

from robot_runner.core.design.numeric_range import is_whole
from robot_runner.core.errors import Finding, LinkError, PluginError, did_you_mean
from robot_runner.core.events.context import Clock, RobotRunnerContext
from robot_runner.core.events.measure import Measure, Origin, Over
from robot_runner.core.events.window import Window
from robot_runner.core.links.declared_host import LOCAL
from robot_runner.core.plugin import Circumstances, Profiler
from robot_runner.measuring.devices import connect_host
from robot_runner.measuring.evaluation import NEVER_STARTED, publish_measures
from robot_runner.measuring.host import (
    EndingSampler,
    HostLink,
    ProcessHost,
    PromptSampler,
    RemoteHost,
    TellingSampler,
    UtilisationSample,
    UtilisationSampler,
    process_selector,
    report_of,
)
from robot_runner.measuring.live_samples import LiveSamples
from robot_runner.measuring.measured_machine import Computer, host_findings, machine_clock
from robot_runner.measuring.on_board_session import FORMS
from robot_runner.measuring.parameter_checks import check_list, check_numbers
from robot_runner.measuring.quality import Column
from robot_runner.measuring.utilisation import Selection, Utilisation, means_over

_REMEDY = "Look at the load of the computer, at the network and at samples.csv before you use this run."
#: For the estimated size of raw data: bytes of a sample, of each core in it, and of each process; a mission's duration,
#: s; the cores of a robot's computer.
_SAMPLE_BYTES, _CORE_BYTES, _PROCESS_BYTES = 45, 8, 20
_MISSION, _CORES = 95.0, 4


class PsUtil(Profiler):
    """Measures CPU and memory utilisation, as the paper's PsUtil does, at 10 Hz.

    On this machine psutil samples in a thread of the run. On another computer a small program samples until the
    mission is over, and its samples are fetched afterwards, so that they cause no traffic during the mission. CPU
    utilisation is that since the sample before, not that over a process's lifetime, which `ps` prints as `%cpu`.

    Args:
        name: distinguishes several instances; None for the class's name.
        host: the computer: `localhost` for this machine, or as ssh takes it (`pi@robot`); None for the on-board
            computer of a simulated robot.
        rate_hz: samples a second, Hz.
        processes: what to measure besides the whole computer: names (`"talker"`), process ids (`4711`), or ROS nodes
            (`"node:/talker"`, found by the name on their command line), or software under test with all that it has
            started (`"subject:Nav"`, the name of a `Program` or `RosNode`).
        cores: the numbers of cores to measure, each by itself.
        is_streamed: whether another computer sends each sample at once.
        ssh_config: a file that replaces your ssh config.
        form: the program that samples another computer: `python3`, `sh` or `ps`; None takes the best that works.
        namespace: of the simulated robot with the computer, if there are several.

    Raises:
        PluginError: the rate is not positive, a process, a core or a form is invalid, or a parameter would do nothing.

    Example:
        >>> [measure.name for measure in PsUtil(host="pi@robot", processes=["move_base"]).measures]
        ['CPU', 'Memory', 'CPU_move_base', 'Memory_move_base']
    """

    measures: Sequence[Measure] = (
        Measure("CPU", "%", "CPU utilisation of all cores together, mean over the measured window.", over=Over.MEAN),
        Measure("Memory", "%", "Physical memory in use, mean over the measured window.", over=Over.MEAN),
    )
    needs: ClassVar[str] = (
        "psutil for this machine, the OpenSSH client and a key for another one, nothing more on a simulated robot."
    )

    #: Over a network, the clock of another computer must be known to 1 % of the window: 10 ms.
    probe_s: float | None = 1.0

    def __init__(  # noqa: PLR0913 - keywords of a user's config
        self,
        *,
        name: str | None = None,
        host: str | None = None,
        rate_hz: float = 10.0,
        processes: Sequence[str | int] = (),
        cores: Sequence[int] = (),
        is_streamed: bool = False,
        ssh_config: str | Path | None = None,
        form: str | None = None,
        namespace: str = "",
    ) -> None:
        super().__init__(name=name)
        check_numbers(self.name, rate_hz=rate_hz)
        if form is not None and form not in FORMS:
            raise PluginError(f"form is {form!r}", where=self.name, fix=did_you_mean(form, FORMS))
        over_ssh = {"is_streamed": is_streamed, "ssh_config": ssh_config, "form": form}
        _refuse_idle(self.name, {} if host not in {None, LOCAL} else over_ssh, "the computer is not reached by ssh")
        _refuse_idle(self.name, {} if host is None else {"namespace": namespace}, "a host is named")
        self.host = host
        self.rate_hz = rate_hz
        self.is_streamed = is_streamed
        self.ssh_config = None if ssh_config is None else Path(ssh_config).expanduser()
        self.form = form
        self.namespace = namespace
        self.selection = _selection(self.name, processes, cores)
        self.measures = (*type(self).measures, *self.selection.measures())
        started = tuple(one for one in self.selection.processes if not one.startswith("pid:"))  # perhaps by a run
        self.not_probed = [measure.name for measure in Selection(started).measures()]
        if form == "ps":  # it looks once a second
            self.probe_s = 3.0
        line = _SAMPLE_BYTES + _CORES * _CORE_BYTES + len(self.selection.processes) * _PROCESS_BYTES
        self.bytes_per_run = round(line * rate_hz * _MISSION)
        self._link: HostLink | None = None
        self._sampler: UtilisationSampler | None = None
        self._clock: Clock | None = None
        self._sampled: Window | None = None
        self._begun_at = 0.0
        self._utilisation: Utilisation | None = None
        self._live: LiveSamples | None = None

    @property
    def measured_computer(self) -> Computer | None:
        """The computer that is sampled; None for that of a simulated robot."""
        if self.host is None:
            return None
        return Computer(self.host, self.ssh_config, self.form, self.selection.processes)

    def claims(self, robot: str | None) -> Iterable[str]:
        """Return a claim of the measured computer; a simulated one belongs to the run anyway."""
        del robot
        return () if self.host is None else (f"host:{self.host}",)

    def check(self, circumstances: Circumstances) -> Iterable[Finding]:
        """Return errors: no computer is named, or it cannot be reached."""
        names = circumstances.listed or [each.name for each in circumstances.plugins]
        for kind, _, name in (each.partition(":") for each in self.selection.processes):
            if kind == "subject" and name not in names:
                problem = f"no plugin is named {name!r}, whose processes are to be measured"
                yield Finding.error(f"plugin {self.name}", problem, did_you_mean(name, names))
        yield from host_findings(
            self.name,
            circumstances.robot,
            host=self.host,
            ssh_config=self.ssh_config,
            has_selection=self._has_selection,
        )

    def start_run(self, context: RobotRunnerContext) -> None:
        """Connect, before the robot moves and before the measurement begins."""
        self._forget()
        link = self._connected(context)
        if isinstance(link, RemoteHost):
            link.connect()

    def start_measurement(self, context: RobotRunnerContext) -> None:
        """Start sampling."""
        self._forget()
        self._clock = context.clock if self.host is None else machine_clock(context)
        self._link = self._connected(context)
        self._begun_at = self._clock.now()
        self._sampler = self._begun(self._link)
        if isinstance(self._sampler, PromptSampler):
            context.times.at_edges(self._sampler.take_now)
        if isinstance(self._sampler, TellingSampler):
            live = self._live = LiveSamples(context.raw_data_folder / "samples.csv")
            self._sampler.tell(lambda sample: live.show(lambda: _shown(sample())))

    def stop_measurement(self, context: RobotRunnerContext) -> None:
        """End sampling; the samples are fetched later, so that other profilers need not wait for them."""
        if self._sampler is None or self._clock is None or self._sampled is not None:
            return
        self._sampled = Window(self._begun_at, self._clock.now())
        if isinstance(self._sampler, EndingSampler):
            self._sampler.end()
        else:
            self._collect(context)

    def stop_run(self, context: RobotRunnerContext) -> None:
        """Fetch the samples if they are still on another computer, and write them."""
        self._collect(context)
        if self._utilisation is not None:
            self._utilisation.write(context.raw_data_folder, context.times.window(self._clock))
        if self._live is not None:
            self._live.close()

    def _collect(self, context: RobotRunnerContext) -> None:
        sampler, self._sampler = self._sampler, None
        if sampler is None or self._link is None or self._sampled is None:
            return
        try:
            samples: Sequence[UtilisationSample] = sampler.stop()
        except LinkError as error:
            samples = ()
            context.doubt(f"the samples could not be fetched: {error.problem}", fix=error.fix)
        report = report_of(sampler, self.rate_hz)
        if report.clock_facts is not None:
            context.note_clock(report.clock_facts)
        self._utilisation = Utilisation(samples, self._sampled, self.selection, report, self._link.is_simulated)

    def populate_run_data(self, context: RobotRunnerContext) -> None:
        """Publish the mean utilisations; no value where samples cover too little."""
        sampled, mission = self._utilisation, context.times.window(self._clock)
        if sampled is None or mission is None:
            context.doubt(NEVER_STARTED, fix=_REMEDY)
        else:
            measured = sampled.over(mission)
            for each in measured.doubted(context.plugin_data):
                context.doubt(each.problem, fix=each.fix or _REMEDY, measures=each.measures)
            for problem in measured.quality.warnings():
                context.doubt(problem, fix=_REMEDY)
        origin = Origin.SIMULATED if sampled is not None and sampled.is_simulated else Origin.MEASURED
        evaluate = partial(means_over, sampled)
        times = () if sampled is None else sampled.times
        publish_measures(context, self.measures, evaluate, origin=origin, clock=self._clock, times=times)

    def _forget(self) -> None:
        self._sampler = self._clock = self._sampled = self._utilisation = None

    @property
    def _has_selection(self) -> bool:
        return bool(self.selection.processes or self.selection.cores)

    def _connected(self, context: RobotRunnerContext) -> HostLink:
        return connect_host(context, self.host, namespace=self.namespace, ssh_config=self.ssh_config, form=self.form)

    def _begun(self, link: HostLink) -> UtilisationSampler:
        if isinstance(link, ProcessHost):
            return link.sample_processes(self.rate_hz, self.selection.processes, is_streamed=self.is_streamed)
        if self._has_selection:
            problem = "this computer does not report single processes or cores"
            raise LinkError(problem, where=self.name, fix="Leave processes and cores out.")
        return link.sample_utilisation(self.rate_hz)


def _shown(sample: UtilisationSample) -> list[Column]:
    told = {"time_s": sample.time, "cpu_percent": sample.cpu, "memory_percent": sample.memory}
    return [Column(name, [value]) for name, value in told.items()]


def _refuse_idle(plugin: str, parameters: Mapping[str, object], reason: str) -> None:
    """Refuse parameters that would do nothing."""
    for name, value in parameters.items():
        if value:
            raise PluginError(f"{name} is {value!r}, and {reason}", where=plugin, fix=f"Leave {name} out.")


def _selection(plugin: str, processes: Sequence[str | int], cores: Sequence[int]) -> Selection:
    check_list(plugin, processes=processes, cores=cores)
    odd = [core for core in cores if not is_whole(core) or core < 0]
    if odd:
        raise PluginError(f"there is no core {odd[0]!r}", where=plugin, fix="Number the cores from 0.")
    try:
        selectors = tuple(dict.fromkeys(map(process_selector, processes)))
    except LinkError as error:
        raise PluginError(error.problem, where=f"{plugin}, processes", fix=error.fix) from error
    selection = Selection(selectors, tuple(dict.fromkeys(cores)))
    if len(set(selection.labels)) < len(selection.labels):
        problem = f"two of the processes would yield measures of one name: {', '.join(selection.labels)}"
        raise PluginError(problem, where=plugin, fix="Measure them with two plugins of different names.")
    return selection
