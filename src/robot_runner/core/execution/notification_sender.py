"""Sends one notification to one address, through apprise, in a process of its own.

`python -m robot_runner.core.execution.notification_sender` reads a JSON object from its input: `address`, `title`,
`body`, `kind` and `deadline` (s). Exit code 0: the service has taken it; 1: it has not. The system ends the process at
the deadline.
"""

from __future__ import annotations

import json
import os
import signal
import sys


def send(address: str, title: str, body: str, kind: str) -> bool:
    """Send a notification; return whether the service has taken it."""
    import apprise  # noqa: PLC0415 - an extra, which only this process needs

    service = apprise.Apprise()
    return bool(service.add(address) and service.notify(body=body, title=title, notify_type=apprise.NotifyType(kind)))


def _send_requested() -> bool:
    request = json.loads(sys.stdin.read())
    signal.setitimer(signal.ITIMER_REAL, request["deadline"])  # its signal ends the process, whatever it waits for
    return send(request["address"], request["title"], request["body"], request["kind"])


if __name__ == "__main__":
    _code = 1
    try:
        _code = 0 if _send_requested() else 1
    finally:
        os._exit(_code)  # a thread of a library must not keep it alive
