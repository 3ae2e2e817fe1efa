"""Generators of random numbers that are made once and that runs draw from: each run would draw the same numbers.

A forked run inherits them as they are, and what it draws is gone with it. Those that `random` and `numpy.random` have
for all are given a state of each run's own (`core/execution/random_states.py`).
"""

from __future__ import annotations

import inspect
from typing import TYPE_CHECKING, Any

from robot_runner.core.config.parameters import RunProcess
from robot_runner.core.errors import Finding
from robot_runner.core.events.manager import RUN_EVENTS
from robot_runner.core.events.measure import CONFIG_OWNER
from robot_runner.core.words import listed

if TYPE_CHECKING:
    from collections.abc import Iterator
    from types import CodeType

    from robot_runner.core.config.loader import LoadedConfig
    from robot_runner.core.config.parameters import Parameters
    from robot_runner.core.events.manager import EventManager

#: By module and class: `random.SystemRandom` draws from the system, and has no state.
_GENERATORS = {
    ("random", "Random"),
    ("numpy.random._generator", "Generator"),
    ("numpy.random.mtrand", "RandomState"),
    ("torch._C", "Generator"),
}
_FIX = (
    "Make it in start_run, with the seed of each run: numpy.random.default_rng(context.run_seed), or "
    "random.Random(context.run_seed). The functions of random and of numpy.random are seeded so already."
)


def check_generators(loaded: LoadedConfig, parameters: Parameters, events: EventManager) -> list[Finding]:
    """Warn of each generator of a config or plugin that its callbacks draw from in forked runs."""
    if parameters.run_process is not RunProcess.FORK:
        return []
    local = {str(each) for each in (loaded.source.path, *loaded.local_modules)}
    found: dict[str, dict[str, None]] = {}
    for event in RUN_EVENTS:
        for each in events.subscribers(event):
            names = dict.fromkeys(_drawn_from(each.callback, local))
            if names:
                found.setdefault(each.owner, {}).update(names)
    return [
        Finding.warning(
            loaded.where if owner == CONFIG_OWNER else f"plugin {owner}",
            f"each run begins with the same state of {listed(names)}, and draws the same random numbers",
            _FIX,
        )
        for owner, names in found.items()
    ]


def _drawn_from(callback: Any, local: set[str]) -> Iterator[str]:
    """Yield the names of generators in the code of a callback, and of the functions and methods that it calls here."""
    owner = getattr(callback, "__self__", None)
    unread, seen = [callback], set()
    while unread:
        function = inspect.unwrap(unread.pop())
        code: CodeType | None = getattr(function, "__code__", None)
        if code is None or code in seen or code.co_filename not in local:
            continue
        seen.add(code)
        for name in _names_in(code):
            for value, shown in ((function.__globals__.get(name), name), (_attribute(owner, name), f"self.{name}")):
                if (type(value).__module__, type(value).__name__) in _GENERATORS:
                    yield shown
                elif inspect.isfunction(value):
                    unread.append(value)


def _attribute(owner: Any, name: str) -> Any:
    """Return an attribute as it is kept; nothing is executed for it."""
    return inspect.getattr_static(owner, name, None) if owner is not None else None


def _names_in(code: CodeType) -> Iterator[str]:
    yield from code.co_names
    for each in code.co_consts:  # functions within functions, and lambdas
        if inspect.iscode(each):
            yield from _names_in(each)
