"""Checks that many plugins make, with the same messages."""

from __future__ import annotations

import math
import signal
from collections.abc import Collection, Iterable
from enum import Enum
from numbers import Real

from robot_runner.core.design.numeric_range import is_whole
from robot_runner.core.errors import Finding, PluginError, nearest


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


def checked_codes(plugin: str, exit_codes: object) -> tuple[int, ...]:
    """Return exit codes of a program.

    Raises:
        PluginError: they are no list of whole numbers.

    Example:
        >>> checked_codes("Planner", [0, 4])
        (0, 4)
    """
    codes = exit_codes if isinstance(exit_codes, Collection) else [None]
    if not all(map(is_whole, codes)):
        fix = "Give a list of whole numbers: exit_codes=[0]."
        raise PluginError(f"exit_codes is {exit_codes!r}", where=plugin, fix=fix)
    return tuple(codes)


def named_signal(plugin: str, wanted: object) -> signal.Signals:
    """Return the stop signal of a program, which a config gives as a member of `signal.Signals` or its number.

    Raises:
        PluginError: there is no such signal.

    Example:
        >>> named_signal("Planner", 2).name
        'SIGINT'
    """
    for each in signal.Signals:
        if wanted == each and wanted is not True:
            return each
    names = [each.name for each in signal.Signals if isinstance(wanted, str)]
    meant = nearest(str(wanted).rpartition(".")[2], names) or signal.SIGINT.name
    problem = f"stop_signal is {wanted!r}, which is no member of Python's module signal"
    raise PluginError(problem, where=plugin, fix=f"Give a member of it: stop_signal=signal.{meant}.")


def no_robot(plugin: str, does: str, *, for_example: str = "simulated") -> Finding:
    """Return the error that a plugin of this name needs a robot, as it `does` something, and there is none.

    Example:
        >>> no_robot("Battery", "measures the battery of a robot").problem
        'the plugin measures the battery of a robot, and the experiment names none'
    """
    fix = f"Name one in the config: robot = {for_example!r}. Or: --set robot={for_example}."
    return Finding.error(f"plugin {plugin}", f"the plugin {does}, and the experiment names none", fix)
