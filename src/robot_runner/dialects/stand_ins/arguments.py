"""Arguments that a stand-in does not know: refused with the name that was meant, as a config validator would."""

from __future__ import annotations

from typing import TYPE_CHECKING

from robot_runner.errors import ConfigError, Finding, did_you_mean

if TYPE_CHECKING:
    from collections.abc import Iterable

__all__ = ["refuse_unknown"]


def refuse_unknown(where: str, unknown: Iterable[str], known: Iterable[str]) -> None:
    """Refuse arguments that no version of a tool knew.

    Raises:
        ConfigError: there are any; each is named, with the nearest that is known.
    """
    names = list(known)
    findings = [
        Finding.error(where, f"it has no argument {name!r}", did_you_mean(name, names)) for name in sorted(unknown)
    ]
    if findings:
        raise ConfigError.of_findings(findings)
