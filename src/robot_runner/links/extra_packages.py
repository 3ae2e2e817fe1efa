"""Says which packages a link lacks, and the extra that brings them."""

from __future__ import annotations

import importlib.util
from typing import TYPE_CHECKING

from robot_runner.errors import LinkError

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

__all__ = ["missing_of", "not_installed"]


def missing_of(packages: Iterable[str]) -> list[str]:
    """Return those of the packages that cannot be imported; none is imported by asking.

    Example:
        >>> missing_of(["json", "no_such_package"])
        ['no_such_package']
    """
    return [package for package in packages if importlib.util.find_spec(package) is None]


def not_installed(missing: Sequence[str], *, way: str, extra: str) -> LinkError:
    """Return the error that a robot cannot be reached in this way for want of packages.

    Example:
        >>> print(not_installed(["cyclonedds"], way="over DDS", extra="dds").fix)
        Install it: pip install 'robot-runner[dds]'.
    """
    return LinkError(
        f"robot is reached {way}, but {' and '.join(missing)} cannot be imported",
        where="robot",
        fix=f"Install it: pip install 'robot-runner[{extra}]'.",
    )
