"""Samples that are read batch by batch, and samples of several profilers on one grid of times."""

from __future__ import annotations

import json

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
import pytest
from tests.analysis.made_experiment import make_experiment, write_phases, write_samples

from robot_runner.analysis import Resampling, lazy_samples, load_results
from robot_runner.analysis.alignment import align_values
from robot_runner.core.errors import AnalysisError
from robot_runner.core.storage.journal import Journal

RATE, SECONDS = 200, 40.0


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """Return two runs of each task: power at 200 Hz, use of the processor every 0.1 s, phases of the mission."""
    made = make_experiment(tmp_path_factory.mktemp("lazy") / "trial", repetitions=2)
    random = np.random.default_rng(5)
    for run_id, begun in zip(("r_1", "r_2", "r_3", "r_4"), (10.0, 20.0, 5.0, 7.0), strict=True):
        times = begun + np.arange(int(RATE * SECONDS)) / RATE
        power = 7 + random.normal(size=len(times))
        rows = "\n".join(f"{t:.4f},{p:.6f},{place}" for place, (t, p) in enumerate(zip(times, power, strict=True)))
        write_samples(made, run_id, f"time_s,power_W,number\n{rows}\n")
        slow = begun + 0.03 + np.arange(int(SECONDS * 10)) / 10
        rows = "\n".join(f"{t:.4f},{20 + t:.4f}" for t in slow if not 15 < t - begun < 17)
        write_samples(made, run_id, f"time_s,cpu_percent\n{rows}\n", plugin="Host")
        write_phases(made, run_id, f"number,phase,start_s,end_s\n1,sleep,{begun},{begun + 5}\n2,drive,{begun + 5},99\n")
        with Journal(made.journal) as journal:
            window = {"run": run_id, "attempt": 1, "start": begun + 1.0, "end": begun + 31.0}
            journal.append("window", **window)
            journal.append("clock", run=run_id, attempt=1, owner="Host", host="robot", uncertainty=0.004)
    return load_results(made.root)


@pytest.mark.parametrize(
    "chosen",
    [*(kind(["Video", "Video"]) for kind in (np.array, pd.Index, pd.Series, pd.Categorical)), np.str_("Video")],
    ids=lambda each: type(each).__name__,
)
def test_treatments_may_be_given_as_pandas_and_numpy_hold_them(results, chosen):
    found = results.lazy_samples("Host", treatments={"Task": chosen}).frame()
    assert set(found["Task"]) == {"Video"}


def test_a_column_that_is_named_twice_comes_once(results):
    assert list(results.samples("Host", columns=["cpu_percent"] * 2).columns)[-1:] == ["cpu_percent"]
    assert list(results.lazy_samples("Host", columns=["cpu_percent"] * 2).frame().columns).count("cpu_percent") == 1
    aligned = results.aligned_samples({"Host": ["cpu_percent"] * 2}, period=1.0)
    assert [column.name for column in aligned.columns] == ["Host.cpu_percent"]
    assert list(aligned.frame.columns)[-2:] == ["time_s", "Host.cpu_percent"]


@pytest.mark.long
def test_batches_hold_what_the_whole_table_holds(results):
    whole = results.samples("Meter")
    pieces = list(results.lazy_samples("Meter").frames())
    assert len(pieces) >= 4
    pd.testing.assert_frame_equal(pd.concat(pieces, ignore_index=True), whole, check_dtype=False)
    assert pieces[0].dtypes["Task"].ordered
    assert {str(piece["number"].dtype) for piece in pieces} == {"float64"}


def test_filters_choose_what_a_mask_over_the_whole_table_chooses(results):
    whole = results.samples("Meter", columns=["power_W"])
    mask = (whole["Task"] == "Video") & whole["in_window"] & (whole["phase"] == "drive")
    found = results.lazy_samples(
        "Meter", columns=["power_W"], treatments={"Task": "Video"}, phases=["drive"], within_window=True
    ).frame()
    assert 0 < len(found) < len(whole) / 2
    assert found["power_W"].tolist() == whole.loc[mask, "power_W"].tolist()
    assert found["time_s"].tolist() == whole.loc[mask, "time_s"].tolist()
    assert set(found["Task"]) == {"Video"}


