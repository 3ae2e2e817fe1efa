"""What the earlier tools told a callback about its run."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from robot_runner.errors import nearest

if TYPE_CHECKING:
    from collections.abc import MutableMapping

__all__ = ["CONTEXT_ATTRIBUTES", "EarlierContext"]

#: `execute_run` is the later name of `run_variation`.
CONTEXT_ATTRIBUTES = ("run_variation", "execute_run", "run_nr", "run_dir")


class EarlierContext:
    """The context of a run, the same object for all of its callbacks.

    Attributes:
        run_variation: the row of the run table, with `__run_id`, `__done`, treatments and measures; callbacks may
            write into it. `execute_run` is the same.
        run_nr: the place of the run in the table, from 1.
        run_dir: the run's folder.

    Example:
        >>> EarlierContext({"Task": "Video"}, 1, Path("run_0")).execute_run["Task"]
        'Video'
    """

    def __init__(self, run_variation: MutableMapping[str, Any], run_nr: int, run_dir: Path) -> None:
        self.run_variation = run_variation
        self.run_nr = run_nr
        self.run_dir = Path(run_dir)

    @property
    def execute_run(self) -> MutableMapping[str, Any]:
        """The row of the run table."""
        return self.run_variation

    @execute_run.setter
    def execute_run(self, row: MutableMapping[str, Any]) -> None:
        self.run_variation = row

    def __getattr__(self, name: str) -> Any:
        near = nearest(name, CONTEXT_ATTRIBUTES)
        hint = f"Did you mean {near!r}?" if near else f"It has {', '.join(CONTEXT_ATTRIBUTES)}."
        raise AttributeError(f"the context has no {name!r}. {hint}", name=name, obj=self)
