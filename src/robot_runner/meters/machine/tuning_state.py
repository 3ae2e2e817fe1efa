"""The settings of a machine before it was set up, in a file that outlives the process that did so.

The file is written before any change, and removed once everything is restored: while it exists, a process is at work
or was killed, and the next one can restore the machine.
"""

from __future__ import annotations

import json
import os
from dataclasses import asdict, dataclass, field
from pathlib import Path

from robot_runner.core.errors import PluginError
from robot_runner.core.storage.layout import user_folder
from robot_runner.core.storage.safe_write import write_beside_and_rename


def state_file() -> Path:
    """Return the file's path in the user's folder of state (XDG_STATE_HOME); a `StorageError` without a home folder."""
    return user_folder("XDG_STATE_HOME") / "tuned.json"


@dataclass(frozen=True, slots=True)
class Change:
    """One file of the kernel: its content before, and the new one."""

    path: str
    before: str
    wanted: str


@dataclass(frozen=True, slots=True)
class Kept:
    """The content of the file.

    Attributes:
        owner: the process that restores the machine, and its start; None for a machine that was set up by hand.
        boot: identifies the start of the machine; at the next one all settings are lost.
        threads: the start of each thread and the cores that it might use before, by thread.
        others: the cores that were left to others.
        everything: all cores that there were.
    """

    boot: str
    owner: tuple[int, str] | None = None
    changes: tuple[Change, ...] = ()
    threads: dict[int, tuple[str, list[int]]] = field(default_factory=dict)
    others: tuple[int, ...] = ()
    everything: tuple[int, ...] = ()

    @property
    def who(self) -> str:
        """The process that set the machine up, or that it was done by hand, in words."""
        return "by hand" if self.owner is None else f"by process {self.owner[0]}"

    @classmethod
    def read(cls, path: Path) -> Kept | None:
        """Read a file of state; None if there is none, and a `PluginError` if it cannot be read."""
        try:
            found = json.loads(path.read_text(encoding="utf-8"))
            owner, threads = found["owner"], found["threads"]
            return cls(
                boot=str(found["boot"]),
                owner=None if owner is None else (int(owner[0]), str(owner[1])),
                changes=tuple(
                    Change(str(each["path"]), str(each["before"]), str(each["wanted"])) for each in found["changes"]
                ),
                threads={int(thread): (str(each[0]), list(map(int, each[1]))) for thread, each in threads.items()},
                others=tuple(map(int, found["others"])),
                everything=tuple(map(int, found["everything"])),
            )
        except (FileNotFoundError, NotADirectoryError):
            return None
        except (OSError, ValueError, KeyError, TypeError, IndexError, AttributeError) as error:
            if isinstance(error, PermissionError) and not os.access(path.parent, os.X_OK, effective_ids=True):
                return None  # in a folder that this user cannot enter there is no file of this user
            problem = f"the previous settings of this machine cannot be read: {error}"
            fix = "Look at the file, set the machine up by hand, and remove the file."
            raise PluginError(problem, where=str(path), fix=fix) from error

    def write(self, path: Path) -> None:
        """Write the file of state, and flush it to disk; a `StorageError` says that it cannot be written."""
        path.parent.mkdir(parents=True, exist_ok=True)
        write_beside_and_rename(path, lambda file: json.dump(asdict(self), file, indent=1))
