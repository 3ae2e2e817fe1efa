"""Packages as a stranger may prepare them, each made from one that was really packed."""

from __future__ import annotations

import hashlib
import io
import itertools
import json
import os
import struct
import zipfile
import zlib
from functools import partial
from typing import TYPE_CHECKING, Any

from tests.hostile.hostile_folders import Hostile
from tests.hostile.malformed_json import (
    ESCAPES,
    ODD_VALUES,
    damaged,
    in_every_text,
    keys_of,
    with_value,
    without,
    written,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

__all__ = ["hostile_packages"]

_SUMS = "SHA256SUMS"
_DOCUMENTS = ("package.json", "environment.json", "manifest.json", "registration.json", "ro-crate-metadata.json")
_REGULAR = 0o100644 << 16

Entries = dict[str, bytes]


def hostile_packages(package: Path) -> Iterator[Hostile]:
    """Yield all of them, made from this package."""
    whole = package.read_bytes()
    with zipfile.ZipFile(package) as archive:
        entries = {each.filename: archive.read(each) for each in archive.infolist() if not each.is_dir()}
    yield from _cut(whole)
    yield from _named(entries)
    yield from _bombs(entries)
    yield from _documents(entries)
    yield from _unpacked(entries)


# The bytes of the zip file


def _cut(whole: bytes) -> Iterator[Hostile]:
    end = whole.rindex(b"PK\5\6")
    for share in range(0, 100, 7):
        yield Hostile(f"cut at {share} %", partial(_bytes, whole[: len(whole) * share // 100]))
    for place in range(len(whole) // 40, len(whole), len(whole) // 20):
        flipped = bytearray(whole)
        flipped[place] ^= 0xFF
        yield Hostile(f"another byte at {place}", partial(_bytes, bytes(flipped)))
    for offset in (8, 10, 12, 16, 20):
        for value in (0, 1, 0xFFFF):
            changed = bytearray(whole)
            struct.pack_into("<H", changed, end + offset, value)
            yield Hostile(f"end of the directory: {value} at {offset}", partial(_bytes, bytes(changed)))
    start = struct.unpack_from("<L", whole, end + 16)[0]
    for offset in (8, 10, 16, 20, 24, 28, 30, 32, 38, 42):
        for value in (0, 0xFFFF):
            changed = bytearray(whole)
            struct.pack_into("<H", changed, start + offset, value)
            yield Hostile(f"directory: {value} at {offset}", partial(_bytes, bytes(changed)))
    yield Hostile("something before", partial(_bytes, b"#!/bin/sh\n" + whole))
    yield Hostile("something behind", partial(_bytes, whole + b"more"))
    yield Hostile("twice", partial(_bytes, whole + whole))
    yield Hostile("no zip", partial(_bytes, b"not a zip" * 999))
    yield Hostile(
        "a long comment", partial(_bytes, whole[: end + 20] + struct.pack("<H", 65535) + ESCAPES.encode() * 999)
    )
    for kind in ("fifo", "zero", "sparse", "loop"):
        yield Hostile(f"{kind} in its place", partial(_special, kind))


def _bytes(content: bytes, path: Path, _outside: Path) -> None:
    path.write_bytes(content)


def _special(kind: str, path: Path, outside: Path) -> None:
    path.unlink()
    match kind:
        case "fifo":
            os.mkfifo(path)
        case "zero":
            path.symlink_to("/dev/zero")
        case "loop":
            path.symlink_to(path)
        case _:
            with path.open("wb") as file:
                file.truncate(8 << 30)


# Names and kinds of the entries


def _named(entries: Entries) -> Iterator[Hostile]:
    for name in _NAMES:
        yield Hostile(f"entry {name[:40]!r}", partial(_zipped, {**entries, name: b"planted"}))
        yield Hostile(f"entry {name[:40]!r}, listed", partial(_zipped, _with_sums({**entries, name: b"planted"})))
    for kind, mode in {"link": 0o120777, "fifo": 0o010644, "device": 0o020644, "socket": 0o140644}.items():
        made = partial(_zipped, entries, odd={"runs/r_1/planted": (b"../../../outside/secret.txt", mode << 16)})
        yield Hostile(f"entry that is a {kind}", made)
    for method in (1, 12, 14, 93, 99, 0xFFFF):
        yield Hostile(f"compressed by {method}", partial(_compressed_by, entries, method))
    yield Hostile("encrypted", partial(_encrypted, entries))
    for name in ("package.json", "manifest.json", "runs/r_1/log.txt", _SUMS):
        yield Hostile(f"{name} twice", partial(_twice, entries, name, name))
        yield Hostile(f"{name} twice but for case", partial(_twice, entries, name, name.upper()))
        left = {key: content for key, content in entries.items() if key != name}
        yield Hostile(f"without {name}", partial(_zipped, left))
        yield Hostile(f"without {name}, listed", partial(_zipped, _with_sums(left)))
    yield Hostile("file and folder at once", partial(_zipped, {**entries, "runs": b"x"}))
    yield Hostile("no entries", partial(_zipped, {}))


_NAMES = (
    "../planted",
    "../../outside/planted",
    "/etc/planted",
    "/var/planted",
    "runs/../../planted",
    "./planted",
    "a//b",
    "C:\\planted",
    "C:planted",
    "\\\\server\\planted",
    "..\\planted",
    "a\\..\\..\\planted",
    "~/planted",
    "con",
    "NUL.txt",
    "a" * 300,
    "/".join("a" * 200),
    "a/" * 2000 + "b",
    "name ",
    "name.",
    "a\x1b[2Jb",
    "a\x9b2Jb",
    "a\nb",
    "\u202egnp.exe",
    "a\u2028b",
    "\ufeffpackage.json",
    "a\x00b",
    "..",
    ".",
    " ",
    "-rf",
    "=cmd|' /C calc'!A0",
    "config/small.py/planted",
    "SHA256SUMS/planted",
)


# What unpacks to more than it is


def _bombs(entries: Entries) -> Iterator[Hostile]:
    yield Hostile("one file of zeros", partial(_zipped, entries, odd={"runs/bomb": (bytes(200 << 20), _REGULAR)}))
    yield Hostile(
        "a description of zeros", partial(_zipped, {**entries, "package.json": b"[" + b" " * (60 << 20) + b"]"})
    )
    yield Hostile("sums of zeros", partial(_zipped, {**entries, _SUMS: bytes(60 << 20)}))
    yield Hostile("sums of line ends", partial(_zipped, {**entries, _SUMS: b"\n" * (60 << 20)}))
    for name in _DOCUMENTS:
        content = b"[" + b"{}," * (16 << 20) + b"{}]"
        yield Hostile(f"{name} of empty objects", partial(_zipped, _with_sums({**entries, name: content})))
    many = {f"runs/{number}": b"" for number in range(70_000)}
    yield Hostile("many entries", partial(_zipped, {**entries, **many}))
    yield Hostile(
        "many entries in folders", partial(_zipped, {**entries, **{f"{'a/' * 200}{n}": b"" for n in range(2000)}})
    )
    yield Hostile("directory of a million entries", partial(_large_directory, entries, 1_000_000))
    yield Hostile("entries that share bytes", partial(_sharing, entries))
    yield Hostile("larger than it says", partial(_said_sizes, entries, 10))
    yield Hostile("much larger than it says", partial(_said_sizes, entries, 1 << 31))
    yield Hostile(
        "many names of 60 kB", partial(_zipped, {**entries, **{f"runs/{n}{'b' * 60_000}": b"" for n in range(999)}})
    )


def _large_directory(entries: Entries, count: int, path: Path, outside: Path) -> None:
    """The directory names one small file again and again: some kilobytes once it is zipped for the way."""
    _zipped(entries, path, outside)
    whole = path.read_bytes()
    end = whole.rindex(b"PK\5\6")
    start, size = struct.unpack_from("<L", whole, end + 16)[0], struct.unpack_from("<L", whole, end + 12)[0]
    first = struct.unpack_from("<3H", whole, start + 28)
    entry = whole[start : start + 46 + sum(first)]
    with path.open("r+b") as file:
        file.seek(start + size)
        file.write(entry * count)
        tail = struct.pack("<4s4H2LH", b"PK\5\6", 0, 0, 0xFFFF, 0xFFFF, size + len(entry) * count, start, 0)
        file.write(tail)


def _sharing(entries: Entries, path: Path, outside: Path) -> None:
    _zipped({**entries, "runs/a": bytes(1 << 20)}, path, outside)
    with zipfile.ZipFile(path, "a") as archive:
        first = archive.getinfo("runs/a")
        for number in range(3000):
            again = zipfile.ZipInfo(f"runs/a{number}")
            for name in ("CRC", "compress_size", "file_size", "header_offset", "compress_type", "external_attr"):
                setattr(again, name, getattr(first, name))
            archive.filelist.append(again)
        archive._didModify = True


def _said_sizes(entries: Entries, said: int, path: Path, outside: Path) -> None:
    _zipped({**entries, "runs/a": bytes(100 << 20)}, path, outside)
    whole = bytearray(path.read_bytes())
    place = whole.rindex(b"PK\1\2", 0, whole.rindex(b"runs/a"))
    struct.pack_into("<L", whole, place + 24, said)
    path.write_bytes(bytes(whole))


# JSON and sums


def _documents(entries: Entries) -> Iterator[Hostile]:
    values = itertools.cycle(ODD_VALUES.items())
    for name in (each for each in _DOCUMENTS if each in entries):
        document = json.loads(entries[name])
        for kind, content in damaged(json.dumps(document)):
            yield Hostile(f"{kind} {name}", partial(_zipped, _with_sums({**entries, name: content})))
        for kind, text in {
            "escapes in": json.dumps(in_every_text(document, lambda each: ESCAPES + each)),
            "raw escapes in": json.dumps(
                in_every_text(document, lambda each: "\x9b2J\u202e" + each), ensure_ascii=False
            ),
        }.items():
            yield Hostile(f"{kind} {name}", partial(_zipped, _with_sums({**entries, name: text.encode()})))
        for way, (kind, value) in zip(keys_of(document, 2), values, strict=False):
            content = written(with_value(document, way, value)).encode()
            yield Hostile(f"{kind} at {way} of {name}", partial(_zipped, _with_sums({**entries, name: content})))
        for way in keys_of(document, 1):
            content = written(without(document, way)).encode()
            yield Hostile(f"without {way} of {name}", partial(_zipped, _with_sums({**entries, name: content})))
    for kind, content in damaged(entries[_SUMS].decode()):
        yield Hostile(f"{kind} sums", partial(_zipped, {**entries, _SUMS: content}))
    for kind, line in {"escapes": f"{'0' * 64}  {ESCAPES}", "path": f"{'0' * 64}  ../../outside/secret.txt"}.items():
        yield Hostile(f"sums of {kind}", partial(_zipped, {**entries, _SUMS: entries[_SUMS] + f"{line}\n".encode()}))


# The folder that a package was unpacked to


def _unpacked(entries: Entries) -> Iterator[Hostile]:
    for name in ("package.json", _SUMS, "manifest.json", "runs/r_1/log.txt"):
        # Raw data may be as large as the disk, and is read to its end, with its progress shown.
        for kind in ("fifo", "zero", "loop", *(["sparse"] if "/" not in name else [])):
            yield Hostile(f"unpacked, {kind} {name}", partial(_folder_with, entries, partial(_replaced_by, kind, name)))
    for name in ("runs", "config"):
        yield Hostile(f"unpacked, {name} is a link", partial(_folder_with, entries, partial(_linked, name)))


def _folder_with(entries: Entries, damage: Callable[[Path, Path], None], path: Path, outside: Path) -> None:
    path.unlink()
    for name, content in entries.items():
        (path / name).parent.mkdir(parents=True, exist_ok=True)
        (path / name).write_bytes(content)
    damage(path, outside)


def _replaced_by(kind: str, name: str, path: Path, outside: Path) -> None:
    _special(kind, path / name, outside)


def _linked(name: str, path: Path, outside: Path) -> None:
    (path / name).rename(path / f"{name}_before")
    (path / name).symlink_to(outside)


# Writing zip files as no library would


def _with_sums(entries: Entries) -> Entries:
    """Return the entries with checksums that are right: whoever alters on purpose can do that, too."""
    lines = [f"{hashlib.sha256(entries[name]).hexdigest()}  {name}\n" for name in sorted(entries) if name != _SUMS]
    return {**entries, _SUMS: "".join(lines).encode("utf-8", "surrogatepass")}


def _zipped(
    entries: Entries, path: Path, _outside: Path, *, odd: dict[str, tuple[bytes, int]] | None = None, method: int = 8
) -> None:
    with zipfile.ZipFile(path, "w", method) as archive:
        for name, content in entries.items():
            archive.writestr(_info(name, _REGULAR, method), content)
        for name, (content, attributes) in (odd or {}).items():
            archive.writestr(_info(name, attributes, method), content)


def _info(name: str, attributes: int, method: int) -> zipfile.ZipInfo:
    info = zipfile.ZipInfo("x", (1980, 1, 1, 0, 0, 0))
    info.filename = name  # as it is: the constructor cuts at NUL
    info.create_system, info.external_attr, info.compress_type = 3, attributes, method
    return info


def _patched(entries: Entries, offset: int, value: int, path: Path, outside: Path) -> None:
    """Change a field of two bytes in both headers of the first entry."""
    _zipped(entries, path, outside)
    whole = bytearray(path.read_bytes())
    place = struct.unpack_from("<L", whole, whole.rindex(b"PK\5\6") + 16)[0]
    struct.pack_into("<H", whole, place + offset, value)
    struct.pack_into("<H", whole, offset - 2, value)
    path.write_bytes(bytes(whole))


def _compressed_by(entries: Entries, method: int, path: Path, outside: Path) -> None:
    _patched(entries, 10, method, path, outside)


def _encrypted(entries: Entries, path: Path, outside: Path) -> None:
    _patched(entries, 8, 1, path, outside)


def _twice(entries: Entries, name: str, other: str, path: Path, outside: Path) -> None:
    _zipped(entries, path, outside)
    buffer = io.BytesIO(zlib.compress(b"planted"))
    with zipfile.ZipFile(path, "a") as archive:
        info: Any = _info(other, _REGULAR, 0)
        archive.NameToInfo.pop(other, None)
        archive.writestr(info, buffer.getvalue())
