"""The user's own scripts in a command, and the modules beside them: a package has to contain these."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import islice
from pathlib import Path

from robot_runner.core.errors import Finding
from robot_runner.core.storage.input_files import InputFile, input_file, kept_copy

#: Folders of the system and of installed programs: every machine has its own.
_INSTALLED = ("/bin", "/sbin", "/lib", "/usr", "/opt", "/dev", "/proc", "/sys", "/etc", "/snap", "/nix")
#: Interpreters, by a pattern of their names: option letters that are followed by a program instead of a file, and
#: letters that have a value, in the same or the next word (from the manual of each).
_INTERPRETERS = {
    r"python[\d.]*": ("cm", "WX"),
    r"(?:ba|da|z|k|fi)?sh": ("cs", "oO"),
    r"perl[\d.]*": ("eE", "IMm"),
    r"ruby[\d.]*": ("e", "IrC"),
    r"node(?:js)?": ("ep", "rC"),
    r"julia": ("eE", "tpLJC"),
    r"lua[\d.]*": ("e", "l"),
    r"php[\d.]*": ("r", "dcz"),
    r"Rscript": ("e", ""),
    r"octave": ("", "p"),
}
#: Programs that execute the command which follows their own options.
_WRAPPER = re.compile(
    "chrt|doas|env|ionice|nice|nohup|numactl|prlimit|setsid|stdbuf|sudo|taskset|time|timeout|unbuffer|xvfb-run"
)
#: Programs that execute what follows their `run` in an environment: a command, or a script of Python.
_ENVIRONMENTS = re.compile("conda|hatch|mamba|micromamba|pdm|pipenv|pixi|poetry|rye|uv")

_IMPORT = re.compile(r"^[ \t]*(?:from[ \t]+([\w.]+)[ \t]+import|import[ \t]+([\w., \t]+))", re.MULTILINE)
#: In how many files to search for further ones, and how large such a file may be, bytes.
_MOST_NAMING, _LARGEST_NAMING = 200, 1_000_000
#: Folders that software under test does not read, or writes while it is executed.
_NOT_READ = frozenset({"__pycache__", "node_modules"})
_MOST_FILES = 5001  # one more than is kept of any input


def is_installed(path: Path) -> bool:
    """Return whether a path lies where the system and its packages are."""
    return str(path).startswith(tuple(f"{each}/" for each in _INSTALLED))


def scripts_in(words: Sequence[str]) -> Iterator[str]:
    """Yield the files that a command executes: a program of the user's own, and a script for an interpreter.

    Example:
        >>> list(scripts_in(["python3", "-u", "planner.py", "--map", "hall.yaml"])), list(scripts_in(["planner"]))
        (['planner.py'], [])
    """
    program, *rest = words
    path = Path(program)
    options = _options_of(path.name)
    # The interpreter itself is left out: a copy of a virtual environment's Python would find none of its packages.
    is_of_environment = options is not None and (path.parent.parent / "pyvenv.cfg").is_file()
    if _is_own(program) and not is_of_environment:
        yield program
    if options is not None:
        yield from _script_behind(rest, *options)
    elif _WRAPPER.fullmatch(path.name):
        behind = (place for place, each in enumerate(rest) if _is_own(each) or _options_of(Path(each).name))
        if (start := next(behind, None)) is not None:
            yield from scripts_in(rest[start:])
    elif _ENVIRONMENTS.fullmatch(path.name) and "run" in rest:
        yield from _scripts_run(rest[rest.index("run") + 1 :])


def _scripts_run(words: Sequence[str]) -> Iterator[str]:
    """Yield the files that `uv run` and its like execute: options and their values come first."""
    for place, word in enumerate(words):
        if word.endswith(".py"):
            yield word
            return
        if _is_own(word) or _options_of(Path(word).name):
            yield from scripts_in(words[place:])
            return


def _is_own(word: str) -> bool:
    """Return whether an argument is a path of the user's: no option, no assignment, and no installed program."""
    return "/" in word and "=" not in word and not word.startswith("-") and not is_installed(Path(word))


