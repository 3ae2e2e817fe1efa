"""Analysis plans in files, for results whose config has none; and their choices in words.

The file may also declare the design of results from elsewhere.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

from robot_runner.analysis.declared_design import DeclaredDesign
from robot_runner.core.design.analysis_plan import AnalysisPlan, Estimand
from robot_runner.core.design.outliers import Doubtful
from robot_runner.core.errors import AnalysisError
from robot_runner.core.storage.system_refusals import storage_error
from robot_runner.core.words import enumerated

_DESIGN = "design"


class PlanFile(NamedTuple):
    """The contents of a plan file; None for a part that the file does not have."""

    analysis: AnalysisPlan | None
    design: DeclaredDesign | None


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file that a user wrote.

    Raises:
        AnalysisError: the file is not TOML.
        StorageError: the file cannot be read.
    """
    try:
        return tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise storage_error(path, "read", error) from error
    except (ValueError, RecursionError) as error:  # also of numbers with thousands of digits, and deep brackets
        raise AnalysisError(f"the file is not TOML: {error}", where=str(path), fix="Correct this line.") from error


def read_plan(path: Path) -> PlanFile:
    """Read a plan from a TOML file, which has the attributes of `AnalysisPlan`, and `[design]`.

    Raises:
        AnalysisError: the file is not TOML, or its design is invalid.
        DesignError: the plan is invalid.
        StorageError: the file cannot be read.
    """
    plain = read_toml(path)
    declared = plain.pop(_DESIGN, None)
    if declared is not None and not isinstance(declared, dict):
        raise AnalysisError(f"design is {declared!r}", where=str(path), fix="Write [design] and its entries below it.")
    design = None if declared is None else DeclaredDesign.of_mapping(declared, f"{path}, [design]")
    return PlanFile(AnalysisPlan.of_mapping(plain) if plain or design is None else None, design)


def choices_in_words(plan: AnalysisPlan, unit: Callable[[str], str]) -> Iterator[str]:
    """Yield the choices of a plan for estimand, outliers, doubtful values and covariates, as far as it makes any."""
    if plan.estimand is not Estimand.MEAN:
        yield f"{plan.estimand.value}s are compared, not means"
    if plan.outliers is not None:
        rules: dict[str, list[str]] = {}
        for name in plan.outliers.bounds:
            rules.setdefault(plan.outliers.in_words(name, unit(name)), []).append(name)
        # A rule of spread holds for all measures, exploratory ones included; bounds hold for one measure.
        others = f"every {'other ' * bool(rules)}numeric measure"
        rules.setdefault(plan.outliers.in_words(""), []).append(others)
        for rule, of in rules.items():
            if rule:
                yield f"left out as outliers: values of {enumerated(of)} {rule}"
    if plan.doubtful is not Doubtful.KEEP:
        leaves_out = plan.doubtful is Doubtful.LEAVE_OUT
        yield "doubtful values are left out" if leaves_out else "no conclusion on measures with doubtful values"
    if plan.covariates:
        yield f"adjusted for {enumerated(plan.covariates)}"
