"""Checks of the code of callbacks: mistakes because a run has its own process and, if simulated, its own clock.

The code of the config, and of modules that are not installed, is read; nothing of it is executed.
"""

from __future__ import annotations

import ast
import inspect
import time
from collections.abc import Iterator, Mapping
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

from robot_runner.core.config.loader import LoadedConfig
from robot_runner.core.config.parameters import BadValuePolicy, Parameters, RunProcess
from robot_runner.core.config.source import tree_of
from robot_runner.core.errors import Finding
from robot_runner.core.events.manager import (
    ORCHESTRATED_EVENTS,
    RUN_EVENTS,
    EventManager,
    RobotRunnerEvents,
    Subscriber,
)
from robot_runner.core.events.measure import CONFIG_OWNER
from robot_runner.core.links.commanded_topics import VELOCITIES
from robot_runner.core.links.connect import is_simulated
from robot_runner.core.words import listed


def check_callbacks(loaded: LoadedConfig, parameters: Parameters, events: EventManager) -> list[Finding]:
    """Return a warning for each such mistake in callbacks of the config and of plugins beside it."""
    code = _LocalCode(loaded)
    found: dict[tuple[str, str, str], None] = dict.fromkeys(_replaced_files(code, events))
    if parameters.run_process is not RunProcess.IN_PROCESS:
        found |= dict.fromkeys(_lost_changes(code, events))
    if parameters.run_process is RunProcess.SPAWN or parameters.cluster is not None:
        found |= dict.fromkeys(_unseen_changes(code, events))
    if parameters.run_process is RunProcess.FORK:
        found |= dict.fromkeys(_shared_generators(code, events))
    if parameters.on_bad_value is not BadValuePolicy.KEEP:
        found |= dict.fromkeys(_measured_too_late(code, events))
    if is_simulated(parameters.robot):
        found |= dict.fromkeys(_sleeping_missions(code, events))
    elif parameters.run_process is not RunProcess.IN_PROCESS:
        found |= dict.fromkeys(_drives_without_standby(code, events))
    return [
        Finding.warning(loaded.where if owner == CONFIG_OWNER else f"plugin {owner}", problem, fix)
        for owner, problem, fix in found
    ]


class _CalledCode(NamedTuple):
    """A function that a callback calls, or the callback itself.

    Attributes:
        nodes: all nodes of its syntax tree.
        outside: the global names of its module.
        owner: the object whose method the callback is; None for a function.
        own: the name of that object in the function, such as `self`.
    """

    nodes: tuple[ast.AST, ...]
    outside: Mapping[str, Any]
    owner: Any
    own: str

    def named(self, node: ast.AST) -> Any:
        """Return the object that a node names in its module or in its owner; None for anything else."""
        if isinstance(node, ast.Name):
            return self.outside.get(node.id)
        name = self.attribute(node)
        return None if name is None or self.owner is None else inspect.getattr_static(self.owner, name, None)

    def attribute(self, node: ast.AST) -> str | None:
        """Return the name of the attribute of its owner that a node is, as in `self.name`; None for anything else."""
        match node:
            case ast.Attribute(value=ast.Name(id=own), attr=name) if own == self.own:
                return name
            case _:
                return None


class _LocalCode:
    """The functions of a config file and of the modules that it imports and that are not installed."""

    def __init__(self, loaded: LoadedConfig) -> None:
        trees = {path: tuple(ast.walk(tree_of(path))) for path in (loaded.source.path, *loaded.local_modules)}
        # By file and first line, which is that of the first decorator, as in code objects.
        self._functions = {
            (str(path), min([node.lineno, *(each.lineno for each in node.decorator_list)])): node
            for path, nodes in trees.items()
            for node in nodes
            if isinstance(node, ast.FunctionDef)
        }
        self.containers = frozenset(chain.from_iterable(map(_containers_in, chain.from_iterable(trees.values()))))

    def called_by(self, subscriber: Subscriber) -> Iterator[_CalledCode]:
        """Yield the code of a callback and of the functions and methods that it names."""
        owner = getattr(subscriber.callback, "__self__", None)
        unread, seen = [subscriber.callback], set()
        while unread:
            function = inspect.unwrap(unread.pop())
            code = getattr(function, "__code__", None)
            node = None if code is None else self._functions.get((code.co_filename, code.co_firstlineno))
            if node is None or code in seen:
                continue
            seen.add(code)
            arguments = [*node.args.posonlyargs, *node.args.args]
            own = arguments[0].arg if arguments and owner is not None else ""
            called = _CalledCode(tuple(ast.walk(node)), function.__globals__, owner, own)
            yield called
            unread += filter(inspect.isfunction, map(called.named, called.nodes))


