"""One column of samples that grows run by run, of whatever type its pieces turn out to be."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
import pyarrow as pa

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["GrowingColumn"]


class GrowingColumn:
    """Whole numbers, floats (NaN for what is missing), moments, or texts; the type widens when a piece asks for it.

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
        self._missing = 0  # values before the first piece that has a type
        self._numbers: NDArray[Any] | None = None
        self._texts: list[pa.Array] | None = None

    def append(self, piece: pa.ChunkedArray) -> None:
        """Add the values of another run."""
        if pa.types.is_null(piece.type) and self._numbers is None and self._texts is None:
            self._missing += len(piece)
        elif self._texts is not None or not _is_numeric(piece.type) or self._is_of_another_kind(piece):
            self._append_texts(piece)
        else:
            self._append_numbers(piece)

    def values(self) -> Any:
        """Return all values: an array, or a categorical where they are texts."""
        if self._texts is not None:
            return _categorical(self._texts)
        if self._numbers is None:
            return np.full(self._missing, np.nan)
        return self._numbers[: self._length]

    def _append_numbers(self, piece: pa.ChunkedArray) -> None:
        if self._numbers is None:
            self._numbers = np.empty(max(self._expected, self._missing + len(piece)), dtype=_dtype(piece))
            if self._missing:
                self._widen(_missing_dtype(self._numbers.dtype))
                self._numbers[: self._missing] = _nothing(self._numbers.dtype)
            self._length = self._missing
        needed = self._length + len(piece)
        if needed > len(self._numbers):
            self._numbers = np.resize(self._numbers, needed + needed // 4)
        self._widen(_common_dtype(self._numbers.dtype, piece))
        for chunk in piece.chunks:
            is_null = pa.types.is_null(chunk.type)
            stop = self._length + len(chunk)
            self._numbers[self._length : stop] = (
                _nothing(self._numbers.dtype) if is_null else chunk.to_numpy(zero_copy_only=False)
            )
            self._length = stop

    def _is_of_another_kind(self, piece: pa.ChunkedArray) -> bool:
        if self._numbers is None or pa.types.is_null(piece.type):
            return False
        return (self._numbers.dtype.kind == "M") is not bool(pa.types.is_timestamp(piece.type))

    def _widen(self, dtype: np.dtype[Any]) -> None:
        if self._numbers is not None and self._numbers.dtype != dtype:
            wider = np.empty(len(self._numbers), dtype=dtype)
            wider[: self._length] = self._numbers[: self._length]
            self._numbers = wider

    def _append_texts(self, piece: pa.ChunkedArray) -> None:
        if self._texts is None:
            self._texts = [pa.nulls(self._missing, pa.string())]
            if self._numbers is not None:
                self._texts.append(pa.array(self._numbers[: self._length]).cast(pa.string()))
                self._numbers = None
        self._texts += piece.cast(pa.string()).chunks


def _is_numeric(kind: pa.DataType) -> bool:
    tests = (pa.types.is_integer, pa.types.is_floating, pa.types.is_boolean, pa.types.is_timestamp, pa.types.is_null)
    return any(test(kind) for test in tests)


def _dtype(piece: pa.ChunkedArray) -> np.dtype[Any]:
    if pa.types.is_timestamp(piece.type):
        return np.dtype("datetime64[ns]")
    if pa.types.is_integer(piece.type) and not piece.null_count:
        return np.dtype("int64")
    return np.dtype("float64")


def _common_dtype(dtype: np.dtype[Any], piece: pa.ChunkedArray) -> np.dtype[Any]:
    return _missing_dtype(dtype) if pa.types.is_null(piece.type) else np.result_type(dtype, _dtype(piece))


def _missing_dtype(dtype: np.dtype[Any]) -> np.dtype[Any]:
    return dtype if dtype.kind == "M" else np.dtype("float64")


def _nothing(dtype: np.dtype[Any]) -> Any:
    return np.datetime64("NaT") if dtype.kind == "M" else np.nan


def _categorical(texts: list[pa.Array]) -> pd.Categorical:
    coded = pa.chunked_array(texts, pa.string()).dictionary_encode().combine_chunks()
    if isinstance(coded, pa.ChunkedArray):
        coded = coded.chunk(0)
    codes = coded.indices.fill_null(-1).to_numpy(zero_copy_only=False)
    return pd.Categorical.from_codes(codes, coded.dictionary.to_pylist())
