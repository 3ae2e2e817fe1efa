"""What `robot = "dds:…"` may say, and what stands in the way of it."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest

from robot_runner.core.errors import LinkError
from robot_runner.core.links.robot import RobotName
from robot_runner.ros.dds_link import findings, open_dds_link
from robot_runner.ros.graph_addresses import DdsSettings


def test_options_are_read_before_the_environment():
    environment = {"ROS_DOMAIN_ID": "7", "ROS_DISTRO": "humble"}
    assert DdsSettings.of({}, environment) == DdsSettings(7, "humble")
    assert DdsSettings.of({"domain": "3", "distro": "iron"}, environment) == DdsSettings(3, "iron")
    assert DdsSettings.of({"types": "a:b"}, {}).types == (Path("a"), Path("b"))


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
    ],
)
def test_what_stands_in_the_way_is_found_without_opening_anything(name, problem):
    (finding,) = findings(RobotName.parse(name))
    assert finding.is_error
    assert problem in str(finding)


def test_nothing_stands_in_the_way_of_what_can_be():
    assert findings(RobotName.parse("dds:domain=3,distro=humble")) == []


def test_a_missing_package_is_named_with_its_extra(monkeypatch):
    there = importlib.util.find_spec
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None if name == "cyclonedds" else there(name))
    (finding,) = findings(RobotName.parse("dds"))
    assert "cyclonedds cannot be imported" in finding.problem
    assert "robot-runner[dds]" in finding.fix


def test_a_network_interface_that_is_not_there_is_an_error_that_names_the_setting(monkeypatch):
    monkeypatch.setenv("CYCLONEDDS_URI", "<General><Interfaces><NetworkInterface name='nix0'/></Interfaces></General>")
    with pytest.raises(LinkError, match="CYCLONEDDS_URI"):
        open_dds_link({"domain": "99"}, None)


def test_nothing_of_dds_is_loaded_before_a_link_is_opened():
    script = (
        "import sys; from robot_runner.ros.dds_link import findings; "
        "from robot_runner.core.links.robot import RobotName; findings(RobotName.parse('dds')); "
        "sys.exit('cyclonedds' in sys.modules)"
    )
    subprocess.run([sys.executable, "-c", script], check=True, timeout=30)
