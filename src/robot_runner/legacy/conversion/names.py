"""Convert the static parameters, run tables and factors of a config to our spelling."""

from __future__ import annotations

import ast
from collections.abc import Collection, Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path

from robot_runner.core.config.parameters import PARAMETERS
from robot_runner.core.errors import Finding
from robot_runner.core.events.manager import RobotRunnerEvents
from robot_runner.legacy.conversion.earlier_imports import ConvertedFile
from robot_runner.legacy.earlier_exclusions import EarlierFactor, NamedExclusion, named_exclusions
from robot_runner.legacy.lifting import EARLIER_NAMES
from robot_runner.legacy.run_tables import PROGRESS, named_columns
from robot_runner.legacy.session import Session
from robot_runner.legacy.syntax import Edits, attributes_of, bound_names, nodes, walk_bodies

_PATH_PROPERTY = '''
    @property
    def experiment_path(self) -> Path:
        """Where everything of this experiment is kept; callbacks also have it as context.experiment_folder."""
        return Path(__file__).parent / Path(self.results_output_path).expanduser() / self.experiment_name'''


#: Members that mean something to us, and meant nothing to the earlier tools.
_OF_OURS = frozenset({*PARAMETERS, "duration_s", "input_files", "plugins"}) - EARLIER_NAMES.keys()


def own_members(config: ast.ClassDef) -> dict[str, str]:
    """Return new names for members of a config class that are called like a parameter of ours by chance."""
    used = {*bound_names(config.body)}
    used |= {node.attr for _, node in attributes_of(config, {"self", "cls", config.name})}
    renamed = {}
    for name in sorted(used & _OF_OURS):
        renamed[name] = f"_{name}"  # other names that are like ours would be taken for slips of the pen
        while renamed[name] in used:
            renamed[name] += "_"
    return renamed


def convert_parameters(config: ast.ClassDef, results: Path, members: Mapping[str, str], edits: Edits) -> None:
    """Rename static parameters and other members of a config class in its body.

    Args:
        config: the class.
        results: the folder of its results.
        members: the new names of its members that are called like parameters of ours.
        edits: takes the changes.
    """
    bound = bound_names(config.body)
    renamed = {"name": "experiment_name", **{name: now for name, now in members.items() if name in bound}}
    is_asked = any(node.attr == "experiment_path" for node in nodes(config, ast.Attribute))
    for statement in walk_bodies(config.body):
        _rename_reads(statement, renamed, edits)
        for target in _targets(statement):
            if target.id in renamed:
                edits.replace(target, renamed[target.id])
            elif target.id == "experiment_path" and is_asked:  # in place, as it may end the class
                edits.replace(statement, _PATH_PROPERTY.strip())
                is_asked = False
            elif target.id == "experiment_path":
                edits.remove_lines(statement.lineno, statement.end_lineno or statement.lineno)
            elif target.id == "results_output_path" and not results.expanduser().is_absolute():
                _begin_in_current_folder(statement, edits)
    if is_asked:
        edits.insert(edits.end_of(config), f"\n{_PATH_PROPERTY}")


def _rename_reads(statement: ast.stmt, renamed: Mapping[str, str], edits: Edits) -> None:
    """Rename reads of members in the body of the class; in a method they are other variables."""
    parts = list(ast.iter_child_nodes(statement))
    if isinstance(statement, ast.FunctionDef | ast.AsyncFunctionDef):
        defaults = [each for each in statement.args.kw_defaults if each is not None]
        parts = [*statement.decorator_list, *statement.args.defaults, *defaults]
    elif isinstance(statement, ast.ClassDef):
        return
    for expression in parts:
        for node in nodes(expression, ast.Name) if isinstance(expression, ast.expr) else ():
            is_target = node is expression and isinstance(node.ctx, ast.Store)
            if node.id in renamed and not is_target:
                edits.replace(node, renamed[node.id])


def _begin_in_current_folder(statement: ast.stmt, edits: Edits) -> None:
    """Make a path relative to the current folder, as before: ours are relative to the config file's."""
    value = getattr(statement, "value", None)
    if value is not None:
        edits.insert(edits.start_of(value), "Path.cwd() / (")
        edits.insert(edits.end_of(value), ")")


