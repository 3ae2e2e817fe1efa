"""Files that an experiment reads beside its code, such as a room or a bag: kept, and found again in a replication.

The experiment's folder has copies of them below its config, and an index. Where a package is executed again, plugins
read the copy in place of the path that the config names.
"""

# Without `from __future__ import annotations`: a TypedDict would not see which of its keys are required.
import hashlib
import json
import os
import shutil
import stat
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import NotRequired, TypedDict

from robot_runner.core.errors import Finding, StorageError
from robot_runner.core.storage.declared_shapes import faults_of
from robot_runner.core.storage.guarded_files import TEXT_LIMIT, read_bytes, read_json, replace
from robot_runner.core.storage.system_refusals import storage_errors
from robot_runner.core.words import listed

#: The name of the index, beside the config.
INDEX = "input_files.json"
#: The environment variable with the folder of the index in use, for this process and those that it starts.
_VARIABLE = "ROBOT_RUNNER_INPUT_FILES"
#: The environment variable with the folder of the copies, where it is another one.
_WORKING = "ROBOT_RUNNER_WORKING_FILES"
#: Larger inputs are not copied, bytes: people send experiment folders to each other, and a copy is compared with its
#: original at each resumption.
_LARGEST = TEXT_LIMIT
#: Of larger inputs there is no checksum, bytes: reading them takes a minute or more.
_LARGEST_SUMMED = 16 << 30
#: Inputs with more files are not copied, and only their size is compared.
_MOST_FILES = 5000
#: The folder for copies of files that are outside the folder of the config.
_ELSEWHERE = "elsewhere"


@dataclass(frozen=True, slots=True)
class InputFile:
    """A file or folder that a plugin or the link to a robot reads.

    Attributes:
        path: as the config names it, which may be a text; a folder stands for all that is in it.
        others: files that it needs at their relative paths, as a model needs its meshes; for a folder, the files in it
            that are read.

    Example:
        >>> from pathlib import Path
        >>> InputFile(Path("rover.xml"), (Path("meshes/wheel.stl"),)).path.name
        'rover.xml'
    """

    path: Path
    others: tuple[Path, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "path", Path(self.path))
        object.__setattr__(self, "others", tuple(map(Path, self.others)))


class KeptInput(TypedDict):
    """An input in the index: where it was, its copy, and size and checksum to recognise it where there is no copy.

    `below` is its path in the folder of the config, for paths that the config computes from its own; `others` are the
    files that it needs, relative to its folder; `programs` the copies that are executable, since a package may come by
    way of a disk that does not keep that permission.
    """

    named: str
    at: str
    below: str | None
    others: list[str]
    kept: str | None
    size: int
    sha256: str | None
    programs: NotRequired[list[str]]


class _Index(TypedDict):
    inputs: list[KeptInput]


def read_index(folder: Path) -> list[KeptInput]:
    """Return the index in a folder of configs; empty where there is none.

    Raises:
        StorageError: it cannot be read, or is not such an index.
    """
    path = folder / INDEX
    if not path.exists():
        return []
    index: _Index = read_json(path)
    faults = faults_of(index, _Index)
    if not faults:
        named = (place for each in index["inputs"] for place in (each["kept"], *each.get("programs", ())))
        places = [Path(place) for place in named if place is not None]
        faults = [f"{str(at)!r} is not a place below it" for at in places if at.is_absolute() or ".." in at.parts]
    if faults:
        raise StorageError(f"the index of input files is damaged: {faults[0]}", where=str(path), fix="Get it again.")
    return index["inputs"]


def shown_input(each: KeptInput) -> str:
    """Return size and checksum of an input in words."""
    return f"{each['size']:,} bytes" + (f", SHA-256 {each['sha256']}" if each["sha256"] else "")


