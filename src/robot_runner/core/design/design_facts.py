"""A design as plain data: what the manifest and a registration say of it."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from robot_runner.core.design.run_table_model import RunTableModel


def described_design(model: RunTableModel) -> dict[str, Any]:
    """Return what the manifest says of a design: factors, repetitions, order, warm-up runs, batches.

    `parameters` and `facts` are there where the design is another than the full factorial.
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
    if model.warm_up is not None:
        design["warm_up"] = asdict(model.warm_up)
    if model.is_extended:
        design["batches"] = [batch.summary() for batch in model.batches]
    return design