def _targets(statement: ast.stmt) -> Iterator[ast.Name]:
    targets = statement.targets if isinstance(statement, ast.Assign) else []
    if isinstance(statement, ast.AnnAssign):
        targets = [statement.target]
    yield from (target for target in targets if isinstance(target, ast.Name))


#: The factor of a run table without factors: ours need at least one.
ONLY_FACTOR = "setup"
_ONLY_TREATMENT = "as it is"
_KEYWORDS = {
    "exclude_variations": "exclude_combinations",
    "num_repetitions": "repetitions",
    "iterations": "repetitions",
    "randomize_order": "shuffle",
    "treatments": "factors",
}
_IN_PLACE = "num_of_repetitions"
_FACTOR_NAME = "factor_name"
#: Methods of a model or a factor that are attributes here, or return the model itself.
_CALLS = {
    "get_factors": ".factors",
    "get_data_columns": ".data_columns",
    "get_factor_name": ".name",
    "get_treatments": ".treatments",
    "get_experiment_run_table": "",
    "generate_experiment_run_table": "",
}


def convert_run_tables(session: Session, converted: ConvertedFile) -> None:
    """Convert every call that makes or queries a run table."""
    tree, edits = converted.tree, converted.edits
    for call in nodes(tree, ast.Call):
        match call.func:
            case ast.Name(id=name) if converted.names.get(name) == "RunTableModel":
                _convert_model(session, call, edits)
                if _vary(call, edits):
                    converted.ours.add("Factor")
            case ast.Name(id=name) if converted.names.get(name) == "Factor":
                for start in (edits.start_of(each) for each in call.keywords if each.arg == _FACTOR_NAME):
                    edits.replace_span(start, start + len(_FACTOR_NAME), "name")
            case ast.Attribute(value=owner, attr=name) if name in _CALLS and not call.args and not call.keywords:
                edits.replace_span(edits.end_of(owner), edits.end_of(call), _CALLS[name])
    for node in nodes(tree, ast.Attribute):
        if node.attr == _FACTOR_NAME:
            edits.replace_span(edits.end_of(node.value), edits.end_of(node), ".name")


def _convert_model(session: Session, call: ast.Call, edits: Edits) -> None:
    for argument in call.args[2:]:
        edits.insert(edits.start_of(argument), f"{_keyword_of(argument)}=")
    exclusions = call.args[1] if len(call.args) > 1 else None
    for keyword in call.keywords:
        if keyword.arg == _IN_PLACE:
            _convert_repetitions_in_place(call, keyword, edits)
        elif keyword.arg in _KEYWORDS:
            start = edits.start_of(keyword)
            edits.replace_span(start, start + len(keyword.arg), _KEYWORDS[keyword.arg])
        if keyword.arg in {"exclude_variations", "exclude_combinations"}:
            exclusions = keyword.value
    if exclusions is not None:
        _convert_exclusions(session, exclusions, edits)


def _factors_of(call: ast.Call) -> ast.expr | None:
    named = (each.value for each in call.keywords if each.arg in {"factors", "treatments"})
    return next(named, call.args[0] if call.args else None)


def _vary(call: ast.Call, edits: Edits) -> bool:
    """Add a factor with one treatment to a model without factors; returns whether it was added."""
    factors = _factors_of(call)
    only = f'[Factor("{ONLY_FACTOR}", ["{_ONLY_TREATMENT}"])]'
    if factors is None:
        edits.insert(edits.find("(", edits.end_of(call.func)) + 1, f"factors={only}, ")
    elif isinstance(factors, ast.List) and not factors.elts:
        edits.replace(factors, only)
    else:
        return False
    return True


def _keyword_of(argument: ast.expr) -> str:
    match argument:
        case ast.Constant(value=bool()):
            return "shuffle"
        case ast.Constant(value=int()):
            return "repetitions"
        case _:
            return "data_columns"


def _convert_repetitions_in_place(call: ast.Call, keyword: ast.keyword, edits: Edits) -> None:
    """Convert consecutive repetitions to a factor: it changes fastest, and has the fork's column."""
    factors = _factors_of(call)
    if isinstance(factors, ast.List) and factors.elts:
        count = edits.source(keyword.value)
        edits.insert(edits.end_of(factors.elts[-1]), f', Factor("repetition", range(1, {count} + 1))')
    edits.replace(keyword, "repetitions=1")


