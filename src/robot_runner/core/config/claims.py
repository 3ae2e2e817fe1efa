"""Claims of runs: runs that would disturb each other never overlap.

A claim is a text: `host:localhost` is this machine, its processor, memory and energy; `robot:ros2`, `host:pi@robot`,
`serial:/dev/ttyUSB0` and `device:camera 0` name what their plugins use. A plugin or config without declared claims
claims the whole machine.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from itertools import islice, product
from math import ceil
from pathlib import Path
from typing import Any

from robot_runner.core.config.parameters import Parameters, RunProcess
from robot_runner.core.config.plugin_checks import failed_check
from robot_runner.core.design.run_table_model import RunTableModel
from robot_runner.core.errors import Finding, LinkError, PluginError
from robot_runner.core.events.manager import RUN_EVENTS, EventManager
from robot_runner.core.events.measure import CONFIG_OWNER
from robot_runner.core.links.connect import is_simulated, robot_on_graph
from robot_runner.core.plugin import THIS_MACHINE, Plugin, System, with_parts
from robot_runner.core.treatments import built_with, factors_of, values_of
from robot_runner.core.words import counted, enumerated

#: Where plugins have more different treatments than this, the claims of the first ones stand for all.
_LOOKED_AT = 200


def usable_cores(system: Path = Path("/")) -> int:
    """Return how many cores this process may use: those of its affinity, and no more than its control groups allow.

    A container or a job of a cluster often sees all cores of its machine, but may use the time of a few (`--cpus=2`).
    """
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1  # macOS
    return max(1, min([cores, *(ceil(each) for each in _quotas(system))]))


def _quotas(system: Path) -> Iterator[float]:
    """Yield how much processor time, s a second, this process's control group and those above it are allowed.

    The files are those of `man 7 cgroups` and of the kernel's admin-guide/cgroup-v2 and scheduler/sched-bwc.
    """
    with suppress(OSError, ValueError):  # not Linux
        for line in (system / "proc/self/cgroup").read_text(encoding="utf-8").splitlines():
            _, controllers, path = line.split(":", 2)
            if controllers and "cpu" not in controllers.split(","):
                continue
            mounts = ("sys/fs/cgroup/" + controllers,) if controllers else ("sys/fs/cgroup", "sys/fs/cgroup/unified")
            # In a container, the path may be that of its host, and not exist: then the mount itself is its group.
            for mount, group in product(mounts, (Path(path.lstrip("/")), *Path(path.lstrip("/")).parents)):
                yield from _quota_of(system / mount / group)


def _quota_of(group: Path) -> Iterator[float]:
    with suppress(OSError, ValueError):  # not there, or "max"
        quota, period = (group / "cpu.max").read_text(encoding="ascii").split()
        yield int(quota) / int(period)
    with suppress(OSError, ValueError):
        quota = (group / "cpu.cfs_quota_us").read_text(encoding="ascii")
        if int(quota) > 0:  # -1 where there is none
            yield int(quota) / int((group / "cpu.cfs_period_us").read_text(encoding="ascii"))


def worker_count(parameters: Parameters) -> int:
    """Return how many runs may be in flight on this machine at the same time, claims aside."""
    if parameters.run_process is RunProcess.IN_PROCESS:
        return 1
    return usable_cores() if parameters.workers == "auto" else int(parameters.workers)


class Claims:
    """The claims of the runs of an experiment, and the plugins, or the config, that make each.

    Plugins with bound parameters may have others in each run; a config without callbacks in a run claims nothing.
    """

    def __init__(self, parameters: Parameters, plugins: Sequence[Plugin], events: EventManager) -> None:
        self._parameters = parameters
        #: How the robots of the runs are reached: one, or those that take turns.
        self._reached = tuple(parameters.robots.values()) or (parameters.robot,)
        self._plugins = plugins
        self._of_config = tuple(_of_config(parameters, events))
        self._known: dict[tuple[object, ...], tuple[str, ...]] = {}

    def of(self, combination: Mapping[str, Any], robot: str | None = None) -> dict[str, list[str]]:
        """Return the claims of a run with these treatments, each with the names of the plugins that make it.

        `robot` is how its robot is reached; None for the experiment's, or the first one of those that take turns.
        """
        claims: dict[str, list[str]] = {claim: [CONFIG_OWNER] for claim in self._of_config}
        for plugin in self._plugins:
            for claim in self._of_plugin(plugin, combination, robot or self._reached[0]):
                claims.setdefault(claim, []).append(plugin.name)
        return claims

    def common(self, combinations: Iterable[Mapping[str, Any]]) -> dict[str, list[str]]:
        """Return the claims that all of these runs have in common: if there is one, they never overlap."""
        common: dict[str, list[str]] | None = None
        for combination, robot in product(self._apart(combinations), self._reached):
            claims = self.of(combination, robot)
            common = claims if common is None else {name: who for name, who in common.items() if name in claims}
        return common or {}

    def against_others(self, combinations: Iterable[Mapping[str, Any]]) -> frozenset[str]:
        """Return the claims of these runs against other experiments: declared ones, and real robots.

        The default claim on the whole machine only keeps runs of this experiment apart. On a cluster, claims are about
        other machines, except that on the robot.
        """
        chosen = [*islice(self._apart(combinations), _LOOKED_AT)]
        found = {claim for combination in chosen for claim in self._declared(combination)}
        here = found | {f"host:{host.address}" for host in self._parameters.hosts.values() if not host.is_local}
        here.update(self._parameters.claims or ())
        declared = () if self._parameters.cluster is not None else map(_spelt_alike, here)
        return frozenset((*self.robots(chosen), *declared))

    def of_run_against_others(self, combination: Mapping[str, Any], model: RunTableModel) -> frozenset[str]:
        """Return those claims that no run has which is in flight beside this one.

        The experiment is as its place has it. Runs with one robot never overlap, whatever namespaces plugins name.
        """
        plan = [*islice(self._apart(run.combination for run in model.plan()), _LOOKED_AT)]
        return self.against_others([combination]).union(self.robots(plan))

    def _apart(self, combinations: Iterable[Mapping[str, Any]]) -> Iterator[Mapping[str, Any]]:
        """Yield the first of the combinations that give plugins the same treatments."""
        factors = {factor for plugin in self._plugins for factor in factors_of(plugin).values()}
        seen: dict[tuple[int, ...], list[Any]] = {}
        for combination in combinations if factors else islice(combinations, 1):
            treatments = [combination.get(factor) for factor in factors]
            # Runs share their treatments, which need not be hashable; those that are seen are kept, and so their ids.
            if seen.setdefault(tuple(map(id, treatments)), treatments) is treatments:
                yield combination

    def _declared(self, combination: Mapping[str, Any]) -> Iterator[str]:
        for plugin in self._plugins:
            measures_computer = getattr(plugin, "measured_computer", None) is not None
            if measures_computer or type(plugin).claims is not Plugin.claims:
                for robot in self._reached:
                    yield from self._of_plugin(plugin, combination, robot)

    def robots(self, combinations: Sequence[Mapping[str, Any]]) -> Iterator[str]:
        """Yield the claims on the real robots of runs, each by its graph and the namespaces that plugins name there.

        So one robot has one claim, however it is reached, and whether its namespace is in its link or in a plugin.
        """
        links = [link for link in self._parameters.links if not is_simulated(link)]
        namespaces = self._namespaces(combinations) if links else set()
        for link in links:
            with suppress(LinkError):  # reported by the check of the robot
                robot = f"robot:{robot_on_graph(link)}"
                yield from (f"{robot}/{each}".rstrip("/") for each in namespaces)

    def _namespaces(self, combinations: Sequence[Mapping[str, Any]]) -> set[str]:
        """Return the namespaces that plugins, and their parts, have in any of these runs.

        An empty one is the robot's own, where a system or else callbacks operate it; a profiler may be about any other.
        """
        found: set[str] = set()
        is_operated = False
        for plugin in self._plugins:
            apart = {str(values_of(plugin, each)): each for each in combinations}
            for combination in apart.values():
                with suppress(Exception):  # treatments that it does not take fail their run
                    for part in with_parts([built_with(plugin, combination)]):
                        own, is_system = getattr(part, "namespace", None), isinstance(part, System)
                        if own or (own is not None and is_system):
                            found.add(str(own).strip("/"))
                            is_operated = is_operated or is_system
        return found if is_operated else found | {""}

    def _of_plugin(self, plugin: Plugin, combination: Mapping[str, Any], robot: str | None) -> tuple[str, ...]:
        treatments = values_of(plugin, combination) if factors_of(plugin) else {}
        key = (plugin.name, robot, *(f"{name}={value}" for name, value in treatments.items()))
        if key not in self._known:
            try:
                claimed = built_with(plugin, combination).claims(robot)
                self._known[key] = (claimed,) if isinstance(claimed, str) else tuple(map(str, claimed))
            except (Exception, SystemExit) as error:
                refused = failed_check(f"plugin {plugin.name}", error, "claims", plugin)
                raise PluginError(refused.problem, where=refused.where, fix=refused.fix) from error
        return self._known[key]


def _of_config(parameters: Parameters, events: EventManager) -> Iterator[str]:
    """Yield the claims of the config: its robot, its hosts, and its `claims`, or this machine if it has none.

    The values that a config returns of a run with the simulated robot are labelled as simulated, and need no machine.
    """
    robot = parameters.robot
    if robot is not None and not (parameters.robots or is_simulated(robot)):  # of several, its place claims one
        yield f"robot:{robot}"
    for host in parameters.hosts.values():
        yield THIS_MACHINE if host.is_local else f"host:{host.address}"
    if parameters.claims is not None:
        yield from parameters.claims
    elif not is_simulated(robot) and any(each.owner == CONFIG_OWNER for each in events.subscribers(*RUN_EVENTS)):
        yield THIS_MACHINE


def _spelt_alike(claim: str) -> str:
    """Return a claim on a robot by graph and namespace, as others are, where it names it as a config does.

    Example:
        >>> _spelt_alike("robot:dds:domain=7,namespace=bob"), _spelt_alike("robot:bob")
        ('robot:domain 7/bob', 'robot:bob')
    """
    kind, _, robot = claim.partition(":")
    with suppress(LinkError, PluginError):  # a name of one's own, or a link that is reported elsewhere
        if kind == "robot" and not is_simulated(robot):
            return f"robot:{robot_on_graph(robot)}"
    return claim


def declared_for_callbacks(parameters: Parameters, events: EventManager) -> list[str]:
    """Return the `claims` of a config; where it has none, those that it has without saying so."""
    if parameters.claims is not None:
        return [*parameters.claims]
    return [claim for claim in _of_config(parameters, events) if claim == THIS_MACHINE]


def held_claims(claims: Claims, model: RunTableModel) -> frozenset[str]:
    """Return the claims of an experiment of this design against others."""
    return claims.against_others(run.combination for run in model.plan())


def check_workers(
    where: str, parameters: Parameters, plugins: Sequence[Plugin], events: EventManager, model: RunTableModel | None
) -> list[Finding]:
    """Return a warning if several workers, or robots that take turns, would be idle because of claims."""
    if model is None:
        return []
    what, names = ("robot", "robot") if parameters.robots else ("worker", "workers")
    place, count = f"{where}.{names}", len(parameters.robots) or worker_count(parameters)
    claims = Claims(parameters, plugins, events)
    try:
        held_claims(claims, model)
        common = claims.common(run.combination for run in model.plan()) if count > 1 else {}
    except (Exception, SystemExit) as error:  # noqa: BLE001 - a stranger's code; what it raises is a finding like others
        return [failed_check(f"{where}.plugins", error, "asking plugins for their claims")]
    alone = "let the robots drive one after another" if parameters.robots else "leave workers at 1"
    if parameters.run_process is RunProcess.IN_PROCESS and (parameters.robots or parameters.workers != 1):
        problem = f"run_process is IN_PROCESS: the orchestrator executes one run at a time, and other {what}s are idle"
        return [Finding.warning(place, problem, f"Leave run_process out, or {alone}.")]
    if not common:
        return []
    told = "; ".join(f"{claim} is claimed by {enumerated(who)}" for claim, who in common.items())
    problem = f"{counted(count - 1, what)} of {count} will be idle, as two runs with one claim never overlap: {told}"
    return [Finding.warning(place, problem, f"{alone.capitalize()}.{_fix(common)}")]


def _fix(common: Mapping[str, Sequence[str]]) -> str:
    fix = ""
    if any(CONFIG_OWNER in who for claim, who in common.items() if claim == THIS_MACHINE):
        fix += " Where the config's callbacks neither measure this machine nor keep it busy, say claims = []."
    if any(who != [CONFIG_OWNER] for who in common.values()):
        fix += " A plugin that needs nothing for itself says so in its method claims."
    return fix
