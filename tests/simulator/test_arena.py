"""What a ray of the laser scanner hits."""

from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot_runner.simulator.model import burger_model
from robot_runner.simulator.rooms import ARENA, Wall, ray_distances
from robot_runner.simulator.turtlebot3_parameters import Turtlebot3Parameters

BOX = (Wall(3.0, 0.0, 1.0, 0.5),)


def distance(walls, x, y, angle):
    return float(ray_distances(walls, x, y, np.array([angle]))[0])


def test_a_wall_ahead_is_as_far_as_its_near_side():
    assert distance(BOX, 0, 0, 0) == pytest.approx(2.0)


def test_a_wall_behind_is_not_hit():
    assert distance(BOX, 0, 0, math.pi) == math.inf


def test_a_ray_beside_a_wall_misses_it():
    assert distance(BOX, 0, 0.6, 0) == math.inf


def test_a_slanted_ray_is_longer():
    assert distance(BOX, 0, 0, 0.2) == pytest.approx(2.0 / math.cos(0.2))


def test_the_nearest_of_two_walls_counts():
    assert distance((*BOX, Wall(1.0, 0.0, 0.1, 0.1)), 0, 0, 0) == pytest.approx(0.9)


@given(x=st.floats(-1.2, 0.7), y=st.floats(-0.9, 1.9), angle=st.floats(-math.pi, math.pi))
def test_distances_agree_with_rays_in_the_physics_model(x, y, angle):
    drawn = distance(ARENA, x, y, angle)
    direction = np.array([math.cos(angle), math.sin(angle), 0.0])
    truth = mujoco.mj_ray(MODEL, DATA, np.array([x, y, 0.4]), direction, None, 1, -1, np.zeros(1, dtype=np.int32))
    assert drawn == pytest.approx(truth, rel=1e-6)


def model_and_data():
    parameters = Turtlebot3Parameters()
    model = mujoco.MjModel.from_xml_string(burger_model(parameters, (0.033, 0.033)))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


MODEL, DATA = model_and_data()
