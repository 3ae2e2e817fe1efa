"""Checks of parameters that many profilers have, with the same messages."""

from __future__ import annotations

import math
from collections.abc import Iterable
from numbers import Real

from robot_runner.core.errors import PluginError


def check_positive(where: str, **parameters: object) -> None:
    """Refuse parameters that are not finite numbers above 0.

    Raises:
        PluginError: one of the parameters is not.

    Example:
        >>> check_positive("Network", rate_hz=2.0)
    """
    for name, value in parameters.items():
        if isinstance(value, bool) or not isinstance(value, Real) or not 0 < float(value) < math.inf:
            raise PluginError(f"{name} is {value!r}", where=where, fix=f"Give {name} a number above 0.")


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
