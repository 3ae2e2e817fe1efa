"""Which files software under test reads, as far as known: those that it is started with, and those that these name.

A launch file or a Compose file names others in its text. An existing file beside it with such a name is taken for one
of them: one too many does no harm, but if one is missing, others cannot start the software.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable, Iterator
from itertools import chain
from pathlib import Path
from types import MappingProxyType

from robot_runner.core.errors import Finding
from robot_runner.core.storage.input_files import InputFile, fits, input_file, kept_copy
from robot_runner.measuring.own_scripts import files_below, is_file, is_installed, modules_beside, text_of, with_named

#: Texts without quotes, as in YAML, and those in quotes, as in everything else.
_PLAIN = re.compile(r"""[^\s"',\[\]{}|<>]+""")
_QUOTED = re.compile(r"""["']([^"'\n]{1,255})["']""")
_YAML = frozenset({".yaml", ".yml"})
#: The kinds of files that are searched for further names.
_NAMING = _YAML | {".launch", ".xml", ".py", ".urdf", ".xacro"}
#: The folder of a launch file of ROS, in that file.
_HERE = re.compile(r"\$\((?:dirname|var __file__)\)/")
_BUILD = re.compile(r"(?:^|[\s{,])(build|context|dockerfile)[ \t]*:[ \t]*[\"']?([^\s\"'#{},]+)", re.MULTILINE)
_COPY = re.compile(r"^\s*(?:COPY|ADD)\s+(.+)$", re.IGNORECASE | re.MULTILINE)

#: The wildcards of `.dockerignore`, as regular expressions. Without ranges: a file too many does no harm.
_WILD = MappingProxyType({"**/": "(?:.*/)?", "**": ".*", "*": "[^/]*", "?": "[^/]"})
_PARTS = re.compile(r"\*\*/|\*\*|.", re.DOTALL)


def is_own_setup(path: Path) -> bool:
    """Return whether a file to source works on its own; that of a workspace does not without the workspace."""
    return not is_installed(path) and not re.fullmatch(r"(?:local_)?setup\.\w+", path.name)


def with_what_it_names(path: Path) -> InputFile:
    """Return a file as an input, with the files that it names by relative paths, and those that they name."""
    return with_named(
        path, lambda each: chain(_named_beside(each), modules_beside(each)) if each.suffix in _NAMING else ()
    )


def compose_input(path: Path) -> InputFile:
    """Return a Compose file as an input, with all that it names beside it; see `_of_compose`."""
    start = kept_copy(path) or path
    beside = [each for each in (start.with_name(".env"),) if each.is_file()]  # Compose always reads it
    return InputFile(path, tuple(dict.fromkeys([*beside, *_named_beside(start), *_of_compose(start)])))


def _named_beside(path: Path) -> Iterator[Path]:
    """Yield the files that a file names by paths relative to its own folder."""
    text = text_of(path)
    folder, into = path.parent, Path()
    if path.suffix in _YAML:
        text = re.sub(r"(?m)(?:^|\s)#.*$", "", text)
        parts = (part for each in _PLAIN.findall(text) for part in (each, each.partition(":")[0]))
        names = [part for part in parts if set("./") & {*part}]
    else:
        names = _QUOTED.findall(text)
    for name in names:
        plain = Path(_HERE.sub("", name))
        # `here / "config" / "nav.yaml"` has a path in several texts.
        beside = [folder / into / plain, folder / plain] if name and not plain.is_absolute() else []
        file = next(filter(is_file, beside), None)
        if file is not None and os.path.normpath(file) != os.path.normpath(path):
            yield Path(os.path.normpath(file))
        into = into / plain if beside and _is_folder(beside[0]) else Path()


