"""Treatments on their way into plugins: parameters that are bound to factors."""

from __future__ import annotations

import inspect
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NoReturn, Self

from robot_runner.core.errors import PluginError, did_you_mean
from robot_runner.core.late_annotations import signature_of
from robot_runner.core.vain_parameters import check_set, parameters_of
from robot_runner.core.words import INACTIVE

_BINDING = "_robot_runner_binding"
_WAITING = "_robot_runner_is_waiting"
_GIVEN = "_robot_runner_given"


class Treatment:
    """Stands for the treatment that a factor has in each run, where a plugin is given a parameter.

    Attributes:
        factor: the name of the factor.
    """

    __slots__ = ("factor",)

    def __init__(self, factor: str) -> None:
        if not isinstance(factor, str) or not factor:
            fix = "Name a factor of the run table: treatment('Speed')."
            raise PluginError(f"{factor!r} names no factor", where="treatment", fix=fix)
        self.factor = factor

    def __repr__(self) -> str:
        return f"treatment({self.factor!r})"

    def _refuse(self) -> NoReturn:
        raise PluginError(
            f"{self!r} has no value before a run, so that nothing can be computed from it",
            where="treatment",
            fix=f"Make what you need the treatments of the factor {self.factor!r}, and give {self!r} alone.",
        )

    # Python would take it for true, for unequal to everything, and for its own name in a text: each a wrong value.

    def __bool__(self) -> bool:  # noqa: PLE0304 - it has none
        self._refuse()

    def __eq__(self, other: object) -> bool:
        self._refuse()

    def __str__(self) -> str:  # noqa: PLE0307 - it has none
        self._refuse()

    __hash__ = object.__hash__


def treatment(factor: str) -> Any:
    """Bind a parameter of a plugin to a factor: in each run it has the treatment that the factor has there.

    Args:
        factor: the name of a factor of the run table.

    Raises:
        PluginError: this is no name.

    Example:
        >>> from robot_runner.plugins.systems import BasicTurtlebot3
        >>> BasicTurtlebot3(speed=treatment("Speed"))  # doctest: +ELLIPSIS
        <...BasicTurtlebot3 object at ...>
    """
    return Treatment(factor)


# A plugin that has bound parameters is built when the run table is known, and again for each run.


@dataclass(frozen=True, slots=True)
class _Binding:
    """What a plugin was given.

    Attributes:
        factors: the factor of each bound parameter, by the parameter's name; of one inside a list, a tuple or a mapping
            by its place there as well, such as `command[1]` or `arguments['speed']`; of one of a plugin that it is made
            of, such as `systems[0].speed`.
        name: that the plugin is given, which no treatment changes; None where it is given none.
    """

    positional: tuple[Any, ...]
    keywords: Mapping[str, Any]
    factors: Mapping[str, str]
    name: Any

    @classmethod
    def of(cls, kind: type, positional: tuple[Any, ...], keywords: Mapping[str, Any]) -> Self | None:
        """Return what binds a plugin of this kind to factors, or None where nothing does.

        Raises:
            PluginError: a treatment stands in a set, for a key, or for the name.
            TypeError: the plugin has no such parameters.
        """
        given = (*positional, *keywords.values())
        if not any(map(_holds_treatment, given)):
            return None
        factors: dict[str, str] = {}
        named = dict(_named(kind, positional, keywords))
        for name, value in named.items():
            factors |= {place: each.factor for place, each in _places(kind, name, value)}
        if "name" in factors:
            raise PluginError(
                f"the name of a plugin is the same in all runs, and is bound to the factor {factors['name']!r}",
                where=kind.__name__,
                fix="Give a name, or leave it out.",
            )
        return cls(positional, dict(keywords), factors, named.get("name"))

    def arguments(self, combination: Mapping[str, Any]) -> tuple[list[Any], dict[str, Any]]:
        """Return what it is built with under a combination; what a factor does not apply to is left at its default."""
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
    return isinstance(value, Treatment) or is_waiting(value)  # of a plugin that another one is made of


