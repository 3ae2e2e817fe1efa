"""A plan that grows: no run is touched, none is planned twice, and every combination gets what was asked for."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import replace
from decimal import Decimal
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot_runner.core.design.batches import GrownRunTableModel, batches_of, first_batch, next_batch, records_of
from robot_runner.core.design.extended_design import Additions, Begun, NewFactor, extended_design
from robot_runner.core.design.factor import Factor
from robot_runner.core.design.listed_runs import ListedRun, ListedRunTableModel
from robot_runner.core.design.planned_runs import RunOrder
from robot_runner.core.design.run_table_model import RunTableModel
from robot_runner.core.design.warm_up import WarmUp
from robot_runner.core.errors import DesignError

if TYPE_CHECKING:
    from robot_runner.core.design.batch import Batch

TASK, SPEED = Factor("Task", ["Video", "Network"]), Factor("Speed", [0.1, 0.2])


def begun(model: RunTableModel, **changed: Any) -> Begun:
    facts = Begun(
        factors=model.factors,
        runs=list(model.plan()),
        chosen=getattr(model, "chosen", {}),
        has_repetition=model.repetitions > 1,
        is_by_hand=False,
    )
    return replace(facts, **changed)


def extended(
    model: RunTableModel, added: Additions, *, config: RunTableModel | None = None, seed: int = 1, shuffle: bool = True
) -> GrownRunTableModel:
    """Return the design with one more batch, by way of the journal's plain records."""
    config = config or getattr(model, "as_configured", model)
    there = begun(model)
    design = extended_design(there, config, added)
    batches = model.batches or (first_batch(there, RunOrder(shuffle=model.shuffle, seed=model.seed)),)
    order = RunOrder(shuffle=shuffle, seed=seed, blocks=config.blocks)
    batch = next_batch(
        there, design, config.warm_up, order=order, number=len(batches) + 1, at="2026-11-22T10:00:00.000Z"
    )
    records = json.loads(json.dumps(list(records_of([*batches, batch]))))
    return GrownRunTableModel(config, batches_of(records))


def shown(model: RunTableModel) -> list[tuple[str, str, int, int]]:
    return [(run.run_id, str(run.combination), run.repetition, run.batch) for run in model.plan()]


def findings(model: RunTableModel, added: Additions, **changed: Any) -> list[str]:
    with pytest.raises(DesignError) as refused:
        extended_design(begun(model, **changed), getattr(model, "as_configured", model), added)
    return [str(finding) for finding in refused.value.findings]


growths = st.lists(
    st.tuples(
        st.integers(0, 3),  # repetitions more
        st.integers(0, 2),  # treatments of Task more
        st.booleans(),  # a factor more
        st.integers(0, 2**32 - 1),
    ),
    min_size=1,
    max_size=4,
)


@pytest.mark.long
@given(
    growths,
    st.integers(1, 3),
    st.booleans(),
    st.sampled_from([None, "Task", "Speed"]),
    st.sampled_from([None, WarmUp(1), WarmUp(2, per="Task"), WarmUp(1, per="combination")]),
    st.booleans(),
)
def test_whatever_is_added_no_run_changes_and_every_combination_gets_what_was_asked_for(
    steps: list[tuple[int, int, bool, int]],
    repetitions: int,
    shuffle: bool,
    blocks: str | None,
    warm_up: WarmUp | None,
    excludes: bool,
) -> None:
    excluded = [lambda each: each["Task"] == "Network" and each["Speed"] == 0.2] if excludes else []
    config = RunTableModel(
        [TASK, SPEED], excluded, repetitions, shuffle=shuffle, seed=5, blocks=blocks, warm_up=warm_up
    )
    model: RunTableModel = config
    for number, (more, treatments, is_new_factor, seed) in enumerate(steps):
        before, earlier = list(model.plan()), model.repetitions
        added = Additions(
            earlier + more,
            {"Task": [f"T{number}_{each}" for each in range(treatments)]} if treatments else {},
            {f"F{number}": NewFactor("old", ("new",))} if is_new_factor else {},
        )
        model = extended(model, added, seed=seed)
        after = list(model.plan())
        kept = after[: len(before)]
        assert [(run.run_id, run.number, run.repetition, run.batch, run.block) for run in kept] == [
            (run.run_id, run.number, run.repetition, run.batch, run.block) for run in before
        ]
        for run, was in zip(kept, before, strict=True):
            assert {name: run.combination[name] for name in was.combination} == dict(was.combination)
            assert all(run.combination[name] == "old" for name in set(run.combination) - set(was.combination))
        counted = Counter(str(run.combination) for run in after if not run.is_warm_up)
        assert set(counted.values()) == {earlier + more}
        assert len(counted) == sum(
            not (excludes and each["Task"] == "Network" and each["Speed"] == 0.2)
            for each in config.combinations_of(model.factors)
        )
        each_once = {(str(run.combination), run.repetition) for run in after if not run.is_warm_up}
        assert len(each_once) == sum(counted.values())
        assert len({run.run_id for run in after}) == len(after)
        assert [run.number for run in after] == list(range(1, len(after) + 1))
        assert {run.batch for run in after[len(before) :]} <= {number + 2}


