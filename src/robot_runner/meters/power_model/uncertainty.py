"""The uncertainty of a power model's coefficients, with correlated samples and differing runs."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from robot_runner.meters.power_model.linear_power_model import Linearity

if TYPE_CHECKING:
    import numpy.typing as npt

    Floats = npt.NDArray[np.float64]

#: Columns with a singular value below this, relative to the largest, are collinear: between terms that truly differ,
#: rounding to the raw data's third decimal leaves more than this.
SINGULAR = 1e-6
#: Residuals smaller than this, W, are rounding: their correlation is meaningless.
_ROUNDING = 1e-9
#: The number of values of a binary term.
_ON_OR_OFF = 2


@dataclass(frozen=True, slots=True)
class PiecesOfRuns:
    """The data of a fit: one row for each piece of time, run after run and oldest first.

    Attributes:
        matrix: the values of the terms, shape (pieces, terms).
        watts: the measured power of each piece.
        seconds: the duration of each piece, which is its weight.
        runs: the number of the run of each piece.
    """

    matrix: Floats
    watts: Floats
    seconds: Floats
    runs: npt.NDArray[np.int64]

    def where(self, is_kept: npt.NDArray[np.bool_]) -> PiecesOfRuns:
        """Return some of the pieces."""
        return PiecesOfRuns(self.matrix[is_kept], self.watts[is_kept], self.seconds[is_kept], self.runs[is_kept])


@dataclass(frozen=True, slots=True)
class Uncertainty:
    """The uncertainty of coefficients.

    Attributes:
        lag: the number of pieces over which correlation was allowed for.
        standard_errors: of each coefficient, W.
        half_widths: of the 95 % confidence intervals, W.
    """

    lag: int
    standard_errors: Floats
    half_widths: Floats


def uncertainty_of(pieces: PiecesOfRuns, partial: Sequence[Floats]) -> Uncertainty:
    """Return the uncertainty of the coefficients of a weighted least-squares fit.

    Pieces of one run are correlated: an unexplained error continues in the next piece. The standard errors are those of
    Newey and West (heteroskedasticity- and autocorrelation-consistent, Econometrica 55, 1987), within each run, with
    twice the lag of Andrews (Econometrica 59, 1991) for a first-order autoregression, and at least that of Lazarus,
    Lewis, Stock and Watson (Journal of Business & Economic Statistics 36, 2018). They do not include errors that all
    pieces of a run share: if leaving out one run after the other (jackknife) yields larger errors, those are returned.

    Args:
        pieces: the data of the fit.
        partial: the coefficients of the fits without one run each; if fewer than two, there is no jackknife.
    """
    lag = _lag(pieces)
    fitted = _fitted(pieces, pieces.matrix, lag)
    errors = np.maximum(np.asarray(fitted.bse, dtype=float), _jackknife(partial, pieces.matrix.shape[1]))
    return Uncertainty(lag, errors, errors * _critical_value(lag / len(pieces.watts)))


def check_linearity(pieces: PiecesOfRuns) -> Linearity | None:
    """Test whether power is a linear function of the terms; None if all terms are binary.

    Ramsey's RESET: squares of the terms that are not binary, and squares and cubes of the fitted power, are added; if
    they explain anything, power is not a weighted sum of these terms (Ramsey, Journal of the Royal Statistical
    Society B 31, 1969; Ramsey and Schmidt, Journal of the American Statistical Association 71, 1976, for the terms).
    The test is robust against correlation in the same way as the standard errors.
    """
    lag = _lag(pieces)
    straight = _fitted(pieces, pieces.matrix, lag)
    fitted = np.asarray(straight.fittedvalues)
    scale = float(fitted.std())
    if scale <= _ROUNDING:
        return None
    graded = [column for column in pieces.matrix.T if len(np.unique(column)) > _ON_OR_OFF]
    scaled = (fitted - fitted.mean()) / scale
    squares = [((column - column.mean()) / column.std()) ** 2 for column in graded]
    bent = _independent(pieces.matrix, [*squares, scaled**2, scaled**3])
    extra = bent.shape[1] - pieces.matrix.shape[1]
    if not extra:
        return None
    found = _fitted(pieces, bent, lag)
    constraint = np.eye(bent.shape[1])[-extra:]
    difference = np.asarray(found.fittedvalues) - fitted
    curvature = math.sqrt(float(pieces.seconds @ difference**2 / pieces.seconds.sum()))
    is_straight = curvature <= _ROUNDING
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # statsmodels warns of covariances with a lower rank, for which it allows
        p_value = 1.0 if is_straight else float(found.wald_test(constraint, use_f=False, scalar=True).pvalue)
    return Linearity(p_value=p_value, curvature_W=curvature, explained_W=scale)


def _fitted(pieces: PiecesOfRuns, matrix: Floats, lag: int) -> Any:
    """Return statsmodels' results of the weighted fit, with covariances that allow for correlation."""
    from statsmodels.regression.linear_model import WLS  # noqa: PLC0415 - takes a second to import

    model = WLS(pieces.watts, matrix, weights=pieces.seconds)
    if pieces.runs[0] == pieces.runs[-1]:
        return model.fit(cov_type="HAC", cov_kwds={"maxlags": lag, "use_correction": True}, use_t=True)
    return model.fit(
        cov_type="hac-panel", cov_kwds={"groups": pieces.runs, "maxlags": lag, "use_correction": "hac"}, use_t=True
    )


