"""Whether goals and messages that a plugin will send are as their types are defined, before anything is executed."""

from __future__ import annotations

import importlib.util
import json
from typing import TYPE_CHECKING, Protocol

from robot_runner.core.errors import Finding, LinkError
from robot_runner.core.links.graph_needs import GraphPart
from robot_runner.ros.shapes import completed, plain_type

if TYPE_CHECKING:
    from collections.abc import Iterator

    from robot_runner.core.links.graph_needs import GraphNeed
    from robot_runner.core.links.robot import Message


class ChecksMessages(Protocol):
    """Knows definitions: a link to a graph, or the types of ROS 2 that are known without any graph."""

    def check_message(self, name: str, type_name: str, message: Message, *, is_goal: bool = False) -> None:
        """See that a message or a goal follows its definition; raise a `LinkError` where it does not."""
        ...


class StandardTypes:
    """The types of ROS 2 that are known without any graph, as the embedded robot takes them."""

    @staticmethod
    def is_known() -> bool:
        """Whether the package that brings the definitions is installed."""
        return importlib.util.find_spec("rosbags") is not None

    def check_message(self, name: str, type_name: str, message: Message, *, is_goal: bool = False) -> None:
        """See that a message or a goal follows its definition.

        Raises:
            LinkError: it does not, or there is no such type.
        """
        from robot_runner.ros.type_catalogue import TypeCatalogue  # noqa: PLC0415  # it takes the extra `ros`

        shape = TypeCatalogue.of(2).shape(f"{plain_type(type_name)}{'_Goal' if is_goal else ''}")
        completed(shape, message, where=name)


def misfits(known: ChecksMessages, need: GraphNeed, where: str) -> Iterator[Finding]:
    """Yield an error for each goal or message of a need that is not as its type is defined.

    Each has a place of its own below `where`: what an experiment starts later does not mend it.
    """
    is_goal = need.part is GraphPart.ACTION
    for sent in need.sent:
        try:
            known.check_message(need.name, need.types[0], json.loads(sent), is_goal=is_goal)
        except LinkError as error:
            place = f"{where}, {'goal' if is_goal else 'message'} of {error.where}"
            yield Finding.error(place, error.problem, error.fix)
