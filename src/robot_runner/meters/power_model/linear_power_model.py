"""A linear model of power, with a coefficient in watts for each term, and its file."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from robot_runner.core.errors import PluginError, did_you_mean

if TYPE_CHECKING:
    from robot_runner.meters.power_model.states import RobotState

FORMAT = "robot-runner power model 1"
#: Terms without a parameter; the others are `motion:<phase>`, `task:<task>` and `frequency:<MHz>`.
PLAIN_TERMS = ("constant", "cpu", "memory", "has_moved", "cycles", "network", "gpu")
_KINDS = ("motion", "task", "frequency")
#: How far a value may be outside of the range of the fit without a doubt, as a share of that range.
_TOLERANCE = 0.1


#: Curvature is doubted if chance explains it in fewer than one of 100 experiments, and it is more than this share of
#: the standard deviation of the modelled power.
_CHANCE = 0.01
_BENT = 0.1


@dataclass(frozen=True, slots=True, kw_only=True)
class Linearity:
    """The result of Ramsey's RESET of a model.

    Attributes:
        p_value: the probability of at least this curvature if the true model is linear.
        curvature_W: root mean square of the contribution of squares of the terms, and of squares and cubes of the
            modelled power, W.
        explained_W: standard deviation of the modelled power, W.
    """

    p_value: float
    curvature_W: float  # noqa: N815 - the unit is part of the name in the file
    explained_W: float  # noqa: N815 - the same

    def doubt(self) -> str | None:
        """Return the doubt about the model, or None."""
        if self.p_value >= _CHANCE or self.curvature_W <= _BENT * self.explained_W:
            return None
        p_value = "p < 0.001" if self.p_value < 0.001 else f"p = {self.p_value:.3f}"  # noqa: PLR2004 - as p is written
        bent = f"bending the model changes it by {self.curvature_W:.2f} W (root mean square; Ramsey's RESET, {p_value})"
        return f"power is not a weighted sum of these terms: {bent}"


@dataclass(frozen=True, slots=True, kw_only=True)
class FitReport:
    """The data, quality and uncertainty of a fit.

    Attributes:
        experiment: the name of the experiment.
        runs: of the fit.
        left_out: why other runs were left out, by run.
        power_source: the plugin that measured power.
        is_simulated: whether that was a simulated meter.
        pieces: the number of pieces of time of the fit.
        seconds: their total duration, s.
        r_squared: the share of the variance of power that the model explains, 0..1.
        residual_W: root mean square of measured less modelled power, weighted by time, W.
        standard_errors: of each coefficient, W; they allow for the correlation of the pieces of a run, and for
            differences between runs.
        energy_errors: the error of each run's energy, %, by a model that was fitted on the other runs.
        intervals: the 95 % confidence interval of each coefficient, W.
        correlation_lag: the number of pieces over which correlation was allowed for; None in a file of an earlier
            version.
        linearity: the test of linearity; None if every term is on or off.
    """

    experiment: str
    runs: Sequence[str]
    left_out: Mapping[str, str]
    power_source: str
    is_simulated: bool
    pieces: int
    seconds: float
    r_squared: float
    residual_W: float  # noqa: N815 - the unit is part of the name in the file
    standard_errors: Mapping[str, float]
    energy_errors: Mapping[str, float]
    intervals: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    correlation_lag: int | None = None
    linearity: Linearity | None = None


@dataclass(frozen=True, slots=True)
class LinearModel:
    """The sum of coefficient times value over the terms, W.

    Attributes:
        coefficients: W for each term; for `cpu`, `memory` and `gpu`, W for each percent; for `network`, W for each
            MB/s; for `frequency:<MHz>`, W for each core that is busy at it; for `cycles`, W for each GHz.
        ranges: the least and largest value of `cpu` and `memory` in the fit.
        report: of the fit; None for coefficients that were given by hand.

    Raises:
        PluginError: a term is not known, or a coefficient is not a finite number.

    Example:
        >>> from robot_runner.meters.power_model.states import RobotState
        >>> model = LinearModel({"constant": 7.6, "cpu": 0.02, "task:video": 1.0})
        >>> model.power(RobotState(0.0, 0.1, cpu=50.0, phase="task", task="video"))
        9.6
    """

    coefficients: Mapping[str, float]
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    report: FitReport | None = None

    def __post_init__(self) -> None:
        check_terms(self.coefficients)
        for term, watts in self.coefficients.items():
            if isinstance(watts, bool) or not isinstance(watts, int | float) or not math.isfinite(watts):
                problem = f"the coefficient of {term!r} is {watts!r}"
                raise PluginError(problem, where="power model", fix="Give a finite number of watts.")

    def power(self, state: RobotState) -> float | None:
        """Return the power in W, or None if the value of a term was not sampled."""
        total = 0.0
        for term, watts in self.coefficients.items():
            value = term_value(term, state)
            if value is None:
                return None
            total += watts * value
        return total

    def needs(self, *terms: str) -> bool:
        """Return whether the model has one of these terms; `motion` and `task` stand for all of their kind."""
        return any(term.partition(":")[0] in terms for term in self.coefficients)

    def doubts(self, states: Sequence[RobotState]) -> Iterator[str]:
        """Yield a sentence for each way in which these states are outside of the range of the fit."""
        if self.report is None:
            return
        if self.report.linearity is not None and (bent := self.report.linearity.doubt()):
            yield f"the power model does not fit: {bent}"
        for kind, met in (("motion", {state.motion for state in states}), ("task", {state.task for state in states})):
            unknown = sorted(name for name in met if name and f"{kind}:{name}" not in self.coefficients)
            if unknown and self.needs(kind):
                yield f"the power model was fitted on runs without the {kind} {', '.join(map(repr, unknown))}"
        for term, (low, high) in self.ranges.items():
            yield from _beyond(term, low, high, [term_value(term, state) for state in states])

    def as_json(self) -> dict[str, Any]:
        """Return the content of a model's file."""
        fit = asdict(self.report) if self.report else None
        if fit and self.report and self.report.linearity:
            fit["linearity"]["doubt"] = self.report.linearity.doubt()
        return {
            "format": FORMAT,
            "coefficients_W": dict(self.coefficients),
            "ranges_percent": {term: list(limits) for term, limits in self.ranges.items()},
            "fit": fit,
        }

    @classmethod
    def of_json(cls, document: Any) -> LinearModel:
        """Return the model of a document from `as_json`.

        Raises:
            ValueError, TypeError, KeyError, AttributeError: the document is not a power model.
            PluginError: a term or a coefficient is wrong.
        """
        if document["format"] != FORMAT:
            raise ValueError(f"the model's format is {document['format']!r}, not {FORMAT!r}")
        ranges = {term: (float(low), float(high)) for term, (low, high) in document["ranges_percent"].items()}
        report = _report_of(document["fit"]) if document["fit"] else None
        return cls(dict(document["coefficients_W"]), ranges, report)


