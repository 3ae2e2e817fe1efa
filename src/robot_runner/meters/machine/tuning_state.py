"""What a machine was like before it was set up, in a file that outlives whoever set it up.

It is written before anything is changed, and goes once everything is as before: as long as it is there, somebody is at
work or was killed, and whoever comes next can put things right.
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
    """Return where it is kept what a machine was like before: in the user's folder of state (XDG_STATE_HOME).

    Raises:
        StorageError: the user has no home folder.
    """
    return user_folder("XDG_STATE_HOME") / "tuned.json"


@dataclass(frozen=True, slots=True)
class Change:
    """One file of the kernel: what stood in it, and what is wanted."""

    path: str
    before: str
    wanted: str


@dataclass(frozen=True, slots=True)
class Kept:
    """What is in the file.

    Attributes:
        owner: the process that restores the machine, and when it was started; None for one that was set up by hand.
        boot: tells one start of the machine from the next, after which nothing is as it was set.
        threads: cores that each thread might use before, with the time at which it was started, by thread.
        others: the cores that were left to others.
        everything: all cores that were there.
    """

    boot: str
    owner: tuple[int, str] | None = None
    changes: tuple[Change, ...] = ()
    threads: dict[int, tuple[str, list[int]]] = field(default_factory=dict)
    others: tuple[int, ...] = ()
    everything: tuple[int, ...] = ()

    @property
    def who(self) -> str:
        """Who set the machine up, in words."""
        return "by hand" if self.owner is None else f"by process {self.owner[0]}"

    @classmethod
    def read(cls, path: Path) -> Kept | None:
        """Return what a file of state holds; None where there is none.

        Raises:
            PluginError: it cannot be read.
        """
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
                return None  # a folder that this user cannot enter holds nothing that was kept for him
            problem = f"what this machine was like before cannot be read: {error}"
            fix = "Look at the file, set the machine up by hand, and remove the file."
            raise PluginError(problem, where=str(path), fix=fix) from error

    def write(self, path: Path) -> None:
        """Write the file of state, and have it reach the disk.

        Raises:
            StorageError: it cannot be written.
        """
        path.parent.mkdir(parents=True, exist_ok=True)
        write_beside_and_rename(path, lambda file: json.dump(asdict(self), file, indent=1))