# Values that a run stores in the config or a plugin, which never reach another process.

#: Methods of lists, dicts and sets that change them.
_CHANGING = {"add", "append", "clear", "discard", "extend", "insert", "pop", "remove", "setdefault", "update"}
#: The events of the orchestrator that may follow a run.
_LATER = tuple(each for each in ORCHESTRATED_EVENTS if each is not RobotRunnerEvents.BEFORE_EXPERIMENT)
_CONTAINERS = {"Counter", "OrderedDict", "defaultdict", "deque", "dict", "list", "set"}
_FIX_OF_CHANGE = (
    "Return it from populate_run_data, or write it into context.run_folder and read it there; "
    "run_process = RunProcess.IN_PROCESS executes runs in the orchestrator's process."
)


def _lost_changes(code: _LocalCode, events: EventManager) -> Iterator[tuple[str, str, str]]:
    changed: dict[str, dict[str, None]] = {}
    for each in events.subscribers(*RUN_EVENTS):
        changed.setdefault(each.owner, {}).update(dict.fromkeys(_changed_by(code.called_by(each), code.containers)))
    for each in events.subscribers(*_LATER):
        read = set(_read_by(code.called_by(each)))
        if lost := [f"self.{name}" for name in changed.get(each.owner, ()) if name in read]:
            problem = f"{each.event.callback_name} reads {listed(lost)}, which runs change: "
            problem += "each run has a process of its own, and what it stores is gone with it"
            yield each.owner, problem, _FIX_OF_CHANGE


def _unseen_changes(code: _LocalCode, events: EventManager) -> Iterator[tuple[str, str, str]]:
    of_runs = events.subscribers(*RUN_EVENTS)
    for each in events.subscribers(RobotRunnerEvents.BEFORE_EXPERIMENT, RobotRunnerEvents.BEFORE_RUN):
        own = [other for other in of_runs if other.owner == each.owner]
        read = set(chain.from_iterable(_read_by(code.called_by(other)) for other in own))
        read -= set(chain.from_iterable(_changed_by(code.called_by(other), code.containers) for other in own))
        changed = dict.fromkeys(_changed_by(code.called_by(each), code.containers))
        if unseen := [f"self.{name}" for name in changed if name in read]:
            problem = f"{each.event.callback_name} changes {listed(unseen)}, which runs read: "
            problem += "a run in a fresh interpreter (SPAWN), or on a worker of a cluster, sees nothing of it"
            yield each.owner, problem, "Pass it by context.share in before_run, or set it up in start_run."


def _containers_in(node: ast.AST) -> Iterator[str]:
    """Yield the variables and attributes to which a list, a dict or a set is assigned."""
    match node:
        case ast.Assign(targets=targets, value=value):
            pass
        case ast.AnnAssign(target=target, value=ast.expr() as value):
            targets = [target]
        case _:
            return
    match value:
        case ast.List() | ast.Dict() | ast.Set() | ast.ListComp() | ast.DictComp() | ast.SetComp():
            pass
        case ast.Call(func=ast.Name(id=made)) if made in _CONTAINERS:
            pass
        case _:
            return
    for each in targets:
        match each:
            case ast.Attribute(attr=name) | ast.Name(id=name):
                yield name
            case _:
                pass


def _changed_by(called_code: Iterator[_CalledCode], containers: frozenset[str]) -> Iterator[str]:
    for called in called_code:
        for node in called.nodes:
            match node:
                case ast.Attribute(ctx=ast.Store() | ast.Del()):
                    changed = node
                case ast.Subscript(value=ast.Attribute() as changed, ctx=ast.Store() | ast.Del()):
                    pass
                case ast.Call(func=ast.Attribute(value=ast.Attribute() as changed, attr=name)) if (
                    name in _CHANGING and changed.attr in containers
                ):
                    pass
                case _:
                    continue
            if attribute := called.attribute(changed):
                yield attribute


