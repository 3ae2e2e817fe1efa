"""Treatments on their way into plugins: parameters that are bound to factors, and those that are set in vain."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NoReturn

from robot_runner.core.errors import PluginError, did_you_mean, nearest
from robot_runner.core.inactive import INACTIVE

if TYPE_CHECKING:
    from types import FrameType
    from typing import Self

__all__ = [
    "CONFIG_MODULE",
    "Bindable",
    "Treatment",
    "bind",
    "built_with",
    "factors_of",
    "give_again",
    "given_to",
    "is_waiting",
    "parameters_guarded",
    "treatment",
    "values_of",
]

#: What the module of a config file is called while it is executed.
CONFIG_MODULE = "robot_runner_config"

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
    """

    positional: tuple[Any, ...]
    keywords: Mapping[str, Any]
    factors: Mapping[str, str]

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
        for name, value in _named(kind, positional, keywords):
            factors |= {place: each.factor for place, each in _places(kind, name, value)}
        if "name" in factors:
            raise PluginError(
                f"the name of a plugin is the same in all runs, and is bound to the factor {factors['name']!r}",
                where=kind.__name__,
                fix="Give a name, or leave it out.",
            )
        return cls(positional, dict(keywords), factors)

    def arguments(self, combination: Mapping[str, Any]) -> tuple[list[Any], dict[str, Any]]:
        """Return what it is built with under a combination; what a factor does not apply to is left at its default."""
        bound = {name: value.factor for name, value in self.keywords.items() if isinstance(value, Treatment)}
        left = {name for name, factor in bound.items() if combination.get(factor) is INACTIVE}
        values = {name: _resolved(value, combination) for name, value in self.keywords.items() if name not in left}
        return [_resolved(value, combination) for value in self.positional], values


def _named(kind: type, positional: tuple[Any, ...], keywords: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    signature = inspect.signature(kind)
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
    return isinstance(value, Treatment) or (isinstance(value, Bindable) and bool(factors_of(value)))


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
    return type(value)(_resolved(each, combination) for each in value)


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
        combination = _guarded.get()
        kind: Any = type(self)
        if combination is not None and name in _parameters(kind) and _is_set_from_outside(kind, name):
            raise _vain(kind.__name__, name, value, combination)
        super().__setattr__(name, value)


@lru_cache
def _waiting_kind(kind: type) -> type:
    def wait(self: object, *_: object, **__: object) -> None:
        object.__setattr__(self, "__class__", kind)

    return type(kind)(kind.__name__, (kind,), {"__slots__": (), "__init__": wait, "__module__": kind.__module__})


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
        if name not in _parameters(kind):
            fix = did_you_mean(name, _parameters(kind))
            raise PluginError(f"it has no parameter {name!r}", where=kind.__name__, fix=fix)
        if name in factors:
            fix = "Leave it as it is, or vary it over other treatments."
            raise PluginError(f"{name} is bound to the factor {factors[name]!r}", where=kind.__name__, fix=fix)
    if not all(map(str.isidentifier, given)):
        fix = "Give it a parameter by name for each thing, or leave it as it is."
        raise PluginError("it takes any number of values, and cannot be made again", where=kind.__name__, fix=fix)
    made = kind(**{**given, **changed})
    vars(plugin).clear()
    vars(plugin).update(vars(made))


# A parameter that the code of a config sets on a plugin that was built: most plugins never look at it again.

#: While the code of a config is executed: the combination of the run, or nothing before there is one.
_guarded: ContextVar[Iterable[str] | None] = ContextVar("guarded", default=None)


@contextmanager
def parameters_guarded(factors: Iterable[str] = ()) -> Iterator[None]:
    """Have parameters of plugins refused that the code of a config sets, in this thread.

    Args:
        factors: the names among which the remedy looks for the one that is meant.
    """
    token = _guarded.set(factors)
    try:
        yield
    finally:
        _guarded.reset(token)


@lru_cache
def _parameters(kind: type) -> frozenset[str]:
    """Return the names that can be given where a plugin is made; with `**keywords`, those of its parents as well."""
    names: set[str] = set()
    for each in kind.__mro__[:-1]:
        if "__init__" not in vars(each):
            continue
        own = inspect.signature(vars(each)["__init__"]).parameters.values()
        names |= {parameter.name for parameter in list(own)[1:] if parameter.kind not in _OPEN}
        if not any(parameter.kind is parameter.VAR_KEYWORD for parameter in own):
            break
    return frozenset(names)


_OPEN = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)


def _is_set_from_outside(kind: type, name: str) -> bool:
    """Whether no code of the plugin's own sets an attribute at this moment; where in doubt, its own does."""
    if hasattr(getattr(kind, name, None), "__set__"):  # a property: its author provides for it
        return False
    frame: FrameType | None = sys._getframe(2)  # noqa: SLF001 - who sets the attribute is told by nothing else
    if frame is not None and _package(frame.f_globals.get("__name__", "")) in _packages(kind):
        return False
    own_names, own_code = _own_code(kind)
    while frame is not None:
        if frame.f_code in own_code or frame.f_code.co_qualname.startswith(own_names):
            return False
        frame = frame.f_back
    return True


def _package(module: str) -> str:
    return module.partition(".")[0]


def _packages(kind: type) -> set[str]:
    return {_package(each.__module__) for each in kind.__mro__} - {CONFIG_MODULE}


@lru_cache
def _own_code(kind: type) -> tuple[tuple[str, ...], frozenset[object]]:
    """Return how the names of a plugin's methods begin, and the code of those that were made without a name there."""
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
