"""A TCP port of loopback that is this process' own until it ends."""

from __future__ import annotations

import os
import socket

__all__ = ["claim_port"]

#: Below the ports that Linux gives to whoever asks for any (/proc/sys/net/ipv4/ip_local_port_range): no connection and
#: no other test's server takes one between its choice here and the start of the program that listens at it.
_PORTS = range(12_000, 31_000)


def claim_port() -> int:
    """Return a port that nobody listens at and no other process has claimed; it is kept until this process ends.

    A claim is an abstract socket's name, which the system frees with the process.
    """
    for number in range(len(_PORTS)):
        port = _PORTS[(os.getpid() * 101 + number) % len(_PORTS)]
        claim = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        try:
            claim.bind(f"\0robot-runner-port-{port}")
            with socket.socket() as probe:
                probe.bind(("127.0.0.1", port))
        except OSError:
            claim.close()
        else:
            claim.detach()  # it stays open, and nobody warns of that when the process ends
            return port
    raise AssertionError("all ports are claimed")
