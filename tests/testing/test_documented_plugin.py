"""The profiler of the documentation passes the contract that the documentation asks it to pass."""

from __future__ import annotations

import re
from pathlib import Path

PAGE = Path(__file__).parents[2] / "docs" / "write-a-plugin.md"
_BLOCKS = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
_names: dict[str, type] = {}
for _block in _BLOCKS:
    if "class BatteryVoltage(" in _block or "class TestBatteryVoltage(" in _block:
        exec(_block, _names)  # noqa: S102 - our own documentation

TestBatteryVoltage = _names["TestBatteryVoltage"]
