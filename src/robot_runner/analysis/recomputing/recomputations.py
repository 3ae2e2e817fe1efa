"""Writes the notebook and the R script that compute the numbers of a report again, beside the report."""

from __future__ import annotations

from datetime import UTC, datetime
from enum import Enum
from typing import TYPE_CHECKING

from robot_runner.analysis.recomputing.fact_finding import facts_of_study
from robot_runner.analysis.recomputing.notebook import notebook
from robot_runner.analysis.recomputing.r_script import r_script
from robot_runner.analysis.report.writing import made_by, report_folder
from robot_runner.analysis.results import Results, load_results
from robot_runner.core.storage.guarded_files import make_folder, replace

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from robot_runner.core.design.analysis_plan import AnalysisPlan

__all__ = ["Recomputation", "write_recomputations"]


class Recomputation(Enum):
    """What computes the numbers of a report again; the value is the name of its file."""

    NOTEBOOK = "recompute.ipynb"
    R = "recompute.R"


_CODE = {Recomputation.NOTEBOOK: notebook, Recomputation.R: r_script}


def write_recomputations(
    experiment: Results | Path | str,
    kinds: Sequence[Recomputation] = tuple(Recomputation),
    *,
    output: Path | None = None,
    measures: Sequence[str] | None = None,
    alpha: float | None = None,
    plan: AnalysisPlan | None = None,
) -> tuple[Path, ...]:
    """Write what computes the numbers of a report again from the run table alone, and return the files.

    Args:
        experiment: its results or its folder.
        kinds: a notebook, an R script, or both.
        output: the folder to write into, that of the report; None is `report/` in the experiment's folder.
        measures: which measures the report is of; None for all.
        alpha: the level of significance; None for the one that was fixed beforehand, or 0.05.
        plan: what the report follows in the place of what was fixed before the experiment.

    Raises:
        StorageError: there is no experiment, or the folder cannot be written.
        AnalysisError: there is no such measure.
    """
    results = experiment if isinstance(experiment, Results) else load_results(experiment)
    root, folder = report_folder(results.folder, output)
    make_folder(folder, root)
    made = made_by("Report", datetime.now(UTC))
    study = facts_of_study(results, folder, measures=measures, alpha=alpha, plan=plan, made=made)
    written = []
    for kind in kinds:
        written.append(folder / kind.value)
        replace(folder / kind.value, _CODE[kind](study), root)
    return tuple(written)
