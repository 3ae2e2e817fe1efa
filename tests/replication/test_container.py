"""The recipe of the image fits what the experiment was executed with."""

from __future__ import annotations

import pytest

from robot_runner.core.errors import PackageError
from robot_runner.replication.container import as_base, container_commands, containerfile, image_name


def _recipe(*, has_comparison=False, image=None, **manifest):
    software = {"python": "3.12.4", "robot_runner": "1.2.3"}
    manifest = {"experiment_name": "trial", "software": software, **manifest}
    return containerfile(manifest, has_wheels=True, has_comparison=has_comparison, image=image)


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
    command = '["replicate", "original", "--to", "/results/replication", "--environment", "/opt/robot-runner", "--yes"]'
    assert recipe.endswith(f"CMD {command}\n")
    assert "No digest of the base image was known" in recipe


def test_an_image_that_clones_revisions_has_git():
    assert "git" not in _recipe(robot="simulated")
    lines = _recipe(robot="simulated", revisions={"Version": {"v1.0": {"commit": "1a2b3c4d"}}}).splitlines()
    place = lines.index("WORKDIR /experiment")
    assert lines[place - 3 : place - 1] == [
        "# The commits that were compared are cloned by git.",
        "RUN command -v git || (apt-get update && apt-get install -y --no-install-recommends git \\",
    ]


def test_what_compares_stands_apart_unless_the_experiment_needs_it_anyway():
    apart = _recipe(robot="simulated")
    assert "/opt/comparison/bin/pip install --no-cache-dir ${PIP_OPTIONS} --find-links environment/wheels" in apart
    assert "'robot-runner[analysis]==1.2.3'" in apart
    assert 'ENTRYPOINT ["/opt/comparison/bin/robot-runner"]' in apart
    together = _recipe(robot="simulated", has_comparison=True)
    assert "/opt/comparison" not in together
    assert 'ENTRYPOINT ["/opt/robot-runner/bin/robot-runner"]' in together
    assert '"--environment", "here", "--yes"]' in together


def test_what_has_all_hashes_is_installed_as_it_is_listed():
    manifest = {"experiment_name": "trial", "robot": "simulated"}
    hashed = containerfile(manifest, has_wheels=False, demands_hashes=True)
    assert "install --no-cache-dir ${PIP_OPTIONS} --no-deps \\\n    -r environment/requirements.txt" in hashed
    assert "--no-deps" not in containerfile(manifest, has_wheels=False)


def test_a_base_with_its_digest_is_taken_and_what_is_no_image_is_refused():
    pinned = f"registry.example/python:3.12-slim@sha256:{'ab' * 32}"
    recipe = _recipe(robot="simulated", image=as_base(pinned))
    assert f"ARG BASE={pinned}\n" in recipe
    assert "is pinned by the digest" in recipe
    for wrong in ("python@sha256:12", "a b", "x\nRUN evil", ""):
        with pytest.raises(PackageError, match="is not an image"):
            as_base(wrong)


def test_a_distribution_with_an_old_python_gets_another_one():
    assert "uv python install 3.12" in _recipe(robot="rosbridge", ros={"version": 1, "distro": "noetic"})
    assert "uv python" not in _recipe(robot="ros2", ros={"version": 2, "distro": "jazzy"})


def test_results_go_to_a_folder_outside_the_package():
    build, start = container_commands("Energy of Tasks", "package")
    assert build == "podman build -t energy-of-tasks package"
    assert '-v "$HOME/energy-of-tasks":/results' in start
    assert image_name("!?") == "experiment"


@pytest.mark.parametrize(
    "manifest",
    [
        {"experiment_name": "trial\nRUN touch /seen"},
        {"software": {"python": "3\nRUN touch /seen"}},
        {"software": {"robot_runner": "1'\nRUN touch /seen"}},
        {"ros": {"distro": "jazzy\nRUN touch /seen", "version": 2}},
        {"ros": {"distro": "humble", "version": "2\nRUN touch /seen"}, "software": {"python": "3; touch /seen"}},
    ],
)
def test_what_a_strangers_manifest_says_is_no_instruction(manifest):
    """Whoever packs another's experiment gave the image instructions that its manifest named in place of a version."""
    words = containerfile(manifest, has_wheels=False).splitlines()
    assert not [line for line in words if "touch" in line and not line.startswith("# An image")]
