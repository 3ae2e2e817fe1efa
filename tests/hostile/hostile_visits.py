"""Every command that reads an experiment's folder or a package, called on hostile ones, and what came of it."""

from __future__ import annotations

import shutil
import stat
from typing import TYPE_CHECKING

from tests.hostile.hostile_calls import snapshot

if TYPE_CHECKING:
    from pathlib import Path

    from tests.hostile.hostile_calls import CallServer, Tally
    from tests.hostile.hostile_folders import Hostile
    from tests.hostile.hostile_original import Original

__all__ = ["COMMANDS_OF_FOLDERS", "COMMANDS_OF_PACKAGES", "visit_folder", "visit_package"]

_FOLDER, _CONFIG, _ORIGINAL = "results/small", "small.py", "../original"
#: Those that only look come first.
COMMANDS_OF_FOLDERS: tuple[tuple[str, ...], ...] = (
    ("status", _FOLDER),
    ("status", _FOLDER, "--json"),
    ("explain", _FOLDER, "r_1"),
    ("explain", _FOLDER, "r_1", "--json"),
    ("plan", _CONFIG),
    ("check", _CONFIG),
    ("verify", _FOLDER),
    ("replicate", _FOLDER, "--to", "../again"),
    ("compare", _FOLDER, _ORIGINAL, "--bound", "5%"),
    ("report", _FOLDER, "--figures", "svg"),
    ("report", _FOLDER, "--figures", "svg", "--format", "json"),
    ("export", _FOLDER, "--to", "../exported"),
    ("pack", _FOLDER, "--to", "../packed.zip", "--no-wheels", "--no-hashes"),
    ("extend", _CONFIG, "--repetitions", "3", "--dry-run"),
    ("pause", _FOLDER),
    ("continue", _FOLDER),
    ("exclude", _FOLDER, "r_1", "--reason", "the door was open"),
    ("include", _FOLDER, "r_4"),
    ("run", _CONFIG, "--plain", "--no-probe"),
)
COMMANDS_OF_PACKAGES: tuple[tuple[str, ...], ...] = (
    ("verify", "hostile"),
    ("verify", "hostile", "--json"),
    ("replicate", "hostile", "--to", "../again"),
    ("replicate", "hostile", "--to", "../unpacked", "--environment", "container"),
)


def visit_folder(
    hostile: Hostile,
    original: Original,
    server: CallServer,
    box: Path,
    tally: Tally,
    *,
    every: int = 1,
    first: int = 0,
    said: list[bytes] | None = None,
) -> list[int]:
    """Make a hostile folder and call each command on it, or every so many, from the first on; return the exit codes.

    What was printed is added to `said`.
    """
    work, outside = _made(box), box / "outside"
    shutil.copytree(original.study, work, symlinks=True)
    (box / "original").symlink_to(original.study / original.folder)
    hostile.damage(work / original.folder, outside)
    return _call_all(hostile.name, COMMANDS_OF_FOLDERS[first % every :: every], server, box, tally, said)


def visit_package(
    hostile: Hostile,
    original: Original,
    server: CallServer,
    box: Path,
    tally: Tally,
    *,
    every: int = 1,
    first: int = 0,
) -> list[int]:
    """Make a hostile package and call each command on it, or every so many; return the exit codes."""
    work = _made(box)
    work.mkdir()
    shutil.copy(original.package, work / "hostile")
    hostile.damage(work / "hostile", box / "outside")
    return _call_all(hostile.name, COMMANDS_OF_PACKAGES[first % every :: every], server, box, tally)


def _made(box: Path) -> Path:
    if box.exists():
        _remove(box)
    outside = box / "outside"
    outside.mkdir(parents=True)
    (outside / "secret.txt").write_text("4 by", encoding="utf-8")
    (outside / "samples.csv").write_text("t,power_W\n0,1\n", encoding="utf-8")
    return box / "work"


def _remove(box: Path) -> None:
    shutil.rmtree(box)


def _call_all(
    name: str,
    commands: tuple[tuple[str, ...], ...],
    server: CallServer,
    box: Path,
    tally: Tally,
    said: list[bytes] | None = None,
) -> list[int]:
    before = snapshot(box / "outside"), _beside(box)
    tally.subjects += 1
    codes = []
    for words in commands:
        call = server.call(words, box / "work")
        tally.take(name, call)
        codes.append(call.code)
        if said is not None:
            said += [call.out, call.err]
        now = snapshot(box / "outside"), _beside(box)
        if now != before:
            tally.note("written", f"{name}: {' '.join(words)}: {now}")
            before = now
    return codes


def _beside(box: Path) -> set[str]:
    """Return what lies beside the folders that commands may write to, however it came there."""
    allowed = {"work", "outside", "original", "again", "unpacked", "exported", "packed.zip"}
    planted = {path.name for path in box.iterdir()} - allowed
    return planted | {f"work/{path.name}" for path in (box / "work").iterdir() if _is_foreign(path)}


def _is_foreign(path: Path) -> bool:
    return (
        path.name not in {"results", "small.py", "small.registration.json", "hostile"}
        or (path.name == "results" and {each.name for each in path.iterdir()} != {"small"})
        or stat.S_ISLNK(path.lstat().st_mode)
    )
