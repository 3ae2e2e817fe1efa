from __future__ import annotations

import csv
import json

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.meters.rehearsed import problems

from robot_runner.core.errors import AnalysisError, PluginError
from robot_runner.core.events.measure import Origin
from robot_runner.meters.power_model.linear_power_model import LinearModel, read_model
from robot_runner.meters.power_model.states import Sources, read_states
from robot_runner.plugins import Circumstances, Window
from robot_runner.plugins.profilers import Ina219, PowerModel, PsUtil, RobotState
from robot_runner.plugins.systems import BasicTurtlebot3
from robot_runner.testing import FakeClock, ProfilerContract, make_context, rehearse

STEADY = {"constant": 8.0}
SOURCES = Sources(utilisation="PsUtil", phases="BasicTurtlebot3")


class TestPowerModelOfASteadyRobot(ProfilerContract):
    def make_plugin(self) -> PowerModel:
        return PowerModel(coefficients=STEADY)


def write_run(folder, *, cpu=((0.0, 10.0), (5.0, 10.0), (10.0, 50.0)), phases=(), watts=(), coverage=100.0):
    """Write what other plugins leave in the folder of a run of ten seconds."""

    def write(plugin, name, heading, rows):
        (folder / plugin).mkdir(parents=True, exist_ok=True)
        with (folder / plugin / name).open("w", newline="") as file:
            csv.writer(file).writerows([heading, *rows])

    write("PsUtil", "samples.csv", ("time_s", "cpu_percent", "memory_percent"), [(t, c, 25.0) for t, c in cpu])
    rows = [(number, *phase, 0, 0, 0) for number, phase in enumerate(phases, start=1)]
    heading = ("number", "phase", "task", "start_s", "end_s", "x_m", "y_m", "heading_rad")
    write("BasicTurtlebot3", "phases.csv", heading, rows)
    if watts:
        write("Ina219", "samples.csv", ("time_s", "power_W"), watts)
        facts = {"window": {"start": 0.0, "end": 10.0}, "samples": {"coverage": coverage}, "is_simulated": False}
        (folder / "Ina219" / "quality.json").write_text(json.dumps(facts))


PHASES = (("sleep", "", 0.0, 2.0), ("forward", "", 2.0, 4.0), ("sleep", "", 4.0, 6.0), ("task", "video", 6.0, 10.0))


@pytest.fixture
def estimate(tmp_path):
    def execute(*, seconds=10.0, run=None, **settings):
        clock, plugin = FakeClock(), PowerModel(**settings)
        context = make_context(tmp_path, plugin, robot=None, clock=clock)
        write_run(context.run_path, **{"phases": PHASES, **(run or {})})
        rehearse(context, plugin, mission=lambda: clock.sleep(seconds))
        return context

    return execute


def test_each_term_counts_for_as_long_as_it_holds(estimate):
    coefficients = {"constant": 7.0, "has_moved": 0.5, "motion:forward": 2.0, "task:video": 1.0, "cpu": 0.01}
    context = estimate(coefficients=coefficients)
    expected = 7.0 * 10 + 0.5 * 8 + 2.0 * 2 + 1.0 * 4 + 0.01 * (10.0 * 5 + 50.0 * 5)
    assert context.measures["Energy"] == pytest.approx(expected)
    assert context.measures["MeanPower"] == pytest.approx(expected / 10)
    assert problems(context) == []
    assert {each.origin for each in context.broker.measures.values()} == {Origin.ESTIMATED}


def test_a_function_may_stand_for_the_model(estimate):
    context = estimate(function=lambda state: 10.0 if state.phase == "forward" else 5.0 + 0.1 * state.cpu)
    assert context.measures["Energy"] == pytest.approx(10.0 * 2 + 5.0 * 8 + 0.1 * (10.0 * 3 + 50.0 * 5))


