"""A plan of the analysis in a file of its own, for results whose config fixed none."""

from __future__ import annotations

import tomllib
from typing import TYPE_CHECKING

from robot_runner.core.design.analysis_plan import AnalysisPlan
from robot_runner.core.errors import AnalysisError
from robot_runner.core.storage.safe_write import storage_error

if TYPE_CHECKING:
    from pathlib import Path

__all__ = ["read_plan"]


def read_plan(path: Path) -> AnalysisPlan:
    """Read a plan from a TOML file, whose entries are the choices of `AnalysisPlan`.

    Raises:
        AnalysisError: the file is no TOML.
        DesignError: what it holds is no plan.
        StorageError: it cannot be read.
    """
    try:
        plain = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise storage_error(path, "read", error) from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise AnalysisError(f"the file is not TOML: {error}", where=str(path), fix="Mend this line.") from error
    return AnalysisPlan.of_mapping(plain)
