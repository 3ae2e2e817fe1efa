"""Figures of missions: sampled measures over time (the paper's Fig. 4), and the ways that robots took."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, partial
from typing import TYPE_CHECKING

import pandas as pd

from robot_runner.analysis.figures.courses import Course, PhaseSpan, bin_width, course_of_run, mean_course
from robot_runner.analysis.figures.missions import Way, draw_mean_courses, draw_single_courses, draw_trajectories
from robot_runner.analysis.report.blocks import Block, FigureBlock, Gallery, Paragraph, Part, Tone
from robot_runner.analysis.report.charts import course_chart
from robot_runner.analysis.report.material import origin_badges, origin_in_words
from robot_runner.analysis.wording import counted, listed
from robot_runner.core.design.columns import RUN_ID

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    import numpy as np
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from robot_runner.analysis.report.material import Material
    from robot_runner.analysis.results import Results
    from robot_runner.analysis.sample_files import SampleFile

__all__ = ["Mission", "SampledMeasure", "is_way", "mission_parts", "sampled_measures", "trajectory_part"]

_MOST_MEASURES = 4
#: More lines than that cannot be told apart in a column.
_MOST_GROUPS = 6
#: More ways than that hide each other.
_MOST_WAYS = 60
_MARKED = ("launch_mission", "stop_measurement")
_UNITS = {
    "W": "W", "mW": "mW", "kW": "kW", "A": "A", "mA": "mA", "V": "V", "mV": "mV", "J": "J", "s": "s", "ms": "ms",
    "m": "m", "mm": "mm", "Hz": "Hz", "kHz": "kHz", "MHz": "MHz", "percent": "%", "pct": "%", "C": "°C", "degC": "°C",
    "K": "K", "rad": "rad", "deg": "°", "mps": "m/s", "radps": "rad/s", "B": "B", "MB": "MB", "MiB": "MiB",
}  # fmt: skip
_ACRONYMS = frozenset({"cpu", "gpu", "ram", "rss"})
#: What columns are left out because others of the same file say the same in units that people read.
_RAW = ("_raw", "_counts", "_ticks")


@dataclass(frozen=True, slots=True)
class SampledMeasure:
    """One column of raw samples.

    Attributes:
        file: where it is.
        column: its heading there, such as `power_W`.
        title: what it is, as in `Power`.
        unit: its unit; empty where the heading does not tell.
        origin: `measured`, `simulated`, `estimated`, or None.
    """

    file: SampleFile
    column: str
    title: str
    unit: str
    origin: str | None

    @property
    def label(self) -> str:
        """A heading for an axis, as in `Power (W)`."""
        return f"{self.title} ({self.unit})" if self.unit else self.title


def sampled_measures(results: Results) -> tuple[SampledMeasure, ...]:
    """Return the columns of samples that are shown: of each file power if it has any, else its first columns."""
    found: list[SampledMeasure] = []
    for file in results.sample_files:
        if not is_way(file.columns):
            found += [_measure(results, file, column) for column in _leading(file.columns)]
    return tuple(sorted(found, key=lambda each: each.unit != "W")[:_MOST_MEASURES])


def is_way(columns: Sequence[str]) -> bool:
    """Whether samples are places on a floor."""
    return {"x_m", "y_m"} <= set(columns)


def _leading(columns: Sequence[str]) -> list[str]:
    readable = [column for column in columns if not column.endswith(_RAW)]
    power = [column for column in readable if column.casefold().startswith("power")]
    return power[:1] or readable[:2]


def _measure(results: Results, file: SampleFile, column: str) -> SampledMeasure:
    name, _, suffix = column.rpartition("_")
    unit = _UNITS.get(suffix, "") if name else ""
    words = (name if unit else column).replace("_", " ").split()
    title = " ".join(word.upper() if word.casefold() in _ACRONYMS else word for word in words)
    return SampledMeasure(file, column, title[:1].upper() + title[1:], unit, _origin(results, file.plugin))


def _origin(results: Results, plugin: str) -> str | None:
    published = results.published
    origins = published.loc[(published["owner"] == plugin), "origin"].dropna().unique()
    return ", ".join(sorted(map(str, origins))) or None


@dataclass(frozen=True)
class Mission:
    """One sampled measure over the time of the mission, of all runs that are done.

    Attributes:
        material: what the report is about.
        measure: what was sampled.
        groups: the combinations that are shown.
    """

    material: Material
    measure: SampledMeasure
    groups: tuple[str, ...]

    @cached_property
    def width(self) -> float:
        """The width of a bin, s."""
        spans = [(float(time[-1] - time[0]), len(time)) for time, _ in self._samples.values()]
        longest = max((span for span, _ in spans), default=1.0)
        period = max((span / (count - 1) for span, count in spans), default=1.0)
        return bin_width(longest, period)

    @cached_property
    def courses(self) -> Mapping[str, Course]:
        """The course of each run, by its id."""
        return {run_id: course_of_run(run_id, *pair, self.width) for run_id, pair in self._samples.items()}

    @cached_property
    def _samples(self) -> dict[str, tuple[NDArray[np.float64], NDArray[np.float64]]]:
        """Times and values of each run that has two samples at least."""
        file, labels = self.measure.file, self.material.labels
        samples = self.material.results.samples(
            file.plugin,
            file=file.name,
            runs=[run for run in self.material.done[RUN_ID] if run in file.paths and labels[run] in self.groups],
            columns=[self.measure.column],
            with_factors=False,
            with_phases=False,
        )
        times = samples["time_s"].to_numpy(dtype="float64")
        values = pd.to_numeric(samples[self.measure.column], errors="coerce").to_numpy(dtype="float64")
        by_run = samples.groupby("run_id", observed=True, sort=False).indices
        return {str(run): (times[places], values[places]) for run, places in by_run.items() if len(places) > 1}

    @cached_property
    def members(self) -> Mapping[str, list[Course]]:
        """The courses of each combination's runs; those without any are left out."""
        members: dict[str, list[Course]] = {group: [] for group in self.groups}
        for run_id, course in self.courses.items():
            members[self.material.labels[run_id]].append(course)
        return {group: courses for group, courses in members.items() if courses}

    @cached_property
    def means(self) -> tuple[Course, ...]:
        """The mean course of each combination."""
        return tuple(mean_course(group, courses, self.width) for group, courses in self.members.items())

    @cached_property
    def phases(self) -> tuple[PhaseSpan, ...]:
        """The phases of the mission, where all runs went through the same ones; their median times."""
        phases = self.material.results.phases(list(self.courses)) if self.courses else pd.DataFrame()
        if phases.empty or len(phases["plugin"].unique()) != 1:
            return ()
        sequences = phases.sort_values(["run_id", "number"]).groupby("run_id")["phase"].agg(tuple)
        if len(sequences.unique()) != 1:
            return ()
        spans = phases.groupby("number").agg(
            phase=("phase", "first"), start=("start_s", "median"), end=("end_s", "median")
        )
        return tuple(PhaseSpan(str(row.phase), float(row.start), float(row.end)) for row in spans.itertuples())

    @cached_property
    def events(self) -> Mapping[str, float]:
        """When events were, s since the start of measurement; the median of all runs."""
        events = self.material.results.events(list(self.courses)) if self.courses else pd.DataFrame()
        if events.empty:
            return {}
        times = events.groupby("event", observed=True)["since_start_s"].median().dropna()
        return {name: float(times[name]) for name in _MARKED if name in times.index}


