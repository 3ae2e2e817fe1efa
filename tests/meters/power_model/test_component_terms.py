"""Power by the parts of a computer: cores at their frequencies, network, GPU."""

from __future__ import annotations

import json

import numpy as np
import pytest
from tests.meters.power_model.test_power_model import PHASES, write_run

from robot_runner.core.errors import AnalysisError
from robot_runner.measuring.quality import Column, write_samples
from robot_runner.meters.power_model.linear_power_model import term_value
from robot_runner.meters.power_model.states import Sources, read_states
from robot_runner.plugins import Circumstances, Window
from robot_runner.plugins.profilers import Nvml, PowerModel, PsUtil, RobotState

SOURCES = {"frequency": "LinuxThermal", "network": "Network", "gpu": "Nvml"}
#: Watts for a core that is busy at 600 and at 1500 MHz, for each MB/s, for each percent of the GPU, and at rest.
TRUE = {"constant": 5.0, "frequency:600": 0.4, "frequency:1500": 1.5, "network": 0.8, "gpu": 0.05}


def write_components(folder, *, seed=1, clocks=(600, 1500), cores=2):
    """Write what PsUtil, LinuxThermal, Network, Nvml and Ina219 leave of a run of ten seconds."""
    noise = np.random.default_rng(seed)
    times = np.arange(101) / 10
    busy = noise.uniform(0, 100, (cores, 101))
    at = noise.choice(clocks, (cores, 101))
    rates = noise.uniform(0, 4, 101)
    received = np.concatenate([[0], np.cumsum(rates[1:] * 0.1 * 1e6)]).round()
    gpu = noise.uniform(0, 100, 101)
    write_run(folder, phases=PHASES)

    def write(plugin, columns):
        (folder / plugin).mkdir(parents=True, exist_ok=True)
        write_samples(folder / plugin / "samples.csv", [Column("time_s", times), *columns])

    own = [Column(f"cpu_core{core}_percent", busy[core]) for core in range(cores)]
    write("PsUtil", [Column("cpu_percent", busy.mean(axis=0)), Column("memory_percent", gpu), *own])
    write("LinuxThermal", [Column(f"frequency_cpu{core}_Hz", at[core] * 1e6) for core in range(cores)])
    write("Network", [Column("wlan0_rx_bytes", received), Column("wlan0_tx_bytes", received * 0)])
    write("Nvml", [Column("gpu0_gpu_percent", gpu)])
    watts = []
    for place in range(1, 101):
        # A piece of time is told of by the samples at its end, but for the frequency, which is that at its beginning.
        load = {clock: busy[at[:, place - 1] == clock, place].sum() / 100 for clock in (600, 1500)}
        power = 5.0 + 0.4 * load[600] + 1.5 * load[1500] + 0.8 * rates[place] + 0.05 * gpu[place]
        watts += [(times[place - 1] + 1e-9, power), (times[place] - 1e-9, power)]
    write_run(folder, phases=PHASES, watts=watts)
    write("PsUtil", [Column("cpu_percent", busy.mean(axis=0)), Column("memory_percent", gpu), *own])


@pytest.fixture
def experiment(tmp_path):
    for number in (1, 2):
        write_components(tmp_path / "known" / "runs" / f"r_{number}", seed=number)
    return tmp_path / "known"


def test_each_core_at_its_frequency_the_network_and_the_gpu_have_their_price(experiment):
    model = PowerModel.fit(experiment, ["r_1", "r_2"], phases=None, **SOURCES)
    assert model["coefficients_W"] == pytest.approx(TRUE, abs=1e-4)


def test_a_processor_of_many_frequencies_is_told_of_in_cycles(tmp_path):
    for number in (1, 2):
        write_components(tmp_path / "runs" / f"r_{number}", seed=number, clocks=range(800, 3000, 100))
    model = PowerModel.fit(tmp_path, ["r_1", "r_2"], phases=None, frequency="LinuxThermal")
    assert list(model["coefficients_W"]) == ["constant", "cycles"]


def test_without_these_plugins_the_terms_are_those_of_before(experiment):
    assert list(PowerModel.fit(experiment, ["r_1", "r_2"], phases=None)["coefficients_W"]) == ["constant", "cpu"]


def test_states_tell_of_the_parts(experiment):
    sources = Sources(utilisation="PsUtil", **SOURCES)
    states = read_states(experiment / "runs" / "r_1", Window(0.0, 10.0), sources)
    assert len(states) == 100
    assert {clock for state in states for clock, _ in state.cores} == {600, 1500}
    assert 0 < states[50].network < 4
    assert 0 < states[50].gpu < 100


def test_what_a_term_is_multiplied_by():
    state = RobotState(0.0, 0.1, cores=((1500, 0.5), (600, 1.0), (1500, 0.25)), network=2.0, gpu=40.0)
    found = {term: term_value(term, state) for term in ("frequency:1500", "frequency:600", "cycles", "network", "gpu")}
    assert found == pytest.approx(
        {"frequency:1500": 0.75, "frequency:600": 1.0, "cycles": 1.725, "network": 2.0, "gpu": 40.0}
    )
    assert term_value("cycles", RobotState(0.0, 0.1)) is None


def test_the_check_asks_for_the_plugins_that_a_model_needs(tmp_path, experiment):
    path = tmp_path / "model.json"
    path.write_text(json.dumps(PowerModel.fit(experiment, ["r_1", "r_2"], phases=None, **SOURCES)))
    plugin = PowerModel(model=path)
    missing = [each.problem for each in plugin.check(Circumstances(plugins=(plugin, PsUtil(), Nvml())))]
    assert missing == [
        "the model reads the samples of 'LinuxThermal', which is not among the plugins",
        "the model reads the samples of 'Network', which is not among the plugins",
    ]


def test_a_plugin_that_did_not_sample_what_is_asked_for_is_told(experiment):
    (experiment / "runs" / "r_1" / "Nvml" / "samples.csv").write_text("time_s,power_W\n0.0,1.0\n")
    with pytest.raises(AnalysisError, match="no column like"):
        PowerModel.fit(experiment, ["r_1"], phases=None, gpu="Nvml")


def test_cores_that_were_sampled_elsewhere_are_refused(experiment):
    write_samples(
        experiment / "runs" / "r_1" / "LinuxThermal" / "samples.csv",
        [Column("time_s", [0.0, 10.0]), *(Column(f"frequency_cpu{core}_Hz", [1e9, 1e9]) for core in range(8))],
    )
    with pytest.raises(AnalysisError, match="the frequencies of 8 cores, and 2 cores were sampled"):
        PowerModel.fit(experiment, ["r_1"], phases=None, frequency="LinuxThermal")
