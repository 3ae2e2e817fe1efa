"""Curves of the raw samples of one run, also while they are taken, with a limited number of points."""

from __future__ import annotations

import csv
import math
import os
import stat
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from robot_runner.core.errors import StorageError
from robot_runner.core.storage.guarded_files import open_to_read
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.system_refusals import storage_errors
from robot_runner.measuring.live_samples import LIVE

#: Points of a curve, more than a phone has pixels; each has the smallest and the largest value of its samples.
_POINTS = 400
#: What is read of one file at a time, and in all, bytes: a million samples.
_AT_ONCE, _MOST_BYTES = 4_000_000, 48_000_000
_MOST_FILES, _MOST_COLUMNS, _LONGEST_NAME = 16, 16, 80
_TIMES = ("time_s", "t_s", "timestamp_s", "time", "t")
_WAY, _HEADING = ("x_m", "y_m"), "heading_rad"


class ThinnedSamples:
    """Samples of several columns in at most 400 points; when there are more, each two are merged.

    Args:
        columns: how many values a sample has.

    Attributes:
        times, low, high: when each point begins, and the smallest and the largest value of each column in it.
        last, last_at: the last value of each column, and its time.

    Example:
        >>> samples = ThinnedSamples(1)
        >>> for place in range(1000):
        ...     samples.add(place, [place % 10])
        >>> len(samples.times), samples.low[0][0], samples.high[0][0]
        (250, 0, 3)
    """

    def __init__(self, columns: int) -> None:
        self.times: list[float] = []
        self.low: list[list[float | None]] = [[] for _ in range(columns)]
        self.high: list[list[float | None]] = [[] for _ in range(columns)]
        self.last: list[float | None] = [None] * columns
        self.last_at = [math.nan] * columns
        self._each = 1
        self._in_last = 0

    def add(self, time: float, values: Sequence[float | None]) -> None:
        """Add a sample; times must not decrease."""
        for place, value in enumerate(values):
            if value is not None:
                self.last[place], self.last_at[place] = value, time
        if self._in_last in {0, self._each}:
            if len(self.times) == _POINTS:
                self._halve()
            self._in_last = 0
            self.times.append(time)
            for place, value in enumerate(values):
                self.low[place].append(value)
                self.high[place].append(value)
        else:
            for place, value in enumerate(values):
                self.low[place][-1] = _pick(min, self.low[place][-1], value)
                self.high[place][-1] = _pick(max, self.high[place][-1], value)
        self._in_last += 1

    def _halve(self) -> None:
        self.times = self.times[::2]
        self.low = [_paired(min, each) for each in self.low]
        self.high = [_paired(max, each) for each in self.high]
        self._each *= 2


def _pick(choose: Any, one: float | None, other: float | None) -> float | None:
    known = [each for each in (one, other) if each is not None]
    return choose(known) if known else None


def _paired(choose: Any, values: list[float | None]) -> list[float | None]:
    return [_pick(choose, *pair) for pair in zip(values[::2], values[1::2], strict=True)]


