"""D-optimal designs: the runs that estimate the effects of a model most precisely."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING, Any, ClassVar

from robot_runner.core.design.design import ChosenCombinations, IsAllowed
from robot_runner.core.design.design_findings import MAX_RUNS
from robot_runner.core.design.factor import Factor
from robot_runner.core.design.full_factorial import full_factorial, full_size
from robot_runner.core.errors import DesignError, Finding, did_you_mean
from robot_runner.core.words import INACTIVE
from robot_runner.designs import choosing

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Matrix = NDArray[np.float64]

_MODELS = ("main", "interactions", "quadratic")
#: The number of searches from random starts, of which the best is taken; fewer if a search takes long.
_STARTS = 8
#: The limit of candidates times runs for the steps of all searches together: a second or two.
_AT_ONCE = 500_000
#: The most candidates; of a larger full factorial, which is never listed, a random sample is searched.
_MOST_CANDIDATES = 4000
#: A search ends when no exchange of a run increases the determinant of the information by this share.
_GAIN = 1e-6


@dataclass(frozen=True, slots=True)
class DOptimal(choosing.Described):
    """The `runs` allowed combinations that estimate the effects of a model most precisely.

    It maximises the determinant of the information matrix by exchanges (Fedorov, 1972), from several random starts.
    Only allowed combinations are candidates. Factors may have any number of treatments, and conditions.

    Attributes:
        runs: the number of combinations.
        model: `main` for main effects, `interactions` for two-factor interactions as well, `quadratic` for squares of
            numeric factors in addition.
        seed: of the random starts.

    Example:
        >>> from robot_runner import Factor
        >>> factors = [Factor("Task", ["Video", "Network", "Map"]), Factor("Speed", [0.1, 0.2]), Factor("Load", [0, 1])]
        >>> len(DOptimal(runs=6).choose(factors, lambda combination: True).combinations)
        6
    """

    kind: ClassVar[str] = "d_optimal"
    runs: int
    model: str = "main"
    seed: int = 0

    def findings(self, factors: Sequence[Factor]) -> Iterator[Finding]:
        """Yield findings on libraries, parameters and factors."""
        yield from choosing.library_findings("numpy")
        yield from choosing.number_findings("seed", self.seed, 0)
        wrong = list(choosing.number_findings("runs", self.runs, 1, MAX_RUNS))
        yield from wrong
        if self.model not in _MODELS:
            yield Finding.error("design", f"there is no model {self.model!r}", did_you_mean(str(self.model), _MODELS))
        elif not wrong:
            needed = _parameters(factors, self.model)
            if self.runs < needed:
                problem = f"runs={self.runs}, and the model {self.model!r} has {needed} parameters"
                yield Finding.error("design", problem, f"Give {needed} runs or more, or a smaller model.")
            else:
                yield from choosing.more_than_all(factors, self.runs)
            for factor in factors if self.model == "quadratic" else ():
                yield from choosing.curve_findings(factor)

    def choose(self, factors: Sequence[Factor], is_allowed: IsAllowed) -> ChosenCombinations:
        """Return the combinations with the largest determinant of the information that is found."""
        import numpy as np  # noqa: PLC0415 - an extra

        random = np.random.default_rng(self.seed)
        offered = list(_candidates(factors, self.model, random))
        used, candidates = choosing.with_values(factors, offered, is_allowed)
        if len(offered) < self.runs:
            problem = f"runs={self.runs}, and there are {len(offered)} combinations of the values that the model takes"
            raise DesignError(problem, where="design", fix=f"Give {len(offered)} runs or fewer.")
        if len(candidates) < self.runs:
            left = f"{len(candidates)} of the {len(offered):,} combinations that DOptimal searches"
            problem = f"runs={self.runs}, and the exclusions leave {left}"
            raise DesignError(problem, where="design", fix="Give fewer runs, or exclude fewer.")
        matrix = _model_matrix(used, [combination.treatments for combination in candidates], self.model)
        parameters = int(np.linalg.matrix_rank(matrix))
        starts = min(_STARTS, max(1, _AT_ONCE // (len(matrix) * self.runs)))
        found = [_exchanged(matrix, self.runs, random) for _ in range(starts)]
        best, value = max(found, key=lambda each: each[1])
        if parameters < matrix.shape[1] or not np.isfinite(value):
            problem = f"what the exclusions leave does not tell all effects of the model {self.model!r} apart"
            raise DesignError(problem, where="design", fix="Exclude fewer, or choose a smaller model.")
        kept = [candidates[place] for place in sorted(best)]
        # Relative to an orthogonal design, in which each effect-coded column has a mean square of one.
        efficiency = float(np.exp(value / parameters) / self.runs)
        facts = {
            "kind": self.kind,
            "model": self.model,
            "parameters": parameters,
            "candidates": len(candidates),
            "d_efficiency": round(efficiency, 4),
        }
        final, _ = choosing.with_values(factors, [each.treatments for each in kept], lambda _: True)
        return ChosenCombinations(kept, facts, final)


def _parameters(factors: Sequence[Factor], model: str) -> int:
    widths = [1 if each.range is not None else len(choosing.active_treatments(each)) - 1 for each in factors]
    count = 1 + sum(widths)
    if model != "main":
        count += sum(widths[one] * widths[other] for one, other in _pairs(factors))
    return count + (sum(each.range is not None for each in factors) if model == "quadratic" else 0)


def _pairs(factors: Sequence[Factor]) -> Iterator[tuple[int, int]]:
    """Yield the indices of factors that can interact: a conditional factor and its parent cannot."""
    for one, other in combinations(range(len(factors)), 2):
        if factors[one].name not in factors[other].when and factors[other].name not in factors[one].when:
            yield one, other


def _candidates(factors: Sequence[Factor], model: str, random: np.random.Generator) -> Iterator[tuple[Any, ...]]:
    """Yield the candidates, all combinations or a random sample; a range has its ends and, if quadratic, its middle."""
    values = [_levels(factor, model) for factor in factors]
    listed = [factor.with_treatments(each) for factor, each in zip(factors, values, strict=True)]
    if full_size(listed) <= _MOST_CANDIDATES:
        yield from (combination.treatments for combination in full_factorial(listed))
        return
    seen: set[tuple[int, ...]] = set()
    for _ in range(4 * _MOST_CANDIDATES):
        drawn = {
            factor.name: each[int(random.integers(len(each)))] for factor, each in zip(factors, values, strict=True)
        }
        row = choosing.with_conditions(factors, drawn)
        key = tuple(map(id, row))  # if conditions do not hold, several draws are the same combination
        if key not in seen and len(seen) < _MOST_CANDIDATES:
            seen.add(key)
            yield row


def _levels(factor: Factor, model: str) -> tuple[Any, ...]:
    span = factor.range  # its treatments may be those that an earlier plan chose
    if span is None:
        return choosing.active_treatments(factor)
    return (span.lower, *([span.at(0.5)] if model == "quadratic" else []), span.upper)


def _model_matrix(factors: Sequence[Factor], rows: Sequence[tuple[Any, ...]], model: str) -> Matrix:
    """Return the columns of the model: the constant, effects, their products, squares.

    Effects are coded as orthogonal contrasts, with a mean square of one if balanced; an inactive factor has zeros.
    """
    import numpy as np  # noqa: PLC0415 - an extra

    columns = [_effects(factor, [row[place] for row in rows]) for place, factor in enumerate(factors)]
    parts = [np.ones((len(rows), 1)), *columns]
    if model != "main":
        parts += [
            (columns[one][:, :, None] * columns[other][:, None, :]).reshape(len(rows), -1)
            for one, other in _pairs(factors)
        ]
    if model == "quadratic":
        parts += [each**2 for factor, each in zip(factors, columns, strict=True) if factor.range is not None]
    return np.hstack(parts)


def _effects(factor: Factor, values: Sequence[Any]) -> Matrix:
    import numpy as np  # noqa: PLC0415 - an extra

    if factor.range is not None:
        span = factor.range
        return np.array([[0.0 if each is INACTIVE else 2 * span.share_of(each) - 1] for each in values])
    treatments = choosing.active_treatments(factor)
    count = len(treatments)
    place_of = {id(each): place for place, each in enumerate(treatments)}
    contrasts = np.zeros((count + 1, max(count - 1, 0)))  # the last row is for an inactive factor
    for column in range(count - 1):  # Helmert: each treatment against those before it
        contrasts[: column + 1, column] = -1
        contrasts[column + 1, column] = column + 1
        contrasts[:, column] *= np.sqrt(count / ((column + 1) * (column + 2)))
    return contrasts[[place_of.get(id(each), count) for each in values]]


def _exchanged(matrix: Matrix, runs: int, random: np.random.Generator) -> tuple[list[int], float]:
    """Return rows chosen by exchanges, and the logarithm of the determinant of their information.

    Each step exchanges one run for the candidate that increases the determinant most: by the factor
    (1 + d_c)(1 - d_r) + d_cr², with d_xy = x' M^-1 y (Fedorov, 1972).
    """
    import numpy as np  # noqa: PLC0415 - an extra

    width = matrix.shape[1]
    chosen = random.choice(len(matrix), runs, replace=False)
    ridge = 1e-9 * np.eye(width)  # the information of a start may be singular
    for _ in range(10 * runs):  # an upper limit that is never needed, as each step gains
        inverse = np.linalg.inv(matrix[chosen].T @ matrix[chosen] + ridge)
        projected = matrix @ inverse
        every = np.einsum("ij,ij->i", projected, matrix)
        between = projected @ matrix[chosen].T
        factor = (1 + every)[:, None] * (1 - every[chosen])[None, :] + between**2
        factor[chosen] = -np.inf  # no combination twice
        into, out = np.unravel_index(int(np.argmax(factor)), factor.shape)
        if factor[into, out] < 1 + _GAIN:
            break
        chosen[out] = into
    sign, value = np.linalg.slogdet(matrix[chosen].T @ matrix[chosen])
    return list(map(int, chosen)), float(value) if sign > 0 else -np.inf
