"""The R script that computes every number of a report again."""

from __future__ import annotations

from typing import TYPE_CHECKING

from robot_runner.analysis.recomputing.literals import Code, r_literal, rendered
from robot_runner.analysis.recomputing.procedures import procedures
from robot_runner.analysis.recomputing.study_facts import LEVEL

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from robot_runner.analysis.recomputing.study_facts import Compared, Contrasted, Reported, StudyFacts, TestedEffect

__all__ = ["r_script"]


def r_script(study: StudyFacts) -> str:
    """Return the script, for R 4.0 and its own packages."""
    return rendered(
        "recompute.R.j2",
        study=study,
        table=_table,
        keys=lambda reported: r_literal([label for label, _ in reported.rows]),
        separator=lambda is_last: Code("" if is_last else ","),
        tolerance=lambda kind: Code(", tolerance = 1e-4" if kind == "mixed" else ""),
        chosen=_chosen,
        level=lambda measure: Code("" if measure.level == LEVEL else f", {r_literal(measure.level)}"),
        **procedures("NULL", "function(groups, contrasts) {}"),
        which_of=_which_of,
        terms=_terms,
        weights=_weights,
    )


def _table(reported: Reported) -> Code:
    rows = [f"  list({', '.join(map(r_literal, (label, *numbers)))})" for label, numbers in reported.rows]
    columns = r_literal(reported.columns) if reported.columns else "character()"
    return Code("reported(\n  " + ",\n".join([columns, *rows]) + "\n)")


def _chosen(treatments: Mapping[str, str]) -> Code:
    """Return which runs have some treatments."""
    return Code(" & ".join(f"d[[{r_literal(name)}]] == {r_literal(of)}" for name, of in treatments.items()))


def _which_of(it: Compared, effect: TestedEffect, names: Sequence[str]) -> Code:
    """Return whether an effect is one of each of some factors."""
    is_in = dict(zip(it.names, effect.which, strict=True))
    return r_literal([is_in[name] for name in names]) if names else Code("logical()")


def _terms(it: Compared) -> Code:
    """Return the effects as terms of a formula, whose factors are F1, F2 and so on."""
    return r_literal([":".join(f"F{at}" for at, is_in in enumerate(each.which, 1) if is_in) for each in it.effects])


def _weights(contrast: Contrasted, it: Compared) -> Code:
    levels = dict(it.factors)[contrast.factor]
    return r_literal([contrast.weights.get(level, 0.0) for level in levels])
