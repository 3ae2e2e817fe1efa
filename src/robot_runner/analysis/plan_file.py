"""A plan of the analysis in a file of its own, for results whose config fixed none; and its choices in words.

The file may declare the design, too, by which results were planned that were made elsewhere.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

from robot_runner.analysis.declared_design import DeclaredDesign
from robot_runner.core.design.analysis_plan import AnalysisPlan
from robot_runner.core.design.outliers import Doubtful
from robot_runner.core.errors import AnalysisError
from robot_runner.core.storage.system_refusals import storage_error
from robot_runner.core.words import enumerated

_DESIGN = "design"


class PlanFile(NamedTuple):
    """What a file of a plan holds; None where it says nothing of it."""

    analysis: AnalysisPlan | None
    design: DeclaredDesign | None


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file that a user wrote.

    Raises:
        AnalysisError: the file is no TOML.
        StorageError: it cannot be read.
    """
    try:
        return tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise storage_error(path, "read", error) from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise AnalysisError(f"the file is not TOML: {error}", where=str(path), fix="Mend this line.") from error


def read_plan(path: Path) -> PlanFile:
    """Read a plan from a TOML file, whose entries are the choices of `AnalysisPlan`, and `[design]`.

    Raises:
        AnalysisError: the file is no TOML, or what it declares is no design.
        DesignError: what it holds is no plan.
        StorageError: it cannot be read.
    """
    plain = read_toml(path)
    declared = plain.pop(_DESIGN, None)
    if declared is not None and not isinstance(declared, dict):
        raise AnalysisError(f"design is {declared!r}", where=str(path), fix="Write [design] and its entries below it.")
    design = None if declared is None else DeclaredDesign.of_mapping(declared, f"{path}, [design]")
    return PlanFile(AnalysisPlan.of_mapping(plain) if plain or design is None else None, design)


def choices_in_words(plan: AnalysisPlan, unit: Callable[[str], str]) -> Iterator[str]:
    """Yield what a plan says of outliers, doubtful values and covariates, where it says anything."""
    if plan.outliers is not None:
        rules: dict[str, list[str]] = {}
        for name in plan.outliers.bounds:
            rules.setdefault(plan.outliers.in_words(name, unit(name)), []).append(name)
        # A rule of spread holds for all measures, exploratory ones as well; only bounds are of one.
        rules.setdefault(plan.outliers.in_words(""), []).append(f"every {'other ' * bool(rules)}numeric measure")
        for rule, of in rules.items():
            if rule:
                yield f"left out as outliers: values of {enumerated(of)} {rule}"
    if plan.doubtful is not Doubtful.KEEP:
        leaves_out = plan.doubtful is Doubtful.LEAVE_OUT
        yield "doubtful values are left out" if leaves_out else "no conclusion on measures with doubtful values"
    if plan.covariates:
        yield f"adjusted for {enumerated(plan.covariates)}"