def mission_parts(material: Material) -> Iterator[Part]:
    """Yield a part for each sampled measure that runs which are done have samples of."""
    if not len(material.done):
        return
    groups = _shown_groups(material)
    for measure in sampled_measures(material.results):
        mission = Mission(material, measure, groups)
        if mission.means:
            blocks = tuple(_blocks(mission))
            name = f"mission-{measure.file.plugin}-{measure.column}"
            yield Part(name, f"{measure.title} over the mission", blocks, origin_badges(measure.origin))


def _shown_groups(material: Material) -> tuple[str, ...]:
    order = material.order
    if len(order) <= _MOST_GROUPS:
        return order
    places = [round(place * (len(order) - 1) / (_MOST_GROUPS - 1)) for place in range(_MOST_GROUPS)]
    return tuple(order[place] for place in places)


def _blocks(mission: Mission) -> Iterator[Block]:
    material, measure = mission.material, mission.measure
    left_out = len(material.order) - len(mission.groups)
    if left_out:
        shown = f"Shown are {listed(mission.groups)}; {counted(left_out, 'combination')} between them left out."
        yield Paragraph(shown, Tone.NOTE)
    yield course_chart(
        f"chart-{measure.file.plugin}-{measure.column}",
        label=measure.label,
        unit=measure.unit,
        order=mission.groups,
        means=mission.means,
        runs=mission.members,
        phases=mission.phases,
        events=mission.events,
    )
    name = f"paper-{measure.file.plugin}-{measure.column}"
    yield Part(name, "Figures for a paper", (Gallery((_single(mission), _means(mission))),), is_folded=True)


