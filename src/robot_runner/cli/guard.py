"""Executes commands for the shell: each outcome has its exit code, and an error is printed without a traceback."""

from __future__ import annotations

import errno
import sys

from robot_runner.cli.harmless_stream import guard_streams, let_go_of

TYPE_CHECKING = False  # `typing` takes long to import, and `--help` is to be quick
if TYPE_CHECKING:
    from collections.abc import Callable

SOME_FAILED = 1
REFUSED = 2
#: A fault of Robot Runner, as in sysexits.h (EX_SOFTWARE).
FAULT = 70
INTERRUPTED = 130
#: Errors by which the system refuses access to a file or folder, mostly another user's; even `exists` may raise them.
_REFUSALS = frozenset({errno.EACCES, errno.EPERM, errno.EROFS, errno.ENAMETOOLONG, errno.EMFILE, errno.ENFILE})
#: As a shell shows that SIGPIPE ended a program.
BROKEN_PIPE = 141


def guarded(command: Callable[[], int], *, show_traceback: bool = False) -> int:
    """Execute a command and return its exit code, whatever it raises and prints."""
    _replace_closed_streams()
    _make_streams_lenient()
    earlier = guard_streams()
    try:
        return _executed(command, show_traceback=show_traceback)
    finally:
        sys.stdout, sys.stderr = earlier


def _executed(command: Callable[[], int], *, show_traceback: bool) -> int:
    try:
        code = command()
        sys.stdout.flush()
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:  # `| head` has read enough
        let_go_of(sys.stdout)
        return BROKEN_PIPE
    except MemoryError as error:
        return _lacking_memory(error, show_traceback=show_traceback)
    except Exception as error:  # noqa: BLE001 - whatever it is, the user gets a line instead of a traceback
        return _explained(error, show_traceback=show_traceback)
    return code


def show_fault(error: Exception, *, show_traceback: bool) -> None:
    """Print that this is a fault of Robot Runner; the traceback goes to the terminal, or to a file that is named."""
    import traceback  # noqa: PLC0415 - as above

    from robot_runner.cli.findings import show_findings  # noqa: PLC0415 - as above
    from robot_runner.core.errors import Finding  # noqa: PLC0415 - as above
    from robot_runner.core.secret_names import without_environment_secrets  # noqa: PLC0415 - as above

    text = without_environment_secrets("".join(traceback.format_exception(error)))  # people report it in public
    if show_traceback:
        sys.stderr.write(text)
        fix = "Report it with this traceback."
    elif kept := _kept(text):
        fix = f"Report it with the file {kept}, or repeat the command with --debug."
    else:
        fix = "Repeat the command with --debug, and report it with the traceback that is shown then."
    said = without_environment_secrets(f"{type(error).__name__}: {error}")
    show_findings([Finding.error("", f"this is a fault of Robot Runner, not yours: {said}", fix)])


def _kept(text: str) -> str:
    """Write a traceback to a temporary file; return its name, or nothing if it cannot be written."""
    import platform  # noqa: PLC0415 - as above
    import tempfile  # noqa: PLC0415 - as above
    from importlib.metadata import version  # noqa: PLC0415 - as above

    from robot_runner.core.secret_names import shown_assignments  # noqa: PLC0415 - as above

    head = f"robot-runner {version('robot-runner')}, Python {platform.python_version()}, {platform.platform()}\n"
    words = [part for each in sys.argv for part in (each.split("=", 1) if each.startswith("--set=") else [each])]
    command = " ".join(shown_assignments(words))
    try:
        with tempfile.NamedTemporaryFile(
            "w", prefix="robot-runner-fault-", suffix=".txt", delete=False, encoding="utf-8", errors="backslashreplace"
        ) as file:
            file.write(f"{head}{command}\n\n{text}")
    except OSError:
        return ""
    return file.name


def _lacking_memory(error: MemoryError, *, show_traceback: bool) -> int:
    """Print that there is not enough memory, without importing anything: it may not fit."""
    problem = f"there is not enough memory for this{f': {error}' if str(error) else ''}"
    fix = "End other programs, raise the limit of memory (ulimit -v, a container's), or use a larger machine."
    sys.stderr.write(f"error: this machine: {problem}\n  fix: {fix}\n")
    if show_traceback:
        import traceback  # noqa: PLC0415 - as above

        traceback.print_exception(error)
    return REFUSED


def _explained(error: Exception, *, show_traceback: bool) -> int:
    from pathlib import Path  # noqa: PLC0415 - as above

    from robot_runner.core.errors import RobotRunnerError, StorageError  # noqa: PLC0415 - as above
    from robot_runner.core.storage.system_refusals import GONE, storage_error  # noqa: PLC0415 - as above

    if isinstance(error, OSError) and error.errno in {errno.ENOSPC, errno.EDQUOT}:  # mostly of `> file`
        let_go_of(sys.stdout)
        problem = f"the output cannot be written: {error.strerror}"
        error = StorageError(problem, fix="Make room on the disk, or send the output elsewhere.")
    if isinstance(error, FileNotFoundError) and not error.filename and (refusal := _missing_folder(error)):
        error = StorageError(refusal[0], fix=refusal[1])
    if isinstance(error, OSError) and error.errno in _REFUSALS | GONE and isinstance(error.filename, str):
        error = storage_error(Path(error.filename), "opened", error)
    if not isinstance(error, RobotRunnerError):
        show_fault(error, show_traceback=show_traceback)
        return FAULT
    from robot_runner.cli.findings import show_findings  # noqa: PLC0415 - as above

    show_findings(error.findings)
    if show_traceback:
        import traceback  # noqa: PLC0415 - as above

        traceback.print_exception(error)
    return REFUSED


def _missing_folder(error: FileNotFoundError) -> tuple[str, str] | None:
    """Return problem and fix where a folder is missing that any program needs."""
    import os  # noqa: PLC0415 - as above

    if (error.strerror or "").startswith("No usable temporary directory"):
        fix = "Make room in one of them, or have TMPDIR be a folder that can be written."
        return f"no folder takes temporary files: {error.strerror}", fix
    try:
        os.getcwd()  # noqa: PTH109 - as above
    except FileNotFoundError:
        return "the current folder was removed or renamed", "Go to one that is there: cd FOLDER."
    return None


def _replace_closed_streams() -> None:
    """Open the null device in place of a closed standard stream: output would go to the next opened file."""
    import os  # noqa: PLC0415 - as above

    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            nothing = os.open(os.devnull, os.O_RDWR)
            if nothing != number:
                os.dup2(nothing, number)
                os.close(nothing)
            os.set_inheritable(number, True)  # noqa: FBT003 - the system's own signature
            stream = os.fdopen(number, "r" if number == 0 else "w", encoding="utf-8", closefd=False)
            setattr(sys, name, stream)
            setattr(sys, f"__{name}__", stream)


def _make_streams_lenient() -> None:
    # On a terminal that knows only ASCII, other characters become question marks instead of errors.
    for stream in (sys.stdout, sys.stderr):
        if (getattr(stream, "encoding", None) or "utf-8").lower().replace("-", "") != "utf8":
            try:  # noqa: SIM105 - `contextlib` takes long to import
                stream.reconfigure(errors="replace")  # type: ignore[union-attr]
            except (AttributeError, ValueError):
                pass
