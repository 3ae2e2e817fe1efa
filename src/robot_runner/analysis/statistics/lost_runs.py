"""Runs that failed, values that are missing or at a limit, by treatment, and runs that are one execution again.

Runs that fail are seldom any runs: those fail that take longer than is waited for, or drive until the battery is
empty. A mean of the others is not that of the treatment, and no test tells. Nor does one where a timeout was written
down as if it were how long the run took, or the time at which a mission failed as if it were what the mission takes.
Nor does one of repetitions that are the same execution.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from robot_runner.analysis.importing.units import TIME_UNITS
from robot_runner.analysis.wording import with_unit
from robot_runner.core.design.columns import RUN_ID, STATUS
from robot_runner.core.events.measure import OPERATOR_OWNER
from robot_runner.core.storage.cells import RunStatus
from robot_runner.core.words import counted, listed

if TYPE_CHECKING:
    from robot_runner.analysis.results import Results
    from robot_runner.analysis.statistics.outcome import DesignSummary

_OF_OTHERS = (
    "Means are of the others: where those are lost that take long or do not succeed, say, a treatment looks better the "
    "more of its runs it loses."
)
_OF_SUCCESSES = (
    "Means are of the attempts that succeeded: where those fail that take long, say, a treatment looks better the more "
    "of its attempts fail."
)
#: The fewest lost runs for a warning: a single one does not show which treatments lose more.
_FEWEST = 2
_MOST_FACTORS = 3
#: An end of the range may be a limit if this many runs and this share have it, and this share of the others differ
#: from each other: counts often are at their largest, too.
_FEWEST_AT_LIMIT, _SHARE_AT_LIMIT, _LEAST_APART = 3, 0.1, 0.8
#: Times that were measured at a timeout differ by the moments until it is noticed: this share of the range at the most.
_WIDTH_OF_LIMIT = 0.01
#: The title of what `repeats_in_words` yields.
REPEATED = "Repetitions have the same values"
#: Values that were rounded to so many decimals, as those of the simulator's clock, and ratios of whole numbers up to
#: this one, as those of coarse sensors and means of few answers, come twice by chance.
_DECIMALS, _COARSE, _ROUNDED = 9, 10**5, 1e-13
#: What `ActionMission` calls the measure that says whether its goal was reached.
_SUCCESS = "Success"


def lost_warnings(results: Results, design: DesignSummary, measures: Sequence[str]) -> Iterator[str]:
    """Yield warnings on failed runs and missions, missing values, and values at a limit."""
    if uneven := failed_by_treatment(results, design):
        yield f"Runs failed.{uneven}"
    if uneven := repeated_by_treatment(results, design):
        yield f"Runs were repeated after attempts that failed.{uneven}"
    for text in unsuccessful_in_words(results, design):
        yield f"Missions did not succeed: {text}"
    for name in measures:
        if uneven := missing_by_treatment(results, design, name):
            yield f"{name} has missing values.{uneven}"
        for text in limits_in_words(results, design, name):
            yield f"{name} may have a limit: {text}"
    for text in repeats_in_words(results, design, measures):
        yield f"{REPEATED}: {text}"


def failed_by_treatment(results: Results, design: DesignSummary) -> str:
    """Return which treatments have more failed runs; empty if shares are equal, or hardly any run failed."""
    runs = results.confirming.runs
    status = runs[STATUS].astype("str")
    ended = runs[status.isin([RunStatus.DONE.value, RunStatus.FAILED.value])]
    failed = set(runs.loc[status == RunStatus.FAILED.value, RUN_ID])
    return f"{uneven} {_OF_OTHERS}" if (uneven := _by_treatment(ended, failed, design)) else ""


def repeated_by_treatment(results: Results, design: DesignSummary) -> str:
    """Return which treatments have more runs that succeeded only after failed attempts, which are not analysed."""
    attempts = results.attempts
    failed = set(attempts.loc[attempts["status"].astype("str") == "failed", RUN_ID])
    done = results.confirming.done
    uneven = _by_treatment(done, failed & set(done[RUN_ID]), design)
    return f"{uneven} {_OF_SUCCESSES}" if uneven else ""


def failures_in_words(results: Results) -> str:
    """Return how many runs failed, for comparisons with other experiments; empty if hardly any did."""
    counts = results.confirming.runs[STATUS].astype("str").value_counts()
    failed, done = (int(counts.get(each.value, 0)) for each in (RunStatus.FAILED, RunStatus.DONE))
    if failed < _FEWEST:
        return ""
    return (
        f"{failed:,} of {counted(done + failed, 'run')} failed: means are of the others, and where those are lost that "
        "take long, say, look better than those of all"
    )


def missing_by_treatment(results: Results, design: DesignSummary, measure: str) -> str:
    """Return which treatments have more missing values; empty for values that an operator enters."""
    if results.columns[measure].owner == OPERATOR_OWNER:  # now and then
        return ""
    done = results.confirming.done
    uneven = _by_treatment(done, set(done.loc[done[measure].isna(), RUN_ID]), design)
    return f"{uneven} {_OF_OTHERS}" if uneven else ""


def limits_in_words(results: Results, design: DesignSummary, measure: str) -> Iterator[str]:
    """Yield how many runs have the largest or smallest value of a measure, if that may be a limit."""
    done = results.confirming.done
    values = done[measure]
    if isinstance(values.dtype, pd.BooleanDtype) or not pd.api.types.is_numeric_dtype(values):
        return
    known = values.dropna()
    for word, end, beyond in (("largest", known.max(), "larger"), ("smallest", known.min(), "smaller")):
        is_at, nearly = values == end, ""
        if word == "largest" and results.unit(measure) in TIME_UNITS and not _is_limit(known, known == end):
            is_at, nearly = values >= end - _width(known), "nearly "
        if not _is_limit(known, is_at[known.index]) or (nearly and _is_dense_below(known, is_at[known.index])):
            continue
        at, having = done.loc[is_at.fillna(value=False), RUN_ID], done.loc[known.index]
        yield (
            f"{len(at):,} of {counted(len(known), 'run')} have {nearly}the {word} value, "
            f"{with_unit(float(end), results.unit(measure))}.{_by_treatment(having, set(at), design)} Where that is a "
            f"limit, such as a timeout, the true values are {beyond}: means and differences are not what they seem."
        )


def _width(known: pd.Series[float]) -> float:
    return _WIDTH_OF_LIMIT * (float(known.max()) - float(known.min()))


def _is_limit(known: pd.Series[float], is_at: pd.Series[bool]) -> bool:
    """Return whether so many values at an end of the range are not chance, as hardly any of the others are alike."""
    count, others = int(is_at.sum()), known[~is_at]
    is_often = count >= max(_FEWEST_AT_LIMIT, _SHARE_AT_LIMIT * len(known))
    is_apart = others.nunique() >= max(_FEWEST_AT_LIMIT, _LEAST_APART * len(others))
    return is_often and is_apart and not (known[is_at] == 0).any()  # 0 is the end of most ranges


def _is_dense_below(known: pd.Series[float], is_at: pd.Series[bool]) -> bool:
    """Return whether as many of the other values lie as close together somewhere."""
    others, width = np.sort(known[~is_at].to_numpy(float)), _width(known)
    alike = np.searchsorted(others, others + width, "right") - np.arange(len(others))
    return bool(alike.max() >= is_at.sum())


def repeats_in_words(results: Results, design: DesignSummary, measures: Sequence[str]) -> Iterator[str]:
    """Yield how many runs have exactly the value of another run of their combination, in another block if any."""
    done, block = results.confirming.done, [design.block] if design.block else []
    for name in measures:
        if not pd.api.types.is_float_dtype(done[name]):
            continue
        known = done.dropna(subset=[name]).drop_duplicates([*design.factors, *block, name] if block else [RUN_ID])
        again = known.loc[known.duplicated([*design.factors, name]), name]
        count = sum(not _is_coarse(value) for value in again)
        if count >= max(_FEWEST_AT_LIMIT, _SHARE_AT_LIMIT * len(known)):
            yield (
                f"{count:,} of {counted(len(known), 'run')} have, to the last digit, the {name} of an earlier run of "
                "their combination. Where these are the same execution again, as with a seed that is fixed, they are "
                "no runs of their own: p-values are too small, and intervals too narrow."
            )


def _is_coarse(value: float) -> bool:
    if not np.isfinite(value) or round(value, _DECIMALS) == value:
        return True
    near = float(Fraction(value).limit_denominator(_COARSE))
    return abs(near - value) <= _ROUNDED * max(1.0, abs(value))


def unsuccessful_in_words(results: Results, design: DesignSummary) -> Iterator[str]:
    """Yield how many missions did not succeed though their runs are done, where quantities of these are analysed."""
    done = results.confirming.done
    dtypes = [done[name].dtype for name in results.measures]
    if not any(pd.api.types.is_numeric_dtype(each) and not pd.api.types.is_bool_dtype(each) for each in dtypes):
        return
    for name, values in _successes(results):
        known = done[RUN_ID].map(values).dropna()
        failed, having = done.loc[known.index[~known.astype(bool)], RUN_ID], done.loc[known.index]
        if len(failed):
            yield (
                f"{name} is no in {len(failed):,} of {counted(len(known), 'run')}."
                f"{_by_treatment(having, set(failed), design)} Their durations, energies and whatever else grows with "
                "time are those until they failed or were broken off: a treatment whose missions fail early looks fast "
                "and frugal, and one whose missions end at a deadline less slow than it is. Means and tests are of all "
                f"runs: compare {name} first."
            )


def _successes(results: Results) -> Iterator[tuple[str, pd.Series[Any]]]:
    """Yield the name of each measure of success, with or without a column, and its values by run id."""
    runs, published = results.done.set_index(RUN_ID), results.published
    names = dict.fromkeys((*results.measures, *published["measure"].unique()))
    for name in (each for each in names if each.rpartition(".")[2] == _SUCCESS):
        values = published[published["measure"] == name].set_index(RUN_ID)["value"]
        known = (runs[name] if name in results.columns else values).dropna().infer_objects()
        if pd.api.types.is_bool_dtype(known):
            yield name, known


def _by_treatment(runs: pd.DataFrame, lost: set[str], design: DesignSummary) -> str:
    """Return a sentence on each factor, after a space; empty if all treatments lose the same share of runs."""
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