def test_arrow_takes_the_stream(results):
    table = results.lazy_samples("Meter", columns=["power_W"], within_window=True).reader().read_all()
    by_task = table.group_by("Task").aggregate([("power_W", "mean"), ("power_W", "count")]).to_pydict()
    whole = results.samples("Meter")
    expected = whole[whole["in_window"]].groupby("Task", observed=True)["power_W"].mean()
    assert dict(zip(by_task["Task"], by_task["power_W_mean"], strict=True)) == pytest.approx(dict(expected))
    assert pc.sum(pa.chunked_array([by_task["power_W_count"]])).as_py() == int(whole["in_window"].sum())


@pytest.mark.parametrize(
    ("chosen", "problem", "fix"),
    [
        ({"columns": ["powr_W"]}, "there is no column 'powr_W'", "power_W"),
        ({"treatments": {"Tsk": "Video"}}, "there is no factor 'Tsk'", "Task"),
        ({"treatments": {"Task": ["Video", "Netwrk"]}}, "factor 'Task' has no treatment 'Netwrk'", "Network"),
        ({"phases": ["drve"]}, "there is no phase 'drve'", "drive"),
        ({"runs": ["r_9"]}, "there is no run 'r_9'", "r_"),
    ],
)
def test_what_is_not_there_is_said_with_the_nearest_name(results, chosen, problem, fix):
    with pytest.raises(AnalysisError) as raised:
        results.lazy_samples("Meter", **chosen).frame()
    assert problem in str(raised.value)
    assert fix in raised.value.fix


def test_a_file_that_holds_something_else_is_named(tmp_path):
    made = make_experiment(tmp_path / "trial", repetitions=1)
    write_samples(made, "r_1", "time_s,power_W\n0.0,1.0\n")
    write_samples(made, "r_2", "time_s,power_W\n0.0,high\n")
    with pytest.raises(AnalysisError, match="does not hold what the first one does") as raised:
        load_results(made.root).lazy_samples().frame()
    assert "r_2" in raised.value.where


@pytest.mark.long
def test_few_samples_are_held_at_once(tmp_path, monkeypatch):
    monkeypatch.setattr(lazy_samples, "_BLOCK", 1 << 16)  # so that a small file is long beside what is read ahead
    made = make_experiment(tmp_path / "trial", repetitions=1)
    rows = "".join(f"{place / 1000:.3f},{place % 97},1.5,2.5,3.5\n" for place in range(400_000))
    write_samples(made, "r_1", f"time_s,a,b,c,d\n{rows}")
    samples = load_results(made.root).lazy_samples("Meter")
    before, most, count = pa.total_allocated_bytes(), 0, 0
    for batch in samples.reader():
        count += len(batch)
        most = max(most, pa.total_allocated_bytes() - before)
    assert count == 400_000
    assert most < 6e6  # the whole table holds 16 MB in its values alone


def independent_mean(times, values, at, period):
    """Return the mean of what is nearer to a time than to its neighbours, by looking at each sample."""
    near = [v for t, v in zip(times, values, strict=True) if -period / 2 <= round(t - at, 9) < period / 2]
    return sum(near) / len(near) if near else float("nan")


@pytest.mark.long
def test_means_and_lines_agree_with_a_slow_computation(results):
    aligned = results.aligned_samples({"Meter": ["power_W"], "Host": ["cpu_percent"]}, period=0.05)
    frame = aligned.frame
    assert list(frame.columns) == ["run_id", "Task", "time_s", "Meter.power_W", "Host.cpu_percent"]
    of_run = frame[frame["run_id"] == "r_2"].reset_index(drop=True)
    assert of_run["time_s"].tolist() == pytest.approx([place * 0.05 for place in range(601)])
    power = results.samples("Meter", runs=["r_2"])
    host = results.samples("Host", runs=["r_2"]).set_index("time_s")["cpu_percent"]
    for place in range(0, 601, 40):
        at = place * 0.05
        expected = independent_mean(power["time_s"], power["power_W"], at, 0.05)
        assert of_run["Meter.power_W"][place] == pytest.approx(expected, rel=1e-9)
    # The slow one by pandas' own interpolation over the times of both, where no bin of 0.05 s has a sample.
    grid = of_run["time_s"].to_numpy()
    joined = host.reindex(sorted({*host.index, *grid})).interpolate("index")
    hole = (grid > 14.05) & (grid < 15.95)
    is_line = np.array([np.isnan(independent_mean(host.index, host, at, 0.05)) for at in grid])
    made = of_run["Host.cpu_percent"].to_numpy()
    assert np.isnan(made[hole]).all()
    chosen = is_line & ~hole & (np.abs(grid - 15) > 1.2)
    assert chosen.sum() > 200
    assert made[chosen] == pytest.approx(joined.loc[grid[chosen]].to_numpy(), rel=1e-6)


