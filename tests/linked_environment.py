"""A virtual environment with some of the packages of the tests' own, and no others: nothing is fetched for it."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING

from tests.python_program import first_lines

if TYPE_CHECKING:
    from collections.abc import Iterable

PROGRAM = """\
import sys

from robot_runner.cli.main import main

sys.exit(main())
"""


def locked_names(lock: Path) -> list[str]:
    """Return the distributions that a requirements file pins."""
    return re.findall(r"^([\w.-]+)==", lock.read_text("utf-8"), re.MULTILINE)


def is_locked_environment(lock: Path) -> bool:
    """Return whether the tests run with the versions of a lock, and not with the oldest or newest ones."""
    pinned = re.findall(r"^rich==([\w.]+)", lock.read_text("utf-8"), re.MULTILINE)
    return pinned == [metadata.version("rich")]


def make_linked_environment(folder: Path, names: Iterable[str], *, code: Path) -> Path:
    """Make an environment with these distributions, as links, and Robot Runner as if it were installed from `code`.

    Returns:
        Its program `robot-runner`.
    """
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", folder], check=True, timeout=60)
    site = next(folder.glob("lib/python*/site-packages"))
    for name in (*names, "robot-runner"):
        _link(name, site)
    path_file = next(site.glob("*robot_runner*.pth"))
    path_file.unlink()
    path_file.write_text(f"{code}\n", encoding="utf-8")
    program = folder / "bin" / "robot-runner"
    program.write_text(first_lines(python=folder / "bin" / "python") + PROGRAM, encoding="utf-8")
    program.chmod(0o755)
    return program


def _link(name: str, site: Path) -> None:
    """Link the files of a distribution; one that is for other systems is not installed here."""
    try:
        found = metadata.distribution(name)
    except metadata.PackageNotFoundError:
        return
    for file in found.files or ():
        origin, target = Path(str(file.locate())), site / file
        # Bytecode as well, as pip leaves it: else each environment would compile all libraries anew.
        if ".." not in file.parts and origin.exists():
            target.parent.mkdir(parents=True, exist_ok=True)
            target.unlink(missing_ok=True)
            try:
                os.link(origin.resolve(), target)  # no symbolic one: those are not packed
            except OSError:  # another file system
                shutil.copyfile(origin, target)
