"""The run table's columns in memory: each knows the value of a row and how its cells are written."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any, Protocol

from robot_runner.design.columns import RUN_ID, STATUS, numbered_run_id
from robot_runner.storage.cells import measure_text, quoted, quoted_all
from robot_runner.storage.run_status import RunStatus

if TYPE_CHECKING:
    from array import array
    from collections.abc import Iterable, Mapping, Sequence

    from robot_runner.storage.cells import CellValue

__all__ = ["CodedColumn", "MeasureColumn", "RunIdColumn", "StatusColumn", "TableColumn", "TextColumn"]

_STATUSES = tuple(RunStatus)
_PLACES_OF_STATUSES = {status: place for place, status in enumerate(_STATUSES)}
_STATUS_CELLS = tuple(status.value for status in _STATUSES)
_NUMBERED = re.compile(r"r_[1-9][0-9]{0,17}")


class TableColumn(Protocol):
    """One column of the run table."""

    name: str

    def value(self, place: int) -> Any:
        """Return the value in the row at `place`, counted from 0."""
        ...

    def cells(self, start: int, stop: int) -> Iterable[str]:
        """Return the cells of some rows as they stand in the file, quotes included."""
        ...


class RunIdColumn:
    """The ids of the runs. Numbered ones (`r_1`, `r_2`, ...) take no memory.

    Example:
        >>> RunIdColumn.numbered(3).place_of("r_3")
        2
    """

    def __init__(self, run_ids: Sequence[str] | None, count: int) -> None:
        self.name = RUN_ID
        self._run_ids = run_ids
        self._count = count
        self._places = None if run_ids is None else {run_id: place for place, run_id in enumerate(run_ids)}

    @classmethod
    def numbered(cls, count: int) -> RunIdColumn:
        """Return the ids of a planned run table."""
        return cls(None, count)

    def __len__(self) -> int:
        return self._count

    def value(self, place: int) -> str:
        """Return the id of the run at `place`."""
        return numbered_run_id(place + 1) if self._run_ids is None else self._run_ids[place]

    def place_of(self, run_id: str) -> int | None:
        """Return the place of a run, or None where there is no such run."""
        if self._places is not None:
            return self._places.get(run_id)
        number = int(run_id[2:]) if _NUMBERED.fullmatch(run_id) else 0
        return number - 1 if 1 <= number <= self._count else None

    def cells(self, start: int, stop: int) -> Iterable[str]:
        """Return the ids of some rows."""
        if self._run_ids is None:
            return map(numbered_run_id, range(start + 1, stop + 1))
        return map(quoted, self._run_ids[start:stop])


class StatusColumn:
    """How far each run has come, and how many have come how far."""

    def __init__(self, count: int) -> None:
        self.name = STATUS
        self._cells: tuple[str, ...] = _STATUS_CELLS
        self._codes = bytearray(count)
        self._counts = [0] * len(_STATUSES)
        self._counts[_PLACES_OF_STATUSES[RunStatus.TODO]] = count

    def __len__(self) -> int:
        return len(self._codes)

    def extend(self, words: Iterable[str], meaning: Mapping[str, RunStatus]) -> None:
        """Add rows whose statuses are written so."""
        code_of = {word: _PLACES_OF_STATUSES[status] for word, status in meaning.items()}
        added = bytes(map(code_of.__getitem__, words))
        self._codes += added
        for code in range(len(_STATUSES)):
            self._counts[code] += added.count(code)

    def value(self, place: int) -> RunStatus:
        """Return the status of the run at `place`."""
        return _STATUSES[self._codes[place]]

    def change(self, place: int, status: RunStatus) -> None:
        """Change the status of the run at `place`."""
        code = _PLACES_OF_STATUSES[status]
        self._counts[self._codes[place]] -= 1
        self._counts[code] += 1
        self._codes[place] = code

    def count(self, status: RunStatus) -> int:
        """Return how many runs have this status, at no cost that grows with the table."""
        return self._counts[_PLACES_OF_STATUSES[status]]

    def spell(self, words: Mapping[RunStatus, str]) -> None:
        """Write each status with this word from now on."""
        self._cells = tuple(quoted(words[status]) for status in _STATUSES)

    def cells(self, start: int, stop: int) -> Iterable[str]:
        """Return the words for the statuses of some rows."""
        return map(self._cells.__getitem__, self._codes[start:stop])


class CodedColumn:
    """Values that repeat, as the treatments of a factor: each is kept once, and every row keeps its place."""

    def __init__(self, name: str, values: Sequence[Any], texts: Sequence[str], places: array[int]) -> None:
        self.name = name
        self.values = values
        self.places = places
        self._cells = tuple(map(quoted, texts))

    def value(self, place: int) -> Any:
        """Return the value in the row at `place`."""
        return self.values[self.places[place]]

    def cells(self, start: int, stop: int) -> Iterable[str]:
        """Return the cells of some rows."""
        return map(self._cells.__getitem__, self.places[start:stop])


class TextColumn:
    """Text that the run table carries as it is: time stamps, and the columns that a user added."""

    def __init__(self, name: str, texts: list[str | None]) -> None:
        self.name = name
        self.texts = texts

    def value(self, place: int) -> str | None:
        """Return the text in the row at `place`; None where the cell is empty."""
        return self.texts[place]

    def cells(self, start: int, stop: int) -> Iterable[str]:
        """Return the cells of some rows."""
        return quoted_all([text or "" for text in self.texts[start:stop]])


class MeasureColumn:
    """The values of one measure."""

    def __init__(self, name: str, values: list[CellValue]) -> None:
        self.name = name
        self.values = values

    def value(self, place: int) -> CellValue:
        """Return the value in the row at `place`; None where it is missing."""
        return self.values[place]

    def cells(self, start: int, stop: int) -> Iterable[str]:
        """Return the cells of some rows."""
        return quoted_all(list(map(measure_text, self.values[start:stop])))