def test_what_was_estimated_is_kept_piece_by_piece_with_the_model(estimate):
    context = estimate(coefficients={"constant": 7.0, "task:video": 1.0})
    with (context.raw_data_folder / "estimates.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert rows[-1] == {"start_s": "6.000000", "end_s": "10.000000", "power_W": "8.0000"}
    facts = json.loads((context.raw_data_folder / "quality.json").read_text())
    assert (facts["coverage_percent"], facts["window"]) == (100.0, {"start": 0.0, "end": 10.0})
    assert read_model(context.raw_data_folder / "model.json").coefficients == {"constant": 7.0, "task:video": 1.0}


def test_samples_that_are_not_needed_are_not_read(tmp_path):
    clock, plugin = FakeClock(), PowerModel(coefficients=STEADY)
    context = make_context(tmp_path, plugin, robot=None, clock=clock)
    rehearse(context, plugin, mission=lambda: clock.sleep(3.0))
    assert context.measures["Energy"] == pytest.approx(24.0)


def test_samples_that_are_missing_cost_the_values_and_not_the_run(tmp_path):
    clock, plugin = FakeClock(), PowerModel(coefficients={"cpu": 0.1})
    context = make_context(tmp_path, plugin, robot=None, clock=clock)
    rehearse(context, plugin, mission=lambda: clock.sleep(3.0))
    assert set(context.measures.values()) == {None}
    assert "samples.csv: there is no such file" in problems(context)[0]


def test_utilisation_that_covers_too_little_yields_no_value(estimate):
    context = estimate(coefficients={"cpu": 0.1}, run={"cpu": ((0.0, 10.0), (5.0, 10.0))})
    assert context.measures["Energy"] is None
    assert "nothing was estimated: samples cover 50.0 % of the measured window" in problems(context)


@pytest.mark.parametrize(
    ("function", "said"),
    [
        (lambda state: 1 / 0, "the function raised ZeroDivisionError"),
        (lambda state: "many", "the function returned 'many'"),
        (lambda state: float("inf"), "the function returned inf"),
    ],
)
def test_a_function_that_is_wrong_costs_the_values_and_not_the_run(estimate, function, said):
    context = estimate(function=function)
    assert set(context.measures.values()) == {None}
    assert said in problems(context)[0]


def test_a_task_and_a_load_that_the_model_has_never_met_are_warned_of(estimate, tmp_path):
    for name in ("r_1", "r_2"):
        write_run(
            tmp_path / "fitted" / "runs" / name,
            cpu=[(t / 2, 10.0 + t % 3) for t in range(21)],
            phases=(("sleep", "", 0.0, 5.0), ("task", "network", 5.0, 10.0)),
            watts=[(t / 10, 8.0 if t <= 50 else 9.0) for t in range(101)],
        )
    document = PowerModel.fit(tmp_path / "fitted", ["r_1", "r_2"])
    path = tmp_path / "model.json"
    path.write_text(json.dumps(document))
    said = " ".join(problems(estimate(model=path)))
    assert "without the task 'video'" in said
    assert "cpu was 50 to 50 % for a time, and the power model was fitted on 10 to 12 %" in said


@pytest.mark.parametrize("is_first", [True, False])
def test_an_estimate_from_doubtful_samples_is_doubtful(tmp_path, is_first):
    class Load(PsUtil):
        def populate_run_data(self, context):
            context.doubt("other processes were busy", measures=["CPU"])

    clock, model, load = FakeClock(), PowerModel(coefficients={"cpu": 0.1}), Load(name="PsUtil", host="localhost")
    plugins = [model, load] if is_first else [load, model]
    context = make_context(tmp_path, *plugins, robot=None, clock=clock)
    rehearse(context, *plugins, mission=lambda: clock.sleep(1.0))
    findings = [fields for kind, fields in context.broker.records if kind == "finding"]
    (busy,) = (fields for fields in findings if fields["problem"] == "other processes were busy")
    assert {*busy["measures"]} == {"CPU", "Energy", "MeanPower"}


def test_a_run_that_was_never_measured_publishes_no_values(tmp_path):
    plugin = PowerModel(coefficients=STEADY)
    context = make_context(tmp_path, plugin, robot=None)
    plugin.populate_run_data(context)
    assert set(context.measures.values()) == {None}


@pytest.mark.parametrize(
    ("settings", "problem"),
    [
        ({}, "none of model, coefficients and function are given"),
        ({"coefficients": STEADY, "function": lambda state: 1.0}, "2 of model, coefficients and function are given"),
        ({"coefficients": {"cpus": 1.0}}, "no term 'cpus'"),
        ({"coefficients": {"motion:": 1.0}}, "no term 'motion:'"),
        ({"coefficients": {"cpu": "much"}}, "the coefficient of 'cpu' is 'much'"),
    ],
)
def test_what_cannot_be_is_refused(settings, problem):
    with pytest.raises(PluginError, match=problem):
        PowerModel(**settings)


def test_the_check_asks_for_the_plugins_whose_samples_it_reads():
    plugins = (plugin := PowerModel(coefficients={"cpu": 0.1, "motion:forward": 2.0}), PsUtil(name="Psutil"))
    findings = list(plugin.check(Circumstances(plugins=plugins)))
    assert [finding.problem for finding in findings] == [
        "the model reads the samples of 'PsUtil', which is not among the plugins",
        "the model reads the samples of 'BasicTurtlebot3', which is not among the plugins",
    ]
    fixes = ["Add it to the plugins. Did you mean 'Psutil'?", "Add it to the plugins."]
    assert [finding.fix for finding in findings] == fixes
    assert list(PowerModel(coefficients=STEADY).check(Circumstances(plugins=plugins))) == []


@pytest.mark.parametrize("content", ["", "[]", '{"format": "another"}', '{"format": "robot-runner power model 1"}'])
def test_a_file_that_holds_no_model_is_refused_by_the_check(tmp_path, content):
    path = tmp_path / "model.json"
    path.write_text(content)
    (finding,) = PowerModel(model=path).check(Circumstances())
    assert "the file holds no power model" in finding.problem
    assert "fit-power-model" in finding.fix


def test_the_file_of_its_model_is_kept_with_the_experiment(tmp_path):
    path = tmp_path / "power_model.json"
    assert [each.path for each in PowerModel(model=path).input_files()] == [path]
    assert list(PowerModel(coefficients=STEADY).input_files()) == []


def test_a_model_file_that_is_not_there_is_told(tmp_path):
    (finding,) = PowerModel(model=tmp_path / "none.json").check(Circumstances())
    assert "the file cannot be read" in finding.problem


def test_states_are_cut_where_a_sample_or_a_phase_ends(tmp_path):
    write_run(tmp_path, phases=PHASES)
    states = read_states(tmp_path, Window(1.0, 7.0), SOURCES)
    assert [(state.start, state.end) for state in states] == [(1, 2), (2, 4), (4, 5), (5, 6), (6, 7)]
    assert [state.cpu for state in states] == [10.0, 10.0, 10.0, 50.0, 50.0]
    assert [state.motion for state in states] == ["", "forward", "", "", ""]
    assert [state.task for state in states] == ["", "", "", "", "video"]
    assert [state.has_moved for state in states] == [False, True, True, True, True]


@given(
    terms=st.dictionaries(
        st.sampled_from(["constant", "cpu", "has_moved", "motion:forward", "task:video"]), st.floats(-10, 10)
    ),
    cpu=st.floats(0, 100),
)
def test_a_model_survives_its_file(terms, cpu):
    model = LinearModel(terms, {"cpu": (0.0, 100.0)})
    state = RobotState(0.0, 1.0, cpu=cpu, phase="forward", task="video", has_moved=True)
    assert LinearModel.of_json(json.loads(json.dumps(model.as_json()))).power(state) == model.power(state)


TRUE = {"constant": 7.0, "cpu": 0.02, "has_moved": 0.5, "motion:forward": 2.0, "task:video": 1.0}


class TestFitting:
    """Least squares on runs whose power is known."""

    @pytest.fixture
    def experiment(self, tmp_path):
        def write(*, count=3, noise=0.0, **run):
            for number in range(1, count + 1):
                cpu = [(t / 10, 10.0 + (7 * t * number) % 40) for t in range(101)]
                folder = tmp_path / "known" / "runs" / f"r_{number}"
                write_run(folder, cpu=cpu, phases=PHASES)
                states = read_states(folder, Window(0.0, 10.0), SOURCES)
                model = LinearModel(TRUE)
                watts = []
                for place, state in enumerate(states):
                    power = model.power(state) + noise * (-1) ** place
                    watts += [(state.start + 1e-9, power), (state.end - 1e-9, power)]
                write_run(folder, **{"cpu": cpu, "phases": PHASES, "watts": watts, **run})
            return tmp_path / "known"

        return write

    def test_the_true_coefficients_are_found(self, experiment):
        model = PowerModel.fit(experiment(), ["r_1", "r_2", "r_3"])
        assert model["coefficients_W"] == pytest.approx(TRUE, abs=1e-6)
        assert model["fit"]["r_squared"] == pytest.approx(1.0)
        assert model["fit"]["residual_W"] == pytest.approx(0.0, abs=1e-6)
        assert model["ranges_percent"] == {"cpu": [10.0, 49.0]}
        assert set(model["fit"]["energy_errors"]) == {"r_1", "r_2", "r_3"}

    def test_noise_shows_in_the_residual(self, experiment):
        model = PowerModel.fit(experiment(noise=0.3), ["r_1", "r_2", "r_3"])
        assert model["fit"]["residual_W"] == pytest.approx(0.3, rel=0.05)
        assert model["fit"]["r_squared"] < 0.97
        assert all(error > 0 for error in model["fit"]["standard_errors"].values())

    def test_a_run_that_is_named_twice_counts_once(self, experiment):
        model = PowerModel.fit(experiment(noise=0.3), ["r_1", "r_1", "r_2"])
        assert model["fit"]["runs"] == ["r_1", "r_2"]

    def test_power_that_is_told_from_within_a_piece_on_is_no_less(self, experiment):
        folder = experiment(count=1)
        write_run(
            folder / "runs" / "r_1", watts=[(0.3, 8.0), (10.0, 8.0)], cpu=[(0.0, 10.0), (5.0, 10.0), (10.0, 50.0)]
        )
        model = PowerModel.fit(folder, ["r_1"], phases=None, terms=["constant"])
        assert model["coefficients_W"] == {"constant": pytest.approx(8.0)}

    def test_one_run_is_held_out_from_nothing_and_still_has_errors(self, experiment):
        model = PowerModel.fit(experiment(count=1, noise=0.3), ["r_1"])
        assert model["fit"]["energy_errors"] == {}
        assert set(model["fit"]["standard_errors"]) == set(model["fit"]["intervals"]) == set(TRUE)
        assert all(error > 0 for error in model["fit"]["standard_errors"].values())

    def test_a_report_survives_its_file(self, experiment):
        document = PowerModel.fit(experiment(noise=0.3), ["r_1", "r_2"])
        assert LinearModel.of_json(json.loads(json.dumps(document))).as_json() == json.loads(json.dumps(document))

    def test_a_file_of_an_earlier_version_can_be_read(self, experiment):
        document = PowerModel.fit(experiment(), ["r_1", "r_2"])
        for name in ("intervals", "correlation_lag", "linearity"):
            del document["fit"][name]
        assert LinearModel.of_json(document).report.linearity is None

    def test_a_model_that_is_not_linear_is_doubted_wherever_it_is_used(self, experiment):
        document = PowerModel.fit(experiment(noise=0.3), ["r_1", "r_2"])
        document["fit"]["linearity"] = {"p_value": 0.0001, "curvature_W": 0.7, "explained_W": 1.2}
        (doubt, *_) = LinearModel.of_json(document).doubts([])
        assert "bending the model changes it by 0.70 W" in doubt

    def test_terms_can_be_chosen(self, experiment):
        model = PowerModel.fit(experiment(), ["r_1"], terms=["constant", "motion:forward"])
        assert list(model["coefficients_W"]) == ["constant", "motion:forward"]

    def test_terms_that_the_data_do_not_tell_apart_are_refused_by_name(self, experiment):
        cpu = [(t / 10, 20.0) for t in range(101)]
        folder = experiment(cpu=cpu)
        with pytest.raises(AnalysisError, match="do not tell these terms apart: 'constant', 'cpu'") as refusal:
            PowerModel.fit(folder, ["r_1", "r_2"])
        assert "Leave one of them out" in refusal.value.fix

    def test_a_term_that_never_holds_is_refused(self, experiment):
        with pytest.raises(AnalysisError, match="the term 'task:network' is 0 all the time"):
            PowerModel.fit(experiment(), ["r_1"], terms=["constant", "task:network"])

    def test_too_few_pieces_are_refused(self, experiment):
        folder = experiment(count=1)
        write_run(folder / "runs" / "r_1", watts=[(0.0, 8.0), (10.0, 8.0)], phases=())
        with pytest.raises(AnalysisError, match="2 pieces of time for 3 terms"):
            PowerModel.fit(folder, ["r_1"], terms=["constant", "cpu", "memory"])

    def test_a_run_without_its_samples_is_left_out_and_told(self, experiment):
        folder = experiment()
        (folder / "runs" / "r_2" / "PsUtil" / "samples.csv").unlink()
        write_run(folder / "runs" / "r_3", phases=PHASES, watts=[(0.0, 8.0), (10.0, 8.0)], coverage=60.0)
        model = PowerModel.fit(folder, ["r_1", "r_2", "r_3"])
        assert model["fit"]["runs"] == ["r_1"]
        assert model["fit"]["left_out"] == {
            "r_2": "there is no such file",
            "r_3": "the power samples cover 60 % of the measured window",
        }

    def test_a_run_in_which_nothing_of_the_terms_was_sampled_is_left_out_and_told(self, experiment):
        folder = experiment()
        (folder / "runs" / "r_2" / "PsUtil" / "samples.csv").write_text("time_s,cpu_percent,memory_percent\n")
        model = PowerModel.fit(folder, ["r_1", "r_2", "r_3"])
        assert model["coefficients_W"] == pytest.approx(TRUE, abs=1e-6)
        assert model["fit"]["runs"] == list(model["fit"]["energy_errors"]) == ["r_1", "r_3"]
        assert model["fit"]["left_out"] == {"r_2": "nothing was sampled that explains power"}

    def test_an_experiment_without_a_meter_is_refused(self, experiment):
        with pytest.raises(AnalysisError, match="no run can be used: there is no such file"):
            PowerModel.fit(experiment(), ["r_1", "r_2"], power="Meter")
        with pytest.raises(AnalysisError, match="no run is done"):
            PowerModel.fit(experiment(), [])

    def test_a_term_that_cannot_be_is_refused_with_the_nearest(self, experiment):
        with pytest.raises(PluginError, match="'movin'"):
            PowerModel.fit(experiment(), ["r_1"], terms=["movin"])


def short_mission(task):
    return BasicTurtlebot3(task=task, task_factor=None, sleep_s=2.0, drive_s=4.0, task_s=5.0, rotate_s=5.0)


@pytest.fixture(scope="module")
def fitted(tmp_path_factory):
    """A model that was fitted on two simulated runs of each task."""
    pytest.importorskip("mujoco")
    experiment = tmp_path_factory.mktemp("experiment")
    (experiment / "runs").mkdir()
    run_ids = []
    for number, task in enumerate(("Computation", "Video", "Network") * 2):
        plugins = (short_mission(task), Ina219(), PsUtil())
        context = make_context(tmp_path_factory.mktemp("run"), *plugins, run_seed=number)
        rehearse(context, *plugins)
        context.resources.close()
        run_ids.append(f"r_{number + 1}")
        context.run_path.rename(experiment / "runs" / run_ids[-1])
    path = experiment / "model.json"
    path.write_text(json.dumps(PowerModel.fit(experiment, run_ids)))
    return path


@pytest.mark.long
@pytest.mark.parametrize("task", ["Computation", "Video", "Network"])
def test_the_energy_of_other_runs_is_estimated_within_a_few_percent(fitted, tmp_path, task):
    model = PowerModel(model=fitted)
    plugins = (short_mission(task), Ina219(), PsUtil(), model)
    assert list(model.check(Circumstances(robot="simulated", plugins=plugins))) == []
    context = make_context(tmp_path, *plugins, run_seed=1234)
    measures = rehearse(context, *plugins)
    context.resources.close()
    assert measures["PowerModel.Energy"] == pytest.approx(measures["Ina219.Energy"], rel=0.04)
    origins = {name: published.origin for name, published in context.broker.measures.items()}
    assert origins["PowerModel.Energy"] is Origin.ESTIMATED
    assert origins["Ina219.Energy"] is Origin.SIMULATED


@pytest.mark.long
def test_the_model_of_the_simulated_robot_finds_the_levels_of_its_power(fitted):
    model = read_model(fitted)
    assert model.report.is_simulated
    assert model.report.r_squared > 0.85
    assert model.coefficients["motion:forward"] == pytest.approx(2.3, abs=0.3)
    assert model.coefficients["task:video"] > model.coefficients["task:network"]
