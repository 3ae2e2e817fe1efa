"""Legends leave the values their room."""

from __future__ import annotations

import pytest

from robot_runner.analysis.figures.effects import draw_agreement
from robot_runner.analysis.figures.style import HIGHEST


def many_combinations(count):
    names = [f"planner number {place // 4} / 0.{place % 4}" for place in range(count)]
    pairs = {name: [(5.0 + place / count, 5.5)] for place, name in enumerate(names)}
    return draw_agreement(
        pairs, bias=0.1, lower=-1, upper=1, value_label="Energy (J)", names=("ours", "theirs"), unit="J"
    )


@pytest.mark.long
@pytest.mark.parametrize("count", [24, 150])
def test_a_legend_of_many_combinations_leaves_the_values_their_room(count):
    figure = many_combinations(count)
    figure.draw_without_rendering()
    values = figure.axes[0].get_window_extent()
    assert values.height >= figure.dpi  # an inch
    assert all(legend.get_window_extent().y1 < values.y0 for legend in figure.legends)
    assert figure.get_figheight() <= HIGHEST
    assert bool(figure.legends) is (count == 24)  # 150 are told apart neither by colour nor by marker
