"""Raw samples read batch by batch, for more of them than fit into memory."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa
from pyarrow import csv as arrow_csv

from robot_runner.analysis.arrays import Floats
from robot_runner.analysis.samples import (
    SampleRequest,
    are_within,
    checked_columns,
    csv_options,
    places_of_phases,
    sample_source,
)
from robot_runner.core.errors import AnalysisError
from robot_runner.core.storage.system_refusals import storage_error

if TYPE_CHECKING:
    import pandas as pd
    from numpy.typing import NDArray

    from robot_runner.analysis.sample_files import PhaseSpans

#: Bytes of a file that are parsed at once: about 20,000 samples of six columns. Arrow reads about 30 blocks ahead.
_BLOCK = 1 << 20


@dataclass(frozen=True)
class LazySamples:
    """A selection of raw samples; each use reads the files again, one batch at a time.

    The columns are those of `Results.samples`. Numbers are float64 in every batch, so that all batches have one schema.

    Attributes:
        request: the kind of file, the runs and the columns.
        within_window: whether samples outside the measured window are left out.
        only_phases: the phases of each run whose samples are kept; None keeps all samples.

    Example:
        >>> samples = load_results("experiments/long").lazy_samples("Ina219", columns=["power_W"])  # doctest: +SKIP
        >>> max(batch["power_W"].max() for batch in samples.frames())  # doctest: +SKIP
        >>> pyarrow.parquet.write_table(samples.reader().read_all(), "samples.parquet")  # doctest: +SKIP
    """

    request: SampleRequest
    within_window: bool = False
    only_phases: Mapping[str, PhaseSpans] | None = None

    def reader(self) -> pa.RecordBatchReader:
        """Return a stream of Arrow record batches, for DuckDB, Polars, pyarrow.dataset and Parquet writers.

        Raises:
            AnalysisError: there is no such column; while reading: a file does not have the types of the first one.
            StorageError: a file cannot be read.
        """
        checked_columns(self.request)
        types = self._types()
        return pa.RecordBatchReader.from_batches(self._schema(types), self._batches(types))

    def frames(self) -> Iterator[pd.DataFrame]:
        """Yield data frames of about 20,000 samples, each of one run, in the order of the runs."""
        for batch in self.reader():
            yield batch.to_pandas()

    def frame(self) -> pd.DataFrame:
        """Return the whole selection as one data frame, which must fit into memory."""
        return self.reader().read_pandas()

    def _types(self) -> dict[str, pa.DataType]:
        """Return the type of each column, from the first blocks of files until all types are known."""
        types: dict[str, pa.DataType] = {self.request.file.time: pa.float64()}
        for run_id in self.request.run_ids:
            missing = [name for name in self.request.columns if name not in types]
            if not missing:
                break
            with self._opened(run_id, {}) as reader:
                for field in reader.schema:
                    if field.name in missing and not pa.types.is_null(field.type):
                        types[field.name] = _widened(field.type)
        return {name: types.get(name, pa.float64()) for name in (self.request.file.time, *self.request.columns)}

    def _schema(self, types: Mapping[str, pa.DataType]) -> pa.Schema:
        request = self.request
        fields = [("run_id", pa.dictionary(pa.int32(), pa.string()))]
        fields += [
            (name, pa.dictionary(pa.int32(), pa.array(each.categories).type, ordered=True))
            for name, each in request.factors.items()
        ]
        fields.append(("time_s", pa.float64()))
        if request.windows is not None:
            fields.append(("in_window", pa.bool_()))
        if request.phases is not None:
            fields += [("phase", pa.dictionary(pa.int32(), pa.string())), ("phase_number", pa.int16())]
        return pa.schema([*fields, *((name, types[name]) for name in request.columns)])

    def _batches(self, types: Mapping[str, pa.DataType]) -> Iterator[pa.RecordBatch]:
        schema, spans = self._schema(types), (self.request.phases or {}).values()
        run_ids = pa.array(list(self.request.run_ids), pa.string())
        factors = [(np.asarray(each.codes), pa.array(each.categories)) for each in self.request.factors.values()]
        phases = list(dict.fromkeys(name for each in spans for name in each.names))
        for place, run_id in enumerate(self.request.run_ids):
            start = self.request.starts.get(run_id)
            with self._opened(run_id, types) as reader:
                for raw in reader:
                    times = raw.column(self.request.file.time).to_numpy(zero_copy_only=False)
                    start = float(times[0]) if start is None and len(times) else start
                    columns, chosen = self._told(run_id, times, phases)
                    values = (raw.column(name) for name in self.request.columns)
                    since = pa.array(times - (start or 0.0), from_pandas=True)
                    run = _dictionary(np.full(len(times), place, np.int32), run_ids)
                    treatments = (
                        _dictionary(np.full(len(times), codes[place], np.int32), words, ordered=True)
                        for codes, words in factors
                    )
                    batch = pa.RecordBatch.from_arrays([run, *treatments, since, *columns, *values], schema=schema)
                    yield batch if chosen is None else batch.filter(pa.array(chosen))

    def _told(self, run_id: str, times: Floats, names: list[str]) -> tuple[list[pa.Array], NDArray[np.bool_] | None]:
        """Return the columns of the window and the phases, and which samples are selected (None for all)."""
        request, whole = self.request, {run_id: slice(0, len(times))}
        arrays: list[pa.Array] = []
        chosen: NDArray[np.bool_] | None = None
        if request.windows is not None:
            within = are_within(request.windows, times, whole)
            arrays.append(pa.array(within))
            chosen = within if self.within_window else None
        if request.phases is not None:
            codes, numbers = places_of_phases(request.phases, names, times, whole)
            arrays.append(_dictionary(codes.astype(np.int32), pa.array(names, pa.string())))
            arrays.append(pa.array(numbers))
            if self.only_phases is not None:
                there = places_of_phases(self.only_phases, names, times, whole)[0] >= 0
                chosen = there if chosen is None else chosen & there
        return arrays, chosen

    @contextmanager
    def _opened(self, run_id: str, types: Mapping[str, pa.DataType]) -> Iterator[arrow_csv.CSVStreamingReader]:
        """Open the file of a run, to be read while it is open.

        Raises:
            AnalysisError: the file does not have the columns and types of the first one.
            StorageError: the file cannot be read.
        """
        path, options = self.request.file.paths[run_id], csv_options(self.request, types)
        try:
            with sample_source(self.request, run_id) as source:
                yield arrow_csv.open_csv(source, read_options=arrow_csv.ReadOptions(block_size=_BLOCK), **options)
        except pa.ArrowInvalid as error:
            fix = "Leave the run or the column out, or read the samples with Results.samples, which widens types."
            problem = f"the file does not hold what the first one does: {error}"
            raise AnalysisError(problem, where=str(path), fix=fix) from error
        except OSError as error:
            raise storage_error(path, "read", error) from error


def _dictionary(codes: NDArray[np.int32], words: pa.Array, *, ordered: bool = False) -> pa.Array:
    return pa.DictionaryArray.from_arrays(pa.array(codes, mask=codes < 0), words, ordered=ordered)


def _widened(kind: pa.DataType) -> pa.DataType:
    """Return the type of a column in all files: whole numbers in one file may be fractions in the next."""
    is_kept = pa.types.is_boolean(kind) or pa.types.is_timestamp(kind)
    is_number = pa.types.is_integer(kind) or pa.types.is_floating(kind)
    return pa.float64() if is_number else kind if is_kept else pa.string()