def _convert_exclusions(session: Session, exclusions: ast.expr, edits: Edits) -> None:
    """Add the factors to sets of values, and remove exclusions without treatments, which ours refuse."""
    if isinstance(exclusions, ast.Constant) and exclusions.value is None:
        edits.replace(exclusions, "[]")
    model = session.model
    if not isinstance(exclusions, ast.List) or model is None:
        return
    given = list(model.exclusions or ())
    if len(given) != len(exclusions.elts):
        return  # not the list that the model got
    factors = model.get_factors()
    named = [named_exclusions(session, factors, [each])[0] for each in given]
    for element, value, exclusion in zip(exclusions.elts, given, named, strict=True):
        if not isinstance(value, Mapping) or exclusion.has_unknown:
            edits.replace(element, _in_our_words(exclusion, factors))
    _leave_out(exclusions, [each.names_nothing for each in named], edits)


def _leave_out(whole: ast.List | ast.Dict, is_idle: Sequence[bool], edits: Edits) -> None:
    """Remove elements of a list or items of a mapping, each with its comma and comment."""
    starts: Sequence[ast.expr | None] = whole.elts if isinstance(whole, ast.List) else whole.keys
    ends = whole.elts if isinstance(whole, ast.List) else whole.values
    if not any(is_idle):
        return
    if all(is_idle):
        edits.replace(whole, "[]" if isinstance(whole, ast.List) else "{}")
        return
    last = max(place for place, idle in enumerate(is_idle) if not idle)
    for place, (start, following) in enumerate(pairwise(starts)):
        if is_idle[place] and place < last and start is not None and following is not None:
            edits.replace_span(edits.start_of(start), edits.start_of(following), "")
    if last < len(ends) - 1:
        edits.replace_span(edits.end_of(ends[last]), edits.end_of(ends[-1]), "")


def _in_our_words(named: NamedExclusion, factors: Sequence[EarlierFactor]) -> str:
    if named.treatments is not None:
        parts = [f"{factors[place].factor_name!r}: {list(values)!r}" for place, values in named.treatments.items()]
        return "{" + ", ".join(parts) + "}"
    values = "{" + ", ".join(map(repr, named.values)) + "}" if named.values else "set()"
    return f"lambda combination: {values} <= set(combination.values())"


# Factors and measures whose names clash with our own columns of the run table.

_TABLES = frozenset({"create_run_table", "create_run_table_model"})
_ROWS = ("run_variation", "execute_run")
_MODELS = ("RunTableModel", "Factor")


def rename_clashing(session: Session, converted: ConvertedFile) -> Iterator[Finding]:
    """Rename such columns in run tables, in reads of a row, and in returned measures."""
    model = session.model
    if model is None:
        return
    columns = [*(factor.factor_name for factor in model.get_factors()), *model.get_data_columns()]
    clashing = {name: ours for name, ours in named_columns(columns).items() if name != ours}
    for constant in _names_of_columns(session, converted) if clashing else ():
        if constant.value in clashing:
            converted.edits.replace(constant, repr(clashing[constant.value]))
    for name, ours in clashing.items():
        bare = str(name).strip()
        why = "no heading has blanks around it" if ours == bare else f"the run table has one of ours called {bare!r}"
        problem = f"the column {name!r} is called {ours!r} now: {why}"
        yield Finding.warning(session.path.name, problem, "Read it under this name in your analysis.")


def _names_of_columns(session: Session, converted: ConvertedFile) -> Iterator[ast.Constant]:
    """Yield the texts in a config that are names of columns."""
    populating = session.callbacks_of(RobotRunnerEvents.POPULATE_RUN_DATA)
    for call in nodes(converted.tree, ast.Call):
        if isinstance(call.func, ast.Name) and converted.names.get(call.func.id) in _MODELS:
            yield from _texts_in(call)
    for function in nodes(converted.tree, ast.FunctionDef):
        if function.name in populating:
            yield from _keys_in(function)
    for row in nodes(converted.tree, ast.Subscript):
        if isinstance(row.value, ast.Attribute) and row.value.attr in _ROWS and isinstance(row.slice, ast.Constant):
            yield row.slice


