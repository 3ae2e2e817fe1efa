"""A plan of the analysis in a file of its own, for results whose config fixed none; and its choices in words."""

from __future__ import annotations

import tomllib
from typing import TYPE_CHECKING

from robot_runner.core.design.analysis_plan import AnalysisPlan
from robot_runner.core.design.outliers import Doubtful
from robot_runner.core.errors import AnalysisError
from robot_runner.core.storage.system_refusals import storage_error
from robot_runner.core.words import enumerated

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

__all__ = ["choices_in_words", "read_plan"]


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


def choices_in_words(plan: AnalysisPlan, unit: Callable[[str], str]) -> Iterator[str]:
    """Yield what a plan says of outliers, doubtful values and covariates, where it says anything."""
    if plan.outliers is not None:
        names = dict.fromkeys((*plan.measures, *plan.secondary, *plan.outliers.bounds))
        rules: dict[str, list[str]] = {}
        for name in names:
            rules.setdefault(plan.outliers.in_words(name, unit(name)), []).append(name)
        for rule, of in rules.items():
            if rule:
                yield f"left out as outliers: values of {enumerated(of)} {rule}"
    if plan.doubtful is not Doubtful.KEEP:
        leaves_out = plan.doubtful is Doubtful.LEAVE_OUT
        yield "doubtful values are left out" if leaves_out else "no conclusion on measures with doubtful values"
    if plan.covariates:
        yield f"adjusted for {enumerated(plan.covariates)}"
