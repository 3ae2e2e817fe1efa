"""How the contracts of links try what must be refused, and in time."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from robot_runner.core.errors import LinkError
from robot_runner.testing.plugin_contract import require

if TYPE_CHECKING:
    from collections.abc import Callable

#: How long what takes milliseconds may take on a busy machine, s.
PATIENCE = 20.0
#: How much longer than its deadline something may take, s; and how often it is tried, since a busy machine may be late.
_SLACK, _ATTEMPTS = 3.0, 3


def refusal(attempt: Callable[[], object]) -> LinkError:
    """Return the `LinkError` that the attempt raises; fail the test if it raises none."""
    try:
        attempt()
    except LinkError as error:
        require(error.problem and error.where, f"{error!r} does not say what is wrong and where")
        return error
    raise AssertionError("the attempt was not refused")


def punctual_refusal(attempt: Callable[[], object], *, timeout: float) -> LinkError:
    """Return the `LinkError` that the attempt raises; fail the test if it never does so soon after its `timeout`, s."""
    for _ in range(_ATTEMPTS):
        begun = time.monotonic()
        error = refusal(attempt)
        if time.monotonic() - begun < timeout + _SLACK:
            return error
    raise AssertionError(f"the attempt took too long: more than {_SLACK:g} s after its deadline")
