"""Find secrets in Python code: values of names such as `password`, and secrets in comments."""

from __future__ import annotations

import ast
import io
import re
import tokenize
from collections.abc import Iterable, Iterator
from itertools import accumulate

from robot_runner.core.config.source import name_of, tree_or_empty
from robot_runner.core.secret_names import is_placeholder, is_secret_name
from robot_runner.replication.named_secrets import Grammar, is_secret_value, named_secrets
from robot_runner.replication.secret_kinds import Found

_SHORTEST = 5
#: Common logins of robots, and default values: elsewhere in the folder, these words are not secrets.
_COMMON_TEXT = (
    "admin change changeme default guest password postgres public raspberry robot secret simulated student "
    "test token turtlebot turtlebot3 ubuntu video"
)
_COMMON = frozenset(_COMMON_TEXT.split())
_WITH_DEFAULT = frozenset({"getenv", "get", "setdefault", "setenv", "putenv", "pop"})
_Pair = tuple[ast.AST | None, ast.AST | None]


def secrets_in_code(text: str) -> set[str]:
    """Return the values of names such as `password` in Python code; none if it does not parse.

    Short values and common words are left out, since they would match too much in other files.

    Example:
        >>> sorted(secrets_in_code('wifi_password = "swordfish"; connect(token="open-sesame", user="ada")'))
        ['open-sesame', 'swordfish']
    """
    values = {_text_of(value) for value in _secret_values(tree_or_empty(text))}
    return {value for value in values if len(value) >= _SHORTEST and value.casefold() not in _COMMON}


def found_in_code(code: bytes) -> Iterator[Found]:
    """Yield the secrets in the code and the comments of a Python file; replacing them keeps the code valid."""
    try:
        text = code.decode("utf-8")
    except UnicodeDecodeError:
        return
    tree = tree_or_empty(text)
    starts = [0, *accumulate(len(line) for line in code.splitlines(keepends=True))]
    for node in _secret_values(tree):
        start, end = _span(node, starts)
        yield Found(start, end, "password", start, _instead_of(node, code[start:end]))
    for node in _listed_values(tree):
        start, end = _span(node, starts)
        yield Found(start, end, "what may be a password", start, _instead_of(node, code[start:end]), is_sure=False)
    yield from _in_texts(tree, code, starts)
    yield from _in_comments(text, code, starts)


def _span(node: ast.expr, starts: list[int]) -> tuple[int, int]:
    """Return where a node begins and ends in the code, bytes, from where its lines start."""
    # The parser gives each node an end, which its type leaves open.
    end = starts[(node.end_lineno or node.lineno) - 1] + (node.end_col_offset or 0)
    return starts[node.lineno - 1] + node.col_offset, end


#: In a text of the code, such as one that names a database: `host=db user=ada password=X`.
_SETTING = re.compile(rb"(?<![\w.?&-])(?P<name>[A-Za-z_][\w.-]*)=(?P<value>[^\s\"'`,;&<>\\(){}\[\]%$]{4,})")
#: A line of YAML or INI in a text of the code: `password: X`. A mere word is what messages tell, as in `auth: failed`.
_LINE = re.compile(
    rb"(?:^|\\n|[\"'])[ \t]*(?:-[ \t]+)?(?P<name>[A-Za-z_][\w.-]*)[ \t]*[:=][ \t]*(?![A-Za-z]+(?:[\s\"'\\]|\Z))"
    rb"(?P<value>[^\s\"'`,;&<>\\(){}\[\]%$]{4,})[ \t]*(?=\r?$|\\[rn]|[\"'])",
    re.MULTILINE,
)


def _in_texts(tree: ast.Module, code: bytes, starts: list[int]) -> Iterator[Found]:
    described = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}  # docstrings
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr) or (isinstance(node, ast.Constant) and isinstance(node.value, str)):
            forms = (_SETTING,) if id(node) in described else (_SETTING, _LINE)
            for match in (each for form in forms for each in form.finditer(code, *_span(node, starts))):
                name = match["name"].decode("ascii", "replace")
                if is_secret_name(name) and is_secret_value(match["value"], name):
                    yield Found(*match.span("value"), "password", match.start())


def _instead_of(node: ast.expr, source: bytes) -> bytes:
    is_bytes = isinstance(node, ast.Constant) and isinstance(node.value, bytes)
    quote = b"'" if source.lstrip(b"rbfuRBFU").startswith(b"'") else b'"'
    return (b"b" if is_bytes else b"") + quote + b"REDACTED" + quote


