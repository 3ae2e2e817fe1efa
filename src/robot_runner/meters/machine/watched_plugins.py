"""Adds a `MachineWatch` to experiments with plugins that measure a computer; a companion of each config.

Each start of the program executes this: modules that only the watch needs are imported if there is one.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import count
from typing import TYPE_CHECKING

from robot_runner.measuring.measured_machine import concerned

if TYPE_CHECKING:
    from robot_runner.core.config.parameters import Parameters
    from robot_runner.core.plugin import Plugin


def watch_machines(parameters: Parameters, plugins: Sequence[Plugin]) -> Iterable[Plugin]:
    """Return the watch of the computers that these plugins measure; empty if there are none, or it is turned off."""
    if not concerned(plugins):
        return []
    from robot_runner.meters.machine.machine_watch import MachineWatch  # noqa: PLC0415 - as said above

    watches = [plugin for plugin in plugins if isinstance(plugin, MachineWatch)]
    for watch in watches:
        watch.attach(plugins)
    if watches or not parameters.watch_machines:
        return []
    names = {plugin.name.casefold() for plugin in plugins}
    free = next(name for number in count(1) if (name := "machine" if number == 1 else f"machine-{number}") not in names)
    watch = MachineWatch(name=free, hosts=())
    watch.attach(plugins)
    return [watch]
