"""The node with parameters that tests offer refuses what a real one refuses."""

from __future__ import annotations

import pytest

from robot_runner.ros.parameter_values import as_wire, kind_of
from robot_runner.testing import FakeClock, FakeRobotLink, ParameterNode


@pytest.mark.parametrize(("value", "kind"), [(0.75, "floating point"), (7, "integer")])
def test_a_value_beyond_the_limits_of_a_parameter_is_refused(value, kind):
    link = FakeRobotLink(FakeClock())
    node = ParameterNode(link, "/planner", {"speed": type(value)(0)}, limits={"speed": (0, 0.5)})
    parameter = {"name": "speed", "value": as_wire(value, kind_of(value))}
    asked = {"parameters": [parameter]}
    (answer,) = link.call("/planner/set_parameters", "rcl_interfaces/SetParameters", asked)["results"]
    assert answer == {"successful": False, "reason": f"Parameter {{speed}} doesn't comply with {kind} range."}
    assert not node.changes
