"""Published experiments of designs of their own, as results that were read."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd

from robot_runner.analysis.planning.planned_study import PlannedResults
from robot_runner.core.design.columns import RUN_ID, STATUS
from robot_runner.core.storage.table_columns import ColumnDescription, ColumnRole

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from robot_runner.analysis.results import Results
    from robot_runner.core.design.analysis_plan import AnalysisPlan


def designed(
    rows: Sequence[Sequence[Any]],
    names: Sequence[str],
    facts: Mapping[str, Any],
    measures: Sequence[str] = ("y",),
    plan: AnalysisPlan | None = None,
) -> Results:
    """Return results with these rows: treatments in the order of the names, then the values of the measures.

    Args:
        rows: one a run.
        names: of the factors.
        facts: what a design of its own says of its runs; empty for a full factorial.
        measures: their names.
        plan: what was fixed for the analysis.
    """
    columns = list(zip(*rows, strict=True))
    frame: dict[str, Any] = {
        RUN_ID: pd.array([f"r_{place}" for place in range(1, len(rows) + 1)], dtype="str"),
        STATUS: pd.Categorical(["Done"] * len(rows), ["Done"]),
    }
    for name, texts in zip(names, columns, strict=False):
        levels = list(dict.fromkeys(texts))
        numbers = sorted(levels) if all(isinstance(each, int | float) for each in levels) else levels
        frame[name] = pd.Categorical(list(map(str, texts)), list(map(str, numbers)), ordered=True)
    for name, values in zip(measures, columns[len(names) :], strict=True):
        frame[name] = pd.array(values, dtype="float64")
    roles = {RUN_ID: ColumnRole.PROGRESS, STATUS: ColumnRole.PROGRESS} | dict.fromkeys(names, ColumnRole.FACTOR)
    roles |= dict.fromkeys(measures, ColumnRole.MEASURE)
    described = {name: ColumnDescription(name=name, role=role, unit="") for name, role in roles.items()}
    manifest = {
        "experiment_name": "published",
        "design": {"facts": dict(facts)} if facts else {},
        "analysis": None if plan is None else plan.as_mapping(),
    }
    return PlannedResults(Path(), manifest, described, table=pd.DataFrame(frame))


# Montgomery, Design and Analysis of Experiments, 8th ed., 2013.

#: Table 14.14: tensile strength of paper, by replicate, preparation (whole plots) and temperature.
PAPER = [
    (f"rep {rep}", f"m{method}", temperature, strength)
    for rep, methods in enumerate(
        (
            ((30, 35, 37, 36), (34, 41, 38, 42), (29, 26, 33, 36)),
            ((28, 32, 40, 41), (31, 36, 42, 40), (31, 30, 32, 40)),
            ((31, 37, 41, 40), (35, 40, 39, 44), (32, 34, 39, 45)),
        ),
        start=1,
    )
    for method, strengths in enumerate(methods, start=1)
    for temperature, strength in zip((200, 225, 250, 275), strengths, strict=True)
]

#: Tables 4.9 and 4.20: burning rate of propellants, by batch, operator, formulation and test assembly.
PROPELLANTS = [
    (batch, operator, cell[0], cell[1], int(cell[2:]))
    for batch, cells in enumerate(
        (
            ("Aa24", "Bc20", "Ce19", "Db24", "Ed24"),
            ("Bb17", "Cd24", "Da30", "Ec27", "Ae36"),
            ("Cc18", "De38", "Eb26", "Ad27", "Ba21"),
            ("Dd26", "Ea31", "Ac26", "Be23", "Cb22"),
            ("Ee22", "Ab30", "Bd20", "Ca29", "Dc31"),
        ),
        start=1,
    )
    for operator, cell in enumerate(cells, start=1)
]

#: Table 4.22: reaction time by catalyst and batch; each batch has three of four catalysts.
CATALYSTS = [
    (f"b{batch}", f"c{catalyst}", time)
    for catalyst, times in enumerate(
        ({1: 73, 2: 74, 4: 71}, {2: 75, 3: 67, 4: 72}, {1: 73, 2: 75, 3: 68}, {1: 75, 3: 72, 4: 75}), start=1
    )
    for batch, time in times.items()
]

#: Table 8.3: filtration rate, a half of 2^4 with D = ABC.
FILTRATION_HALF = [
    ("-", "-", "-", "-", 45),
    ("+", "-", "-", "+", 100),
    ("-", "+", "-", "+", 45),
    ("+", "+", "-", "-", 65),
    ("-", "-", "+", "+", 75),
    ("+", "-", "+", "-", 60),
    ("-", "+", "+", "-", 80),
    ("+", "+", "+", "+", 96),
]

#: Table 6.10: the same, all 16, in the standard order.
FILTRATION = (45, 71, 48, 65, 68, 60, 80, 65, 43, 100, 45, 104, 75, 86, 70, 96)

#: Table 11.6: yield of a process by time (min) and temperature (F), a central composite design.
PROCESS = [
    (80, 170, 76.5),
    (80, 180, 77.0),
    (90, 170, 78.0),
    (90, 180, 79.5),
    *((85, 175, each) for each in (79.9, 80.3, 80.0, 79.7, 79.8)),
    (92.07, 175, 78.4),
    (77.93, 175, 75.6),
    (85, 182.07, 78.5),
    (85, 167.93, 77.0),
]

#: Cochran and Cox, Experimental Designs, 2nd ed., 1957, p. 133: milk yield by square, cow, period and feeding method.
COWS = [
    (f"square {1 + cow // 3}", f"cow {1 + cow}", 10 * (1 + cow // 3) + period, method, int(milk))
    for cow, told in enumerate(
        ("A38 B25 C15", "B109 C86 A39", "C124 A72 B27", "A86 C76 B46", "B75 A35 C34", "C101 B63 A1")
    )
    for period, (method, *digits) in enumerate(told.split(), start=1)
    for milk in ["".join(digits)]
]
