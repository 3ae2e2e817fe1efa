"""Ask Optuna which combinations to try next: a program of its own, from JSON on its input to JSON on its output.

The orchestrator must not import it, as NumPy starts threads. It keeps no state between calls, so that the same history
and seed give the same answer.
"""

from __future__ import annotations

import json
import sys
import warnings
from typing import Any

#: How often Optuna is asked at most for one combination, and how many candidates are returned for it.
_ASKED = 60
_WANTED = 8


def candidates(question: dict[str, Any]) -> list[list[list[int]]]:
    """Return the combinations to try next: several candidates for each, the preferred one first.

    Args:
        question: `levels` (how many treatments each factor has), `are_numbers`, `directions` (of Optuna), `points`
            (pairs of indices and values; no values where the runs failed), `tried` (indices that must not come again),
            `start` (how many combinations come before Optuna has a model), `count` and `seed`.
    """
    import optuna  # noqa: PLC0415 - a second
    from optuna.distributions import BaseDistribution, CategoricalDistribution, IntDistribution  # noqa: PLC0415
    from optuna.trial import TrialState, create_trial  # noqa: PLC0415

    warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    sampler = optuna.samplers.TPESampler(
        seed=question["seed"], multivariate=True, constant_liar=True, n_startup_trials=question["start"]
    )
    study = optuna.create_study(directions=question["directions"], sampler=sampler)
    space: dict[str, BaseDistribution] = {
        str(number): IntDistribution(0, levels - 1) if is_numeric else CategoricalDistribution(list(range(levels)))
        for number, (levels, is_numeric) in enumerate(zip(question["levels"], question["are_numbers"], strict=True))
        if levels > 1
    }
    tried = set(map(tuple, question["tried"]))
    for places, values in question["points"]:
        params = {name: places[int(name)] for name in space}
        # The model ignores failed trials; pruned ones without a value count as the worst.
        state = TrialState.COMPLETE if values is not None else TrialState.PRUNED
        study.add_trial(create_trial(params=params, distributions=space, values=values, state=state))
    answer = []
    for _ in range(question["count"]):
        found: list[list[int]] = []
        for _ in range(_ASKED):
            trial = study.ask(space)
            places = [int(trial.params.get(str(number), 0)) for number in range(len(question["levels"]))]
            is_new = tuple(places) not in tried
            tried.add(tuple(places))
            if is_new:
                found.append(places)
            if not is_new or len(found) > 1:  # the first one stays running: Optuna takes that into account
                study.tell(trial, state=TrialState.FAIL)
            if len(found) == _WANTED:
                break
        answer.append(found)
    return answer


if __name__ == "__main__":
    sys.stdout.write(json.dumps(candidates(json.load(sys.stdin))))
