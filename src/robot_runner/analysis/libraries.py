"""The libraries of the `analysis` extra, which may be absent: they are too heavy for a robot's computer."""

from __future__ import annotations

from importlib.util import find_spec

from robot_runner.core.errors import AnalysisError

#: The packages by the names under which they are imported.
_NEEDED = ("numpy", "pandas", "pint", "pyarrow", "scipy", "statsmodels", "matplotlib", "jinja2")


class MissingLibraryError(AnalysisError, ImportError):
    """A library of the `analysis` extra that is not installed."""


def require_libraries() -> None:
    """Check, without importing them, that the libraries of the extra are installed.

    Raises:
        MissingLibraryError: some are not; it names them and says how to install them.
    """
    missing = [name for name in _NEEDED if find_spec(name) is None]
    if missing:
        problem = f"{', '.join(missing)} {'is' if len(missing) == 1 else 'are'} not installed"
        fix = "Install the extra: pip install 'robot-runner[analysis]'"
        raise MissingLibraryError(problem, where="robot_runner.analysis", fix=fix)