def test_more_repetitions_get_the_next_ids_and_numbers() -> None:
    grown = extended(RunTableModel([TASK], repetitions=2), Additions(3), shuffle=False)
    assert shown(grown)[4:] == [("r_5", "Task='Video'", 3, 2), ("r_6", "Task='Network'", 3, 2)]


def test_the_new_runs_are_randomised_among_themselves_from_their_own_seed() -> None:
    model = RunTableModel([TASK, SPEED], repetitions=2)
    one, same, other = (extended(model, Additions(5), seed=seed) for seed in (1, 1, 2))
    assert shown(one) == shown(same) != shown(other)
    assert shown(one)[:8] == shown(other)[:8] == [(*run[:3], 1) for run in shown(model)]
    assert [run[1:3] for run in shown(one)[8:]] != sorted(run[1:3] for run in shown(one)[8:])
    assert one.batches[1].order.seed == 1


def test_blocks_hold_in_a_batch_and_go_on_counting() -> None:
    model = RunTableModel([TASK, SPEED], repetitions=2, blocks="Repetition", shuffle=True, seed=1)
    new = list(extended(model, Additions(4)).plan())[8:]
    assert [run.repetition for run in new] == [3] * 4 + [4] * 4
    assert [run.block for run in new] == [3] * 4 + [4] * 4


def test_what_the_config_has_beyond_the_table_is_added_unasked() -> None:
    now = RunTableModel([Factor("Task", ["Video", "Network", "Audio"]), SPEED], [{"Task": "Audio", "Speed": 0.2}], 2)
    model = RunTableModel([TASK, SPEED])
    grown = extended(model, Additions(), config=now)
    assert Counter(str(run.combination) for run in grown.plan() if run.batch == 2) == {
        "Task='Audio', Speed=0.1": 2,
        **{f"Task={task!r}, Speed={speed}": 1 for task in ("Video", "Network") for speed in (0.1, 0.2)},
    }


def test_a_treatment_that_the_config_has_no_longer_gets_no_further_run() -> None:
    model = RunTableModel([Factor("Task", ["Video", "Network"])])
    grown = extended(model, Additions(2), config=RunTableModel([Factor("Task", ["Network"])]))
    assert shown(grown)[2:] == [("r_3", "Task='Network'", 2, 2)]


def test_what_was_added_on_the_command_line_counts_later_too() -> None:
    grown = extended(
        RunTableModel([TASK]), Additions(treatments={"Task": ["Audio"]}, factors={"Floor": NewFactor("1", ("2",))})
    )
    again = extended(grown, Additions(2))
    assert set(Counter(str(run.combination) for run in again.plan()).values()) == {2}
    assert {run.combination["Floor"] for run in again.plan()} == {1, 2}
    assert again.chosen == {"Task": ("Audio",), "Floor": ("1", "2")}


def test_treatments_have_the_type_of_the_others() -> None:
    grown = extended(
        RunTableModel([SPEED, Factor("Light", [True])]), Additions(treatments={"Speed": ["1"], "Light": ["False"]})
    )
    assert grown.factors[0].treatments == (0.1, 0.2, 1.0)
    assert grown.factors[1].treatments == (True, False)


