from __future__ import annotations

from tests.core.execution.conftest import execute

__all__ = ["execute"]
