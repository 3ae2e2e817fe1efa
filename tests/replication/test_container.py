"""The recipe of the image fits what the experiment was executed with."""

from __future__ import annotations

import pytest

from robot_runner.replication.about import container_commands, containerfile, image_name


def _recipe(**manifest):
    return containerfile({"experiment_name": "trial", "software": {"python": "3.12.4"}, **manifest}, has_wheels=True)


@pytest.mark.parametrize(
    ("manifest", "base"),
    [
        ({"robot": "simulated"}, "docker.io/library/python:3.12-slim"),
        ({}, "docker.io/library/python:3.12-slim"),
        ({"robot": "rosbridge", "ros": {"version": 1, "distro": "noetic"}}, "docker.io/library/ros:noetic-ros-base"),
        ({"robot": "ros2", "ros": {"version": 2, "distro": "jazzy"}}, "docker.io/library/ros:jazzy-ros-base"),
        (
            {"robot": "simulated:battery=0.5", "ros": {"version": 2, "distro": "jazzy"}},
            "docker.io/library/python:3.12-slim",
        ),
    ],
)
def test_the_base_is_that_of_the_ros_or_of_the_python(manifest, base):
    recipe = _recipe(**manifest)
    assert f"ARG BASE={base}\nFROM ${{BASE}}\n" in recipe
    assert "--find-links environment/wheels" in recipe
    assert recipe.endswith('CMD ["replicate", "original", "--to", "/results/replication", "--yes"]\n')


def test_a_distribution_with_an_old_python_gets_another_one():
    assert "uv python install 3.12" in _recipe(robot="rosbridge", ros={"version": 1, "distro": "noetic"})
    assert "uv python" not in _recipe(robot="ros2", ros={"version": 2, "distro": "jazzy"})


def test_results_go_to_a_folder_outside_the_package():
    build, start = container_commands("Energy of Tasks", "package")
    assert build == "podman build -t energy-of-tasks package"
    assert '-v "$HOME/energy-of-tasks":/results' in start
    assert image_name("!?") == "experiment"
