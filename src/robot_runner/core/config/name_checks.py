"""Checks of the names in the code of a config: those that nothing uses, nothing defines, or nothing publishes.

The code is read; nothing of it is executed. Misspelt names, which are refused, are found by `checks`.
"""

from __future__ import annotations

import ast
import builtins
import dis
import inspect
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from types import CodeType, ModuleType

from robot_runner.core.config.loader import LoadedConfig
from robot_runner.core.config.parameters import PARAMETERS, ExperimentConfig
from robot_runner.core.config.raised_errors import fix_of_undefined
from robot_runner.core.config.source import DESIGN_METHODS, tree_of
from robot_runner.core.errors import Finding, nearest
from robot_runner.core.events.manager import EVENTS_BY_CALLBACK, EventManager, RobotRunnerEvents
from robot_runner.core.events.measure import CONFIG_OWNER, MeasureColumns
from robot_runner.core.late_annotations import names_in, names_read_by

# Methods and attributes that look like ours, or an earlier tool's, and are never used.

#: The fix for a method, with names that earlier tools have for it, or that people guess.
_METHODS = {
    "Call it launch_mission.": (
        "interact interaction interact_with_robot mission start_mission run_mission execute_mission perform_mission "
        "execute_run run_experiment run"
    ),
    "Call it stop_run, or populate_run_data where it returns measures.": (
        "after_run after_each_run post_run end_run finish_run on_run_end run_finished"
    ),
    "A mission ends when launch_mission returns; what it leaves running is ended in stop_measurement.": (
        "stop_mission end_mission finish_mission stop_interaction after_mission"
    ),
    "Call it before_run.": "pre_run before_each_run on_run_start prepare_run setup_run set_up_run",
    "Call it before_experiment.": "setup set_up setup_experiment set_up_experiment start_experiment on_start",
    "Call it after_experiment.": (
        "teardown tear_down cleanup clean_up end_experiment stop_experiment finish_experiment on_end"
    ),
    "Call it start_measurement.": "before_measurement begin_measurement start_profiler start_profilers start_profiling",
    "Call it stop_measurement.": "after_measurement end_measurement stop_profiler stop_profilers stop_profiling",
    "Call it continue_experiment.": "between_runs continue_ continue_run next_run before_next_run",
    "Call it populate_run_data, and return the measures.": (
        "populate_data get_run_data collect_data collect_run_data run_data get_results collect_results save_results"
    ),
    "Call it create_run_table.": "create_run_table_model get_run_table run_table make_run_table",
}

#: The same for attributes.
_ATTRIBUTES = {
    "Use attempts: how often a run is tried, 1 for no retry.": (
        "retries max_retries num_retries n_retries retry_count retry repeat_failed max_attempts num_attempts"
    ),
    "Give it to RunTableModel: repetitions=...": (
        "repetitions num_repetitions number_of_repetitions repeats num_runs number_of_runs runs replications iterations"
    ),
    "Give it to RunTableModel: shuffle=True, seed=...": (
        "shuffle randomize randomise randomize_order random_order randomize_runs seed random_seed"
    ),
    "Give it to RunTableModel: warm_up=...": "warm_up warmup warm_ups warmups warm_up_runs warmup_runs num_warmup_runs",
    "Give it to RunTableModel: blocks=...": "blocks block block_by blocking",
    "Give it to RunTableModel: exclude_combinations=...": (
        "exclude_combinations excluded_combinations exclude exclusions exclude_variations"
    ),
    "Give it to RunTableModel: design=...": "design experiment_design experimental_design",
    "Give it to the plan of the analysis: analysis = AnalysisPlan(...).": (
        "hypotheses hypothesis covariates alpha significance_level analysis_plan"
    ),
    "Return a RunTableModel from create_run_table.": "run_table run_table_model factors treatments data_columns",
    "Call it experiment_name.": "name title experiment",
    "Call it results_output_path.": (
        "results_path result_path output_path output_folder results_folder output_dir results_dir experiment_path"
    ),
    "Call it time_between_runs_in_ms.": (
        "time_between_runs time_between_runs_in_s cooldown cooldown_time cool_down rest_time pause_between_runs delay"
    ),
    "Use run_deadline_in_s, or event_deadline_in_s.": "timeout run_timeout max_duration max_run_time deadline",
    "Make it a method: def duration_s(self, combination): return 60.": "duration_s",
    "Call it operation_type: OperationType.AUTO or OperationType.SEMI.": "operation mode run_mode",
    "Call it required_ros_version.": "ros_version",
    "Call it required_ros_distro.": "ros_distro ros_distribution",
    'Set robot = "simulated".': "simulated simulate is_simulated use_simulator use_simulation simulation",
    "List them in plugins.": "profilers systems sensors profiler",
    "Use on_failure: FailurePolicy.CONTINUE or FailurePolicy.STOP.": "stop_on_failure continue_on_failure fail_fast",
}
_FIX_OF_METHOD = {name: fix for fix, names in _METHODS.items() for name in names.split()}
_FIX_OF_ATTRIBUTE = {name: fix for fix, names in _ATTRIBUTES.items() for name in names.split()}

