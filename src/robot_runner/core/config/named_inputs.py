"""Which files an experiment reads beside its code: those that plugins, robots and config name, for any treatment."""

from __future__ import annotations

import logging
from functools import partial
from typing import TYPE_CHECKING

from robot_runner.core.config.plugin_checks import instances_of, with_each_treatment
from robot_runner.core.links.connect import robot_input_files
from robot_runner.core.storage.input_files import InputFile

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from robot_runner.core.config.parameters import Parameters
    from robot_runner.core.design.run_table_model import RunTableModel
    from robot_runner.core.plugin import Plugin

_log = logging.getLogger(__name__)


def named_inputs(
    parameters: Parameters, plugins: Sequence[Plugin], model: RunTableModel | None, config: object = None
) -> tuple[InputFile, ...]:
    """Return the files that are named, each once; who cannot tell them is logged and left out.

    A config may have a method `input_files`, too, for what its callbacks read.
    """
    found: dict[InputFile, None] = {}
    robots = parameters.robots.values() if parameters.robots else filter(None, [parameters.robot])
    asked: list[tuple[str, Callable[[], Iterable[InputFile]]]] = [
        *((robot, partial(robot_input_files, robot)) for robot in robots),
        *((f"plugin {plugin.name}", partial(_of_plugin, plugin, model)) for plugin in plugins),
    ]
    if callable(own := getattr(config, "input_files", None)):
        asked.append(("the config", own))
    for where, ask in asked:
        try:
            found |= dict.fromkeys(instances_of(InputFile, ask()))
        except (Exception, SystemExit) as error:  # noqa: BLE001 - a stranger's code; an experiment is worth more than a copy
            _log.warning("%s: which files it reads is not known: %s", where, error)
    return tuple(found)


def _of_plugin(plugin: Plugin, model: RunTableModel | None) -> Iterator[InputFile]:
    for built in with_each_treatment(plugin, model):
        yield from built.input_files()
