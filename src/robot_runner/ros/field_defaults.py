"""The defaults that definitions of ROS 2 give to fields, which type stores lose.

Source: docs.ros.org, "Interfaces", "Field default value".
"""

from __future__ import annotations

import ast
import re
from typing import Any

from robot_runner.core.errors import LinkError

#: A field's type, whether it is an array, its name, and what stands behind that; constants have `=` there.
_FIELD = re.compile(r"\s*([\w/]+)(?:<=\d+)?(\[[^\]]*\])?\s+(\w+)\s+([^\s=#].*)")
_TRUTH = re.compile(r"\b(?:true|false)\b", re.IGNORECASE)
_TEXTS = ("string", "wstring")


def field_defaults(text: str, *, where: str) -> dict[str, Any]:
    r"""Return the default of each field that has one in a definition; arrays are tuples.

    Args:
        text: of the definition.
        where: its file, for the error.

    Raises:
        LinkError: one cannot be read.

    Example:
        >>> field_defaults("float32 speed 0.25  # m/s\nuint8 MODE=3\nint32 count\nbool[] on [true, false]", where="a")
        {'speed': 0.25, 'on': (True, False)}
    """
    found = {}
    for line in text.splitlines():
        parts = _FIELD.fullmatch(line)
        if parts is not None:
            kind, array, name, written = parts.groups()
            try:
                found[name] = _value(kind, written, is_array=array is not None)
            except (ValueError, SyntaxError) as error:
                problem = f"the default of the field {name!r} cannot be read: {written[:80]!r}"
                raise LinkError(problem, where=where, fix="Mend the definition.") from error
    return found


def _value(kind: str, written: str, *, is_array: bool) -> Any:
    if is_array:
        spelt = written if kind in _TEXTS else _TRUTH.sub(lambda word: word[0].title(), written)
        values = ast.literal_eval(spelt)  # lists are spelt as in Python, and comments, too
        return tuple(map(bool, values)) if kind == "bool" else tuple(values)
    if kind in _TEXTS and written[0] in "\"'":
        return ast.literal_eval(written)
    bare = written.partition("#")[0].strip()
    if kind in _TEXTS:  # quotes may be left out
        return bare
    if kind == "bool":
        return bool(("false", "true", "0", "1").index(bare.lower()) % 2)
    return float(bare) if kind.startswith("float") else int(bare)
