"""Sampled measures over the time of the mission: a chart for the page, and the paper's Fig. 4 for paper."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import pandas as pd

from robot_runner.analysis.figures.courses import Course, bin_width, course_of_run, mean_course
from robot_runner.analysis.figures.mission import draw_mean_courses, draw_single_courses
from robot_runner.analysis.figures.phases import PhaseSpan
from robot_runner.analysis.report.blocks import Block, FigureBlock, Gallery, Paragraph, Part, Tone
from robot_runner.analysis.report.charts import course_chart
from robot_runner.analysis.report.material import origin_badges, origin_in_words
from robot_runner.analysis.report.numbers import listed
from robot_runner.analysis.report.sample_columns import SampledMeasure, sampled_measures
from robot_runner.analysis.wording import counted
from robot_runner.design.columns import RUN_ID

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from robot_runner.analysis.report.material import Material

__all__ = ["Mission", "mission_parts"]

#: More lines than that cannot be told apart in a column.
_MOST_GROUPS = 6
_MARKED = ("launch_mission", "stop_measurement")


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
        return self._prepared[0]

    @property
    def courses(self) -> Mapping[str, Course]:
        """The course of each run, by its id."""
        return self._prepared[1]

    @cached_property
    def _prepared(self) -> tuple[float, dict[str, Course]]:
        done = [run_id for run_id in self.material.done[RUN_ID] if run_id in self.measure.file.paths]
        shown = [run_id for run_id in done if self.material.labels[run_id] in self.groups]
        samples = self.material.results.samples(
            self.measure.file.plugin,
            file=self.measure.file.name,
            runs=shown,
            columns=[self.measure.column],
            with_factors=False,
            with_phases=False,
        )
        times = samples["time_s"].to_numpy(dtype="float64")
        values = pd.to_numeric(samples[self.measure.column], errors="coerce").to_numpy(dtype="float64")
        by_run = {
            str(run_id): (times[places], values[places])
            for run_id, places in samples.groupby("run_id", observed=True, sort=False).indices.items()
        }
        by_run = {run_id: pair for run_id, pair in by_run.items() if len(pair[0]) > 1}
        longest = max((float(time[-1] - time[0]) for time, _ in by_run.values()), default=1.0)
        period = max((float(time[-1] - time[0]) / (len(time) - 1) for time, _ in by_run.values()), default=1.0)
        width = bin_width(longest, period)
        return width, {run_id: course_of_run(run_id, *pair, width) for run_id, pair in by_run.items()}

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
        runs={group: mission.members[group] for group in mission.members},
        phases=mission.phases,
        events=mission.events,
    )
    name = f"paper-{measure.file.plugin}-{measure.column}"
    yield Part(name, "Figures for a paper", (Gallery((_single(mission), _means(mission))),), is_folded=True)


def _single(mission: Mission) -> FigureBlock:
    measure = mission.measure
    one = {group: courses[0] for group, courses in mission.members.items()}
    runs = listed(course.label for course in one.values())
    return FigureBlock(
        f"course {measure.file.plugin} {measure.column} runs",
        f"{measure.label} over the time of the mission, the first run that is done of each treatment ({runs}). "
        f"Line: mean of {mission.width:g} s; band: least and greatest sample.{_marks(mission)}",
        f"{measure.title} of {counted(len(one), 'run')} over time.",
        lambda: draw_single_courses(
            one,
            order=mission.groups,
            value_label=measure.label,
            phases=mission.phases,
            events=mission.events,
        ),
    )


def _means(mission: Mission) -> FigureBlock:
    measure = mission.measure
    runs = ", ".join(f"{course.label}: {course.runs}" for course in mission.means)
    return FigureBlock(
        f"course {measure.file.plugin} {measure.column} means",
        f"{measure.label} over the time of the mission, mean of all runs of each treatment (runs: {runs}). Line: mean "
        f"of {mission.width:g} s; band: one standard deviation between runs.{_marks(mission)}",
        f"Mean {measure.title} of each treatment over time.",
        lambda: draw_mean_courses(
            mission.means, order=mission.groups, value_label=measure.label, phases=mission.phases, events=mission.events
        ),
    )


def _marks(mission: Mission) -> str:
    return f"{' Dashed: events.' if mission.events else ''}{origin_in_words(mission.measure.origin)}"