@contextmanager
def kept_copies(folder: Path, working: Path | None = None) -> Iterator[None]:
    """Let `input_file` find the copies in a folder of configs, or those in `working`, for a while."""
    own = {_VARIABLE: str(folder.resolve()), _WORKING: str((working or folder).resolve())}
    before = {name: os.environ.get(name) for name in own}
    os.environ.update(own)
    try:
        yield
    finally:
        for name, text in before.items():
            os.environ.pop(name)
            if text is not None:
                os.environ[name] = text


def copy_kept(folder: Path, target: Path) -> None:
    """Copy the inputs that a folder of configs keeps, so that programs may write there without changing a package.

    Raises:
        StorageError: something cannot be read or written.
    """
    part = target.with_name(f".{target.name}.tmp")
    with storage_errors(target, "written"):
        shutil.rmtree(part, ignore_errors=True)
        part.mkdir(parents=True)
        for each in read_index(folder):
            for member in _copies_of(each, folder):
                place = part / member.relative_to(_absolute(folder))
                place.parent.mkdir(parents=True, exist_ok=True)
                replace(place, read_bytes(member, folder), part, is_lasting=False)
        let_programs_execute(folder, part)
        part.replace(target)


def let_programs_execute(folder: Path, copies: Path) -> None:
    """Make the copies of executable inputs executable: a config may execute the one beside it.

    `copies` were just written; `folder`, that of configs, has the index.

    Raises:
        StorageError: the index cannot be read.
        OSError: a copy cannot be changed.
    """
    for place in (copies / name for each in read_index(folder) for name in each.get("programs", ())):
        if place.is_file():
            place.chmod(place.stat().st_mode | 0o100 | (place.stat().st_mode & 0o044) >> 2)


def copies_in(folder: Path) -> set[Path]:
    """Return the files in a folder of configs that are copies of inputs, and so no part of its code.

    Raises:
        StorageError: the index cannot be read.
    """
    return {copy for each in read_index(folder) for copy in _copies_of(each, folder)}


def _copies_of(each: KeptInput, folder: Path) -> list[Path]:
    copy = _copy_of(each, folder)
    if copy is None:
        return []
    # The folder of the config may be the input itself: its copy is then the whole folder, which has another name.
    others = [Path(other) for other in each["others"]]
    places = [copy.joinpath(*other.parts[1:]) if each["kept"] == "." else copy.parent / other for other in others]
    members = _members_of(_absolute(copy), places)
    return [member for member in members if member.is_relative_to(_absolute(folder))]


def input_file(path: str | Path) -> Path:
    """Return the path from which to read an input: its copy if a package is executed again, else the path itself.

    A `~` at its beginning stands for the home folder.

    Example:
        >>> from pathlib import Path
        >>> input_file(Path("lab.toml")).as_posix()
        'lab.toml'
    """
    return kept_copy(Path(path)) or _expanded(Path(path))


def kept_copy(path: Path) -> Path | None:
    """Return the copy that a package has of a file, or of a file in a folder, while it is executed again."""
    folder = os.environ.get(_VARIABLE)
    copies = _copies(Path(folder), Path(os.environ.get(_WORKING) or folder)) if folder else {}
    for base in (path, *path.parents) if copies else ():
        copy, below = copies.get(str(base)) or copies.get(str(_absolute(base))), path.relative_to(base)
        if copy is not None and ".." not in below.parts and os.path.exists(copy / below):  # noqa: PTH110 - any word
            return copy / below
    return None


@cache
def _copies(folder: Path, working: Path) -> Mapping[str, Path]:
    found: dict[str, Path] = {}
    for each in read_index(folder):
        if (copy := _copy_of(each, working)) is not None:
            # In a package, `~` stands for the home folder of its authors.
            found |= {each["named"]: copy, str(_expanded(Path(each["at"]))): copy}
            found |= {str(folder / each["below"]): copy} if each["below"] is not None else {}
    return found


def _copy_of(each: KeptInput, folder: Path) -> Path | None:
    """Return the copy of an input; None where there is none, as a package leaves out files with names of secrets."""
    copy = None if each["kept"] is None else folder / each["kept"]
    return copy if copy is not None and copy.exists() else None


