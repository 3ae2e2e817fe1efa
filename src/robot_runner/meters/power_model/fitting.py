"""Fits the coefficients of a linear power model by least squares, with their uncertainty."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING

import numpy as np

from robot_runner.core.errors import AnalysisError
from robot_runner.meters.power_model.linear_power_model import FitReport, LinearModel, check_terms, term_value
from robot_runner.meters.power_model.uncertainty import SINGULAR, PiecesOfRuns, check_linearity, uncertainty_of

if TYPE_CHECKING:
    import numpy.typing as npt

    from robot_runner.meters.power_model.measured_runs import MeasuredRun
    from robot_runner.meters.power_model.states import RobotState, Sources

    Floats = npt.NDArray[np.float64]

#: A processor with more frequencies than this changes them in small steps: they are combined to cycles.
_FREQUENCIES = 6
#: A term is named as the cause of a rank deficiency if its share of a direction without data is at least this.
_CAUSE = 0.1


def _solved(pieces: PiecesOfRuns, terms: Sequence[str]) -> Floats:
    """Return the least-squares coefficients, with each piece weighted by its duration; refuse collinear terms."""
    root = np.sqrt(pieces.seconds)
    weighted = pieces.matrix * root[:, None]
    scale = np.linalg.norm(weighted, axis=0)
    scale[scale == 0] = 1.0
    _check_rank(weighted / scale, terms)
    solution: Floats = np.linalg.lstsq(weighted / scale, pieces.watts * root, rcond=None)[0] / scale
    return solution


def _check_rank(scaled: Floats, terms: Sequence[str]) -> None:
    if len(scaled) < len(terms):
        problem = f"there are {len(scaled)} pieces of time for {len(terms)} terms"
        raise AnalysisError(problem, where="power model", fix="Measure more, or leave terms out.")
    _, singular, directions = np.linalg.svd(scaled, full_matrices=False)
    if singular[-1] > SINGULAR * singular[0]:
        return
    causes = [repr(term) for term, share in zip(terms, directions[-1], strict=True) if abs(share) > _CAUSE]
    if len(causes) == 1:
        problem, fix = f"the term {causes[0]} is 0 all the time", f"Leave {causes[0]} out."
    else:
        problem = f"the data do not tell these terms apart: {', '.join(causes)}"
        fix = f"Leave one of them out, such as {causes[-1]}, or measure runs in which they differ."
    raise AnalysisError(problem, where="power model", fix=fix)


def terms_of(runs: Sequence[MeasuredRun], sources: Sources) -> tuple[str, ...]:
    """Return the terms that occur in these runs: utilisation, motions and tasks."""
    states = [state for run in runs for state in run.states]
    terms = ["constant"]
    terms += _computing_terms(states, sources)
    if any(state.has_moved for state in states) and not all(state.has_moved for state in states):
        terms.append("has_moved")
    terms += [f"motion:{name}" for name in sorted({state.motion for state in states} - {""})]
    terms += [f"task:{name}" for name in sorted({state.task for state in states} - {""})]
    return tuple(terms)


def _computing_terms(states: Sequence[RobotState], sources: Sources) -> list[str]:
    """Return the terms of the computer's parts; if frequencies are known, terms of the cores replace `cpu`."""
    terms = []
    clocks = sorted({clock for state in states for clock, _ in state.cores or ()})
    if clocks:
        terms += [f"frequency:{clock}" for clock in clocks] if len(clocks) <= _FREQUENCIES else ["cycles"]
    elif sources.utilisation:
        terms.append("cpu")
    terms += ["network"] if sources.network else []
    return [*terms, "gpu"] if sources.gpu else terms


