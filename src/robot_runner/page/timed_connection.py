"""A connection of the live page, which is closed where nothing is asked in it, so that many keep nobody else out."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from uvicorn.protocols.http.h11_impl import H11Protocol

if TYPE_CHECKING:
    import asyncio


class TimedConnection(H11Protocol):
    """uvicorn's connection, which it closes itself where nothing comes after a response.

    This one is also closed where no first request comes, or one that never ends: header by header, or without its body.
    """

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]  # as uvicorn's
        """Begin to look for requests."""
        super().connection_made(transport)
        self._look_later()

    def _look_later(self) -> None:
        self.loop.call_later(self.timeout_keep_alive, self._close_if_idle, self.cycle)

    def _close_if_idle(self, before: Any) -> None:
        """Close it where no request has come since the last look, and none is being answered."""
        if self.transport.is_closing():
            return
        is_answering = before is not None and not before.more_body and not before.response_complete
        if self.cycle is before and not is_answering:
            self.transport.close()  # unlike `abort`, it sends the rest of a response to a slow reader
        else:
            self._look_later()
