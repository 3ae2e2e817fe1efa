"""A smoke test of an experiment: one run of each treatment, as short as possible, and its result."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from robot_runner.core.config.experiment import Experiment
from robot_runner.core.config.loader import LoadedConfig, own_parameters
from robot_runner.core.config.parameters import PARAMETERS, OperationType
from robot_runner.core.design.planned_runs import PlannedRun
from robot_runner.core.errors import Finding, PluginError, did_you_mean
from robot_runner.core.execution.durations import Durations, Estimate, durations_of
from robot_runner.core.execution.known_durations import CombinationKey, combination_key
from robot_runner.core.late_annotations import signature_of
from robot_runner.core.links.connect import is_simulated
from robot_runner.core.links.declared_host import Host, Reboot
from robot_runner.core.plugin import Plugin
from robot_runner.core.storage.journal import read_journal
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.treatments import give_again, given_to
from robot_runner.core.words import counted, enumerated, listed, shown_treatment


def covering_runs(plan: Sequence[PlannedRun]) -> list[PlannedRun]:
    """Return few runs among which each treatment of each factor is, in their order.

    The next one is always that which has most treatments that no other has yet (greedy set cover, which needs at most
    a logarithmic factor more than the fewest: Chvatal, Math. Oper. Res. 4, 1979).
    """
    first: dict[CombinationKey, PlannedRun] = {}
    for run in plan:
        first.setdefault(combination_key(run.combination), run)
    left = set().union(*first) if first else set()
    chosen: list[PlannedRun] = []
    while left:
        best = max(first, key=lambda pairs: len(pairs & left))
        chosen.append(first[best])
        left -= best
    return sorted(chosen, key=lambda run: run.number) or list(plan[:1])


@dataclass(slots=True)
class Shortening:
    """The parameters that were set so that a smoke test is quick.

    Attributes:
        parameters: of plugins, as they were given: `BasicTurtlebot3.task_s = 2.0`.
        attributes: of the config, static parameters among them, as they were set.
        left_out: what the study does and the smoke test does not.
        missions: the plugins whose part of a run is shorter than in the study.
    """

    parameters: list[str] = field(default_factory=list)
    attributes: list[str] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)
    missions: list[str] = field(default_factory=list)


def shortened_loader(
    load: Callable[[Path, Mapping[str, str]], LoadedConfig], folder: Path, told: Shortening
) -> Callable[[Path, Mapping[str, str]], LoadedConfig]:
    """Return a loader as `load` that shortens the config, notes that in `told`, and has results in `folder`."""

    def shortened(path: Path, overrides: Mapping[str, str]) -> LoadedConfig:
        loaded = load(path, overrides)
        config, findings = loaded.config, list(loaded.findings)
        wishes = getattr(config, "smoke", {})
        wishes = dict(wishes) if isinstance(wishes, dict) else {}  # what else it may be is found by validation
        _leave_out(config, wishes, told)
        plugins = _plugins(loaded)
        # The embedded robot's time goes by as fast as the physics can: there is nothing to be gained there.
        robot = getattr(config, "robot", None)
        is_slow = not (isinstance(robot, str) and is_simulated(robot))
        for plugin in plugins:
            prefix = f"{_name_of(plugin)}."
            asked = {name.removeprefix(prefix): value for name, value in wishes.items() if name.startswith(prefix)}
            _shorten_plugin(plugin, {**(dict(_own_wishes(plugin)) if is_slow else {}), **asked}, told, findings)
        findings += _set_attributes(config, wishes, plugins, told)
        config.results_output_path = folder
        named = loaded.folder.root.name if loaded.folder is not None else None
        own = ExperimentFolder(folder / named) if named is not None else None
        return replace(loaded, findings=tuple(findings), folder=own)

    return shortened


def _leave_out(config: Any, wishes: Mapping[str, Any], told: Shortening) -> None:
    """Leave out what only costs time, unless the config wishes otherwise."""
    if getattr(config, "time_between_runs_in_ms", 0) and "time_between_runs_in_ms" not in wishes:
        config.time_between_runs_in_ms = 0
        told.left_out.append("the rests between two runs")
    if getattr(config, "operation_type", None) is OperationType.SEMI and "operation_type" not in wishes:
        config.operation_type = OperationType.AUTO
        told.left_out.append("the operator's share between two runs")
    hosts = getattr(config, "hosts", {})
    if isinstance(hosts, dict) and "hosts" not in wishes:
        restarted = [name for name, host in hosts.items() if isinstance(host, Host) and host.reboot != Reboot.NEVER]
        if restarted:
            config.hosts = {**hosts, **{name: replace(hosts[name], reboot=Reboot.NEVER) for name in restarted}}
            told.left_out.append(f"restarting {enumerated(restarted)}")


def _plugins(loaded: LoadedConfig) -> list[Plugin]:
    """Return the plugins of a config; those that import lines activated are made, so that they can be shortened."""
    listed_ones = getattr(loaded.config, "plugins", ())
    plugins = list(listed_ones) if isinstance(listed_ones, list | tuple) else []
    for kind in loaded.activated:
        if not any(isinstance(plugin, kind) for plugin in plugins):
            with suppress(Exception):  # validation says why it cannot be made
                plugins.append(kind())
                loaded.config.plugins = plugins
    return plugins


def _name_of(plugin: Any) -> str:
    return str(given_to(plugin).get("name") or type(plugin).__name__)  # one that waits for treatments has no attributes


def _shorten_plugin(plugin: Any, changed: Mapping[str, Any], told: Shortening, findings: list[Finding]) -> None:
    named = _name_of(plugin)
    if not changed:
        return
    try:
        give_again(plugin, changed)
    except PluginError as error:
        findings.append(Finding.error(f"smoke, plugin {named}", error.problem, error.fix))
        return
    except Exception as error:  # noqa: BLE001 - a stranger's code
        problem = f"the plugin cannot be built with {dict(changed)}: {type(error).__name__}: {error}"
        findings.append(Finding.error(f"smoke, plugin {named}", problem, "Give it other values."))
        return
    told.parameters += [f"{named}.{name} = {value!r}" for name, value in changed.items()]
    told.missions.append(named)


def _own_wishes(plugin: Any) -> Iterator[tuple[str, float]]:
    """Yield the parameters that a plugin proposes for smoke tests, where they are less than its own."""
    signature = signature_of(type(plugin)).parameters
    given = given_to(plugin)
    for name, value in plugin.smoke_parameters.items():
        present = given.get(name, signature[name].default if name in signature else None)
        if isinstance(present, int | float) and not isinstance(present, bool) and value < present:
            yield name, value


def _set_attributes(
    config: Any, wishes: Mapping[str, Any], plugins: Sequence[Any], told: Shortening
) -> Iterator[Finding]:
    names = set(map(_name_of, plugins))
    known = [*PARAMETERS, *own_parameters(type(config))]
    for name, value in wishes.items():
        if name.partition(".")[0] in names:
            continue
        if name in {"results_output_path", "smoke"} or (name not in known and "." not in name):
            fix = did_you_mean(name, [*known, *names])
            yield Finding.error(f"smoke[{name!r}]", "the config has nothing of this name", fix)
        elif "." in name:
            fix = did_you_mean(name.partition(".")[0], names) or "List the plugin in `plugins`."
            yield Finding.error(f"smoke[{name!r}]", "the config has no plugin of this name", fix)
        else:
            setattr(config, name, value)
            told.attributes.append(f"{name} = {value!r}")


# What it has proved.


@dataclass(frozen=True, slots=True)
class SmokeResult:
    """The result of a smoke test.

    Attributes:
        treatments: the treatments that were executed well, in words, by factor.
        without: those of which no run ended well, by factor.
        with_values: the measures that had a plausible value in each run that ended well.
        without_values: the measures that had none in some run, and in how many.
        doubtful: the measures with values that may not be true, with the first reason.
        not_proved: what the study has and the smoke test had not.
        seconds: of each run that ended well, s, by id.
    """

    treatments: Mapping[str, Sequence[str]]
    without: Mapping[str, Sequence[str]]
    with_values: Sequence[str]
    without_values: Mapping[str, int]
    doubtful: Mapping[str, str]
    failures: Mapping[str, str]
    not_proved: Sequence[str]
    seconds: Mapping[str, float]


def result_of(
    experiment: Experiment, plan: Sequence[PlannedRun], chosen: Sequence[PlannedRun], told: Shortening
) -> SmokeResult:
    """Read the results of a smoke test's runs from its folder; `plan` are all runs of the study."""
    ends = {record["run"]: record for record in read_journal(experiment.folder.journal, kinds={"attempt_finished"})}
    done = [run for run in chosen if ends.get(run.run_id, {}).get("status") == "done"]
    missing: dict[str, int] = {}
    doubtful: dict[str, str] = {}
    for name in (column.name for column in experiment.columns.in_table if not column.tells_of):
        values = [(run.run_id, ends[run.run_id]["measures"].get(name, {})) for run in done]
        missing[name] = sum(each.get("value") is None for _, each in values)
        for run_id, each in values:
            if each.get("value") is not None and each.get("doubts"):
                doubtful.setdefault(name, f"{run_id}: {'; '.join(each['doubts'])}")
    executed, wanted = _by_factor(done), _by_factor(plan)
    return SmokeResult(
        treatments=executed,
        without={
            name: left
            for name, each in wanted.items()
            if (left := [treatment for treatment in each if treatment not in executed.get(name, ())])
        },
        with_values=[name for name, count in missing.items() if not count and name not in doubtful and done],
        without_values={name: count for name, count in missing.items() if count},
        doubtful=doubtful,
        failures={run: end["failure"] or "" for run, end in ends.items() if end["status"] == "failed"},
        not_proved=list(_not_proved(experiment, plan, chosen, told)),
        seconds={run.run_id: float(ends[run.run_id]["seconds"]) for run in done},
    )