class _SampleFile:
    """One file of samples, followed as it grows."""

    def __init__(self, path: Path, root: Path, plugin: str) -> None:
        self.plugin = plugin[:_LONGEST_NAME]
        self.name = path.name.removeprefix(".").removesuffix(LIVE)[:_LONGEST_NAME]
        self.is_live = path.name.endswith(LIVE)
        self.columns: list[str] = []
        self.samples: ThinnedSamples | None = None
        self.way: list[tuple[float, float]] | None = None
        self._way_each = self._way_due = 1
        self._pose: tuple[float, float, float] | None = None
        self.is_behind = self.is_cut = False
        self._path, self._root = path, root
        self._offset = 0
        self._time = 0
        self._places: list[int] = []
        self._way_places: list[int] = []
        self._last = -math.inf

    def read_on(self) -> bool:
        """Read what was appended; return whether there was anything.

        Raises:
            StorageError: it is not a regular file, or cannot be read.
        """
        with storage_errors(self._path, "read"), open_to_read(self._path, self._root) as file:
            file.seek(self._offset)
            wanted = min(_AT_ONCE, _MOST_BYTES - self._offset)
            block = file.read(wanted)
            self.is_cut = os.fstat(file.fileno()).st_size > _MOST_BYTES
        end = block.rfind(b"\n") + 1
        self._offset += end
        self.is_behind = bool(end) and len(block) == wanted
        rows = csv.reader(block[:end].decode("utf-8", "replace").splitlines())
        with suppress(csv.Error):
            if self.samples is None and end:
                self._begin(next(rows, []))
            for row in rows if self.samples is not None else ():
                self._take(row)
        return end > 0

    def _begin(self, headings: list[str]) -> None:
        folded = [each.strip().casefold() for each in headings]
        known = [folded.index(name) for name in _TIMES if name in folded]
        if not known:
            return
        self._time = known[0]
        self._places = [place for place in range(len(headings)) if place != self._time][:_MOST_COLUMNS]
        self.columns = [headings[place][:_LONGEST_NAME] for place in self._places]
        self.samples = ThinnedSamples(len(self._places))
        if all(name in folded for name in _WAY):
            self._way_places = [folded.index(name) for name in (*_WAY, _HEADING) if name in folded]
            self.way = []

    def _take(self, row: list[str]) -> None:
        if len(row) <= self._time:
            return
        time = _number(row[self._time])
        if time is None or time < self._last or self.samples is None:
            return
        self._last = time
        self.samples.add(time, [_number(row[place]) if place < len(row) else None for place in self._places])
        if self.way is not None and max(self._way_places) < len(row):
            self._go(*(_number(row[place]) for place in self._way_places))

    def _go(self, x: float | None, y: float | None, heading: float | None = 0.0) -> None:
        """Add a position of the robot; the more there are, the fewer are kept: one in two, four, ..."""
        if self.way is None or x is None or y is None:
            return
        self._pose = (x, y, heading or 0.0)
        self._way_due -= 1
        if self._way_due == 0:
            if len(self.way) == 2 * _POINTS:
                self.way = self.way[::2]
                self._way_each *= 2
            self.way.append((x, y))
            self._way_due = self._way_each

    @property
    def begin(self) -> float:
        """The time of the first sample; infinite where there is none."""
        return self.samples.times[0] if self.samples is not None and self.samples.times else math.inf

    def told(self, begin: float) -> dict[str, Any] | None:
        """Return the curves with numbers as plain data, with times from `begin` on, or None."""
        if self.samples is None or not self.samples.times:
            return None
        low, high, last, last_at = self.samples.low, self.samples.high, self.samples.last, self.samples.last_at
        return {
            "plugin": self.plugin,
            "file": self.name,
            "is_live": self.is_live,
            "is_cut": self.is_cut,
            "times": [time - begin for time in self.samples.times],
            "columns": [
                {"name": self.columns[each], "low": low[each], "high": high[each]}
                | {"last": value, "last_at": last_at[each] - begin}
                for each, value in enumerate(last)
                if value is not None
            ],
            "way": self.way,
            "pose": self._pose,
        }


def _number(text: str) -> float | None:
    try:
        number = float(text)
    except ValueError:
        return None
    return number if math.isfinite(number) else None


class RunCurves:
    """The curves of one run, from the files in its folder.

    Args:
        files: the experiment's folder.
        run_id: the run.
        version: incremented whenever there is anything new.
    """

    def __init__(self, files: ExperimentFolder, run_id: str, version: int = 0) -> None:
        self._files = files
        self.run_id = run_id
        self._folder = files.run(run_id)
        self._known: dict[Path, _SampleFile] = {}
        self.version = version

    def look(self) -> bool:
        """Read what was appended since; return whether there is more to read at once."""
        paths = dict(self._paths())
        for path in self._known.keys() - paths.keys():  # a live file is removed when its samples are written
            del self._known[path]
            self.version += 1
        is_behind = False
        for path, plugin in paths.items():
            known = self._known.setdefault(path, _SampleFile(path, self._files.root, plugin))
            with suppress(StorageError):  # a link, a named pipe: it has no curve
                self.version += known.read_on()
                is_behind |= known.is_behind
        return is_behind

    def told(self) -> list[dict[str, Any]]:
        """Return all curves as plain data, by file; times are s since the run's first sample.

        A run's clock may count from the start of the machine.
        """
        begin = min((each.begin for each in self._known.values()), default=0.0)
        return [told for each in self._known.values() if (told := each.told(begin)) is not None]

    def _paths(self) -> Iterator[tuple[Path, str]]:
        """Yield a limited number of files that may have samples, each with its plugin."""
        count = 0
        for folder, plugin in self._folders():
            paths = _regular(folder)
            names = {path.name for path in paths}
            for path in paths:
                is_live = path.name.endswith(LIVE) and path.name.removeprefix(".").removesuffix(LIVE) not in names
                if is_live or (path.suffix == ".csv" and not path.name.startswith(".")):
                    yield path, plugin
                    count += 1
                    if count == _MOST_FILES:
                        return

    def _folders(self) -> Iterator[tuple[Path, str]]:
        yield self._folder, "config"
        with suppress(OSError), os.scandir(self._folder) as entries:
            names = sorted(each.name for each in entries if each.is_dir(follow_symlinks=False))
            yield from ((self._folder / name, name) for name in names[:_MOST_FILES])


def _regular(folder: Path) -> list[Path]:
    try:
        with os.scandir(folder) as entries:
            names = (each.name for each in entries if stat.S_ISREG(each.stat(follow_symlinks=False).st_mode))
            return sorted(folder / name for name in names)
    except OSError:
        return []