def _secret_values(tree: ast.Module) -> Iterator[ast.expr]:
    """Yield the nodes of values with a secret's name; f-strings only if their constant parts are long enough."""
    for node in ast.walk(tree):
        for target, value in _pairs(node):
            if isinstance(value, ast.expr) and is_secret_name(_name_of(target)) and _is_secret(value):
                yield value


def _listed_values(tree: ast.Module) -> Iterator[ast.expr]:
    """Yield the texts in a list, or in a mapping without a secret's name in it, that has a secret's name."""
    for target, value in (pair for node in ast.walk(tree) for pair in _pairs(node)):
        listed: list[ast.expr] = []
        match value:
            case ast.List(elts=values) | ast.Set(elts=values) | ast.Tuple(elts=values):
                listed = values
            case ast.Dict(keys=keys, values=values) if not any(is_secret_name(_name_of(key)) for key in keys):
                listed = values
            case _:
                pass
        if is_secret_name(_name_of(target)):  # which may also list the names of secrets
            yield from (each for each in listed if _is_secret(each) and not is_secret_name(_text_of(each)))


def _is_secret(value: ast.expr) -> bool:
    if isinstance(value, ast.JoinedStr):
        return len(_text_of(value)) >= _SHORTEST * 2
    if not isinstance(value, ast.Constant) or not isinstance(value.value, str | bytes):
        return False
    text = _text_of(value)
    is_path = text.startswith(("/", "~/", "./")) and "/" in text[1:]
    return not is_placeholder(text) and not is_path and not text.startswith(("http://", "https://", "-"))


def _text_of(value: ast.expr) -> str:
    if isinstance(value, ast.JoinedStr):
        return "".join(_text_of(part) for part in value.values if isinstance(part, ast.Constant))
    content = value.value if isinstance(value, ast.Constant) else ""
    return content.decode("utf-8", "surrogateescape") if isinstance(content, bytes) else str(content)


def _pairs(node: ast.AST) -> Iterable[_Pair]:
    """Return the names that a node assigns or passes, with their values."""
    pairs: Iterable[_Pair] = ()
    match node:
        case ast.Assign(targets=targets, value=value):
            pairs = [pair for target in targets for pair in _assigned(target, value)]
        case ast.AnnAssign(target=target, value=value) | ast.NamedExpr(target=target, value=value):
            pairs = [(target, value)]
        case ast.keyword(arg=str(name), value=value):
            pairs = [(ast.Name(name), each) for each in _last_of_pair(name, value)]
        case ast.Dict(keys=keys, values=values):
            pairs = zip(keys, values, strict=True)
        case ast.arguments():
            positional = [*node.posonlyargs, *node.args]
            with_default = [*positional[len(positional) - len(node.defaults) :], *node.kwonlyargs]
            names = [ast.Name(argument.arg) for argument in with_default]
            pairs = zip(names, [*node.defaults, *node.kw_defaults], strict=True)
        case ast.Call(args=[ast.Constant(value=str()) as name, *others], keywords=keywords):
            given = [each.value for each in keywords if each.arg in {"default_value", "default", "value"}]
            pairs = [(name, each) for each in [*given, *(others if name_of(node.func) in _WITH_DEFAULT else ())]]
    return pairs


def _assigned(target: ast.expr, value: ast.expr) -> Iterator[_Pair]:
    """Yield names with their values; `user, password = "ada", "X"` has two."""
    if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple) and len(target.elts) == len(value.elts):
        yield from zip(target.elts, value.elts, strict=True)
    else:
        for each in _last_of_pair(_name_of(target), value):
            yield target, each


def _last_of_pair(name: str, value: ast.expr) -> list[ast.expr]:
    """Return the value; for `auth = ("ada", "X")` the second one."""
    if name.casefold().endswith("auth") and isinstance(value, ast.Tuple) and len(value.elts) == 2:  # noqa: PLR2004 - a pair
        return [value.elts[1]]
    return [value]


def _name_of(target: ast.AST | None) -> str:
    match target:
        case ast.Constant(value=str(name)):
            return name
        case ast.Subscript(slice=key):
            return _name_of(key)
    return name_of(target)


def _in_comments(text: str, code: bytes, starts: list[int]) -> Iterator[Found]:
    try:
        tokens = list(tokenize.generate_tokens(io.StringIO(text, newline="").readline))
    except (tokenize.TokenError, SyntaxError):
        return
    for token in tokens:
        if token.type == tokenize.COMMENT:
            start = starts[token.start[0] - 1] + len(token.line[: token.start[1]].encode())
            comment = code[start : start + len(token.string.encode())]
            for found in named_secrets(comment, Grammar.TEXT):
                yield found._replace(start=start + found.start, end=start + found.end, begin=start + found.begin)
