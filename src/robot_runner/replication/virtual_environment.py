"""The Python environment of a package, made again in a folder of its own."""

from __future__ import annotations

import shutil
import subprocess
import sys
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

from robot_runner.core.errors import PackageError
from robot_runner.core.storage.safe_write import storage_error
from robot_runner.replication.contents import REQUIREMENTS, WHEELS
from robot_runner.replication.differences import Difference, differing_packages
from robot_runner.replication.distributions import InstalledDistribution, canonical

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

__all__ = ["make_environment", "program_of", "remaining_differences"]

_DEADLINE_S = 3600.0
_SHOWN_LINES = 8


def make_environment(root: Path, folder: Path, environment: Mapping[str, Any]) -> Path:
    """Make a virtual environment and install what a package needs; one that is complete is used as it is.

    What the package brings as wheels is taken from it; pip gets the rest from wherever it is set up to, and demands the
    hashes where the package has them of all files.

    Args:
        root: the unpacked package.
        folder: where the environment is to be.
        environment: as the package has it; its Python is taken where it is installed here under its usual name.

    Returns:
        The program `robot-runner` in it.

    Raises:
        PackageError: it cannot be made; shows the last lines that pip wrote.
        StorageError: the folder cannot be written.
    """
    program = program_of(folder)
    done = folder / "complete"
    if done.exists():
        return program
    log = folder.with_name(f"{folder.name}.log")
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        log.unlink(missing_ok=True)
        _call([_python(environment), "-m", "venv", "--clear", str(folder)], log)
        wheels = ["--find-links", str(root / WHEELS)] if (root / WHEELS).is_dir() else []
        pip = [str(folder / "bin" / "python"), "-m", "pip", "install", "--no-input", "--disable-pip-version-check"]
        _call([*pip, *wheels, "-r", str(root / REQUIREMENTS)], log)
        done.touch()
    except OSError as error:
        raise storage_error(folder, "made", error) from error
    return program


def program_of(folder: Path) -> Path:
    """Return where the program `robot-runner` is in an environment."""
    return folder / "bin" / "robot-runner"


def remaining_differences(folder: Path, environment: Mapping[str, Any]) -> list[Difference]:
    """Return what is installed in an environment otherwise than it was, by version and by fingerprint of the files."""
    places = [str(path) for path in folder.glob("lib/python*/site-packages")]
    installed = {
        canonical(each.metadata["Name"]): InstalledDistribution(each.metadata["Name"], each.version, each)
        for each in metadata.distributions(path=places)
    }
    return differing_packages(environment, installed)


def _python(environment: Mapping[str, Any]) -> str:
    wanted = ".".join(str(environment.get("python") or "").split(".")[:2])
    if wanted == f"{sys.version_info.major}.{sys.version_info.minor}":
        return sys.executable
    return shutil.which(f"python{wanted}") or sys.executable


def _call(words: Sequence[str], log: Path) -> None:
    with log.open("ab") as output:
        try:
            finished = subprocess.run(  # noqa: S603 - words of our own
                words,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                timeout=_DEADLINE_S,
                check=False,
            )
        except subprocess.TimeoutExpired as error:
            problem = f"{Path(words[0]).name} took longer than {_DEADLINE_S:.0f} s"
            raise PackageError(problem, where=str(log), fix="Look at what it wrote there.") from error
    if finished.returncode:
        lines = log.read_text(encoding="utf-8", errors="replace").splitlines()[-_SHOWN_LINES:]
        raise PackageError(
            f"the environment cannot be made: {' / '.join(line.strip() for line in lines if line.strip())}",
            where=str(log),
            fix="Mend what is said there, or take your own environment: --environment here. The first lines of "
            "environment/requirements.txt say for which Python and platforms its hashes are.",
        )
