"""What is wrong with a run table's file: every problem, with its line and column, up to a sensible number."""

from __future__ import annotations

from typing import TYPE_CHECKING

from robot_runner.errors import Finding, Severity, StorageError

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

__all__ = ["TableFindings"]

#: Whoever saved a table wrongly gets one problem in each row: nobody reads a million.
_MOST = 50


class TableFindings:
    """Gathers what is wrong with one file. A fix that takes long to find is asked for only where it is listed.

    Example:
        >>> from pathlib import Path
        >>> findings = TableFindings(Path("run_table.csv"))
        >>> findings.warning("'vidoe' is no treatment", "Did you mean 'Video'?", line=4, column="Task")
        >>> print(*findings.warnings)
        run_table.csv, line 4, column 'Task': 'vidoe' is no treatment → Did you mean 'Video'?
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._found: dict[Severity, list[Finding]] = {severity: [] for severity in Severity}
        self._unlisted = dict.fromkeys(Severity, 0)

    def error(
        self, problem: str, fix: str | Callable[[], str], *, line: int | None = None, column: str | None = None
    ) -> None:
        """Note what keeps the table from being used."""
        self._note(Severity.ERROR, problem, fix, line, column)

    def warning(
        self, problem: str, fix: str | Callable[[], str], *, line: int | None = None, column: str | None = None
    ) -> None:
        """Note what looks odd."""
        self._note(Severity.WARNING, problem, fix, line, column)

    @property
    def warnings(self) -> tuple[Finding, ...]:
        """What looks odd, and how much more of it there is than is listed."""
        return self._listed(Severity.WARNING)

    def raise_errors(self) -> None:
        """Refuse the table if anything keeps it from being used.

        Raises:
            StorageError: it carries every error and every warning.
        """
        if self._found[Severity.ERROR]:
            raise StorageError.of_findings((*self._listed(Severity.ERROR), *self.warnings))

    def _note(
        self, severity: Severity, problem: str, fix: str | Callable[[], str], line: int | None, column: str | None
    ) -> None:
        if len(self._found[severity]) >= _MOST:
            self._unlisted[severity] += 1
            return
        where = str(self._path)
        if line is not None:
            where += f", line {line}"
        if column is not None:
            where += f", column {column!r}"
        self._found[severity].append(Finding(severity, where, problem, fix if isinstance(fix, str) else fix()))

    def _listed(self, severity: Severity) -> tuple[Finding, ...]:
        found = tuple(self._found[severity])
        if not self._unlisted[severity]:
            return found
        rest = Finding(severity, str(self._path), f"there are {self._unlisted[severity]:,} more of them", "")
        return (*found, rest)
