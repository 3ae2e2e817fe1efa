"""The task "network": HTTP GET requests to one address."""

from __future__ import annotations

import argparse
import http.client
import sys
import time
import urllib.error
import urllib.request
from functools import partial
from typing import TYPE_CHECKING

from robot_runner_onboard.channel import serve
from robot_runner_onboard.errors import TaskError

if TYPE_CHECKING:
    from robot_runner_onboard.channel import Channel

__all__ = ["request"]

#: How long one request may take, in seconds.
_TIMEOUT = 3.0
#: So many failures in a row, and the address is taken to be gone.
_MOST_FAILURES = 3
#: So many bytes of a resource are read at a time: in between it is looked whether the task is to end.
_PART = 65536


def request(channel: Channel, address: str, rate: float) -> str:
    """Issue requests until told to end; one that is being answered then is broken off.

    Args:
        channel: to the node.
        address: of the resource, with http:// or https://.
        rate: requests a second; 0 for one after the other without a pause.

    Raises:
        TaskError: the first request failed, or several in a row did.
    """
    size = _fetched(channel, address)
    channel.ready()
    done, failed, in_a_row, begun = 1, 0, 0, time.monotonic()
    while not channel.is_over(begun + (done + failed) / rate - time.monotonic() if rate else 0.0):
        try:
            size += _fetched(channel, address)
            done, in_a_row = done + 1, 0
        except TaskError as error:  # noqa: PERF203 - each request may fail
            failed, in_a_row = failed + 1, in_a_row + 1
            if in_a_row == _MOST_FAILURES:
                raise TaskError(f"{error} (after {done} requests)") from error
    return f"{done} requests, {failed} failed, {size} bytes"


def _fetched(channel: Channel, address: str) -> int:
    """Fetch a resource, or as much of it as there is until the task is to end, and return its size in bytes."""
    size = 0
    try:
        # The scheme was checked by `parameters`.
        with urllib.request.urlopen(address, timeout=_TIMEOUT) as response:  # noqa: S310
            whole = response.length  # None: it is not told; `read1` of Python 3.8 does not count it down
            while size != whole:
                part = response.read1(_PART)
                size += len(part)
                if not part and whole is not None:
                    raise http.client.IncompleteRead(b"", whole - size)
                if not part or (size != whole and channel.is_over()):
                    break
            return size
    except urllib.error.HTTPError as error:
        error.close()
        raise TaskError(f"{address} answers {error.code} {error.reason}") from error
    except (OSError, http.client.HTTPException, ValueError) as error:
        reason = getattr(error, "reason", error)
        raise TaskError(f"{address} cannot be fetched: {reason}") from error


def _main() -> int:
    parser = argparse.ArgumentParser(prog="network")
    parser.add_argument("--address", required=True)
    parser.add_argument("--rate", type=float, required=True)
    arguments = parser.parse_args()
    return serve(partial(request, address=arguments.address, rate=arguments.rate))


if __name__ == "__main__":
    sys.exit(_main())