def _read_by(called_code: Iterator[_CalledCode]) -> Iterator[str]:
    for called in called_code:
        for node in called.nodes:
            attribute = called.attribute(node)
            if attribute is not None and isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Load):
                yield attribute


# Random generators that are made once: each forked run inherits the same state. The global ones of `random` and
# `numpy.random` are seeded for each run (core/execution/inherited_state.py).

#: By module and class: `random.SystemRandom` draws from the system, and has no state.
_GENERATORS = {
    ("random", "Random"),
    ("numpy.random._generator", "Generator"),
    ("numpy.random.mtrand", "RandomState"),
    ("torch._C", "Generator"),
}
_FIX_OF_GENERATOR = (
    "Make it in start_run, with the seed of each run: numpy.random.default_rng(context.run_seed), or "
    "random.Random(context.run_seed). The functions of random and of numpy.random are seeded so already."
)


def _shared_generators(code: _LocalCode, events: EventManager) -> Iterator[tuple[str, str, str]]:
    found: dict[str, dict[str, None]] = {}
    for each in events.subscribers(*RUN_EVENTS):
        for called in code.called_by(each):
            drawn = [node for node in called.nodes if _is_generator(called.named(node))]
            found.setdefault(each.owner, {}).update(dict.fromkeys(map(ast.unparse, drawn)))
    for owner, names in found.items():
        if names:
            problem = f"each run begins with the same state of {listed(names)}, and draws the same random numbers"
            yield owner, problem, _FIX_OF_GENERATOR


def _is_generator(value: Any) -> bool:
    return (type(value).__module__, type(value).__name__) in _GENERATORS


# Missions that wait by the clock of this machine: for the simulated robot no time passes then.

_FIX_OF_SLEEP = "Wait by context.clock.sleep(seconds): on a real robot it does what time.sleep does."


def _sleeping_missions(code: _LocalCode, events: EventManager) -> Iterator[tuple[str, str, str]]:
    problem = "launch_mission waits by time.sleep, in which no time goes by for the simulated robot: measures lack it"
    for each in events.subscribers(RobotRunnerEvents.LAUNCH_MISSION):
        if any(map(_sleeps, code.called_by(each))):
            yield each.owner, problem, _FIX_OF_SLEEP


def _sleeps(called: _CalledCode) -> bool:
    for node in called.nodes:
        match node:
            case ast.Name() if called.named(node) is time.sleep:
                return True
            case ast.Attribute(value=ast.Name() as module, attr="sleep") if called.named(module) is time:
                return True
            case _:
                pass
    return False


# Robots that are driven by the orchestrator, which has no standby: that waits for the death of a run.

_FIX_OF_DRIVE = "Drive in start_run or launch_mission: whatever is killed there, a process stands by to stop the robot."


def _drives_without_standby(code: _LocalCode, events: EventManager) -> Iterator[tuple[str, str, str]]:
    for each in events.subscribers(RobotRunnerEvents.BEFORE_RUN, RobotRunnerEvents.CONTINUE):
        if any(_commands_robot(node, called) for called in code.called_by(each) for node in called.nodes):
            problem = f"{each.event.callback_name} drives the robot in the orchestrator's process: "
            problem += "where that is killed meanwhile, nothing stops the robot"
            yield each.owner, problem, _FIX_OF_DRIVE


def _commands_robot(node: ast.AST, called: _CalledCode) -> bool:
    match node:
        case ast.Call(func=ast.Attribute(attr="publish"), args=[_, _, ast.Dict() as message]) if _is_zero(message):
            return False  # to stand still
        case ast.Call(func=ast.Attribute(attr="publish"), args=[_, message_type, *_]):
            name = message_type.value if isinstance(message_type, ast.Constant) else called.named(message_type)
            return isinstance(name, str) and name.replace("/msg/", "/") in VELOCITIES
        case ast.Call(func=ast.Attribute(attr="send_goal")):
            return True
        case _:
            return False


def _is_zero(message: ast.expr) -> bool:
    """Return whether all numbers of a message in the code are 0, or it has none."""
    match message:
        case ast.Dict(values=fields):
            return all(map(_is_zero, fields))
        case ast.Constant(value=int() | float() as number):
            return number == 0
        case _:
            return False


