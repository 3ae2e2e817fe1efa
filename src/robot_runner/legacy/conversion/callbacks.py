"""Convert the methods of a config: their subscriptions, and CodeCarbon's decorators."""

from __future__ import annotations

import ast
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from robot_runner.core.errors import Finding
from robot_runner.core.events.manager import EVENTS_BY_CALLBACK, RobotRunnerEvents
from robot_runner.legacy.conversion.bases import Inherited
from robot_runner.legacy.conversion.earlier_imports import ConvertedFile
from robot_runner.legacy.earlier_experiment import ROW_NAMES
from robot_runner.legacy.profilers.profiler_catalogue import plugin_of
from robot_runner.legacy.session import Session, name_of
from robot_runner.legacy.syntax import Edits, attributes_of, imports_of, nodes, walk_bodies

_CONTROLLER = "EventSubscriptionController"
_OF_ALL = "subscribe_to_multiple_events"
_OF_FORK = f"{_OF_ALL}_multiple_callbacks"
_INDENT = 4


@dataclass(frozen=True, slots=True)
class CallbackNames:
    """The names of a config's methods after the conversion.

    Attributes:
        renamed: the new name of a method, by its old one.
        is_by_name: whether all callbacks are subscribed by their names alone.
        heard: the events with a callback, each by the name of its callback.
    """

    renamed: dict[str, str]
    is_by_name: bool
    heard: frozenset[str]


def named_callbacks(session: Session, config: ast.ClassDef, inherited: Inherited) -> CallbackNames:
    """Name each callback after its event, if events and callbacks correspond one to one.

    Args:
        session: has the subscriptions of the loaded config.
        config: the class; conditional subscriptions are kept.
        inherited: the members of converted base classes, which have their new names already.
    """
    own = {method.name for method in _methods(config)}
    always = [statement for method in _methods(config) for statement in method.body if _subscribes(statement)]
    heard = [(each.event, name_of(each.callback)) for each in session.subscriptions]
    events = Counter(event for event, _ in heard)
    names = Counter(name for _, name in heard)
    is_always = all(statement in always for statement in nodes(config, ast.Expr) if _subscribes(statement))
    is_by_name = (
        is_always
        and all(
            (name in own or name in inherited.methods)
            and inherited.methods.get(name, event.callback_name) == event.callback_name
            for event, name in heard
        )
        and all(count == 1 for count in (*events.values(), *names.values()))
    )
    renamed = {name: now for name, now in inherited.methods.items() if name != now}
    if is_by_name:
        renamed |= {name: event.callback_name for event, name in heard if name != event.callback_name}
    for method in own & set(EVENTS_BY_CALLBACK) - set(inherited.methods):
        if method not in names:
            renamed[method] = f"_{method}"  # its old name would now subscribe it
    return CallbackNames(renamed, is_by_name, frozenset(event.callback_name for event in events))


def remove_subscriptions(config: ast.ClassDef, edits: Edits) -> list[ast.stmt]:
    """Remove the subscriptions of a class, and an `__init__` with nothing else; return the removed statements."""
    removed: list[ast.stmt] = []
    for method in _methods(config):
        found = [statement for statement in method.body if _subscribes(statement)]
        removed += found
        rest = [statement for statement in method.body if statement not in found]
        is_idle = all(isinstance(each, ast.Expr) and isinstance(each.value, ast.Constant) for each in rest)  # docstring
        if found and is_idle and method.name == "__init__":
            first = min([method.lineno, *(decorator.lineno for decorator in method.decorator_list)])
            edits.remove_paragraph(first, method.end_lineno or method.lineno)
            continue
        for statement in found:
            lines = range(statement.lineno, (statement.end_lineno or statement.lineno) + 1)
            beside = (each for each in method.body if each is not statement)
            if method.lineno in lines or any(each.lineno in lines or each.end_lineno in lines for each in beside):
                edits.replace(statement, "pass")
            else:
                edits.remove_lines(lines[0], lines[-1])
        if len(found) == len(method.body) and method.lineno != found[0].lineno:
            edits.insert(edits.line_start(method.body[0].lineno), f"{' ' * method.body[0].col_offset}pass\n")
    return removed