def _by_factor(runs: Sequence[PlannedRun]) -> dict[str, list[str]]:
    found: dict[str, dict[str, None]] = {}
    for run in runs:
        for name, treatment in run.combination.items():
            found.setdefault(name, {})[shown_treatment(treatment)] = None
    return {name: list(each) for name, each in found.items()}


def _not_proved(
    experiment: Experiment, plan: Sequence[PlannedRun], chosen: Sequence[PlannedRun], told: Shortening
) -> Iterator[str]:
    combinations = {combination_key(run.combination) for run in plan}
    unseen = len(combinations) - len(chosen)
    if unseen > 0:
        yield f"{counted(unseen, 'combination')} of treatments that no run had together"
    if experiment.model.repetitions > 1:
        yield "that repetitions yield the same"
    if told.missions:
        yield f"whole missions: {enumerated(told.missions)} did less ({listed(told.parameters)})"
    yield from told.left_out
    yield f"that batteries, disks and people last for {counted(len(plan), 'run')}"


def study_estimate(
    study: Durations, experiment: Experiment, chosen: Sequence[PlannedRun], result: SmokeResult, told: Shortening
) -> Estimate:
    """Return how long the study takes; the durations of the smoke test are added to those of the `study`.

    Where missions were shortened, what the runs took beyond what plugins say of the shortened ones is added to what
    they say of the whole ones; where nobody says anything, nothing is learnt.
    """
    parts = (experiment.config, experiment.plugins, experiment.events, experiment.parameters)
    combinations = [run.combination for run in chosen]
    smoke = durations_of(*parts, combinations, experiment.folder.root / "nothing")
    for run in chosen:
        seconds = result.seconds.get(run.run_id)
        short, whole = smoke.declared_of(run.combination), study.declared_of(run.combination)
        if seconds is None or (told.missions and (short is None or whole is None)):
            continue
        study.learn(run.combination, seconds + ((whole or 0.0) - (short or 0.0) if told.missions else 0.0))
    estimate = study.estimate()
    if estimate.seconds is None or not told.attributes:
        return estimate
    longer = f"longer runs without {listed(told.attributes)}"
    return replace(estimate, is_least=True, unknown=(*estimate.unknown, longer))
