"""What the gateway tells the orchestrator, from its event loop."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
from typing import Any

#: How long the last replies may take, s.
_FLUSHED = 5.0


class Replies:
    """What is told to the orchestrator; never waited for, as it may be busy with a callback of a user.

    Args:
        descriptor: of the pipe.
    """

    def __init__(self, descriptor: int) -> None:
        os.set_blocking(descriptor, False)
        self._descriptor = descriptor
        self._pending = bytearray()
        self._is_sent = asyncio.Event()
        self._is_sent.set()

    def tell(self, kind: str, fields: dict[str, Any]) -> None:
        """Send one reply, once the pipe takes it."""
        was_empty = not self._pending
        self._pending += json.dumps([kind, fields]).encode() + b"\n"
        if was_empty:
            self._write()

    async def flushed(self) -> None:
        """Wait, but not for ever, until everything is sent."""
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(self._is_sent.wait(), _FLUSHED)

    def _write(self) -> None:
        loop = asyncio.get_running_loop()
        try:
            sent = os.write(self._descriptor, self._pending)
        except BlockingIOError:
            sent = 0
        except OSError:  # nobody reads any more
            sent = len(self._pending)
        del self._pending[:sent]
        if self._pending:
            self._is_sent.clear()
            loop.add_writer(self._descriptor, self._write)
        else:
            self._is_sent.set()
            loop.remove_writer(self._descriptor)