def convert_lists_of_callbacks(config: ast.ClassDef, edits: Edits) -> None:
    """Write an entry for each callback instead of a fork's lists; the elements are converted already."""
    for call in nodes(config, ast.Call):
        match call.func:
            case ast.Attribute(value=ast.Name(id=name), attr=attr) as func if name == _CONTROLLER and attr == _OF_FORK:
                edits.replace_span(edits.end_of(func) - len(_OF_FORK), edits.end_of(func), _OF_ALL)
                for pair in nodes(call, ast.Tuple):
                    match pair.elts:
                        case [event, ast.List(elts=callbacks)]:
                            parts = [f"({edits.edited(event)}, {edits.edited(each)})" for each in callbacks]
                            edits.replace(pair, ", ".join(parts))


def convert_continue(config: ast.ClassDef, names: CallbackNames, inherited: Inherited, edits: Edits) -> None:
    """Make the callbacks of `continue` and `before_experiment` return True, as the config asks the user itself."""
    methods = {names.renamed.get(method.name, method.name): method for method in _methods(config)}
    asking, before = methods.get("continue_experiment"), methods.get("before_experiment")
    is_asked_by_base = "continue_experiment" in inherited.heard
    by_itself = "return True  # the first run starts by itself"
    if before is not None and (asking is not None or is_asked_by_base):
        _return_true(before, by_itself, edits)
    if asking is None:
        return
    _return_true(asking, "return True  # the user was asked here", edits)
    if before is None and not is_asked_by_base:
        calling = ["super().before_experiment()"] if "before_experiment" in inherited.heard else []
        lines = "".join(f"\n{' ' * (asking.col_offset + _INDENT)}{line}" for line in (*calling, by_itself))
        edits.insert(edits.end_of(asking.body[-1]), f"\n\n{' ' * asking.col_offset}def before_experiment(self):{lines}")


def _return_true(method: ast.FunctionDef, statement: str, edits: Edits) -> None:
    """Make a method always return True: the earlier tools ignored its value."""
    for each in walk_bodies(method.body):
        match each:
            case ast.Return(value=None | ast.Constant()):
                edits.replace(each, "return True")
            case ast.Return(value=ast.expr() as value):  # evaluated still, as it may ask the user
                edits.insert(edits.start_of(value), "(")
                edits.insert(edits.end_of(value), ", True)[1]")
    if not isinstance(method.body[-1], ast.Return):
        is_in_line = method.body[0].lineno == method.lineno  # a method on one line
        following = f"; {statement}" if is_in_line else f"\n{' ' * method.body[0].col_offset}{statement}"
        edits.insert(edits.end_of(method.body[-1]), following)


#: The docstring of a method that overrides an inherited callback to which the config did not subscribe.
NOTHING = "Do nothing: the class that this one derives from subscribes to the event, and this one does not."


def leave_unheard(config: ast.ClassDef, names: CallbackNames, inherited: Inherited, edits: Edits) -> None:
    """Override inherited callbacks that were not subscribed, since their names would subscribe them."""
    own = {names.renamed.get(method.name, method.name) for method in _methods(config)}
    indent = " " * config.body[0].col_offset
    for name in EVENTS_BY_CALLBACK:
        if name in inherited.heard - names.heard - own:
            text = f'\n\n{indent}def {name}(self):\n{indent}{" " * _INDENT}"""{NOTHING}"""'
            edits.insert(edits.end_of(config.body[-1]), text)


def taken_over(where: str, config: ast.ClassDef, names: CallbackNames, inherited: Inherited) -> Iterator[Finding]:
    """Yield an error for each callback that would override an inherited one that the class calls by its name."""
    called = {node.attr for _, node in attributes_of(config, {"self"})}
    for name, callback in names.renamed.items():
        before = {old for old, now in inherited.methods.items() if now == callback}
        if name not in inherited.methods and before & called:
            problem = f"{name} is subscribed in the place of {', '.join(sorted(before))}, which this class calls"
            fix = "Override that one, and call it by super() there; then convert the file."
            yield Finding.error(where, problem, fix)