@pytest.mark.parametrize(
    ("treatments", "text", "made"),
    [
        ([Decimal("0.10"), Decimal("0.2")], "0.30", Decimal("0.30")),
        ([Fraction(1, 3)], "2/3", Fraction(2, 3)),
        (list(np.arange(0.1, 0.3, 0.1)), "0.5", np.float64(0.5)),
        (list(np.arange(2)), "7", np.int64(7)),
    ],
)
def test_numbers_of_any_kind_get_treatments_of_that_kind_and_slips_are_refused(
    treatments: list[Any], text: str, made: Any
) -> None:
    model = RunTableModel([Factor("Speed", treatments)])
    grown = extended(model, Additions(treatments={"Speed": [text]}))
    last = grown.factors[0].treatments[-1]
    assert (type(last), str(last)) == (type(made), str(made))
    for slip in ("fast", "1/0", "-inf", "nan"):
        (problem,) = findings(model, Additions(treatments={"Speed": [slip]}))
        assert f"{slip!r} is not " in problem


def test_a_factor_that_applies_under_a_condition_gets_treatments_where_it_applies() -> None:
    sensor = Factor("Sensor", ["lidar", "camera"])
    model = RunTableModel([sensor, Factor("Resolution", ["720p"], when={"Sensor": "camera"})])
    grown = extended(model, Additions(treatments={"Resolution": ["4k"]}))
    assert [str(run.combination) for run in grown.plan()] == [
        "Sensor='lidar', Resolution=inactive",
        "Sensor='camera', Resolution='720p'",
        "Sensor='camera', Resolution='4k'",
    ]


def test_objects_are_those_of_the_config_and_none_is_made_from_a_text() -> None:
    modes = [complex(1, 2), complex(3, 4)]
    model = RunTableModel([Factor("Mode", modes[:1])])
    (problem,) = findings(model, Additions(treatments={"Mode": ["(3+4j)"]}))
    assert "Add it to the factor in the config" in problem
    grown = extended(model, Additions(), config=RunTableModel([Factor("Mode", modes)]))
    assert [run.combination["Mode"] for run in grown.plan()] == modes
    with pytest.raises(DesignError, match="no treatment '\\(3\\+4j\\)' any more"):
        GrownRunTableModel(model, grown.batches)


def test_a_plain_treatment_outlives_its_config() -> None:
    grown = extended(RunTableModel([TASK]), Additions(2))
    left = GrownRunTableModel(RunTableModel([Factor("Task", ["Video"])]), grown.batches)
    assert shown(left) == shown(grown)


def test_a_plan_says_the_seed_that_it_is_given_and_else_that_of_the_first_batch() -> None:
    grown = extended(RunTableModel([TASK, SPEED], shuffle=True, seed=7), Additions(2), seed=8)
    assert [grown.plan(seed).order.seed for seed in (None, 9)] == [7, 9]
    assert list(grown.plan(9)) == list(grown.plan())


def test_ids_go_on_as_they_began() -> None:
    listed = ListedRunTableModel(
        [TASK], [ListedRun("run_7", {"Task": "Video"}), ListedRun("run_9", {"Task": "Network"})]
    )
    assert [run.run_id for run in extended(listed, Additions(2)).plan()][2:] == ["run_10", "run_11"]
    odd = ListedRunTableModel([TASK], [ListedRun("first", {"Task": "Video"}), ListedRun("r_3", {"Task": "Network"})])
    assert [run.run_id for run in extended(odd, Additions(2)).plan()][2:] == ["r_4", "r_5"]


def test_runs_of_a_table_without_repetitions_are_counted() -> None:
    runs = [
        ListedRun(f"r_{number}", {"Task": task}) for number, task in enumerate(["Video", "Video", "Network"], start=1)
    ]
    grown = extended(ListedRunTableModel([TASK], runs), Additions(2))
    assert shown(grown) == [
        ("r_1", "Task='Video'", 1, 1),
        ("r_2", "Task='Video'", 2, 1),
        ("r_3", "Task='Network'", 1, 1),
        ("r_4", "Task='Network'", 2, 2),
    ]


