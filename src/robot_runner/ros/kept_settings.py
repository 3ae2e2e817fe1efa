"""The settings of nodes before a run changed them, in a file that outlives the run.

The file is written before anything is set, and removed once everything is restored. As long as it exists, a run is in
progress or was killed, and the next one can restore the settings.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, TypeAlias

from robot_runner.core.errors import StorageError
from robot_runner.core.storage.claim_locks import state_folder
from robot_runner.core.storage.guarded_files import make_experiment_folder, read_json, remove
from robot_runner.core.storage.outliving import started_at
from robot_runner.core.storage.safe_write import write_beside_and_rename
from robot_runner.ros.graph_addresses import graph_of
from robot_runner.ros.parameter_values import ParameterValue, from_json, to_json

#: Values by node and by name.
Settings: TypeAlias = "Mapping[str, Mapping[str, ParameterValue]]"

#: The folder of these files, on this computer: the processes of another cannot be checked from here.
_FOLDER = "settings"
#: The files of runs that this process is executing: with `RunProcess.IN_PROCESS` there may be several.
_in_care: set[Path] = set()


@dataclass(frozen=True, slots=True)
class KeptSettings:
    """The content of one file: settings of a kind, such as `parameters`, that a plugin set, by full names of nodes.

    `before` are the values before the run, `wanted` those that it set; `owner` is the process that restores them, and
    when it was started. Robots of one `graph` may be named `ros2` or `dds:domain=0,distro=humble`.
    """

    kind: str
    robot: str
    plugin: str
    before: Settings
    wanted: Settings
    owner: tuple[int, str]
    graph: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "graph", self.graph or graph_of(self.robot))

    @classmethod
    def of_this_process(cls, kind: str, robot: str, plugin: str, before: Settings, wanted: Settings) -> KeptSettings:
        """Return an object whose owner is this process."""
        return cls(kind, robot, plugin, before, wanted, (os.getpid(), started_at(os.getpid())))

    @property
    def path(self) -> Path:
        """Its file."""
        return state_folder(_FOLDER) / f"{self.plugin}-{self.owner[0]}-{self.owner[1]}.json"

    @property
    def is_left(self) -> bool:
        """Whether its owner is dead, or has given it up."""
        pid, started = self.owner
        if pid == os.getpid():
            return self.path not in _in_care
        return not started or started_at(pid) != started

    def write(self) -> None:
        """Write the file, and sync it to the disk; raise a `StorageError` if it cannot be written."""
        stored = {**asdict(self), "before": as_json(self.before), "wanted": as_json(self.wanted)}
        make_experiment_folder(self.path.parent)
        write_beside_and_rename(self.path, lambda file: json.dump(stored, file, indent=1))
        _in_care.add(self.path)

    def give_up(self) -> None:
        """Leave the file to the next run, as not everything can be restored now."""
        _in_care.discard(self.path)

    def remove(self) -> None:
        """Remove the file, once everything is restored."""
        _in_care.discard(self.path)
        with suppress(StorageError):  # a simulated robot's was never written
            remove(self.path)


def left_settings(kind: str, robot: str | None) -> list[KeptSettings]:
    """Return the settings that killed runs have left changed on this robot; nothing is changed.

    A file that cannot be read is skipped: another version or another program wrote it.
    """
    graph = None if robot is None else graph_of(robot)
    return [each for each in _read_all() if each.kind == kind and each.graph == graph and each.is_left]


def as_json(settings: Settings) -> dict[str, dict[str, Any]]:
    """Return settings in a form that JSON can hold."""
    return {node: {name: to_json(value) for name, value in values.items()} for node, values in settings.items()}


def _read_all() -> Iterator[KeptSettings]:
    try:
        paths = sorted(state_folder(_FOLDER).glob("*.json"))
    except StorageError:  # a user without a home folder has left nothing
        return
    for path in paths:
        with suppress(StorageError, KeyError, TypeError, ValueError, AttributeError):
            found = read_json(path)
            pid, started = found["owner"]
            before, wanted = _settings(found["before"]), _settings(found["wanted"])
            owner = (int(pid), str(started))
            graph = str(found.get("graph", ""))  # files of earlier versions have none
            kept = KeptSettings(found["kind"], found["robot"], found["plugin"], before, wanted, owner, graph)
            if kept.path == path:
                yield kept


def _settings(stored: Mapping[str, Mapping[str, Any]]) -> Settings:
    return {node: {name: from_json(value) for name, value in values.items()} for node, values in stored.items()}