def convert_rows_of_before_run(config: ast.ClassDef, session: Session, edits: Edits) -> None:
    """Make a `before_run` with a row as its parameter take the context."""
    heard = session.callbacks_of(RobotRunnerEvents.BEFORE_RUN)
    for method in _methods(config):
        for argument in method.args.args[1:2] if method.name in heard else ():
            if argument.arg in ROW_NAMES:
                edits.replace(argument, "context")
                first = method.body[0]
                indent = " " * first.col_offset
                edits.insert(edits.start_of(first), f"{argument.arg} = context.combination\n{indent}")


#: Literals that no cell can hold; the earlier tools wrote their texts.
_DISPLAYS = (ast.List, ast.Tuple, ast.Set, ast.Dict, ast.ListComp, ast.SetComp, ast.DictComp)


def write_values_as_text(config: ast.ClassDef, session: Session, edits: Edits) -> None:
    """Convert lists and the like that are values of measures to the texts that the earlier tools wrote."""
    heard = session.callbacks_of(RobotRunnerEvents.POPULATE_RUN_DATA)
    columns = {column for model in session.models for column in model.get_data_columns()}
    for method in _methods(config):
        dicts = list(nodes(method, ast.Dict)) if method.name in heard else []
        cells = [pair for data in dicts for pair in zip(data.keys, data.values, strict=True)]
        of_measures = [cell for key, cell in cells if isinstance(key, ast.Constant) and key.value in columns]
        written = [cell for cell in of_measures if isinstance(cell, _DISPLAYS)]
        inner = {id(node) for cell in written for node in ast.walk(cell) if node is not cell}
        for cell in written:
            if id(cell) not in inner:
                edits.insert(edits.start_of(cell), "str(")
                edits.insert(edits.end_of(cell), ")")


def order_findings(session: Session) -> Iterator[Finding]:
    """Yield warnings where the order of the events differs from the earlier tool's."""
    heard = {each.event for each in session.subscriptions}
    is_robot_runner = session.recognised.dialect.class_name == "RobotRunnerConfig"
    if is_robot_runner and {RobotRunnerEvents.STOP_RUN, RobotRunnerEvents.POPULATE_RUN_DATA} <= heard:
        problem = "populate_run_data is called after stop_run now; Robot Runner called it before"
        yield Finding.warning(session.path.name, problem, "See that stop_run leaves what populate_run_data reads.")


def _methods(config: ast.ClassDef) -> Iterator[ast.FunctionDef]:
    return (node for node in config.body if isinstance(node, ast.FunctionDef))


def _subscribes(statement: ast.stmt) -> bool:
    match statement:
        case ast.Expr(value=ast.Call(func=ast.Attribute(value=ast.Name(id=name)))):
            return name == _CONTROLLER
        case _:
            return False


_PLUGIN = "CodeCarbon"
_HOME = "robot_runner.plugins.profilers"
_COUNTRY = "country_iso_code"
_INTERVAL = "measure_power_secs"
#: Arguments that our profiler does not have: its columns, and permission to use the internet.
_OF_WRAPPER = {"data_columns", "online"}
#: Our profiler's names of CodeCarbon's columns, including one of the plugin's first version.
_MEASURES = {
    "__co2_emissions": "Emissions",
    "codecarbon__emissions": "Emissions",
    "codecarbon__energy_consumed": "Energy",
    "codecarbon__cpu_energy": "CPUEnergy",
    "codecarbon__ram_energy": "MemoryEnergy",
}
_OF_CODECARBON = "codecarbon__"