def test_it_says_what_was_made_up_and_how_far_clocks_may_be_wrong(results):
    aligned = results.aligned_samples(
        {"Meter": ["power_W"], "Host": ["cpu_percent"]}, period=0.05, treatments={"Task": "Video"}
    )
    power, host = aligned.columns
    assert set(aligned.frame["Task"].astype(str)) == {"Video"}
    assert (power.name, power.unit, power.interpolated, power.missing) == ("Meter.power_W", "W", 0.0, 0.0)
    assert power.period == pytest.approx(1 / RATE)
    assert (power.clock_uncertainty, host.clock_uncertainty) == (None, 0.004)
    assert (host.unit, host.period) == ("%", pytest.approx(0.1))
    assert 45 < host.interpolated < 50
    assert 5 < host.missing < 8


def test_a_meter_s_own_note_of_its_clock_counts_as_well(tmp_path):
    made = make_experiment(tmp_path / "trial", repetitions=1)
    path = write_samples(made, "r_1", "time_s,power_W\n0.0,1.0\n1.0,2.0\n")
    (path.parent / "quality.json").write_text(json.dumps({"samples": {"clock_uncertainty": 0.02}}), encoding="utf-8")
    aligned = load_results(made.root).aligned_samples({"Meter": "power_W"}, period=0.5, resampling=Resampling.LINEAR)
    assert aligned.columns[0].clock_uncertainty == 0.02
    assert aligned.frame["Meter.power_W"].tolist() == [1.0, 1.5, 2.0]
    assert aligned.columns[0].interpolated == pytest.approx(100 / 3)


def test_the_last_value_before_a_time_and_none_that_is_too_old():
    times, values = np.array([0.0, 1.0, 2.0, 9.0]), np.array([1.0, 2.0, 3.0, 4.0])
    grid = np.array([-0.5, 0.0, 0.5, 2.5, 4.5, 5.5, 9.5])
    made = align_values(times, values, grid, 0.5, Resampling.PREVIOUS)
    assert made.course[[1, 2, 3, 4, 6]].tolist() == [1.0, 1.0, 3.0, 3.0, 4.0]
    assert np.isnan(made.course[[0, 5]]).all()


@pytest.mark.parametrize("period", [0.0, -1.0, float("nan")])
def test_a_period_that_is_none_is_refused(results, period):
    with pytest.raises(AnalysisError, match="not a period of a grid"):
        results.aligned_samples({"Meter": ["power_W"]}, period=period)


@pytest.mark.parametrize("period", [1e-12, 1e-300])
def test_a_grid_that_no_memory_holds_is_refused_with_what_it_would_take(results, period):
    with pytest.raises(AnalysisError, match="times a run") as refused:
        results.aligned_samples({"Meter": ["power_W"]}, period=period)
    assert "Give a longer period" in refused.value.fix


def test_texts_are_not_aligned(tmp_path):
    made = make_experiment(tmp_path / "trial", repetitions=1)
    write_samples(made, "r_1", "time_s,state\n0.0,on\n1.0,off\n")
    with pytest.raises(AnalysisError, match="column 'state' holds no numbers"):
        load_results(made.root).aligned_samples({"Meter": ["state"]}, period=0.5)


def test_a_way_of_resampling_that_is_none_is_refused(results):
    # The text of one is another thing: values would be means, and called the last ones.
    with pytest.raises(AnalysisError, match="resampling is 'previous'") as refused:
        results.aligned_samples({"Meter": "power_W"}, period=0.5, resampling="previous")
    assert "Resampling.PREVIOUS" in refused.value.fix
    with pytest.raises(AnalysisError, match="no columns"):
        results.aligned_samples({}, period=0.5)


@pytest.mark.long
def test_one_name_alone_may_be_given_as_it_is(results):
    told = results.samples("Meter", columns="power_W", runs="r_1")
    pd.testing.assert_frame_equal(told, results.samples("Meter", columns=["power_W"], runs=["r_1", "r_1"]))
    found = results.lazy_samples("Meter", phases="drive", runs="r_1")
    assert found.frame()["time_s"].tolist() == told.loc[told["phase"] == "drive", "time_s"].tolist()
