"""Checks that many plugins make, with the same messages."""

from __future__ import annotations

import math
from collections.abc import Iterable
from enum import Enum
from numbers import Real

from robot_runner.core.errors import Finding, PluginError


def check_numbers(where: str, *, may_be_zero: bool = False, **parameters: object) -> None:
    """Refuse parameters that are not finite numbers above 0, or not below it.

    Raises:
        PluginError: one of the parameters is not.

    Example:
        >>> check_numbers("Waypoints", speed=0.2, timeout_s=5)
    """
    for name, value in parameters.items():
        number = float(value) if isinstance(value, Real) and not isinstance(value, bool) else -1.0
        if not 0 <= number < math.inf or (number == 0 and not may_be_zero):
            least = "from 0 up" if may_be_zero else "above 0"
            raise PluginError(f"{name} is {value!r}", where=where, fix=f"Give {name} a number {least}.")


def check_kind(where: str, kind: type, /, **parameters: object) -> None:
    """Refuse parameters that are of another type, such as the name of an enum's member.

    Raises:
        PluginError: one of the parameters is.

    Example:
        >>> check_kind("the column 'watts'", str, source="watts")
    """
    for name, value in parameters.items():
        if not isinstance(value, kind):
            named = "number" if kind is Real else kind.__name__
            choice = f"one of: {', '.join(map(str, kind))}" if issubclass(kind, Enum) else f"a {named}"
            raise PluginError(f"{name} is {value!r}", where=where, fix=f"Give {name} {choice}.")


def check_list(where: str, **parameters: object) -> None:
    """Refuse parameters that are not lists, such as a text, whose letters would be taken for items.

    Raises:
        PluginError: one of the parameters is not.

    Example:
        >>> check_list("Network", interfaces=["wlan0"])
    """
    for name, value in parameters.items():
        if isinstance(value, str) or not isinstance(value, Iterable):
            listed = [] if value in (None, "") else [value]
            raise PluginError(f"{name} is {value!r}", where=where, fix=f"Give a list: {name}={listed!r}.")


def no_robot(plugin: str, does: str, *, for_example: str = "simulated") -> Finding:
    """Return the error that a plugin of this name needs a robot, as it `does` something, and there is none.

    Example:
        >>> no_robot("Battery", "measures the battery of a robot").problem
        'the plugin measures the battery of a robot, and the experiment names none'
    """
    fix = f"Name one in the config: robot = {for_example!r}. Or: --set robot={for_example}."
    return Finding.error(f"plugin {plugin}", f"the plugin {does}, and the experiment names none", fix)
