"""Raw samples of many runs as one table, built column by column to need little more memory than the table itself."""

from __future__ import annotations

import io
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from os import cpu_count
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
import pyarrow as pa
from pyarrow import csv as arrow_csv

from robot_runner.analysis.arrays import Floats
from robot_runner.core.errors import AnalysisError, did_you_mean
from robot_runner.core.storage.guarded_files import open_to_read
from robot_runner.core.storage.system_refusals import storage_error

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from robot_runner.analysis.sample_files import PhaseSpans, SampleFile


class GrowingColumn:
    """One column of samples that grows run by run, so that no sample is in memory twice.

    It holds whole numbers, floats (NaN for missing values), timestamps or texts; its type widens when a piece needs it.
    Joining the pieces at the end (`pyarrow.concat_tables`) would take nearly twice the memory, too much for 10 million
    samples.

    Example:
        >>> column = GrowingColumn(expected=3)
        >>> column.append(pa.chunked_array([[1, 2]]))
        >>> column.append(pa.chunked_array([[0.5]]))
        >>> column.values().tolist()
        [1.0, 2.0, 0.5]
    """

    def __init__(self, expected: int) -> None:
        self._expected = expected
        self._length = 0
        self._numbers: NDArray[Any] = np.empty(0, dtype=np.int64)
        self._is_missing = True  # whether all values so far are
        self._texts: list[pa.Array] | None = None

    def append(self, piece: pa.ChunkedArray) -> None:
        """Add the values of another run."""
        if pa.types.is_null(piece.type) and not len(piece):  # a file without a row
            return
        dtype = self._dtype_with(piece)
        if self._texts is not None or dtype is None:
            self._append_texts(piece)
            return
        begin, self._length = self._length, self._length + len(piece)
        if self._length > len(self._numbers) or dtype != self._numbers.dtype:
            size = len(self._numbers) if self._length <= len(self._numbers) else self._length + self._length // 4
            wider = np.empty(max(self._expected, size), dtype=dtype)
            wider[:begin] = self._numbers[:begin]
            self._numbers = wider
        self._numbers[begin : self._length] = piece.to_numpy()
        self._is_missing &= pa.types.is_null(piece.type)

    def values(self) -> Any:
        """Return all values: an array, or a categorical for texts."""
        if self._texts is not None:
            return _categorical(self._texts)
        return np.full(self._length, np.nan) if self._is_missing else self._numbers[: self._length]

    def _dtype_with(self, piece: pa.ChunkedArray) -> np.dtype[Any] | None:
        """Return the type that holds the values so far and another piece; None if only texts do."""
        own, so_far = _dtype(piece), self._numbers.dtype
        if own is None or "M" not in {own.kind, so_far.kind}:
            return None if own is None else np.result_type(so_far, own)
        is_joined = own == so_far or self._is_missing or pa.types.is_null(piece.type)
        return np.dtype("datetime64[ns]") if is_joined else None

    def _append_texts(self, piece: pa.ChunkedArray) -> None:
        if self._texts is None:
            self._texts = [pa.array(self._numbers[: self._length], from_pandas=True).cast(pa.string())]
            self._numbers = self._numbers[:0]
        self._texts += piece.cast(pa.string()).chunks


def _dtype(piece: pa.ChunkedArray) -> np.dtype[Any] | None:
    """Return the type of an array for the values of a piece; None for texts."""
    kind = piece.type
    if pa.types.is_timestamp(kind):
        return np.dtype("datetime64[ns]")
    if pa.types.is_integer(kind) and not piece.null_count:
        return np.dtype("int64")
    tests = (pa.types.is_integer, pa.types.is_floating, pa.types.is_boolean, pa.types.is_null)
    return np.dtype("float64") if any(test(kind) for test in tests) else None


def _categorical(texts: list[pa.Array]) -> pd.Categorical:
    coded = pa.chunked_array(texts, pa.string()).dictionary_encode().combine_chunks()
    if isinstance(coded, pa.ChunkedArray):
        coded = coded.chunk(0)
    codes = coded.indices.fill_null(-1).to_numpy(zero_copy_only=False)
    return pd.Categorical.from_codes(codes, coded.dictionary.to_pylist())


#: Threads, and how many tables each may be ahead of what is copied.
_MOST_THREADS, _AHEAD = 8, 4

#: Allocated memory that is never touched costs nothing; growing later costs a copy.
_SPARE = 1.05


