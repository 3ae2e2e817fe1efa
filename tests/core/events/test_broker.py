from __future__ import annotations

import pytest

from robot_runner.core.errors import MeasureError
from robot_runner.core.events.measure import Measure, Origin
from robot_runner.testing import RecordingBroker


@pytest.fixture
def broker() -> RecordingBroker:
    return RecordingBroker({"Ina219": [Measure("Energy", "J")]})


def test_a_measure_is_taken_and_reported_at_once(broker: RecordingBroker) -> None:
    broker.publish("Ina219", "Energy", 877.5, Origin.SIMULATED)
    assert broker.measures["Energy"].value == 877.5
    assert broker.measures["Energy"].unit == "J"
    assert broker.records == [("measure", {"name": "Energy", "value": 877.5, "owner": "Ina219", "origin": "simulated"})]


def test_a_later_value_replaces_an_earlier(broker: RecordingBroker) -> None:
    broker.publish("Ina219", "Energy", 1, Origin.MEASURED)
    broker.publish("config", "Energy", 2, Origin.MEASURED)
    assert broker.measures["Energy"].value == 2
    assert broker.measures["Energy"].owner == "config"


def test_a_missing_value_is_none(broker: RecordingBroker) -> None:
    broker.publish("Ina219", "Energy", None, Origin.MEASURED)
    assert broker.measures["Energy"].value is None


class _NoRepr:
    def __repr__(self) -> str:
        raise RuntimeError("no text")


@pytest.mark.parametrize(
    ("name", "value", "kept"),
    [
        ("Enery", 1.0, "1.0"),
        ("Energy", float("nan"), "nan"),
        ("Energy", [1], "[1]"),
        ("Energy", "7.5", "'7.5'"),
        ("Energy", ["open-sesame"], "['REDACTED']"),
        ("Energy", _NoRepr(), "a _NoRepr"),
        ("Energy", 10**5000, "a int"),
    ],
    ids=["undeclared", "nan", "list", "text", "secret of the environment", "no repr", "too many digits"],
)
def test_what_is_refused_is_reported_so_that_it_is_kept(
    broker: RecordingBroker, monkeypatch: pytest.MonkeyPatch, name: str, value: object, kept: str
) -> None:
    monkeypatch.setenv("LAB_TOKEN", "open-sesame")
    with pytest.raises(MeasureError):
        broker.publish("Ina219", name, value, Origin.MEASURED)
    assert broker.records == [("refused", {"owner": "Ina219", "name": name, "value": kept})]
    assert broker.measures == {}


@pytest.mark.parametrize("value", [float("nan"), [1], "7.5"])
def test_what_is_refused_is_told_without_its_run_so_that_runs_that_fail_alike_share_a_line(
    broker: RecordingBroker, value: object
) -> None:
    with pytest.raises(MeasureError) as refused:
        broker.publish("Ina219", "Energy", value, Origin.MEASURED)
    assert str(refused.value).startswith("Ina219: measure 'Energy' got ")


def test_a_text_is_refused_where_the_measure_has_a_unit_and_taken_where_it_has_none() -> None:
    broker = RecordingBroker({"Plug": [Measure("Power", "W"), Measure("Firmware")]})
    with pytest.raises(MeasureError, match=r"measure 'Power' got the text '12\.5', and its unit is W") as refused:
        broker.publish("Plug", "Power", "12.5", Origin.MEASURED)  # as many an API writes its numbers
    assert refused.value.fix == "Give a number, or None where there is no value; a measure that is a text has no unit."
    with pytest.raises(MeasureError, match="the text 'OL', and its unit is W"):
        broker.publish("config", "Power", "OL", Origin.MEASURED)
    broker.publish("Plug", "Power", "", Origin.MEASURED)
    broker.publish("Plug", "Firmware", "1.2", Origin.MEASURED)
    assert {name: each.value for name, each in broker.measures.items()} == {"Power": None, "Firmware": "1.2"}