def _places(kind: type, name: str, value: object) -> Iterator[tuple[str, Treatment]]:
    """Yield where treatments stand in a parameter.

    Raises:
        PluginError: one stands in a set, which has no places, or for a key.
    """
    if isinstance(value, Treatment):
        yield name, value
    elif isinstance(value, Bindable):  # a plugin that another one is made of
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
    make = getattr(value, "_make", type(value))  # the class of a named tuple takes its fields one by one
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
    """What plugins have of `treatment(...)`: built when treatments are known, and guarded against vain changes.

    No metaclass does it, as a plugin may have another one: `__new__` makes what waits an instance of a subclass for
    a moment, whose `__init__` keeps the arguments and executes nothing.
    """

    def __new__(cls, *positional: Any, **keywords: Any) -> Self:
        """Make an instance, and have it wait where one of the arguments is `treatment(...)`.

        Raises:
            PluginError: a treatment stands in a set, for a key, or for the name.
            TypeError: something is bound that is no parameter.
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
        check_set(kind, name, value)
        super().__setattr__(name, value)


@lru_cache
def _waiting_kind(kind: type) -> type:
    def wait(self: object, *_: object, **__: object) -> None:
        object.__setattr__(self, "__class__", kind)

    return type(kind)(kind.__name__, (kind,), {"__slots__": (), "__init__": wait, "__module__": kind.__module__})


def given_name(plugin: Bindable) -> str:
    """Return what a plugin is called, also where it was not built yet."""
    binding: _Binding | None = vars(plugin).get(_BINDING)
    given = getattr(plugin, "name", None) if binding is None else binding.name
    return given if isinstance(given, str) else type(plugin).__name__


def is_waiting(plugin: object) -> bool:
    """Whether this is a plugin that has bound parameters and was not built yet: it has no attributes of its own."""
    return isinstance(plugin, Bindable) and _WAITING in vars(plugin)


def factors_of(plugin: Bindable) -> Mapping[str, str]:
    """Return the factor of each bound parameter of a plugin, by the parameter's name."""
    binding: _Binding | None = vars(plugin).get(_BINDING)
    return binding.factors if binding is not None else {}


def values_of(plugin: Bindable, combination: Mapping[str, Any]) -> dict[str, Any]:
    """Return the value of each bound parameter of a plugin under a combination, by the parameter's name."""
    return {name: combination[factor] for name, factor in factors_of(plugin).items()}


def bind(plugin: Bindable, combination: Mapping[str, Any]) -> None:
    """Build a plugin again, in its place, with the treatments of a combination; one without bound parameters stays.

    Whatever its `__init__` raises is raised.
    """
    binding: _Binding | None = vars(plugin).get(_BINDING)
    if binding is not None:
        positional, keywords = binding.arguments(combination)
        type(plugin).__init__(plugin, *positional, **keywords)
        vars(plugin)[_BINDING] = binding  # some clear everything that they had
        vars(plugin).pop(_WAITING, None)


def built_with(plugin: Any, combination: Mapping[str, Any]) -> Any:
    """Return another plugin as this one is under a combination; one without bound parameters is returned itself."""
    binding: _Binding | None = vars(plugin).get(_BINDING)
    if binding is None:
        return plugin
    positional, keywords = binding.arguments(combination)
    built = type(plugin)(*positional, **keywords)
    vars(built)[_BINDING] = binding
    return built


def given_to(plugin: Bindable) -> dict[str, Any]:
    """Return what a plugin was made with, by the parameter's name; what was left out is not among it."""
    positional, keywords = vars(plugin).get(_GIVEN, ((), {}))
    return dict(_named(type(plugin), positional, keywords))


def give_again(plugin: Bindable, changed: Mapping[str, Any]) -> None:
    """Make a plugin again, in its place, with some parameters changed; one that waits for treatments goes on waiting.

    Raises:
        PluginError: it has no such parameter, or one that was to be changed is bound to a factor.
    """
    kind: Any = type(plugin)
    given, factors = given_to(plugin), factors_of(plugin)
    for name in changed:
        if name not in parameters_of(kind):
            fix = did_you_mean(name, parameters_of(kind))
            raise PluginError(f"the plugin has no parameter {name!r}", where=kind.__name__, fix=fix)
        if name in factors:
            fix = "Leave it as it is, or vary it over other treatments."
            raise PluginError(f"{name} is bound to the factor {factors[name]!r}", where=kind.__name__, fix=fix)
    if not all(map(str.isidentifier, given)):
        fix = "Give it a parameter by name for each thing, or leave it as it is."
        raise PluginError(
            "the plugin takes any number of values, and cannot be built again", where=kind.__name__, fix=fix
        )
    made = kind(**{**given, **changed})
    vars(plugin).clear()
    vars(plugin).update(vars(made))
