"""Write figures as PDF in a second process: embedding fonts takes longer than everything else."""

from __future__ import annotations

import gc
import json
import pickle
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import IO, TYPE_CHECKING, Self, cast

from robot_runner.analysis.figures.style import FigureFormat, figure_bytes
from robot_runner.core.errors import AnalysisError, StorageError
from robot_runner.core.storage.guarded_files import replace

if TYPE_CHECKING:
    from types import TracebackType

    from matplotlib.figure import Figure

_MODULE = "robot_runner.analysis.figures.pdf_worker"
_DEADLINE = 300.0  # s, for the remaining figures after the last was handed over
_COULD_NOT_WRITE = 3


class PdfWorker:
    """Write figures as PDF in the background; leaving the context waits for the last one.

    Example:
        >>> with PdfWorker() as worker:  # doctest: +SKIP
        ...     worker.write(figure, Path("figure.pdf"))

    Raises:
        StorageError: on leaving: a file cannot be written.
        AnalysisError: on leaving: the process failed.
    """

    def __init__(self) -> None:
        self._complaint = tempfile.TemporaryFile()  # noqa: SIM115 - closed on leaving; a pipe could fill up
        # -P: modules in the user's folder must not shadow ours.
        self._process = subprocess.Popen(  # noqa: S603 - this Python, and a module of ours
            [sys.executable, "-P", "-m", _MODULE], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self._complaint
        )
        self._input = cast("IO[bytes]", self._process.stdin)  # not None, because of stdin=PIPE

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with self._complaint:
            try:
                if error is None:
                    self._finish()
            finally:
                self._process.kill()
                self._process.communicate()

    def write(self, figure: Figure, path: Path, root: Path) -> None:
        """Hand over a figure to write below `root`; the caller may go on using the figure."""
        data = pickle.dumps((figure, path, root))
        try:
            self._input.write(len(data).to_bytes(8, "big") + data)
        except BrokenPipeError:
            self._finish()

    def _finish(self) -> None:
        try:
            answer, _ = self._process.communicate(timeout=_DEADLINE)
        except subprocess.TimeoutExpired as error:
            fix = "Ask for fewer formats of figures."
            problem = f"figures were not written as PDF within {_DEADLINE:g} s"
            raise AnalysisError(problem, where="figures", fix=fix) from error
        if self._process.returncode == _COULD_NOT_WRITE:
            raise StorageError(**json.loads(answer))
        if self._process.returncode != 0:
            self._complaint.seek(0)
            last = self._complaint.read().decode("utf-8", "replace").strip().splitlines()[-1:]
            raise AnalysisError(f"figures cannot be written as PDF: {''.join(last)}", where="figures", fix="Try again.")


def main() -> int:
    """Write the figures from standard input until it ends."""
    gc.freeze()  # fonts create many short-lived objects; modules need not be examined with these
    while head := sys.stdin.buffer.read(8):
        # The pickles come from the process that started this one.
        figure, path, root = pickle.loads(sys.stdin.buffer.read(int.from_bytes(head, "big")))  # noqa: S301
        try:
            replace(path, figure_bytes(figure, FigureFormat.PDF), root, is_lasting=False)
        except StorageError as error:
            sys.stdout.write(json.dumps({"problem": error.problem, "where": error.where, "fix": error.fix}))
            return _COULD_NOT_WRITE
    return 0


if __name__ == "__main__":
    sys.exit(main())
