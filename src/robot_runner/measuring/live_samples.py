"""A preview of samples, a few a second, written while a profiler samples; removed once all samples are written."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from robot_runner.core.storage.guarded_files import open_to_append, remove
from robot_runner.measuring.quality import Column

#: The end of the file's name; the name begins with a dot, so that the file is not mistaken for samples to be analysed.
LIVE = ".live"
#: At least this long between two samples that are written, s: enough for a curve on a screen, and little load.
_EVERY = 0.5

_log = logging.getLogger(__name__)


class LiveSamples:
    r"""The preview of one file of samples: `.samples.csv.live` beside `samples.csv`.

    Errors of writing are ignored: a preview never fails a run.

    Args:
        path: the file that all samples are written to in the end.

    Example:
        >>> import tempfile
        >>> from pathlib import Path
        >>> from robot_runner.plugins import Column
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     live = LiveSamples(Path(folder) / "samples.csv")
        ...     live.show(lambda: [Column("time_s", [0.5]), Column("power_W", [7.5])])
        ...     text = (Path(folder) / ".samples.csv.live").read_text()
        ...     live.close()
        >>> text
        'time_s,power_W\n0.5,7.5\n'
    """

    def __init__(self, path: Path) -> None:
        self._path = path.with_name(f".{path.name}{LIVE}")
        self._has_begun = False
        self._due = float("-inf")

    def show(self, columns: Callable[[], Sequence[Column]]) -> None:
        """Write one sample, if the last one was written some time ago.

        Args:
            columns: returns columns of one value each; not called where nothing is due.
        """
        now = time.monotonic()
        if now < self._due:
            return
        self._due = now + _EVERY
        try:
            self._write(columns())
        except Exception:  # noqa: BLE001 - whatever fails here, the mission continues
            _log.debug("Nothing more is shown of %s.", self._path, exc_info=True)
            self._due = float("inf")

    def close(self) -> None:
        """Remove the preview; closing twice does nothing."""
        self._due = float("inf")
        if self._has_begun:
            self._has_begun = False
            remove(self._path)

    def _write(self, columns: Sequence[Column]) -> None:
        line = ",".join("" if (value := column.values[0]) is None else str(value) for column in columns)
        if not self._has_begun:
            remove(self._path)  # of an earlier attempt
            self._has_begun = True
            line = f"{','.join(column.name for column in columns)}\n{line}"
        with open_to_append(self._path) as file:
            file.write(f"{line}\n".encode("utf-8", "backslashreplace"))
