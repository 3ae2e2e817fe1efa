"""Cases of a parametrised test that are executed less often: docs/decisions/0071-long-tests-have-a-mark.md."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable

__all__ = ["long_but", "soak_but"]


def long_but(short: Collection[Any], cases: Iterable[Any]) -> list[Any]:
    """Return the cases, marked `long` but for the short ones, which have to be among them."""
    return _marked_but(short, cases, pytest.mark.long)


def soak_but(always: Collection[Any], cases: Iterable[Any]) -> list[Any]:
    """Return the cases, marked `soak` but for those that CI executes always, which have to be among them."""
    return _marked_but(always, cases, pytest.mark.soak)


def _marked_but(others: Collection[Any], cases: Iterable[Any], mark: pytest.MarkDecorator) -> list[Any]:
    every = list(cases)
    assert all(each in every for each in others), f"{others} are not all among the cases"
    return [each if each in others else pytest.param(each, marks=mark) for each in every]
