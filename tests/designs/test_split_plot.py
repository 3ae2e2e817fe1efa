from __future__ import annotations

from collections import Counter
from itertools import groupby

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robot_runner.core.design.factor import Factor
from robot_runner.core.design.run_table_model import RunTableModel
from robot_runner.core.errors import DesignError
from robot_runner.designs import SplitPlot


@settings(deadline=None, max_examples=30)
@given(
    floors=st.integers(1, 3),
    lamps=st.integers(1, 2),
    speeds=st.integers(1, 4),
    replicates=st.integers(1, 3),
    repetitions=st.integers(1, 2),
    seed=st.integers(0, 2**32 - 1),
    shuffle=st.booleans(),
)
def test_hard_factors_change_from_whole_plot_to_whole_plot_only(
    floors: int, lamps: int, speeds: int, replicates: int, repetitions: int, seed: int, shuffle: bool
) -> None:
    def planned(replicates: int) -> RunTableModel:
        factors = [
            Factor("Speed", range(speeds)),
            Factor("Lamp", range(lamps)),
            Factor("Floor", range(floors)),
            Factor("Plot", range(floors * lamps * replicates)),
        ]
        design = SplitPlot(["Floor", "Lamp"], "Plot")
        return RunTableModel(factors, repetitions=repetitions, seed=seed, shuffle=shuffle, design=design)

    model = planned(replicates)
    runs = list(model.plan())
    plots = [(plot, list(mine)) for plot, mine in groupby(runs, key=lambda run: run.combination["Plot"])]
    assert [plot for plot, _ in plots] == list(range(floors * lamps * replicates)), "each once, in its order"
    held = []
    for _, mine in plots:
        assert len({(run.combination["Floor"], run.combination["Lamp"]) for run in mine}) == 1
        assert Counter((run.combination["Speed"], run.repetition) for run in mine) == {
            (speed, number): 1 for speed in range(speeds) for number in range(1, repetitions + 1)
        }
        held.append((mine[0].combination["Floor"], mine[0].combination["Lamp"]))
    for first in range(0, len(held), floors * lamps):
        assert len(set(held[first : first + floors * lamps])) == floors * lamps, "a replicate has each once"
    settings_of_hard = sum(1 for _ in groupby(held))
    assert model.design_facts["changes"] == settings_of_hard - 1 <= floors * lamps * replicates - 1
    assert list(planned(replicates + 1).plan())[: len(runs)] == runs, "further whole plots leave the first ones"


def test_the_order_within_whole_plots_is_random_and_what_cannot_be_tested_is_said() -> None:
    factors = [Factor("Plot", [1, 2]), Factor("Floor", ["wood", "carpet"]), Factor("Speed", range(6))]
    model = RunTableModel(factors, shuffle=True, seed=1, design=SplitPlot("Floor", "Plot"))
    speeds = [run.combination["Speed"] for run in model.plan()]
    assert speeds[:6] != sorted(speeds[:6])
    assert speeds[:6] != speeds[6:]
    changes, note = model.design_facts["notes"]
    assert changes == "Floor changes 1 time in 2 whole plots"
    assert "one whole plot: nothing tells how whole plots vary, so that Floor cannot be tested" in note


def test_a_split_plot_that_cannot_be_is_a_finding() -> None:
    factors = [Factor("Plot", range(5)), Factor("Floor", ["wood", "carpet"]), Factor("Speed", [0.1, 0.2])]
    with pytest.raises(DesignError, match=r"5 whole plots, no multiple of the 2 .* Have 4 or 6 whole plots"):
        RunTableModel(factors, design=SplitPlot("Floor", "Plot"))
    with pytest.raises(DesignError) as caught:
        RunTableModel(factors, design=SplitPlot(["Flor", "Speed"], "Plott"))
    assert [finding.fix for finding in caught.value.findings] == ["Did you mean 'Plot'?", "Did you mean 'Floor'?"]
    with pytest.raises(DesignError, match="no factor is left to be studied"):
        RunTableModel(factors[:2], design=SplitPlot("Floor", "Plot"))
    with pytest.raises(DesignError, match="no factor is hard to change"):
        RunTableModel(factors, design=SplitPlot([], "Plot"))
    with pytest.raises(DesignError, match="there is no factor 3"):
        RunTableModel(factors, design=SplitPlot(3, "Plot"))
