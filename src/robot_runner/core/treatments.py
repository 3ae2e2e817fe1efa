"""Parameters of plugins: bound to factors (`treatment(...)`), and not to be set once a plugin is built."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import lru_cache
from types import FrameType
from typing import Any, NoReturn, Self

from robot_runner.core.errors import PluginError, did_you_mean, nearest
from robot_runner.core.late_annotations import OPEN_KINDS, parameters_of, signature_of
from robot_runner.core.words import INACTIVE

_BINDING = "_robot_runner_binding"
_WAITING = "_robot_runner_is_waiting"
_GIVEN = "_robot_runner_given"


class Treatment:
    """A placeholder for the treatment of the `factor` of this name, as the parameter of a plugin."""

    __slots__ = ("factor",)

    def __init__(self, factor: str) -> None:
        if not isinstance(factor, str) or not factor:
            fix = "Name a factor of the run table: treatment('Speed')."
            raise PluginError(f"{factor!r} names no factor", where="treatment", fix=fix)
        self.factor = factor

    def __repr__(self) -> str:
        return f"treatment({self.factor!r})"

    def _refuse(self) -> NoReturn:
        problem = f"{self!r} has no value before a run, so that nothing can be computed from it"
        fix = f"Make what you need the treatments of the factor {self.factor!r}, and give {self!r} alone."
        raise PluginError(problem, where="treatment", fix=fix)

    # By default these would return True, False and a name: a wrong value each.

    def __bool__(self) -> bool:  # noqa: PLE0304 - it has none
        self._refuse()

    def __eq__(self, other: object) -> bool:
        self._refuse()

    def __str__(self) -> str:  # noqa: PLE0307 - it has none
        self._refuse()

    __hash__ = object.__hash__


def treatment(factor: str) -> Any:
    """Bind a parameter of a plugin to a factor: in each run it has the run's treatment of that factor.

    Args:
        factor: the name of a factor of the run table.

    Raises:
        PluginError: `factor` is not a name.

    Example:
        >>> from robot_runner.plugins.systems import BasicTurtlebot3
        >>> BasicTurtlebot3(speed=treatment("Speed"))
        BasicTurtlebot3(...)
    """
    return Treatment(factor)


# A plugin with bound parameters is built when the run table is known, and again for each run.


@dataclass(frozen=True, slots=True)
class _Binding:
    """The arguments of a plugin with bound parameters.

    Attributes:
        factors: the factor of each bound parameter, by the parameter's name, with the place inside a list, a tuple or a
            mapping, such as `command[1]` or `arguments['speed']`, or in a contained plugin, such as `systems[0].speed`.
        name: the given name of the plugin, which cannot be bound; None where there is none.
    """

    positional: tuple[Any, ...]
    keywords: Mapping[str, Any]
    factors: Mapping[str, str]
    name: Any

    @classmethod
    def of(cls, kind: type, positional: tuple[Any, ...], keywords: Mapping[str, Any]) -> Self | None:
        """Return the binding of a plugin with these arguments, or None where nothing is bound.

        Raises:
            PluginError: a treatment is in a set, is a key, or is the name.
            TypeError: the plugin has no such parameters.
        """
        if not any(map(_holds_treatment, (*positional, *keywords.values()))):
            return None
        factors: dict[str, str] = {}
        named = dict(_named(kind, positional, keywords))
        for name, value in named.items():
            factors |= {place: each.factor for place, each in _places(kind, name, value)}
        if "name" in factors:
            problem = f"the name of a plugin is the same in all runs, and is bound to the factor {factors['name']!r}"
            raise PluginError(problem, where=kind.__name__, fix="Give a name, or leave it out.")
        return cls(positional, dict(keywords), factors, named.get("name"))

    def arguments(self, combination: Mapping[str, Any]) -> tuple[list[Any], dict[str, Any]]:
        """Return the arguments for a combination; where a factor does not apply, the parameter keeps its default."""
        bound = {name: value.factor for name, value in self.keywords.items() if isinstance(value, Treatment)}
        left = {name for name, factor in bound.items() if combination.get(factor) is INACTIVE}
        values = {name: _resolved(value, combination) for name, value in self.keywords.items() if name not in left}
        return [_resolved(value, combination) for value in self.positional], values


def _named(kind: type, positional: tuple[Any, ...], keywords: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    signature = signature_of(kind)
    try:
        given = signature.bind(*positional, **keywords).arguments
    except TypeError as error:
        raise TypeError(f"{kind.__name__}(): {error}") from None
    for name, value in given.items():
        match signature.parameters[name].kind:
            case inspect.Parameter.VAR_KEYWORD:
                yield from value.items()
            case inspect.Parameter.VAR_POSITIONAL:
                yield from ((f"{name}[{place}]", each) for place, each in enumerate(value))
            case _:
                yield name, value


def _holds_treatment(value: object) -> bool:
    if isinstance(value, Mapping):
        return any(map(_holds_treatment, (*value, *value.values())))
    if isinstance(value, list | tuple | set | frozenset):
        return any(map(_holds_treatment, value))
    return isinstance(value, Treatment) or is_waiting(value)  # the latter is a contained plugin


def _places(kind: type, name: str, value: object) -> Iterator[tuple[str, Treatment]]:
    """Yield the places of treatments in a parameter.

    Raises:
        PluginError: one is in a set, which has no places, or is a key.
    """
    if isinstance(value, Treatment):
        yield name, value
    elif isinstance(value, Bindable):  # a contained plugin
        yield from ((f"{name}.{place}", Treatment(factor)) for place, factor in factors_of(value).items())
    elif isinstance(value, list | tuple):
        for place, each in enumerate(value):
            yield from _places(kind, f"{name}[{place}]", each)
    elif isinstance(value, Mapping) and not any(map(_holds_treatment, value)):
        for key, each in value.items():
            yield from _places(kind, f"{name}[{key!r}]", each)
    elif _holds_treatment(value):
        where = "for a key" if isinstance(value, Mapping) else f"inside a {type(value).__name__}"
        fix = f"Bind {name} as a whole: the treatments of its factor may be of any type."
        raise PluginError(f"{name} holds a treatment(...) {where}", where=kind.__name__, fix=fix)


def _resolved(value: Any, combination: Mapping[str, Any]) -> Any:
    if isinstance(value, Treatment):
        return _treatment_of(value, combination)
    if not _holds_treatment(value):
        return value
    if isinstance(value, Bindable):
        return built_with(value, combination)
    if isinstance(value, Mapping):
        return {key: _resolved(each, combination) for key, each in value.items()}
    make = getattr(value, "_make", type(value))  # a named tuple cannot be called with a list
    return make(_resolved(each, combination) for each in value)


def _treatment_of(bound: Treatment, combination: Mapping[str, Any]) -> Any:
    if bound.factor not in combination:
        fix = did_you_mean(bound.factor, combination) or "Give the run a treatment of it."
        raise PluginError(f"the run has no treatment of the factor {bound.factor!r}", where=repr(bound), fix=fix)
    if combination[bound.factor] is INACTIVE:
        fix = f"Bind a parameter by its name, which has a default: Camera(resolution={bound!r})."
        raise PluginError(f"the factor {bound.factor!r} does not apply to the run", where=repr(bound), fix=fix)
    return combination[bound.factor]


class Bindable:
    """The base of plugins: built once treatments are known, and guarded against changes without effect.

    Not by a metaclass, as a plugin may have another one: `__new__` makes a waiting plugin an instance of a subclass for
    a moment, whose `__init__` executes nothing.
    """

    def __new__(cls, *positional: Any, **keywords: Any) -> Self:
        """Make an instance, which waits to be built if one of the arguments is `treatment(...)`.

        Raises:
            PluginError: a treatment is in a set, is a key, or is the name.
            TypeError: the plugin has no such parameter.
        """
        make: Any = super().__new__
        made: Self = make(cls) if make is object.__new__ else make(cls, *positional, **keywords)
        binding = _Binding.of(cls, positional, keywords)
        vars(made)[_GIVEN] = (positional, keywords)
        if binding is not None:
            vars(made).update({_BINDING: binding, _WAITING: True})
            object.__setattr__(made, "__class__", _waiting_kind(cls))  # type: ignore[arg-type] # classes can be hashed
        return made

    def __setattr__(self, name: str, value: object) -> None:
        """Set an attribute; in a config, a parameter is not set once the plugin is built.

        Raises:
            PluginError: the code of a config sets a parameter.
        """
        kind: Any = type(self)
        _check_set(kind, name, value)
        super().__setattr__(name, value)


@lru_cache
def _waiting_kind(kind: type) -> type:
    def wait(self: object, *_: object, **__: object) -> None:
        object.__setattr__(self, "__class__", kind)

    return type(kind)(kind.__name__, (kind,), {"__slots__": (), "__init__": wait, "__module__": kind.__module__})


def given_name(plugin: Bindable) -> str:
    """Return the name of a plugin, also before it is built."""
    binding: _Binding | None = vars(plugin).get(_BINDING)
    given = getattr(plugin, "name", None) if binding is None else binding.name
    return given if isinstance(given, str) else type(plugin).__name__


def is_waiting(plugin: object) -> bool:
    """Return whether this is a plugin with bound parameters that was not built yet, and so has no attributes."""
    return isinstance(plugin, Bindable) and _WAITING in vars(plugin)


def factors_of(plugin: Bindable) -> Mapping[str, str]:
    """Return the factor of each bound parameter of a plugin, by the parameter's name."""
    binding: _Binding | None = vars(plugin).get(_BINDING)
    return binding.factors if binding is not None else {}