def _lag(pieces: PiecesOfRuns) -> int:
    """Return the number of pieces over which correlation is allowed for: at most half of the shortest run."""
    root = np.sqrt(pieces.seconds)
    weighted = pieces.matrix * root[:, None]
    coefficients = np.linalg.lstsq(weighted, pieces.watts * root, rcond=None)[0]
    residuals = pieces.watts * root - weighted @ coefficients
    lengths: list[int] = np.unique(pieces.runs, return_counts=True)[1].tolist()
    length, half = sum(lengths) / len(lengths), min(lengths) // 2
    follows = pieces.runs[1:] == pieces.runs[:-1]
    power = float((residuals**2).sum())
    if power <= _ROUNDING**2 * len(residuals):
        return 0
    rho = min(0.99, max(0.0, float((residuals[1:] * residuals[:-1])[follows].sum()) / power))
    alpha = 4 * rho**2 / ((1 - rho) ** 2 * (1 + rho) ** 2)  # Andrews 1991, equation 6.4
    # Twice the lag that is best for the standard error: intervals need a longer one for their coverage (Sun, Phillips
    # and Jin, Econometrica 76, 2008).
    andrews = 2 * 1.1447 * math.cbrt(alpha * length)  # the same, equation 6.2, for Bartlett's kernel
    recommended = 1.3 * math.sqrt(length)  # Lazarus et al. 2018, equation 3
    return min(math.ceil(max(andrews, recommended)), half)


def _critical_value(share: float) -> float:
    """Return the factor from a standard error to half a 95 % confidence interval.

    Args:
        share: the lag, as a share of all pieces.

    It allows for the errors being estimates, which are the coarser the larger the lag. Source: Kiefer and Vogelsang,
    Econometric Theory 21 (2005), table 1, Bartlett's kernel, 97.5 %.
    """
    return 1.9600 + 2.9694 * share + 0.4160 * share**2 - 0.5324 * share**3


def _jackknife(partial: Sequence[Floats], terms: int) -> Floats:
    """Return the standard errors by leaving out one run after the other; zeros for fewer than two runs.

    Source: Efron and Tibshirani, An introduction to the bootstrap, equation 11.5.
    """
    count = len(partial)
    if count < 2:  # noqa: PLR2004 - at least two for a difference
        return np.zeros(terms)
    deviations = np.asarray(partial) - np.mean(partial, axis=0)
    errors: Floats = np.sqrt((count - 1) / count * (deviations**2).sum(axis=0))
    return errors


def _independent(matrix: Floats, columns: Sequence[Floats]) -> Floats:
    """Return the matrix with the columns that are linearly independent of it and of each other."""
    for column in columns:
        candidate = np.column_stack([matrix, column])
        norms = np.linalg.norm(candidate, axis=0)
        singular = np.linalg.svd(candidate / np.where(norms == 0, 1.0, norms), compute_uv=False)
        if len(candidate) > candidate.shape[1] and singular[-1] > SINGULAR * singular[0]:
            matrix = candidate
    return matrix
