"""The journal of an experiment, read on as it grows: no line twice, no more at once than fits into little memory."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from robot_runner.core.storage.declared_shapes import faults_of, parsed_json
from robot_runner.core.storage.guarded_files import LINE_LIMIT, MissingFileError, open_to_read
from robot_runner.core.storage.record_shapes import RECORDS, Record
from robot_runner.core.storage.system_refusals import storage_error

#: How much is read at once: some 4,000 records, which take 50 ms.
_AT_ONCE = 1_000_000
#: In the place of a file that was removed: the next one is another, though the system may give it the same number.
_GONE = (-1, -1)


class JournalTail:
    """Reads what was appended since it was read last.

    A journal that is another file than before, or shorter, is read from its beginning. A line that is no record is
    counted and passed over: who looks at an experiment sees what is left of it; `robot-runner status` refuses it.

    Args:
        path: the journal; one that does not exist yet has no records.

    Attributes:
        damaged: how many lines were passed over.
        is_behind: whether there is more to read at once.
        has_begun_anew: whether the last look began from the beginning, so that all that was known is void.
    """

    def __init__(self, path: Path) -> None:
        self.damaged = 0
        self.is_behind = False
        self.has_begun_anew = False
        self._path = path
        self._file: tuple[int, int] | None = None
        self._offset = 0
        self._size = 0

    def read(self) -> list[dict[str, Any]]:
        """Return the records that came since, the oldest first; not all of them where `is_behind`.

        Raises:
            StorageError: the journal cannot be read.
        """
        self.has_begun_anew = False
        try:
            found = self._path.lstat()
        except OSError:  # missing, or where nobody may look: opening says so
            if self._file is not None:
                self._file = _GONE
            return []
        if self._file == (found.st_dev, found.st_ino) and found.st_size == self._size and not self.is_behind:
            return []
        if self._file != (found.st_dev, found.st_ino) or found.st_size < self._offset:
            self.has_begun_anew = self._file is not None
            self._offset = self.damaged = 0
        self._file, self._size = (found.st_dev, found.st_ino), found.st_size
        return [record for line in self._lines() if (record := self._parsed(line)) is not None]

    @property
    def share(self) -> float:
        """How much of the journal was read, 0 to 1."""
        return self._offset / self._size if self._size else 0.0

    def _lines(self) -> list[bytes]:
        try:
            with open_to_read(self._path) as file:
                file.seek(self._offset)
                block = file.read(_AT_ONCE)
                if b"\n" not in block and len(block) == _AT_ONCE:
                    block += file.readline(LINE_LIMIT)
        except MissingFileError:
            return []
        except OSError as error:
            raise storage_error(self._path, "read", error) from error
        end = block.rfind(b"\n") + 1
        if not end and len(block) > LINE_LIMIT:  # nothing that we wrote: go on behind it
            end = len(block)
        self._offset += end
        self.is_behind = bool(end) and self._offset < self._size
        return block[:end].splitlines()

    def _parsed(self, line: bytes) -> dict[str, Any] | None:
        record: dict[str, Any] | None
        try:
            record = parsed_json(line.decode())
        except (ValueError, RecursionError):
            record = None
        kind = record.get("kind") if isinstance(record, dict) else None
        if not isinstance(kind, str) or faults_of(record, RECORDS.get(kind, Record)):
            self.damaged += 1
            return None
        return record
