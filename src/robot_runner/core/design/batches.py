"""The plan of an extended experiment: the first plan, and each batch of runs that was added to it.

Once an experiment has grown, its plan is what the journal lists, batch by batch, and not what the config makes: so runs
keep their ids when the config changes. It grows by batches, which a user adds, and by repetitions, which are added
until it is precise: these belong to the batch before them.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, replace
from itertools import count, repeat
from re import fullmatch
from typing import Any

from robot_runner.core.design.asking import DECIDED, Decision
from robot_runner.core.design.batch import Batch, BatchRun, plain_treatment
from robot_runner.core.design.columns import REPETITION, numbered_run_id
from robot_runner.core.design.extended_design import Begun, ExtendedDesign, treatments_of, typed
from robot_runner.core.design.factor import Combination, Factor, factor_places, texts_of
from robot_runner.core.design.listed_runs import run_findings
from robot_runner.core.design.planned_runs import PlannedRun, RunOrder, arranged
from robot_runner.core.design.run_table_model import RunTable, RunTableModel
from robot_runner.core.design.warm_up import WarmUp, with_warm_ups
from robot_runner.core.errors import DesignError

#: The kind of the journal's record of an extension, which has the added batch; the first one has the first plan, too.
EXTENDED = "extended"
#: The kind of the record of a further repetition; the first one has the first plan, unless an extension has it.
REPEATED = "repeated"
#: The kinds of all records from which `batches_of` makes the plan.
GROWTH = frozenset({EXTENDED, REPEATED, DECIDED})


def batches_of(records: Iterable[Mapping[str, Any]]) -> tuple[Batch, ...]:
    """Return all batches of an experiment from the journal's records of its growth; empty where there are none.

    Raises:
        DesignError: a record is damaged.
    """
    batches: list[Batch] = []
    for record in records:
        try:
            batches += [Batch.of_mapping(record["base"])] if not batches else []
            if "batch" in record:
                batches.append(Batch.of_mapping(record))
            else:
                batches[-1] = _grown_by(batches[-1], record)
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            problem = f"a record of an extension is damaged: {type(error).__name__}: {error}"
            raise DesignError(problem, where="journal", fix="Restore the journal from a backup.") from error
    return tuple(batches)


def _grown_by(batch: Batch, record: Mapping[str, Any]) -> Batch:
    runs = [BatchRun.of_mapping(run) for run in record["runs"]]
    is_repetition = "repetition" in record
    repetitions = int(record["repetition"]) if is_repetition else batch.repetitions
    name = f"repetition {repetitions}" if is_repetition else str(record["name"])
    return replace(
        batch,
        repetitions=repetitions,
        runs=[*batch.runs, *runs],
        # A record without runs only has the first plan.
        added=(*batch.added, (name, tuple(run.run_id for run in runs))) if runs else batch.added,
        factors=record.get("factors") or batch.factors,
    )


def records_of(batches: Sequence[Batch]) -> Iterator[dict[str, Any]]:
    """Yield the fields of `extended` records from which `batches_of` makes these batches.

    A plan that has grown by repetitions only is one batch: for it, a `repeated` record without runs is made.
    """
    if len(batches) == 1:
        yield {"repetition": batches[0].repetitions, "runs": [], "base": batches[0].as_mapping()}
    for batch in batches[1:]:
        base = {"base": batches[0].as_mapping()} if batch is batches[1] else {}
        yield batch.as_mapping() | base


def extended_batch(batch: Batch, decision: Decision, planned: Batch, *, is_first: bool) -> tuple[Batch, dict[str, Any]]:
    """Return a batch with the runs that were decided on, and the fields of the journal's record of it.

    `batch` is the last one, and `planned` has its runs in the order of execution, and the factors that these need. With
    `is_first` the journal does not have the first plan yet.
    """
    is_repetition = decision.kind == REPEATED
    record: dict[str, Any] = {"repetition": planned.repetitions} if is_repetition else {"name": decision.name}
    record["runs"] = [run.as_mapping() for run in planned.runs]
    factors = planned.as_mapping()["factors"]
    if factors != batch.as_mapping()["factors"]:
        record["factors"] = factors
    if is_first:
        record["base"] = batch.as_mapping()
    return _grown_by(batch, record), record


class GrownRunTableModel(RunTableModel):
    """A design whose plan has grown by batches.

    Attributes:
        as_configured: the design by the present config, which may plan fewer or more runs.
        chosen: the treatments that were added on the command line, as text, by factor.

    Example:
        >>> model = RunTableModel([Factor("Task", ["Video"])])
        >>> runs = [BatchRun("r_1", {"Task": "Video"})]
        >>> one = Batch(number=1, order=RunOrder(seed=1), repetitions=1, factors={"Task": ["Video"]}, runs=runs)
        >>> two = replace(one, number=2, repetitions=2, runs=[BatchRun("r_2", {"Task": "Video"}, 2)])
        >>> [(run.run_id, run.repetition, run.batch) for run in GrownRunTableModel(model, [one, two]).plan()]
        [('r_1', 1, 1), ('r_2', 2, 2)]
    """

    def __init__(self, model: RunTableModel, batches: Sequence[Batch]) -> None:
        """Make the plan from its batches.

        Raises:
            DesignError: the config lacks a treatment that cannot be made from its text, or a run id is invalid.
        """
        DesignError.refuse(run_findings([run.run_id for batch in batches for run in batch.runs]))
        last = batches[-1]
        own = {factor.name: factor for factor in model.factors}
        factors = tuple(_factor(own.get(name), name, treatments) for name, treatments in last.factors.items())
        by_name = {factor.name: factor for factor in factors}
        defaults = {name: text for batch in batches for name, text in batch.defaults.items()}
        self.defaults = {name: _treatment(by_name[name], text) for name, text in defaults.items()}
        vars(self).update(
            factors=factors,
            repetitions=last.repetitions,
            data_columns=model.data_columns,
            warnings=model.warnings,
            warm_up=model.warm_up,
            design=model.design,
            design_facts=model.design_facts,
        )
        self.as_configured = model
        self.batches = tuple(batches)
        self.chosen: dict[str, tuple[str, ...]] = {}
        for batch in batches:
            for name, texts in batch.chosen.items():
                self.chosen[name] = (*self.chosen.get(name, ()), *texts)
        self._order = replace(batches[0].order, seed_is_given=model.seed_is_given)
        places = factor_places(by_name)
        self._runs = [
            self._planned_run(places, number, batch, run)
            for number, (batch, run) in enumerate(((batch, run) for batch in batches for run in batch.runs), start=1)
        ]

    def plan(self, seed: int | None = None) -> RunTable:
        """Return the run table as listed, whatever the seed."""
        order = self._order if seed is None else replace(self._order, seed=seed)
        return RunTable(self, self._runs, order)

    def _planned_run(self, places: Mapping[str, int], number: int, batch: Batch, run: BatchRun) -> PlannedRun:
        treatments = tuple(
            _treatment(factor, run.treatments[factor.name])
            if factor.name in run.treatments
            else self.defaults[factor.name]
            for factor in self.factors
        )
        combination = Combination(places, treatments)
        return PlannedRun(run.run_id, number, combination, run.repetition, run.block, batch.number)


def as_configured(model: RunTableModel) -> RunTableModel:
    """Return the design by the config, without later batches."""
    return model.as_configured if isinstance(model, GrownRunTableModel) else model


def _factor(own: Factor | None, name: str, recorded: Sequence[Any]) -> Factor:
    """Return a factor with the recorded treatments: the config's own objects, where it has them."""
    treatments = [_own_treatment(own, name, each) for each in recorded]
    return own.with_treatments(treatments) if own else Factor(name, treatments)