def convert_decorators(converted: ConvertedFile, config: ast.ClassDef, columns: Sequence[str]) -> None:
    """Remove the decorators, also from the tree, and add the profiler and its columns to the config.

    Args:
        converted: the file.
        config: its config class.
        columns: the columns of the run table before.
    """
    plugins = {each.bound_as: plugin_of(f"{each.module}.{each.name}") for each in imports_of(converted.tree)}
    names = {bound for bound, plugin in plugins.items() if plugin is not None and plugin.ours == _PLUGIN}
    removed: list[ast.expr] = []
    for node in (config, *config.body):
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            found = [each for each in node.decorator_list if _root(each) in names]
            node.decorator_list = [each for each in node.decorator_list if each not in found]
            removed += found
    for decorator in removed:
        converted.edits.remove_lines(decorator.lineno, decorator.end_lineno or decorator.lineno)
    if removed:
        keywords = [keyword for each in removed if isinstance(each, ast.Call) for keyword in each.keywords]
        settings = {each.arg: converted.edits.source(each.value) for each in keywords if each.arg is not None}
        _list_profiler(converted, config, settings)
        _list_columns(converted, config, columns)


def _list_profiler(converted: ConvertedFile, config: ast.ClassDef, settings: Mapping[str, str]) -> None:
    if _COUNTRY not in settings:
        problem = f"CodeCarbon's decorators do not say the {_COUNTRY}"
        converted.refuse(config.lineno, problem, f"Write it, as in {_COUNTRY}='NLD'.")
        return
    first, edits = config.body[0], converted.edits
    given = f"country={settings[_COUNTRY]}"
    given += f", interval_s={settings[_INTERVAL]}" if _INTERVAL in settings else ""
    known = {_COUNTRY, _INTERVAL, *_OF_WRAPPER}
    options = ", ".join(f'"{name}": {value}' for name, value in settings.items() if name not in known)
    given += f", options={{{options}}}" if options else ""
    edits.insert(edits.start_of(first), f"plugins = [{_PLUGIN}({given})]\n{' ' * first.col_offset}")
    converted.profilers.setdefault(_HOME, set()).add(_PLUGIN)


def is_told_as_of_codecarbon(column: str, columns: Sequence[str]) -> bool:
    """Return whether a column was CodeCarbon's, and its measure either is a new column or does not exist."""
    return _MEASURES[column] in columns if column in _MEASURES else column.startswith(_OF_CODECARBON)


def _list_columns(converted: ConvertedFile, config: ast.ClassDef, columns: Sequence[str]) -> None:
    """Replace the run table's columns by the profiler's, with findings on each earlier one."""
    ours = {name: _MEASURES[name] for name in columns if name in _MEASURES}
    names = ", ".join(f'"{each}"' for each in dict.fromkeys(ours.values()))
    keywords = [keyword for call in nodes(converted.tree, ast.Call) for keyword in call.keywords]
    for listed in (each.value for each in keywords if each.arg == "data_columns" and names):
        match listed:
            case ast.List(elts=[]):
                converted.edits.replace(listed, f"[{names}]")
            case ast.List(elts=[*_, last]):
                there = {each.value for each in listed.elts if isinstance(each, ast.Constant)}
                for name in sorted({*ours.values()} & there):
                    problem = f"the config has a measure {name!r}, and so has CodeCarbon's profiler"
                    converted.refuse(listed.lineno, problem, "Call the config's otherwise, then convert.")
                converted.edits.insert(converted.edits.end_of(last), f", {names}")
            case _:
                pass  # loading the new config reports a missing column
    told = [f"{name} is {measure} now" for name, measure in ours.items()]
    told += [
        f"{name} has no column any more, and stands in emissions.json of each run"
        for name in columns
        if name.startswith(_OF_CODECARBON) and name not in ours
    ]
    problem = "; ".join(["CodeCarbon's decorators are a profiler now", *told])
    fix = "Read them so in your analysis: emissions in kg, energies in J, which were in kWh."
    converted.findings.append(Finding.warning(f"{converted.path}:{config.lineno}", problem, fix))


def _root(decorator: ast.expr) -> str:
    """Return the first name of a decorator: `tracker` for `@tracker.start(country="NLD")`."""
    while isinstance(decorator, ast.Call | ast.Attribute):
        decorator = decorator.func if isinstance(decorator, ast.Call) else decorator.value
    return decorator.id if isinstance(decorator, ast.Name) else ""
