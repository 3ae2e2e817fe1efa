"""Figures have units on their axes, fit a column, and can be told apart without colour."""

from __future__ import annotations

import hashlib
import subprocess
import sys
import warnings
from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from robot_runner.analysis.figures.courses import MissionCourses, PhaseSpan, course_of_run
from robot_runner.analysis.figures.distribution import (
    Group,
    draw_distribution,
    draw_proportions,
    draw_quantiles,
    draw_run_order,
)
from robot_runner.analysis.figures.effects import (
    Estimate,
    draw_agreement,
    draw_differences,
    draw_interaction,
    draw_power,
)
from robot_runner.analysis.figures.missions import (
    AttemptSpan,
    Trajectory,
    draw_mean_courses,
    draw_single_courses,
    draw_timeline,
    draw_trajectories,
)
from robot_runner.analysis.figures.style import (
    COLUMN,
    PAGE,
    FigureFormat,
    figure_bytes,
    letters_without_font,
    looks,
    verbatim,
)
from robot_runner.analysis.statistics.outcome import Proportion
from robot_runner.analysis.statistics.tested import Interval

ROOT = Path(__file__).parents[3]
LABEL = "Energy (J)"
TASKS = ("Video", "Network")


def mission():
    time = np.arange(0, 20, 0.1)
    runs = {name: [course_of_run(f"r_{n}", time, 7 + np.sin(time) + n, 0.5)] for n, name in enumerate(TASKS)}
    phases = [PhaseSpan("sleep", 0, 5), PhaseSpan("forward", 5, 20)]
    return MissionCourses("Power (W)", "W", TASKS, runs, 0.5, phases, {"launch_mission": 0.1, "stop_measurement": 19.0})


def single():
    return draw_single_courses(mission())


def means():
    return draw_mean_courses(replace(mission(), phases=(), events={}))


def distribution(count=3, size=5):
    groups = [
        Group(f"T{n}", tuple(np.linspace(n, n + 1, size)), tuple(f"r_{n}_{i}" for i in range(size)))
        for n in range(count)
    ]
    return draw_distribution(groups, value_label=LABEL, group_label="Task", outliers=frozenset({"r_0_0"}))


DRAWINGS = {
    "single": single,
    "means": means,
    "distribution": distribution,
    "many_groups": lambda: distribution(30, 3),
    "violins": lambda: distribution(2, 40),
    "one_value": lambda: distribution(1, 1),
    "no_value": lambda: draw_distribution([Group("a", (), ())], value_label=LABEL, group_label="Task"),
    "equal_values": lambda: draw_distribution(
        [Group("a", (1.0,) * 30, ("r",) * 30)], value_label=LABEL, group_label="Task"
    ),
    "interaction": lambda: draw_interaction(
        {
            "fast": {"a": Group("a", (1.0,), ("r_1",), 0.9, 1.1), "b": Group("b", (2.0,), ("r_2",))},
            "slow": {"a": Group("a", (1.5,), ("r_3",))},
        },
        treatments=["a", "b"],
        value_label=LABEL,
        along="Task",
        across="Speed",
    ),
    "order": lambda: draw_run_order(
        [1, 2, 3], [0.1, -0.2, 0.1], ["a", "b", "a"], order=("a", "b"), value_label=LABEL, slope=0.1
    ),
    "quantiles": lambda: draw_quantiles([-1, 0, 1], [-2, 0, 2], slope=2, intercept=0, value_label=LABEL),
    "trajectory": lambda: draw_trajectories(
        [Trajectory("a", np.arange(9.0), np.zeros(9)), Trajectory("b", np.zeros(9), np.zeros(9))], order=("a", "b")
    ),
    "standing": lambda: draw_trajectories([Trajectory("a", np.zeros(3), np.zeros(3))], order=("a",)),
    "nowhere": lambda: draw_trajectories([Trajectory("a", np.array([np.nan]), np.array([np.nan]))], order=("a",)),
    "timeline": lambda: draw_timeline(
        [AttemptSpan("r_1", "a", 0, 9, (1, 8), is_done=True), AttemptSpan("r_2", "b", 9, 12, None, is_done=False)],
        order=("a", "b"),
    ),
    "agreement": lambda: draw_agreement(
        {"a": [(1.0, 1.1)], "b": [(2.0, 2.1), (3.0, 2.9)]},
        bias=0.1,
        lower=-0.1,
        upper=0.3,
        value_label=LABEL,
        names=("one", "other"),
        unit="J",
    ),
    "differences": lambda: draw_differences(
        [Estimate("a", 0.1, -0.1, 0.3, 0.5), Estimate("b", 0.1, 0.0, 0.2, None)], value_label=LABEL
    ),
}

