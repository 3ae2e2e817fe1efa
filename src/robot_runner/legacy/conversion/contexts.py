"""Convert the accesses of a config's functions to their context."""

from __future__ import annotations

import ast
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field

from robot_runner.core.config.parameters import ExperimentConfig
from robot_runner.core.errors import Finding
from robot_runner.core.events.manager import RobotRunnerEvents
from robot_runner.legacy.conversion.earlier_imports import ConvertedFile
from robot_runner.legacy.earlier_experiment import ROW_NAMES, WITHOUT_CONTEXT
from robot_runner.legacy.session import Session
from robot_runner.legacy.syntax import attributes_of, bound_names, classes_of, imports_of, nodes

#: Attributes of the context, with their names here.
_ROWS = frozenset({"run_variation", "execute_run"})
_ATTRIBUTES = {"run_nr": "run_number", "run_dir": "run_folder"}
_NAMES_HERE = _ATTRIBUTES | dict.fromkeys(sorted(_ROWS), "combination")
_RUN_ID = "__run_id"
_LAMBDA = "<lambda>"
_CHANGING = frozenset({"update", "setdefault", "pop", "popitem", "clear"})
_CLASSES = frozenset({"RunnerContext", "RobotRunnerContext"})
_BY_TEXT = frozenset({"hasattr", "getattr", "setattr", "delattr"})
_BY_HAND = "Write this part by hand, then convert the file."


def convert_contexts(converted: ConvertedFile, session: Session, columns: Collection[str]) -> Iterator[Finding]:
    """Convert the functions with a context, and yield findings on accesses without a counterpart.

    A parameter is a context by its name, by its annotation, or as the first parameter of a run's callback.
    """
    tree = converted.tree
    every: list[ast.FunctionDef | ast.Lambda] = [*nodes(tree, ast.FunctionDef), *nodes(tree, ast.Lambda)]
    functions = {function: set(_contexts_of(function, tree, session)) for function in every}
    kept = {place for function, names in functions.items() for place in _places_kept(function, names)}
    contexts = kept.union(*functions.values())
    moved = set(_attributes_to_move(tree, contexts))
    given_back = {id(row) for row in _rows_given_back(tree, session)}
    found: list[Finding] = []
    for function, names in functions.items():
        if names or kept:
            found += _Function(function, names | kept, converted, columns, moved, given_back).findings()
    yield from dict.fromkeys(found)  # nested functions are visited twice
    yield from _left(converted, contexts)


def _is_context(argument: ast.arg, tree: ast.Module) -> bool:
    classes = _CLASSES | {each.bound_as for each in imports_of(tree) if each.name in _CLASSES}
    named = [] if argument.annotation is None else list(ast.walk(argument.annotation))
    return argument.arg == "context" or any(
        (isinstance(node, ast.Name) and node.id in classes)
        or (isinstance(node, ast.Constant) and node.value in classes)
        for node in named
    )


def _contexts_of(function: ast.FunctionDef | ast.Lambda, tree: ast.Module, session: Session) -> Iterator[str]:
    arguments = [*function.args.posonlyargs, *function.args.args, *function.args.kwonlyargs]
    yield from (each.arg for each in arguments if _is_context(each, tree))
    if isinstance(function, ast.Lambda):
        codes = (getattr(each.callback, "__code__", None) for each in session.subscriptions)
        is_callback = any(code and (code.co_name, code.co_firstlineno) == (_LAMBDA, function.lineno) for code in codes)
        yield from (each.arg for each in arguments[:1] if is_callback)
        return
    if function.name in session.callbacks_of(*set(RobotRunnerEvents) - WITHOUT_CONTEXT):
        yield from (each.arg for each in arguments[1:2])
    if function.name in session.callbacks_of(RobotRunnerEvents.BEFORE_RUN):
        yield from (each.arg for each in arguments[1:2] if each.arg not in ROW_NAMES)


def _places_kept(function: ast.FunctionDef | ast.Lambda, names: Collection[str]) -> Iterator[str]:
    """Yield the attributes in which a function keeps its context for others: `self.context`."""
    for node in nodes(function, ast.Assign):
        if isinstance(node.value, ast.Name) and node.value.id in names:
            yield from (ast.unparse(each) for each in node.targets if isinstance(each, ast.Attribute))