def _texts_in(call: ast.Call) -> Iterator[ast.Constant]:
    """Yield the names of a factor and of data columns in a call."""
    for argument in (*call.args, *(keyword.value for keyword in call.keywords if keyword.arg != "treatments")):
        listed = argument.elts if isinstance(argument, ast.List | ast.Tuple) else [argument]
        is_second = argument in call.args[1:2]  # the treatments of a factor
        yield from (each for each in listed if isinstance(each, ast.Constant) and not is_second)


def _keys_in(function: ast.FunctionDef) -> Iterator[ast.Constant]:
    """Yield the keys of a callback's mappings: of literals, and of those that it fills."""
    for mapping in nodes(function, ast.Dict):
        yield from (key for key in mapping.keys if isinstance(key, ast.Constant))
    filled = set[str]()
    for node in ast.walk(function):
        match node:
            case (
                ast.Assign(targets=[ast.Name(id=name)], value=ast.Dict())
                | ast.AnnAssign(target=ast.Name(id=name), value=ast.Dict())
            ):
                filled.add(name)
    for cell in nodes(function, ast.Subscript):
        is_read_again = isinstance(cell.value, ast.Name) and cell.value.id in filled
        if isinstance(cell.slice, ast.Constant) and (isinstance(cell.ctx, ast.Store) or is_read_again):
            yield cell.slice


# What `populate_run_data` returns: here only measures with a column may be in it.


def leave_out_treatments(session: Session, converted: ConvertedFile, config: ast.ClassDef) -> Iterator[Finding]:
    """Remove treatments from what is returned, and yield a warning for each other key that has no column.

    The earlier tools wrote returned treatments into the row again. If the class does not make the run table, its
    columns are not known.
    """
    methods = {node.name: node for node in config.body if isinstance(node, ast.FunctionDef)}
    if session.model is None or not methods.keys() & _TABLES:
        return
    columns = set(session.model.get_data_columns())
    treatments = {factor.factor_name for factor in session.model.get_factors()} | set(PROGRESS)
    for name in sorted(session.callbacks_of(RobotRunnerEvents.POPULATE_RUN_DATA) & methods.keys()):
        for key in _returned_keys(methods[name], config, converted.edits, treatments - columns):
            if key.value not in columns:
                problem = f"{key.value!r} is not in data_columns: each run of the new file that returns it fails"
                fix = "Take it out, or add it to data_columns."
                yield Finding.warning(f"{converted.path}:{key.lineno}", problem, fix)


def _returned_keys(
    function: ast.FunctionDef, config: ast.ClassDef, edits: Edits, treatments: Collection[str]
) -> Iterator[ast.Constant]:
    """Yield the constant keys of the mappings that a function returns.

    Those of `treatments` are removed where the mapping is written in the `return`; another one may be read elsewhere.
    """
    for returned in (node.value for node in nodes(function, ast.Return) if node.value is not None):
        if isinstance(returned, ast.Dict):
            can_be = None not in returned.keys  # `**more` has no key whose place in the text is known
            idle = [can_be and isinstance(key, ast.Constant) and key.value in treatments for key in returned.keys]
            _leave_out(returned, idle, edits)
            kept = (key for key, is_idle in zip(returned.keys, idle, strict=True) if not is_idle)
            yield from (key for key in kept if isinstance(key, ast.Constant))
        elif isinstance(returned, ast.Name | ast.Attribute):
            yield from _keys_of(ast.unparse(returned), function if isinstance(returned, ast.Name) else config)


def _keys_of(mapping: str, where: ast.AST) -> Iterator[ast.Constant]:
    """Yield the constant keys with which a mapping is made and filled."""
    for node in ast.walk(where):
        match node:
            case (
                ast.Assign(targets=[target], value=ast.Dict(keys=keys))
                | ast.AnnAssign(target=target, value=ast.Dict(keys=keys))
            ) if ast.unparse(target) == mapping:
                yield from (key for key in keys if isinstance(key, ast.Constant))
            case ast.Subscript(value=value, slice=ast.Constant() as key, ctx=ast.Store()):
                if ast.unparse(value) == mapping:
                    yield key