# What is kept of them, and what has changed since.


def kept_contents(inputs: Sequence[InputFile], beside: Path, kept: Path) -> dict[Path, bytes]:
    """Return the files to keep for the inputs of an experiment, the index included: contents by path.

    `beside` is the folder of its config, and `kept` that of configs in the experiment's folder.

    Raises:
        StorageError: a file that is there cannot be read.
    """
    contents: dict[Path, bytes] = {}
    index: list[KeptInput] = []
    for each in dict.fromkeys(inputs):
        with storage_errors(each.path, "read"):
            path, members = _files_of(each)
            if members:
                entry = _described(each, path, members)
                copies = _kept_of(entry, path, members, beside)
                contents |= {kept / place: member.read_bytes() for place, member in copies.items()}
                index.append(entry)
    if index:
        contents[kept / INDEX] = (json.dumps({"inputs": index}, indent=2) + "\n").encode()
    return contents


def _kept_of(entry: KeptInput, path: Path, members: Sequence[Path], beside: Path) -> dict[Path, Path]:
    """Return the files of an input to copy, each with the path of its copy, and complete its entry in the index."""
    at = Path(entry["at"])
    entry["below"] = at.relative_to(beside).as_posix() if at.is_relative_to(beside) else None
    if not fits(members):
        return {}
    base, place = _places(path, members, beside)
    entry["kept"] = (place / path.relative_to(base)).as_posix()
    copies = {place / member.relative_to(base): member for member in members}
    entry["programs"] = [copy.as_posix() for copy, member in copies.items() if member.stat().st_mode & stat.S_IXUSR]
    return copies


def fits(members: Collection[Path]) -> bool:
    """Return whether the files of an input are few and small enough to be copied."""
    return len(members) <= _MOST_FILES and sum(member.stat().st_size for member in members) <= _LARGEST


def input_changes(inputs: Sequence[InputFile], kept: Path) -> Iterator[Finding]:
    """Yield an error for each input that has changed since it was read before, by the index in a folder of configs.

    Raises:
        StorageError: the index cannot be read, or a file that is there.
    """
    known = read_index(kept)
    for each in dict.fromkeys(inputs):
        same_path = [was for was in known if was["named"] == str(each.path)]  # as of several programs in one folder
        if same_path and all(_is_another(was, each) for was in same_path):
            fix = "Undo the change, accept it (--accept-changes), or choose another experiment_name."
            fewest = min((_change_in_words(was, each, kept) for was in same_path), key=len)
            yield Finding.error(str(each.path), fewest, fix)


def _is_another(was: KeptInput, each: InputFile) -> bool:
    with storage_errors(each.path, "read"):
        path, members = _files_of(each)
        now = _described(each, path, members, name=_absolute(Path(was["at"])).name)
    return bool(members) and (now["size"], now["sha256"]) != (was["size"], was["sha256"])


def _change_in_words(was: KeptInput, each: InputFile, kept: Path) -> str:
    path, members = _files_of(each)
    copy = _copy_of(was, kept)
    changes: list[str] = []
    if copy is not None and members != [path]:
        with storage_errors(each.path, "read"):
            changes = _changes_in(path, members, copy, _copies_of(was, kept))
    kind = "folder" if path.is_dir() else "file"
    return listed(changes) or f"the {kind} is another one than the runs before have read"


def _changes_in(path: Path, members: Sequence[Path], copy: Path, copies: Sequence[Path]) -> list[str]:
    """Return in words which files of an input differ from their copies."""
    found, known = _named(path, members, path.name), _named(copy, copies, path.name)
    changed = [name for name in found.keys() & known if _file_digest(found[name]) != _file_digest(known[name])]
    return [
        *(f"{name} is another one than the runs before have read" for name in sorted(changed)),
        *(f"{name} is new since the runs before" for name in sorted(found.keys() - known)),
        *(f"{name}, which the runs before have read, is not there" for name in sorted(known.keys() - found)),
    ]


