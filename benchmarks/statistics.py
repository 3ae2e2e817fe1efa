"""How often the statistics err: false positives, coverage of intervals and power of the product's own procedure.

Each figure stands beside its expectation, and the exit code is 1 where one is not met. The longer form is surer of the
last digit: `python -m benchmarks.statistics --experiments 100000`.
"""

from __future__ import annotations

import argparse
import math
import multiprocessing
import os
import time
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from benchmarks.designed_nulls import DESIGNED_NULLS
from benchmarks.interval_coverage import COVERED
from benchmarks.null_designs import NULL_DESIGNS, NullDesign
from benchmarks.power_comparison import COMPARED
from benchmarks.precise_stopping import precise_stopping
from benchmarks.proportion_nulls import PROPORTIONS
from benchmarks.table import Judged, Row, print_table
from robot_runner.analysis.statistics.cell_layout import layout_of
from robot_runner.analysis.statistics.cell_means import CellMeans
from robot_runner.analysis.statistics.descriptive import quiet
from robot_runner.analysis.statistics.post_hoc import adjusted
from robot_runner.analysis.statistics.tested import NotComputed
from robot_runner.analysis.statistics.tests import model_of
from robot_runner.core.design.analysis_plan import Correction, Estimand

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Judge = Callable[[np.random.Generator, int], Judged]

_SEED = 2021
_ALPHA = 0.05
_EXPERIMENTS = 10_000
#: Of designs whose tests are computed all at once, so many times as many are made.
_OF_THE_FAST = 4
#: Models are fitted one by one.
_SHARE_OF_MODELS = 10
#: Draws of the bootstrap, as so many experiments are made of each design.
_DRAWS = 199
#: Any of a family is to be found in no more, in percent.
_FAMILY = 6.5


def main(arguments: list[str] | None = None) -> int:
    """Print false positives, coverage and power, each with what is expected of it; return 1 where one is not met."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--experiments", type=int, default=_EXPERIMENTS, help="simulated experiments a design")
    count = parser.parse_args(arguments if arguments is not None else []).experiments
    began = time.monotonic()
    false_positives = [partial(_false_positives, design) for design in NULL_DESIGNS]
    parts: list[tuple[str, Sequence[Judge]]] = [
        (f"False positives at 5 % ({count:,} experiments a design)", false_positives),
        ("False positives of designs of their own, at 5 %", DESIGNED_NULLS),
        ("Coverage of intervals", COVERED),
        ("Proportions: false positives at 5 %, and coverage", PROPORTIONS),
        ("Power, and what it lacks to the best test beside it", COMPARED),
    ]
    failed = 0
    os.environ["OPENBLAS_NUM_THREADS"] = "1"  # of the processes that are started now: there is one for each core
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(os.cpu_count(), mp_context=context) as pool:
        # One after another from the pool's queue; what each finds hangs on its place alone, not on who computes it.
        going = [
            (title, [pool.submit(_judged, (part, place), judge, count) for place, judge in enumerate(judges)])
            for part, (title, judges) in enumerate(parts)
        ]
        stopped = pool.submit(_stopped, (len(parts),), count)
        for title, futures in going:
            found = [future.result() for future in futures]
            missed = sum(not each.holds for each in found)
            failed += missed
            print_table(f"{title}: {len(found) - missed} of {len(found)} as expected", [each.row for each in found])
        rows = stopped.result()
        failed += sum(row.ratio == "misses" for row in rows)
        print_table("Repeated until precise, 30 times at most: the worst of six widths", rows)
    print(f"{failed or 'No'} figure{'' if failed == 1 else 's'} not as expected, {time.monotonic() - began:.0f} s.")
    return 1 if failed else 0


def _judged(place: tuple[int, int], judge: Judge, count: int) -> Judged:
    return judge(np.random.default_rng((_SEED, *place)), count)


def _stopped(place: tuple[int, ...], count: int) -> list[Row]:
    return list(precise_stopping(np.random.default_rng((_SEED, *place)), count))


def _false_positives(design: NullDesign, random: np.random.Generator, count: int) -> Judged:
    is_slow = any(name in _test_of(design) for name in ("bootstrap", "model"))
    found = _p_values(design, design.draw(random, count if is_slow else _OF_THE_FAST * count))
    shifted = (f"F{len(design.levels) - 1}",) if design.shift else ()
    p_values = np.stack([each for factors, each in found.items() if factors != shifted])
    rates = 100 * np.mean(p_values <= _ALPHA, axis=1)
    smallest = len(p_values) * p_values.min(axis=0)  # Holm's adjustment of the smallest
    if not np.allclose(
        np.minimum(smallest[:20], 1.0), [min(adjusted(each, Correction.HOLM)) for each in p_values.T[:20]]
    ):
        raise ValueError(f"{design.name}: Holm's adjustment is another")
    family = 100 * float(np.mean(smallest <= _ALPHA))
    # Two standard errors of the simulation are granted: 0.2 points of all experiments, more of those one by one.
    slack = 2 * 100 * math.sqrt(_ALPHA * (1 - _ALPHA) / p_values.shape[1])
    highest = float(rates.max())
    if not design.why and family > _FAMILY:
        highest = max(highest, family)
    beside = f"family {family:.1f} %" if len(rates) > 1 else ""
    return Judged(design.name, float(rates.min()), highest, design.bounds, design.why, beside, slack)


def _estimand(design: NullDesign) -> Estimand:
    return Estimand.RANK if design.is_ranked else Estimand.MEAN


def _test_of(design: NullDesign) -> str:
    """Return by what a design is tested, as words."""
    values = design.draw(np.random.default_rng(_SEED), 1)[0]
    model = model_of(design.data(values), _estimand(design))
    if isinstance(model, NotComputed):
        raise TypeError(f"{design.name}: {model.why}")
    with quiet():
        return " ".join(each.test for each in model.effects())


def _p_values(design: NullDesign, values: Floats) -> dict[tuple[str, ...], Floats]:
    """Return the p-values of each effect, one an experiment, as the product computes them."""
    layout = layout_of(design.data(values[0]))
    if layout is not None:
        with quiet():
            effects = CellMeans.of_values(layout, values, _estimand(design), draws=_DRAWS).effects()
            return {each.factors: np.asarray(each.p_value) for each in effects}
    found: dict[tuple[str, ...], list[float]] = {}
    for experiment in values[: len(values) // _SHARE_OF_MODELS]:
        model = model_of(design.data(experiment), _estimand(design))
        for each in () if isinstance(model, NotComputed) else model.effects():
            found.setdefault(each.factors, []).append(float(each.p_value))
    return {factors: np.array(several) for factors, several in found.items()}


if __name__ == "__main__":
    import sys

    sys.exit(main(sys.argv[1:]))