def test_a_warm_up_run_between_others_is_counted_as_no_repetition() -> None:
    first = RunTableModel([TASK]).plan()[0]
    runs = [first, first._replace(run_id="w_2", repetition=0), first._replace(run_id="r_3")]
    there = begun(RunTableModel([TASK]), runs=runs, has_repetition=False)
    assert [run.repetition for run in there.counted_runs] == [1, 0, 2]


def test_everything_that_cannot_be_added_is_said_at_once() -> None:
    model = RunTableModel([TASK, SPEED], repetitions=2)
    added = Additions(
        1,
        {"Tusk": ["Audio"], "Task": ["Video"], "Speed": ["fast"]},
        {"Task": NewFactor("a"), "Floor": NewFactor("carpet"), "status": NewFactor("a", ("b",))},
    )
    assert [problem.partition(" → ") for problem in findings(model, added)] == [
        (problem, " → ", fix)
        for problem, fix in [
            (
                "--repetitions: 1 is fewer than the 2 repetitions that there are",
                "Give the new total, such as 3; no run is ever taken away.",
            ),
            ("--treatments Tusk: the run table has no factor 'Tusk'", "Did you mean 'Task'?"),
            ("--treatments Task: the factor has the treatment 'Video' already", "Leave it out."),
            (
                "--treatments Speed: 'fast' is not of type float, as the treatments of the factor are",
                "Give one of that type.",
            ),
            (
                "--factor Task: the run table has this factor already",
                "Add treatments to it: --treatments Task=... .",
            ),
            (
                "--factor Floor: the factor would have the treatment 'carpet' alone",
                "Give others: --factor Floor=carpet:OTHER,... .",
            ),
            ("factor 'status': the run table has a column of that name already", "Choose another name."),
        ]
    ]


def test_a_number_with_an_underscore_is_no_treatment() -> None:
    """Python takes `0_3` for 3, and the robot would drive ten times as fast as was meant."""
    for factor in (Factor("Speed", [0.1, 0.2]), Factor("Speed", [1, 2])):
        (problem,) = findings(RunTableModel([factor]), Additions(treatments={"Speed": ["0_3"]}))
        assert "'0_3' is not of type" in problem


def test_a_new_factor_of_the_config_needs_the_treatment_that_the_runs_so_far_had() -> None:
    model = RunTableModel([TASK])
    now = RunTableModel([TASK, Factor("Floor", ["carpet", "wood"])])
    with pytest.raises(DesignError, match="nothing says which treatment the runs so far had"):
        extended(model, Additions(), config=now)
    with pytest.raises(DesignError, match="'carpt' is not a treatment"):
        extended(model, Additions(factors={"Floor": NewFactor("carpt")}), config=now)
    grown = extended(model, Additions(factors={"Floor": NewFactor("carpet")}), config=now)
    assert [run.combination["Floor"] for run in grown.plan()] == ["carpet", "carpet", "wood", "wood"]


def test_a_factor_that_the_config_has_no_longer_is_to_be_put_back() -> None:
    there = begun(RunTableModel([TASK, SPEED]))
    with pytest.raises(DesignError, match=r"the config does not have this factor any more.*Put it back") as refused:
        extended_design(there, RunTableModel([TASK]), Additions(2))
    assert [finding.where for finding in refused.value.findings] == ["factor 'Speed'"]


def test_treatments_of_a_factor_that_the_config_alone_has_are_no_slip() -> None:
    now = RunTableModel([TASK, Factor("Floor", ["carpet", "wood"])])
    with pytest.raises(DesignError, match="The config has it and the run table not yet: --factor Floor=DEFAULT"):
        extended(RunTableModel([TASK]), Additions(treatments={"Floor": ["stone"]}), config=now)


