"""Fits the coefficients of a linear power model by least squares, and says how far they can be trusted."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from robot_runner.core.errors import AnalysisError
from robot_runner.meters.power_model.linear_power_model import FitReport, LinearModel, check_terms, term_value
from robot_runner.meters.power_model.uncertainty import PiecesOfRuns, check_linearity, uncertainty_of

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import numpy.typing as npt

    from robot_runner.meters.power_model.measured_runs import MeasuredRun, Sources
    from robot_runner.meters.power_model.states import RobotState

    Floats = npt.NDArray[np.float64]

#: A processor that knows more frequencies than this changes them in small steps: they are taken together as cycles.
_FREQUENCIES = 6
#: Singular values, relative to the largest, below which columns count as one: rounding in the raw data's third
#: decimal leaves more than this between terms that truly differ.
_SINGULAR = 1e-6
#: How much of a direction in which nothing was seen a term must make up to be named as its cause.
_CAUSE = 0.1


@dataclass(frozen=True, slots=True)
class _Rows:
    """One row a piece of time: what it is explained by, the power that was measured, and how long it lasted."""

    terms: Sequence[str]
    matrix: Floats
    watts: Floats
    seconds: Floats

    def solve(self) -> Floats:
        """Return the coefficients that leave the least squares, each piece weighted by its duration.

        Raises:
            AnalysisError: the data do not tell some of the terms apart.
        """
        root = np.sqrt(self.seconds)
        weighted = self.matrix * root[:, None]
        scale = np.linalg.norm(weighted, axis=0)
        scale[scale == 0] = 1.0
        self._check_rank(weighted / scale)
        solution: Floats = np.linalg.lstsq(weighted / scale, self.watts * root, rcond=None)[0] / scale
        return solution

    def _check_rank(self, scaled: Floats) -> None:
        if len(scaled) < len(self.terms):
            problem = f"there are {len(scaled)} pieces of time for {len(self.terms)} terms"
            raise AnalysisError(problem, where="power model", fix="Measure more, or leave terms out.")
        _, singular, directions = np.linalg.svd(scaled, full_matrices=False)
        if singular[-1] > _SINGULAR * singular[0]:
            return
        causes = [repr(term) for term, share in zip(self.terms, directions[-1], strict=True) if abs(share) > _CAUSE]
        if len(causes) == 1:
            problem, fix = f"the term {causes[0]} is 0 all the time", f"Leave {causes[0]} out."
        else:
            problem = f"the data do not tell these terms apart: {', '.join(causes)}"
            fix = f"Leave one of them out, such as {causes[-1]}, or measure runs in which they differ."
        raise AnalysisError(problem, where="power model", fix=fix)


def terms_of(runs: Sequence[MeasuredRun], sources: Sources) -> tuple[str, ...]:
    """Return the terms that these runs can tell of: utilisation, motions and tasks, as far as they were seen."""
    states = [state for run in runs for state in run.states]
    terms = ["constant"]
    terms += _computing_terms(states, sources)
    if any(state.has_moved for state in states) and not all(state.has_moved for state in states):
        terms.append("has_moved")
    terms += [f"motion:{name}" for name in sorted({state.motion for state in states} - {""})]
    terms += [f"task:{name}" for name in sorted({state.task for state in states} - {""})]
    return tuple(terms)


def _computing_terms(states: Sequence[RobotState], sources: Sources) -> list[str]:
    """Return the terms of the computer's parts; with frequencies known, the cores take the place of `cpu`."""
    terms = []
    clocks = sorted({clock for state in states for clock, _ in state.cores or ()})
    if clocks:
        terms += [f"frequency:{clock}" for clock in clocks] if len(clocks) <= _FREQUENCIES else ["cycles"]
    elif sources.utilisation:
        terms.append("cpu")
    terms += ["network"] if sources.components.network else []
    return [*terms, "gpu"] if sources.components.gpu else terms


