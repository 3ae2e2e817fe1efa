"""A DDS domain on loopback for each worker of a test run, so that runs at the same time do not hear each other."""

from __future__ import annotations

import os
import socket

__all__ = ["LOOPBACK", "claim_domain"]

#: Cyclone DDS on loopback alone; discovery goes by multicast there too.
LOOPBACK = (
    "<CycloneDDS><Domain><General><Interfaces><NetworkInterface name='lo' multicast='true'/></Interfaces></General>"
    "</Domain></CycloneDDS>"
)


def claim_domain() -> int:
    """Return a domain that no other process has claimed; it is kept until this process ends.

    A claim is an abstract socket's name, which the system frees with the process. The ports of a domain begin at 7400 +
    250 times its number (DDSI-RTPS 9.6.1.1). From 102 on they are among those that Linux gives to whoever asks for any.
    """
    for number in range(99):
        domain = 1 + (number + os.getpid()) % 99
        claim = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        try:
            claim.bind(f"\0robot-runner-dds-domain-{domain}")
        except OSError:
            claim.close()
        else:
            claim.detach()  # it stays open, and nobody warns of that when the process ends
            return domain
    raise AssertionError("all domains are claimed")
