"""Signatures, names and code of callables and classes, without evaluating annotations.

From Python 3.14 on an annotation is evaluated when it is asked for, which fails if its names are imported for type
checkers alone.
"""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable, Iterator, Mapping
from types import CodeType, NoneType
from typing import Any, NamedTuple

if sys.version_info >= (3, 14):
    from annotationlib import Format


def signature_of(called: Callable[..., Any]) -> inspect.Signature:
    """Return the signature of a function or class, as `inspect.signature`; its annotations are unspecified.

    Raises:
        TypeError: it cannot be called.
        ValueError: it is written in C, and has no signature.

    Example:
        >>> list(signature_of(lambda context, speed=0.2: None).parameters)
        ['context', 'speed']
    """
    if sys.version_info >= (3, 14):
        return inspect.signature(called, annotation_format=Format.STRING)
    return inspect.signature(called)


def parameters_of(kind: type) -> dict[str, inspect.Parameter]:
    """Return the parameters of a class, by name; with `**keywords`, those of its parents as well.

    `*arguments` are among them; `**keywords` come last, unless a parent takes none.

    Example:
        >>> class Meter:
        ...     def __init__(self, rate_hz=1.0): ...
        >>> class Powermeter(Meter):
        ...     def __init__(self, port, **keywords): ...
        >>> list(parameters_of(Powermeter))
        ['port', 'rate_hz']
    """
    found: dict[str, inspect.Parameter] = {}
    keywords: dict[str, inspect.Parameter] = {}
    for parent in kind.__mro__[:-1]:
        if "__init__" in vars(parent):
            own = list(signature_of(vars(parent)["__init__"]).parameters.values())[1:]
            keywords = {each.name: each for each in own if each.kind is each.VAR_KEYWORD}
            found |= {each.name: each for each in own if each.name not in {**keywords, **found}}
            if not keywords:
                break
    return found | keywords


#: The kinds of parameters that take any number of arguments.
OPEN_KINDS = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)


def needed_parameters(called: Callable[..., Any]) -> list[str]:
    """Return the names of the parameters without which something cannot be called.

    Example:
        >>> needed_parameters(lambda cause, *answers, rate_hz, timeout_s=1.0: None)
        ['cause', 'rate_hz']
    """
    parameters = signature_of(called).parameters.items()
    return [name for name, each in parameters if each.default is each.empty and each.kind not in OPEN_KINDS]


_PLAIN = {"bool": bool, "int": int, "float": float, "str": str, "None": NoneType}
_IN_WORDS = {bool: "True or False", int: "a whole number", float: "a number", str: "a text", NoneType: "None"}


class Mistyped(NamedTuple):
    """An argument of another type than its parameter is annotated with."""

    name: str
    value: Any
    types: tuple[type, ...]

    @property
    def problem(self) -> str:
        """The argument, in words."""
        return f"{self.name} is {self.value!r}, of type {type(self.value).__name__}"

    @property
    def fix(self) -> str:
        """What is to be given in its place, in words."""
        return f"Give {' or '.join(_IN_WORDS[each] for each in self.types)}."


def mistyped(called: Callable[..., Any], given: Mapping[str, Any]) -> Iterator[Mistyped]:
    """Yield the arguments of another type than their parameter, where that is annotated with plain types alone.

    Raises:
        TypeError: it cannot be called.
        ValueError: it is written in C, and has no signature.

    Example:
        >>> def drive(speed: float, is_fast: bool = False, places: "list[str] | None" = None): ...
        >>> [(each.problem, each.fix) for each in mistyped(drive, {"speed": 1, "is_fast": "no", "places": "x"})]
        [("is_fast is 'no', of type str", 'Give True or False.')]
    """
    for name, parameter in signature_of(called).parameters.items():
        if name not in given or parameter.kind in OPEN_KINDS:
            continue
        value, annotation = given[name], parameter.annotation
        text = annotation.__name__ if isinstance(annotation, type) else str(annotation)
        types = tuple(_PLAIN.get(part.strip(), object) for part in text.split("|"))
        if not isinstance(value, (*types, int) if float in types else types):
            yield Mistyped(name, value, types)


def names_in(parent: type) -> set[str]:
    """Return the names in the body of a class, also those that are only annotated.

    Example:
        >>> class Robot:
        ...     speed: float
        >>> "speed" in names_in(Robot)
        True
    """
    if sys.version_info >= (3, 14):
        annotated = inspect.get_annotations(parent, format=Format.STRING)
    else:
        annotated = vars(parent).get("__annotations__", {})
    return {*vars(parent), *annotated}


def code_of(attribute: object) -> CodeType | None:
    """Return the code of a function or method of a class; None for anything else."""
    bare = attribute.__func__ if isinstance(attribute, classmethod | staticmethod) else attribute
    return getattr(inspect.unwrap(bare) if callable(bare) else None, "__code__", None)


def names_read_by(attribute: object) -> Iterator[str]:
    """Yield the names that a function or method reads or calls, and those of the functions in it.

    Example:
        >>> sorted(names_read_by(lambda robot: [robot.stop() for _ in "ab"]))
        ['stop']
    """
    code = attribute if isinstance(attribute, CodeType) else code_of(attribute)
    if code is not None:
        yield from code.co_names
        for each in code.co_consts:
            yield from names_read_by(each) if isinstance(each, CodeType) else ()
