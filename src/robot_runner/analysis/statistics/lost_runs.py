"""Runs that failed, values that are missing, and values at a limit, by treatment: what is left may look better.

Runs that fail are seldom any runs: those fail that take longer than is waited for, or drive until the battery is
empty. A mean of the others is not that of the treatment, and no test tells. Nor does one where a timeout was written
down as if it were how long the run took.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import pandas as pd

from robot_runner.analysis.wording import with_unit
from robot_runner.core.design.columns import RUN_ID, STATUS
from robot_runner.core.events.measure import OPERATOR_OWNER
from robot_runner.core.storage.cells import RunStatus
from robot_runner.core.words import counted, listed

if TYPE_CHECKING:
    from robot_runner.analysis.results import Results
    from robot_runner.analysis.statistics.outcome import DesignSummary

_OF_OTHERS = (
    "Means are of the others: where those are lost that take long, say, a treatment looks better the more of its runs "
    "it loses."
)
_OF_SUCCESSES = (
    "Means are of the attempts that succeeded: where those fail that take long, say, a treatment looks better the more "
    "of its attempts fail."
)
#: One run that is lost says nothing of which treatments lose more.
_FEWEST = 2
_MOST_FACTORS = 3
#: From so many runs on, and such a share of all, that have one value at the end of the range it may be a limit, where
#: of the others hardly any are alike: counts are at their largest often, too.
_FEWEST_AT_LIMIT, _SHARE_AT_LIMIT, _LEAST_APART = 3, 0.1, 0.8


def lost_warnings(results: Results, design: DesignSummary, measures: Sequence[str]) -> Iterator[str]:
    """Yield what is doubtful as runs failed, values are missing, or stand at a limit."""
    if uneven := failed_by_treatment(results, design):
        yield f"Runs failed.{uneven}"
    if uneven := repeated_by_treatment(results, design):
        yield f"Runs were repeated after attempts that failed.{uneven}"
    for name in measures:
        if uneven := missing_by_treatment(results, design, name):
            yield f"{name} has missing values.{uneven}"
        for text in limits_in_words(results, design, name):
            yield f"{name} may have a limit: {text}"


def failed_by_treatment(results: Results, design: DesignSummary) -> str:
    """Return which treatments more runs failed with; nothing where as many failed with each, or hardly any."""
    runs = results.confirming.runs
    status = runs[STATUS].astype("str")
    ended = runs[status.isin([RunStatus.DONE.value, RunStatus.FAILED.value])]
    failed = set(runs.loc[status == RunStatus.FAILED.value, RUN_ID])
    return f"{uneven} {_OF_OTHERS}" if (uneven := _by_treatment(ended, failed, design)) else ""


def repeated_by_treatment(results: Results, design: DesignSummary) -> str:
    """Return which treatments more runs are done with only after an attempt that failed, which counts nowhere."""
    attempts = results.attempts
    failed = set(attempts.loc[attempts["status"].astype("str") == "failed", RUN_ID])
    done = results.confirming.done
    uneven = _by_treatment(done, failed & set(done[RUN_ID]), design)
    return f"{uneven} {_OF_SUCCESSES}" if uneven else ""


def failures_in_words(results: Results) -> str:
    """Return how many runs failed, where an experiment is compared with others; nothing where hardly any did."""
    counts = results.confirming.runs[STATUS].astype("str").value_counts()
    failed, done = (int(counts.get(each.value, 0)) for each in (RunStatus.FAILED, RunStatus.DONE))
    if failed < _FEWEST:
        return ""
    return (
        f"{failed:,} of {counted(done + failed, 'run')} failed: means are of the others, and where those are lost that "
        "take long, say, look better than those of all"
    )


def missing_by_treatment(results: Results, design: DesignSummary, measure: str) -> str:
    """Return with which treatments more runs that are done lack a value; nothing of what an operator is asked for."""
    if results.columns[measure].owner == OPERATOR_OWNER:  # now and then
        return ""
    done = results.confirming.done
    uneven = _by_treatment(done, set(done.loc[done[measure].isna(), RUN_ID]), design)
    return f"{uneven} {_OF_OTHERS}" if uneven else ""


def limits_in_words(results: Results, design: DesignSummary, measure: str) -> Iterator[str]:
    """Yield how many runs have the very largest value of a measure, or the smallest, where that may be a limit."""
    done = results.confirming.done
    values = done[measure]
    if isinstance(values.dtype, pd.BooleanDtype) or not pd.api.types.is_numeric_dtype(values):
        return
    known = values.dropna()
    for word, end, beyond in (("largest", known.max(), "larger"), ("smallest", known.min(), "smaller")):
        at, others = done.loc[values == end, RUN_ID], known[known != end]
        is_often = len(at) >= max(_FEWEST_AT_LIMIT, _SHARE_AT_LIMIT * len(known))
        if not is_often or end == 0 or others.nunique() < max(_FEWEST_AT_LIMIT, _LEAST_APART * len(others)):
            continue  # 0 is the end of most ranges
        yield (
            f"{len(at):,} of {counted(len(known), 'run')} have the {word} value, "
            f"{with_unit(float(end), results.unit(measure))}.{_by_treatment(done, set(at), design)} Where that is a "
            f"limit, such as a timeout, the true values are {beyond}: means and differences are not what they seem."
        )


def _by_treatment(runs: pd.DataFrame, lost: set[str], design: DesignSummary) -> str:
    """Return a sentence on each factor, with a blank before it; nothing where as many are lost of each treatment."""
    if len(lost) < _FEWEST:
        return ""
    is_lost = runs[RUN_ID].isin(lost)
    found: list[tuple[float, str]] = []
    for name in (*design.factors, *design.constant_factors):
        by = is_lost.groupby(runs[name].astype("str"), sort=False).agg(["sum", "size"])
        shares = by["sum"] / by["size"]
        if (apart := float(shares.max() - shares.min())) > 0:
            rows = by.loc[shares.sort_values(ascending=False, kind="stable").index].itertuples()
            told = [f"{treatment} {row_lost:,} of {counted(size, 'run')}" for treatment, row_lost, size in rows]
            found.append((apart, f" By {name}: {listed(told)}."))
    return "".join(text for _, text in sorted(found, key=lambda each: -each[0])[:_MOST_FACTORS])
