"""What tests of several commands share: a small experiment and its package, made once."""

from __future__ import annotations

from tests.replication.conftest import ada, experiment, packed

__all__ = ["ada", "experiment", "packed"]
