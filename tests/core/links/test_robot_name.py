"""A robot is named by its link and, if need be, options of that link."""

from __future__ import annotations

import pytest

from robot_runner.core.errors import LinkError
from robot_runner.core.events.resources import Resources
from robot_runner.core.links.connect import is_simulated, link_findings, open_clock
from robot_runner.core.links.robot_name import RobotName


def test_a_plain_name_has_no_options():
    assert RobotName.parse("simulated") == RobotName("simulated", {})


def test_spaces_around_names_and_values_do_not_matter():
    name = RobotName.parse("simulated: initial_charge = 40 , meter_rate=100")
    assert name.options == {"initial_charge": "40", "meter_rate": "100"}


@pytest.mark.parametrize(
    ("robot", "problem", "fix"),
    [
        ("simulated:", "sets no option", "option=value"),
        ("simulated:task_power_factor", "'task_power_factor'", "option=value"),
        ("simulated:task_power_factor=", "sets no option", "option=value"),
        ("simulated:mass=1,mass=2", "twice", "Leave one"),
        ("simulated:task_power_facter=1.1", "'task_power_facter'", "'task_power_factor'"),
        ("simulated:mass=heavy", "'heavy'", "a number"),
        ("simulated:meter_rate=1.5", "'1.5'", "a whole number"),
        ("simulated:mass=-1", "mass is -1.0", "finite number"),
        ("simulated:mass=nan", "mass is nan", "finite number"),
        ("simulatd:mass=1", "'simulatd:mass=1'", "'simulated'"),
    ],
)
def test_an_option_that_cannot_be_is_a_finding_with_a_way_out(robot, problem, fix):
    [finding] = link_findings(robot)
    assert finding.is_error
    assert finding.where
    assert problem in finding.problem
    assert fix in finding.fix
    resources = Resources()
    with pytest.raises(LinkError):
        open_clock(robot, resources, 1)
    resources.close()


def test_options_do_not_make_it_another_robot():
    assert link_findings("simulated:task_power_factor=1.1") == []
    assert is_simulated("simulated:task_power_factor=1.1")
    assert is_simulated("simulated")
    assert not is_simulated("simulated_by_others")
    assert not is_simulated(None)


@pytest.mark.parametrize("robot", ["dds:namespace=al ice", "dds://al ice", "dds:domain=7,namespace=/1st"])
def test_a_namespace_that_cannot_be_one_is_refused_before_anything_is_opened(robot):
    (finding,) = link_findings(robot)
    assert finding.is_error
    assert f"robot is {robot!r}, which names a robot of a graph by its namespace" in finding.problem
    assert finding.fix == "Say dds://alice, or dds for all of it."
