"""Figures of missions: sampled measures over time (the paper's Fig. 4), trajectories of robots, stills of cameras."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from matplotlib.image import imread

from robot_runner.analysis.arrays import Floats
from robot_runner.analysis.figures.courses import Course, MissionCourses, PhaseSpan, bin_width, course_of_run
from robot_runner.analysis.figures.missions import Trajectory, draw_mean_courses, draw_single_courses, draw_trajectories
from robot_runner.analysis.figures.style import GREY, HIGHEST, PAGE, new_figure, shortened
from robot_runner.analysis.report.blocks import Beside, Block, FigureBlock, Gallery, Paragraph, Part, Tone, one_word
from robot_runner.analysis.report.charts import course_chart
from robot_runner.analysis.report.material import Material, origin_badges, origin_in_words
from robot_runner.analysis.report.summary_section import means_table
from robot_runner.analysis.sample_files import SampleFile, notes_of, split_unit
from robot_runner.analysis.wording import listed
from robot_runner.core.design.columns import RUN_ID
from robot_runner.core.errors import StorageError
from robot_runner.core.storage.guarded_files import require_file
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.words import counted

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from robot_runner.analysis.results import Results

    #: The caption and the file of each still, by run and its treatments.
    Stills = dict[str, tuple[tuple[str, Path], ...]]

_MOST_MEASURES = 4
#: More lines cannot be distinguished in a column.
_MOST_GROUPS = 6
#: More trajectories would hide each other.
_MOST_WAYS = 60
_MARKED = ("launch_mission", "stop_measurement")
_ACRONYMS = frozenset({"cpu", "gpu", "ram", "rss"})
#: Columns of raw counts, which are left out if the same file has others, in readable units.
_RAW = ("_raw", "_counts", "_ticks")


@dataclass(frozen=True, slots=True)
class SampledMeasure:
    """One column of raw samples.

    Attributes:
        file: its kind of file.
        column: its heading, such as `power_W`.
        source: the plugin that wrote the file, with the file's name where several of its files are shown.
        title: the name of the quantity, such as `Power`, with the source where several sources have it.
        unit: its unit; empty where the heading has none.
        origin: `measured`, `simulated`, `estimated`, or None.
    """

    file: SampleFile
    column: str
    source: str
    title: str
    unit: str
    origin: str | None

    @property
    def label(self) -> str:
        """The label of its axis, as in `Power (W)`."""
        return f"{self.title} ({self.unit})" if self.unit else self.title


def sampled_measures(results: Results) -> tuple[SampledMeasure, ...]:
    """Return the columns of samples to show: of each file power if it has any, otherwise its first columns."""
    files = [file for file in results.sample_files if not are_positions(file.columns)]
    found = [
        _measure(results, file, column, source_of(file, files)) for file in files for column in _leading(file.columns)
    ]
    shown = sorted(found, key=lambda each: each.unit != "W")[:_MOST_MEASURES]
    titles = Counter(each.title for each in shown)
    return tuple(
        replace(each, title=f"{each.title} of {each.source}") if titles[each.title] > 1 else each for each in shown
    )


def source_of(file: SampleFile, among: Iterable[SampleFile]) -> str:
    """Return the plugin that wrote a file, with the file's name if it wrote several of these."""
    return file.plugin if sum(each.plugin == file.plugin for each in among) == 1 else file.label


def are_positions(columns: Sequence[str]) -> bool:
    """Return whether samples are positions in a plane."""
    return {"x_m", "y_m"} <= set(columns)


def _leading(columns: Sequence[str]) -> list[str]:
    readable = [column for column in columns if not column.endswith(_RAW)]
    power = [column for column in readable if column.casefold().startswith("power")]
    return power[:1] or readable[:2]


def _measure(results: Results, file: SampleFile, column: str, source: str) -> SampledMeasure:
    name, unit = split_unit(column)
    words = name.replace("_", " ").split()
    title = " ".join(word.upper() if word.casefold() in _ACRONYMS else word for word in words)
    return SampledMeasure(file, column, source, title[:1].upper() + title[1:], unit, _origin(results, file.plugin))


def _origin(results: Results, plugin: str) -> str | None:
    published = results.published
    origins = published.loc[(published["owner"] == plugin), "origin"].dropna().unique()
    return ", ".join(sorted(map(str, origins))) or None


def mission_parts(material: Material) -> Iterator[Part]:
    """Yield a part for each measure of which runs that are done have samples."""
    if not len(material.done):
        return
    groups = _shown_groups(material)
    for measure in sampled_measures(material.results):
        mission = mission_courses(material, measure, groups)
        if mission.runs:
            blocks = tuple(_blocks(material, measure, mission))
            name = f"mission-{measure.source}-{measure.column}"
            yield Part(name, f"{measure.title} over the mission", blocks, origin_badges(measure.origin))