def _own_treatment(own: Factor | None, name: str, recorded: Any) -> Any:
    is_object = isinstance(recorded, dict)
    text = recorded["text"] if is_object else str(recorded)
    place = own.position_of_text(text) if own else None
    if own is not None and place is not None:
        return own.treatments[place]
    if is_object:
        with suppress(DesignError):  # a number of a type that JSON does not have is made from its text
            if own is not None and plain_treatment(made := typed(own, text)) == recorded:
                return made
        problem = f"the config has no treatment {text!r} any more, which runs of the experiment have"
        raise DesignError(problem, where=f"factor {name!r}", fix="Put it back into the config.")
    return recorded


def _treatment(factor: Factor, text: str) -> Any:
    place = factor.position_of_text(text)
    if place is None:
        problem = f"a run has the treatment {text!r}, which the factor does not have"
        raise DesignError(problem, where=f"factor {factor.name!r}", fix="Restore the journal from a backup.")
    return factor.treatments[place]


# The runs that are missing for a design to be complete.


def first_batch(begun: Begun, order: RunOrder) -> Batch:
    """Return the batch of the first plan."""
    return Batch(
        number=1,
        order=order,
        repetitions=begun.repetitions,
        factors=_plain(begun.factors),
        runs=list(map(BatchRun.of, begun.counted_runs)),
    )


