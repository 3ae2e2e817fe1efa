"""Standard errors of a power model and its linearity, on data whose truth is known and whose noise is correlated."""

from __future__ import annotations

import math

import numpy as np
import pytest

pytest.importorskip("statsmodels")
signal = pytest.importorskip("scipy.signal")

from robot_runner.meters.power_model.uncertainty import (  # noqa: E402 - after what it needs was looked for
    PiecesOfRuns,
    check_linearity,
    uncertainty_of,
)

TRUE = np.array([7.0, 0.02, 1.0])
TASK = 2
REPETITIONS = 300


def autoregression(noise, rho, count):
    """Return a stationary first-order autoregression of variance 1."""
    steps = noise.standard_normal(count) * math.sqrt(1 - rho**2)
    steps[0] = noise.standard_normal()
    return signal.lfilter([1.0], [1.0, -rho], steps)


def measured(noise, *, runs, length=950, rho=0.9, between=0.0, bend=0.0):
    """Return the pieces of some runs of 95 s at 10 Hz: a constant, a load that wanders, a task that comes and goes."""
    rows, watts, numbers = [], [], []
    for run in range(runs):
        cpu = 30 + 8 * autoregression(noise, 0.9, length)
        task = (np.arange(length) // (length // 6) % 2).astype(float)
        matrix = np.column_stack([np.ones(length), cpu, task])
        common = between * noise.standard_normal()
        rows.append(matrix)
        bent = bend * ((cpu - 30) / 8) ** 2
        watts.append(matrix @ TRUE + common + bent + 0.2 * autoregression(noise, rho, length))
        numbers.append(np.full(length, run))
    matrix = np.concatenate(rows)
    return PiecesOfRuns(matrix, np.concatenate(watts), np.full(len(matrix), 0.1), np.concatenate(numbers))


def solved(pieces, without=None):
    kept = pieces.runs != without
    return np.linalg.lstsq(pieces.matrix[kept], pieces.watts[kept], rcond=None)[0]


def coverage(runs, **data):
    """Return how often the interval covers the true cost of the task: ours, the jackknife's, and that of plain OLS."""
    noise = np.random.default_rng(7)
    hits = np.zeros(3)
    for _ in range(REPETITIONS):
        pieces = measured(noise, runs=runs, **data)
        error = abs(solved(pieces)[TASK] - TRUE[TASK])
        partial = [solved(pieces, without=run) for run in range(runs)] if runs > 1 else []
        ours = uncertainty_of(pieces, partial).half_widths[TASK]
        spread = np.std([each[TASK] for each in partial]) if partial else 0.0
        jackknife = 1.96 * math.sqrt(max(0, runs - 1)) * spread
        residuals = pieces.watts - pieces.matrix @ solved(pieces)
        inverse = np.linalg.inv(pieces.matrix.T @ pieces.matrix)
        plain = 1.96 * math.sqrt(residuals @ residuals / len(residuals) * inverse[TASK, TASK])
        hits += [error <= ours, error <= jackknife, error <= plain]
    return hits / REPETITIONS


@pytest.mark.long
def test_the_interval_of_one_run_covers_the_truth_where_uncorrelated_errors_do_not():
    ours, _, plain = coverage(runs=1)
    assert 0.90 <= ours <= 0.98
    assert plain < 0.6


@pytest.mark.long
def test_the_interval_of_two_runs_covers_the_truth_where_leaving_one_out_does_not():
    ours, jackknife, plain = coverage(runs=2)
    assert 0.90 <= ours <= 0.98
    assert jackknife < 0.85
    assert plain < 0.6


@pytest.mark.long
def test_what_runs_have_in_common_widens_the_interval_of_the_constant():
    noise = np.random.default_rng(3)
    alike, unlike = (measured(noise, runs=6, between=between) for between in (0.0, 1.0))
    widths = []
    for pieces in (alike, unlike):
        partial = [solved(pieces, without=run) for run in range(6)]
        widths.append(uncertainty_of(pieces, partial).standard_errors[0])
    assert widths[1] > 3 * widths[0]


def test_noise_that_is_not_correlated_yields_the_errors_of_the_textbook():
    pieces = measured(np.random.default_rng(5), runs=3, rho=0.0)
    inverse = np.linalg.inv(pieces.matrix.T @ pieces.matrix)
    found = uncertainty_of(pieces, []).standard_errors
    assert found == pytest.approx(0.2 * np.sqrt(np.diag(inverse)), rel=0.25)


def test_a_perfect_fit_has_no_errors():
    pieces = measured(np.random.default_rng(5), runs=2)
    perfect = PiecesOfRuns(pieces.matrix, pieces.matrix @ TRUE, pieces.seconds, pieces.runs)
    assert uncertainty_of(perfect, []).standard_errors == pytest.approx(0.0, abs=1e-6)
    assert check_linearity(perfect).doubt() is None


def test_power_that_bends_is_noticed_with_figures():
    linearity = check_linearity(measured(np.random.default_rng(11), runs=3, bend=0.3))
    assert linearity.p_value < 0.001
    assert "Ramsey's RESET, p < 0.001" in linearity.doubt()


@pytest.mark.long
def test_straight_power_is_hardly_ever_doubted_however_correlated_the_noise():
    noise = np.random.default_rng(13)
    doubts = [check_linearity(measured(noise, runs=2)).doubt() for _ in range(100)]
    assert sum(doubt is not None for doubt in doubts) <= 3


def test_a_bend_that_costs_nothing_is_no_doubt():
    linearity = check_linearity(measured(np.random.default_rng(17), runs=10, rho=0.0, bend=0.02))
    assert linearity.curvature_W < 0.05
    assert linearity.doubt() is None


def test_terms_that_are_on_or_off_alone_cannot_bend():
    pieces = measured(np.random.default_rng(5), runs=2)
    on_or_off = PiecesOfRuns(pieces.matrix[:, [0, TASK]], pieces.watts, pieces.seconds, pieces.runs)
    assert check_linearity(on_or_off) is None
