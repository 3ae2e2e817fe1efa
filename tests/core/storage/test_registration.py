"""A registration is written with a checksum, read with care, and compared in words."""

from __future__ import annotations

import copy
import json
from typing import TYPE_CHECKING, Any

import pytest

from robot_runner.core.design.analysis_plan import AnalysisPlan
from robot_runner.core.errors import StorageError
from robot_runner.core.storage.registration import checksum_of, differences, read_registration, write_registration

if TYPE_CHECKING:
    from pathlib import Path

CONTENT: dict[str, Any] = {
    "registered_at": "2026-01-31T12:00:00.000Z",
    "experiment": "naps",
    "config": {"file": "study.py", "sha256": "0" * 64, "modules": {}},
    "design": {
        "factors": {"Task": ["Video", "Größe"]},
        "repetitions": 3,
        "shuffle": True,
        "blocks": None,
        "excluded": [],
    },
    "seed": 7,
    "seed_is_given": False,
    "measures": [{"name": "Energy", "unit": "J"}],
    "analysis": AnalysisPlan("Energy").as_mapping(),
    "repeat_until": None,
    "power": None,
}


def test_what_was_written_is_intact_and_what_was_changed_is_not(tmp_path: Path) -> None:
    path = tmp_path / "it.json"
    made = write_registration(path, CONTENT)
    found = read_registration(path)
    assert found.is_intact
    assert found.sha256 == made.sha256 == checksum_of(found.content)
    assert found.facts() == {"file": "it.json", "registered_at": CONTENT["registered_at"], "sha256": made.sha256}
    # Blanks and the order of keys are no content.
    path.write_text(json.dumps(dict(reversed(list(found.content.items())))), encoding="utf-8")
    assert read_registration(path).is_intact
    path.write_text(json.dumps({**found.content, "seed": 8}), encoding="utf-8")
    assert not read_registration(path).is_intact


def _without(name: str) -> dict[str, Any]:
    return {key: value for key, value in CONTENT.items() if key != name}


@pytest.mark.parametrize(
    "content",
    [
        *(_without(name) for name in ("design", "seed", "measures", "analysis", "power", "config")),
        {**CONTENT, "design": {"factors": 3}},
        {**CONTENT, "measures": ["Energy"]},
        {**CONTENT, "measures": [{"unit": "J"}]},
        {**CONTENT, "analysis": {"hypotheses": [{"no": "statement"}], "odd": 1}},
        {**CONTENT, "analysis": {"hypotheses": 3}},
        {**CONTENT, "repeat_until": {"least": 3}},
        {**CONTENT, "repeat_until": [3]},
        {**CONTENT, "seed": "seven"},
        {**CONTENT, "config": {"file": ["study.py"]}},
        {**CONTENT, "config": {"modules": 3}},
        {**CONTENT, "config": {"settings": ["robot"]}},
    ],
)
def test_a_file_of_another_shape_is_no_registration(tmp_path: Path, content: dict[str, Any]) -> None:
    path = tmp_path / "it.json"
    path.write_text(json.dumps({"format": 1, **content, "sha256": checksum_of({"format": 1, **content})}))
    with pytest.raises(StorageError, match="not a registration"):
        read_registration(path)


@pytest.mark.parametrize("text", ["", "{", "[" * 100_000, "3", '{"format": 2}'])
def test_a_damaged_file_is_refused_with_a_way_out(tmp_path: Path, text: str) -> None:
    path = tmp_path / "it.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(StorageError) as raised:
        read_registration(path)
    assert raised.value.fix
    with pytest.raises(StorageError, match="the folder cannot be read: Is a directory"):
        read_registration(tmp_path)


def test_differences_are_told_in_words() -> None:
    def told(**changes: Any) -> list[str]:
        now = copy.deepcopy(CONTENT)
        for path, value in changes.items():
            part, _, name = path.partition("__")
            if name:
                now[part][name] = value
            else:
                now[part] = value
        return list(differences(CONTENT, now))

    assert told() == []
    assert told(design__repetitions=5) == ["repetitions: 5, and 3 was registered"]
    assert told(design__factors={"Task": ["Video"]}) == [
        "the treatments of Task are Video, and Video, Größe were registered"
    ]
    assert told(design__factors={"Job": ["a"]}) == [
        "the factor Task was registered, and is gone",
        "the factor Job was not registered",
    ]
    assert told(seed=8) == ["the seed of the order is 8, and 7 was registered"]
    assert told(analysis=None) == ["the analysis plan is gone, and one was registered"]
    assert told(analysis__alpha=0.01) == ["alpha of the analysis plan: 0.01, and 0.05 was registered"]
    stated = {"statement": "It costs.", "measure": "Energy", "factors": ["Task"]}
    assert told(analysis__hypotheses=[stated]) == ["the hypothesis 'It costs.' was not registered"]
    registered = copy.deepcopy(CONTENT)
    registered["analysis"]["hypotheses"] = [stated]
    assert list(differences(registered, CONTENT)) == ["the hypothesis 'It costs.' was registered, and is gone"]
    claimed = copy.deepcopy(registered)
    claimed["analysis"]["hypotheses"] = [{**stated, "factors": ["Speed"]}]
    assert list(differences(registered, claimed)) == [
        "the hypothesis 'It costs.' claims something else than was registered"
    ]
    assert told(measures=[{"name": "Energy", "unit": "kJ"}]) == ["Energy is in kJ, and J was registered"]
    assert told(measures=[]) == ["the measure Energy was registered, and the run table has no column for it"]
    more = [*CONTENT["measures"], {"name": "CPU", "unit": "%"}]
    assert told(measures=more) == ["the run table has measures that were not registered: CPU"]
    # A plan that an earlier version wrote lacks choices that it did not know: they had their defaults.
    older = copy.deepcopy(CONTENT)
    del older["analysis"]["statistic"]
    assert list(differences(older, CONTENT)) == []


def test_other_units_conditions_and_ranges_are_differences_and_a_whole_number_with_a_point_is_none() -> None:
    registered = {
        "factors": {"Wait": ["1", "2"], "Mode": ["eco", "fast"]},
        "units": {"Wait": "s"},
        "combinations": [["1", "eco"], ["2", "fast"]],
    }
    before = {**CONTENT, "design": registered}

    def told(**changes: Any) -> list[str]:
        return list(differences(before, {"design": {**registered, **changes}}))

    with_points = {"factors": {"Wait": ["1.0", "2.0"], "Mode": ["eco", "fast"]}}
    assert told(**with_points, combinations=[["2.0", "fast"], ["1.0", "eco"]]) == []
    assert told(units={"Wait": "ms"}) == ["Wait is in ms, and s was registered"]
    assert told(combinations=[["1", "fast"], ["2", "fast"]]) == [
        "1 combination not registered: 1 / fast",
        "1 combination registered and not in the design: 1 / eco",
    ]
    ranged = {**registered, "ranges": {"Wait": "1 to 9 in steps of 1"}}
    tried = {**ranged, "factors": {**registered["factors"], "Wait": ["1", "2", "4"]}}  # what a search had tried
    assert list(differences({**CONTENT, "design": ranged}, {"design": tried})) == []
    assert list(differences({**CONTENT, "design": ranged}, {"design": {**tried, "ranges": {"Wait": "1 to 5"}}})) == [
        "the range of Wait is 1 to 5, and 1 to 9 in steps of 1 was registered"
    ]
    unknown = {name: each for name, each in registered.items() if name == "factors"}  # as an earlier version wrote it
    assert list(differences({**CONTENT, "design": unknown}, {"design": registered})) == []