def test_key_value_pairs_are_gathered_by_plugin(broker: RecordingBroker) -> None:
    broker.share("robot", {"phase": "forward"})
    broker.share("robot", {"phase": "rotate", "speed": 0.2})
    assert broker.shared == {"robot": {"phase": "rotate", "speed": 0.2}}


def test_a_warning_names_run_and_owner(broker: RecordingBroker) -> None:
    broker.warn("Ina219", "12 frames were lost", "Look at the cable.")
    (finding,) = broker.findings
    assert finding.where == "r_1, Ina219"
    assert not finding.is_error


def test_an_origin_that_is_none_is_refused_before_the_value_is_taken(broker: RecordingBroker) -> None:
    with pytest.raises(MeasureError, match="'simulated' is not an origin") as caught:
        broker.publish("Ina219", "Energy", 1.0, "simulated")  # type: ignore[arg-type]
    assert caught.value.fix == "Did you mean 'Origin.SIMULATED'?"
    assert broker.measures == {}


def test_one_measure_is_doubted_by_its_name_alone(broker: RecordingBroker) -> None:
    broker.doubt("Ina219", "the cable was loose", "", "Energy")
    assert broker.records[0][1]["measures"] == ["Energy"]


def test_a_doubt_about_one_measure_is_about_its_phases_and_not_the_reverse() -> None:
    names = ("CPU_nav", "CPU_nav.task", "CPU_nav_2.task", "Memory_nav.task")
    measures = {"PsUtil": [Measure(name, "%") for name in names], "Other": [Measure("CPU_nav.task", "%")]}
    broker = RecordingBroker(measures)
    broker.doubt("PsUtil", "a child ended", "", ["CPU_nav"])
    broker.doubt("PsUtil", "the phase was short", "", ["CPU_nav.task"])
    doubted = [fields["measures"] for _, fields in broker.records]
    assert doubted == [["CPU_nav", "PsUtil.CPU_nav.task"], ["PsUtil.CPU_nav.task"]]


def test_what_is_computed_from_a_doubtful_phase_is_doubtful_in_that_phase() -> None:
    measures = {
        "PsUtil": [Measure(name, "%") for name in ("CPU", "CPU.task", "CPU.drive", "CPU_node.task")],
        "PowerModel": [Measure(name, "J") for name in ("Energy", "Energy.task", "Energy.drive")],
    }
    broker = RecordingBroker(measures)
    broker.derive("PowerModel", "PsUtil", ["CPU", "Memory"])
    broker.doubt("PsUtil", "the phase was short", "", ["CPU.task"])
    broker.doubt("PsUtil", "the phase was short", "", ["CPU_node.task"])
    assert [fields["measures"] for _, fields in broker.records] == [["CPU.task", "Energy.task"], ["CPU_node.task"]]


def test_an_exception_may_be_the_problem_and_none_the_fix(broker: RecordingBroker) -> None:
    broker.doubt("Ina219", ValueError("a frame was torn"), None)  # type: ignore[arg-type] # as callbacks do
    assert (broker.findings[0].problem, broker.findings[0].fix) == ("a frame was torn", "")
    assert (broker.records[0][1]["problem"], broker.records[0][1]["fix"]) == ("a frame was torn", "")


def test_what_is_computed_from_doubtful_measures_is_doubtful() -> None:
    measures = {"PsUtil": [Measure("CPU", "%"), Measure("CPU_node", "%")], "PowerModel": [Measure("Energy", "J")]}
    broker = RecordingBroker(measures)
    broker.derive("PowerModel", "PsUtil", ["CPU", "Memory"])
    broker.doubt("PsUtil", "samples were lost", "")
    broker.doubt("PsUtil", "the node ended early", "", ["CPU_node"])
    broker.doubt("PowerModel", "the load is beyond the fit", "")
    assert [fields["measures"] for _, fields in broker.records] == [
        ["CPU", "CPU_node", "Energy"],
        ["CPU_node"],
        ["Energy"],
    ]
