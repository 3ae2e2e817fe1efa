"""Doors: packages with a promised interface, which import each name from its module when it is first used.

So `import robot_runner` and `robot-runner --help` stay cheap. A door declares each name once, as an import that type
checkers and editors see and Python does not execute:

```python
TYPE_CHECKING = False
if TYPE_CHECKING:
    from robot_runner.core.errors import Finding as Finding
else:
    __getattr__, __dir__ = open_door(__name__)
```
"""

from __future__ import annotations

import sys
from importlib import import_module

TYPE_CHECKING = False  # `typing` takes longer to import than all of this
if TYPE_CHECKING:
    from collections.abc import Callable


_ONLY_AST = 0x400  # ast.PyCF_ONLY_AST; the module `ast` is slow to import


def open_door(
    door: str, prepare: Callable[[], None] = lambda: None
) -> tuple[Callable[[str], object], Callable[[], list[str]]]:
    """Return `__getattr__` and `__dir__` for a package.

    `prepare` is called before a name is imported, and may raise an ImportError that says what is missing.
    """
    homes: dict[str, str] = {}

    def promised() -> dict[str, str]:
        if not homes:
            homes.update(_declared_in(door))
        return homes

    def import_name(name: str) -> object:
        if name == "__all__":  # asked for by `from ... import *`
            return list_names()
        if name not in promised():
            raise AttributeError(f"module {door!r} has no attribute {name!r}", name=name, obj=sys.modules[door])
        prepare()
        found: object = getattr(import_module(homes[name]), name)
        setattr(sys.modules[door], name, found)
        return found

    def list_names() -> list[str]:
        return sorted(promised(), key=lambda name: (name.islower(), name))

    return import_name, list_names


def _declared_in(door: str) -> dict[str, str]:
    """Return the module of each name that the block under TYPE_CHECKING in a package's source imports `as` itself."""
    spec = sys.modules[door].__spec__
    source = spec.loader.get_source(door) if spec else None  # type: ignore[union-attr]
    tree = compile(source or "", door, "exec", _ONLY_AST, dont_inherit=True)
    blocks = [node for node in tree.body if type(node).__name__ == "If" and node.test.id == "TYPE_CHECKING"]
    return {
        alias.name: node.module
        for block in blocks
        for node in block.body
        for alias in node.names
        if alias.asname == alias.name
    }
