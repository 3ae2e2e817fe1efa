"""The modules that a config imports and that are not installed: those beside it, and others of this machine.

They are kept with the results, so that they can be imported from the kept config, and go to workers and replications.
"""

from __future__ import annotations

import ast
import hashlib
import json
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import cache
from importlib.machinery import PathFinder
from pathlib import Path
from types import ModuleType
from urllib.parse import unquote, urlsplit

from robot_runner.core.config.source import tree_of
from robot_runner.core.errors import Finding
from robot_runner.core.treatments import CONFIG_MODULE

#: Python's modules and ours, which may be below the config's folder, too, if that is the home folder.
_OF_NO_CONFIG = (Path(os.__file__).parent, Path(__file__).parents[2])
_NO_CONFIGS = tuple(f"{each}/" for each in _OF_NO_CONFIG)
_OURS, _OUR_NAME = __name__.partition(".")[0], "robot-runner"
_PACKAGE = "__init__.py"


def local_modules_among(config: Path, names: set[str]) -> dict[Path, Path]:
    """Return the files of the modules `names`, and of those that the config and its callbacks import.

    Modules outside the config's folder are found by import statements, as the process may have loaded others for other
    reasons. Each has its path relative to the config's folder: its own, or by the name of its module.
    """
    folder = config.parent
    # `__mp_main__`, the main program under `multiprocessing`, may be below the config's folder, but is not part of it.
    files = {_file_of(sys.modules.get(name)) for name in names - {"__mp_main__"}}
    # What stands in an archive, or removed itself once it was imported, is no file.
    loaded = {path for path in files if path is not None and is_local(path, folder) and path.is_file()}
    found = imported_files({path: path.relative_to(folder) for path in (config, *loaded)}, folder)
    del found[config]
    return dict(sorted(found.items()))


def _file_of(module: object) -> Path | None:
    """Return the file of a module; None for a mock object that has any attribute."""
    try:
        file = getattr(module, "__file__", None)
    except Exception:  # noqa: BLE001 - a stranger's code: a package may import its own modules only here, and in vain
        return None
    return _without_dots(file) if isinstance(file, str | os.PathLike) else None


def _without_dots(path: str | os.PathLike[str]) -> Path:
    """Return a path without `..`, which a config may have added to `sys.path`."""
    return Path(os.path.abspath(path))  # noqa: PTH100 - links are kept


def is_local(path: Path, folder: Path) -> bool:
    """Return whether a file is below a folder, and is neither installed there nor Python's or ours."""
    return folder in path.parents and not _is_installed(path)


def _is_installed(path: Path) -> bool:
    return not {"site-packages", "dist-packages"}.isdisjoint(path.parts) or any(
        each in path.parents for each in _OF_NO_CONFIG
    )


def _is_elsewhere(path: Path) -> bool:
    """Return whether a file is not installed, not even as editable."""
    return not _is_installed(path) and not any(each in path.parents for each in editable_folders())


@cache
def editable_folders() -> Mapping[Path, str]:
    """Return the folders of editable installations (`pip install --editable`), each with its distribution's name.

    A package of the experiment has them as wheels. Ours is left out, as there may be anything in our clone.
    """
    from importlib.metadata import distributions  # noqa: PLC0415 - few configs import from elsewhere

    found = {}
    for each in distributions():
        is_editable = False
        with suppress(ValueError, AttributeError):  # an installer may have written another form
            told = json.loads(each.read_text("direct_url.json") or "{}")
            address = urlsplit(str(told.get("url", "")))
            is_editable = address.scheme == "file" and told.get("dir_info", {}).get("editable")
        if is_editable and (name := str(each.metadata["Name"])) != _OUR_NAME:
            found[Path(unquote(address.path))] = name
    return found


def imported_files(files: Mapping[Path, Path], folder: Path) -> dict[Path, Path]:
    """Return these Python files, and those that they import anywhere in their code, without executing them.

    Each has its path relative to `folder`, the config's.
    """
    searched = [_without_dots(each) for each in sys.path]
    roots = [str(each) for each in searched if not _is_installed(each / "_")]
    beside = [each for each in roots if is_local(Path(each, "_"), folder)]
    found, unread = dict(files), list(files)
    places = set(found.values())
    while unread:
        path = unread.pop()
        for each, place in _imported_by(path, found[path], lambda top: beside if _is_known(top) else roots):
            is_here = is_local(each, folder)
            if not _is_meant(each, place, is_here=is_here):
                continue
            if is_here:
                place = each.relative_to(folder)  # noqa: PLW2901 - where it stands, whatever root it was found by
            elif each.suffix != ".py" or not _is_elsewhere(each) or place in places:
                continue  # a module of the same name beside the config comes first
            if each not in found:
                found[each] = place
                places.add(place)
                unread.append(each)
    return found