def values_of(plugin: Bindable, combination: Mapping[str, Any]) -> dict[str, Any]:
    """Return the value of each bound parameter of a plugin for a combination, by the parameter's name."""
    return {name: combination[factor] for name, factor in factors_of(plugin).items()}


def bind(plugin: Bindable, combination: Mapping[str, Any]) -> None:
    """Build a plugin again, in place, with the treatments of a combination; nothing is done without bound parameters.

    Whatever its `__init__` raises is raised.
    """
    binding: _Binding | None = vars(plugin).get(_BINDING)
    if binding is not None:
        positional, keywords = binding.arguments(combination)
        type(plugin).__init__(plugin, *positional, **keywords)
        vars(plugin)[_BINDING] = binding  # an `__init__` may clear all attributes
        vars(plugin).pop(_WAITING, None)


def built_with(plugin: Any, combination: Mapping[str, Any]) -> Any:
    """Return a copy of a plugin built for a combination; without bound parameters, the plugin itself."""
    binding: _Binding | None = vars(plugin).get(_BINDING)
    if binding is None:
        return plugin
    positional, keywords = binding.arguments(combination)
    built = type(plugin)(*positional, **keywords)
    vars(built)[_BINDING] = binding
    return built


def given_to(plugin: Bindable) -> dict[str, Any]:
    """Return the arguments of a plugin, by the parameter's name, without defaults."""
    positional, keywords = vars(plugin).get(_GIVEN, ((), {}))
    return dict(_named(type(plugin), positional, keywords))


