"""Signatures, names and code of callables and classes, without evaluating annotations.

From Python 3.14 on an annotation is evaluated when it is asked for, which fails if its names are imported for type
checkers alone.
"""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable, Iterator
from types import CodeType
from typing import Any

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
