"""The embedded robot is made of what its name says."""

from __future__ import annotations

import pytest

from robot_runner.core.errors import LinkError
from robot_runner.core.events.resources import Resources
from robot_runner.core.links.connect import open_clock
from robot_runner.simulator.embedded_robot import simulation_options


def test_values_have_the_type_of_their_parameter():
    parameters = simulation_options({"meter_rate": "100", "task_power_factor": "2"}).parameters
    assert (parameters.meter_rate, parameters.task_power_factor) == (100, 2.0)
    assert isinstance(parameters.meter_rate, int)


def test_the_simulation_is_made_with_the_options():
    resources = Resources()
    open_clock("simulated:task_power_factor=1.1", resources, 1)
    simulation = resources.open("simulation", lambda: None)
    assert simulation.parameters.task_power_factor == 1.1
    resources.close()


def test_the_simulation_can_go_in_real_time():
    assert simulation_options({"real_time_factor": "2"}).real_time_factor == 2.0
    assert simulation_options({}).real_time_factor is None


@pytest.mark.parametrize("pace", ["0", "-1", "inf", "nan"])
def test_a_pace_that_no_clock_can_keep_is_refused(pace):
    with pytest.raises(LinkError, match="real_time_factor"):
        simulation_options({"real_time_factor": pace})