def _report_of(document: Mapping[str, Any]) -> FitReport:
    linearity = dict(document.get("linearity") or {})
    linearity.pop("doubt", None)
    return FitReport(**{**document, "linearity": Linearity(**linearity) if linearity else None})


def _beyond(term: str, low: float, high: float, values: Iterable[float | None]) -> Iterator[str]:
    known = [value for value in values if value is not None]
    margin = _TOLERANCE * (high - low)
    outside = [value for value in known if not low - margin <= value <= high + margin]
    if outside:
        beyond = f"{term} was {min(outside):.0f} to {max(outside):.0f} % for a time"
        yield f"{beyond}, and the power model was fitted on {low:.0f} to {high:.0f} %"


def check_terms(terms: Iterable[str]) -> None:
    """Refuse unknown terms by a `PluginError`, which names the nearest one."""
    for term in terms:
        kind, colon, name = term.partition(":") if isinstance(term, str) else ("", "", "")
        if term not in PLAIN_TERMS and not (kind in _KINDS and colon and name):
            fix = did_you_mean(str(term), [*PLAIN_TERMS, "motion:forward", "task:video"])
            raise PluginError(f"a power model has no term {term!r}", where="power model", fix=fix)


def term_value(term: str, state: RobotState) -> float | None:
    """Return the value of a term, by which its coefficient is multiplied; None if it was not sampled.

    That is 1 or 0, a percentage (`cpu`, `memory`, `gpu`), MB/s (`network`), the number of busy cores at a frequency, or
    GHz (`cycles`: the sum over the cores of frequency times busy share of the time).

    Example:
        >>> from robot_runner.meters.power_model.states import RobotState
        >>> term_value("motion:forward", RobotState(0.0, 0.1, phase="forward"))
        1.0
    """
    kind, _, name = term.partition(":")
    values = {
        "constant": 1.0,
        "cpu": state.cpu,
        "memory": state.memory,
        "has_moved": float(state.has_moved),
        "motion": float(state.motion == name),
        "task": float(state.task == name),
        "network": state.network,
        "gpu": state.gpu,
        "cycles": None if state.cores is None else sum(megahertz / 1000 * busy for megahertz, busy in state.cores),
        "frequency": None if state.cores is None else sum(busy for at, busy in state.cores if str(at) == name),
    }
    return values[kind]


def read_model(path: Path) -> LinearModel:
    """Return the model of a file; a `PluginError` says that it cannot be read, or contains no power model."""
    fix = "Name a file that `robot-runner fit-power-model EXPERIMENT --out FILE` has written."
    try:
        return LinearModel.of_json(json.loads(path.read_text(encoding="utf-8")))
    except OSError as error:
        raise PluginError(f"the file cannot be read: {error.strerror}", where=str(path), fix=fix) from error
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise PluginError(f"the file holds no power model: {error}", where=str(path), fix=fix) from error