# Each is drawn once, for all tests that only look at it.
each_drawing = pytest.mark.parametrize("draw", [cache(draw) for draw in DRAWINGS.values()], ids=DRAWINGS)


@each_drawing
def test_axes_are_labelled(draw):
    figure = draw()
    drawn = [axes for axes in figure.axes if axes.axison]
    assert all(axes.get_xlabel() for axes in drawn[-1:])
    is_labelled = [axes.get_ylabel() or figure.get_supylabel() for axes in drawn]
    assert all(is_labelled) or figure.get_figwidth() == PAGE or drawn[0].get_yticklabels()


@each_drawing
def test_it_fits_a_column_or_a_page(draw):
    width, height = draw().get_size_inches()
    assert width <= COLUMN or width == PAGE
    assert height <= 9.0


@each_drawing
def test_it_can_be_saved(draw):
    assert figure_bytes(draw(), FigureFormat.SVG).rstrip().endswith(b"</svg>")


@pytest.mark.parametrize(("kind", "head"), [(FigureFormat.PDF, b"%PDF"), (FigureFormat.PNG, b"\x89PNG")])
def test_it_can_be_saved_in_each_format(kind, head):
    assert figure_bytes(single(), kind).startswith(head)


def test_letters_in_a_pdf_are_of_a_truetype_font():
    data = figure_bytes(single(), FigureFormat.PDF)
    assert b"/CIDFontType2" in data
    assert b"/Type3" not in data


@pytest.mark.filterwarnings("error")
def test_a_time_line_of_an_attempt_that_was_killed_as_it_began_is_drawn_without_a_word() -> None:
    draw_timeline([AttemptSpan("r_1", "a", 0.0, 0.0, None, is_done=False)], order=["a"])


def test_a_crowd_of_points_is_not_hidden_by_their_edges_and_hides_neither_box_nor_legend():
    """Of 100,000 runs, white edges covered the points, the boxes and the medians."""
    names, count = ["Video", "Idle"], 700
    places = list(range(2 * count))
    ordered = draw_run_order(places, [0.1] * len(places), names * count, order=names, value_label="Energy (J)")
    boxes = distribution(2, count)
    for figure in (ordered, boxes):
        crowds = [line for line in figure.axes[0].lines if len(line.get_xdata()) == count]
        assert len(crowds) == 2
        assert {line.get_markeredgewidth() for line in crowds} == {0.0}
    others = {*boxes.axes[0].patches, *boxes.axes[0].lines}.difference(crowds)
    lowest = min(artist.get_zorder() for artist in others)
    assert max(line.get_zorder() for line in crowds) < lowest
    [legend] = ordered.legends
    assert all(handle.get_markersize() > 2 for handle in legend.legend_handles)


@pytest.mark.long
def test_crowds_of_points_and_bars_are_kept_as_pixels():
    spans = [AttemptSpan(f"r_{n}", "Video", n, n + 0.9, (n + 0.1, n + 0.8), is_done=True) for n in range(400)]
    for few, many in (
        (distribution(), distribution(3, 250)),
        (draw_timeline(spans[:20], order=["Video"]), draw_timeline(spans, order=["Video"])),
    ):
        assert b"<image" not in figure_bytes(few, FigureFormat.SVG)
        svg = figure_bytes(many, FigureFormat.SVG)
        assert b"data:image/png;base64" in svg
        assert len(svg) < 150_000


