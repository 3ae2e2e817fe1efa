"""Misspelt attributes and callbacks: a name that is nearly one of ours was meant to be it."""

from __future__ import annotations

import difflib
from typing import TYPE_CHECKING

from robot_runner.config.parameters import PARAMETERS_BY_NAME
from robot_runner.errors import Finding
from robot_runner.events.event import EVENTS_BY_CALLBACK

if TYPE_CHECKING:
    from robot_runner.config.loader import LoadedConfig

__all__ = ["check_names"]

#: How alike two names are before one is taken for a slip of the other (1.0: equal).
_ALIKE = 0.85


def check_names(loaded: LoadedConfig) -> list[Finding]:
    """Return a finding for each public name of the config that nearly is a parameter or a callback."""
    names = {name for parent in type(loaded.config).__mro__[:-1] for name in _names_of(parent)}
    names |= set(vars(loaded.config)) if hasattr(loaded.config, "__dict__") else set()
    parameters = [*PARAMETERS_BY_NAME, "plugins"]
    callbacks = [*EVENTS_BY_CALLBACK, "create_run_table"]
    findings = []
    for name in sorted(names):
        if name.startswith("_") or name in parameters or name in callbacks:
            continue
        is_method = callable(getattr(loaded.config, name, None))
        meant = _nearly(name, callbacks if is_method else parameters)
        if meant is not None and meant not in names - _inherited(loaded.config):
            findings.append(_misspelt(loaded, name, meant, is_method=is_method))
    return findings


def _names_of(parent: type) -> set[str]:
    # A name that is annotated and never given a value is misspelt as easily as one that is.
    return set(vars(parent)) | set(vars(parent).get("__annotations__", {}))


def _inherited(config: object) -> set[str]:
    own = _names_of(type(config))
    return {name for parent in type(config).__mro__[1:] for name in _names_of(parent)} - own


def _nearly(name: str, known: list[str]) -> str | None:
    match = difflib.get_close_matches(name.casefold(), known, n=1, cutoff=_ALIKE)
    return match[0] if match else None


def _misspelt(loaded: LoadedConfig, name: str, meant: str, *, is_method: bool) -> Finding:
    what = "no event is called" if is_method else "there is no static parameter"
    return Finding.error(
        f"{loaded.where}.{name}",
        f"{what} {name!r}",
        f"Did you mean {meant!r}? Otherwise begin the name with '_'.",
    )