def _options_of(program: str) -> tuple[str, str] | None:
    return next((options for pattern, options in _INTERPRETERS.items() if re.fullmatch(pattern, program)), None)


def _script_behind(words: Sequence[str], inline: str, valued: str) -> Iterator[str]:
    """Yield the script that an interpreter executes, unless an option has the program."""
    left = iter(words)
    for word in left:
        if not word.startswith(("-", "+")) or word == "--":
            yield from islice(left, 1) if word == "--" else [word]
            return
        letters = "" if word.startswith("--") else word[1:]
        first = next((each for each in letters if each in inline + valued), "")
        if word == "-" or (first and first in inline):
            return
        if first and letters.endswith(first):
            next(left, None)


def script_inputs(paths: Iterable[Path]) -> Iterator[InputFile]:
    """Yield programs and scripts as inputs, with the modules beside them that they import.

    A program that the user may execute but not read cannot be kept: see `unread_findings`.
    """
    for path in paths:
        found = input_file(path)
        # Python and Node execute folders, too. Modules that they compile are not inputs.
        if os.path.isdir(found):  # noqa: PTH112 - false of a name that no path can have
            yield InputFile(path, tuple(files_below(found)))
        elif os.access(found, os.R_OK):
            yield with_named(path, modules_beside)


def unread_findings(where: str, paths: Iterable[Path]) -> Iterator[Finding]:
    """Yield a warning for each program that can be executed but not read: a package lacks it."""
    for path in paths:
        found = input_file(path)
        if is_file(found) and not os.access(found, os.R_OK):
            fix = f"Make it readable (chmod +r {found}), or say in the package where it comes from."
            yield Finding.warning(where, f"the program {str(path)!r} cannot be read: a package lacks it", fix)


def with_named(path: Path, look: Callable[[Path], Iterable[Path]]) -> InputFile:
    """Return a file as an input, with the files that `look` finds in it, and those that it finds in them."""
    found = {kept_copy(path) or path: None}
    for place in range(_MOST_NAMING):
        each = next(islice(found, place, None), None)  # `found` grows in this loop
        if each is not None:
            found |= dict.fromkeys(look(each))
    return InputFile(path, tuple(found)[1:])


def modules_beside(path: Path) -> Iterator[Path]:
    """Yield the modules that a Python file imports from its own folder."""
    for names in _IMPORT.findall(text_of(path)) if path.suffix == ".py" else ():
        for name in {each.split()[0].partition(".")[0] for part in names for each in part.split(",") if each.strip()}:
            package = path.parent / name
            yield from filter(is_file, [package.with_name(f"{name}.py")] if name else ())
            if name and is_file(package / "__init__.py"):
                yield from files_below(package)


def text_of(path: Path) -> str:
    """Return the text of a file; empty where it cannot be read, or is too large to be searched for names of files."""
    try:
        if path.is_file() and path.stat().st_size <= _LARGEST_NAMING:
            return path.read_text(encoding="utf-8", errors="replace")
    except OSError:  # the program that reads it reports that
        pass
    return ""


def files_below(folder: Path) -> Iterator[Path]:
    """Yield the files in a folder and below it, except in hidden folders and results of experiments."""
    return islice(_walked(folder), _MOST_FILES)


def _walked(folder: Path) -> Iterator[Path]:
    for place, folders, names in os.walk(folder):
        if {"manifest.json", "run_table.csv"} <= set(names):
            folders.clear()
            continue
        folders[:] = sorted(each for each in folders if not each.startswith(".") and each not in _NOT_READ)
        yield from (Path(place, name) for name in sorted(names))


def is_file(path: Path) -> bool:
    """Return whether a path, which may be any text, is that of a file."""
    return os.path.isfile(path)  # noqa: PTH113 - false of a name that no path can have
