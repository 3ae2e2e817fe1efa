"""What `robot = "dds:…"` may say, and what stands in the way of it."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
from pathlib import Path

import pytest
from tests.ros.dds_domain import claim_domain

from robot_runner.core.errors import LinkError
from robot_runner.core.links.robot_name import RobotName
from robot_runner.ros.graph_addresses import DdsSettings
from robot_runner.ros.graph_links import DDS
from robot_runner.ros.link_opening import open_dds_link


def test_options_are_read_before_the_environment():
    environment = {"ROS_DOMAIN_ID": "7", "ROS_DISTRO": "humble"}
    assert DdsSettings.of({}, environment) == DdsSettings(7, "humble")
    assert DdsSettings.of({"domain": "3", "distro": "iron"}, environment) == DdsSettings(3, "iron")
    assert DdsSettings.of({"types": "a:b"}, {}).types == (Path("a"), Path("b"))


@pytest.mark.parametrize(
    "environment", [{"ROS_LOCALHOST_ONLY": "1"}, {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}], ids=str
)
def test_discovery_reaches_as_far_as_ros_is_told(environment):
    settings = DdsSettings.of({}, environment)
    assert settings.is_local
    assert "127.0.0.1" in settings.cyclone_configuration()
    assert DdsSettings.of({}, {"ROS_LOCALHOST_ONLY": "0"}).cyclone_configuration() is None


def test_a_range_of_this_machine_leaves_named_computers_and_what_cannot_be_is_refused():
    local = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_STATIC_PEERS": "192.168.1.7"}
    configuration = DdsSettings.of({}, local).cyclone_configuration()
    assert "<AllowMulticast>false</AllowMulticast>" in configuration
    assert "<Peer address='192.168.1.7'/>" in configuration
    alone = DdsSettings.of({}, local | {"ROS_LOCALHOST_ONLY": "1"})  # Humble's goes first, and knows no peers
    assert (alone.is_local, alone.peers) == (True, ())
    told = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SYSTEM_DEFAULT", "ROS_STATIC_PEERS": "192.168.1.7"}
    assert DdsSettings.of({}, told).cyclone_configuration() is None  # rmw_cyclonedds_cpp ignores the peers, too
    with pytest.raises(LinkError, match="discovery is off") as caught:
        DdsSettings.of({}, {"ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF"})
    assert caught.value.where == "ROS_AUTOMATIC_DISCOVERY_RANGE"
    with pytest.raises(LinkError, match="'LOCALHST'") as caught:
        DdsSettings.of({}, {"ROS_AUTOMATIC_DISCOVERY_RANGE": "localhst"})
    assert "LOCALHOST" in caught.value.fix


def test_peers_are_asked_for_the_graph_and_cannot_break_out_of_the_configuration():
    settings = DdsSettings.of({}, {"ROS_STATIC_PEERS": "192.168.1.7; robot'/><x "})
    assert settings.peers == ("192.168.1.7", "robot'/><x")
    assert "<Peer address='192.168.1.7'/>" in settings.cyclone_configuration()
    assert "<x" not in settings.cyclone_configuration()


TWO_LINKS = """
import os, time
from robot_runner.core.events.context import SystemClock
from robot_runner.ros.link_opening import open_dds_link
links = [open_dds_link({"domain": os.environ["DOMAIN"], "distro": "humble"}, SystemClock(), "") for _ in range(2)]
received, deadline = [], time.monotonic() + 60
links[0].subscribe("chatter", "std_msgs/String", received.append)
while not received and time.monotonic() < deadline:
    links[1].publish("chatter", "std_msgs/String", {"data": "here"})
    time.sleep(0.05)
print(received[0]["data"], os.environ["CYCLONEDDS_URI"])
for link in links: link.close()
"""


@pytest.mark.long
@pytest.mark.parametrize(
    ("told", "sign"),
    [
        ({"ROS_LOCALHOST_ONLY": "1"}, 'NetworkInterface address="127.0.0.1"'),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_STATIC_PEERS": "127.0.0.1"}, "<AllowMulticast>false<"),
    ],
    ids=["localhost only", "range and peer"],
)
def test_two_links_of_this_machine_alone_reach_each_other(told, sign):
    environment = {name: value for name, value in os.environ.items() if name != "CYCLONEDDS_URI"}
    environment |= {**told, "DOMAIN": str(claim_domain())}
    done = subprocess.run(
        [sys.executable, "-c", TWO_LINKS], check=False, env=environment, capture_output=True, text=True, timeout=120
    )
    assert done.stdout.startswith("here "), done.stderr
    assert sign in done.stdout


def test_a_ros_1_that_is_sourced_says_nothing_of_the_graph():
    assert DdsSettings.of({}, {"ROS_DISTRO": "noetic", "ROS_DOMAIN_ID": ""}) == DdsSettings(0, None)


@pytest.mark.parametrize("domain", ["233", "-1", "seven", "1.5", "٣"])
def test_a_domain_id_that_cannot_be_is_refused_where_it_was_said(domain):
    with pytest.raises(LinkError) as caught:
        DdsSettings.of({"domain": domain}, {})
    assert caught.value.where == "robot"
    with pytest.raises(LinkError) as caught:
        DdsSettings.of({}, {"ROS_DOMAIN_ID": domain})
    assert caught.value.where == "ROS_DOMAIN_ID"


@pytest.mark.parametrize(
    ("name", "problem"),
    [
        ("dds:domian=3", "Did you mean 'domain'"),
        ("dds:distro=jazy", "Did you mean 'jazzy'"),
        ("dds:types=/no/such/folder", "there is no such file or folder"),
        ("dds:domain=999", "the domain id is '999'"),
        ("dds:domain=010", "the domain id is '010'"),  # programs of ROS take it for 8
    ],
)
def test_what_stands_in_the_way_is_found_without_opening_anything(name, problem):
    (finding,) = DDS.findings(RobotName.parse(name))
    assert finding.is_error
    assert problem in str(finding)


def test_nothing_stands_in_the_way_of_what_can_be():
    assert DDS.findings(RobotName.parse("dds:domain=3,distro=humble")) == []


def test_a_missing_package_is_named_with_its_extra(monkeypatch):
    there = importlib.util.find_spec
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None if name == "cyclonedds" else there(name))
    (finding,) = DDS.findings(RobotName.parse("dds"))
    assert "cyclonedds cannot be imported" in finding.problem
    assert "robot-runner[dds]" in finding.fix


def test_a_network_interface_that_is_not_there_is_an_error_that_names_the_setting(monkeypatch):
    monkeypatch.setenv("CYCLONEDDS_URI", "<General><Interfaces><NetworkInterface name='nix0'/></Interfaces></General>")
    with pytest.raises(LinkError, match="CYCLONEDDS_URI"):
        open_dds_link({"domain": "99"}, None)


@pytest.mark.long
def test_nothing_of_dds_is_loaded_before_a_link_is_opened():
    script = (
        "import sys; from robot_runner.ros.graph_links import DDS; "
        "from robot_runner.core.links.robot_name import RobotName; DDS.findings(RobotName.parse('dds')); "
        "sys.exit('cyclonedds' in sys.modules)"
    )
    subprocess.run([sys.executable, "-c", script], check=True, timeout=30)