def fit_model(
    runs: Sequence[MeasuredRun], terms: Sequence[str], *, experiment: str, power: str, left_out: Mapping[str, str]
) -> LinearModel:
    """Return the linear model that fits these runs best.

    Args:
        runs: the measured runs.
        terms: the terms of the model.
        experiment: the name of the experiment, for the report.
        power: the plugin that measured power, for the report.
        left_out: the runs that were left out and why, for the report.

    Raises:
        AnalysisError: the data are too few, or some of the terms are collinear.
        PluginError: there is no such term.
    """
    check_terms(terms)
    pieces = _pieces_of(runs, terms)
    coefficients = _solved(pieces, terms)
    fitted = {number: run for number, run in enumerate(runs) if number in pieces.runs}
    silent = [run.run_id for number, run in enumerate(runs) if number not in fitted]
    partial = _without_each(pieces, terms)
    uncertainty = uncertainty_of(pieces, list(partial.values()))
    report = FitReport(
        experiment=experiment,
        runs=[run.run_id for run in fitted.values()],
        left_out={**left_out, **dict.fromkeys(silent, "nothing was sampled that explains power")},
        power_source=power,
        is_simulated=any(run.is_simulated for run in fitted.values()),
        pieces=len(pieces.watts),
        seconds=float(pieces.seconds.sum()),
        r_squared=_r_squared(pieces, coefficients),
        residual_W=_residual(pieces, coefficients),
        standard_errors=dict(zip(terms, map(float, uncertainty.standard_errors), strict=True)),
        energy_errors={
            fitted[number].run_id: _energy_error(pieces.where(pieces.runs == number), others)
            for number, others in partial.items()
        },
        intervals={
            term: (float(watts - half), float(watts + half))
            for term, watts, half in zip(terms, coefficients, uncertainty.half_widths, strict=True)
        },
        correlation_lag=uncertainty.lag,
        linearity=check_linearity(pieces),
    )
    watts = dict(zip(terms, map(float, coefficients), strict=True))
    return LinearModel(watts, _ranges(fitted.values(), terms), report)


def _pieces_of(runs: Sequence[MeasuredRun], terms: Sequence[str]) -> PiecesOfRuns:
    """Return the pieces of time of all runs, without those where a term was not sampled."""
    kept = [
        (values, watts, state.seconds, number)
        for number, run in enumerate(runs)
        for state, watts in zip(run.states, run.watts, strict=True)
        if None not in (values := [term_value(term, state) for term in terms])
    ]
    matrix = np.array([values for values, *_ in kept], dtype=float).reshape(len(kept), len(terms))
    watts, seconds = (np.array([each[place] for each in kept], dtype=float) for place in (1, 2))
    return PiecesOfRuns(matrix, watts, seconds, np.array([number for *_, number in kept], dtype=int))


def _without_each(pieces: PiecesOfRuns, terms: Sequence[str]) -> dict[int, Floats]:
    """Return, for each run by number, the coefficients from the other runs, if these suffice."""
    numbers = np.unique(pieces.runs).tolist()
    partial = {}
    for number in numbers if len(numbers) > 1 else ():
        with suppress(AnalysisError):  # such as without a task that only this run had
            partial[number] = _solved(pieces.where(pieces.runs != number), terms)
    return partial


def _residual(pieces: PiecesOfRuns, coefficients: Floats) -> float:
    errors = pieces.watts - pieces.matrix @ coefficients
    return math.sqrt(float(pieces.seconds @ errors**2 / pieces.seconds.sum()))


def _r_squared(pieces: PiecesOfRuns, coefficients: Floats) -> float:
    mean = pieces.seconds @ pieces.watts / pieces.seconds.sum()
    variance = float(pieces.seconds @ (pieces.watts - mean) ** 2 / pieces.seconds.sum())
    return 1.0 - _residual(pieces, coefficients) ** 2 / variance if variance else 0.0


def _energy_error(pieces: PiecesOfRuns, coefficients: Floats) -> float:
    """Return the error of a run's modelled energy, % of the measured one."""
    measured = float(pieces.seconds @ pieces.watts)
    return 100.0 * (float(pieces.seconds @ (pieces.matrix @ coefficients)) / measured - 1.0)


def _ranges(runs: Collection[MeasuredRun], terms: Sequence[str]) -> dict[str, tuple[float, float]]:
    ranges = {}
    for term in ("cpu", "memory", "gpu"):
        met = [value for run in runs for state in run.states if (value := term_value(term, state)) is not None]
        if term in terms and met:
            ranges[term] = (min(met), max(met))
    return ranges
