"""How an experiment is to go on: what is executed again, and what may differ from before."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from robot_runner.errors import ExecutionError, Finding, did_you_mean
from robot_runner.storage.run_status import RunStatus

if TYPE_CHECKING:
    from collections.abc import Iterable

    from robot_runner.storage.run_table_rows import RunTableRows

__all__ = ["Resumption", "selected_places"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Resumption:
    """What the user asks for when an experiment is started or goes on.

    Attributes:
        accept_changes: go on though the config, what was set, or the run table differs from before.
        redo: runs to execute again though they are done; what they left is kept.
        only: the only runs to execute; nothing means all.
    """

    accept_changes: bool = False
    redo: tuple[str, ...] = ()
    only: tuple[str, ...] = ()


def selected_places(rows: RunTableRows, resumption: Resumption) -> list[int]:
    """Return the places of the runs that are to be executed, in order.

    Raises:
        ExecutionError: a run that was named is not in the table; all of them are listed.
    """
    _refuse_unknown(rows, "--redo", resumption.redo)
    _refuse_unknown(rows, "--only", resumption.only)
    redo, only = set(resumption.redo), set(resumption.only)
    return [
        place
        for place in range(len(rows))
        if (rows.status(place) is not RunStatus.DONE or (redo and rows.run_id(place) in redo))
        and (not only or rows.run_id(place) in only or rows.run_id(place) in redo)
    ]


def _refuse_unknown(rows: RunTableRows, option: str, run_ids: Iterable[str]) -> None:
    unknown = [run_id for run_id in run_ids if rows.run_ids.place_of(run_id) is None]
    if unknown:
        known = [rows.run_id(place) for place in range(min(len(rows), 1000))]
        raise ExecutionError.of_findings(
            [
                Finding.error(f"{option} {run_id}", "the run table has no such run", did_you_mean(run_id, known))
                for run_id in unknown
            ]
        )
