"""A driver of Joulescopes, with the methods and the statistics of the maker's own."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable

    from robot_runner.testing import FakeClock


class FakeDriver:
    """Stands in for `pyjoulescope_driver.Driver`; its instruments live by a test's clock.

    Attributes:
        paths: of the instruments that are connected.
        watts: what they measure, W at a time of the clock.
        published: topics and values, in order.
        counted: what the energy counter tells of the joules that it has counted, J.
        is_silent: whether no statistics come any more.
        is_finalized: whether it was let go of.
    """

    def __init__(self, clock: FakeClock, paths: list[str], watts: Callable[[float], float] = lambda _: 8.0) -> None:
        self.clock, self.paths, self.watts = clock, paths, watts
        self.published: list[tuple[str, Any]] = []
        self.opened: set[str] = set()
        self.is_silent = self.is_finalized = False
        self.joules = 500.0
        self.counted: Callable[[float], float] = lambda joules: joules
        self._beats: list[Any] = []

    def device_paths(self, timeout=None) -> list[str]:
        return self.paths

    def open(self, device_prefix, mode=None, timeout=None) -> None:
        assert device_prefix in self.paths
        self.opened.add(device_prefix)

    def close(self, device_prefix, timeout=None) -> None:
        for beat in self._beats:
            beat.close()
        self.opened.remove(device_prefix)

    def publish(self, topic: str, value, timeout=None) -> None:
        assert topic.rpartition("/s/")[0] in self.opened
        self.published.append((topic, value))

    def subscribe(self, topic: str, flags, fn, timeout=None) -> None:
        assert flags == "pub"
        path = topic.removesuffix("/s/stats/value")
        count = dict(self.published)[f"{path}/s/stats/scnt"]
        assert dict(self.published)[f"{path}/s/stats/ctrl"] in {1, "on"}
        period = count / (2_000_000 if "js110" in path else 1_000_000)

        def beat() -> None:
            end = self.clock.now()
            watts = sum(self.watts(end - period * (step + 0.5) / 100) for step in range(100)) / 100
            self.joules += watts * period
            if not self.is_silent:
                fn(topic, self._statistics(watts))

        self._beats.append(self.clock.every(period, beat))

    def finalize(self, timeout=None) -> None:
        self.is_finalized = True

    def _statistics(self, watts: float) -> dict[str, Any]:
        def signal(value: float, units: str) -> dict[str, Any]:
            return {name: {"value": value, "units": units} for name in ("avg", "std", "min", "max")}

        return {
            "time": {"range": {"value": [0.0, 0.1], "units": "s"}, "delta": {"value": 0.1, "units": "s"}},
            "signals": {"current": signal(watts / 12, "A"), "voltage": signal(12.0, "V"), "power": signal(watts, "W")},
            "accumulators": {
                "charge": {"value": 1.0, "units": "C"},
                "energy": {"value": self.counted(self.joules), "units": "J"},
            },
        }
