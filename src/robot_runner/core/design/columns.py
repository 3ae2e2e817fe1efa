"""Names of run-table columns: reserved ones, and checks of others."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterator
from typing import Protocol

from robot_runner.core.errors import Finding


class _Named(Protocol):
    @property
    def name(self) -> str: ...


#: How a config names a column of its own: by a name, or by a measure with a name.
NamedColumn = str | _Named

RUN_ID = "run_id"
#: Valid run ids, which are names of folders.
RUN_IDS = re.compile(r"\w[\w.-]{0,59}")
STATUS = "status"
#: Why a run is left out of the analysis; exists once a run was ever excluded.
EXCLUDED = "excluded"
REPETITION = "Repetition"
#: In which batch a run was planned; exists once an experiment was extended.
BATCH = "batch"
#: Whether a run only warms up; exists where a design has such runs.
WARM_UP = "warm_up"

#: When each event of a run was emitted, in the order of the events (paper, Fig. 2 and 3).
STAMP_COLUMNS = (
    "before_run_at",
    "start_run_at",
    "start_measurement_at",
    "launch_mission_at",
    "stop_measurement_at",
    "stop_run_at",
    "populate_run_data_at",
    "continue_at",
)

#: Unicode categories: control characters, line and paragraph separators, and lone surrogates (UTF-8 has none).
_UNFIT_CATEGORIES = frozenset({"Cc", "Zl", "Zp", "Cs"})

_TAKEN = (RUN_ID, STATUS, EXCLUDED, "attempt", *STAMP_COLUMNS)


def column_name(column: object) -> object:
    """Return the name of a `NamedColumn`; any other object is returned unchanged."""
    return column if isinstance(column, str) else getattr(column, "name", column)


def numbered_run_id(number: int) -> str:
    """Return the id of a run by its number (from 1) in a planned run table, as in the paper's Fig. 3."""
    return f"r_{number}"


def numbered_warm_up_id(number: int) -> str:
    """Return the id of a warm-up run by its number (from 1)."""
    return f"w_{number}"


def reserved_names(repetitions: int, *, warms_up: bool = False) -> tuple[str, ...]:
    """Return the column names that no factor or measure may have, in any case of letters."""
    return (*_TAKEN, *([REPETITION] if repetitions > 1 else []), *([WARM_UP] if warms_up else []))


def is_fit_for_heading(character: str) -> bool:
    """Return whether a character is allowed in a heading, see `_UNFIT_CATEGORIES`."""
    return unicodedata.category(character) not in _UNFIT_CATEGORIES


def name_findings(name: object, *, kind: str, repetitions: int = 1, warms_up: bool = False) -> Iterator[Finding]:
    """Yield an error for each reason why `name` cannot be a heading.

    `kind` says what it is the name of, as in `factor`. `Repetition` is reserved where each combination has two
    `repetitions` or more, and `warm_up` where there are warm-up runs (`warms_up`).
    """
    where = f"{kind} {name!r}"
    if not isinstance(name, str):
        yield Finding.error(where, f"the name is of type {type(name).__name__}", "Give a string.")
    elif not name.strip():
        yield Finding.error(where, "the name is empty", "Give it a name.")
    elif name != name.strip():
        yield Finding.error(where, "the name begins or ends with a blank", f"Write {name.strip()!r}.")
    elif odd := [character for character in name if not is_fit_for_heading(character)]:
        yield Finding.error(where, f"the name holds {odd[0]!r}, which no heading can hold", "Leave it out.")
    elif name.casefold() in {taken.casefold() for taken in reserved_names(repetitions, warms_up=warms_up)}:
        is_count = name.casefold() == REPETITION.casefold()
        fix = f"Choose another name{', or leave out repetitions= and vary it as a factor' if is_count else ''}."
        yield Finding.error(where, "the run table has a column of that name already", fix)