#: A name of these words alone is probably meant for an event.
_MOMENTS = frozenset(["before", "after", "start", "stop", "begin", "end", "launch", "finish", "execute", "populate"])
_SUBJECTS = frozenset(
    ["run", "runs", "experiment", "measurement", "measurements", "measuring", "mission", "interaction", "data"]
)
_FILLING = frozenset(["on", "each", "every", "all", "the", "handle", "do"])
#: How similar two names must be (1.0: equal); less than where a name is refused, as nothing uses this one.
_ALIKE = 0.75
_HUMP = re.compile(r"(?<=[a-z0-9])(?=[A-Z])")
#: The unit at the end of a name, in our form and in others: `run_timeout_in_s` counts as `run_timeout`.
_UNIT_OF_TIME = re.compile(r"_(?:in_)?(?:m?s|secs?|min|(?:milli)?seconds?|minutes?)$")


def check_unused_names(loaded: LoadedConfig) -> list[Finding]:
    """Return a finding for each public name of the config that looks like ours and is never called or read.

    Configs of other dialects, which have their own names, are checked by their rooms.
    """
    config_class = type(loaded.config)
    if config_class.__name__ != loaded.source.class_name:
        return []
    tree, used = tree_of(loaded.source.path), _used_names(loaded)
    found = list(_valueless(loaded, tree))
    if used is None:
        return found
    found += _outside_of_the_class(loaded, tree, used)
    for name in sorted(_own_names(config_class) | set(getattr(loaded.config, "__dict__", ()))):
        if name.startswith("_") or name in used or name in _LIVE:
            continue
        is_method = inspect.isroutine(inspect.getattr_static(loaded.config, name, None))
        fix = _fix_of_method(name) if is_method else _fix_of_attribute(name)
        if fix:
            problem = "nothing calls this method" if is_method else "nothing reads this attribute"
            found.append(Finding.warning(f"{loaded.where}.{name}", problem, fix))
    return found


def _outside_of_the_class(loaded: LoadedConfig, tree: ast.AST, used: set[str]) -> Iterator[Finding]:
    """Yield an error for each function that looks like a callback, and is no method by its indentation."""
    for each in _functions_of_no_class(tree):
        first = [argument.arg for argument in each.args.args[:1]]
        if each.name in _CALLED and first == ["self"] and each.name not in used and not each.decorator_list:
            problem = f"{each.name} stands outside of the config class, where nothing calls it"
            fix = f"Indent it as the other methods of {loaded.source.class_name} are."
            yield Finding.error(f"{loaded.source.path}:{each.lineno}", problem, fix)


def _functions_of_no_class(node: ast.AST, *, is_in_class: bool = False) -> Iterator[ast.FunctionDef]:
    for each in ast.iter_child_nodes(node):
        if isinstance(each, ast.FunctionDef) and not is_in_class:
            yield each
        is_scope = isinstance(each, ast.ClassDef | ast.FunctionDef)
        yield from _functions_of_no_class(each, is_in_class=isinstance(each, ast.ClassDef) if is_scope else is_in_class)


def _valueless(loaded: LoadedConfig, tree: ast.Module) -> Iterator[Finding]:
    """Yield an error for each parameter with a value in the place of its annotation, in the config class or a base."""
    names = {each.__name__ for each in type(loaded.config).__mro__}
    classes = [each for each in tree.body if isinstance(each, ast.ClassDef) and each.name in names]
    for node in (line for each in classes for line in each.body):
        match node:
            case ast.AnnAssign(target=ast.Name(id=name), annotation=value, value=None) if name in _LIVE:
                if _is_no_type(value) and name not in vars(loaded.config):
                    problem = f"{name}: the colon makes it an annotation, which gives no value"
                    fix = f"Write {name} = {ast.unparse(value)}."
                    yield Finding.error(f"{loaded.source.path}:{node.lineno}", problem, fix)


def _is_no_type(annotation: ast.expr) -> bool:
    match annotation:
        case ast.Constant(value=value):
            return isinstance(value, int | float)
        case ast.Attribute(attr=name):  # of an enum
            return name.isupper()
        case _:
            return isinstance(annotation, ast.List | ast.Tuple | ast.Dict | ast.Call | ast.UnaryOp)


