"""How fast a simulator's time goes."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, Any

import pytest

from robot_runner.core.errors import LinkError
from robot_runner.plugins.systems import Simulation
from robot_runner.ros.simulators import watched_time
from robot_runner.ros.simulators.watched_time import WatchedTime
from robot_runner.testing import FakeClock, FakeLinks, FakeRobotLink, make_context

if TYPE_CHECKING:
    from pathlib import Path


@pytest.mark.parametrize(("stands_from", "factor", "slowest"), [(99.0, 1.0, 1.0), (4.0, 0.4, 0.0)])
def test_a_simulator_that_tells_no_time_any_more_has_stood_still_since(
    monkeypatch: pytest.MonkeyPatch, stands_from: float, factor: float, slowest: float
) -> None:
    clock = FakeClock()
    link = FakeRobotLink(clock)
    monkeypatch.setattr(watched_time.time, "monotonic", clock.now)

    def tell() -> None:
        now = clock.now()
        if now < stands_from:
            link.deliver("/clock", {"clock": {"sec": int(now), "nanosec": round(now % 1 * 1e9)}})

    clock.every(0.1, tell)
    told: list[Any] = []
    watched = WatchedTime(link, lambda *times: told.append(times))
    watched.begin()
    clock.sleep(10.0)
    watched.end()
    watched.close()
    assert watched.factor == pytest.approx(factor, abs=0.03)
    assert watched.slowest == pytest.approx(slowest, abs=0.2)
    assert not told


@pytest.mark.parametrize("reset", ["simulation", "world"])
def test_a_simulator_whose_time_is_soon_past_that_of_before_the_reset_was_reset_all_the_same(
    tmp_path: Path, reset: str
) -> None:
    clock = FakeClock()
    is_over = threading.Event()

    def tell(seconds: int) -> None:
        link.deliver("/clock", {"clock": {"sec": seconds, "nanosec": 0}})

    def begin_again(_: Any) -> dict[str, Any]:
        for seconds in (0, 5):
            tell(seconds)
        return {}

    def stand_there() -> None:
        pose = {"position": {"x": 0.0, "y": 0.0}, "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}
        while not is_over.wait(0.005):
            link.deliver("/odom", {"pose": {"pose": pose}})

    def unpaused(_: Any) -> dict[str, Any]:
        if not link.calls[1:]:  # a simulator that was started two seconds before
            tell(2)
        return {}

    services = {f"/{service}": unpaused for service in ("unpause_physics", "pause_physics")}
    link = FakeRobotLink(clock, services={**services, f"/reset_{reset}": begin_again})
    link.known_topics = {"/clock": "rosgraph_msgs/Clock", "/odom": "nav_msgs/Odometry"}
    plugin = Simulation(reset=reset, timeout_s=1.0)
    context = make_context(tmp_path, plugin, robot="dds", links=FakeLinks(robot=link), clock=clock)
    telling = threading.Thread(target=stand_there)
    telling.start()
    try:
        if reset == "simulation":
            plugin.start_run(context)
        else:
            with pytest.raises(LinkError, match=r"took the simulator's time back from 2\.000 s to 0\.000 s"):
                plugin.start_run(context)
    finally:
        is_over.set()
        telling.join()