def test_a_factor_whose_name_has_blanks_is_quoted_as_a_shell_takes_it() -> None:
    now = RunTableModel([TASK, Factor("Floor type", ["thick carpet", "wood"])])
    with pytest.raises(DesignError, match="Say it: --factor 'Floor type=DEFAULT'"):
        extended(RunTableModel([TASK]), Additions(), config=now)
    with pytest.raises(DesignError, match="--factor 'Floor type=DEFAULT'"):
        extended(RunTableModel([TASK]), Additions(treatments={"Floor type": ["stone"]}), config=now)
    new = Additions(factors={"Floor type": NewFactor("thick carpet")})
    with pytest.raises(DesignError, match=r"Give others: --factor 'Floor type=thick carpet:OTHER,\.\.\.'"):
        extended(RunTableModel([TASK]), new)
    with pytest.raises(DesignError, match=r"Add treatments to it: --treatments 'Floor type=\.\.\.'"):
        extended(now, new)


def test_a_factor_that_counts_repetitions_gets_treatments() -> None:
    model = RunTableModel([TASK, Factor("Repetition", [1, 2])])
    (problem,) = findings(model, Additions(3))
    assert "--treatments Repetition=" in problem
    assert len(extended(model, Additions(treatments={"Repetition": ["3"]})).plan()) == 6


def test_runs_that_were_listed_one_by_one_get_repetitions_alone() -> None:
    model = RunTableModel([TASK])
    problems = findings(model, Additions(2, {"Task": ["Audio"]}, {"Floor": NewFactor("a", ("b",))}), is_by_hand=True)
    assert len(problems) == 2
    assert all("listed one by one" in problem for problem in problems)


def test_too_many_runs_are_refused_before_they_are_made() -> None:
    assert "more than 10,000,000 runs" in findings(RunTableModel([TASK]), Additions(10**9))[0]


def test_a_damaged_record_is_refused() -> None:
    grown = extended(RunTableModel([TASK]), Additions(2))
    (record,) = records_of(grown.batches)
    with pytest.raises(DesignError, match="a record of an extension is damaged"):
        batches_of([{**record, "runs": 3}])
    unfit = replace(grown.batches[1], runs=[replace(grown.batches[1].runs[0], run_id="../up")])
    with pytest.raises(DesignError, match="a run cannot have the id"):
        GrownRunTableModel(RunTableModel([TASK]), [grown.batches[0], unfit])


def test_a_batch_sums_up_what_the_manifest_tells() -> None:
    batch: Batch = extended(RunTableModel([TASK], warm_up=1), Additions(2), seed=9).batches[1]
    assert batch.summary() == {
        "batch": 2,
        "runs": 2,
        "first": "r_3",
        "last": "r_4",
        "warm_ups": 1,
        "seed": 9,
        "shuffle": True,
        "blocks": None,
        "repetitions": 2,
        "at": "2026-11-22T10:00:00.000Z",
    }


@pytest.mark.parametrize(
    ("text", "written"), [("1", "1.0"), ("0.30", "0.3"), (".4", "0.4"), ("5e-1", "0.5"), (" 0.7", "0.7")]
)
def test_a_treatment_may_be_asked_for_in_another_spelling_of_its_number(text: str, written: str) -> None:
    model = RunTableModel([SPEED])
    grown = extended(model, Additions(treatments={"Speed": [text, "0.9"]}))
    assert sorted(str(run.combination["Speed"]) for run in grown.plan()) == sorted(["0.1", "0.2", written, "0.9"])
    assert grown.chosen == {"Speed": (written, "0.9")}
    assert extended(grown, Additions(repetitions=2)).chosen == grown.chosen


def test_a_number_that_is_there_in_another_spelling_or_is_not_finite_is_no_further_treatment() -> None:
    fix = "as the treatments of the factor are → Give one of that type."
    assert findings(RunTableModel([SPEED]), Additions(treatments={"Speed": ["1e-1", "nan", "-inf"]})) == [
        "--treatments Speed: the factor has the treatment '1e-1' already, as 0.1 → Leave it out.",
        f"--treatments Speed: 'nan' is not a finite number, {fix}",
        f"--treatments Speed: '-inf' is not a finite number, {fix}",
    ]


def test_a_factor_of_the_config_may_get_treatments_in_another_spelling() -> None:
    config = RunTableModel([TASK, SPEED])
    grown = extended(RunTableModel([TASK]), Additions(factors={"Speed": NewFactor("0.1", ("1",))}), config=config)
    assert {str(run.combination["Speed"]) for run in grown.plan()} == {"0.1", "0.2", "1.0"}