def mission_courses(material: Material, measure: SampledMeasure, groups: Sequence[str]) -> MissionCourses:
    """Return a measure over the mission, of all runs of these combinations that are done and have samples."""
    samples = _samples(material, measure, groups)
    spans = [(float(time[-1] - time[0]), len(time)) for time, _ in samples.values()]
    longest = max((span for span, _ in spans), default=1.0)
    width = bin_width(longest, max((span / (count - 1) for span, count in spans), default=1.0))
    runs: dict[str, list[Course]] = {group: [] for group in groups}
    for run_id, pair in samples.items():
        runs[material.labels[run_id]].append(course_of_run(run_id, *pair, width))
    there = {group: courses for group, courses in runs.items() if courses}
    phases, events = _phases(material, list(samples)), _events(material, list(samples))
    return MissionCourses(measure.label, measure.unit, material.order, there, width, phases, events)


def _samples(material: Material, measure: SampledMeasure, groups: Sequence[str]) -> dict[str, tuple[Floats, Floats]]:
    """Return ascending times and values of each run with at least two samples of its mission."""
    file, labels = measure.file, material.labels
    samples = material.results.samples(
        file.plugin,
        file=file.name,
        runs=[run_id for run_id in material.done[RUN_ID] if run_id in file.paths and labels[run_id] in groups],
        columns=[measure.column],
        with_factors=False,
        with_phases=False,
    )
    # Samples are out of order if a clock was set back, or if a plugin has several threads.
    samples = samples[samples["in_window"] & np.isfinite(samples["time_s"])]
    samples = samples.sort_values(["run_id", "time_s"], kind="stable")
    times = samples["time_s"].to_numpy(dtype="float64")
    values = pd.to_numeric(samples[measure.column], errors="coerce").to_numpy(dtype="float64")
    by_run = samples.groupby("run_id", observed=True, sort=False).indices
    return {str(run_id): (times[places], values[places]) for run_id, places in by_run.items() if len(places) > 1}


def _phases(material: Material, run_ids: list[str]) -> tuple[PhaseSpan, ...]:
    """Return the phases of the mission at their median times, if all runs have the same phases in the same order."""
    phases = material.results.phases(run_ids) if run_ids else pd.DataFrame()
    if phases.empty:
        return ()
    phases = phases.sort_values(["run_id", "start_s", "end_s"])
    by_run = phases.groupby("run_id", sort=False)
    if len(by_run["phase"].agg(tuple).unique()) != 1 or (by_run["end_s"].shift() > phases["start_s"]).any():
        return ()
    places = by_run.cumcount()
    spans = phases.groupby(places).agg(phase=("phase", "first"), start=("start_s", "median"), end=("end_s", "median"))
    return tuple(PhaseSpan(str(row.phase), float(row.start), float(row.end)) for row in spans.itertuples())


def _events(material: Material, run_ids: list[str]) -> dict[str, float]:
    """Return the times of events, s since the start of the mission: the median of all runs."""
    events = material.results.events(run_ids) if run_ids else pd.DataFrame()
    if events.empty:
        return {}
    times = events.groupby("event", observed=True)["since_start_s"].median().dropna()
    return {name: float(times[name]) for name in _MARKED if name in times.index}


def _shown_groups(material: Material) -> tuple[str, ...]:
    order = material.order
    if len(order) <= _MOST_GROUPS:
        return order
    places = [round(place * (len(order) - 1) / (_MOST_GROUPS - 1)) for place in range(_MOST_GROUPS)]
    return tuple(order[place] for place in places)


def _blocks(material: Material, measure: SampledMeasure, mission: MissionCourses) -> Iterator[Block]:
    groups = _shown_groups(material)
    left_out = len(material.order) - len(groups)
    if left_out:
        shown = f"Shown are {listed(groups)}; {counted(left_out, 'combination')} between them left out."
        yield Paragraph(shown, Tone.NOTE)
    yield course_chart(f"chart-{measure.source}-{measure.column}", mission)
    figures = Gallery(tuple(_figures(measure, mission)))
    yield Part(f"paper-{measure.source}-{measure.column}", "Figures for a paper", (figures,), is_folded=True)


def _figures(measure: SampledMeasure, mission: MissionCourses) -> Iterator[FigureBlock]:
    name = f"course {one_word(measure.source)} {measure.column}"
    over = f"{measure.label} over the time of the mission"
    line = f"Line: mean of {mission.width:g} s"
    marks = f"{' Dashed: events.' if mission.events else ''}{origin_in_words(measure.origin)}"
    runs = listed(course.label for course in mission.firsts.values())
    yield FigureBlock(
        f"{name} runs",
        f"{over}, the first run that is done of each treatment ({runs}). {line}; band: least and greatest "
        f"sample.{marks}",
        f"{measure.title} of {counted(len(mission.firsts), 'run')} over time.",
        lambda: draw_single_courses(mission),
    )
    sizes = ", ".join(f"{course.label}: {course.runs}" for course in mission.means)
    yield FigureBlock(
        f"{name} means",
        f"{over}, mean of each treatment's runs that last so long (runs: {sizes}). {line}; band: one standard "
        f"deviation between runs.{marks}",
        f"Mean {measure.title} of each treatment over time.",
        lambda: draw_mean_courses(mission),
    )


