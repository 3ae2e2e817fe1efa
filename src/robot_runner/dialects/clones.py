"""The clone of an earlier tool that a config file stands in: a fork has modules of its own there, or changed some."""

from __future__ import annotations

import ast
from dataclasses import dataclass
from pathlib import Path

from robot_runner.dialects.syntax import bound_names

__all__ = ["Clone", "clone_around"]

#: Where public forks keep modules of their own: beside the config, in the tool's folder of the same clone, or in a
#: clone inside the user's own repository.
_TOOL_FOLDERS = (
    "",
    "experiment-runner",
    "robot-runner",
    "experiment-runner/experiment-runner",
    "robot-runner/robot-runner",
)


@dataclass(frozen=True, slots=True)
class Clone:
    """The folders of a clone from which the tool itself imported its modules; none where a config stands alone."""

    folders: tuple[Path, ...]

    def file_of(self, module: str) -> Path | None:
        """Return the file of a module, where the clone has it.

        Example:
            >>> Clone(()).file_of("Plugins.Profilers.MyMeter") is None
            True
        """
        below = Path(*module.split(".")).with_suffix(".py")
        return next((folder / below for folder in self.folders if (folder / below).is_file()), None)

    def text_of(self, module: str) -> str:
        """Return the text of a module; nothing where the clone does not have it, or it cannot be read."""
        file = self.file_of(module)
        try:
            return file.read_text(encoding="utf-8") if file else ""
        except (OSError, ValueError):
            return ""

    def defines(self, module: str, name: str) -> bool:
        """Return whether the clone's own version of a module has a name."""
        try:
            return name in bound_names(ast.parse(self.text_of(module)).body)
        except (SyntaxError, ValueError):
            return False


def clone_around(config: Path) -> Clone:
    """Return the clone that a config file stands in."""
    return Clone(
        tuple(
            folder / tool
            for folder in (config.parent, *config.parents)
            for tool in _TOOL_FOLDERS
            if (folder / tool / "Plugins").is_dir() or (tool and (folder / tool / "ConfigValidator").is_dir())
        )
    )
