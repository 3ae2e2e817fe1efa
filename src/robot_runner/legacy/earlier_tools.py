"""The dialect of the earlier tools, announced by an entry point."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from robot_runner.core.config.loader import LoadedConfig
from robot_runner.legacy.recognition import recognise


class _EarlierTools:
    """Configs of Experiment Runner and of earlier versions of Robot Runner, recognised by their syntax tree."""

    def recognise(self, path: Path) -> Callable[[Mapping[str, str]], LoadedConfig] | None:
        """Return a function that loads this file, or None if it is not a config of an earlier tool.

        Raises:
            ConfigError: the file cannot be read or parsed, or mixes the spellings of several tools.
        """
        recognised = recognise(path)
        if recognised is None:
            return None
        from robot_runner.legacy.lifting import lift  # noqa: PLC0415 - own configs need none of it

        return lambda overrides: lift(recognised, overrides)

    def stand_in_modules(self) -> frozenset[str]:
        """Return the top-level packages of the earlier tools that stand-in modules replace."""
        from robot_runner.legacy.stand_ins.modules import MODULES, PACKAGES  # noqa: PLC0415 - own configs need none

        return frozenset(name.partition(".")[0] for name in (*MODULES, *PACKAGES))


#: The object of the entry point.
EARLIER_TOOLS = _EarlierTools()
