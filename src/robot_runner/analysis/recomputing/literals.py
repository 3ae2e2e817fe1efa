"""Values as literals of R and of Python, so that no name can become code; templates print nothing else.

A name or a treatment may be any text of a user: quotes, line ends, `"); system("reboot")`. A template that prints one
without a filter is refused.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cache
from typing import TYPE_CHECKING, Any

from robot_runner.analysis.report.rendering import markdown_text, templates_of

if TYPE_CHECKING:
    from jinja2 import Environment

_PACKAGE = "robot_runner.analysis.recomputing"
_WIDTH = 100
_LAST_OF_BASIC_PLANE = 0xFFFF


class Code(str):
    """Text that is code, or safe in code."""

    __slots__ = ()


def r_literal(value: Any) -> Code:
    r"""Return a value as an R literal; texts are in ASCII, so that they are the same in every locale.

    Example:
        >>> print(r_literal('5 "\N{OHM SIGN}"'), r_literal([1, 2.5, None]), r_literal(True))
        "5 \"\u2126\"" c(1, 2.5, NA) TRUE
    """
    if isinstance(value, str):
        return Code(f'"{"".join(map(_r_character, value))}"')
    if isinstance(value, list | tuple):
        return _sequence("c(", [r_literal(each) for each in value], ")") if value else Code("character()")
    if isinstance(value, bool):
        return Code("TRUE" if value else "FALSE")
    return Code("NA" if value is None else _number(value))


def _r_character(character: str) -> str:
    if character in '\\"':
        return f"\\{character}"
    if character.isascii() and character.isprintable():
        return character
    code = ord(character)
    return f"\\u{code:04x}" if code <= _LAST_OF_BASIC_PLANE else f"\\U{code:08x}"


def python_literal(value: Any) -> Code:
    r"""Return a value as a Python literal; a missing number is `nan`.

    Example:
        >>> print(python_literal("Task"), python_literal('a"\n'), python_literal((1, None)))
        "Task" 'a"\n' [1, nan]
    """
    if isinstance(value, str):
        text = repr(value)
        return Code(f'"{text[1:-1]}"' if text[0] == "'" and '"' not in text else text)
    if isinstance(value, list | tuple):
        return _sequence("[", [python_literal(each) for each in value], "]")
    return Code("nan" if value is None else str(value) if isinstance(value, bool) else _number(value))


def _number(value: float) -> str:
    if not math.isfinite(value):
        raise ValueError(f"{value} is not a number of a report")
    return repr(value)


def _sequence(start: str, items: Sequence[str], end: str) -> Code:
    """Return a list, on several lines if one would be too long."""
    lines, line = [], start
    for place, item in enumerate(items):
        part = f"{item}, " if place < len(items) - 1 else item
        if len(line) + len(part) > _WIDTH:
            lines.append(line.rstrip())
            line = "  "
        line += part
    return Code("\n".join([*lines, line + end]))


def comment_text(text: str) -> Code:
    r"""Return a text for a comment, with line ends and other unprintable characters escaped.

    Example:
        >>> print(comment_text("a\nstop()"))
        a\nstop()
    """
    return Code("".join(each if each.isprintable() else repr(each)[1:-1] for each in text))


def rendered(name: str, **content: Any) -> str:
    """Render a template.

    Raises:
        TypeError: the template prints a text without a filter.
    """
    return _templates().get_template(name).render(**content)


@cache
def _templates() -> Environment:
    environment = templates_of(_PACKAGE, _checked)  # no HTML: text that no filter has escaped is refused
    filters: dict[str, Callable[[Any], Code]] = {
        "r": r_literal,
        "py": python_literal,
        "comment": comment_text,
        "markdown": lambda text: Code(markdown_text(text)),
    }
    environment.filters.update(filters)
    return environment


def _checked(value: object) -> object:
    if isinstance(value, Code | int | float):
        return value
    raise TypeError(f"a template prints {value!r} without saying as what")