@dataclass(frozen=True, slots=True)
class SampleRequest:
    """The file, runs and columns to read.

    Attributes:
        file: the kind of file.
        run_ids: the runs, in the order of the rows.
        columns: the value columns.
        starts: the zero of each run's times, s on the samples' clock; a run without one counts from its first sample.
        windows: beginning and end of each run's measured window, s on the samples' clock; all samples of a run without
            one count as inside. None to leave the column out.
        phases: the phases of each run; None to leave them out.
        factors: the treatments of each run, by factor: categoricals as long as `run_ids`.
        unfinished: runs that are not done: the last line of their files may be cut off.
    """

    file: SampleFile
    run_ids: Sequence[str]
    columns: Sequence[str]
    starts: Mapping[str, float] = field(default_factory=dict)
    windows: Mapping[str, tuple[float, float]] | None = None
    phases: Mapping[str, PhaseSpans] | None = None
    factors: Mapping[str, pd.Categorical] = field(default_factory=dict)
    unfinished: frozenset[str] = frozenset()


def read_samples(request: SampleRequest) -> pd.DataFrame:
    """Read raw samples of several runs; `attrs["skipped_rows"]` counts malformed rows, by run.

    Raises:
        AnalysisError: there is no such column, or a file is not a table.
        StorageError: a file cannot be read.
    """
    checked_columns(request)
    reader = _Reader(request)
    lengths, columns = _gather(reader)
    frame = pd.DataFrame(_columns(request, lengths, columns), copy=False)
    frame.attrs["source"] = request.file.label
    frame.attrs["skipped_rows"] = dict(reader.skipped)
    return frame


def checked_columns(request: SampleRequest) -> None:
    """Check that the columns of a request exist.

    Raises:
        AnalysisError: one does not; the error names the nearest.
    """
    for name in request.columns:
        if name not in request.file.columns:
            fix = did_you_mean(name, request.file.columns)
            raise AnalysisError(f"there is no column {name!r}", where=request.file.label, fix=fix)


def sample_source(request: SampleRequest, run_id: str) -> Any:
    """Open the file of a run for Arrow, to be closed by the caller; of a run that is not done, its complete lines.

    Raises:
        StorageError: the file is not a regular one, or cannot be read.
    """
    file = open_to_read(request.file.paths[run_id])
    if run_id not in request.unfinished:
        return file
    with file:
        content = file.read()
    return io.BytesIO(content[: content.rfind(b"\n") + 1])


def csv_options(
    request: SampleRequest, types: Mapping[str, pa.DataType], skip: Callable[[object], str] = lambda _: "skip"
) -> dict[str, Any]:
    """Return Arrow's options for the files of a request; `skip` is called for rows with too many or too few cells."""
    return {
        "parse_options": arrow_csv.ParseOptions(invalid_row_handler=skip),
        "convert_options": arrow_csv.ConvertOptions(
            include_columns=[request.file.time, *request.columns],
            include_missing_columns=True,
            column_types=dict(types),
            strings_can_be_null=True,
        ),
    }


def _gather(reader: _Reader) -> tuple[NDArray[np.int64], dict[str, Any]]:
    """Copy each table into the columns as soon as it is read, so that only a few tables are in memory at once."""
    lengths: list[int] = []
    columns: dict[str, GrowingColumn] = {}
    for table in reader.tables():
        if not columns:
            columns = {name: GrowingColumn(reader.expected_rows(table.num_rows)) for name in reader.wanted}
        lengths.append(table.num_rows)
        for name, column in columns.items():
            column.append(table.column(name))
    return np.array(lengths, dtype=np.int64), {
        name: columns[name].values() if columns else [] for name in reader.wanted
    }


def _columns(request: SampleRequest, lengths: NDArray[np.int64], columns: dict[str, Any]) -> dict[str, Any]:
    slices = _slices(request.run_ids, lengths)
    times = np.asarray(columns.pop(request.file.time), dtype=np.float64)
    labels = labels_of(request.run_ids, request.factors, lengths)
    phases: dict[str, Any] = {}
    if request.phases is not None:
        names = list(dict.fromkeys(name for spans in request.phases.values() for name in spans.names))
        codes, numbers = places_of_phases(request.phases, names, times, slices)
        phases = {"phase": pd.Categorical.from_codes(codes, names), "phase_number": numbers}
    within = {} if request.windows is None else {"in_window": are_within(request.windows, times, slices)}
    for run, place in slices.items():
        if place.stop > place.start:
            times[place] -= request.starts.get(run, times[place.start])
    return {**labels, "time_s": times, **within, **phases, **columns}


def are_within(
    windows: Mapping[str, tuple[float, float]], times: Floats, slices: Mapping[str, slice]
) -> NDArray[np.bool_]:
    """Return whether each sample lies in its run's window."""
    are_within = np.ones(len(times), dtype=bool)
    for run, place in slices.items():
        if run in windows:
            start, end = windows[run]
            are_within[place] = (times[place] >= start) & (times[place] <= end)
    return are_within


