"""The parameter server of ROS 1, asked through rosapi, the node beside a rosbridge."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from robot_runner.core.errors import LinkError

if TYPE_CHECKING:
    from robot_runner.ros.rosbridge_types import Rosapi


class RosapiParameters:
    """A parameter server by `/rosapi/get_param` and the like, which carry values as JSON.

    rosapi can be told which parameters it lets anybody see (`params_glob`); those that it does not are as if not set.
    """

    def __init__(self, rosapi: Rosapi) -> None:
        self._rosapi = rosapi

    def parameter_names(self) -> list[str]:
        """Return the full names of all parameters."""
        return list(self._rosapi.told("get_param_names", {})["names"])

    def parameter(self, name: str) -> Any:
        """Return the value of one, or None where it is not set.

        Raises:
            LinkError: rosapi does not answer, or with something that is no JSON.
        """
        told = self._rosapi.told("get_param", {"name": name, "default": ""})["value"]
        try:
            return json.loads(told or "null")
        except ValueError as error:
            fix = "Look at rosapi's log."
            raise LinkError(f"rosapi tells its value as {told!r}, which is no JSON", where=name, fix=fix) from error

    def set_parameter(self, name: str, *, value: Any) -> None:
        """Set one.

        Raises:
            LinkError: rosapi does not answer, or the value cannot be written as JSON.
        """
        try:
            written = json.dumps(value, allow_nan=False)
        except (TypeError, ValueError) as error:
            fix = "Give a number, a text, True or False, or a list of them."
            raise LinkError(f"{value!r} cannot pass through a rosbridge: {error}", where=name, fix=fix) from error
        self._rosapi.told("set_param", {"name": name, "value": written})

    def delete_parameter(self, name: str) -> None:
        """Take one away."""
        self._rosapi.told("delete_param", {"name": name})
