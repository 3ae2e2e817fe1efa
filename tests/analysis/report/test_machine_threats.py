"""What differed on a computer between runs is a threat, with the figures that its files had."""

from __future__ import annotations

import json
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest
from pandas import DataFrame
from tests.analysis.made_experiment import write_samples

from robot_runner.analysis.report.machine_threats import _goes_with
from robot_runner.analysis.report.material import Material
from robot_runner.analysis.report.threats_section import threats_of
from robot_runner.analysis.results import load_results
from robot_runner.analysis.statistics.experiment_statistics import analyse
from robot_runner.core.storage.journal import Journal
from robot_runner.core.storage.layout import ExperimentFolder

if TYPE_CHECKING:
    from collections.abc import Callable

WATCH = {"name": "machine", "class": "robot_runner.meters.machine.machine_watch:MachineWatch"}


@pytest.fixture
def threats(two_tasks: Callable[..., Any]) -> Callable[..., dict[str, str]]:
    """Return the threats of an experiment whose runs have these facts, from the first run on."""

    def found(*facts: object) -> dict[str, str]:
        folder = two_tasks(manifest={"plugins": [WATCH]})
        for number, fact in enumerate(facts, start=1):
            text = fact if isinstance(fact, str) else json.dumps({"host": "localhost", **fact})  # type: ignore[dict-item]
            write_samples(ExperimentFolder(folder.root), f"r_{number}", text, plugin="machine", name="localhost.json")
        results = load_results(folder.root)
        return {threat.title: threat.text for threat in threats_of(Material(results, analyse(results)))}

    return found


def facts(
    governor: str = "performance", *, turbo: bool | None = False, hertz: float = 2e9, degrees: float = 50.0
) -> dict[str, Any]:
    spread = {"least": hertz, "mean": hertz, "greatest": hertz}
    heat = {"least": degrees, "mean": degrees, "greatest": degrees}
    return {"governors": [governor], "turbo": turbo, "frequency_hz": spread, "temperature_degc": heat}


def about_machines(found: dict[str, str]) -> dict[str, str]:
    return {title: text for title, text in found.items() if "this machine" in title}


def test_a_machine_that_was_the_same_in_all_runs_is_no_threat(threats: Callable[..., dict[str, str]]) -> None:
    assert about_machines(threats(facts(), facts())) == {}


def test_runs_that_the_table_had_as_done_before_the_first_execution_are_told(two_tasks: Callable[..., Any]) -> None:
    folder = two_tasks(manifest={"design": {"source": "run_table.csv", "done_before": ["r_1", "r_2", "gone"]}})
    began = '{"kind":"attempt_started","at":"2026-01-31T12:00:00.000Z","run":"r_2","attempt":1}\n'
    ExperimentFolder(folder.root).journal.write_text(began)
    results = load_results(folder.root)
    found = {threat.title: threat.text for threat in threats_of(Material(results, analyse(results)))}
    assert found["Runs were executed elsewhere"] == (
        "The run table had 1 run as done before the experiment began here (r_1): where and by what is not known, and "
        "their values count as all others do."
    )


HARDWARE = "Runs were executed on machines that differ"


@pytest.fixture
def at_workers(two_tasks: Callable[..., Any]) -> Callable[..., dict[str, str]]:
    """Return the threats of an experiment whose runs were executed at these workers, "" for this machine."""

    def found(*places: str, origin: str = "measured") -> dict[str, str]:
        folder = two_tasks(manifest={"host": {"processor": "Ours", "cores": 8}}, origin=origin)
        told: set[str] = set()
        with Journal(ExperimentFolder(folder.root).journal) as journal:
            for number, place in enumerate(places, start=1):
                where = {"place": place, "slot": 0} if place else {}
                journal.append("attempt_started", run=f"r_{number}", attempt=2, **where)
                if place and place not in told:
                    told.add(place)
                    host = {"processor": place.partition("-")[0], "cores": 4, "memory_bytes": number}
                    journal.append("machine", run=f"r_{number}", attempt=2, place=place, host=host)
        results = load_results(folder.root)
        return {threat.title: threat.text for threat in threats_of(Material(results, analyse(results)))}

    return found