def _single(mission: Mission) -> FigureBlock:
    one = {group: courses[0] for group, courses in mission.members.items()}
    runs = listed(course.label for course in one.values())
    return _figure_over_time(
        mission,
        "runs",
        f"the first run that is done of each treatment ({runs}). Line: mean of {mission.width:g} s; band: least and "
        "greatest sample",
        f"{mission.measure.title} of {counted(len(one), 'run')} over time.",
        partial(draw_single_courses, one),
    )


def _means(mission: Mission) -> FigureBlock:
    runs = ", ".join(f"{course.label}: {course.runs}" for course in mission.means)
    return _figure_over_time(
        mission,
        "means",
        f"mean of all runs of each treatment (runs: {runs}). Line: mean of {mission.width:g} s; band: one standard "
        "deviation between runs",
        f"Mean {mission.measure.title} of each treatment over time.",
        partial(draw_mean_courses, mission.means),
    )


def _figure_over_time(
    mission: Mission, name: str, shown: str, alternative: str, draw: Callable[..., Figure]
) -> FigureBlock:
    measure = mission.measure
    marks = f"{' Dashed: events.' if mission.events else ''}{origin_in_words(measure.origin)}"
    return FigureBlock(
        f"course {measure.file.plugin} {measure.column} {name}",
        f"{measure.label} over the time of the mission, {shown}.{marks}",
        alternative,
        lambda: draw(order=mission.groups, value_label=measure.label, phases=mission.phases, events=mission.events),
    )


def trajectory_part(material: Material) -> Iterator[Part]:
    """Yield a part with a figure for each robot whose way was kept."""
    figures = []
    for file in material.results.sample_files:
        runs = [run_id for run_id in material.done[RUN_ID] if run_id in file.paths]
        if is_way(file.columns) and runs:
            figures.append(_figure(material, file, runs))
    if figures:
        yield Part("trajectory", "The way of the robot", (Gallery(tuple(figures)),))


def _figure(material: Material, file: SampleFile, runs: list[str]) -> FigureBlock:
    shown = runs[:: -(-len(runs) // _MOST_WAYS)]
    samples = material.results.samples(
        file.plugin, file=file.name, runs=shown, columns=["x_m", "y_m"], with_factors=False, with_phases=False
    )
    ways = [
        Way(material.labels[str(run_id)], way["x_m"].to_numpy(dtype="float64"), way["y_m"].to_numpy(dtype="float64"))
        for run_id, way in samples.groupby("run_id", observed=True)
    ]
    whose = "all runs that are done" if len(shown) == len(runs) else f"{len(shown)} of {counted(len(runs), 'run')}"
    return FigureBlock(
        f"trajectory {file.plugin}",
        f"The way of the robot ({file.plugin}) by its odometry, {whose}. Circle: beginning; cross: end.",
        f"{counted(len(ways), 'way')} seen from above.",
        lambda: draw_trajectories(ways, order=material.order),
    )
