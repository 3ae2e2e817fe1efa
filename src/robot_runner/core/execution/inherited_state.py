"""The state that a forked run inherits from its parent: random generators, and open files of callbacks.

A forked process ends without Python's own end, which would clean up and write what is its parent's. Without this, the
table that `before_experiment` opens and each run adds a line to would lack these lines, and what a run opens and does
not close would be empty.

Python's `random` is seeded anew in each forked process; NumPy's and PyTorch's would yield the same numbers in every
run, repetitions included.
"""

from __future__ import annotations

import gc
import io
import os
import random
import stat
import sys
from collections.abc import Collection, Iterable, Iterator
from contextlib import suppress
from itertools import chain
from typing import Any
from weakref import ref

_BUFFERED = (io.BufferedWriter, io.BufferedRandom)
_WRITERS = (io.TextIOWrapper, *_BUFFERED)
#: Generations of the garbage collector that hold the newest objects; since Python 3.14 there is one.
_YOUNG = (0, 1) if sys.version_info < (3, 14) else (0,)
#: Classes that write a trailer when they are closed, without which the file is broken: module and name.
_ENDED_BY_CLOSING = (("gzip", "GzipFile"), ("bz2", "BZ2File"), ("lzma", "LZMAFile"), ("zipfile", "ZipFile"))

#: Files that were open when the first run began, which runs inherit; weak, so that they can be closed meanwhile.
_inherited: list[ref[Any]] = []


def note_open_files() -> None:
    """Remember which files are open in this process, which is about to fork runs."""
    _inherited[:] = map(ref, _files_among(gc.get_objects()))


def note_fresh_files() -> None:
    """Remember the files that `before_run` has opened, too: they are among the newest objects."""
    known = set(map(id, _still_there()))
    young = [gc.get_objects(generation) for generation in _YOUNG]
    _inherited.extend(ref(each) for each in _files_among(*young) if id(each) not in known)


def write_inherited() -> None:
    """Flush the files that runs inherit: otherwise each run would write the same buffer again."""
    for _ in _flushed(_still_there()):
        pass  # problems are reported by the run, whose own lines cannot be written either


def freeze_inherited() -> None:
    """Have the garbage collector distinguish what the run makes from what it has inherited."""
    gc.freeze()


def write_open_files() -> list[str]:
    """Flush the files that this run has opened or inherited; return the problems."""
    made = gc.get_objects()
    problems = list(_flushed(_files_among(made, _still_there())))
    known = [getattr(sys.modules[module], name) for module, name in _ENDED_BY_CLOSING if module in sys.modules]
    for each in _of_types(made, tuple(known)):
        problems += _problem(each, each.close)
    return problems


def _still_there() -> list[Any]:
    _inherited[:] = [each for each in _inherited if each() is not None]
    return [file for each in _inherited if (file := each()) is not None]


def _files_among(*objects: Iterable[Any]) -> list[Any]:
    """Return the regular files among objects that can be written; text first, which writes into the others."""
    found = _of_types([*chain(*objects)], _WRITERS)
    return sorted(filter(_is_written, found), key=lambda each: isinstance(each, _BUFFERED))


def _of_types(objects: Collection[Any], types: tuple[type, ...]) -> list[Any]:
    """Return the objects of these types and of types derived from them."""
    # By their types, of which there are few. Not `isinstance`, which reads `__class__`: proxies execute code then.
    kinds = {kind for kind in set(map(type, objects)) if not set(types).isdisjoint(kind.__mro__)}
    return [each for each in objects if type(each) in kinds] if kinds else []


def _is_written(file: Any) -> bool:
    with suppress(Exception):  # it was closed, is in memory, or a stranger's
        return bool(file.writable() and stat.S_ISREG(os.fstat(file.fileno()).st_mode))
    return False


def _flushed(files: Iterable[Any]) -> Iterator[str]:
    for each in files:
        yield from _problem(each, each.flush)


def _problem(file: Any, write: Any) -> Iterator[str]:
    try:
        write()
    except OSError as error:
        yield f"{getattr(file, 'name', 'a file')} lacks part of what was written to it: {error.strerror or error}"
    except Exception:  # noqa: BLE001, S110 - it was closed or detached meanwhile
        pass


def seed_random_numbers(run_seed: int) -> None:
    """Give the generators of `random`, and of NumPy and PyTorch where they were imported, the state of this seed.

    So a run draws the same numbers wherever and whenever it is executed, and each run draws others. `run_seed` has 32
    bits, which is what NumPy takes.
    """
    random.seed(run_seed)
    if (numpy_random := sys.modules.get("numpy.random")) is not None:
        numpy_random.seed(run_seed)
    if (torch := sys.modules.get("torch")) is not None:
        torch.manual_seed(run_seed)