def trajectory_part(material: Material) -> Iterator[Part]:
    """Yield a part with a figure for each robot whose trajectory was recorded."""
    figures = []
    files = [file for file in material.results.sample_files if are_positions(file.columns)]
    for file in files:
        runs = [run_id for run_id in material.done[RUN_ID] if run_id in file.paths]
        if runs:
            figures.append(_figure(material, file, source_of(file, files), runs))
    if figures:
        beside = Beside((Gallery(tuple(figures)), *means_table(material, "means beside ways")))
        yield Part("trajectory", "The way of the robot", (beside,))


def _figure(material: Material, file: SampleFile, source: str, runs: list[str]) -> FigureBlock:
    shown = runs[:: -(-len(runs) // _MOST_WAYS)]
    samples = material.results.samples(
        file.plugin, file=file.name, runs=shown, columns=["x_m", "y_m"], with_factors=False, with_phases=False
    )
    ways = [
        Trajectory(material.labels[str(run_id)], *way[["x_m", "y_m"]].to_numpy(dtype="float64").T)
        for run_id, way in samples.groupby("run_id", observed=True)
    ]
    whose = "all runs that are done" if len(shown) == len(runs) else f"{len(shown)} of {counted(len(runs), 'run')}"
    return FigureBlock(
        f"trajectory {source}",
        f"The way of the robot ({source}) by its odometry, {whose}. Circle: beginning; cross: end.",
        f"{counted(len(ways), 'way')} seen from above.",
        lambda: draw_trajectories(ways, order=material.order),
    )


#: The file of a camera's notes on its stills: `runs/<run id>/<plugin>/stills.json`.
_STILLS = "stills.json"
#: More rows would be too small to see anything.
_MOST_RUNS = 8
_MOST_STILLS = 8


def stills_part(material: Material) -> Iterator[Part]:
    """Yield a part with a figure for each camera that has stills of runs that are done."""
    folder = ExperimentFolder(material.results.folder)
    cameras: dict[str, Stills] = {}
    for run_id, path, notes in notes_of(folder, map(str, material.done[RUN_ID]), f"*/{_STILLS}"):
        if stills := _stills(notes, path, folder.root):
            cameras.setdefault(path.parent.name, {})[f"{run_id}, {material.labels[run_id]}"] = stills
    if cameras:
        figures = tuple(_stills_figure(camera, runs) for camera, runs in cameras.items())
        beside = Beside((Gallery(figures), *means_table(material, "means beside stills")))
        yield Part("stills", "What the camera saw", (beside,))


def _stills_figure(camera: str, runs: Stills) -> FigureBlock:
    shown = dict(list(runs.items())[:: -(-len(runs) // _MOST_RUNS)])
    which = "all runs that are done" if len(shown) == len(runs) else f"{len(shown)} of {counted(len(runs), 'run')}"
    return FigureBlock(
        f"stills {camera}",
        f"Stills of the mission ({camera}), {which}. The videos are beside the raw data of each run.",
        f"Stills of {counted(len(shown), 'run')}.",
        lambda: draw_stills(shown),
        is_wide=True,
        has_photographs=True,
    )


def _stills(notes: object, path: Path, root: Path) -> tuple[tuple[str, Path], ...]:
    """Return the caption and the file of each still; other entries, and paths outside the folder, are ignored."""
    stills = [note for note in notes if isinstance(note, dict)] if isinstance(notes, list) else []
    found = ((str(note.get("label")), path.parent / str(note.get("file"))) for note in stills)
    safe = (each for each in found if each[1].parent == path.parent and _is_file(each[1], root))
    return tuple(islice(safe, _MOST_STILLS))


def _is_file(path: Path, root: Path) -> bool:
    try:
        require_file(path, root)
    except StorageError:
        return False
    return True


_LETTERS = 24


def draw_stills(runs: Stills) -> Figure:
    """Draw the stills of runs, a row for each run; the place of an unreadable file stays empty."""
    columns = max(map(len, runs.values()))
    figure = new_figure(PAGE, min(HIGHEST, len(runs) * (0.68 * PAGE / columns + 0.2)))
    grid = figure.subplots(len(runs), columns, squeeze=False)
    for places, (name, stills) in zip(grid, runs.items(), strict=True):
        for number, axes in enumerate(places):
            axes.set_axis_off()
            if number >= len(stills):
                continue
            label, path = stills[number]
            before = f"{name}: " if number == 0 else ""
            axes.set_title(shortened(before + label, _LETTERS), fontsize="small", loc="left")
            try:
                axes.imshow(imread(path))
            except (OSError, ValueError, SyntaxError):  # Pillow raises the last for a damaged file
                axes.text(0.5, 0.5, "no picture", color=GREY, ha="center", va="center", transform=axes.transAxes)
    return figure
