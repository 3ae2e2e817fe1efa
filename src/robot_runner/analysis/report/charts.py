"""Data of the charts that answer to a reader's pointer, as `assets/charts.js` expects them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import pandas as pd

from robot_runner.analysis.figures.style import looks_by
from robot_runner.analysis.report.blocks import Chart
from robot_runner.core.design.columns import RUN_ID
from robot_runner.core.words import counted

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from robot_runner.analysis.figures.courses import Course, MissionCourses
    from robot_runner.analysis.figures.style import Look
    from robot_runner.analysis.report.material import Material

#: Single runs in a chart: each is some 3 kB of the page.
_MOST_RUNS = 40
_DIGITS = 4


def course_chart(name: str, mission: MissionCourses) -> Chart:
    """Return a chart of a sampled measure over the time of the mission; its name is unique in the document."""
    grid = _Grid.of(mission.means)
    share = max(1, -(-sum(map(len, mission.runs.values())) // _MOST_RUNS))
    by_name = looks_by(mission.order)
    data = {
        "label": mission.label,
        "unit": mission.unit,
        "time": [round(grid.first + place * grid.width, 4) for place in range(grid.count)],
        "groups": [
            {
                "name": mean.label,
                "colour": by_name[mean.label].colour,
                "dash": _dash(by_name[mean.label]),
                "runs": mean.runs,
                **{edge: grid.values(mean, edge) for edge in ("middle", "low", "high")},
                "each": [
                    {"name": run.label, "values": grid.values(run, "middle")}
                    for run in mission.runs[mean.label][::share]
                ],
            }
            for mean in mission.means
        ],
        "phases": [{"name": each.name, "start": each.start, "end": each.end} for each in mission.phases],
        "events": [{"name": each.replace("_", " "), "at": at} for each, at in mission.events.items()],
    }
    some = f" Of single runs, one in {share} is shown." if share > 1 else ""
    caption = (
        f"{mission.label}: mean of each treatment with a band of one standard deviation between runs, or each run. "
        f"Drag to look closer; press twice for the whole.{some}"
    )
    return Chart(name, "course", caption, data)


def points_chart(material: Material) -> Chart | None:
    """Return a chart of all measures of all runs that are done, in the order of execution; None if there are none."""
    numeric = [each.name for each in material.statistics.measures if each.overall is not None and each.overall.n]
    done = material.done
    if not numeric or done.empty:
        return None
    places = _places(material)
    ordered = done.assign(place=done[RUN_ID].map(places)).sort_values("place", kind="stable")
    data = {
        "order": [int(place) for place in ordered["place"]],
        "runs": list(map(str, ordered[RUN_ID])),
        "groups": [
            {"name": name, "colour": look.colour, "marker": look.marker}
            for name, look in looks_by(material.order).items()
        ],
        "group": [material.order.index(material.labels[run_id]) for run_id in ordered[RUN_ID]],
        "measures": [
            {
                "name": name,
                "label": material.results.label(name),
                "unit": material.results.unit(name),
                "values": _plain(pd.to_numeric(ordered[name], errors="coerce").to_numpy(dtype="float64"), digits=6),
            }
            for name in numeric
        ],
    }
    caption = f"{counted(len(ordered), 'run')} in the order of execution. Point at one for its id and its value."
    return Chart("chart-runs", "points", caption, data)


def _places(material: Material) -> dict[str, int]:
    """Return the place of each run in the order of execution, from 1: by its last attempt, else as in the table."""
    order = list(material.last_attempts.sort_values("started_at")["run_id"])
    return {run_id: place for place, run_id in enumerate(dict.fromkeys((*order, *material.runs[RUN_ID])), start=1)}


def _dash(look: Look) -> list[float]:
    return [] if isinstance(look.line, str) else [round(each * 1.6, 1) for each in look.line[1]]


@dataclass(frozen=True, slots=True)
class _Grid:
    """The times that all courses of a chart share: so many, from the first, a width apart."""

    first: float
    width: float
    count: int

    @classmethod
    def of(cls, courses: Sequence[Course]) -> _Grid:
        """Return the grid that holds all courses."""
        width = next((float(course.time[1] - course.time[0]) for course in courses if len(course.time) > 1), 0.0)
        first = min((float(course.time[0]) for course in courses if len(course.time)), default=0.0)
        last = max((float(course.time[-1]) for course in courses if len(course.time)), default=0.0)
        return cls(first, width, round((last - first) / width) + 1 if width else 0)

    def values(self, course: Course, edge: str) -> list[float | None]:
        """Return a course's `middle`, `low` or `high` at each time; None where it has none."""
        cells: list[float | None] = [None] * self.count
        if len(course.time) and self.width:
            offset = round((float(course.time[0]) - self.first) / self.width)
            for place, value in enumerate(_plain(getattr(course, edge)), start=offset):
                if 0 <= place < self.count:
                    cells[place] = value
        return cells


def _plain(values: Iterable[float], digits: int = _DIGITS) -> list[float | None]:
    """Return numbers as JSON has them, in as many digits as a screen shows."""
    return [float(f"{value:.{digits}g}") if math.isfinite(value) else None for value in map(float, values)]
