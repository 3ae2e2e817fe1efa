"""The journal, the append-only history of an experiment: one record a line, flushed to disk where it matters."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable, Collection, Iterator
from contextlib import suppress
from datetime import UTC, datetime
from io import BytesIO
from itertools import chain
from pathlib import Path
from typing import Any, Self

from robot_runner.core.errors import StorageError
from robot_runner.core.secret_names import sentences_without_secrets
from robot_runner.core.storage.declared_shapes import faults_of, finite, parsed_json, with_short_texts
from robot_runner.core.storage.guarded_files import (
    LINE_LIMIT,
    MissingFileError,
    open_descriptor,
    open_to_read,
    open_to_write,
    read_blocks,
)
from robot_runner.core.storage.lock_files import is_at
from robot_runner.core.storage.record_shapes import RECORDS, Record
from robot_runner.core.storage.system_refusals import fsync_file, storage_errors

#: `Journal.append` writes the kind first, so that a line's kind is known without parsing it.
_BEGINNING = '{"kind":"'
_RECORD, _END = _BEGINNING.encode(), b"}\n"
_FLAGS = os.O_RDWR | os.O_CREAT | os.O_APPEND
#: How much of the end of a journal `last_records` reads: some thousand runs.
_LAST_BYTES = 4_000_000
#: Problem and fix where the folder of an experiment that is being executed was removed.
REMOVED = (
    "the experiment's folder was removed while it was executed",
    "Start the experiment again: it begins from the start.",
)

_encode = json.JSONEncoder(ensure_ascii=False, separators=(",", ":"), allow_nan=False, default=str).encode


def utc_now() -> str:
    """Return the present moment in UTC: ISO 8601 with milliseconds, as in `2026-01-31T12:00:00.250Z`."""
    return datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


def seconds_of(stamp: str) -> float:
    """Return a time stamp of `utc_now` in seconds since 1970."""
    return datetime.fromisoformat(stamp).timestamp()


def _line_of(record: dict[str, Any]) -> bytes:
    try:
        text = _encode(record)
    except ValueError:
        text = _encode(finite(record))
    return f"{text}\n".encode("utf-8", "backslashreplace")


class Journal:
    """The journal, opened for appending by the one process that executes the experiment.

    A torn last line (power failed while it was written) is cut off when the journal is opened. Where the file is
    removed or replaced while it is open, as by `git stash`, it is put back with all that it held. `successor` returns,
    in words, what has taken the experiment's place: then a removed journal is not put back there.
    """

    def __init__(self, path: Path, successor: Callable[[], str] = str) -> None:
        self._path = path
        self._successor = successor
        self._descriptor = open_descriptor(path, flags=_FLAGS)
        try:
            with storage_errors(path, "written"):
                self._cut_torn_line()
                self._end = os.fstat(self._descriptor).st_size
        except StorageError:
            os.close(self._descriptor)
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *raised: object) -> None:
        self.close()

    def append(self, kind: str, *, flush: bool = False, at: str | None = None, **fields: Any) -> None:
        """Append one record; with `flush` it is on the disk when this returns.

        Texts in a record that is too long for readers are shortened: an exception's may contain a picture.

        Raises:
            StorageError: it cannot be written (a full disk, say), or is too long; earlier records are intact.
        """
        record = {"kind": kind, "at": at or utc_now(), **sentences_without_secrets(fields)}
        line = _line_of(record)
        if len(line) > LINE_LIMIT and len(line := _line_of(with_short_texts(record))) > LINE_LIMIT:
            problem = f"a record {kind!r} of {len(line):,} bytes could not be read again"
            raise StorageError(problem, where=str(self._path), fix="Plan fewer runs at a time.")
        with storage_errors(self._path, "written"):
            self._write(line)
        if flush:
            self.flush()

    def flush(self) -> None:
        """Flush all records to the disk.

        Raises:
            StorageError: they cannot be flushed; readers find them all the same, unless the power fails.
        """
        with storage_errors(self._path, "written"):
            fsync_file(self._descriptor)
            self._put_back_if_removed()

    @property
    def is_ours_alone(self) -> bool:
        """Return whether no other process has appended a record, or begun another journal, since this was opened."""
        is_there = is_at(self._descriptor, self._path) or not self._path.exists()
        return is_there and os.fstat(self._descriptor).st_size == self._end

    @property
    def moved_to(self) -> str:
        """The present path of the file, if it or its folder was moved or renamed since; else empty."""
        try:
            self._path.lstat()
        except (FileNotFoundError, NotADirectoryError):
            if os.fstat(self._descriptor).st_nlink == 0:
                return ""
        except OSError:  # a folder that cannot be read, as on a network
            return ""
        else:
            return ""
        try:
            return os.readlink(f"/proc/self/fd/{self._descriptor}")  # noqa: PTH115 - a text
        except OSError:  # not Linux
            return "elsewhere"

    def close(self) -> None:
        """Flush to disk and close, unless it is closed; raise a `StorageError` if it cannot be flushed."""
        if self._descriptor < 0:
            return
        try:
            self.flush()
        finally:
            os.close(self._descriptor)
            self._descriptor = -1

    def stay_in_place(self) -> None:
        """Put the journal back where it was removed: the table, a view of it, must not be left alone.

        Raises:
            StorageError: it cannot be put back, or was moved.
        """
        with storage_errors(self._path, "written"):
            self._put_back_if_removed()
            if not is_at(self._descriptor, self._path):
                fix = "Move it back, and start the experiment again: it resumes."
                raise StorageError("the journal was moved while it was written", where=str(self._path), fix=fix)

    def _put_back_if_removed(self) -> None:
        if os.fstat(self._descriptor).st_nlink == 0:
            self._put_back()

    def _put_back(self) -> None:
        if not os.path.isdir(self._path.parent):  # noqa: PTH112 - that of a path raises what the system refuses
            raise StorageError(REMOVED[0], where=str(self._path.parent), fix=REMOVED[1])
        if successor := self._successor():
            kept = self._path.with_name(f"{self._path.name}.removed-{os.getpid()}")
            self._copy_to(kept)
            problem = f"the journal was removed, and {successor}"
            fix = f"Leave the folder alone while it is executed. What this process had recorded is in {kept.name}."
            raise StorageError(problem, where=str(self._path), fix=fix)
        with suppress(FileNotFoundError):
            self._path.replace(self._path.with_name(f"{self._path.name}.replaced"))  # somebody's: it is kept
        self._copy_to(self._path)
        old, self._descriptor = self._descriptor, open_descriptor(self._path, flags=_FLAGS)
        self._end = os.fstat(self._descriptor).st_size
        os.close(old)

    def _copy_to(self, path: Path) -> None:
        with os.fdopen(os.dup(self._descriptor), "rb") as removed, open_to_write(path) as file:
            removed.seek(0)
            shutil.copyfileobj(removed, file)

    def _write(self, line: bytes) -> None:
        written = 0
        try:
            while written < len(line):  # a nearly full disk takes a part
                written += os.write(self._descriptor, line[written:])
        except OSError:
            if written:  # remove the torn line, so that the next one is whole
                os.ftruncate(self._descriptor, os.fstat(self._descriptor).st_size - written)
            raise
        self._end += written

    def _cut_torn_line(self) -> None:
        size = os.fstat(self._descriptor).st_size
        end = size
        while end > 0:
            if size - end > LINE_LIMIT:
                problem = f"this is not a journal: its last {size - end:,} bytes have no end of a line"
                raise StorageError(problem, where=str(self._path), fix="Restore the file from a backup.")
            start = max(0, end - 65536)
            newline = os.pread(self._descriptor, end - start, start).rfind(b"\n")
            if newline >= 0:
                end = start + newline + 1
                break
            end = start
        if end < size:
            os.ftruncate(self._descriptor, end)


def read_journal(path: Path, *, kinds: Collection[str] | None = None) -> Iterator[dict[str, Any]]:
    """Yield the records of a journal, oldest first; a torn last line is left out.

    A missing one has none. With `kinds`, only these are yielded: others are not parsed, so that a long journal is read
    quickly.

    Raises:
        StorageError: it cannot be read, or a line before the last is not a record.
    """
    return (parsed_record(path, line) for line in journal_lines(path, kinds=kinds))


def journal_lines(path: Path, *, kinds: Collection[str] | None = None) -> Iterator[bytes]:
    """Yield the lines of a journal, for a reader that need not parse all of them; see `read_journal`.

    Every line is checked, of whatever kind: one that was cut or overwritten is refused.
    """
    beginnings = None if kinds is None else tuple(f'{_BEGINNING}{kind}"'.encode() for kind in kinds)
    with suppress(MissingFileError):
        for block in read_blocks(path):
            if not _is_whole(block):
                yield from _lines_with_damage(path, block, beginnings)
            elif beginnings is None:
                yield from BytesIO(block)
            else:
                yield from _lines_of_kinds(block, beginnings)


def _is_whole(block: bytes) -> bool:
    """Return whether each line of a block begins and ends as one record, by counting, which is fast."""
    lines = block.count(b"\n")
    begun = block.startswith(_RECORD) + block.count(b"\n" + _RECORD)
    return lines == begun == block.count(_END) == block.count(_RECORD) and block.endswith(_END)


def _lines_of_kinds(block: bytes, beginnings: Collection[bytes]) -> Iterator[bytes]:
    starts = [0] if block.startswith(tuple(beginnings)) else []
    for beginning in beginnings:
        at = block.find(b"\n" + beginning)
        while at >= 0:
            starts.append(at + 1)
            at = block.find(b"\n" + beginning, at + 1)
    for start in sorted(starts):
        yield block[start : block.index(b"\n", start) + 1]


def _lines_with_damage(path: Path, block: bytes, beginnings: tuple[bytes, ...] | None) -> Iterator[bytes]:
    """Yield the lines of a block up to a damaged one; the last one of a journal may be torn by a power failure.

    Raises:
        StorageError: one is damaged.
    """
    for line in BytesIO(block):
        if not (line.startswith(_RECORD) and line.endswith(_END)):
            if line.endswith(b"\n"):
                raise _corrupt(path, line)
            continue
        if line.count(_RECORD) > 1:  # two records in one line, or a record with a nested `kind`
            parsed_record(path, line)
        if beginnings is None or line.startswith(beginnings):
            yield line


def last_records(path: Path, *, kinds: Collection[str], within: int = _LAST_BYTES) -> Iterator[dict[str, Any]]:
    """Yield the records of these kinds in the last bytes of a journal, oldest first, at a cost that does not grow.

    Raises:
        StorageError: it cannot be read.
    """
    beginnings = tuple(f'{_BEGINNING}{kind}"'.encode() for kind in kinds)
    lines: list[bytes] = []
    with suppress(MissingFileError), storage_errors(path, "read"), open_to_read(path) as file:
        beginning = max(0, file.seek(0, os.SEEK_END) - within)
        file.seek(beginning)
        if beginning:
            file.readline()  # the rest of a line
        lines += (line for line in file if line.startswith(beginnings) and line.endswith(_END))
    for line in lines:
        yield parsed_record(path, line)


def parsed_record(path: Path, line: bytes) -> dict[str, Any]:
    """Return the record that a line of the journal holds.

    Raises:
        StorageError: it is not a record, or not as records of its kind are.
    """
    try:
        record: dict[str, Any] = parsed_json(line.decode())
    except (ValueError, RecursionError) as error:
        raise _corrupt(path, line, str(error)) from error
    kind = record.get("kind") if isinstance(record, dict) else None
    faults = faults_of(record, RECORDS.get(kind, Record) if isinstance(kind, str) else Record)
    if faults:
        raise _corrupt(path, line, "; ".join(faults))
    return record


def _corrupt(path: Path, line: bytes, reason: str = "") -> StorageError:
    # The line number is computed only for an error.
    lines = chain.from_iterable(map(BytesIO, read_blocks(path)))
    number = next((number for number, each in enumerate(lines, start=1) if each == line), 0)
    problem = f"this line is not a record of a journal{f': {reason}' if reason else ''}"
    fix = "Restore the file from a backup, or delete the line to go on without it."
    return StorageError(problem, where=f"{path}:{number}", fix=fix)
