"""The order in which the runs that are done were executed, and how far time stamps tell it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from robot_runner.core.design.columns import RUN_ID

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from robot_runner.analysis.results import Results

#: The time stamp that runs are ordered by.
STAMP = "start_measurement_at"


@dataclass(frozen=True, slots=True)
class ExecutionOrder:
    """The order of execution of the runs that are done.

    Attributes:
        places: of each run, from 1.
        is_known: whether runs or the journal tell it; else it is the order of the table.
        has_times: whether differences of time stamps are times that went by: not once the clock was set back.
    """

    places: NDArray[np.int64]
    is_known: bool
    has_times: bool


def execution_order(results: Results) -> ExecutionOrder:
    """Return the order by time stamps; that of the journal where these lack, or where the clock was set back."""
    done = results.confirming.done
    is_stamped = STAMP in done and bool(done[STAMP].notna().all())
    attempts, is_imported = results.attempts, results.manifest.get("origin") == "imported"
    # The journal of an import has the order of the table, and times from elsewhere.
    is_set_back = bool(attempts.attrs.get("clock_was_set_back")) and not is_imported
    if is_stamped and not is_set_back:
        places = np.asarray(done[STAMP].rank(method="first"), dtype=np.int64)
        return ExecutionOrder(places, is_known=True, has_times=True)
    begun = () if is_imported else attempts.drop_duplicates(RUN_ID, keep="last")[RUN_ID]
    place_of = {run_id: place for place, run_id in enumerate(begun)}
    told = [place_of[run_id] for run_id in done[RUN_ID] if run_id in place_of]
    is_told = bool(told) and len(told) == len(done)
    places = np.argsort(np.argsort(told)) + 1 if is_told else np.arange(1, len(done) + 1, dtype=np.int64)
    return ExecutionOrder(places, is_known=is_told, has_times=not is_set_back)
