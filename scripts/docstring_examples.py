"""What the documentation's reader of source has to be told: our `Example:` sections, and the names behind a door."""

from __future__ import annotations

import re
from typing import Any

import griffe

__all__ = ["DoorNames", "ExampleSections"]


class ExampleSections(griffe.Extension):
    """Rename the section while modules are read."""

    def on_object(self, *, obj: griffe.Object, **kwargs: Any) -> None:
        """Rename it in the docstring of one module, class or function."""
        del kwargs
        if obj.docstring is not None:
            obj.docstring.value = re.sub(r"^Example:$", "Examples:", obj.docstring.value, flags=re.MULTILINE)


class DoorNames(griffe.Extension):
    """Take what a door imports `as` itself for what it promises; `__all__` is made when it is asked for."""

    def on_module_members(self, *, mod: griffe.Module, **kwargs: Any) -> None:
        """Look whether a module is a door, and note its names."""
        del kwargs
        if "open_door" in mod.members:
            mod.exports = [name for name, member in mod.members.items() if member.is_alias and not member.runtime]