_CALLED = frozenset({*EVENTS_BY_CALLBACK, "create_run_table"})
_LIVE = frozenset({*PARAMETERS, *_CALLED, "plugins"})


def _own_names(config_class: type) -> set[str]:
    classes = [each for each in config_class.__mro__ if each not in ExperimentConfig.__mro__]
    return {name for each in classes for name in names_in(each)}


def _used_names(loaded: LoadedConfig) -> set[str] | None:
    """Return the names that the code of a config reads or calls; None where it computes names (`getattr`)."""
    used: set[str] = set()
    for path in (loaded.source.path, *loaded.local_modules):
        for node in ast.walk(tree_of(path)):
            if _looks_up(node):
                return None
            used |= set(_read_by(node))
    for each in type(loaded.config).__mro__:  # a base class from an installed package may call what is defined here
        if each not in ExperimentConfig.__mro__:
            used |= {name for attribute in vars(each).values() for name in names_read_by(attribute)}
    return used


def _looks_up(node: ast.AST) -> bool:
    match node:
        case ast.Call(func=ast.Name(id="getattr"), args=[_, name, *_]):
            return not isinstance(name, ast.Constant)
        case ast.Call(func=ast.Name(id="vars" | "dir")):
            return True
        case _:
            return False


def _read_by(node: ast.AST) -> Iterator[str]:
    match node:
        case ast.Attribute(attr=name, ctx=ast.Load()) | ast.Name(id=name, ctx=ast.Load()):
            yield name
        case ast.Constant(value=str(name)):  # of getattr, or of a test
            yield name
        case ast.FunctionDef(name=name, decorator_list=decorators) if any(map(_registers, decorators)):
            yield name
        case _:
            pass


def _registers(decorator: ast.expr) -> bool:
    """Return whether a decorator may register its method to be called."""
    return not (isinstance(decorator, ast.Name) and decorator.id in {"staticmethod", "classmethod", "property"})


def _fix_of_method(name: str) -> str:
    plain = _HUMP.sub("_", name).casefold()
    if plain in _FIX_OF_METHOD:
        return _FIX_OF_METHOD[plain]
    words = [word for word in plain.split("_") if word not in _FILLING]
    is_event = {*words} <= _MOMENTS | _SUBJECTS and bool({*words} & _MOMENTS) and bool({*words} & _SUBJECTS)
    near = nearest("_".join(words), EVENTS_BY_CALLBACK, 0.0 if is_event else _ALIKE)
    if near is None:
        return ""
    return f"No event is called so: did you mean {near!r}? There are {', '.join(EVENTS_BY_CALLBACK)}."


def _fix_of_attribute(name: str) -> str:
    plain = _HUMP.sub("_", name).casefold()
    guessed = _FIX_OF_ATTRIBUTE.get(plain) or _FIX_OF_ATTRIBUTE.get(_UNIT_OF_TIME.sub("", plain))
    if guessed:
        return guessed
    near = nearest(plain, PARAMETERS, _ALIKE)
    return f"No static parameter is called so: did you mean {near!r}?" if near is not None else ""


# Names that functions read, and that nothing defines: a run would fail of them.


def check_undefined_names(loaded: LoadedConfig) -> list[Finding]:
    """Return a warning for each name that a function of the config, or of a module beside it, would not find."""
    files = {str(each) for each in (loaded.source.path, *loaded.local_modules)}
    modules = [each for each in list(sys.modules.values()) if isinstance(each, ModuleType)]
    named = {str(vars(each).get("__file__")): each for each in modules}
    return [finding for file in sorted(files & named.keys()) for finding in _undefined_in(Path(file), named[file])]


def _undefined_in(path: Path, module: ModuleType) -> Iterator[Finding]:
    codes = list(_functions_of(compile(tree_of(path), str(path), "exec")))
    made = {each.argval for code in codes for each in dis.get_instructions(code) if each.opname == "STORE_GLOBAL"}
    known = {*vars(module), *dir(builtins), *made}
    local = {name for code in codes for name in code.co_varnames}
    for code in codes:
        if "NameError" in code.co_names:  # it looks whether there is one
            continue
        reader = code.co_qualname.partition(".<locals>")[0].rpartition(".")[2]
        lines: dict[str, int | None] = {}
        for each in dis.get_instructions(code):
            if each.opname == "LOAD_GLOBAL" and each.argval not in known and not each.argval.startswith("__"):
                lines.setdefault(each.argval, each.positions.lineno if each.positions else None)
        for name, line in lines.items():
            problem = f"nothing defines the name {name!r}, which {reader} reads"
            fix = fix_of_undefined(name, [*vars(module), *local])
            if name in {"self", "context"}:
                fix = f"Make it a parameter of {reader}."
            yield Finding.warning(f"{path}:{line or 0}", problem, fix)


