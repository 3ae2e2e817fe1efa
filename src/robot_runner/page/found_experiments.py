"""The experiments below a folder, and the state of each: for the index page, and for Prometheus."""

from __future__ import annotations

import hashlib
import os
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from robot_runner.core.errors import RobotRunnerError
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.lock import holder_of, is_requested
from robot_runner.page.followed_experiment import FollowedExperiment

#: How deep experiments are searched for, and in how many folders.
_DEEPEST, _MOST_FOLDERS = 4, 3_000
_MOST_EXPERIMENTS = 300
#: How long one look reads one of them, s; the rest of a long journal is read at the next ones.
_PATIENCE = 0.5


def is_experiment(folder: Path) -> bool:
    """Return whether a folder is that of an experiment, ours or with a run table of another tool."""
    files = ExperimentFolder(folder)
    return files.manifest.is_file() or files.journal.is_file() or files.run_table.is_file()


def id_of(folder: Path) -> str:
    """Return the id of an experiment in URLs, which does not reveal names of folders."""
    return hashlib.sha256(os.fsencode(folder)).hexdigest()[:16]


class FoundExperiments:
    """The experiments below a folder, searched for at each look; links are not followed.

    Args:
        folder: an experiment's own folder, or one with experiments below it.
        is_one: whether it is an experiment's own folder, which may not exist yet.
    """

    def __init__(self, folder: Path, *, is_one: bool = False) -> None:
        self._folder = folder
        self._is_one = is_one
        self._lock = threading.Lock()
        self._known: dict[str, Path] = {}
        self._summaries: dict[str, tuple[object, dict[str, Any]]] = {}
        self._followed: dict[str, FollowedExperiment] = {}
        self._told: list[dict[str, Any]] = []

    @property
    def only(self) -> str | None:
        """The id of the experiment whose own folder this is."""
        return id_of(self._folder) if self._is_one or is_experiment(self._folder) else None

    def folder(self, experiment_id: str) -> Path | None:
        """Return the folder of an experiment; None for an unknown id."""
        if experiment_id == self.only:
            return self._folder
        if experiment_id not in self._known:
            self._find()
        return self._known.get(experiment_id)

    @property
    def is_behind(self) -> bool:
        """Return False: the next look is soon enough."""
        return False

    def look(self) -> dict[str, Any]:
        """Return all experiments with their states, those first that need attention."""
        with self._lock:
            self._find()
            self._told = [self._summary(experiment_id, folder) for experiment_id, folder in self._known.items()]
            for gone in self._summaries.keys() - self._known.keys():
                del self._summaries[gone]
            return self.snapshot()

    def snapshot(self) -> dict[str, Any]:
        """Return the result of the last look."""
        return {"experiments": self._told}

    def _find(self) -> None:
        found = [self._folder] if self._is_one else list(_below(self._folder))
        self._known = {id_of(folder): folder for folder in found[:_MOST_EXPERIMENTS]}

    def _summary(self, experiment_id: str, folder: Path) -> dict[str, Any]:
        """Return the state of one; it is read again only if it has changed."""
        files = ExperimentFolder.found_at(folder)
        holder = holder_of(files.lock)
        sign = (holder, is_requested(files.pause), *_sizes(files))
        known = self._summaries.get(experiment_id)
        if known is not None and known[0] == sign:
            return self._as_of_now(experiment_id, known[1])
        followed = self._followed.pop(experiment_id, None) or FollowedExperiment(folder)
        end = time.monotonic() + _PATIENCE
        parts = followed.look()
        while followed.is_behind and time.monotonic() < end:
            parts = followed.look()
        state = parts.get("state") or followed.snapshot()["state"]
        summary = {"id": experiment_id, "folder": str(folder.relative_to(self._folder.parent)), **_shortened(state)}
        if holder is not None or followed.is_behind:
            self._followed[experiment_id] = followed
        if not followed.is_behind:
            self._summaries[experiment_id] = (sign, summary)
        return summary

    def _as_of_now(self, experiment_id: str, summary: dict[str, Any]) -> dict[str, Any]:
        """Return a summary with the time left from now, in steps, so that it is not sent at each look."""
        followed = self._followed.get(experiment_id)
        left = followed.seconds_left if followed is not None else None
        return summary if left is None else {**summary, "left": round(left, -1)}


def _shortened(state: dict[str, Any]) -> dict[str, Any]:
    names = ("name", "word", "counts", "left", "left_is_least", "waiting", "host", "started_at", "finished_at")
    short = {name: state.get(name) for name in (*names, "problem", "gates")}
    short["in_flight"] = [{"run": each["run"], "event": each["event"]} for each in state.get("in_flight", ())]
    return short


def _sizes(files: ExperimentFolder) -> Iterator[tuple[int, int]]:
    for path in (files.journal, files.run_table):
        try:
            found = path.lstat()
        except OSError:
            yield (0, 0)
        else:
            yield (found.st_size, found.st_mtime_ns)


def _below(folder: Path) -> Iterator[Path]:
    """Yield the experiments' folders below one, or itself; none within an experiment."""
    left, looked_into = [(folder, 0)], 0
    while left and looked_into < _MOST_FOLDERS:
        here, depth = left.pop(0)
        looked_into += 1
        try:
            if is_experiment(here):
                yield here
            elif depth < _DEEPEST:
                with os.scandir(here) as entries:
                    names = sorted(each.name for each in entries if each.is_dir(follow_symlinks=False))
                left += [(here / name, depth + 1) for name in names if not name.startswith(".")]
        except (OSError, RobotRunnerError):
            continue


_RUNS = (("done", "done"), ("failed", "failed"), ("todo", "to do"))
_WORDS = ("running", "waiting", "paused", "stopped", "failed", "done")


def metrics_text(experiments: Sequence[Mapping[str, Any]], viewers: int) -> str:
    """Return the numbers of runs and states of experiments, and of viewers, in the format of Prometheus.

    Source: https://prometheus.io/docs/instrumenting/exposition_formats/.
    """
    return "".join(f"{line}\n" for line in _lines(experiments, viewers))


def _lines(experiments: Sequence[Mapping[str, Any]], viewers: int) -> Iterator[str]:
    yield "# HELP robot_runner_runs Runs of an experiment, by how far they have come."
    yield "# TYPE robot_runner_runs gauge"
    for each in experiments:
        counts = each.get("counts") or {}
        for name, status in _RUNS:
            if name in counts:
                yield f"robot_runner_runs{{{_labels(each)},status={_quoted(status)}}} {counts[name]}"
    yield "# HELP robot_runner_state 1 for how an experiment stands, 0 for how it could."
    yield "# TYPE robot_runner_state gauge"
    for each in experiments:
        for word in _WORDS:
            yield f"robot_runner_state{{{_labels(each)},state={_quoted(word)}}} {int(each['word'] == word)}"
    yield "# HELP robot_runner_seconds_left How long the runs that are left take, as estimated last, s."
    yield "# TYPE robot_runner_seconds_left gauge"
    for each in experiments:
        if each.get("left") is not None:
            yield f"robot_runner_seconds_left{{{_labels(each)}}} {each['left']:.0f}"
    yield "# HELP robot_runner_viewers How many look at live pages of this server."
    yield "# TYPE robot_runner_viewers gauge"
    yield f"robot_runner_viewers {viewers}"


def _labels(experiment: Mapping[str, Any]) -> str:
    return f"experiment={_quoted(str(experiment['name']))},folder={_quoted(str(experiment['folder']))}"


def _quoted(text: str) -> str:
    escaped = text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n").replace("\r", " ")
    return f'"{escaped}"'
