"""Seeded noise: a stream of its own for each source, so that no source's noise depends on who else is listened to."""

from __future__ import annotations

import zlib

import numpy as np

__all__ = ["NoiseStreams"]

_SEED_BITS = 64


class NoiseStreams:
    """The random streams of one robot, by name.

    Example:
        >>> streams = NoiseStreams(7, "/alice")
        >>> streams.named("imu").random() == NoiseStreams(7, "/alice").named("imu").random()
        True
    """

    def __init__(self, seed: int, namespace: str) -> None:
        self._entropy = (seed % 2**_SEED_BITS, zlib.crc32(namespace.encode()))

    def named(self, name: str) -> np.random.Generator:
        """Return the stream of this name from its beginning."""
        return np.random.default_rng([*self._entropy, zlib.crc32(name.encode())])
