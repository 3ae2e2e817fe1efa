"""The original of a replication: what the checks and the loading of its config take over from it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from typing import Any


@dataclass(frozen=True, slots=True, kw_only=True)
class Original:
    """What is known of an original.

    Attributes:
        run_table: its run table, which lists the runs of a design that is too large to be planned.
        treatments: the facts of the treatments that were made for it, by the name of their maker.
        seed: of its order, for a dialect that arranges runs while it loads a config.
        seed_is_given: whether its config gave the seed.
    """

    run_table: Path
    treatments: Mapping[str, Any]
    seed: int
    seed_is_given: bool


_ORIGINAL: ContextVar[Original | None] = ContextVar("_ORIGINAL", default=None)


@contextmanager
def replicating(original: Original) -> Iterator[None]:
    """Have configs loaded and checked as those of replications of an original, for a while."""
    token = _ORIGINAL.set(original)
    try:
        yield
    finally:
        _ORIGINAL.reset(token)


def replicated_original() -> Original | None:
    """Return the original of what is being replicated; None if nothing is."""
    return _ORIGINAL.get()
