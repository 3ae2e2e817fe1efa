"""How the run table of a study is read elsewhere: which rows count, and how its treatments are spelled."""

from __future__ import annotations

import csv
import hashlib
import io
import os
import re
from typing import TYPE_CHECKING

from robot_runner.analysis.recomputing.study_facts import FactorColumn, TableSource
from robot_runner.analysis.statistics.analysed_design import PLACE
from robot_runner.core.design.columns import EXCLUDED, RUN_ID, STATUS, WARM_UP
from robot_runner.core.storage.guarded_files import read_bytes
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.run_table_reading import delimiter_of, match_headings
from robot_runner.core.storage.system_refusals import storage_error
from robot_runner.core.storage.table_columns import TableLayout
from robot_runner.core.storage.table_decoders import TableFindings

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from robot_runner.analysis.results import Results
    from robot_runner.analysis.statistics.analysed_design import Design

__all__ = ["Cells", "factor_columns", "source_of"]

_MARK = "\ufeff"
_STAMP = "start_measurement_at"
#: Of this length and form, the order of texts is that of times.
_STAMPS = re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}Z", re.ASCII)


class Cells:
    """The cells of a run table as its file has them.

    Attributes:
        delimiter: what stands between the cells.
        renamed: columns that are headed by something else than their names: place from 1, and the name.
    """

    def __init__(self, path: Path, results: Results) -> None:
        try:
            text = read_bytes(path).decode()  # as it stands: R and pandas meet the byte order mark, too
        except ValueError as error:
            raise storage_error(path, "read", OSError(str(error))) from error
        layout = TableLayout.of_schema(tuple(results.columns.values()))
        lines = [line for line in text.splitlines(keepends=True) if line.strip()]
        self.delimiter = delimiter_of(lines[0].removeprefix(_MARK) if lines else "", layout)
        self._rows = [row for row in csv.reader(io.StringIO(text, newline=""), delimiter=self.delimiter) if row]
        first = self._rows.pop(0)
        bare = [first[0].removeprefix(_MARK), *first[1:]]
        self._places = dict(match_headings(bare, layout, TableFindings(path), line=1).places)
        self.renamed = tuple((at + 1, name) for name, at in self._places.items() if first[at] != name)

    def __contains__(self, name: object) -> bool:
        return name in self._places

    def column(self, name: str) -> list[str]:
        """Return the cells of a column; empty ones where it is not there."""
        place = self._places.get(name, -1)
        return [row[place] if 0 <= place < len(row) else "" for row in self._rows]


def source_of(results: Results, design: Design, cells: Cells, folder: Path) -> TableSource:
    """Return how the run table is read.

    Args:
        results: the experiment.
        design: of its runs that are done.
        cells: of its run table.
        folder: where the script will be.
    """
    path = ExperimentFolder.found_at(results.folder).run_table
    used = list(results.done[RUN_ID])
    chosen = _chosen(cells, used)
    wanted = set(used)
    stamps = [stamp for stamp, run in zip(cells.column(_STAMP), cells.column(RUN_ID), strict=True) if run in wanted]
    is_stamped = _STAMP in results.done and all(map(_STAMPS.fullmatch, stamps))
    places = [int(place) for place in design.frame[PLACE]]
    is_ordered = is_stamped or places == list(range(1, len(places) + 1))
    return TableSource(
        path=os.path.relpath(path.resolve(), folder.resolve()).replace(os.sep, "/"),
        checksum=hashlib.md5(read_bytes(path), usedforsecurity=False).hexdigest(),
        delimiter=cells.delimiter,
        renamed=cells.renamed,
        done=chosen or (),
        has_exclusions=EXCLUDED in cells,
        has_warm_ups=WARM_UP in cells,
        run_ids=() if chosen else tuple(used),
        stamp=_STAMP if is_stamped else "",
        places=() if is_ordered else tuple(places),
    )


def _chosen(cells: Cells, used: Sequence[str]) -> tuple[str, ...] | None:
    """Return the words for runs that are done, or None where the columns alone do not tell which runs count."""
    words = dict(zip(cells.column(RUN_ID), cells.column(STATUS), strict=True))
    done = tuple(dict.fromkeys(words.get(run, "") for run in used))
    excluded, warm_up = cells.column(EXCLUDED), cells.column(WARM_UP)
    found = [
        run
        for run, word, why, warms in zip(cells.column(RUN_ID), cells.column(STATUS), excluded, warm_up, strict=True)
        if word in done and not why and warms != "True"
    ]
    return done if found == list(used) and used else None


def factor_columns(design: Design, cells: Cells) -> tuple[FactorColumn, ...]:
    """Return the treatments of each factor as the file spells them, in their order."""
    place = {run: at for at, run in enumerate(cells.column(RUN_ID))}
    found = []
    for name in (*design.factors, *design.constant):
        texts = cells.column(name)
        spelled: dict[str, dict[str, None]] = {label: {} for label in design.frame[name].cat.categories}
        for run, label in zip(design.frame[RUN_ID], design.frame[name], strict=True):
            spelled[label][texts[place[run]]] = None
        pairs = [(text, str(label)) for label, those in spelled.items() for text in those]
        found.append(FactorColumn(name, tuple(text for text, _ in pairs), tuple(of for _, of in pairs)))
    return tuple(found)
