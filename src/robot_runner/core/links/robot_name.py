"""The name of a robot as a config gives it: a link with its options, or an address."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from robot_runner.core.errors import LinkError

if TYPE_CHECKING:
    from collections.abc import Mapping

__all__ = ["RobotName"]

_WHERE = "robot"


@dataclass(frozen=True, slots=True)
class RobotName:
    """What `robot` in a config says: `link`, `link:option=value,option=value`, or an address: `link://host:port`.

    Of a link that reaches a whole graph, what stands in the place of an address names one of its robots by its
    namespace: `ros2://alice`, or with other options `ros2:domain=7,namespace=/alice`.

    Attributes:
        link: the name of the robot link.
        options: what is set on it, as written, in that order.
        address: the whole of an address; None where it is none.
        namespace: of the robot that is named on a graph; empty where none is.

    Example:
        >>> RobotName.parse("simulated:task_power_factor=1.1")
        RobotName(link='simulated', options={'task_power_factor': '1.1'}, address=None)
    """

    link: str
    options: Mapping[str, str] = field(default_factory=dict)
    address: str | None = None
    namespace: str = field(default="", repr=False)

    @property
    def on_graph(self) -> RobotName:
        """The robot of a graph that stands in the place of an address."""
        return RobotName(self.link, namespace=(self.address or "").partition("://")[2])

    @classmethod
    def parse(cls, text: str) -> RobotName:
        """Take a name apart.

        Raises:
            LinkError: an option has no name or no value, or is given twice.
        """
        link, colon, rest = text.partition(":")
        if rest.startswith("//"):
            return cls(link.strip(), {}, text.strip())
        options: dict[str, str] = {}
        for part in rest.split(",") if colon else ():
            name, equals, value = (piece.strip() for piece in part.partition("="))
            if not name or not equals or not value:
                raise LinkError(
                    f"{part.strip()!r} in {text!r} sets no option",
                    where=_WHERE,
                    fix=f"Write it as in '{link.strip()}:option=value,option=value'.",
                )
            if name in options:
                raise LinkError(f"{text!r} sets {name!r} twice", where=_WHERE, fix="Leave one of them out.")
            options[name] = value
        namespace = options.pop("namespace", "")
        return cls(link.strip(), options, namespace=namespace)