def _rows_given_back(tree: ast.Module, session: Session) -> Iterator[ast.Attribute]:
    """Yield the rows in what `populate_run_data` returns: the treatments in them are no measures here."""
    names = session.callbacks_of(RobotRunnerEvents.POPULATE_RUN_DATA)
    for function in (each for each in nodes(tree, ast.FunctionDef) if each.name in names):
        for returned in (node.value for node in nodes(function, ast.Return)):
            match returned:
                case ast.Dict(keys=keys, values=values):
                    rows = [value for key, value in zip(keys, values, strict=True) if key is None]
                case (
                    ast.Call(func=ast.Name(id="dict"), args=[row])
                    | ast.Call(func=ast.Attribute(value=row, attr="copy"))
                ):
                    rows = [row]
                case _:
                    rows = [returned] if returned is not None else []
            yield from (row for row in rows if isinstance(row, ast.Attribute) and row.attr in _ROWS)


def _attributes_to_move(tree: ast.Module, contexts: Collection[str]) -> Iterator[str]:
    """Yield the attributes that callbacks set on their context, and that can move to `self`."""
    methods = [each for each in nodes(tree, ast.FunctionDef) if [arg.arg for arg in each.args.args[:1]] == ["self"]]
    in_methods = {id(node) for method in methods for node in ast.walk(method)}
    asked = [each for each in nodes(tree, ast.Call) if isinstance(each.func, ast.Name) and each.func.id in _BY_TEXT]
    taken = {node.value for call in asked for node in nodes(call, ast.Constant)}
    taken |= {name for each in classes_of(tree).values() for name in bound_names(each.body)}
    taken |= {node.attr for _, node in attributes_of(tree, {"self"})}
    used = [node for node in nodes(tree, ast.Attribute) if ast.unparse(node.value) in contexts]
    for name in {node.attr for node in used if isinstance(node.ctx, ast.Store)}:
        is_in_methods = all(id(node) in in_methods for node in used if node.attr == name)
        if is_in_methods and name not in {*taken, *_NAMES_HERE} and not hasattr(ExperimentConfig, name):
            yield name


def _left(converted: ConvertedFile, contexts: Collection[str]) -> Iterator[Finding]:
    """Yield a warning for each read of an attribute that may be a context's, of an object that may not be one."""
    tree = converted.tree
    own = {node.attr for node in nodes(tree, ast.Attribute) if isinstance(node.ctx, ast.Store)}
    own |= {name for each in classes_of(tree).values() for name in bound_names(each.body)}
    for node in nodes(tree, ast.Attribute):
        if node.attr in _NAMES_HERE.keys() - own and ast.unparse(node.value) not in contexts:
            problem = f"{ast.unparse(node)} is left as it is: whether that is a context cannot be seen"
            fix = f"If it is, write {_NAMES_HERE[node.attr]}."
            yield Finding.warning(f"{converted.path}:{node.lineno}", problem, fix)