def give_again(plugin: Bindable, changed: Mapping[str, Any]) -> None:
    """Build a plugin again, in place, with some parameters changed; one that waits for treatments still waits.

    Raises:
        PluginError: it has no such parameter, or the parameter is bound to a factor.
    """
    kind: Any = type(plugin)
    given, factors = given_to(plugin), factors_of(plugin)
    for name in changed:
        if name not in _given_by_name(kind):
            fix = did_you_mean(name, _given_by_name(kind))
            raise PluginError(f"the plugin has no parameter {name!r}", where=kind.__name__, fix=fix)
        if name in factors:
            fix = "Leave it as it is, or vary it over other treatments."
            raise PluginError(f"{name} is bound to the factor {factors[name]!r}", where=kind.__name__, fix=fix)
    if not all(map(str.isidentifier, given)):
        fix = "Give it a parameter by name for each thing, or leave it as it is."
        problem = "the plugin takes any number of values, and cannot be built again"
        raise PluginError(problem, where=kind.__name__, fix=fix)
    made = kind(**{**given, **changed})
    vars(plugin).clear()
    vars(plugin).update(vars(made))


# Parameters that the code of a config sets after the plugin was built: most plugins never read them again.

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


def _check_set(kind: type, name: str, value: object) -> None:
    """Check an attribute of a plugin that is being set; called by its `__setattr__`.

    Raises:
        PluginError: the code of a config sets a parameter.
    """
    combination = _guarded.get()
    if combination is not None and name in _given_by_name(kind) and _is_set_from_outside(kind, name):
        raise _vain(kind.__name__, name, value, combination)


@lru_cache
def _given_by_name(kind: type) -> frozenset[str]:
    """Return the names of the parameters that can be given by name where a plugin is made."""
    return frozenset(name for name, each in parameters_of(kind).items() if each.kind not in OPEN_KINDS)


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
