"""Callbacks: a method named like an event hears it, so that nothing has to be subscribed."""

from __future__ import annotations

import ast
from collections import Counter
from typing import TYPE_CHECKING

from robot_runner.errors import Finding
from robot_runner.events.event import EVENTS_BY_CALLBACK, RobotRunnerEvents

if TYPE_CHECKING:
    from collections.abc import Iterator

    from robot_runner.dialects.conversion.edits import Edits
    from robot_runner.dialects.session import Session

__all__ = [
    "CallbackNames",
    "convert_continue",
    "convert_lists_of_callbacks",
    "convert_rows_of_before_run",
    "named_callbacks",
    "order_findings",
    "remove_subscriptions",
]

_CONTROLLER = "EventSubscriptionController"
_OF_ALL = "subscribe_to_multiple_events"
_OF_FORK = f"{_OF_ALL}_multiple_callbacks"
_INDENT = 4


class CallbackNames:
    """What the methods of a config are called afterwards.

    Attributes:
        renamed: the new name of a method, by its old one.
        is_by_name: whether every callback hears its event by its name alone.
    """

    def __init__(self, renamed: dict[str, str], *, is_by_name: bool) -> None:
        self.renamed = renamed
        self.is_by_name = is_by_name


def named_callbacks(session: Session, methods: set[str]) -> CallbackNames:
    """Name each callback after its event, where each event has one and each callback hears one.

    Args:
        session: what the config subscribed when it was loaded.
        methods: the methods that the config class defines.
    """
    heard = [(each.event, getattr(each.callback, "__name__", "")) for each in session.subscriptions]
    events = Counter(event for event, _ in heard)
    names = Counter(name for _, name in heard)
    is_by_name = all(name in methods for _, name in heard) and all(
        count == 1 for count in (*events.values(), *names.values())
    )
    renamed = {name: event.callback_name for event, name in heard if name != event.callback_name} if is_by_name else {}
    subscribed = {name for _, name in heard}
    for method in methods & set(EVENTS_BY_CALLBACK):
        if method not in subscribed:
            renamed[method] = f"_{method}"  # it would hear the event now
    return CallbackNames(renamed, is_by_name=is_by_name)


def remove_subscriptions(config: ast.ClassDef, edits: Edits) -> None:
    """Remove the subscriptions of a class, and an `__init__` in which nothing else is done."""
    for method in config.body:
        if not isinstance(method, ast.FunctionDef):
            continue
        found = [statement for statement in method.body if _subscribes(statement)]
        others = [statement for statement in method.body if statement not in found and not _is_docstring(statement)]
        if found and not others and method.name == "__init__":
            edits.remove_paragraph(_first_line(method), method.end_lineno or method.lineno)
            continue
        for statement in found:
            edits.remove_lines(statement.lineno, statement.end_lineno or statement.lineno)
        if len(found) == len(method.body):
            edits.insert(edits.line_start(method.body[0].lineno), f"{' ' * method.body[0].col_offset}pass\n")


def convert_lists_of_callbacks(config: ast.ClassDef, edits: Edits) -> None:
    """Write an entry for each callback where a fork took lists of them; what is in them is converted already."""
    for node in ast.walk(config):
        match node:
            case ast.Call(func=ast.Attribute(value=ast.Name(id=name), attr=attr) as func) if (
                name == _CONTROLLER and attr == _OF_FORK
            ):
                edits.replace_span(edits.end_of(func) - len(_OF_FORK), edits.end_of(func), _OF_ALL)
                for pair in ast.walk(node):
                    match pair:
                        case ast.Tuple(elts=[event, ast.List(elts=callbacks)]):
                            parts = [f"({edits.edited(event)}, {edits.edited(each)})" for each in callbacks]
                            edits.replace(pair, ", ".join(parts))
                        case _:
                            pass
            case _:
                pass


def convert_continue(config: ast.ClassDef, names: CallbackNames, edits: Edits) -> None:
    """Have the callback of `continue` return True: it has asked the user itself."""
    for method in config.body:
        if isinstance(method, ast.FunctionDef) and names.renamed.get(method.name, method.name) == "continue_experiment":
            last = method.body[-1]
            indent = " " * (method.col_offset + _INDENT)
            edits.insert(edits.end_of(last), f"\n{indent}return True  # the user was asked here")


def convert_rows_of_before_run(config: ast.ClassDef, session: Session, edits: Edits) -> None:
    """Have a `before_run` that took the row take the context."""
    heard = {
        getattr(each.callback, "__name__", "")
        for each in session.subscriptions
        if each.event is RobotRunnerEvents.BEFORE_RUN
    }
    for method in config.body:
        if isinstance(method, ast.FunctionDef) and method.name in heard:
            for argument in method.args.args[1:2]:
                if argument.arg != "context":
                    edits.replace(argument, "context")
                    first = method.body[0]
                    indent = " " * first.col_offset
                    edits.insert(edits.start_of(first), f"{argument.arg} = context.combination\n{indent}")


def order_findings(session: Session) -> Iterator[Finding]:
    """Say where the order of the events differs from the earlier tool's."""
    heard = {each.event for each in session.subscriptions}
    is_robot_runner = session.recognised.dialect.class_name == "RobotRunnerConfig"
    if is_robot_runner and {RobotRunnerEvents.STOP_RUN, RobotRunnerEvents.POPULATE_RUN_DATA} <= heard:
        yield Finding.warning(
            session.path.name,
            "populate_run_data is called after stop_run now; Robot Runner called it before",
            "See that stop_run leaves what populate_run_data reads.",
        )


def _subscribes(statement: ast.stmt) -> bool:
    match statement:
        case ast.Expr(value=ast.Call(func=ast.Attribute(value=ast.Name(id=name)))):
            return name == _CONTROLLER
        case _:
            return False


def _is_docstring(statement: ast.stmt) -> bool:
    return isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant)


def _first_line(method: ast.FunctionDef) -> int:
    return min([method.lineno, *(decorator.lineno for decorator in method.decorator_list)])
