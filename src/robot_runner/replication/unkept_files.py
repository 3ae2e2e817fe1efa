"""Find the files and modules that a config needs and a package lacks, by its code, of which nothing is executed."""

from __future__ import annotations

import ast
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path, PurePosixPath

from robot_runner.core.config.source import name_of, tree_or_empty
from robot_runner.core.errors import Finding
from robot_runner.core.storage.guarded_files import read_text
from robot_runner.core.storage.input_files import copies_in
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.replication.distributions import canonical
from robot_runner.replication.environment import RecordedEnvironment, modules_to_install, owners_of, place_of

#: Functions that read the file that is their first argument, beside those whose names begin with `read_`.
_READING = frozenset({"genfromtxt", "imread", "load", "loadtxt", "open"})
_READING_METHODS = frozenset({"read_bytes", "read_text"})
#: Methods of the paths of folders, and functions of folders, that list what is in them.
_LISTING_METHODS, _LISTING = frozenset({"glob", "iterdir", "rglob"}), frozenset({"listdir", "scandir", "walk"})
_MODE = re.compile(r"[rwaxbtU+]{1,4}")
#: Functions that execute a program, whose first two words may be an interpreter and its script.
_EXECUTING = frozenset({"Popen", "call", "check_call", "check_output", "run", "system"})
#: Calls that neither read nor change the file that they name.
_NAMING = frozenset({"Path", "PurePath", "exists", "is_file", "isfile", "print", "str"})
_JOINING = frozenset({"Path", "PurePath", "fspath", "join", "str"})
#: Methods of paths that yield paths.
_OF_PATHS = frozenset({"absolute", "as_posix", "expanduser", "joinpath", "resolve"})
_FILE = re.compile(r"[^/\0\n]+\.\w{1,8}")
#: The most names by way of which a path is looked up: they may name each other.
_DEEPEST = 8
#: The folder of ROS's distributions.
_ROS = Path("/opt/ros")
_OF_SYSTEM = re.compile(r"/(?:bin|dev|etc|lib\w*|opt|proc|run|sbin|sys|tmp|usr|var)/")

#: Whether a path begins at the config's own file, and what constants of the code add to that.
_Named = tuple[bool, str]
_Assigned = Mapping[str, list[ast.expr]]


def unkept_files(files: ExperimentFolder, stored: Iterable[str]) -> Iterator[Finding]:
    """Yield a warning for each file that the code of a config reads by a constant name and a package lacks.

    Files that the config writes as well are its own; names that the code computes are not known.

    Args:
        files: the experiment's folder.
        stored: the names of the files in the package.

    Raises:
        StorageError: a file of the config cannot be read.
    """
    known = {part for name in stored for part in PurePosixPath(name).parts}
    for path in sorted(set(files.config.rglob("*.py")) - copies_in(files.config)):
        tree = tree_or_empty(read_text(path, files.root, errors="replace"))
        for line, name in sorted(_read_files(tree)):
            if PurePosixPath(name).name not in known:
                where = f"{path.relative_to(files.root).as_posix()}:{line}"
                problem = f"the config needs {name}, which is not in the package: a replication will not find it"
                fix = (
                    f"Put a copy below {files.config} where the code looks for it, from Path(__file__) on, and pack "
                    "again; what the config's method input_files returns is kept with each later experiment."
                )
                yield Finding.warning(where, problem, fix)


def unkept_modules(files: ExperimentFolder, environment: RecordedEnvironment) -> Iterator[Finding]:
    """Yield a warning for each module that a config imports and that no recorded package of Python brings.

    Such as one of a sourced workspace of ROS, or one that the system's package manager installed. Those of ROS's own
    distribution come with the recorded ROS. If the experiment is packed elsewhere, modules that are not there are
    passed over: they may be those of a recorded package.

    Raises:
        OSError: a file of the config cannot be read.
    """
    ours = environment.packages.get("robot-runner")
    is_elsewhere = ours is None or ours.source is None
    for name in sorted(modules_to_install(files.config)):
        place = place_of(name)
        is_of_ros = environment.manifest.get("ros") and place is not None and _ROS in place.parents
        is_recorded = any(canonical(each) in environment.packages for each in owners_of(name))
        if is_recorded or is_of_ros or (is_elsewhere and place is None):
            continue
        told = f"{name}, from {place}," if place else f"{name},"
        problem = f"the config imports {told} which no package of Python that was recorded brings"
        fix = (
            f"Install it by pip and execute the experiment with that, or put a copy of its code into {files.config} "
            "and pack again; otherwise say in the package where it can be had."
        )
        yield Finding.warning("config", f"{problem}: a replication will not find it", fix)


