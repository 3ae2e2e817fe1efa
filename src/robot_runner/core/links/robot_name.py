"""Names of robots: one by its link and its options, or several that take turns."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

from robot_runner.core.errors import ConfigError, Finding, LinkError

_WHERE = "robot"


@dataclass(frozen=True, slots=True)
class RobotName:
    """The parsed `robot` of a config: `link`, `link:option=value,option=value`, or an address: `link://host:port`.

    For a link to a whole graph, the namespace of a robot takes the place of an address: `ros2://alice`, or with other
    options `ros2:domain=7,namespace=/alice`.

    Attributes:
        link: the name of the robot link.
        options: as written, in that order.
        address: the whole text of an address, or None.
        namespace: of a robot on a graph, or empty.

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
        """The same with the address taken as the namespace of a robot on a graph."""
        return RobotName(self.link, namespace=(self.address or "").partition("://")[2])

    @property
    def graph(self) -> str:
        """How its graph is reached, without a namespace.

        Example:
            >>> RobotName.parse("ros2:namespace=/alice,domain=7").graph
            'ros2:domain=7'
        """
        options = ",".join(f"{name}={value}" for name, value in self.options.items())
        return self.address or f"{self.link}:{options}".rstrip(":")

    @classmethod
    def parse(cls, text: str) -> RobotName:
        """Parse a name; raise a `LinkError` if an option has no name or no value, or is given twice."""
        link, colon, rest = text.partition(":")
        if rest.startswith("//"):
            return cls(link.strip(), {}, text.strip())
        options: dict[str, str] = {}
        for part in rest.split(",") if colon else ():
            name, equals, value = (piece.strip() for piece in part.partition("="))
            if not name or not equals or not value:
                fix = f"Write it as in '{link.strip()}:option=value,option=value'."
                raise LinkError(f"{part.strip()!r} in {text!r} sets no option", where=_WHERE, fix=fix)
            if name in options:
                raise LinkError(f"{text!r} sets {name!r} twice", where=_WHERE, fix="Leave one of them out.")
            options[name] = value
        namespace = options.pop("namespace", "")
        return cls(link.strip(), options, namespace=namespace)


#: Valid names of robots, which are cells of the run table.
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")


class Robots:
    """Robots of one kind, of which each run takes a free one: `robot = Robots("ros2://alice", "ros2://bob")`.

    Each combination is executed equally often on each robot, where that is possible.

    Args:
        robots: how each is reached, as `robot` for one. Its name is the host of the address, or the namespace.
        named: the same, by the robot's name.

    Attributes:
        links: how each is reached, by its name.

    Raises:
        ConfigError: there are fewer than two, or two have the same name; `findings` lists all problems.

    Example:
        >>> Robots("ros2://alice", bob="rosbridge://10.0.0.7:9090").links["alice"]
        'ros2://alice'
    """

    def __init__(self, *robots: str, **named: str) -> None:
        given = [*((_name_of(link), link) for link in robots), *named.items()]
        ConfigError.refuse(_findings(given))
        self.links: Mapping[str, str] = MappingProxyType(dict(given))

    def __repr__(self) -> str:
        links = ", ".join(f"{name}={link!r}" for name, link in self.links.items())
        return f"Robots({links})"


def _name_of(link: object) -> str:
    text = str(link)
    namespace = re.search(r"[:,]\s*namespace\s*=\s*/?([^,/]+)", text)
    return namespace[1].strip() if namespace else re.split(r"[/:]", text.partition("://")[2] or text)[0]


def _findings(given: list[tuple[str, str]]) -> Iterator[Finding]:
    names = [name for name, _ in given]
    if len(given) <= 1:
        yield Finding.error("Robots", "fewer than two robots are named", "Write robot = '...' for one.")
    for name in dict.fromkeys(names):
        if not _NAME.fullmatch(name):
            fix = "Use letters, digits, '.', '_' and '-': Robots(alice='...')."
            yield Finding.error("Robots", f"{name!r} cannot be the name of a robot", fix)
        elif names.count(name) > 1:
            fix = "Name them: Robots(alice='...', bob='...')."
            yield Finding.error("Robots", f"{names.count(name)} robots would be called {name!r}", fix)
    if not all(isinstance(link, str) and link for _, link in given):
        yield Finding.error("Robots", "a robot is not text", "Give the name of a link, such as 'ros2://alice'.")
