"""Type and range of every static parameter."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from robot_runner.config.parameters import PARAMETERS, REQUIRED, Parameter, Parameters
from robot_runner.errors import Finding

if TYPE_CHECKING:
    from robot_runner.config.loader import LoadedConfig

__all__ = ["read_parameters"]


def read_parameters(loaded: LoadedConfig) -> tuple[Parameters | None, list[Finding]]:
    """Return the static parameters, or None where one of them is missing or malformed, and the findings."""
    values: dict[str, Any] = {}
    findings: list[Finding] = []
    for parameter in PARAMETERS:
        value = getattr(loaded.config, parameter.name, parameter.default)
        if value is REQUIRED:
            findings.append(_missing(loaded, parameter))
        elif not parameter.accepts(value):
            findings.append(_malformed(loaded, parameter, value))
        else:
            values[parameter.name] = parameter.normalise(value)
    return (None if findings else Parameters(**values)), findings


def _missing(loaded: LoadedConfig, parameter: Parameter) -> Finding:
    return Finding.error(
        f"{loaded.where}.{parameter.name}",
        "this static parameter is missing",
        f"Give it a value: it must be {parameter.expected}.",
    )


def _malformed(loaded: LoadedConfig, parameter: Parameter, value: object) -> Finding:
    return Finding.error(
        f"{loaded.where}.{parameter.name}",
        f"it is {value!r}, of type {type(value).__name__}",
        f"It must be {parameter.expected}.",
    )
