from __future__ import annotations

import json
import threading

import pytest
from tests.meters.rehearsed import InRealTime

from robot_runner.core.errors import PluginError
from robot_runner.core.events.context import SystemClock
from robot_runner.core.events.measure import Origin
from robot_runner.plugins import Circumstances
from robot_runner.plugins.profilers import CodeCarbon
from robot_runner.testing import ProfilerContract, make_context, rehearse

needs_codecarbon = pytest.mark.skipif(
    any(finding.is_error for finding in CodeCarbon(country="NLD").check(Circumstances())),
    reason="codecarbon is not installed",
)
# Fixed powers, so that energy is known: CodeCarbon itself measures nothing then.
KNOWN = {"force_cpu_power": 100, "force_ram_power": 10, "force_carbon_intensity_g_co2e_kwh": 400.0}
# Whatever CodeCarbon and what it imports warn of is not ours to mend.
quiet = pytest.mark.filterwarnings("ignore")


@quiet
@needs_codecarbon
class TestCodeCarbonOnThisMachine(InRealTime, ProfilerContract):
    robot = None
    is_repeatable = False
    measuring_seconds = 0.1

    def make_plugin(self) -> CodeCarbon:
        return CodeCarbon(country="NLD", interval_s=0.1, options=KNOWN)


@pytest.fixture
def measure(tmp_path):
    def execute(*, seconds=1.0, **settings):
        plugin = CodeCarbon(**{"country": "NLD", "interval_s": 0.1, "options": KNOWN, **settings})
        context = make_context(tmp_path, plugin, robot=None, clock=SystemClock())
        rehearse(context, plugin, mission=lambda: SystemClock().sleep(seconds))
        return context

    return execute


@quiet
@needs_codecarbon
def test_the_memory_of_a_known_power_yields_its_energy(measure):
    context = measure()
    said = json.loads((context.raw_data_folder / "emissions.json").read_text())
    assert 5.0 < context.measures["MemoryEnergy"] < 10.0 * said["duration"] + 1.0
    assert context.measures["CPUEnergy"] > 0
    whole = context.measures["CPUEnergy"] + context.measures["MemoryEnergy"]
    assert context.measures["Energy"] == pytest.approx(whole, rel=0.01)
    assert context.measures["Emissions"] == pytest.approx(context.measures["Energy"] / 3.6e6 * 0.4, rel=0.01)


@quiet
@needs_codecarbon
def test_all_its_values_are_labelled_as_estimated(measure):
    context = measure(seconds=0.2)
    assert {each.origin for each in context.broker.measures.values()} == {Origin.ESTIMATED}
    said = json.loads((context.raw_data_folder / "emissions.json").read_text())
    assert said["country_iso_code"] == "NLD"
    facts = json.loads((context.raw_data_folder / "quality.json").read_text())
    assert facts["hardware"]


@quiet
@needs_codecarbon
def test_a_country_that_it_does_not_know_is_warned_of(measure):
    context = measure(country="XXX", seconds=0.2, options={})
    assert any("does not know the country 'XXX'" in finding.problem for finding in context.broker.findings)


@quiet
@needs_codecarbon
def test_a_tracker_that_swallowed_an_exception_yields_no_value_and_a_warning(measure, monkeypatch):
    import codecarbon

    class Broken(codecarbon.OfflineEmissionsTracker):
        def stop(self):
            return None

    monkeypatch.setattr(codecarbon, "OfflineEmissionsTracker", Broken)
    before = set(threading.enumerate())
    context = measure(seconds=0.1)
    assert set(context.measures.values()) == {None}
    assert [finding.problem for finding in context.broker.findings] == ["CodeCarbon said nothing"]
    for left in set(threading.enumerate()) - before:
        left.join(60.0)
    assert set(threading.enumerate()) <= before


def test_a_machine_without_the_library_is_told_which_extra_brings_it(tmp_path, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    plugin = CodeCarbon(country="NLD")
    (finding,) = plugin.check(Circumstances())
    assert "robot-runner[codecarbon]" in finding.fix


def test_a_run_that_was_never_measured_publishes_no_values(tmp_path):
    plugin = CodeCarbon(country="NLD")
    context = make_context(tmp_path, plugin, robot=None)
    plugin.populate_run_data(context)
    assert set(context.measures.values()) == {None}


@pytest.mark.parametrize("settings", [{"country": "Netherlands"}, {"country": "nld"}, {"interval_s": 0}])
def test_what_cannot_be_is_refused(settings):
    with pytest.raises(PluginError):
        CodeCarbon(**{"country": "NLD", **settings})