def test_hardware_that_differs_between_measured_runs_is_told_with_how_many_were_on_which(
    at_workers: Callable[..., dict[str, str]],
) -> None:
    found = at_workers(*("Pi-1", "Pi-2", "Nuc", "Pi-1", "") * 2)[HARDWARE]
    assert found.startswith("Pi, 4 cores (6 runs), Nuc, 4 cores (2 runs), Ours, 8 cores (2 runs).")
    assert "no factor or block tells it: look at Energy" in found


def test_hardware_of_one_kind_and_of_one_machine_is_no_threat(at_workers: Callable[..., dict[str, str]]) -> None:
    assert HARDWARE not in at_workers(*("Pi-1", "Pi-2") * 5)
    assert HARDWARE not in at_workers(*("",) * 10)


def test_hardware_that_goes_with_a_factor_is_told_so(at_workers: Callable[..., dict[str, str]]) -> None:
    assert "It goes with Task: " in at_workers(*("Pi",) * 5, *("Nuc",) * 5)[HARDWARE]


@pytest.mark.parametrize(("loads", "told"), [(["1", "2", "3", "4"], ""), (["1", "2", "1", "2"], "Load")])
def test_hardware_does_not_go_with_a_factor_that_has_another_value_in_each_run(loads: list[str], told: str) -> None:
    design = SimpleNamespace(block=None, factors=("Load",))
    done = DataFrame({"run_id": ["r_1", "r_2", "r_3", "r_4"], "Load": loads})
    material: Any = SimpleNamespace(done=done, statistics=SimpleNamespace(design=design))
    assert _goes_with(material, {"Pi": ["r_1", "r_3"], "Nuc": ["r_2", "r_4"]}) == told


def test_hardware_does_not_matter_to_simulated_values(at_workers: Callable[..., dict[str, str]]) -> None:
    found = at_workers(*("Pi", "Nuc") * 5, origin="simulated")
    assert found[HARDWARE].endswith("No measure comes from a sensor there.")


def test_a_frequency_that_was_left_to_chance_is_said_once(threats: Callable[..., dict[str, str]]) -> None:
    found = about_machines(threats(facts("powersave", turbo=True), facts("powersave", turbo=True)))
    assert list(found) == ["The frequency of this machine was not fixed"]
    assert "the governor powersave, turbo on" in found["The frequency of this machine was not fixed"]


def test_settings_that_changed_between_runs_are_told_with_their_runs(threats: Callable[..., dict[str, str]]) -> None:
    found = about_machines(threats(facts("powersave"), facts(), facts()))
    text = found["The processor of this machine was set up differently"]
    assert text == "the governor powersave, turbo off in r_1; the governor performance, turbo off in r_2, r_3."


def test_frequency_and_temperature_are_compared(threats: Callable[..., dict[str, str]]) -> None:
    found = about_machines(threats(facts(hertz=1.2e9, degrees=45.0), facts(hertz=3.4e9, degrees=71.0)))
    assert (
        "1.20 GHz on average in r_1, and at 3.40 GHz in r_2"
        in found["The frequency of this machine differs between runs"]
    )
    assert "45 °C in r_1, and at 71 °C in r_2" in found["The temperature of this machine differs between runs"]


@pytest.mark.parametrize(
    "text", ["", "{", "[1]", '{"host": 3, "governors": 7, "frequency_hz": [1], "temperature_degc": {"mean": "x"}}']
)
def test_a_file_that_is_no_such_note_is_passed_over(threats: Callable[..., dict[str, str]], text: str) -> None:
    assert about_machines(threats(text, text)) == {}