def test_a_timeline_tells_treatments_apart_without_colours():
    names = ["Video", "Network", "Idle", "Map"]
    spans = [AttemptSpan(f"r_{n}", names[n % 4], n, n + 0.9, None, is_done=True) for n in range(8)]
    figure = draw_timeline(spans, order=names)
    told = {line.get_label(): line.get_marker() for line in figure.axes[0].lines if line.get_label() in names}
    assert len(set(told.values())) == 4
    [legend] = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == names


def test_a_timeline_of_thousands_of_runs_has_few_artists():
    spans = [AttemptSpan(f"r_{n}", "Video", n, n + 0.9, (n + 0.1, n + 0.8), is_done=n % 7 > 0) for n in range(5_000)]
    [axes] = draw_timeline(spans, order=["Video"]).axes
    assert len(axes.patches) + len(axes.collections) < 10
    done = sum(span.is_done for span in spans)
    assert sorted(len(bars.get_paths()) for bars in axes.collections) == sorted([done, done, 5_000 - done])
    assert axes.get_xlim() == (0, pytest.approx(1.05 * 4_999.9 / 60))  # min


def test_names_of_outliers_do_not_hide_each_other():
    values = (*np.linspace(0, 1, 20), 9.0, 9.01, 9.02, -8.0)
    group = Group("T", values, tuple(f"r_{n}" for n in range(24)))
    for count, names in ((1, ["r_23", "r_22"]), (4, ["r_23"] * 4 + ["r_22"] * 2)):
        figure = draw_distribution(
            [group] * count, value_label=LABEL, group_label="Task", outliers=frozenset(group.run_ids[20:])
        )
        assert [text.get_text() for text in figure.axes[0].texts] == names


def test_of_many_outliers_the_farthest_from_their_medians_are_named_whatever_their_group():
    far = [(1, 90.0), (3, 60.0), (0, 50.0), (2, 40.0), (3, -30.0), (1, 30.0), (0, 25.0), (0, -20.0)]
    groups = [
        Group(
            f"t{number}",
            tuple([float(value % 3) for value in range(20)] + [value for group, value in far if group == number]),
            tuple(
                [f"r_{number}_{run}" for run in range(20)] + [f"{value:g}" for group, value in far if group == number]
            ),
        )
        for number in range(4)
    ]
    outliers = frozenset(f"{value:g}" for _, value in far)
    figure = draw_distribution(groups, value_label=LABEL, group_label="Task", outliers=outliers)
    assert [note.get_text() for note in figure.axes[0].texts] == ["90", "60", "50", "40", "-30", "30"]


def test_names_of_outliers_stand_beside_the_numbers_of_the_axis_and_not_on_them():
    values = (*np.linspace(0, 1, 20), 9.0)
    group = Group("T", values, tuple(f"r_{1500 + n}" for n in range(21)))
    others = [Group(f"{n}", (1.0, 2.0), ("r_1", "r_2")) for n in range(7)]
    for groups, side in (([group], "right"), ([group, *others], "left"), ([*others, group], "left")):
        figure = draw_distribution(groups, value_label=LABEL, group_label="Task", outliers=frozenset({"r_1520"}))
        assert figure.axes[0].texts[0].get_horizontalalignment() == side
        figure_bytes(figure, FigureFormat.PNG)
        figure.draw_without_rendering()  # at the resolution of the figure
        extents = [text.get_window_extent() for text in figure.axes[0].texts]
        assert min(extent.x0 for extent in extents) >= figure.axes[0].bbox.x0
        assert max(extent.x1 for extent in extents) <= figure.bbox.width


@pytest.mark.parametrize("count", [2, 12])
def test_a_long_label_is_not_cut_at_an_edge_of_the_figure(count):
    groups = [Group(f"a treatment of a longer name {n}", (1.0, 2.0), ("r_1", "r_2")) for n in range(count)]
    long = "a_name_of_a_measure_that_is_nowhere_to_be_broken (J)"
    figure = draw_distribution(groups, value_label=long, group_label=long)
    figure_bytes(figure, FigureFormat.PNG)
    figure.draw_without_rendering()  # at the resolution of the figure
    for label in (figure.axes[0].xaxis.label, figure.axes[0].yaxis.label):
        extent = label.get_window_extent()
        assert 0 <= extent.x0 < extent.x1 <= figure.bbox.width
        assert 0 <= extent.y0 < extent.y1 <= figure.bbox.height


