"""Folders of experiments as a stranger may prepare them, each made from one that was really executed."""

from __future__ import annotations

import csv
import io
import itertools
import json
import os
import shutil
import socket
import stat
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from tests.hostile.malformed_json import (
    ESCAPES,
    ODD_VALUES,
    Verbatim,
    damaged,
    in_every_text,
    keys_of,
    with_value,
    without,
    written,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator
    from pathlib import Path

__all__ = ["Hostile", "hostile_folders"]

_DOCUMENTS = ("manifest.json", "run_table.schema.json", "registration.json", "runs/r_1/Ina219/quality.json")
_JOURNAL, _TABLE = "journal.jsonl", "run_table.csv"
#: Files that a program finds in a folder, and those that it makes there.
_FILES = (
    "manifest.json",
    _JOURNAL,
    _TABLE,
    "run_table.schema.json",
    "registration.json",
    ".lock",
    ".control",
    ".pause",
    ".alive",
    ".outliving",
    ".standing_by",
    ".to_make_safe",
    "current_log.txt",
    "config/small.py",
    "runs/r_1/log.txt",
    "runs/r_1/Ina219/samples.csv",
    "runs/r_1/Ina219/quality.json",
    "report/report.json",
    "report/report.html",
    "report/tables/runs.csv",
)
_FOLDERS = ("runs", "runs/r_1", "runs/r_1/Ina219", "config", "report", "report/tables", "earlier_tables", "export")


@dataclass(frozen=True)
class Hostile:
    """One hostile folder: its name, and what makes it from the original.

    `damage` gets the experiment's folder and a folder outside, which nobody may change.
    """

    name: str
    damage: Callable[[Path, Path], None]


def hostile_folders(folder: Path) -> Iterator[Hostile]:
    """Yield all of them, made from what this experiment's folder holds."""
    yield from _special_files()
    for name in _DOCUMENTS:
        yield from _documents(name, json.loads((folder / name).read_text(encoding="utf-8")))
    yield from _journals((folder / _JOURNAL).read_text(encoding="utf-8").splitlines())
    yield from _tables((folder / _TABLE).read_text(encoding="utf-8"))
    yield from _together()


# What stands in the place of a file or of a folder


def _special_files() -> Iterator[Hostile]:
    for name in _FILES:
        for kind, make in _KINDS.items():
            yield Hostile(f"{kind} {name}", partial(_replaced, name, make))
    for name in _FOLDERS:
        for kind in ("link", "fifo", "loop", "file"):
            yield Hostile(f"{kind} {name}/", partial(_replaced, name, _KINDS_OF_FOLDER[kind]))


def _replaced(name: str, make: Callable[[Path, Path], None], folder: Path, outside: Path) -> None:
    path = folder / name
    with suppress(FileNotFoundError):
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    path.parent.mkdir(parents=True, exist_ok=True)
    make(path, outside)


def _socket(path: Path, _outside: Path) -> None:
    # The name of a socket is short; it is bound from within the folder.
    descriptor = os.open(path.parent, os.O_RDONLY)
    try:
        with socket.socket(socket.AF_UNIX) as each:
            each.bind(f"/proc/self/fd/{descriptor}/{path.name}")
    finally:
        os.close(descriptor)


def _device(path: Path, _outside: Path) -> None:
    try:
        os.mknod(path, stat.S_IFCHR | 0o666, os.makedev(1, 5))  # that of /dev/zero
    except PermissionError:  # only root may
        path.symlink_to("/dev/zero")


def _sparse(path: Path, _outside: Path) -> None:
    with path.open("wb") as file:
        file.truncate(8 << 30)


_KINDS: dict[str, Callable[[Path, Path], None]] = {
    "link": lambda path, outside: path.symlink_to(outside / "secret.txt"),
    "dangling": lambda path, outside: path.symlink_to(outside / "made_by_us"),
    "fifo": lambda path, _: os.mkfifo(path),
    "folder": lambda path, _: path.mkdir(),
    "socket": _socket,
    "zero": lambda path, _: path.symlink_to("/dev/zero"),
    "device": _device,
    "sparse": _sparse,
}
_KINDS_OF_FOLDER: dict[str, Callable[[Path, Path], None]] = {
    "link": lambda path, outside: path.symlink_to(outside),
    "fifo": lambda path, _: os.mkfifo(path),
    "loop": lambda path, _: path.symlink_to(path.parent),
    "file": lambda path, _: path.write_text("no folder", encoding="utf-8"),
}


# JSON


def _documents(name: str, document: Any) -> Iterator[Hostile]:
    short = name.rpartition("/")[2]
    for kind, content in damaged(json.dumps(document)):
        yield Hostile(f"{kind} {short}", partial(_with_bytes, name, content))
    for kind, twist in _TWISTS.items():
        yield Hostile(f"{kind} {short}", partial(_with_text, name, partial(twist, document)))
    # One value after another takes the place of one key after another, so that both are gone through.
    values = itertools.cycle(ODD_VALUES.items())
    for way, (kind, value) in zip(keys_of(document), values, strict=False):
        text = partial(_changed, with_value, document, way, value)
        yield Hostile(f"{kind} at {_shown(way)} of {short}", partial(_with_text, name, text))
    for way in keys_of(document, 2):
        text = partial(_changed, without, document, way)
        yield Hostile(f"without {_shown(way)} of {short}", partial(_with_text, name, text))


def _duplicated(document: dict[str, Any]) -> str:
    text = json.dumps(document)
    return "{" + text[1:-1] + "," + text[1:]


_TWISTS: dict[str, Callable[[dict[str, Any]], str]] = {
    "duplicate-keys": _duplicated,
    "escapes-everywhere": lambda document: json.dumps(in_every_text(document, lambda each: ESCAPES + each)),
    "raw-escapes": lambda document: json.dumps(
        in_every_text(document, lambda each: "\x9b2J\u202e" + each), ensure_ascii=False
    ),
    "lone-surrogates": lambda document: written(
        in_every_text(document, lambda each: Verbatim(f'"\\ud800{len(each)}"'))
    ),
    "huge-texts": lambda document: json.dumps(in_every_text(document, lambda each: each * 20_000)),
    "many-keys": lambda document: json.dumps({**document, **{f"key {number}": number for number in range(100_000)}}),
}


def _changed(change: Callable[..., Any], *given: Any) -> str:
    return written(change(*given))


def _with_text(name: str, text: Callable[[], str], folder: Path, outside: Path) -> None:
    """Write a text that is made only now: of thousands of texts a test uses few."""
    _with_bytes(name, text().encode("utf-8", "surrogatepass"), folder, outside)


def _with_bytes(name: str, content: bytes, folder: Path, _outside: Path) -> None:
    (folder / name).write_bytes(content)


def _shown(way: Iterable[Any]) -> str:
    return ".".join(map(str, way))


# The journal


def _journals(lines: list[str]) -> Iterator[Hostile]:
    whole = "".join(f"{line}\n" for line in lines)
    for kind, content in damaged(whole):
        yield Hostile(f"{kind} journal", partial(_with_bytes, _JOURNAL, content))
    records = [json.loads(line) for line in lines]
    firsts = {record["kind"]: place for place, record in reversed(list(enumerate(records)))}
    values = itertools.cycle(ODD_VALUES.items())
    for kind, place in firsts.items():
        record = records[place]
        for way, (odd, value) in zip([way for way in keys_of(record) if way != ("kind",)], values, strict=False):
            changed = [*lines[:place], written(with_value(record, way, value)), *lines[place + 1 :]]
            yield Hostile(f"{odd} at {_shown(way)} of {kind}", _journal_of(changed))
        for way in keys_of(record, 1):
            changed = [*lines[:place], written(without(record, way)), *lines[place + 1 :]]
            yield Hostile(f"without {_shown(way)} of {kind}", _journal_of(changed))
    for kind, more in _ODD_RECORDS.items():
        yield Hostile(f"{kind} record", _journal_of([*lines, more]))
    for kind, change in {"escapes": lambda each: ESCAPES + each, "long": lambda each: each * 9000}.items():
        changed = [
            json.dumps({**in_every_text(each, change), "kind": each["kind"], "at": each["at"]}) for each in records
        ]
        yield Hostile(f"{kind} in all records", _journal_of([line.replace(": ", ":", 1) for line in changed]))
    yield Hostile("long line of the journal", _journal_of([*lines, '{"kind":"' + "a" * (600 << 20)]))
    yield Hostile("all records twice", _journal_of([*lines, *lines]))


def _journal_of(lines: list[str]) -> Callable[[Path, Path], None]:
    return lambda folder, _: _write_lines(folder / _JOURNAL, lines)


def _write_lines(path: Path, lines: list[str]) -> None:
    with path.open("w", encoding="utf-8", errors="surrogatepass") as file:
        file.writelines(f"{line}\n" for line in lines)


_RUN = '"at":"2026-01-31T12:00:00.000Z","run":"r_1","attempt":1'
_ODD_RECORDS = {
    "bare": '{"kind":"finding"}',
    "unknown": '{"kind":"\\u001b[2J","at":"2026-01-31T12:00:00.000Z"}',
    "run that leads out": '{"kind":"excluded","at":"2026-01-31T12:00:00.000Z","run":"../../outside","reason":"x"}',
    "escapes": json.dumps({"kind": "excluded", "at": "2026-01-31T12:00:00Z", "run": "r_1", "reason": ESCAPES}).replace(
        ": ", ":", 1
    ),
    "bound": f'{{"kind":"bound",{_RUN},"owner":"x","parameters":7}}',
    "gate": f'{{"kind":"gate",{_RUN},"state":"waiting","condition":[],"seen":{{}},"seconds":"long"}}',
    "step": f'{{"kind":"operator_step",{_RUN},"step":"a","notes":[],"answers":7,"treatments":null}}',
    "subject": f'{{"kind":"subject",{_RUN},"command":7}}',
    "extension": f'{{"kind":"extended",{_RUN},"batch":2,"base":[]}}',
    "repetition": f'{{"kind":"repeated",{_RUN},"repetition":3,"runs":[7]}}',
    "repetition of nothing": f'{{"kind":"repeated",{_RUN},"repetition":3,"runs":[]}}',
    "question": '{"kind":"waiting","at":"2026-01-31T12:00:00.000Z","next_run":"r_1","questions":[{"name":[]}]}',
    "preparation": '{"kind":"prepared","at":"2026-01-31T12:00:00.000Z","treatments":{"revisions":7}}',
    "clock": f'{{"kind":"clock",{_RUN},"host":"pi","before":[],"uncertainty":"much"}}',
    "window backwards": f'{{"kind":"window",{_RUN},"start":1e308,"end":-1e308}}',
    "end without a beginning": '{"kind":"experiment_finished","at":"0000-99-99"}',
    "deep": '{"kind":"event","at":' + "[" * 100_000 + "}",
    "twice": '{"kind":"event","at":"2026-01-31T12:00:00Z","event":"a","event":"b"}',
}


# The run table


def _tables(text: str) -> Iterator[Hostile]:
    for kind, content in damaged(text):
        yield Hostile(f"{kind} run table", partial(_with_bytes, _TABLE, content))
    rows = list(csv.reader(io.StringIO(text)))
    for place, heading in enumerate(rows[0]):
        for kind, cell in _CELLS.items():
            yield Hostile(f"{kind} in {heading}", _table_of([rows[0], _with_cell(rows[1], place, cell), *rows[2:]]))
    for kind, heading in _CELLS.items():
        yield Hostile(f"{kind} as a heading", _table_of([_with_cell(rows[0], 11, heading), *rows[1:]]))
    yield Hostile("run twice", _table_of([*rows, rows[1]]))
    yield Hostile("heading twice", _table_of([[*each, each[-1]] for each in rows]))
    yield Hostile("short rows", _table_of([rows[0], *(each[:3] for each in rows[1:])]))
    yield Hostile("no rows", _table_of(rows[:1]))
    yield Hostile("many columns", _table_of([[*rows[0], *(f"c{place}" for place in range(20_000))], *rows[1:]]))
    yield Hostile("many rows", _table_of([*rows, *([f"x{place}", *rows[1][1:]] for place in range(50_000))]))
    yield Hostile("open quote", partial(_with_bytes, _TABLE, text.encode() + b'"' + b"a" * 3_000_000))


_CELLS = {
    "escapes": ESCAPES.replace("\0", ""),
    "nul": "a\0b",
    "path": "../../../outside/planted",
    "absolute path": "/etc/passwd",
    "huge cell": "1" * 300_000,
    "formula": "=cmd|' /C calc'!A0",
    "markup": "<script>alert(1)</script>[link=http://evil]x[/link]",
    "line break": "a\nerror: b",
    "infinite": "1e999",
    "nan": "nan",
    "empty": "",
    "dot": "..",
    "digits": "9" * 4400,
}


def _with_cell(row: list[str], place: int, cell: str) -> list[str]:
    return [*row[:place], cell, *row[place + 1 :]]


def _table_of(rows: list[list[str]]) -> Callable[[Path, Path], None]:
    def write(folder: Path, _outside: Path) -> None:
        with (folder / _TABLE).open("w", encoding="utf-8", newline="") as file:
            csv.writer(file, lineterminator="\n").writerows(rows)

    return write


# Several files at once


def _together() -> Iterator[Hostile]:
    yield Hostile("escapes in every file", _escapes_everywhere)
    yield Hostile("runs named by escapes", _odd_run_folders)
    yield Hostile("samples of one huge cell", _in_samples("t,power_W\n0," + "1" * 5_000_000 + "\n"))
    yield Hostile("samples of other columns", _in_samples("\x1b[2J,\u202e\n1,2\n"))
    yield Hostile("samples of NUL", _in_samples("t,power_W\n\0\0\0\n"))
    yield Hostile("samples of nothing", _in_samples(""))
    yield Hostile("samples without numbers", _in_samples("t,power_W\nx,y\n"))
    yield Hostile("samples of infinity", _in_samples("t,power_W\n0,1e400\n1,nan\n"))
    yield Hostile("logs of escapes", lambda folder, _: (folder / "runs/r_1/log.txt").write_text(ESCAPES * 99, "utf-8"))
    yield Hostile("request of a stranger", partial(_with_bytes, ".control", b'{"command":["continue"],"answers":7}'))
    yield Hostile("lock of a stranger", partial(_with_bytes, ".lock", b'{"pid":"\x1b[2J","host":7}'))
    yield Hostile("list of processes", partial(_with_bytes, ".outliving", b"[1e400,[]]\n[-1,0]\n[[],{}]\n" * 99))


def _escapes_everywhere(folder: Path, _outside: Path) -> None:
    """Names, units, treatments, reasons, problems, owners, cells: in every file at once, so that they fit together."""
    odd = ESCAPES.replace("\0", "").replace("\r", "")
    keep = {"kind", "at", "status", "run", "event"}

    def changed(each: Any) -> Any:
        if isinstance(each, dict):
            return {_name(key): value if key in keep else changed(value) for key, value in each.items()}
        return (
            [changed(one) for one in each]
            if isinstance(each, list)
            else f"{each}{odd}"
            if isinstance(each, str)
            else each
        )

    def _name(key: str) -> str:
        return f"{key}{odd}" if key in {"Task", "Energy", "CPU", "Phases"} else key

    lines = []
    for line in (folder / _JOURNAL).read_text(encoding="utf-8").splitlines():
        record = json.loads(line)
        lines.append(json.dumps(changed(record), separators=(",", ":")))
    _write_lines(folder / _JOURNAL, lines)
    manifest = json.loads((folder / "manifest.json").read_text(encoding="utf-8"))
    moments = {"executions", "registration"}
    manifest = {name: each if name in moments else changed(each) for name, each in manifest.items()}
    manifest["design"]["source"] = "config"
    (folder / "manifest.json").write_text(json.dumps(manifest), encoding="utf-8")
    schema = json.loads((folder / "run_table.schema.json").read_text(encoding="utf-8"))
    for each in schema["fields"]:
        if each["name"] in {"Task", "Energy", "CPU", "Phases"}:
            each["name"] += odd
        each |= {"title": odd, "description": odd, "unit": odd, "robot_runner:findings": [odd]}
        each["robot_runner:doubts"] = {"r_1": [odd]}
    (folder / "run_table.schema.json").write_text(json.dumps(schema), encoding="utf-8")
    rows = list(csv.reader(io.StringIO((folder / _TABLE).read_text(encoding="utf-8"))))
    rows[0] = [_name(each) for each in rows[0]]
    task = rows[0].index(_name("Task"))
    _table_of([rows[0], *([*row[:task], row[task] + odd, *row[task + 1 :]] for row in rows[1:])])(folder, _outside)


def _odd_run_folders(folder: Path, _outside: Path) -> None:
    for number, name in enumerate(("r_1\x1b[2J", "\u202er_1", "r_9\n", "-rf", "R_1", "~", "*")):
        (folder / "runs" / name / "Ina219").mkdir(parents=True)
        (folder / "runs" / name / "Ina219" / f"samples{number}\x1b.csv").write_text(
            "t,power_W\n0,1\n", encoding="utf-8"
        )
        (folder / "runs" / "r_1" / "Ina219" / f"{number}\x9b2J.csv").write_text("t,a\n0,1\n", encoding="utf-8")


def _in_samples(text: str) -> Callable[[Path, Path], None]:
    def write(folder: Path, _outside: Path) -> None:
        for run in ("r_1", "r_2"):
            (folder / "runs" / run / "Ina219/samples.csv").write_text(text, encoding="utf-8")

    return write