def _of_compose(path: Path) -> Iterator[Path]:
    """Yield the files that images are built from, and those in folders that containers can read but not write.

    A folder that they can write to changes with each run, and so is not an input.
    """
    folder, text = path.parent, text_of(path)
    built: list[list[str]] = []  # each context, and its Dockerfile
    for key, name in _BUILD.findall(text):
        if key == "dockerfile" and built:
            built[-1][1] = name
        elif key != "dockerfile" and _is_folder(folder / name):
            built.append([name, "Dockerfile"])
    for context, recipe in built:
        yield from _built_from(folder / context, recipe)
    for token in _PLAIN.findall(text):
        source, _, rest = token.partition(":")
        if rest.endswith(":ro") and not Path(source).is_absolute() and _is_folder(folder / source):
            yield from files_below(folder / source)


def _built_from(context: Path, recipe: str) -> Iterator[Path]:
    """Yield the Dockerfile of an image, and the files that it copies from the folder in which it is built."""
    yield from filter(is_file, [context / recipe, context / ".dockerignore"])
    is_left_out = _left_out(context)
    joined = text_of(context / recipe).replace("\\\n", " ")
    for words in (_PLAIN.findall(each) for each in _COPY.findall(joined)):
        if any(each.startswith("--from") for each in words):
            continue
        for source in [each for each in words if not each.startswith("--")][:-1]:
            yield from (each for each in _copied(context, source.lstrip("/")) if not is_left_out(each))


def _left_out(context: Path) -> Callable[[Path], bool]:
    """Return a function: does a build leave out a file of its folder? In `.dockerignore` the last match counts.

    Source: docs.docker.com, "Build context", ".dockerignore files".
    """
    rules: list[tuple[bool, re.Pattern[str]]] = []
    for line in map(str.strip, text_of(context / ".dockerignore").splitlines()):
        pattern = line.lstrip("!").strip("/")
        if pattern and not line.startswith("#"):
            expression = "".join(_WILD.get(each) or re.escape(each) for each in _PARTS.findall(pattern))
            rules.append((not line.startswith("!"), re.compile(expression, re.DOTALL)))

    def is_left_out(file: Path) -> bool:
        place = Path(os.path.relpath(file, context))
        names = [each.as_posix() for each in (place, *place.parents[:-1])]  # a folder is left out with its content
        said = [leaves for leaves, expression in rules if any(map(expression.fullmatch, names))]
        return bool(said) and said[-1]

    return is_left_out


def _copied(context: Path, source: str) -> Iterator[Path]:
    try:
        found = [context] if source.strip("./") == "" else sorted(context.glob(os.path.normpath(source)))
    except (ValueError, OSError):  # a URL, or no valid pattern
        return
    for each in found:
        yield from [each] if each.is_file() else files_below(each)


def _is_folder(path: Path) -> bool:
    return os.path.isdir(path)  # noqa: PTH112 - as above


def inputs_in(folder: Path | None, inputs: Iterable[InputFile]) -> Iterator[InputFile]:
    """Yield the inputs of software that is executed in this folder as inputs of an experiment.

    Those in that folder become one input, the folder, so that the copies keep their places in it, unless that would be
    too large: then each is an input of its own.
    """
    there = list(map(_with_its_files, inputs))
    inside = [each for each in there if folder is not None and each.path.is_relative_to(folder)]
    starts = [kept_copy(each.path) or each.path for each in inside]
    members = dict.fromkeys([*filter(is_file, starts), *(other for each in inside for other in each.others)])
    if folder is not None and members and fits(members):
        yield InputFile(folder, tuple(members))
    else:
        yield from inside
    yield from (each for each in there if each not in inside)


def missing_findings(where: str, paths: Iterable[Path | None]) -> Iterator[Finding]:
    """Yield a warning for each file that is named and not there; None is a path on another computer."""
    for path in paths:
        if path is not None and not os.path.exists(input_file(path)):  # noqa: PTH110 - any word
            fix = "Correct its name, which is relative to the folder that the program is executed in, or leave it out."
            yield Finding.warning(where, f"it is to read {str(path)!r}, which is not there: a package lacks it", fix)


def _with_its_files(each: InputFile) -> InputFile:
    start = kept_copy(each.path) or each.path
    return InputFile(each.path, tuple(files_below(start))) if _is_folder(start) else each