def test_a_figure_is_no_wider_than_a_column_or_a_page_of_the_latex_class_of_ieee():
    points = 72.27  # of TeX, an inch
    assert (252 - 1 < COLUMN * points < 252, 516 - 1 < PAGE * points < 516) == (True, True)


def test_units_stand_on_the_axes():
    figure = single()
    texts = [figure.get_supylabel(), figure.axes[-1].get_xlabel()]
    assert texts == ["Power (W)", "Time since the start of the mission (s)"]


def test_phases_and_events_are_named():
    words = {text.get_text() for axes in single().axes for text in axes.texts}
    assert {"sleep", "forward", "launch mission", "stop measurement"} <= words


@pytest.mark.parametrize("count", range(1, 11))
def test_treatments_are_told_apart_without_colour(count):
    found = looks(count)
    assert len({look.marker for look in found}) == count
    assert len({look.colour for look in found}) == count


@pytest.mark.parametrize("count", [2, 3, 12])
def test_colours_stay_apart_in_grey(count):
    greys = [float(np.dot((0.2126, 0.7152, 0.0722), to_rgb(look.colour))) for look in looks(count)]
    assert min(abs(one - other) for one, other in pairwise(greys)) > 0.03


def test_a_treatment_looks_the_same_in_each_figure():
    drawn = draw_run_order([1], [0.0], ["Network"], order=TASKS, value_label=LABEL)
    [line] = [line for line in drawn.axes[0].lines if line.get_label() == "Network"]
    assert line.get_color() == looks(2)[1].colour


def test_names_are_no_formulas_and_no_markup():
    figure = draw_distribution(
        [Group(r"$\frac{1}{0}$", (1.0, 2.0), ("r_1", "r_2"))], value_label="<b>$E$</b> (%)", group_label="a\nb"
    )
    svg = figure_bytes(figure, FigureFormat.SVG).decode()
    assert "<b>" not in svg
    assert figure.axes[0].get_xticklabels()[0].get_text() == r"$\frac{1}{0}$"
    assert figure.axes[0].get_xlabel() == "a b"


def test_a_proportion_without_an_interval_is_a_point_without_a_bar():
    known = Proportion({"Task": "a"}, 4, 0, 3, 75.0, Interval(30.0, 95.0, 0.95, "Wilson's score interval"))
    groups = [known, replace(known, treatments={"Task": "b"}, percent=50.0, interval=None)]
    (axes,) = draw_proportions(groups, value_label="Reached (%)", group_label="Task").axes
    assert [line.get_ydata()[0] for line in axes.lines if line.get_marker() == "D"] == [75.0, 50.0]
    assert len(axes.collections) == 1, "one bar"


def test_proportions_of_some_treatments_look_as_in_figures_of_all():
    known = Proportion({"Task": "b"}, 4, 0, 3, 75.0, Interval(30.0, 95.0, 0.95, "Wilson's score interval"))
    (axes,) = draw_proportions([known], value_label="Reached (%)", group_label="Task", order=[*TASKS, "b"]).axes
    assert axes.lines[0].get_color() == looks(3)[2].colour


def test_no_line_leads_through_a_combination_without_runs():
    cells = {name: Group(name, (1.0, 2.0), ("r_1", "r_2")) for name in ("a", "c")}
    figure = draw_interaction(
        {"lab": cells, "hall": cells | {"b": cells["a"]}},
        treatments=["a", "b", "c"],
        value_label=LABEL,
        along="A",
        across="B",
    )
    gap, whole = (line.get_ydata() for line in figure.axes[0].lines if line.get_label() in {"lab", "hall"})
    assert np.isnan(gap).tolist() == [False, True, False]
    assert list(whole) == [1.5, 1.5, 1.5]


def test_letters_that_no_font_has_become_boxes():
    groups = [Group("\U000e0fff 🤖", (1.0,), ("r",))]
    assert figure_bytes(draw_distribution(groups, value_label=LABEL, group_label="T"), FigureFormat.PNG)