# Files that each run writes under the same name, so that the last run's replaces all others.

#: Functions and methods that overwrite a file that is their first argument.
_WRITING = {
    "imwrite", "savefig", "savetxt", "savez", "savez_compressed",
    "to_csv", "to_excel", "to_feather", "to_hdf", "to_json", "to_parquet", "to_pickle",
}  # fmt: skip
_WRITING_METHODS = {"write_bytes", "write_text"}
#: Folders of devices and of the system, where nothing is overwritten.
_NO_FILES = ("/dev/", "/proc/", "/sys/")
_FIX_OF_FILE = "Write into context.run_folder, which each run has for itself: what lies there is kept, and packed."


def _replaced_files(code: _LocalCode, events: EventManager) -> Iterator[tuple[str, str, str]]:
    for each in events.subscribers(*RUN_EVENTS):
        called_code = list(code.called_by(each))
        written = [name for called in called_code for node in called.nodes if (name := _written(node, called))]
        if any(map(_moves, called_code)):
            continue  # from then on, a name may mean another file in each run
        for name in written:
            problem = f"{each.event.callback_name} writes {name!r} again in each run: the last one replaces the others"
            yield each.owner, problem, _FIX_OF_FILE


def _moves(called: _CalledCode) -> bool:
    return any(isinstance(node, ast.Attribute) and node.attr == "chdir" for node in called.nodes)


def _written(node: ast.AST, called: _CalledCode) -> str | None:
    """Return the name of the file that a call overwrites, where it is the same in each run."""
    match node:
        case ast.Call(func=ast.Name(id="open"), args=[file, mode, *_]) if _is_writing(mode):
            return _fixed_name(file, called)
        case ast.Call(func=ast.Name(id="open"), args=[file], keywords=keywords):
            is_writing = any(each.arg == "mode" and _is_writing(each.value) for each in keywords)
            return _fixed_name(file, called) if is_writing else None
        case ast.Call(func=ast.Attribute(value=file, attr="open"), args=[mode, *_]) if _is_writing(mode):
            return _fixed_name(file, called) if isinstance(file, ast.Call) else None
        case ast.Call(func=ast.Attribute(value=file, attr=name)) if name in _WRITING_METHODS:
            return _fixed_name(file, called)
        case ast.Call(func=ast.Attribute(attr=name), args=[file, *_]) if name in _WRITING:
            return _fixed_name(file, called)
        case _:
            return None


def _is_writing(mode: ast.expr) -> bool:
    return isinstance(mode, ast.Constant) and isinstance(mode.value, str) and not {"w", "x"}.isdisjoint(mode.value)


def _fixed_name(file: ast.AST, called: _CalledCode) -> str | None:
    match file:
        case ast.Constant(value=str(name)):
            return None if name.startswith(_NO_FILES) else name
        case ast.Call(func=ast.Name(id="Path") | ast.Attribute(attr="Path"), args=[inner]):
            return _fixed_name(inner, called)
        case ast.Name() if isinstance(value := called.named(file), str | Path):
            return str(value)
        case _:
            return None


# Measures that are published after the run, which is judged by then.

_FIX_OF_MEASURE = (
    "Publish it in populate_run_data, or have a person asked for it by an OperatorStep with after=True; "
    "otherwise each run fails, or is tried again."
)


def _measured_too_late(code: _LocalCode, events: EventManager) -> Iterator[tuple[str, str, str]]:
    for each in events.subscribers(RobotRunnerEvents.CONTINUE):
        nodes = chain.from_iterable(called.nodes for called in code.called_by(each))
        if names := sorted({name for node in nodes if (name := _published(node))}):
            problem = f"{RobotRunnerEvents.CONTINUE.callback_name} publishes {', '.join(names)} once a run is over, "
            yield each.owner, f"{problem}which on_bad_value has taken for missing", _FIX_OF_MEASURE


def _published(node: ast.AST) -> str | None:
    """Return the name of the measure that a call publishes; None for anything else, and where it is computed."""
    if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == "publish"):
        return None
    if len(node.args) > 2:  # noqa: PLR2004 - a message to a topic, with its type
        return None
    named = [*node.args[:1], *(each.value for each in node.keywords if each.arg == "name")]
    return next((str(each.value) for each in named if isinstance(each, ast.Constant)), None)