def _slices(run_ids: Sequence[str], lengths: NDArray[np.int64]) -> dict[str, slice]:
    ends = np.cumsum(lengths)
    return {run: slice(int(end - length), int(end)) for run, end, length in zip(run_ids, ends, lengths, strict=True)}


class _Reader:
    """Reads the files of a request, several at once."""

    def __init__(self, request: SampleRequest) -> None:
        self._request = request
        self.wanted = [request.file.time, *request.columns]
        self.skipped: Counter[str] = Counter()

    def tables(self) -> Iterator[pa.Table]:
        """Yield the table of each run, in order; a few are read ahead."""
        run_ids = self._request.run_ids
        if not run_ids:
            return
        first = self._read_one(run_ids[0], {})
        yield first
        # The types of the first file are used for all, so that Arrow need not infer them for each.
        types = {each.name: each.type for each in first.schema if not pa.types.is_null(each.type)}
        del first
        threads = min(_MOST_THREADS, cpu_count() or 1)
        with ThreadPoolExecutor(threads) as pool:
            for begin in range(1, len(run_ids), _AHEAD * threads):
                several = run_ids[begin : begin + _AHEAD * threads]
                yield from pool.map(lambda run_id: self._read_one(run_id, types), several)

    def expected_rows(self, first: int) -> int:
        """Estimate the number of rows of all files from their sizes and the rows of the first."""
        sizes = [self._request.file.paths[run_id].stat().st_size for run_id in self._request.run_ids]
        return int(first * sum(sizes) / max(1, sizes[0]) * _SPARE) + first

    def _read_one(self, run_id: str, types: Mapping[str, pa.DataType]) -> pa.Table:
        path = self._request.file.paths[run_id]
        try:
            return self._parsed(run_id, types)
        except pa.ArrowInvalid as error:
            if not types:
                fix = "Correct it, or move it away."
                raise AnalysisError(f"the file is not a table of samples: {error}", where=str(path), fix=fix) from error
        except OSError as error:
            raise storage_error(path, "read", error) from error
        return self._read_one(run_id, {})

    def _parsed(self, run_id: str, types: Mapping[str, pa.DataType]) -> pa.Table:
        def skip(row: object) -> str:
            del row
            self.skipped[run_id] += 1
            return "skip"

        self.skipped.pop(run_id, None)
        with sample_source(self._request, run_id) as source:
            options = csv_options(self._request, types, skip)
            return arrow_csv.read_csv(source, read_options=arrow_csv.ReadOptions(use_threads=False), **options)


def labels_of(
    run_ids: Sequence[str], factors: Mapping[str, pd.Categorical], lengths: NDArray[np.int64]
) -> dict[str, Any]:
    """Return the run and its treatments for each sample as categoricals, given the number of samples of each run."""
    count = len(run_ids)
    kind = next(kind for kind in (np.int8, np.int16, np.int32) if count <= np.iinfo(kind).max)
    places = np.repeat(np.arange(count, dtype=kind), lengths)
    labels: dict[str, Any] = {"run_id": pd.Categorical.from_codes(places, list(run_ids))}
    for name, treatments in factors.items():
        codes = np.repeat(np.asarray(treatments.codes), lengths)
        labels[name] = pd.Categorical.from_codes(codes, treatments.categories, ordered=True)
    return labels


def places_of_phases(
    phases: Mapping[str, PhaseSpans], names: Sequence[str], times: Floats, slices: Mapping[str, slice]
) -> tuple[NDArray[Any], NDArray[np.int16]]:
    """Return the phase of each sample, by its time, s on the run's clock; `slices` has the samples of each run.

    Returns:
        The index of the phase's name in `names`, and its number; -1 and 0 outside all phases.
    """
    codes: NDArray[Any] = np.full(len(times), -1, dtype=np.int8 if len(names) <= np.iinfo(np.int8).max else np.int32)
    numbers: NDArray[np.int16] = np.zeros(len(times), dtype=np.int16)
    known = {name: place for place, name in enumerate(names)}
    for run, place in slices.items():
        spans = phases.get(run)
        if spans is None or not spans.names:
            continue
        within = times[place]
        found = np.searchsorted(spans.starts, within, side="right") - 1
        inside = (found >= 0) & (within < spans.ends[found])
        numbers[place] = np.where(inside, spans.numbers[found], 0)
        codes[place] = np.where(inside, np.array([known[name] for name in spans.names])[found], -1)
    return codes, numbers
