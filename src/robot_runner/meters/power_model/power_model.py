"""The profiler that estimates power without a meter."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from robot_runner.core.errors import AnalysisError, Finding, PluginError, did_you_mean
from robot_runner.core.events.context import RobotRunnerContext
from robot_runner.core.events.measure import Measure, Origin, Over
from robot_runner.core.events.window import Window
from robot_runner.core.plugin import Circumstances, Profiler
from robot_runner.core.storage.input_files import InputFile, input_file
from robot_runner.measuring.evaluation import publish_measures
from robot_runner.measuring.quality import MINIMUM_COVERAGE, Column, write_quality, write_samples
from robot_runner.meters.power_model.linear_power_model import LinearModel, read_model
from robot_runner.meters.power_model.measured_runs import read_runs
from robot_runner.meters.power_model.states import RobotState, Sources, read_states

#: From the state of the robot to the power that it draws, W.
PowerFunction = Callable[[RobotState], float | None]

#: By plugin that a model may read from, the terms that need it.
_TERMS = {
    "utilisation": ("cpu", "memory", "frequency", "cycles"),
    "phases": ("has_moved", "motion", "task"),
    "frequency": ("frequency", "cycles"),
    "network": ("network",),
    "gpu": ("gpu",),
}
#: The measures whose doubts are about what is read, where the plugin has others as well: those of processes.
_MEASURES = {"utilisation": ("CPU", "Memory")}
_FIX = "Fit one: robot-runner fit-power-model EXPERIMENT --out power_model.json."


@dataclass(frozen=True, slots=True)
class _Estimate:
    """The power of each piece of the window; None where it is unknown."""

    states: Sequence[RobotState]
    watts: Sequence[float | None]
    window: Window

    @property
    def coverage(self) -> float:
        known = math.fsum(state.seconds for state, watts in self._known())
        return 100.0 * known / self.window.duration if self.window.duration else 0.0

    def mean_power(self) -> float | None:
        known = self._known()
        seconds = math.fsum(state.seconds for state, _ in known)
        if self.coverage < MINIMUM_COVERAGE or not seconds:
            return None
        return math.fsum(watts * state.seconds for state, watts in known) / seconds

    def _known(self) -> list[tuple[RobotState, float]]:
        pairs = zip(self.states, self.watts, strict=True)
        return [(state, watts) for state, watts in pairs if watts is not None]

    def write(self, folder: Path) -> None:
        known = self._known()
        columns = (
            Column("start_s", [state.start for state, _ in known]),
            Column("end_s", [state.end for state, _ in known]),
            Column("power_W", [watts for _, watts in known], "%.4f"),
        )
        write_samples(folder / "estimates.csv", columns)


class PowerModel(Profiler):
    """Estimates the energy that a robot draws from its utilisation, its motion and its task.

    It reads the samples of other plugins of the same run, and measures nothing itself; its values are labelled as
    estimated. Give it one of `model`, `coefficients` and `function`.

    Args:
        name: distinguishes several models; None for the class's name.
        model: a file written by `robot-runner fit-power-model`.
        coefficients: W for each term: `constant`, `cpu`, `memory` and `gpu` (for each percent), `has_moved`,
            `motion:<phase>`, `task:<task>`, `frequency:<MHz>` (for each core that is busy at it), `cycles` (for each
            GHz), `network` (for each MB/s).
        function: from the state of the robot (`RobotState`) to the power in W; it returns None for unknown power.
        utilisation: the plugin that samples CPU and memory; None for none.
        phases: the plugin that records the phases of the mission; None for none.
        frequency: the plugin that samples the frequency of each core, for models with `frequency:<MHz>` or `cycles`.
        network: the plugin that counts network traffic, for models with `network`.
        gpu: the plugin that samples the GPUs, for models with `gpu`.

    Raises:
        PluginError: none or several of model, coefficients and function are given, or a term is not known.

    Example:
        >>> estimate = PowerModel(coefficients={"constant": 7.6, "cpu": 0.02, "motion:forward": 2.5})
        >>> estimate.measures[0].unit
        'J'
    """

    measures: Sequence[Measure] = (
        Measure("Energy", "J", "Energy over the measured window, estimated by a power model.", over=Over.SUM),
        Measure("MeanPower", "W", "Mean power over the measured window, estimated by a power model.", over=Over.MEAN),
    )
    #: No probe: it needs the states of a mission.
    probe_s: float | None = None
    needs: ClassVar[str] = "A power model (robot-runner fit-power-model), and the plugins whose samples it reads."
    bytes_per_run: int = 60_000  # a line of 35 bytes for each of the 10 samples a second of a mission of 95 s

    def __init__(  # noqa: PLR0913 - one keyword for each plugin that it may read from
        self,
        *,
        name: str | None = None,
        model: str | Path | None = None,
        coefficients: Mapping[str, float] | None = None,
        function: PowerFunction | None = None,
        utilisation: str | None = "PsUtil",
        phases: str | None = "BasicTurtlebot3",
        frequency: str | None = "LinuxThermal",
        network: str | None = "Network",
        gpu: str | None = "Nvml",
    ) -> None:
        super().__init__(name=name)
        given = [each for each in (model, coefficients, function) if each is not None]
        if len(given) != 1:
            problem = f"{len(given) or 'none'} of model, coefficients and function are given"
            raise PluginError(problem, where=self.name, fix="Give it one of them. " + _FIX)
        self._named = None if model is None else Path(model)
        self.model = None if self._named is None else input_file(self._named)
        self.function = function
        plugins = (utilisation, phases, frequency, network, gpu)
        self.plugins: Mapping[str, str | None] = dict(zip(_TERMS, plugins, strict=True))
        self._linear = None if coefficients is None else LinearModel(dict(coefficients))

    @classmethod
    def fit(  # noqa: PLR0913 - one keyword for each plugin that it may read from
        cls,
        experiment: Path,
        run_ids: Sequence[str],
        *,
        power: str = "Ina219",
        utilisation: str | None = "PsUtil",
        phases: str | None = "BasicTurtlebot3",
        frequency: str | None = None,
        network: str | None = None,
        gpu: str | None = None,
        terms: Sequence[str] | None = None,
    ) -> dict[str, Any]:
        """Return the content of a file for `model`: least-squares coefficients from measured runs of an experiment.

        Args:
            experiment: the experiment's folder.
            run_ids: the runs to fit on.
            power: the plugin that measured power.
            utilisation: the plugin that sampled CPU and memory; None for none.
            phases: the plugin that recorded the phases; None for none.
            frequency: the plugin that sampled the frequency of each core; None for none.
            network: the plugin that counted network traffic; None for none.
            gpu: the plugin that sampled the GPUs; None for none.
            terms: the terms of the model; None for all that occur.

        Raises:
            AnalysisError: no run can be used, or some of the terms are collinear.
            PluginError: there is no such term.
        """
        try:
            from robot_runner.meters.power_model.fitting import fit_model, terms_of  # noqa: PLC0415 - an extra
        except ModuleNotFoundError as error:
            fix = "Install it: pip install 'robot-runner[analysis]'."
            problem = f"fitting needs {error.name}, which is not installed"
            raise AnalysisError(problem, where=cls.__name__, fix=fix) from error
        sources = Sources(utilisation=utilisation, phases=phases, frequency=frequency, network=network, gpu=gpu)
        runs, left_out = read_runs(experiment, power, sources, run_ids)
        chosen = terms_of(runs, sources) if terms is None else terms
        fitted = fit_model(runs, chosen, experiment=experiment.name, power=power, left_out=left_out)
        return fitted.as_json()

    def claims(self, robot: str | None) -> Iterable[str]:
        """Return no claims, as it only computes from the samples of other plugins."""
        del robot
        return ()

    def input_files(self) -> Iterable[InputFile]:
        """Return the file of the model, if one is given."""
        return [] if self._named is None else [InputFile(self._named)]

    def check(self, circumstances: Circumstances) -> Iterable[Finding]:
        """Return errors: the model cannot be read, or a plugin with samples for its terms is missing."""
        where = f"plugin {self.name}"
        try:
            linear = self._read()
        except PluginError as error:
            return [Finding.error(where, f"{error.where}: {error.problem}", error.fix)]
        names = list(circumstances.listed) or [plugin.name for plugin in circumstances.plugins]
        needed = self._needed(linear).values()
        wanted = [each for each in needed if each is not None and names and each not in names]
        findings = []
        for each in wanted:
            problem = f"the model reads the samples of {each!r}, which is not among the plugins"
            fix = f"Add it to the plugins. {did_you_mean(each, names, otherwise='')}".rstrip()
            findings.append(Finding.error(where, problem, fix))
        return findings

    def start_run(self, context: RobotRunnerContext) -> None:
        """Make its values doubtful where those are from which they are computed."""
        with suppress(PluginError):  # reported with the estimate
            for kind, plugin in self._needed(self._read()).items():
                if plugin is not None:
                    context.broker.derive(self.name, plugin, _MEASURES.get(kind, ()))

    def populate_run_data(self, context: RobotRunnerContext) -> None:
        """Estimate, now that all other plugins have written their samples; no value if they cover too little."""
        if context.window is None:
            context.doubt("nothing was estimated: there was no mission")
        else:
            self._report(context, context.window)
        publish_measures(
            context, self.measures, lambda window: self._evaluated(context, window), origin=Origin.ESTIMATED
        )

    def _evaluated(self, context: RobotRunnerContext, window: Window) -> Mapping[str, float | None]:
        try:
            mean = self._estimate(context, window).mean_power()
        except (AnalysisError, PluginError):  # `_report` has reported it
            return {}
        return {"Energy": None if mean is None else mean * window.duration, "MeanPower": mean}

    def _estimate(self, context: RobotRunnerContext, window: Window) -> _Estimate:
        """Return the power of each piece of a window; an `AnalysisError` or a `PluginError` says why it is unknown."""
        linear = self._read()
        states = read_states(context.run_path, window, Sources(**self._needed(linear, context.run_path)))
        return _Estimate(states, [self._power(linear, state) for state in states], window)

    def _report(self, context: RobotRunnerContext, window: Window) -> None:
        """Write the estimates of the mission, and report doubts about them."""
        try:
            estimate, linear = self._estimate(context, window), self._read()
        except (AnalysisError, PluginError) as error:
            context.doubt(f"nothing was estimated: {error.where}: {error.problem}", fix=error.fix)
            return
        needed = self._needed(linear)
        utilisation, phases = needed.get("utilisation"), needed.get("phases")
        estimate.write(context.raw_data_folder)
        details = {"coverage_percent": estimate.coverage, "utilisation": utilisation, "phases": phases}
        write_quality(context.raw_data_folder / "quality.json", None, window, details)
        if linear is not None:
            self._keep(context, linear, estimate)
        if estimate.mean_power() is None:
            context.doubt(
                f"nothing was estimated: samples cover {estimate.coverage:.1f} % of the measured window",
                fix=f"Look at the samples of {' and '.join(each for each in (utilisation, phases) if each)}.",
            )

    def _keep(self, context: RobotRunnerContext, linear: LinearModel, estimate: _Estimate) -> None:
        """Write the model beside the estimates, and doubt them where the mission is outside of the range of the fit."""
        text = json.dumps(linear.as_json(), indent=2, ensure_ascii=False) + "\n"
        (context.raw_data_folder / "model.json").write_text(text, encoding="utf-8")
        for doubt in linear.doubts(estimate.states):
            context.doubt(doubt, fix="Fit the model on runs in which the robot does what it does here.")

    def _read(self) -> LinearModel | None:
        """Return the linear model, or None if there is a function instead."""
        return read_model(self.model) if self.model is not None else self._linear

    def _needed(self, linear: LinearModel | None, run_folder: Path | None = None) -> dict[str, str | None]:
        """Return the plugins to read; for a function, those of the computer's parts that have samples in the run."""

        def is_needed(kind: str, plugin: str | None) -> bool:
            if linear is not None:
                return linear.needs(*_TERMS[kind])
            is_there = plugin and run_folder and (run_folder / plugin / "samples.csv").is_file()
            return kind in {"utilisation", "phases"} or bool(is_there)

        return {kind: plugin for kind, plugin in self.plugins.items() if is_needed(kind, plugin)}

    def _power(self, linear: LinearModel | None, state: RobotState) -> float | None:
        if self.function is not None:
            return _checked(self.function, state)
        return linear.power(state) if linear is not None else None


def _checked(function: PowerFunction, state: RobotState) -> float | None:
    """Return the result of a user's function for a state; a `PluginError` if it raises, or returns no power."""
    where, fix = getattr(function, "__name__", "function"), "Have the function return watts, or None."
    try:
        watts = function(state)
    except Exception as error:
        problem = f"the function raised {type(error).__name__}: {error}, given {state}"
        raise PluginError(problem, where=where, fix=fix) from error
    if watts is not None and not (isinstance(watts, int | float) and math.isfinite(watts)):
        raise PluginError(f"the function returned {watts!r}, given {state}", where=where, fix=fix)
    return watts
