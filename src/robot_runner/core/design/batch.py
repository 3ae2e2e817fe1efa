"""Batches of runs, as the journal keeps them: those of the first plan, and those added to an experiment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import isfinite
from types import MappingProxyType
from typing import Any, Self

from robot_runner.core.design.factor import texts_of
from robot_runner.core.design.planned_runs import PlannedRun, RunOrder

#: The role of a batch that confirms what earlier runs have found.
CONFIRMATION = "confirmation"

_PLAIN = (bool, int, float, str, type(None))


@dataclass(frozen=True, slots=True)
class BatchRun:
    """A run of a batch, as the journal keeps it: treatments as texts, by factor; repetition 0 for a warm-up run."""

    run_id: str
    treatments: Mapping[str, str]
    repetition: int = 1
    block: int | None = None

    @property
    def is_warm_up(self) -> bool:
        """Whether it only warms up."""
        return self.repetition == 0

    @classmethod
    def of(cls, run: PlannedRun) -> Self:
        """Return the record of a planned run."""
        return cls(run.run_id, texts_of(run.combination), run.repetition, run.block)

    def as_mapping(self) -> dict[str, Any]:
        """Return the run as plain data, without defaults."""
        return {
            "run": self.run_id,
            "combination": dict(self.treatments),
            "repetition": self.repetition,
            **({"block": self.block} if self.block is not None else {}),
        }

    @classmethod
    def of_mapping(cls, plain: Mapping[str, Any]) -> Self:
        """Return the run that `as_mapping` made plain."""
        return cls(plain["run"], plain["combination"], int(plain["repetition"]), plain.get("block"))


@dataclass(frozen=True, slots=True, kw_only=True)
class Batch:
    """Runs that were planned together: those of the first plan, or those of an extension.

    Attributes:
        number: from 1, which is the first plan.
        order: of its runs, with the seed.
        repetitions: how often each combination is executed from this batch on, all batches together.
        factors: all factors with all treatments from this batch on, in order, by `plain_treatment`.
        chosen: the treatments among them that were added on the command line, so that a config need not have them.
        defaults: for each factor that this batch added, the treatment that is assumed for earlier runs, as text.
        confirms: whether it confirms what earlier runs of an adaptive design have found.
        added: what was added to it while the experiment was executed, such as `repetition 4`, with the ids of its runs.
        runs: in the order of execution.
        at: when the batch was added (UTC); empty for the first plan.
    """

    number: int
    order: RunOrder
    repetitions: int
    factors: Mapping[str, Sequence[Any]]
    runs: Sequence[BatchRun]
    chosen: Mapping[str, Sequence[str]] = field(default_factory=lambda: MappingProxyType({}))
    defaults: Mapping[str, str] = field(default_factory=lambda: MappingProxyType({}))
    at: str = ""
    confirms: bool = False
    added: tuple[tuple[str, tuple[str, ...]], ...] = ()

    @property
    def run_ids(self) -> list[str]:
        """The ids of the runs that count: warm-up runs are left out."""
        return [run.run_id for run in self.runs if not run.is_warm_up]

    def as_mapping(self) -> dict[str, Any]:
        """Return the batch as plain data, for a record of the journal."""
        return {
            **self.summary(),
            "factors": {name: list(treatments) for name, treatments in self.factors.items()},
            "runs": [run.as_mapping() for run in self.runs],
        }

    def summary(self) -> dict[str, Any]:
        """Return the batch without its runs as plain data, for the manifest."""
        ids = self.run_ids
        return {
            "batch": self.number,
            "runs": len(ids),
            "first": ids[0] if ids else None,
            "last": ids[-1] if ids else None,
            "warm_ups": len(self.runs) - len(ids),
            "seed": self.order.seed,
            "shuffle": self.order.shuffle,
            "blocks": self.order.blocks,
            "repetitions": self.repetitions,
            **({"chosen": {name: list(texts) for name, texts in self.chosen.items()}} if self.chosen else {}),
            **({"defaults": dict(self.defaults)} if self.defaults else {}),
            **({"role": CONFIRMATION} if self.confirms else {}),
            **({"at": self.at} if self.at else {}),
        }

    @classmethod
    def of_mapping(cls, plain: Mapping[str, Any]) -> Self:
        """Return the batch that `as_mapping` made plain."""
        return cls(
            number=int(plain["batch"]),
            order=RunOrder(
                shuffle=bool(plain["shuffle"]), blocks=plain.get("blocks"), seed=int(plain["seed"]), seed_is_given=True
            ),
            repetitions=int(plain["repetitions"]),
            factors=plain["factors"],
            runs=[BatchRun.of_mapping(run) for run in plain["runs"]],
            chosen=plain.get("chosen", {}),
            defaults=plain.get("defaults", {}),
            at=str(plain.get("at", "")),
            confirms=plain.get("role") == CONFIRMATION,
        )


def plain_treatment(treatment: Any) -> Any:
    """Return a treatment as a value of JSON; for an object of a user's, or infinity, its text."""
    is_plain = type(treatment) in _PLAIN and (type(treatment) is not float or isfinite(treatment))
    return treatment if is_plain else {"text": str(treatment)}
