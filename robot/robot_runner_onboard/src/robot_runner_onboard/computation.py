"""The task "computation": the sequence of Fibonacci over and over, which loads one core."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from robot_runner_onboard.channel import serve

if TYPE_CHECKING:
    from robot_runner_onboard.channel import Channel

__all__ = ["compute", "fibonacci"]

#: About 10 ms of work on a Raspberry Pi: as long as it may take until the worker hears that it is to end.
_TERMS = 5000


def fibonacci(terms: int) -> int:
    """Return the last of so many numbers of the sequence, which begins with 0 and 1.

    Example:
        >>> fibonacci(10)
        34
    """
    last, following = 0, 1
    for _ in range(terms - 1):
        last, following = following, last + following
    return last


def compute(channel: Channel) -> str:
    """Compute until told to end."""
    channel.ready()
    rounds = 0
    while not channel.is_over():
        fibonacci(_TERMS)
        rounds += 1
    return f"{rounds} times the first {_TERMS} numbers of Fibonacci"


if __name__ == "__main__":
    sys.exit(serve(compute))
