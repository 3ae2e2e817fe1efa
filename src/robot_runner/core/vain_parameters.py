"""Parameters that a config sets on a plugin after it was built: refused, as most plugins never read them again."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import lru_cache
from types import FrameType

from robot_runner.core.errors import PluginError, nearest
from robot_runner.core.late_annotations import signature_of

#: The name of a config file's module.
CONFIG_MODULE = "robot_runner_config"

#: While the code of a config is executed: the combination of the run, or nothing before there is one.
_guarded: ContextVar[Iterable[str] | None] = ContextVar("guarded", default=None)


@contextmanager
def parameters_guarded(factors: Iterable[str] = ()) -> Iterator[None]:
    """Refuse parameters of plugins that the code of a config sets, in this thread; `factors` are for the fix."""
    token = _guarded.set(factors)
    try:
        yield
    finally:
        _guarded.reset(token)


def check_set(kind: type, name: str, value: object) -> None:
    """Check an attribute of a plugin that is being set; called by its `__setattr__`.

    Raises:
        PluginError: the code of a config sets a parameter.
    """
    combination = _guarded.get()
    if combination is not None and name in parameters_of(kind) and _is_set_from_outside(kind, name):
        raise _vain(kind.__name__, name, value, combination)


@lru_cache
def parameters_of(kind: type) -> frozenset[str]:
    """Return the names that can be given where a plugin is made; with `**keywords`, those of its parents as well."""
    names: set[str] = set()
    for each in kind.__mro__[:-1]:
        if "__init__" not in vars(each):
            continue
        own = signature_of(vars(each)["__init__"]).parameters.values()
        names |= {parameter.name for parameter in list(own)[1:] if parameter.kind not in _OPEN}
        if not any(parameter.kind is parameter.VAR_KEYWORD for parameter in own):
            break
    return frozenset(names)


_OPEN = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)


def _is_set_from_outside(kind: type, name: str) -> bool:
    """Return whether an attribute is set by other code than the plugin's own; False if in doubt."""
    if hasattr(getattr(kind, name, None), "__set__"):  # a property with a setter is meant to be set
        return False
    frame: FrameType | None = sys._getframe(3)  # noqa: SLF001 - who sets the attribute is told by nothing else
    packages = {each.__module__.partition(".")[0] for each in kind.__mro__} - {CONFIG_MODULE}
    if frame is not None and frame.f_globals.get("__name__", "").partition(".")[0] in packages:
        return False
    own_names, own_code = _own_code(kind)
    while frame is not None:
        if frame.f_code in own_code or frame.f_code.co_qualname.startswith(own_names):
            return False
        frame = frame.f_back
    return True


@lru_cache
def _own_code(kind: type) -> tuple[tuple[str, ...], frozenset[object]]:
    """Return the prefixes of the qualified names of a plugin's methods, and the code of methods with other names."""
    found = (getattr(value, "__func__", value) for each in kind.__mro__[:-1] for value in vars(each).values())
    code = frozenset(each.__code__ for each in found if hasattr(each, "__code__"))
    return tuple(f"{each.__qualname__}." for each in kind.__mro__[:-1]), code


def _vain(kind: str, name: str, value: object, factors: Iterable[str]) -> PluginError:
    known = list(factors)
    factor = nearest(name, known) or (known[0] if len(known) == 1 else name.capitalize())
    return PluginError(
        f"{name} is a parameter of {kind}: changing it has no effect once it is built",
        where=kind,
        fix=f"To vary it, bind it: {kind}({name}=treatment({factor!r})). "
        f"Otherwise give it where {kind} is made: {kind}({name}={value!r}).",
    )