@dataclass(slots=True)
class _Function:
    """A function; `contexts` are its expressions for a context, `moved` the attributes that moved to `self`.

    `given_back` are the rows, by their `id`, of which only what was published counts.
    """

    _function: ast.FunctionDef | ast.Lambda
    _contexts: Collection[str]
    _file: ConvertedFile
    _columns: Collection[str]
    _moved: Collection[str]
    _given_back: Collection[int]
    _rows: dict[str, str] = field(default_factory=dict)
    _returned: set[str] = field(default_factory=set)

    def __post_init__(self) -> None:
        self._rows |= self._row_variables()
        returned = (node.value for node in nodes(self._function, ast.Return))
        self._returned |= {node.id for node in returned if isinstance(node, ast.Name)}

    def findings(self) -> Iterator[Finding]:
        """Convert every use of the context, and of variables with the row; yields findings."""
        for node in ast.walk(self._function):
            match node:
                case ast.Assign(targets=[ast.Subscript(value=row) as cell]) if self._context_of(row):
                    yield from self._convert_writing(node, cell)
                case ast.Call(func=ast.Attribute(value=row, attr=name)) if self._is_row(row) and name in _CHANGING:
                    yield self._lacking(node, "this changes the row of the run table, which cannot be written here")
                case ast.Call(func=ast.Attribute(value=row, attr="get"), args=[ast.Constant(value="__run_id"), *_]) if (
                    self._context_of(row)
                ):
                    self._file.edits.replace(node, f"{self._context_of(row)}.run_id")
                case ast.Call(func=ast.Name(id="vars"), args=[context]) if self._is_context(context):
                    yield self._lacking(node, "a context has no __dict__ here", "Take this out, then convert the file.")
                case ast.Subscript(value=row, slice=ast.Constant(value=str(key))) if self._context_of(row):
                    self._convert_cell(node, row, key)
                case ast.Attribute(value=owner) if self._is_context(owner):
                    yield from self._convert_attribute(node, ast.unparse(owner))
                case ast.Return(value=ast.Name(id=name)) if name in self._rows:
                    others = f"for name, value in {name}.items() if name not in {self._rows[name]}.combination"
                    self._file.edits.replace(node, f"return {{name: value {others}}}")

    def _convert_attribute(self, node: ast.Attribute, context: str) -> Iterator[Finding]:
        if node.attr in self._moved:
            self._file.edits.replace(node, f"self.{node.attr}")
        elif isinstance(node.ctx, ast.Store):
            fix = f"Keep it in self.{node.attr} or under another name there, then convert the file."
            yield self._lacking(node, "a context takes no attributes of your own here", fix)
        elif node.attr == "__dict__":
            yield self._lacking(node, "a context has no __dict__ here", "Take this out, then convert the file.")
        elif node.attr in _ATTRIBUTES:
            self._file.edits.replace(node, f"{context}.{_ATTRIBUTES[node.attr]}")
        elif node.attr in _ROWS:
            self._file.edits.replace(node, "{}" if id(node) in self._given_back else f"dict({context}.combination)")

    def _convert_writing(self, node: ast.Assign, cell: ast.Subscript) -> Iterator[Finding]:
        row, context = cell.value, self._context_of(cell.value)
        match cell.slice:
            case ast.Constant(value=str(key)) if key in self._columns and self._is_row(row):
                start, end = self._file.edits.start_of(node), self._file.edits.start_of(node.value)
                self._file.edits.replace_span(start, end, f"{context}.publish({key!r}, ")
                self._file.edits.insert(self._file.edits.end_of(node.value), ")")
            case ast.Constant(value=str(key)) if key in self._columns and ast.unparse(row) not in self._returned:
                # The variable is a copy of the row, which is read as before.
                published = f"; {context}.publish({key!r}, {ast.unparse(cell)})"
                self._file.edits.insert(self._file.edits.end_of(node), published)
            case _ if self._is_row(row):
                yield self._lacking(node, "this writes into the row of the run table, in none of the data columns")

    def _convert_cell(self, node: ast.Subscript, row: ast.expr, key: str) -> None:
        if key == _RUN_ID:
            self._file.edits.replace(node, f"{self._context_of(row)}.run_id")
        elif self._is_row(row):
            self._file.edits.replace(row, f"{self._context_of(row)}.combination")

    def _lacking(self, node: ast.expr | ast.stmt, problem: str, fix: str = _BY_HAND) -> Finding:
        return Finding.error(f"{self._file.path}:{node.lineno}", problem, fix)

    def _row_variables(self) -> Iterator[tuple[str, str]]:
        """Yield the variables with a row, each with the context of the row."""
        for node in nodes(self._function, ast.Assign):
            match node.targets:
                case [ast.Name(id=name)] if self._is_row(node.value):
                    yield name, self._context_of(node.value)

    def _is_context(self, node: ast.expr) -> bool:
        return isinstance(node, ast.Name | ast.Attribute) and ast.unparse(node) in self._contexts

    def _is_row(self, node: ast.expr) -> bool:
        return isinstance(node, ast.Attribute) and node.attr in _ROWS and self._is_context(node.value)

    def _context_of(self, row: ast.expr) -> str:
        """Return the source text of a row's context; empty if the expression is not a row."""
        match row:
            case ast.Attribute(value=owner) if self._is_row(row):
                return ast.unparse(owner)
            case ast.Name(id=name):
                return self._rows.get(name, "")
            case _:
                return ""
