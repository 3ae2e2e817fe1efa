"""A subject that is a node of the run's graph: it is ready once its node, its topic and its life cycle are."""

from __future__ import annotations

import sys
import time
from typing import TYPE_CHECKING

from tests.ros.dds_domain import LOOPBACK, claim_domain

from robot_runner import all_of, lifecycle_state, topic_present
from robot_runner.core.events.context import SystemClock
from robot_runner.plugins.systems import Program
from robot_runner.testing import make_context, rehearse

if TYPE_CHECKING:
    from pathlib import Path

    import pytest

#: A managed node that takes a moment to become active, and publishes a topic from then on.
NODE = """
import sys, time
from robot_runner.core.events.context import SystemClock
from robot_runner.ros.dds_link import open_dds_link
from robot_runner.ros.lifecycle import LifecycleState
from robot_runner.testing import LifecycleNode

link = open_dds_link({"domain": sys.argv[1], "distro": "jazzy"}, SystemClock())
node = LifecycleNode(link, "/slam")
begun = time.monotonic()
time.sleep(1.0)
node.state = LifecycleState.ACTIVE
link.advertise("/map", "nav_msgs/OccupancyGrid")
print(f"active after {time.monotonic() - begun:.1f} s", flush=True)
time.sleep(60)
"""


def test_it_is_ready_once_its_life_cycle_and_its_topic_are_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CYCLONEDDS_URI", LOOPBACK)
    domain = claim_domain()
    (tmp_path / "node.py").write_text(NODE)
    ready = all_of(lifecycle_state("slam"), topic_present("map", "nav_msgs/OccupancyGrid"))
    node = Program([sys.executable, str(tmp_path / "node.py"), str(domain)], name="Slam", ready=ready)
    context = make_context(tmp_path, node, robot=f"dds:domain={domain},distro=jazzy", clock=SystemClock())
    begun = time.monotonic()
    try:
        measures = rehearse(context, node)
    finally:
        context.resources.close()
    assert "active after 1" in (tmp_path / "runs" / "r_1" / "Slam" / "stdout.txt").read_text()
    assert 1.0 < measures["StartupTime"] < time.monotonic() - begun
