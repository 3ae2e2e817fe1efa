"""The Jupyter notebook and the R script that recompute every number of a report."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from datetime import UTC, datetime
from enum import Enum
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from robot_runner.analysis.recomputing.fact_finding import facts_of_study
from robot_runner.analysis.recomputing.literals import Code, python_literal, r_literal, rendered
from robot_runner.analysis.recomputing.reported import LEVEL
from robot_runner.analysis.recomputing.study_facts import Compared, Contrasted, StudyFacts, TestedEffect
from robot_runner.analysis.report.writing import made_by, report_folder
from robot_runner.analysis.results import Results, results_of
from robot_runner.analysis.statistics.nested_factors import IDLE
from robot_runner.core.design.analysis_plan import AnalysisPlan
from robot_runner.core.storage.guarded_files import make_folder, replace

if TYPE_CHECKING:
    from robot_runner.analysis.recomputing.reported import Reported


def r_script(study: StudyFacts) -> str:
    """Return the R script, for R 4.0 and its own packages."""
    return rendered(
        "recompute.R.j2",
        **_common(study, ", {}", r_literal, ", tolerance = 1e-4", "NULL", "function(groups, contrasts) {}"),
        table=_r_table,
        keys=lambda reported: r_literal([label for label, _ in reported.rows]),
        separator=lambda is_last: Code("" if is_last else ","),
        chosen=_chosen,
        which_of=_which_of,
        coding=lambda of: _r_list(of.items()),
        weights=_weights,
        treatments=_r_list,
        conditions=lambda of: _r_list(of, _r_list),
        applied=lambda study, factors: Code(
            f"every[{_r_applied(factors)}, ]" if study.is_conditional(factors) else "every"
        ),
        where_applied=_r_applied,
    )


def _r_list(of: Iterable[tuple[str, Any]], literal: Callable[[Any], Code] = r_literal) -> Code:
    return Code(f"list({', '.join(f'{r_literal(name)} = {literal(each)}' for name, each in of)})")


def _r_applied(factors: Sequence[str]) -> Code:
    """Return the condition that a factor applies to a run."""
    return Code(f"every[[{r_literal(factors[0])}]] != {r_literal(IDLE)}")


def _r_table(reported: Reported) -> Code:
    rows = [f"  list({', '.join(map(r_literal, (label, *numbers)))})" for label, numbers in reported.rows]
    columns = r_literal(reported.columns) if reported.columns else "character()"
    return Code("reported(\n  " + ",\n".join([columns, *rows]) + "\n)")


def _chosen(treatments: Mapping[str, str]) -> Code:
    """Return the condition that a run has these treatments."""
    return Code(" & ".join(f"d[[{r_literal(name)}]] == {r_literal(of)}" for name, of in treatments.items()))


def _which_of(effect: TestedEffect, names: Sequence[str]) -> Code:
    return r_literal([name in effect.factors for name in names]) if names else Code("logical()")


def _weights(contrast: Contrasted, it: Compared) -> Code:
    levels = dict(it.factors)[contrast.factor]
    return r_literal([contrast.weights.get(level, 0.0) for level in levels])


_CELL = re.compile(r"^# %%( \[markdown\])?\n", re.MULTILINE)
_BLANK_LINES = re.compile(r"\n{4,}")


def notebook(study: StudyFacts) -> str:
    """Return the notebook, in nbformat 4.5: https://nbformat.readthedocs.io/en/latest/format_description.html."""
    cells = [_cell(place, kind, source) for place, (kind, source) in enumerate(cells_of(study), start=1)]
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    content = {
        "cells": cells,
        "metadata": {"kernelspec": kernel, "language_info": {"name": "python"}},
        "nbformat": 4,
        "nbformat_minor": 5,
    }
    return json.dumps(content, indent=1, ensure_ascii=False) + "\n"


def cells_of(study: StudyFacts) -> list[tuple[str, str]]:
    """Return the kind of each cell, `code` or `markdown`, and its source."""
    text = rendered(
        "notebook.py.j2",
        **_common(study, ", level={}", python_literal, ", tolerance=1e-4", "None", "lambda groups, contrasts: {}"),
        table=_python_table,
        mapping=_mapping,
        levels=_levels,
        terms=lambda it: Code(f"[{', '.join(_names(effect.factors) for effect in it.effects)}]"),
        treatments=lambda of: _mapping(dict(of)),
        conditions=lambda of: _mapping({name: dict(parents) for name, parents in of}, _mapping),
        applied=lambda study, factors: Code(
            f"every[{_applied(factors)}]" if study.is_conditional(factors) else "every"
        ),
        where_applied=lambda factors: Code(f"({_applied(factors)}).to_numpy()"),
    )
    _, *parts = _CELL.split(text)
    found = [("markdown" if mark else "code", source) for mark, source in zip(parts[::2], parts[1::2], strict=True)]
    return [(kind, _BLANK_LINES.sub("\n\n\n", source).strip()) for kind, source in found if source.strip()]


