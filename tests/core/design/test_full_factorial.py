"""A conditional factor is inactive where it does not apply, and makes no run twice."""

from __future__ import annotations

import pickle
from copy import deepcopy
from typing import Any

import pytest

from robot_runner.core.design.factor import Factor
from robot_runner.core.design.full_factorial import full_size
from robot_runner.core.design.run_table_model import RunTableModel
from robot_runner.core.errors import DesignError, PluginError
from robot_runner.core.treatments import bind, treatment
from robot_runner.core.words import INACTIVE
from robot_runner.plugins import Profiler

SENSOR = Factor("Sensor", ["camera", "lidar", "sonar"])
RESOLUTION = Factor("Resolution", ["720p", "1080p"], when={"Sensor": "camera"})
CODEC = Factor("Codec", ["h264", "raw"], when={RESOLUTION: ["1080p"]})


def rows(*factors: Factor, **keywords: Any) -> list[tuple[Any, ...]]:
    return [run.combination.treatments for run in RunTableModel(factors, **keywords).plan()]


def test_a_factor_that_does_not_apply_has_one_treatment_and_so_has_what_depends_on_it() -> None:
    expected = [
        ("camera", "720p", INACTIVE),
        ("camera", "1080p", "h264"),
        ("camera", "1080p", "raw"),
        ("lidar", INACTIVE, INACTIVE),
        ("sonar", INACTIVE, INACTIVE),
    ]
    assert rows(SENSOR, RESOLUTION, CODEC) == expected
    assert len(rows(SENSOR, RESOLUTION, CODEC, repetitions=2)) == 10
    assert full_size([SENSOR, RESOLUTION, CODEC, Factor("Task", range(1000))]) == 5000
    assert rows(SENSOR, RESOLUTION, CODEC, exclude_combinations=[{"Codec": "raw"}]) == [*expected[:2], *expected[3:]]


def test_several_conditions_hold_together() -> None:
    rate = Factor("Rate", [1, 2], when={"Sensor": ["camera", "lidar"], "Task": "map"})
    found = rows(SENSOR, Factor("Task", ["map", "drive"]), rate)
    assert [row for row in found if row[2] is not INACTIVE] == [
        (sensor, "map", each) for sensor in ("camera", "lidar") for each in (1, 2)
    ]
    assert len(found) == 8


def test_what_is_inactive_is_the_same_in_every_process_and_is_written_in_a_word() -> None:
    assert pickle.loads(pickle.dumps(INACTIVE)) is INACTIVE  # noqa: S301 - as runs of other processes are sent
    assert deepcopy(INACTIVE) is INACTIVE
    assert RESOLUTION.texts == ("720p", "1080p", "inactive")
    assert RESOLUTION.with_treatments(["720p"]).when == {"Sensor": ("camera",)}


def test_wrong_conditions_are_told_at_once_with_what_is_near() -> None:
    factors = [
        SENSOR,
        Factor("Resolution", ["a"], when={"Sensr": "camera"}),
        Factor("Rate", ["a"], when={"Sensor": "lidr"}),
        Factor("One", ["a"], when={"Other": "a"}),
        Factor("Other", ["a"], when={"One": "a"}),
    ]
    with pytest.raises(DesignError) as caught:
        RunTableModel(factors)
    assert [str(finding) for finding in caught.value.findings] == [
        "factors: 'Resolution' applies when: there is no other factor 'Sensr' → Did you mean 'Sensor'?",
        "factors: 'Rate' applies when: 'lidr' is not a treatment of 'Sensor' → Did you mean 'lidar'?",
        "factors: 'One' applies when: the conditions are circular → Remove one of the conditions.",
        "factors: 'Other' applies when: the conditions are circular → Remove one of the conditions.",
    ]
    with pytest.raises(DesignError, match="names no other factor"):
        Factor("Rate", [1], when="camera")


class Camera(Profiler):
    def __init__(self, resolution: str = "480p", sizes: tuple[str, ...] = (), name: str | None = None) -> None:
        super().__init__(name=name)
        self.resolution = resolution


def test_a_parameter_that_is_bound_to_an_inactive_factor_keeps_its_default() -> None:
    camera = Camera(resolution=treatment("Resolution"))
    bind(camera, {"Resolution": "720p"})
    assert camera.resolution == "720p"
    bind(camera, {"Resolution": INACTIVE})
    assert camera.resolution == "480p"
    with pytest.raises(PluginError, match="does not apply to the run"):
        bind(Camera(sizes=(treatment("Resolution"),)), {"Resolution": INACTIVE})


def test_a_treatment_that_is_written_like_the_inactive_one_is_refused() -> None:
    with pytest.raises(DesignError, match="would both be written 'inactive'"):
        Factor("Resolution", ["inactive", "720p"], when={"Sensor": "camera"})
    assert Factor("State", ["inactive", "active"]).texts == ("inactive", "active")
    assert Factor("Resolution", ["720p", INACTIVE], when={"Sensor": "camera"}).texts == ("720p", "inactive")


def test_treatments_that_compare_element_by_element_may_depend_on_a_factor() -> None:
    numpy = pytest.importorskip("numpy")
    gains = Factor("Gains", [numpy.array([1, 2]), numpy.array([3, 4])], when={"Sensor": "camera"})
    assert [str(row[1]) for row in rows(SENSOR, gains)] == ["[1 2]", "[3 4]", "inactive", "inactive"]


@pytest.mark.parametrize("wanted", [(1, 1), [(1, 1)], {(1, 1)}])
def test_a_condition_names_a_treatment_that_is_a_tuple_or_several_in_a_list_or_set(wanted: Any) -> None:
    places = Factor("Place", [(0, 0), (1, 1)])
    found = rows(places, Factor("Rate", [5], when={"Place": wanted}))
    assert found == [((0, 0), INACTIVE), ((1, 1), 5)]


def test_a_condition_that_names_no_treatment_is_refused() -> None:
    with pytest.raises(DesignError, match="names no treatment of 'Sensor'"):
        Factor("Rate", [5], when={"Sensor": []})
