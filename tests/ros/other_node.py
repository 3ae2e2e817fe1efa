"""A node of another process, which knows nothing of ours and tells in lines of JSON what it sees."""

from __future__ import annotations

import json
import queue
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["OtherNode"]


class OtherNode:
    """The other process, which a file beside this one is; what it says is looked through with a deadline."""

    def __init__(self, script: str, argument: str) -> None:
        command = [sys.executable, str(Path(__file__).with_name(script)), argument]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        self.said: queue.Queue[dict[str, Any]] = queue.Queue()
        self.reader = threading.Thread(target=self._read, daemon=True)
        self.reader.start()
        self.until(lambda fact: "ready" in fact)

    def _read(self) -> None:
        for line in self.process.stdout or ():
            self.said.put(json.loads(line))

    def until(self, is_so: Callable[[dict[str, Any]], bool], timeout: float = 60.0) -> dict[str, Any]:
        deadline = time.monotonic() + timeout
        while True:
            fact = self.said.get(timeout=max(0.01, deadline - time.monotonic()))
            if is_so(fact):
                return fact

    def close(self) -> None:
        self.process.terminate()
        self.process.wait(60)
        self.reader.join(60)
        if self.process.stdout is not None:
            self.process.stdout.close()
