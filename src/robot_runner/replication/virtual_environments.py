"""Virtual environments in the folder of a replication: one to execute it, and one to compare its results."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from types import FrameType
from typing import Any, TextIO

from robot_runner.core.errors import PackageError
from robot_runner.core.execution.interruption import stop_signals_handled
from robot_runner.core.execution.processes import stop_with_parent
from robot_runner.core.storage.guarded_files import read_text
from robot_runner.core.storage.system_refusals import storage_errors
from robot_runner.replication.contents import REQUIREMENTS, WHEELS
from robot_runner.replication.distributions import installed_distributions, wheel_name, wheel_of, write_wheel

_OUR_NAME = "robot-runner"
_DEADLINE_S = 3600.0
_SHOWN_LINES = 8
_NO_TALK = ("--no-input", "--disable-pip-version-check", "--progress-bar", "off")
_OWN_PYTHON = f"{sys.version_info.major}.{sys.version_info.minor}"
_COMPLETE = "complete"


def is_complete(folder: Path) -> bool:
    """Return whether a virtual environment was completed."""
    return (folder / _COMPLETE).exists()


def program_in(folder: Path) -> Path:
    """Return the path of `robot-runner` in a virtual environment."""
    return folder / "bin" / _OUR_NAME


def make_environment(root: Path, folder: Path, environment: Mapping[str, Any]) -> Path:
    """Make a virtual environment with the packages that an experiment needs; a complete one is reused.

    Wheels come from the package, and everything else from the index of pip's settings. Pip demands hashes if the
    package has them for all files.

    Args:
        root: the unpacked package.
        folder: the folder of the new environment.
        environment: the package's; its version of Python is used if it is installed here under its usual name.

    Returns:
        The path of `robot-runner` in it.

    Raises:
        PackageError: the environment cannot be made; shows the last lines of pip's output.
        StorageError: the folder cannot be written.
    """
    if is_complete(folder):
        return program_in(folder)
    python, wanted = _python(environment), _wanted_python(environment)
    fix = "Correct what is said there, or take your own environment: --environment here."
    asked = ["--find-links", str(root / WHEELS)] if (root / WHEELS).is_dir() else []
    if any("--hash=" in line.partition("#")[0] for line in read_text(root / REQUIREMENTS, root).splitlines()):
        # With hashes the list is complete. Pip before 23.3 refuses such a list if a package is needed with an extra
        # (`coverage[toml]`) and has a newer release, unless it is told to install no dependencies.
        asked.append("--no-deps")
        fix += f" The first lines of {REQUIREMENTS} say for which Python and platforms its hashes are."
        if python == sys.executable and wanted not in {"", _OWN_PYTHON}:
            fix += f" The hashes are of files for Python {wanted}, and this is Python {_OWN_PYTHON}: install that one, "
            fix += f"so that python{wanted} is found, if it is files that do not fit."
    _make(folder, python, [*asked, "-r", str(root / REQUIREMENTS)], fix)
    return program_in(folder)


def make_comparison_environment(folder: Path) -> Path:
    """Make a virtual environment for the comparison of results: this Robot Runner with its extra `analysis`.

    It is separate from the environment of the experiment, so that no version there changes.

    Args:
        folder: the folder of the new environment; a complete one is reused.

    Returns:
        The path of `robot-runner` in it.

    Raises:
        PackageError: the environment cannot be made; shows the last lines of pip's output.
        StorageError: the folder cannot be written.
    """
    if not is_complete(folder):
        ours = installed_distributions()[_OUR_NAME]
        wheel = folder.parent / wheel_name(ours)
        with storage_errors(wheel, "written"):
            folder.parent.mkdir(parents=True, exist_ok=True)
            wheel.unlink(missing_ok=True)  # left by one that was killed
            write_wheel(wheel_of(ours), wheel)
        fix = "Correct what is said there, or install the extra yourself: pip install 'robot-runner[analysis]'. "
        fix += "Then repeat the command: no run is executed again."
        try:
            _make(folder, sys.executable, [f"{_OUR_NAME}[analysis] @ {wheel.resolve().as_uri()}"], fix)
        finally:
            wheel.unlink(missing_ok=True)
    return program_in(folder)


def compare_with(program: Path, original: Path, replication: Path, bounds: Sequence[str], page: Path) -> dict[str, Any]:
    """Compare two experiments by the `robot-runner` of another environment.

    Returns:
        The output of `robot-runner compare --json`.

    Raises:
        PackageError: the comparison failed; shows the program's output.
    """
    words = [str(program), "compare", str(original), str(replication), "--json", "--html", str(page)]
    words += [word for bound in bounds for word in ("--bound", bound)]
    try:
        done = subprocess.run(  # noqa: S603 - words of our own
            words, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=_DEADLINE_S, check=False
        )
        if done.returncode == 0:
            found: dict[str, Any] = json.loads(done.stdout)
            return found
        said = done.stderr.strip().splitlines()
    except (OSError, ValueError, subprocess.TimeoutExpired) as error:
        said = [str(error)]
    problem = f"the results cannot be compared: {' / '.join(said[-_SHOWN_LINES:])}"
    raise PackageError(problem, where=str(program), fix="Remove its environment, then repeat the command.")


def _make(folder: Path, python: str, asked: Sequence[str], fix: str) -> None:
    log = folder.with_name(f"{folder.name}.log")
    # Our own pip can install into other environments, and installing pip into each is the slowest step. But the other
    # environment's Python executes it, and pip fails if that Python is too new for it (Debian 12's pip 23.0 on 3.12).
    has_pip = find_spec("pip") is not None and python == sys.executable
    inside = str(folder / "bin" / "python")
    pip = [sys.executable, "-m", "pip", "--python", inside] if has_pip else [inside, "-m", "pip"]
    with storage_errors(folder, "made"):
        folder.parent.mkdir(parents=True, exist_ok=True)
        log.unlink(missing_ok=True)
        _call([python, "-m", "venv", "--clear", *["--without-pip"] * has_pip, str(folder)], log, fix)
        _call([*pip, "install", *_NO_TALK, *asked], log, fix)
        (folder / _COMPLETE).touch()


def _wanted_python(environment: Mapping[str, Any]) -> str:
    return ".".join(str(environment.get("python") or "").split(".")[:2])


def _python(environment: Mapping[str, Any]) -> str:
    wanted = _wanted_python(environment)
    if wanted == _OWN_PYTHON:
        return sys.executable
    return shutil.which(f"python{wanted}") or sys.executable


def _call(words: Sequence[str], log: Path, fix: str) -> None:
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
        is_error = [line.lstrip().lower().startswith("error") for line in lines]
        first = is_error.index(True) if any(is_error) else 0  # before it stands what pip did
        said = " / ".join(line.strip() for line in lines[first:] if line.strip())
        raise PackageError(f"the environment cannot be made: {said}", where=str(log), fix=fix)


def execute_with(program: Path, words: Sequence[str], *, quietly: str, output: TextIO | None) -> int:
    """Execute the program of another environment in this terminal, and return its exit code.

    A stop request is forwarded to the program, whose end is awaited: it has to make its robot safe.

    Args:
        program: its path.
        words: its arguments.
        quietly: an option that is added if that version of the program knows it.
        output: the file for its output; None for our own standard output.

    Raises:
        PackageError: the program cannot be started.
    """
    try:
        known = subprocess.run(  # noqa: S603 - words of our own
            [str(program), words[0], "--help"], stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False
        )
        asked = [str(program), *words, *([quietly] if quietly in known.stdout else [])]
        with _passed_on() as pass_on_to:
            # In a session of its own, so that each signal arrives once: a terminal sends Ctrl-C to all of a session.
            # No terminal would reach it where we are killed, so that the system tells it then (Linux).
            process = subprocess.Popen(  # noqa: S603 - as above
                asked,
                stdout=output,
                start_new_session=True,
                preexec_fn=stop_with_parent,  # noqa: PLW1509 - one system call, no lock
            )
            pass_on_to(process)
            return process.wait()
    except OSError as error:
        fix = "Remove the environment, then repeat the command."
        raise PackageError(f"the program cannot be started: {error}", where=str(program), fix=fix) from error


@contextmanager
def _passed_on() -> Iterator[Callable[[subprocess.Popen[bytes]], None]]:
    """Yield what takes a process: stop requests, also earlier ones, are forwarded to it, and do not interrupt us."""
    processes: list[subprocess.Popen[bytes]] = []
    asked: list[int] = []

    def pass_on() -> None:
        while processes and asked:
            processes[0].send_signal(asked.pop(0))

    def take_signal(number: int, _frame: FrameType | None) -> None:
        asked.append(number)
        pass_on()

    def take_process(process: subprocess.Popen[bytes]) -> None:
        processes.append(process)
        pass_on()

    with stop_signals_handled(take_signal):
        yield take_process
