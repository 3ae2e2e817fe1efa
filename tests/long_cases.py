"""Cases of a parametrised test of which most have the mark `long`: docs/decisions/0071-long-tests-have-a-mark.md."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable

__all__ = ["long_but"]


def long_but(short: Collection[Any], cases: Iterable[Any]) -> list[Any]:
    """Return the cases, marked `long` but for the short ones, which have to be among them."""
    every = list(cases)
    assert all(each in every for each in short), f"{short} are not all among the cases"
    return [each if each in short else pytest.param(each, marks=pytest.mark.long) for each in every]
