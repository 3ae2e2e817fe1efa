"""The contract of robot links, held over DDS on loopback."""

from __future__ import annotations

import pytest
from tests.ros.dds_domain import LOOPBACK, claim_domain

from robot_runner.core.events.context import SystemClock
from robot_runner.ros.link_opening import open_dds_link
from robot_runner.testing.graph_link_contract import GraphLinkContract

_DOMAIN = claim_domain()


class TestDdsLink(GraphLinkContract):
    @pytest.fixture(autouse=True)
    def _loopback(self, monkeypatch):
        monkeypatch.setenv("CYCLONEDDS_URI", LOOPBACK)
        # On loopback everybody is discovered within milliseconds; what is not there need not be waited for.
        monkeypatch.setattr("robot_runner.ros.dds_session.SETTLING", 0.25)
        monkeypatch.setattr("robot_runner.ros.dds_session.FINDING", 0.0)

    def make_link(self, namespace=""):
        return open_dds_link({"domain": str(_DOMAIN), "distro": "jazzy"}, SystemClock(), namespace)
