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
        question: `levels` (how many treatments each factor has; the index behind them says that it does not apply),
            `are_numbers`, `conditions` (as `SearchedSpace.conditions`; may be left out), `directions` (of Optuna),
            `points` (pairs of indices and values; no values where the runs failed), `tried` (indices that must not come
            again), `start` (how many combinations come before Optuna has a model), `count` and `seed`.
    """
    import optuna  # noqa: PLC0415 - a second
    from optuna.distributions import BaseDistribution, CategoricalDistribution, IntDistribution  # noqa: PLC0415
    from optuna.trial import TrialState, create_trial  # noqa: PLC0415

    warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    levels = question["levels"]
    sampler = optuna.samplers.TPESampler(
        seed=question["seed"],
        multivariate=True,
        group=bool(question.get("conditions")),  # a model for each set of factors that apply together
        constant_liar=True,
        n_startup_trials=question["start"],
    )
    study = optuna.create_study(directions=question["directions"], sampler=sampler)
    space: dict[int, BaseDistribution] = {
        number: IntDistribution(0, count - 1) if is_numeric else CategoricalDistribution(list(range(count)))
        for number, (count, is_numeric) in enumerate(zip(levels, question["are_numbers"], strict=True))
        if count > 1
    }
    tried = set(map(tuple, question["tried"]))
    for places, values in question["points"]:
        own = {str(number): each for number, each in space.items() if places[number] < levels[number]}
        params = {name: places[int(name)] for name in own}
        # The model ignores failed trials; pruned ones without a value count as the worst.
        state = TrialState.COMPLETE if values is not None else TrialState.PRUNED
        study.add_trial(create_trial(params=params, distributions=own, values=values, state=state))
    answer = []
    for _ in range(question["count"]):
        found: list[list[int]] = []
        for _ in range(_ASKED):
            trial = study.ask()
            places = _suggested(trial, question)
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


def _suggested(trial: Any, question: dict[str, Any]) -> list[int]:
    """Return the index of each factor's treatment; Optuna suggests those of factors that apply."""
    levels, conditions = question["levels"], dict(question.get("conditions", []))
    places = [0] * len(levels)
    for number in (*(each for each in range(len(levels)) if each not in conditions), *conditions):
        if not all(places[other] in wanted for other, wanted in conditions.get(number, ())):
            places[number] = levels[number]
        elif levels[number] > 1 and question["are_numbers"][number]:
            places[number] = trial.suggest_int(str(number), 0, levels[number] - 1)
        elif levels[number] > 1:
            places[number] = trial.suggest_categorical(str(number), list(range(levels[number])))
    return places


if __name__ == "__main__":
    sys.stdout.write(json.dumps(candidates(json.load(sys.stdin))))