def next_batch(
    begun: Begun,
    design: ExtendedDesign,
    warm_up: WarmUp | None,
    *,
    order: RunOrder,
    number: int,
    at: str,
    wanted: Iterable[tuple[Combination, int]] | None = None,
) -> Batch:
    """Return the batch of runs that are missing, perhaps none.

    `design` is to be reached; `wanted` has the combination and repetition of each run in the order as written, None for
    all that are missing.
    """
    missing = list(missing_runs(begun.counted_runs, design) if wanted is None else wanted)
    blocks = _block_of(missing, order.blocks)
    places = arranged(len(missing), blocks, order) if missing else ()
    first = len(begun.runs) + 1
    last_block = max((run.block or 0 for run in begun.runs), default=0)
    ids = _free_ids(begun.runs)
    block_of = repeat(None, len(places)) if blocks is None else [last_block + blocks[place] + 1 for place in places]
    runs = [
        PlannedRun(next(ids), first + index, *missing[place], block, number)
        for index, (place, block) in enumerate(zip(places, block_of, strict=True))
    ]
    warm_ups = sum(run.is_warm_up for run in begun.runs)
    return Batch(
        number=number,
        order=replace(order, seed_is_given=True),
        repetitions=design.repetitions,
        factors=_plain(design.factors),
        runs=[BatchRun.of(run) for run in with_warm_ups(runs, warm_up, first=warm_ups + 1)],
        chosen=design.chosen,
        defaults=texts_of(design.defaults),
        at=at,
    )


def missing_runs(runs: Iterable[PlannedRun], design: ExtendedDesign) -> Iterator[tuple[Combination, int]]:
    """Yield each run that is missing, as its combination and repetition, in the order as written."""
    names = [factor.name for factor in design.factors]
    places = factor_places(names)
    there = design.repetitions_of(runs)
    wanted = []
    for combination in design.combinations:
        taken = there[design.texts_of(combination)]
        free = (each for each in count(1) if each not in taken)
        numbers = [next(free) for _ in range(design.repetitions - len(taken))]
        own = Combination(places, tuple(combination[name] for name in names))
        wanted += [(number, own) for number in numbers for _ in range(max(1, design.copies[treatments_of(own)]))]
    for number, combination in sorted(wanted, key=lambda each: each[0]):  # stable: combinations as written
        yield combination, number


def _block_of(missing: Sequence[tuple[Combination, int]], blocks: str | None) -> list[int] | None:
    """Return the number of each run's block, from 0 without gaps; in the order as written."""
    if blocks is None:
        return None
    of_run: list[Any] = [
        number if blocks == REPETITION and REPETITION not in combination else str(combination[blocks])
        for combination, number in missing
    ]
    number_of = {value: number for number, value in enumerate(dict.fromkeys(of_run))}
    return [number_of[value] for value in of_run]


def _free_ids(runs: Sequence[PlannedRun]) -> Iterator[str]:
    """Yield the ids after those that there are: `r_11` after `r_10`, `run_3` after `run_2`."""
    taken = {run.run_id.casefold() for run in runs}
    numbered = [fullmatch(r"(\D*)(\d+)", run.run_id) for run in runs if not run.is_warm_up]
    prefixes = {found[1] if found else None for found in numbered}
    prefix = prefixes.pop() if len(prefixes) == 1 else None
    first = 1 + max((int(found[2]) for found in numbered if found), default=0) if prefix is not None else len(runs) + 1
    named = (numbered_run_id(each) if prefix is None else f"{prefix}{each}" for each in count(first))
    return (run_id for run_id in named if run_id.casefold() not in taken)


def _plain(factors: Sequence[Factor]) -> dict[str, list[Any]]:
    return {factor.name: list(map(plain_treatment, factor.treatments)) for factor in factors}


def described_design(model: RunTableModel) -> dict[str, Any]:
    """Return a design for the manifest: factors, ranges, repetitions, order, warm-up runs, batches.

    Designs other than the full factorial have `parameters` and `facts`, too.
    """
    design: dict[str, Any] = {
        "factors": {factor.name: list(factor.texts) for factor in model.factors},
        "repetitions": model.repetitions,
        "shuffle": model.shuffle,
        "blocks": model.blocks,
    }
    if not model.is_full_factorial:
        design["parameters"] = dict(model.design.as_mapping())
        design["facts"] = dict(model.design_facts)
    if ranges := {factor.name: factor.range.in_words for factor in model.factors if factor.range is not None}:
        design["ranges"] = ranges
    if model.warm_up is not None:
        design["warm_up"] = asdict(model.warm_up)
    if model.is_extended:
        design["batches"] = [batch.summary() for batch in model.batches]
    return design
