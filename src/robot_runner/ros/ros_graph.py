"""The profiler that measures the graph of a robot: its nodes and topics, and CPU and memory of chosen nodes."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

from robot_runner.core.errors import Finding, LinkError, PluginError
from robot_runner.core.events.context import RobotRunnerContext
from robot_runner.core.events.measure import Measure, Origin
from robot_runner.core.events.window import Window
from robot_runner.core.links.connect import connect_robot, is_simulated, is_simulation, robot_namespace
from robot_runner.core.links.declared_host import LOCAL
from robot_runner.core.links.graph_names import full_name
from robot_runner.core.links.robot import AsksNodes
from robot_runner.core.links.robot_name import RobotName
from robot_runner.core.plugin import Circumstances, Profiler
from robot_runner.core.words import enumerated
from robot_runner.measuring.devices import connect_host
from robot_runner.measuring.evaluation import NEVER_STARTED, publish_measures
from robot_runner.measuring.host import (
    HostLink,
    ProcessHost,
    PromptSampler,
    RemoteHost,
    UtilisationSampler,
    process_selector,
    report_of,
)
from robot_runner.measuring.measured_machine import host_findings, machine_clock
from robot_runner.measuring.parameter_checks import check_numbers
from robot_runner.measuring.utilisation import Doubt, Selection, Utilisation, means_over
from robot_runner.ros.graph_transport import is_hidden
from robot_runner.ros.link_opening import master_of
from robot_runner.ros.topic_statistics import robot_findings

_FIX = "Look at the graph, with `ros2 node list` or `rosnode list`, before you use this run."
_ROS1 = "ros1"

#: For the estimate of raw data: bytes of a sample and of each process's share of it; a mission's duration, s.
_SAMPLE_BYTES, _PROCESS_BYTES, _MISSION = 80, 20, 95.0
_GRAPH_BYTES = 10_000


class RosGraph(Profiler):
    """Counts the nodes and topics of the graph, and measures CPU and memory of the processes of chosen nodes.

    The graph is read when the measurement starts, and again when it stops; both states are recorded. The counts are of
    a moment, and have no value for a phase. On ROS 1 a node reports its process id. ROS 2 does not: there a process is
    found by the name that the node was given on its command line, as launch files do, or by the name of its program, if
    you give it.

    Args:
        nodes: the nodes to measure, by names that are relative to the robot's namespace unless they begin with `/`; or
            a mapping from these to the name of a program (`"component_container"`) or `pid:4711`.
        name: tells several instances apart; the class's name if left out.
        host: the computer that the nodes run on: `localhost`, or as for ssh (`pi@robot`).
        rate_hz: samples a second, Hz.
        ssh_config: a file to use in place of your ssh config.
        namespace: which robot's link is used, where there are several.

    Raises:
        PluginError: the rate is not positive, or names of nodes are not valid, or would share a column.

    Example:
        >>> [measure.name for measure in RosGraph(["/turtlebot3_node"]).measures]
        ['Nodes', 'Topics', 'CPU_turtlebot3_node', 'Memory_turtlebot3_node']
    """

    measures: Sequence[Measure] = (
        Measure("Nodes", "1", "Nodes on the graph when the measurement stops, this link's own among them."),
        Measure("Topics", "1", "Topics on the graph when the measurement stops, but those that ROS 2 hides."),
    )
    #: The nodes of an experiment are often started with its mission.
    probe_s: float | None = None
    needs: ClassVar[str] = "A robot that is reached over a graph; for nodes what PsUtil needs."

    def __init__(
        self,
        nodes: Sequence[str] | Mapping[str, str] = (),
        *,
        name: str | None = None,
        host: str = LOCAL,
        rate_hz: float = 10.0,
        ssh_config: str | Path | None = None,
        namespace: str = "",
    ) -> None:
        super().__init__(name=name)
        check_numbers(self.name, rate_hz=rate_hz)
        self.nodes = _selectors(nodes, self.name)
        self.host = host
        self.rate_hz = rate_hz
        self.ssh_config = None if ssh_config is None else Path(ssh_config).expanduser()
        self.namespace = namespace
        # Columns are named by the nodes, however their processes are found.
        self.selection = Selection(tuple(f"node:{node}" for node in self.nodes))
        if len(set(self.selection.labels)) < len(self.nodes):
            fix = "Measure them with two plugins of different names."
            raise PluginError("two of the nodes would share a column", where=self.name, fix=fix)
        self.measures = (*type(self).measures, *self.selection.measures())
        line = _SAMPLE_BYTES + len(self.nodes) * _PROCESS_BYTES
        self.bytes_per_run = _GRAPH_BYTES + (round(line * rate_hz * _MISSION) if self.nodes else 0)
        self._sampler: UtilisationSampler | None = None
        self._utilisation: Utilisation | None = None
        self._begun_at = 0.0
        self._graphs: dict[str, Any] = {}
        self._is_simulated = False

    def claims(self, robot: str | None) -> Iterable[str]:
        """Return the claims: the computer whose processes are measured, if any."""
        del robot
        return (f"host:{self.host}",) if self.nodes else ()

    def check(self, circumstances: Circumstances) -> Iterable[Finding]:
        """Return findings: there is no robot, or processes of nodes cannot be reached."""
        findings = robot_findings(self.name, circumstances)
        if not self.nodes:
            return findings
        if is_simulated(circumstances.robot):
            problem = "the computer of a simulated robot does not report the processes of nodes"
            return [*findings, Finding.error(f"plugin {self.name}", problem, "Leave nodes out.")]
        reach = host_findings(
            self.name, circumstances.robot, host=self.host, ssh_config=self.ssh_config, has_selection=True
        )
        return [*findings, *reach]

    def start_run(self, context: RobotRunnerContext) -> None:
        """Connect, before the robot moves and before anything is measured."""
        self._sampler = self._utilisation = None
        self._graphs = {}
        self._is_simulated = False
        connect_robot(context, namespace=self.namespace)
        if self.nodes:
            link = self._computer(context)
            if isinstance(link, RemoteHost):
                link.connect()

    def start_measurement(self, context: RobotRunnerContext) -> None:
        """Read the graph, and begin to sample the processes of its nodes."""
        graph = self._look(context)
        if self.nodes:
            processes = self._processes(context, graph["nodes"])
            for node, label, process in zip(self.nodes, self.selection.labels, processes, strict=True):
                full, doubted = self._full_name(node, context), (f"CPU_{label}", f"Memory_{label}")
                if full not in graph["nodes"]:
                    context.doubt(f"node {full} is not on the graph", fix=_FIX, measures=doubted)
                # The command line of a node that is in no namespace tells nothing of that.
                alike = [each for each in graph["nodes"] if each != full and each.endswith(full)]
                if alike and process == f"node:{full}" and full.count("/") == 1:
                    problem = f"{full} cannot be told from {enumerated(alike)}: its CPU and memory are those of all"
                    context.doubt(problem, fix=f"Name its program: nodes={{{full!r}: ...}}.", measures=doubted)
            computer = self._computer(context)
            if not isinstance(computer, ProcessHost):
                fix = "Name the computer that the nodes run on in `host`."
                raise LinkError("this computer does not report single processes", where=self.name, fix=fix)
            self._begun_at = machine_clock(context).now()
            self._sampler = computer.sample_processes(self.rate_hz, processes)
            if isinstance(self._sampler, PromptSampler):
                context.times.at_edges(self._sampler.take_now)
        self._graphs["start"] = graph

    def stop_measurement(self, context: RobotRunnerContext) -> None:
        """End sampling, and read the graph again."""
        sampler, self._sampler = self._sampler, None
        if sampler is not None:
            samples, sampled = sampler.stop(), Window(self._begun_at, machine_clock(context).now())
            report = report_of(sampler, self.rate_hz)
            if report.clock_facts is not None:
                context.note_clock(report.clock_facts)
            self._utilisation = Utilisation(samples, sampled, self.selection, report, is_simulated=False)
        if self._graphs:
            self._graphs["stop"] = self._look(context)
            link = connect_robot(context, namespace=self.namespace)
            self._is_simulated = is_simulation(link, robot_namespace(context, self.namespace))

    def stop_run(self, context: RobotRunnerContext) -> None:
        """Write the graph, and the samples."""
        folder = context.raw_data_folder
        if self._graphs:
            text = json.dumps(self._graphs, indent=2, ensure_ascii=False)
            (folder / "graph.json").write_text(text + "\n", encoding="utf-8")
        if self._utilisation is not None:
            self._utilisation.write(folder, context.times.window(machine_clock(context)))

    def populate_run_data(self, context: RobotRunnerContext) -> None:
        """Publish the measures; no value for a node whose process was not seen."""
        graph = self._graphs.get("stop")
        if graph is None:
            context.doubt(NEVER_STARTED, fix=_FIX)
        origin = Origin.SIMULATED if self._is_simulated else Origin.MEASURED
        context.publish("Nodes", None if graph is None else len(graph["nodes"]), origin=origin)
        shown = None if graph is None else sum(not is_hidden(topic) for topic in graph["topics"])
        context.publish("Topics", shown, origin=origin)
        clock = machine_clock(context)
        self._doubt_processes(context, context.times.window(clock))
        evaluate, times = partial(means_over, self._utilisation), self._utilisation.times if self._utilisation else ()
        publish_measures(context, self.selection.measures(), evaluate, clock=clock, times=times)

    def _doubt_processes(self, context: RobotRunnerContext, mission: Window | None) -> None:
        if self._utilisation is None or mission is None:
            return
        measured = self._utilisation.over(mission)
        doubted = [measure.name for measure in self.selection.measures()]
        for each in (*measured.doubted(), *map(Doubt, measured.quality.warnings())):
            context.doubt(each.problem, fix=each.fix or _FIX, measures=each.measures or doubted)

    def _look(self, context: RobotRunnerContext) -> dict[str, Any]:
        link = connect_robot(context, namespace=self.namespace)
        nodes = [each for each in link.nodes() if not isinstance(link, AsksNodes) or link.answers(each)]
        return {"nodes": nodes, "topics": dict(link.topics()), "services": dict(link.services())}

    def _computer(self, context: RobotRunnerContext) -> HostLink:
        return connect_host(context, self.host, ssh_config=self.ssh_config)

    def _processes(self, context: RobotRunnerContext, present: Sequence[str]) -> list[str]:
        """Return the selector of each node's process; on ROS 1 by the process id that a node that is there reports."""
        name = None if context.robot is None else RobotName.parse(context.robot)
        master = None
        if name is not None and name.link == _ROS1:
            master = master_of({option: value for option, value in name.options.items() if option == "master"})
        chosen = []
        for node, selector in self.nodes.items():
            full = self._full_name(node, context)
            pid = master.pid_of(full) if master and full in present and selector.startswith("node:") else None
            by_name = f"node:{full}" if selector == f"node:{node}" else selector
            chosen.append(by_name if pid is None else f"pid:{pid}")
        return chosen

    def _full_name(self, node: str, context: RobotRunnerContext) -> str:
        return full_name(robot_namespace(context, self.namespace), node)


def _selectors(nodes: Sequence[str] | Mapping[str, str], where: str) -> dict[str, str]:
    if isinstance(nodes, str):
        raise PluginError(f"nodes is {nodes!r}", where=where, fix=f"Give a list: nodes=[{nodes!r}].")
    chosen = dict(nodes) if isinstance(nodes, Mapping) else {node: f"node:{node}" for node in nodes}
    try:
        for node in chosen:
            full_name("", node)
        return {node: process_selector(selector) for node, selector in chosen.items()}
    except LinkError as error:
        raise PluginError(error.problem, where=f"{where}, nodes", fix=error.fix) from error
