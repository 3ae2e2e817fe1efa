"""The libraries of the `analysis` extra: heavier than a robot's computer should carry, so they may be absent."""

from __future__ import annotations

from importlib.util import find_spec

from robot_runner.core.errors import AnalysisError

#: The packages by the names under which they are imported.
_NEEDED = ("numpy", "pandas", "pint", "pyarrow", "scipy", "statsmodels", "matplotlib", "jinja2")


class MissingLibraryError(AnalysisError, ImportError):
    """A library of the `analysis` extra that is not installed."""


def require_libraries() -> None:
    """Find out, without importing them, whether the libraries of the extra are installed.

    Raises:
        MissingLibraryError: some are not; names them and how to install them.
    """
    missing = [name for name in _NEEDED if find_spec(name) is None]
    if missing:
        problem = f"{', '.join(missing)} {'is' if len(missing) == 1 else 'are'} not installed"
        fix = "Install the extra: pip install 'robot-runner[analysis]'"
        raise MissingLibraryError(problem, where="robot_runner.analysis", fix=fix)