def _is_meant(path: Path, place: Path, *, is_here: bool) -> bool:
    """Return whether importing this name leads to the file, and not to a stand-in for an earlier tool's module."""
    root, top = path.parents[len(place.parts) - 1], place.parts[0].removesuffix(".py")
    named = place.parent if place.name == _PACKAGE else place.with_suffix("")
    module = sys.modules.get(".".join(named.parts))
    if module is not None:
        file = _file_of(module)
        # An object without a file was put there by the module itself: `sys.modules[__name__] = Settings()`.
        return file == path if file is not None else type(module) is not ModuleType
    package = sys.modules.get(top)
    folders = getattr(package, "__path__", None)
    if not isinstance(folders, Iterable):  # no package: Python's own `code`, called like a folder here by chance
        return package is None or is_here
    return root / top in map(_without_dots, folders)


def _is_known(top: str) -> bool:
    """Return whether a module is Python's, or was imported from an installed distribution."""
    file = _file_of(sys.modules.get(top))
    return top in sys.stdlib_module_names or (file is not None and _is_installed(file))


def _imported_by(path: Path, place: Path, roots_of: Callable[[str], Sequence[str]]) -> Iterator[tuple[Path, Path]]:
    """Yield the files that a file imports, each with its path by the name of the module."""
    for node in ast.walk(tree_of(path)):
        match node:
            case ast.Import(names=names):
                for each in names:
                    yield from _files_of(each.name, roots_of(each.name.partition(".")[0]), Path())
            case ast.ImportFrom(module=module, names=names, level=level):
                own = [str(each) for each in path.parents[level - 1 : level]]
                package = own if level else roots_of(str(module).partition(".")[0])
                within = place.parents[min(level, len(place.parents)) - 1] if level else Path()
                for each in names:
                    yield from _files_of(".".join(filter(None, (module, each.name))), package, within)


def _files_of(module: str, places: Sequence[str], within: Path) -> Iterator[tuple[Path, Path]]:
    """Yield the existing files of a module and of its parent packages, with their paths."""
    if module.partition(".")[0] == _OURS:
        return  # a config may stand at the root of our own repository
    for part in module.split("."):
        spec = PathFinder.find_spec(part, places)
        if spec is None:
            return
        within /= part
        path = Path(spec.origin or "")
        if path.is_file():
            yield path, within / _PACKAGE if path.name == _PACKAGE else within.with_name(path.name)
        places = list(spec.submodule_search_locations or ())


def check_neighbours(folder: Path) -> Iterator[Finding]:
    """Yield a warning for each file beside a config that is named like a module of Python's, or an installed one.

    The config's folder comes first on the path, as a script's does: a `random.py` there is imported by plugins, too.
    """
    installed = [each for each in sys.path if _is_installed(Path(each, "_"))]
    places = {*folder.glob("*.py"), *(each.parent for each in folder.glob("*/__init__.py"))}
    for place in sorted(places - {folder / "test.py", folder / "test"}):  # only Python's own tests import that one
        name = place.name.removesuffix(".py")
        kind = "Python's own" if name in sys.stdlib_module_names else "the installed"
        is_importable = place.suffix == ".py" and name.isidentifier()  # of `plot.numpy` the finder looks for `numpy`
        if kind == "Python's own" or (is_importable and PathFinder.find_spec(name, installed)):
            problem = f"the file is called like {kind} module {name!r}, and is imported in its place"
            yield Finding.warning(str(place), problem, f"Give it another name: my_{place.name}.")


def editable_code() -> dict[str, str]:
    """Return a digest of the code of each editable distribution that was imported, by its name.

    Its version does not change with its files.
    """
    found: dict[str, set[Path]] = {}
    for name, module in list(sys.modules.items()):
        file, top = str(getattr(module, "__file__", None)), sys.modules.get(name.partition(".")[0])
        # As texts, not paths, for speed: there are hundreds of modules.
        is_installed = file.startswith(_NO_CONFIGS) or "-packages/" in file
        if top is None or is_installed or name == CONFIG_MODULE or not file.endswith(".py"):
            continue
        folders = editable_folders()
        for folder in folders.keys() & set(Path(file).parents):
            found.setdefault(folders[folder], set()).update(_files_of_package(top))
    return {name: _digest(files) for name, files in sorted(found.items())}


def _files_of_package(module: object) -> set[Path]:
    path = Path(str(getattr(module, "__file__", None) or next(iter(getattr(module, "__path__", [""])))))
    if path.name == _PACKAGE:
        path = path.parent
    return {path} if path.is_file() else set(path.rglob("*.py"))


def _digest(files: set[Path]) -> str:
    digest = hashlib.sha256()
    for path in sorted(files):
        digest.update(f"{path.name}\0".encode() + hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()[:16]
