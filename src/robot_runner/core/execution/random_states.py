"""What random numbers a run begins with.

A forked run inherits the generators that modules have for all. Python's `random` is seeded anew in each forked process;
NumPy's and PyTorch's would yield the same numbers in every run, repetitions included.
"""

from __future__ import annotations

import random
import sys


def seed_random_numbers(run_seed: int) -> None:
    """Give the generators of `random`, and of NumPy and PyTorch where they were imported, the state of this seed.

    So a run draws the same numbers wherever and whenever it is executed, and each run draws others.

    Args:
        run_seed: of 32 bits, which is what NumPy takes.
    """
    random.seed(run_seed)
    if (numpy_random := sys.modules.get("numpy.random")) is not None:
        numpy_random.seed(run_seed)
    if (torch := sys.modules.get("torch")) is not None:
        torch.manual_seed(run_seed)
