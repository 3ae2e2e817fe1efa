"""Data of interactive charts, in the form that `assets/charts.js` expects."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import pandas as pd

from robot_runner.analysis.figures.courses import bins_between
from robot_runner.analysis.figures.style import Look, looks_by
from robot_runner.analysis.report.blocks import Chart
from robot_runner.analysis.wording import MISSING, with_unit
from robot_runner.core.design.columns import RUN_ID
from robot_runner.core.words import counted

if TYPE_CHECKING:
    from robot_runner.analysis.figures.courses import Course, MissionCourses
    from robot_runner.analysis.report.material import Material

#: Single runs in a chart: each takes about 3 kB of the page.
_MOST_RUNS = 40
#: Runs in a chart of all: more would be as many megabytes, and points on a screen hide each other long before.
_MOST_POINTS = 10_000
_DIGITS = 4


def course_chart(name: str, mission: MissionCourses) -> Chart:
    """Return a chart of a sampled measure over the time of the mission; its name is unique in the document."""
    share = max(1, -(-sum(map(len, mission.runs.values())) // _MOST_RUNS))
    by_name = looks_by(mission.order)
    edges = [edge for mean in mission.means for edge in (mean.middle, mean.low, mean.high)]
    shown = [float(value) for edge in edges for value in edge if math.isfinite(value)]
    spread = max(shown, default=0.0) - min(shown, default=0.0)
    # Significant digits of the differences, not of the values: 1,013.25 and 1,013.31 hPa share four digits.
    digits = _DIGITS - 1 - math.floor(math.log10(spread)) if spread else None

    bins = bins_between(number for mean in mission.means for number in mean.bins)

    def values(course: Course, edge: str) -> list[float | None]:
        """Return a course's `middle`, `low` or `high` in each bin of the chart; None where it has none."""
        return _plain(pd.Series(getattr(course, edge), course.bins).reindex(bins), digits)

    data = {
        "label": mission.label,
        "unit": mission.unit,
        "time": [round((float(number) + 0.5) * mission.width, 9) for number in bins],
        "groups": [
            {
                "name": mean.label,
                "colour": by_name[mean.label].colour,
                "dash": _dash(by_name[mean.label]),
                "runs": mean.runs,
                **{edge: values(mean, edge) for edge in ("middle", "low", "high")},
                "each": [
                    {"name": run.label, "values": values(run, "middle")} for run in mission.runs[mean.label][::share]
                ],
            }
            for mean in mission.means
        ],
        "phases": [{"name": each.name, "start": each.start, "end": each.end} for each in mission.phases],
        "events": [{"name": each.replace("_", " "), "at": at} for each, at in mission.events.items()],
    }
    some = f" Of single runs, one in {share} is shown." if share > 1 else ""
    caption = (
        f"{mission.label}: mean of each treatment's runs that last so long, with a band of one standard deviation "
        f"between runs, or each run. Drag to look closer; press twice for the whole.{some}"
    )
    return Chart(name, "course", caption, data)


def points_chart(material: Material) -> Chart | None:
    """Return a chart of all measures of the runs that are done, in the order of execution; None without any."""
    numeric = [each.name for each in material.statistics.measures if each.overall is not None and each.overall.n]
    done = material.done
    if not numeric or done.empty:
        return None
    begun = list(in_order_of_execution(material, material.last_attempts)["run_id"])
    is_known = set(done[RUN_ID]) <= set(begun)
    places = {run_id: place for place, run_id in enumerate(begun if is_known else material.runs[RUN_ID], start=1)}
    order = "order of execution" if is_known else "order of the table"
    in_order = done.assign(place=done[RUN_ID].map(places)).sort_values("place", kind="stable")
    is_shown, share = even_share(map(material.labels.__getitem__, in_order[RUN_ID]), _MOST_POINTS)
    ordered = in_order[is_shown]
    data = {
        "place": f"Place in the {order}",
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
                "texts": [_in_words(value, material.results.unit(name)) for value in ordered[name].tolist()],
                "values": _plain(pd.to_numeric(ordered[name], errors="coerce").to_numpy(dtype="float64")),
            }
            for name in numeric
        ],
    }
    some = f" One in {share} of each treatment is shown." if share > 1 else ""
    caption = f"{counted(len(in_order), 'run')} in the {order}.{some} Point at one for its id and its value."
    return Chart("chart-runs", "points", caption, data)


def even_share(treatments: Iterable[str], most: int) -> tuple[list[bool], int]:
    """Return which of many runs to show, about `most`, and that it is one in so many.

    The share is that of each treatment: of runs that take turns, every sixth may always have the same.
    """
    texts = list(treatments)
    share = max(1, -(-len(texts) // most))
    seen: Counter[str] = Counter()
    is_shown = []
    for text in texts:
        is_shown.append(seen[text] % share == 0)
        seen[text] += 1
    return is_shown, share


def in_order_of_execution(material: Material, attempts: pd.DataFrame) -> pd.DataFrame:
    """Return the attempts with a known beginning, in order of execution.

    This is the order of the journal, even if this machine's clock was set back in between. The journal of an imported
    experiment has the order of the table, so that its attempts are sorted by their times.
    """
    told = attempts.dropna(subset=["started_at"])
    return told.sort_values("started_at", kind="stable") if material.is_imported else told


def _dash(look: Look) -> list[float]:
    return [] if isinstance(look.line, str) else [round(each * 1.6, 1) for each in look.line[1]]


def _in_words(value: Any, unit: str) -> str:
    """Return a value with its unit, as in the table of runs, which distinguishes whole numbers from others."""
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return MISSING if pd.isna(value) else with_unit(value, unit) if is_number else str(value)


def _plain(values: Iterable[float], digits: int | None = None) -> list[float | None]:
    """Return numbers for JSON, rounded to so many decimals (None: not rounded)."""
    finite = (value if math.isfinite(value) else None for value in map(float, values))
    return [value if value is None or digits is None else round(value, digits) for value in finite]
