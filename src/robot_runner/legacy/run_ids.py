"""The ids of runs in each version of the earlier tools, which analysis scripts search for."""

from __future__ import annotations

import ast
import re
from collections.abc import Collection
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

from robot_runner.core.config.source import tree_or_empty
from robot_runner.legacy.recognition import Dialect, Recognised
from robot_runner.legacy.syntax import bound_names, imports_of

#: Folders in which public forks keep their own modules: beside the config, in the tool's folder of the same clone, or
#: in a clone inside the user's own repository.
_TOOL_FOLDERS = (
    "",
    "experiment-runner",
    "robot-runner",
    "experiment-runner/experiment-runner",
    "robot-runner/robot-runner",
)


@dataclass(frozen=True, slots=True)
class Clone:
    """The folders of a clone from which the tool imported its modules; none if the config is not in a clone."""

    folders: tuple[Path, ...]

    def file_of(self, module: str) -> Path | None:
        """Return the file of a module in the clone, or None.

        Example:
            >>> Clone(()).file_of("Plugins.Profilers.MyMeter") is None
            True
        """
        below = Path(*module.split(".")).with_suffix(".py")
        return next((folder / below for folder in self.folders if (folder / below).is_file()), None)

    @property
    def entries(self) -> tuple[Path, ...]:
        """The folders with a `__main__.py`: Python put them on its path, so that modules in them could be imported."""
        return tuple(folder for folder in self.folders if (folder / "__main__.py").is_file())

    def text_of(self, module: str) -> str:
        """Return the text of a module; empty if the clone does not have it, or it cannot be read."""
        file = self.file_of(module)
        try:
            return file.read_text(encoding="utf-8") if file else ""
        except (OSError, ValueError):
            return ""

    def defines(self, module: str, name: str) -> bool:
        """Return whether the clone's version of a module binds a name."""
        return name in bound_names(tree_or_empty(self.text_of(module)).body)


def clone_around(config: Path) -> Clone:
    """Return the clone that contains a config file."""
    return Clone(
        tuple(
            folder / tool
            for folder in (config.parent, *config.parents)
            for tool in _TOOL_FOLDERS
            if (folder / tool / "Plugins").is_dir() or (tool and (folder / tool / "ConfigValidator").is_dir())
        )
    )


class Numbering(Enum):
    """The numbering of runs; the value is the pattern of an id."""

    COUNTED_FROM_0 = "run_{place}"
    COUNTED_FROM_1 = "run_{number}"
    WITH_ITERATION = "run_{place}_iteration_{repetition}"
    WITH_REPETITION = "run_{place}_repetition_{repetition}"

    def run_id(self, place: int, repetition: int) -> str:
        """Return the id of a run from the index of its combination and its repetition, both from 0.

        Example:
            >>> Numbering.WITH_REPETITION.run_id(2, 0)
            'run_2_repetition_0'
        """
        return self.value.format(place=place, number=place + 1, repetition=repetition)


#: Arguments of `RunTableModel` in a fork only, and those that came with Experiment Runner's repetitions.
_OF_FORK = frozenset({"num_of_repetitions", "randomize_order"})
_BY_ARGUMENT = {
    "iterations": Numbering.WITH_ITERATION,
    "repetitions": Numbering.WITH_REPETITION,
    "num_repetitions": Numbering.WITH_REPETITION,
    "exclude_combinations": Numbering.WITH_REPETITION,
}
#: Names and plugins only in versions of Experiment Runner whose ids have the repetition; below, those in earlier ones.
_LATER_NAMES = frozenset({"execute_run", "self_measure"})
_LATER_PLUGINS = frozenset({"EnergiBridge", "NvidiaML", "PicoCM3", "PowerLetrics", "PowerMetrics", "Ps"})
_EARLIER_NAMES = frozenset({"exclude_variations", "run_variation", "create_run_table", "get_factor_name"})
_EARLIER_MODULES = frozenset({"Plugins.CodecarbonWrapper"})

#: The expression for ids in the code of a tool: `f"run_{i}_repetition_{j}"`.
_ID = re.compile(r"run_\{\w+(?P<from_1> ?\+ ?1)?\}(?P<kind>_repetition|_iteration)?")
_KINDS = {"_repetition": Numbering.WITH_REPETITION, "_iteration": Numbering.WITH_ITERATION}


def numbering_of(recognised: Recognised, arguments: Collection[str], repetitions: int = 1) -> Numbering:
    """Return the numbering of runs in the version of the tool for which a config was written.

    The version is that of the clone around the config; without a clone, it follows from the names that the config uses.
    (A resumed run table keeps its ids in any case.) `arguments` are the keyword arguments of `RunTableModel`.
    """
    if _OF_FORK & set(arguments):
        return Numbering.COUNTED_FROM_1
    found = _ID.search(clone_around(recognised.path).text_of("ConfigValidator.Config.Models.RunTableModel"))
    counted = Numbering.COUNTED_FROM_1 if found and found["from_1"] else Numbering.COUNTED_FROM_0
    tool = _KINDS.get(found["kind"], counted) if found else None
    if tool is None or (tool is Numbering.COUNTED_FROM_0 and repetitions > 1):  # that tool did not repeat
        return _in_text(recognised, arguments)
    return tool


def _in_text(recognised: Recognised, arguments: Collection[str]) -> Numbering:
    for name, numbering in _BY_ARGUMENT.items():
        if name in arguments:
            return numbering
    if recognised.dialect is Dialect.ROBOT_RUNNER:
        return Numbering.COUNTED_FROM_0
    names = _names_in(recognised.tree) | set(arguments)
    modules = {each.module for each in imports_of(recognised.tree)}
    if names & _LATER_NAMES or {module.rpartition(".")[2] for module in modules} & _LATER_PLUGINS:
        return Numbering.WITH_REPETITION
    is_early = names & _EARLIER_NAMES or modules & _EARLIER_MODULES
    return Numbering.COUNTED_FROM_0 if is_early else Numbering.WITH_REPETITION


def _names_in(tree: ast.Module) -> set[str]:
    names: set[str] = set()
    for node in ast.walk(tree):
        match node:
            case ast.Attribute(attr=name) | ast.FunctionDef(name=name) | ast.Name(id=name):
                names.add(name)
    return names
