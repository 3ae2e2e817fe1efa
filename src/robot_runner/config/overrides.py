"""Static parameters set from the command line: `--set robot=simulated`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from robot_runner.config.parameters import PARAMETERS_BY_NAME
from robot_runner.errors import ConfigError, Finding, did_you_mean

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

__all__ = ["apply_overrides", "own_parameters", "parse_assignments"]

_SIMPLE_TYPES = (bool, int, float, str, Path)
_BOOLEANS = {"true": True, "false": False, "yes": True, "no": False, "1": True, "0": False}


def parse_assignments(assignments: Iterable[str]) -> dict[str, str]:
    """Return the names and texts of `name=value` assignments; a later one replaces an earlier.

    Raises:
        ConfigError: one of them is no assignment.
    """
    parsed: dict[str, str] = {}
    for assignment in assignments:
        name, equals, value = assignment.partition("=")
        if not equals or not name.strip():
            raise ConfigError(
                f"{assignment!r} is no assignment",
                where="--set",
                fix="Write --set name=value, as in --set robot=simulated.",
            )
        parsed[name.strip()] = value
    return parsed


def apply_overrides(config_class: type, overrides: Mapping[str, str]) -> dict[str, Any]:
    """Set static parameters of a config class, each read as the type that the parameter has.

    Returns:
        The values that were set, by name.

    Raises:
        ConfigError: a parameter is not known or its text cannot be read; all findings at once.
    """
    values: dict[str, Any] = {}
    findings: list[Finding] = []
    for name, text in overrides.items():
        try:
            values[name] = _read(config_class, name, text)
        except ConfigError as error:
            findings += error.findings
    if findings:
        raise ConfigError.of_findings(findings)
    for name, value in values.items():
        setattr(config_class, name, value)
    return values


def own_parameters(config_class: type) -> dict[str, Any]:
    """Return the config's own attributes of a simple type, which can be set like the known ones."""
    return {
        name: value
        for parent in reversed(config_class.__mro__)
        for name, value in vars(parent).items()
        if not name.startswith("_") and isinstance(value, _SIMPLE_TYPES) and name not in PARAMETERS_BY_NAME
    }


def _read(config_class: type, name: str, text: str) -> Any:
    own = own_parameters(config_class)
    where = f"--set {name}={text}"
    if name in PARAMETERS_BY_NAME:
        parameter = PARAMETERS_BY_NAME[name]
        read, expected = parameter.from_text, parameter.expected
    elif name in own:
        kind = type(own[name])
        read, expected = _reader(kind), f"a value of type {kind.__name__}"
    else:
        raise ConfigError(
            f"there is no static parameter {name!r}", where=where, fix=did_you_mean(name, [*PARAMETERS_BY_NAME, *own])
        )
    try:
        return read(text)
    except (ValueError, KeyError) as error:
        raise ConfigError(f"{text!r} cannot be read", where=where, fix=f"It must be {expected}.") from error


def _reader(kind: type) -> Any:
    return (lambda text: _BOOLEANS[text.casefold()]) if kind is bool else kind
