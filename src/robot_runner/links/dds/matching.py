"""Who a writer or reader has found on the graph."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["matched_publications", "matched_subscriptions"]

_TRIES = 10


def matched_subscriptions(writer: Any) -> list[int]:
    """Return the handles of the readers that hear this writer."""
    return _steady(writer.get_matched_subscriptions)


def matched_publications(reader: Any) -> list[int]:
    """Return the handles of the writers that this reader hears."""
    return _steady(reader.get_matched_publications)


def _steady(ask: Callable[[], list[int]]) -> list[int]:
    # cyclonedds asks for their number, then for that many: it fails where another comes in between.
    for _ in range(_TRIES):
        try:
            return ask()
        except IndexError:
            continue
    return ask()