def _functions_of(code: CodeType) -> Iterator[CodeType]:
    """Yield the code of all functions in some code, without annotations, which are evaluated only if asked for."""
    for each in code.co_consts:
        if isinstance(each, CodeType) and each.co_name != "__annotate__":
            yield each
            yield from _functions_of(each)


# Measures that the config declares and that nothing in its code publishes: their cells would stay empty.

_POPULATE = RobotRunnerEvents.POPULATE_RUN_DATA


def check_published(loaded: LoadedConfig, events: EventManager, columns: MeasureColumns) -> list[Finding]:
    """Return a warning for each measure of the config that its code does not publish.

    None where reading cannot tell, as where a name is computed, a context is passed on, or a callback is not beside
    the config; and none where the code publishes nothing at all: that is only planned so far.
    """
    trees = {str(path): tree_of(path) for path in (loaded.source.path, *loaded.local_modules)}
    own = [each for event in RobotRunnerEvents for each in events.subscribers(event) if each.owner == CONFIG_OWNER]
    codes = [getattr(each.callback, "__code__", None) for each in own]
    if any(code is None or code.co_filename not in trees or code.co_name == "<lambda>" for code in codes):
        return []
    returning = {code.co_name for code, each in zip(codes, own, strict=True) if code and each.event is _POPULATE}
    contexts = {name for code in codes if code for name in _taken_by(code)} - {"self"}
    nodes = [node for tree in trees.values() for node in _without_run_tables(tree)]
    looked_into = {id(each.value) for each in nodes if isinstance(each, ast.Attribute)}
    called = {id(each.func) for each in nodes if isinstance(each, ast.Call)}
    whole = [each for each in nodes if id(each) not in looked_into | called]
    published = [name for node in nodes for name in _published_by(node, returning)]
    published += [None for each in whole if _may_publish(each, contexts)]
    if not published or None in published:
        return []
    spelt = {node.value for node in nodes if isinstance(node, ast.Constant) and isinstance(node.value, str)}
    known = {*filter(None, published), *(each.name for each in columns.declared if each.owner != CONFIG_OWNER)}
    known -= set(columns.names)
    return [
        Finding.warning("data_columns", f"nothing publishes {column.name!r}: it stays empty", _fix(column.name, known))
        for column in columns.in_table
        if column.owner == CONFIG_OWNER and not column.tells_of and column.name not in spelt
    ]


def _fix(name: str, known: set[str]) -> str:
    near = nearest(name, known)
    meant = "" if near is None else f"Did you mean {near!r}? "
    return f"{meant}Return it from populate_run_data, or leave it out of data_columns."


def _without_run_tables(tree: ast.AST) -> Iterator[ast.AST]:
    """Yield all nodes but those of the methods that declare the names."""
    yield tree
    for each in ast.iter_child_nodes(tree):
        if not (isinstance(each, ast.FunctionDef) and each.name in DESIGN_METHODS):
            yield from _without_run_tables(each)


def _taken_by(code: CodeType) -> Iterator[str]:
    """Yield the names of what a callback takes; a decorator's often takes a context by `*args`."""
    names, others, _ = inspect.getargs(code)
    yield from names
    if others is not None:
        yield others


def _published_by(node: ast.AST, returning: set[str]) -> Iterator[str | None]:
    """Yield the names of measures that a node may publish; None for names that are not spelt in it."""
    match node:
        case ast.Call(func=ast.Attribute(attr="publish"), args=[ast.Constant(value=str(name)), _]):
            yield name
        case ast.Call(func=ast.Attribute(attr="publish"), args=args) if len(args) <= 2:  # noqa: PLR2004 - no message
            yield None
        case ast.FunctionDef(name=function) if function in returning:
            returned = [each.value for each in ast.walk(node) if isinstance(each, ast.Return)]
            yield from (name for value in returned for name in _returned(value))
        case _:
            pass


def _may_publish(value: ast.AST, contexts: set[str]) -> bool:
    """Return whether a value that is passed on, or kept, is a context, or its method."""
    match value:
        case ast.Name(id=name, ctx=ast.Load()):
            return name in contexts
        case _:
            return isinstance(value, ast.Attribute) and value.attr == "publish"


def _returned(value: ast.expr | None) -> Iterator[str | None]:
    match value:
        case None | ast.Constant(value=None):
            pass
        case ast.Dict(keys=keys):
            values = (key.value if isinstance(key, ast.Constant) else None for key in keys)
            yield from (value if isinstance(value, str) else None for value in values)
        case _:
            yield None
