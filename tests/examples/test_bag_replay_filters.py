"""The two implementations that the example of the bag replay compares."""

from __future__ import annotations

import importlib.util
import time
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from collections.abc import Callable

NODE = Path(__file__).parents[2] / "examples" / "bag_replay" / "scan_filter.py"


@pytest.fixture(scope="module")
def filters() -> dict[str, Callable[[list[float]], list[float]]]:
    spec = importlib.util.spec_from_file_location("scan_filter", NODE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.FILTERS


def test_both_filters_answer_the_same_and_numpy_takes_less_of_the_processor(
    filters: dict[str, Callable[[list[float]], list[float]]],
) -> None:
    ranges = [0.12 + place * 37 % 101 / 30 for place in range(360)]
    assert filters["plain"](ranges) == pytest.approx(filters["numpy"](ranges), abs=1e-6)
    # The least of many: whatever else the machine does can only add to it.
    plain, numpy = (min(_seconds(filters[each], ranges) for _ in range(30)) for each in ("plain", "numpy"))
    assert plain > numpy


def _seconds(smooth: Callable[[list[float]], list[float]], ranges: list[float]) -> float:
    """Return how long a filter takes of this thread's processor time, s."""
    begun = time.thread_time()
    smooth(ranges)
    return time.thread_time() - begun