@pytest.mark.long
@given(st.text())
def test_what_is_shown_stays_on_one_line(text):
    assert verbatim(text).isprintable()


@pytest.mark.long
def test_the_same_figure_is_the_same_file_in_each_process():
    program = (
        "import hashlib\n"
        "from tests.analysis.figures.test_drawing import FigureFormat, figure_bytes, single\n"
        "print(hashlib.sha256(figure_bytes(single(), FigureFormat.SVG)).hexdigest())\n"
    )
    told = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    assert told.strip() == hashlib.sha256(figure_bytes(single(), FigureFormat.SVG)).hexdigest()


def test_a_figure_that_is_laid_out_is_drawn_once(monkeypatch):
    draws = []
    monkeypatch.setattr(Figure, "draw", lambda figure, renderer, draw=Figure.draw: draws.append(draw(figure, renderer)))
    figure_bytes(distribution(), FigureFormat.SVG)
    assert len(draws) == 1


def test_an_event_after_the_last_sample_leaves_the_axes_their_room():
    run = course_of_run("r_1", np.arange(3.0), np.arange(3.0), 0.5)
    figure = draw_single_courses(MissionCourses("Power (W)", "W", ("a",), {"a": [run]}, 0.5, (), {"stop": 95.0}))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        figure_bytes(figure, FigureFormat.SVG)
    assert figure.axes[0].get_position().width > 0.7


def test_repetitions_are_counted_in_whole_numbers():
    axes = draw_power({"d = 0.8": [(2, 0.3, 0.25, 0.35), (4, 0.9, 0.88, 0.92)]}, 0.8).axes[0]
    assert all(float(each).is_integer() for each in axes.get_xticks())


def test_limits_of_agreement_are_not_written_over_the_bias():
    pairs, axis = {"a": [(1.0, 1.0), (2.0, 2.0)]}, {"value_label": "CPU (%)", "names": ("one", "other"), "unit": ""}
    axes = draw_agreement(pairs, bias=0.0, lower=0.0, upper=0.0, **axis).axes[0]
    assert [each.get_text() for each in axes.texts] == ["bias 0"]


def test_long_names_that_differ_in_the_middle_are_told_apart_in_each_figure():
    names = [
        f"config/of/the/robots/of/the/lab/nav2_dwb_{speed}_params_of_all.yaml" for speed in ("fast", "slow", "none")
    ]
    groups = [Group(name, (1.0, 2.0), ("r_1", "r_2")) for name in names]
    lines = {name: {"a": group, "b": group} for name, group in zip(names, groups, strict=True)}
    estimates = [Estimate(name, 1.0, 0.5, 1.5, None) for name in names]
    interaction = draw_interaction(lines, treatments=["a", "b"], value_label=LABEL, along="A", across="B")
    shown = [
        draw_distribution(groups, value_label=LABEL, group_label="Config").axes[0].get_xticklabels(),
        draw_distribution(groups * 3, value_label=LABEL, group_label="Config").axes[0].get_yticklabels()[:3],
        draw_differences(estimates, value_label=LABEL).axes[0].get_yticklabels(),
        interaction.legends[0].get_texts(),
    ]
    for texts in shown:
        assert ["fast" in text.get_text() for text in texts] == [True, False, False]
        assert ["slow" in text.get_text() for text in texts] == [False, True, False]
    shown = draw_agreement({"a": [(1.0, 2.0)]}, bias=1, lower=0, upper=2, value_label=LABEL, names=names[:2], unit="J")
    assert all(speed in shown.axes[0].get_ylabel() for speed in ("fast", "slow"))


def test_long_combinations_that_differ_in_two_places_are_told_apart():
    names = [
        f"config/nav2_{planner}_controller_params.yaml / maps/building_{floor}_floor_of_the_lab.yaml"
        for planner in ("dwb", "rpp")
        for floor in ("north", "south")
    ]
    groups = [Group(name, (1.0, 2.0), ("r_1", "r_2")) for name in names]
    figure = draw_distribution(groups, value_label=LABEL, group_label="Config / Map")
    figure_bytes(figure, FigureFormat.SVG)
    shown = [label.get_text() for label in figure.axes[0].get_xticklabels()]
    assert len(set(shown)) == len(names)
    assert [("_rpp" in label, "_sou" in label) for label in shown] == [
        (rpp, south) for rpp in (False, True) for south in (False, True)
    ]
    assert max(map(len, shown)) <= 31