def _applied(factors: Sequence[str]) -> str:
    """Return the condition that a factor applies to a run."""
    return f"every[{python_literal(factors[0])}] != {python_literal(IDLE)}"


def _cell(place: int, kind: str, source: str) -> dict[str, Any]:
    lines = source.splitlines(keepends=True)
    cell: dict[str, Any] = {"cell_type": kind, "id": f"cell-{place}", "metadata": {}, "source": lines}
    return cell | ({"execution_count": None, "outputs": []} if kind == "code" else {})


def _python_table(reported: Reported) -> Code:
    rows = [f"    ({', '.join(map(python_literal, (label, *numbers)))}),\n" for label, numbers in reported.rows]
    return Code(f"reported(\n    {python_literal(reported.columns)},\n{''.join(rows)})")


def _mapping(of: Mapping[str, Any], literal: Callable[[Any], Code] = python_literal) -> Code:
    return Code(f"{{{', '.join(f'{python_literal(key)}: {literal(value)}' for key, value in of.items())}}}")


def _levels(names: Iterable[str], it: Compared) -> Code:
    return _mapping({name: levels for name, levels in it.factors if name in set(names)})


def _names(factors: Sequence[str]) -> str:
    return f"({', '.join(map(python_literal, factors))},)"


_OF_BLOCKS = {"welch": "single"} | {name: name for name in ("greenhouse_geisser", "huynh_feldt", "sign_flips")}
_OWN = {
    "welch": "welch_t({})",
    "welch_james": "welch_anova({})",
    "combined": "combined(groups, contrasts, welch_anova({}))",
}


def _common(
    study: StudyFacts, level: str, literal: Callable[[Any], Code], iterated: str, nothing: str, function: str
) -> dict[str, Any]:
    """Return the context for the templates of both languages; procedures have the same names in both.

    The arguments are those for the level of an interval, if it is not the default, and for the tolerance of iterative
    estimates; the null value of the language, and the pattern of a function of `groups` and `contrasts`.
    """
    of = partial(_called, nothing, function)
    return {
        "study": study,
        "level": lambda measure: Code("" if measure.level == LEVEL else level.format(literal(measure.level))),
        "tolerance": lambda kind: Code(iterated if kind == "mixed" else ""),
        "adjusted_tolerance": Code(iterated if study.has("mixed") else ""),
        "x_of": lambda it: Code("ranks" if it.estimand == "rank" else "x"),
        "beside_of": lambda it: Code("x" if it.estimand == "rank" else "ranks"),
        "procedure": lambda it, effect, values: of(it, effect.test, values, is_drawn=effect.drawn is not None),
        "check_procedure": lambda it, effect, values: of(it, effect.check, values, is_drawn=effect.check_is_drawn),
    }


def _called(nothing: str, function: str, it: Compared, name: str, values: str, *, is_drawn: bool) -> Code:
    if not name:
        return Code(nothing)
    whole = f"bootstrap({name})" if is_drawn else name
    if it.kind == "blocks":
        return Code(_OF_BLOCKS.get(name, f"of_groups({whole})"))
    if it.is_plain and not is_drawn and name in _OWN:  # R and scipy have these functions
        return Code(function.format(_OWN[name].format(values)))
    return Code(whole)


class Recomputation(Enum):
    """A kind of recomputation; the value is the name of its file."""

    NOTEBOOK = "recompute.ipynb"
    R = "recompute.R"


_CODE = {Recomputation.NOTEBOOK: notebook, Recomputation.R: r_script}


def write_recomputations(
    experiment: Results | Path | str,
    kinds: Sequence[Recomputation] = tuple(Recomputation),
    *,
    output: Path | None = None,
    measures: str | Sequence[str] | None = None,
    alpha: float | None = None,
    plan: AnalysisPlan | None = None,
) -> tuple[Path, ...]:
    """Write scripts that recompute the numbers of a report from the run table alone, and return their paths.

    Args:
        experiment: its results or its folder.
        kinds: a notebook, an R script, or both.
        output: the folder of the report; None for `report/` in the experiment's folder.
        measures: the measures of the report; None for all.
        alpha: the level of significance; None for that of the plan, or 0.05.
        plan: replaces the plan that was fixed before the experiment.

    Raises:
        StorageError: there is no experiment, or the folder cannot be written.
        AnalysisError: there is no such measure.
    """
    results = results_of(experiment)
    root, folder = report_folder(results.folder, output)
    make_folder(folder, root)
    made = made_by("Report", datetime.now(UTC))
    study = facts_of_study(results, folder, measures=measures, alpha=alpha, plan=plan, made=made)
    for kind in kinds:
        replace(folder / kind.value, _CODE[kind](study), root)
    return tuple(folder / kind.value for kind in kinds)
