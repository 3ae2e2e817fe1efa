"""The link through a rosbridge keeps what every link to a graph promises, with both generations of ROS, and by TLS."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from tests.ros.test_rosbridge_security import Authority, server_context

from robot_runner.core.events.context import SystemClock
from robot_runner.ros.link_opening import open_rosbridge_link
from robot_runner.testing.graph_link_contract import GraphLinkContract
from robot_runner.testing.rosbridge_server import RosbridgeServer

if TYPE_CHECKING:
    from robot_runner.core.links.robot import RobotLink


class _RosbridgeContract(GraphLinkContract):
    generation: ClassVar[int]

    def setup_method(self) -> None:
        self.server = RosbridgeServer(generation=self.generation)
        self.url = self.server.url

    def teardown_method(self) -> None:
        self.server.close()

    def make_link(self, namespace: str = "") -> RobotLink:
        return open_rosbridge_link(self.url, SystemClock(), namespace)


class TestRosbridgeToRos1(_RosbridgeContract):
    generation = 1


class TestRosbridgeToRos2(_RosbridgeContract):
    generation = 2
    can_reject = False


class TestRosbridgeByTls(TestRosbridgeToRos2):
    def setup_method(self) -> None:
        self.folder = tempfile.TemporaryDirectory()
        lab = Authority(Path(self.folder.name))
        self.server = RosbridgeServer(generation=2, tls=server_context(lab.certificate("robot", "127.0.0.1")))
        self.url = f"{self.server.url}?ca={lab.ca}"

    def teardown_method(self) -> None:
        super().teardown_method()
        self.folder.cleanup()