def test_a_long_name_of_a_measure_fits_beneath_many_groups():
    groups = [Group(f"a planner with a long name, {at} / hall", (1.0 * at, 2.0), ("r_1", "r_2")) for at in range(12)]
    figure = draw_distribution(
        groups,
        value_label="The goal was reached before the battery was empty (% of runs)",
        group_label="Planner",
    )
    figure.draw_without_rendering()
    ends = figure.axes[0].xaxis.label.get_window_extent()
    assert 0 <= ends.x0 < ends.x1 <= figure.bbox.width


def test_a_power_of_ten_beneath_an_axis_is_not_written_over_its_label():
    groups = [Group(f"a planner with a long name, {at}", (1e6 + at, 1.004e6), ("r_1", "r_2")) for at in range(12)]
    figure = draw_distribution(groups, value_label="Energy of the whole robot and its computer", group_label="Planner")
    figure_bytes(figure, FigureFormat.PNG)
    axis = figure.axes[0].xaxis
    assert axis.get_offset_text().get_text() == "1e6"
    assert axis.label.get_window_extent().y1 <= axis.get_offset_text().get_window_extent().y0


LONG = [
    f"planner {name} with a global map, recovery and C:\\new_50%_é" for name in ("A*", "D*", "RRT", "PRM", "θ*", "TEB")
]
LONG_MEASURE = "Acceleration_of_the_mobile_platform_along_its_longitudinal_axis_filtered (m·s⁻²)"


def long_interaction():
    cells = {name: Group(name, (1.0,), ("r_1",)) for name in LONG[:3]}
    return draw_interaction(
        {"fast": cells, "slow": cells}, treatments=LONG[:3], value_label=LONG_MEASURE, along="Planner", across="Speed"
    )


def long_order():
    return draw_run_order(range(6), [0.1, -0.2] * 3, LONG, order=LONG, value_label=LONG_MEASURE, slope=0.1)


def long_timeline():
    spans = [AttemptSpan(f"r_{n}", name, n, n + 1, None, is_done=True) for n, name in enumerate(LONG)]
    return draw_timeline(spans, order=LONG)


@pytest.mark.parametrize("draw", [long_order, long_timeline])
def test_a_legend_of_long_names_is_not_cut_off(draw):
    figure = draw()
    figure_bytes(figure, FigureFormat.SVG)
    [legend] = figure.legends
    ends = legend.get_window_extent()
    assert 0 <= ends.x0 < ends.x1 <= figure.bbox.width
    assert 0 <= ends.y0 < figure.axes[0].get_window_extent().y0
    assert len({text.get_text() for text in legend.get_texts()}) == len(LONG)


def test_long_names_of_treatments_do_not_hide_each_other():
    names = long_interaction().axes[0].get_xticklabels()
    assert {name.get_rotation() for name in names} == {30}
    assert [name.get_rotation() for name in DRAWINGS["interaction"]().axes[0].get_xticklabels()] == [0, 0]


@pytest.mark.parametrize("draw", [long_order, long_interaction])
def test_a_long_name_of_a_measure_is_not_cut_off_beside_a_low_figure(draw):
    figure = draw()
    figure_bytes(figure, FigureFormat.SVG)
    figure.set_dpi(300)  # letters are wider than at 100
    label = figure.axes[0].yaxis.label
    ends = label.get_window_extent()
    assert -1 <= ends.y0 < ends.y1 <= figure.bbox.height + 1
    assert label.get_fontsize() >= 5


def test_letters_that_would_be_boxes_are_known():
    assert letters_without_font(["Énergie (µJ·s⁻¹)", "θ* …", "two\nlines"]) == ""
    assert letters_without_font(["sign \U00012000", "\U00012000 and \U00012001"]) == "\U00012000\U00012001"
