"""Links to graphs are opened by name, each from its own module, and their clock can be chosen."""

from __future__ import annotations

import sys
from types import ModuleType, SimpleNamespace

import pytest

from robot_runner.core.errors import LinkError
from robot_runner.core.events.context import SystemClock
from robot_runner.core.events.resources import Resources
from robot_runner.core.links.connect import connect_robot, link_findings, lives_by_simulation, open_clock
from robot_runner.core.links.robot import Encoding, RawMessage
from robot_runner.core.links.robot_name import RobotName
from robot_runner.ros import graph_links
from robot_runner.ros.graph_clock import GraphClock
from robot_runner.ros.graph_links import DDS, GRAPH_LINKS, ROS1, ROSBRIDGE
from robot_runner.testing import FakeClock, FakeLinks, FakeRobotLink, make_context


class Opening(ModuleType):
    """Stands where a link is opened, and notes how."""

    def __init__(self):
        super().__init__("opening")
        self.opened = []
        self.link = FakeRobotLink(FakeClock())
        for link in GRAPH_LINKS.values():
            setattr(self, f"open_{link.transport}_link", self.open)
            setattr(self, f"check_{link.transport}", self.check)

    def open(self, options, clock, namespace):
        self.opened.append((options, namespace))
        return self.link

    def check(self, name):
        self.opened.append(name)
        return []


@pytest.fixture
def opening(monkeypatch):
    module = Opening()
    monkeypatch.setattr(graph_links, "import_module", lambda _: module)
    return module


def name_of(text):
    return RobotName.parse(text)


@pytest.mark.parametrize("robot", ["ros1", "ros2", "dds"])
def test_a_link_gets_its_options_without_those_of_the_run(opening, robot):
    kind = GRAPH_LINKS[robot]
    kind.open(name_of(f"{robot}:domain=7,clock=system"), SystemClock(), "/alice")
    assert opening.opened == [({"domain": "7"}, "/alice")]
    assert kind.findings(name_of(f"{robot}:clock=system")) == []
    assert opening.opened[-1] == RobotName(robot)


def test_a_rosbridge_gets_its_address(opening):
    ROSBRIDGE.open(name_of("rosbridge://robot:9090/a?ros=1"), SystemClock())
    assert opening.opened == [("rosbridge://robot:9090/a?ros=1", "")]


def test_a_rosbridge_without_an_address_is_refused():
    (finding,) = link_findings("rosbridge")
    assert "rosbridge://robot:9090" in finding.fix


def test_an_address_of_another_link_is_refused():
    (finding,) = link_findings("dds://robot:9090")
    assert finding.is_error
    assert "'dds://robot:9090'" in finding.problem


def test_the_clock_is_this_machine_s_unless_the_graph_s_is_asked_for(opening):
    assert not DDS.follows_graph_clock(name_of("dds"))
    assert not ROS1.follows_graph_clock(name_of("ros1:clock=system"))
    assert DDS.follows_graph_clock(name_of("dds:clock=graph"))
    with pytest.raises(LinkError, match="'wall'") as caught:
        DDS.follows_graph_clock(name_of("dds:clock=wall"))
    assert "clock=graph" in caught.value.fix


def _tell_nine(link):
    nine = RawMessage(bytes([0, 1, 0, 0, 9, 0, 0, 0, 0, 0, 0, 0]), 0)
    link.encoding, link.subscribe_raw = Encoding.CDR, lambda topic, kind, callback: callback(nine) or print


def test_a_run_on_the_graph_s_clock_shares_its_link_with_the_robot(opening, tmp_path, monkeypatch):
    _tell_nine(opening.link)
    resources = Resources()
    clock = open_clock("dds:clock=graph", resources, 1)
    assert isinstance(clock, GraphClock)
    assert clock.now() == 9.0
    assert resources.open("robot /", lambda: None) is opening.link


def test_a_run_on_the_graph_s_clock_commands_the_robot_that_is_named_and_no_other(opening, tmp_path):
    _tell_nine(opening.link)
    opening.master_of = lambda options: SimpleNamespace(parameter=lambda name: True)  # as a master of ROS 1 says
    for robot in ("dds:clock=graph,namespace=/alice", "ros1://alice"):
        opening.opened.clear()
        context = make_context(tmp_path, robot=robot, links=FakeLinks())
        open_clock(robot, context.resources, 1)
        assert connect_robot(context) is opening.link
        assert [namespace.strip("/") for _, namespace in opening.opened] == ["alice"]


def test_what_is_measured_on_a_real_computer_does_not_live_by_a_graph_s_clock(tmp_path):
    clock = GraphClock(FakeRobotLink(FakeClock()))
    assert lives_by_simulation(make_context(tmp_path, robot="dds", clock=clock))
    assert not lives_by_simulation(make_context(tmp_path, robot="dds", clock=SystemClock()))


@pytest.mark.parametrize("robot", sorted(GRAPH_LINKS))
def test_asking_what_stands_in_the_way_loads_no_client_library(robot):
    import subprocess

    address = "://127.0.0.1:9" if robot == "rosbridge" else ""
    program = (
        "import sys\n"
        "from robot_runner.core.links.connect import link_findings\n"
        f"link_findings({robot + address!r})\n"
        "print([name for name in ('rospy', 'rclpy', 'cyclonedds', 'websockets') if name in sys.modules])"
    )
    said = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=60)
    assert said.stdout.strip() == "[]"
