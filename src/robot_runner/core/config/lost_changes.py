"""What a run's callbacks store in a config or a plugin, and callbacks of the orchestrator read: it never gets there."""

from __future__ import annotations

import ast
import inspect
from collections import defaultdict
from typing import TYPE_CHECKING, Any

from robot_runner.core.config.parameters import RunProcess
from robot_runner.core.config.source import tree_of
from robot_runner.core.errors import Finding
from robot_runner.core.events.manager import ORCHESTRATED_EVENTS, RUN_EVENTS, RobotRunnerEvents
from robot_runner.core.events.measure import CONFIG_OWNER
from robot_runner.core.words import listed

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from robot_runner.core.config.loader import LoadedConfig
    from robot_runner.core.config.parameters import Parameters
    from robot_runner.core.events.manager import EventManager, Subscriber

#: Methods of lists, dicts and sets that change them.
_CHANGING = {"add", "append", "clear", "discard", "extend", "insert", "pop", "remove", "setdefault", "update"}
#: What comes before the first run reads nothing of one.
_LATER = tuple(each for each in ORCHESTRATED_EVENTS if each is not RobotRunnerEvents.BEFORE_EXPERIMENT)
_FIX = (
    "Return it from populate_run_data, or write it into context.run_folder and read it there; "
    "run_process = RunProcess.IN_PROCESS executes runs in the orchestrator's process."
)

_Methods = dict[tuple[str, int], ast.FunctionDef]


def check_lost_changes(loaded: LoadedConfig, parameters: Parameters, events: EventManager) -> list[Finding]:
    """Warn of each attribute that callbacks of runs change and that later ones, in another process, read."""
    if parameters.run_process is RunProcess.IN_PROCESS:
        return []
    methods = _methods_in((loaded.source.path, *loaded.local_modules))
    changed: dict[str, dict[str, None]] = defaultdict(dict)
    for event in RUN_EVENTS:
        for each in events.subscribers(event):
            changed[each.owner] |= dict.fromkeys(_named(each, methods, _changed))
    findings = []
    for event in _LATER:
        for each in events.subscribers(event):
            read = set(_named(each, methods, _read))
            if lost := [f"self.{name}" for name in changed[each.owner] if name in read]:
                where = loaded.where if each.owner == CONFIG_OWNER else f"plugin {each.owner}"
                problem = (
                    f"{event.callback_name} reads {listed(lost)}, which runs change: "
                    "each run has a process of its own, and what it stores is gone with it"
                )
                findings.append(Finding.warning(where, problem, _FIX))
    return findings


def _methods_in(paths: tuple[Path, ...]) -> _Methods:
    """Return the functions of files by file and first line, decorators included, as their code objects have them."""
    return {
        (str(path), min([node.lineno, *(each.lineno for each in node.decorator_list)])): node
        for path in paths
        for node in ast.walk(tree_of(path))
        if isinstance(node, ast.FunctionDef)
    }


def _named(subscriber: Subscriber, methods: _Methods, kind: Any) -> Iterator[str]:
    """Yield the attributes that a callback, or a method that it calls by `self`, changes or reads."""
    owner = getattr(subscriber.callback, "__self__", None)
    unread, seen = [subscriber.callback], set()
    while owner is not None and unread:
        code = getattr(inspect.unwrap(unread.pop()), "__code__", None)
        node = None if code is None else methods.get((code.co_filename, code.co_firstlineno))
        if node is None or code in seen or not (node.args.posonlyargs or node.args.args):
            continue
        seen.add(code)
        own = (node.args.posonlyargs or node.args.args)[0].arg
        for each in ast.walk(node):
            yield from kind(each, own)
            if isinstance(each, ast.Call) and (name := _attribute(each.func, own)):
                unread.append(inspect.getattr_static(type(owner), name, None))


def _attribute(node: ast.AST, own: str) -> str | None:
    """Return the name of an attribute of the object itself."""
    match node:
        case ast.Attribute(value=ast.Name(id=name), attr=attribute) if name == own:
            return attribute
        case _:
            return None


def _changed(node: ast.AST, own: str) -> Iterator[str]:
    match node:
        case ast.Attribute(ctx=ast.Store() | ast.Del()):
            changed = node
        case ast.Subscript(value=changed, ctx=ast.Store() | ast.Del()):
            pass
        case ast.Call(func=ast.Attribute(value=changed, attr=called)) if called in _CHANGING:
            pass
        case _:
            return
    if name := _attribute(changed, own):
        yield name


def _read(node: ast.AST, own: str) -> Iterator[str]:
    if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Load) and (name := _attribute(node, own)):
        yield name