def _named(path: Path, members: Sequence[Path], name: str) -> dict[str, Path]:
    """Return the files of an input by their paths beside it; a folder is called `name`, as it may have been renamed."""
    own = _absolute(path)
    start, before = (own, Path(name)) if own.is_dir() else (own.parent, Path())
    return {os.path.normpath(before / os.path.relpath(each, start)): each for each in members}


def _files_of(each: InputFile) -> tuple[Path, list[Path]]:
    """Return the path of an input and all of its files; none if it is missing, which its reader reports."""
    path = _absolute(input_file(each.path))
    return path, _members_of(path, each.others)


def _members_of(path: Path, others: Sequence[Path]) -> list[Path]:
    inside = path.rglob("*") if path.is_dir() and not others else ()
    members = {*map(_absolute, others), *inside, *([] if path.is_dir() else [path])}
    return sorted(member for member in members if member.is_file())


def _described(each: InputFile, path: Path, members: Sequence[Path], *, name: str | None = None) -> KeptInput:
    """Return the entry of an input in the index; a folder is summed as if it was called `name`, left out as it is."""
    at, size = _absolute(each.path), sum(member.stat().st_size for member in members)
    is_summed = size <= _LARGEST_SUMMED and len(members) <= _MOST_FILES
    return {
        "named": str(each.path),
        "at": str(at),
        "below": None,
        "others": [os.path.relpath(_absolute(other), path.parent) for other in each.others],
        "kept": None,
        "size": size,
        "sha256": _digest(path, members, name or at.name) if is_summed else None,
    }


def _digest(path: Path, members: Sequence[Path], name: str) -> str:
    """Return the SHA-256 of a file; of several, that of the list of their checksums as `sha256sum` prints it."""
    if list(members) == [path]:
        return _file_digest(path)
    lines = (f"{_file_digest(each)}  {place}\n" for place, each in _named(path, members, name).items())
    return hashlib.sha256("".join(lines).encode("utf-8", "surrogateescape")).hexdigest()  # names may be any bytes


def _file_digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _places(path: Path, members: Sequence[Path], beside: Path) -> tuple[Path, Path]:
    """Return the common folder of all files of an input, and the folder of their copies, below the kept config.

    Files below the folder of the config keep their relative paths, so that paths that the config computes lead there.
    """
    own = path if path == beside else path.parent  # the folder of the config may be the input itself
    base = Path(os.path.commonpath([own, *(member.parent for member in members)]))
    if base.is_relative_to(beside) and beside / INDEX not in members:
        return beside, Path()
    return base, Path(_ELSEWHERE, hashlib.sha256(str(base).encode()).hexdigest()[:8])


def _expanded(path: Path) -> Path:
    return Path(os.path.expanduser(path))  # noqa: PTH111  # it leaves the name of an unknown user as it is


def _absolute(path: Path) -> Path:
    # Not `resolve`: a link below the folder of the config counts as being there.
    return Path(os.path.normpath(_expanded(path).absolute()))


def missing_inputs(folder: Path) -> Iterator[Finding]:
    """Yield a warning for each input without a copy in a package that is missing or different on this machine.

    Raises:
        StorageError: the index cannot be read.
    """
    for each in read_index(folder):
        if _copy_of(each, folder) is None and (fault := _fault_of(each)):
            fix = "Ask its authors for it, and put it there; or name another place with --set."
            yield Finding.warning(each["at"], f"there is no copy of it, and {fault}: {shown_input(each)}", fix)


def _fault_of(each: KeptInput) -> str:
    at = Path(each["at"])
    own = InputFile(at, tuple(at.parent / other for other in each["others"]))
    if not _files_of(own)[1]:
        return "it is not here"
    return "the one here is another" if _is_another(each, own) else ""
