"""Wheels of distributions that were installed from a folder of this machine: nobody else could get them.

The same distribution gives the same bytes: files in order, without times.
"""

from __future__ import annotations

import re
import zipfile
from pathlib import Path
from typing import TYPE_CHECKING

from robot_runner.replication.distributions import record_hash
from robot_runner.replication.plain_zip import STAMP

if TYPE_CHECKING:
    from collections.abc import Iterator

    from robot_runner.replication.distributions import InstalledDistribution

__all__ = ["wheel_name", "wheel_of", "write_wheel"]

_NOT_OF_THE_WHEEL = frozenset({"INSTALLER", "RECORD", "REQUESTED", "direct_url.json", "uv_build.json", "uv_cache.json"})
_TAG = re.compile(r"^Tag: (\S+)$", re.MULTILINE)


def wheel_of(distribution: InstalledDistribution) -> dict[str, Path]:
    """Return the files of its wheel by their names in it; nothing where they cannot be told.

    Raises:
        OSError: a folder cannot be read.
    """
    information = _information_folder(distribution)
    if information is None:
        return {}
    files = {f"{information.name}/{path.relative_to(information).as_posix()}": path for path in _below(information)}
    code = dict(_editable_code(distribution) if distribution.is_editable else _installed_code(distribution))
    if not code:
        return {}
    return dict(sorted({**code, **{name: path for name, path in files.items() if _is_of_wheel(path)}}.items()))


def wheel_name(distribution: InstalledDistribution) -> str:
    """Return what the file of its wheel is called (PEP 427)."""
    tags = _TAG.findall(distribution.distribution.read_text("WHEEL") or "") or ["py3-none-any"]
    name = re.sub(r"[-_.]+", "_", distribution.name)
    joined = "-".join(".".join(dict.fromkeys(part)) for part in zip(*(tag.split("-") for tag in tags), strict=True))
    return f"{name}-{distribution.version}-{joined}.whl"


def write_wheel(files: dict[str, Path], target: Path) -> None:
    """Write a wheel of these files, with its RECORD.

    Raises:
        OSError: a file cannot be read, or the wheel not be written.
    """
    information = next(name.partition("/")[0] for name in files if ".dist-info/" in name)
    record = []
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, path in files.items():
            data = path.read_bytes()
            record.append(f"{name},{record_hash(data)},{len(data)}")
            archive.writestr(_entry(name), data)
        name = f"{information}/RECORD"
        archive.writestr(_entry(name), "\n".join([*record, f"{name},,"]) + "\n")


def _entry(name: str) -> zipfile.ZipInfo:
    entry = zipfile.ZipInfo(name, STAMP)
    entry.compress_type = zipfile.ZIP_DEFLATED
    entry.create_system = 3
    entry.external_attr = 0o644 << 16
    return entry


def _information_folder(distribution: InstalledDistribution) -> Path | None:
    for path in distribution.distribution.files or ():
        if path.name == "METADATA" and path.parent.name.endswith(".dist-info"):
            return Path(str(distribution.distribution.locate_file(path.parent)))
    return None


def _is_of_wheel(path: Path) -> bool:
    return path.name not in _NOT_OF_THE_WHEEL


def _installed_code(distribution: InstalledDistribution) -> Iterator[tuple[str, Path]]:
    for path in distribution.distribution.files or ():
        is_code = path.parts[0] != ".." and ".dist-info" not in path.parts[0] and path.suffix != ".pyc"
        located = Path(str(distribution.distribution.locate_file(path)))
        if is_code and located.is_file():
            yield path.as_posix(), located


def _editable_code(distribution: InstalledDistribution) -> Iterator[tuple[str, Path]]:
    """Yield the code in the folder that the installed `.pth` file names: what the installed package imports."""
    tops = _top_names(distribution)
    for root in _path_entries(distribution):
        for top in sorted(tops):
            for path in (root / f"{top}.py", *(_below(root / top) if (root / top).is_dir() else ())):
                if path.is_file() and path.suffix != ".pyc" and "__pycache__" not in path.parts:
                    yield path.relative_to(root).as_posix(), path


def _path_entries(distribution: InstalledDistribution) -> Iterator[Path]:
    for path in distribution.distribution.files or ():
        if path.suffix == ".pth":
            text = Path(str(distribution.distribution.locate_file(path))).read_text(encoding="utf-8")
            yield from (Path(line.strip()) for line in text.splitlines() if line.startswith("/"))


def _top_names(distribution: InstalledDistribution) -> set[str]:
    listed = (distribution.distribution.read_text("top_level.txt") or "").split()
    announced = {point.module.partition(".")[0] for point in distribution.distribution.entry_points}
    return {*listed, *announced, re.sub(r"[-.]+", "_", distribution.name)}


def _below(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*") if path.is_file() and not path.is_symlink())