def _read_files(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Yield line and name of each file that is read, and that no other call is given."""
    assigned = _assigned_in(tree)
    read: dict[str, int] = {}
    changed: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            file = _file_read_by(node)
            if file is not None and (name := _file_name(file, assigned)):
                read.setdefault(name, node.lineno)
            elif (listed := _folder_listed_by(node)) is not None:
                is_beside, name = _named(listed, assigned, 0) or (False, "")
                read |= {name: read.get(name, node.lineno)} if is_beside and name else {}
            elif name := _program_executed_by(node, assigned):
                read.setdefault(name, node.lineno)
            elif file is None and name_of(node.func) not in _NAMING | _JOINING | _OF_PATHS:
                receiver = [node.func.value] if isinstance(node.func, ast.Attribute) else []
                given = [*receiver, *node.args, *(each.value for each in node.keywords)]
                given += [each for listed in given if isinstance(listed, ast.List | ast.Tuple) for each in listed.elts]
                changed |= {_file_name(each, assigned) for each in given}
    yield from ((line, name) for name, line in read.items() if name not in changed)


def _assigned_in(tree: ast.Module) -> _Assigned:
    """Return the expressions that names and attributes of the code are given."""
    found: defaultdict[str, list[ast.expr]] = defaultdict(list)
    for node in ast.walk(tree):
        match node:
            case ast.Assign(targets=[ast.Name(id=name) | ast.Attribute(attr=name)], value=value):
                found[name].append(value)
            case ast.AnnAssign(target=ast.Name(id=name) | ast.Attribute(attr=name), value=ast.expr() as value):
                found[name].append(value)
    return found


def _file_read_by(call: ast.Call) -> ast.expr | None:
    """Return what names the file that a call reads; None if it reads none."""
    name, file = name_of(call.func), next(iter(call.args), None)
    if isinstance(call.func, ast.Attribute) and (name in _READING_METHODS or (name == "open" and _is_mode(file))):
        mode, file = file, call.func.value
    else:
        mode = call.args[1] if len(call.args) > 1 else None
    if name == "open":
        mode = next((each.value for each in call.keywords if each.arg == "mode"), mode)
        is_reading = mode is None or (isinstance(mode, ast.Constant) and not set("wax+") & set(str(mode.value)))
        return file if is_reading else None
    return file if name in _READING | _READING_METHODS or name.startswith("read_") else None


def _folder_listed_by(call: ast.Call) -> ast.expr | None:
    """Return what names the folder whose files a call lists; None if it lists none."""
    if isinstance(call.func, ast.Attribute) and name_of(call.func) in _LISTING_METHODS:
        return call.func.value
    return call.args[0] if call.args and name_of(call.func) in _LISTING else None


def _program_executed_by(call: ast.Call, assigned: _Assigned) -> str:
    """Return the name of the program or script beside the config that a call executes; empty for any other."""
    words = call.args[0] if call.args and name_of(call.func) in _EXECUTING else None
    for word in words.elts[:2] if isinstance(words, ast.List | ast.Tuple) else [words] if words else []:
        is_beside, name = _named(word, assigned, 0) or (False, "")
        if is_beside and name:
            return name
    return ""


def _is_mode(node: ast.expr | None) -> bool:
    """Whether the first argument of a method `open` is a mode, so that the path is the object of the method."""
    return node is None or (isinstance(node, ast.Constant) and _MODE.fullmatch(str(node.value)) is not None)


def _file_name(node: ast.expr, assigned: _Assigned) -> str:
    """Return the name of a file; empty for anything else, and for files of the system."""
    _, name = _named(node, assigned, 0) or (False, "")
    return name if _FILE.fullmatch(PurePosixPath(name).name) and not _OF_SYSTEM.match(name) else ""


def _named(node: ast.expr, assigned: _Assigned, depth: int) -> _Named | None:
    """Return the path that an expression names; None where the code computes it from anything else."""
    if parts := _parts_of(node):
        return _joined(parts, assigned, depth)
    match node:
        case ast.Constant(value=str(text)):
            return False, text
        case ast.Name(id=name) | ast.Attribute(value=ast.Name(id="self" | "cls"), attr=name) if name in assigned:
            values = assigned[name]
            return _named(values[0], assigned, depth + 1) if len(values) == 1 and depth < _DEEPEST else None
        case ast.Attribute(value=base, attr="parent") if _named(base, assigned, depth) == (True, ""):
            return True, ""
        case _:
            return (True, "") if _is_config_file(node) else None


def _parts_of(node: ast.expr) -> list[ast.expr]:
    """Return the expressions that are joined to a path; none for anything else."""
    match node:
        case ast.BinOp(left=left, op=ast.Div(), right=right):
            return [left, right]
        case ast.Call(func=ast.Attribute(value=base, attr=name), args=parts) if name in _OF_PATHS:
            return [base, *parts]
        case ast.Call(args=parts) if name_of(node.func) in _JOINING:
            return parts
        case _:
            return []


def _is_config_file(node: ast.expr) -> bool:
    """Whether an expression computes a path from that of the config, or of a package beside it."""
    if isinstance(node, ast.Call) and name_of(node.func) == "files":  # of importlib.resources
        return True
    return any(isinstance(each, ast.Name) and each.id == "__file__" for each in ast.walk(node))


def _joined(nodes: list[ast.expr], assigned: _Assigned, depth: int) -> _Named | None:
    parts = [_named(each, assigned, depth) for each in nodes]
    if None in parts or any(is_beside for is_beside, _ in filter(None, parts[1:])):
        return None
    known = [each for each in parts if each is not None]
    return known[0][0], "/".join(text for _, text in known if text)