def fit_model(
    runs: Sequence[MeasuredRun], terms: Sequence[str], *, experiment: str, sources: Sources, left_out: Mapping[str, str]
) -> LinearModel:
    """Return the linear model that fits these runs best.

    Args:
        runs: what the robot did and drew.
        terms: the terms of the model.
        experiment: the name of the experiment, for the report.
        sources: where the data came from, for the report.
        left_out: the runs that were left out and why, for the report.

    Raises:
        AnalysisError: the data are too few, or do not tell some of the terms apart.
        PluginError: there is no such term.
    """
    check_terms(terms)
    rows = [_rows_of(run, terms) for run in runs]
    everything = _joined(rows)
    coefficients = everything.solve()
    partial = _without_each(rows)
    pieces = PiecesOfRuns(
        everything.matrix,
        everything.watts,
        everything.seconds,
        np.repeat(np.arange(len(rows)), [len(each.watts) for each in rows]),
    )
    uncertainty = uncertainty_of(pieces, [each for each in partial if each is not None])
    report = FitReport(
        experiment=experiment,
        runs=[run.run_id for run in runs],
        left_out=dict(left_out),
        power_source=sources.power,
        is_simulated=any(run.is_simulated for run in runs),
        pieces=len(everything.watts),
        seconds=float(everything.seconds.sum()),
        r_squared=_r_squared(everything, coefficients),
        residual_W=_residual(everything, coefficients),
        standard_errors=dict(zip(terms, map(float, uncertainty.standard_errors), strict=True)),
        energy_errors={
            run.run_id: _energy_error(own, others)
            for run, own, others in zip(runs, rows, partial, strict=True)
            if others is not None
        },
        intervals={
            term: (float(watts - half), float(watts + half))
            for term, watts, half in zip(terms, coefficients, uncertainty.half_widths, strict=True)
        },
        correlation_lag=uncertainty.lag,
        linearity=check_linearity(pieces),
    )
    return LinearModel(dict(zip(terms, map(float, coefficients), strict=True)), _ranges(runs, terms), report)


def _rows_of(run: MeasuredRun, terms: Sequence[str]) -> _Rows:
    """Return the rows of one run; pieces in which something was not sampled are left out."""
    kept = [
        (values, watts, state.seconds)
        for state, watts in zip(run.states, run.watts, strict=True)
        if None not in (values := [term_value(term, state) for term in terms])
    ]
    matrix = np.array([values for values, _, _ in kept], dtype=float).reshape(len(kept), len(terms))
    watts = np.array([watts for _, watts, _ in kept], dtype=float)
    return _Rows(terms, matrix, watts, np.array([seconds for _, _, seconds in kept], dtype=float))


def _joined(rows: Sequence[_Rows]) -> _Rows:
    return _Rows(
        rows[0].terms,
        np.concatenate([each.matrix for each in rows]),
        np.concatenate([each.watts for each in rows]),
        np.concatenate([each.seconds for each in rows]),
    )


def _without_each(rows: Sequence[_Rows]) -> list[Floats | None]:
    """Return, for each run, the coefficients of the other runs; None where those do not suffice."""
    if len(rows) == 1:
        return [None]
    partial: list[Floats | None] = []
    for place in range(len(rows)):
        try:
            partial.append(_joined([*rows[:place], *rows[place + 1 :]]).solve())
        except AnalysisError:  # a task that only this run had, say
            partial.append(None)
    return partial


def _residual(rows: _Rows, coefficients: Floats) -> float:
    errors = rows.watts - rows.matrix @ coefficients
    return math.sqrt(float(rows.seconds @ errors**2 / rows.seconds.sum()))


def _r_squared(rows: _Rows, coefficients: Floats) -> float:
    mean = rows.seconds @ rows.watts / rows.seconds.sum()
    variance = float(rows.seconds @ (rows.watts - mean) ** 2 / rows.seconds.sum())
    return 1.0 - _residual(rows, coefficients) ** 2 / variance if variance else 0.0


def _energy_error(rows: _Rows, coefficients: Floats) -> float:
    """Return by how many percent the modelled energy of a run differs from the measured."""
    measured = float(rows.seconds @ rows.watts)
    return 100.0 * (float(rows.seconds @ (rows.matrix @ coefficients)) / measured - 1.0)


def _ranges(runs: Sequence[MeasuredRun], terms: Sequence[str]) -> dict[str, tuple[float, float]]:
    ranges = {}
    for term in ("cpu", "memory", "gpu"):
        met = [value for run in runs for state in run.states if (value := term_value(term, state)) is not None]
        if term in terms and met:
            ranges[term] = (min(met), max(met))
    return ranges
