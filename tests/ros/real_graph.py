"""A real graph of this test run, over each link, and which links a test is executed on in `make test`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest
from tests.ros.dds_domain import LOOPBACK, claim_domain
from tests.ros.ros1_master import needs_ros1

if TYPE_CHECKING:
    from collections.abc import Sequence

_MARKS = {"ros1": [needs_ros1], "dds": [], "ros2": [pytest.mark.ros2], "rosbridge": []}


def over(*links: str, soak: Sequence[str] = ()) -> pytest.MarkDecorator:
    """Execute a test that takes `graph` over these links, and over others in `make soak` only.

    What holds over one link holds over all: tests/ros executes the contract of links over each. A whole experiment on
    a real graph takes half a minute, so that only what protects a robot is executed over several of them every time.
    """
    marks = {link: _MARKS[link] for link in links} | {link: [*_MARKS[link], pytest.mark.soak] for link in soak}
    params = [pytest.param(link, marks=each) for link, each in marks.items()]
    return pytest.mark.parametrize("graph", params, indirect=True)


def over_pairs(
    name: str, values: Sequence[Any], first: str, *others: str, everywhere: Sequence[Any] = ()
) -> pytest.MarkDecorator:
    """Execute a test that takes `graph` and `name` with each value over the first link.

    Those of `everywhere` are executed over the other links as well, and other pairs in `make soak` only: a link does
    not change what becomes of each of ten deaths, and every pair would take CI a quarter of an hour.
    """
    pairs = [(link, value) for link in (first, *others) for value in values]
    soaks = [link != first and value not in everywhere for link, value in pairs]
    params = [
        pytest.param(*pair, marks=[*_MARKS[pair[0]], *[pytest.mark.soak] * is_soak])
        for pair, is_soak in zip(pairs, soaks, strict=True)
    ]
    return pytest.mark.parametrize(("graph", name), params, indirect=["graph"])


@pytest.fixture
def graph(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """How a robot on a graph of this test run is reached; `over` says on which. A rosbridge is the test's own."""
    if request.param == "rosbridge":
        return "rosbridge"
    if request.param == "ros1":
        request.getfixturevalue("master_uri")
        return "ros1"
    if request.param == "dds":
        monkeypatch.setenv("CYCLONEDDS_URI", LOOPBACK)
    else:
        monkeypatch.delenv("CYCLONEDDS_URI", raising=False)
        monkeypatch.setenv("ROS_LOCALHOST_ONLY", "1")
        monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    return f"{request.param}:domain={claim_domain()}"
