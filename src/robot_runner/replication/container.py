"""The Containerfile of an image that replicates an experiment, and the commands that use it."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from robot_runner.core.errors import PackageError
from robot_runner.core.words import one_line

#: The name of an image with a tag, a digest or both, in the form of the Open Container Initiative's distribution.
_IMAGE = re.compile(r"[\w][\w.\-/:]{0,254}(@sha256:[0-9a-f]{64})?", re.ASCII)
#: A version, or the name of a distribution of ROS.
_WORD = re.compile(r"[\w.+!-]+", re.ASCII)
#: The distributions of ROS whose Python is too old for Robot Runner (REP 3, REP 2000): another Python is installed.
_ROS_WITH_OLD_PYTHON = frozenset({"kinetic", "melodic", "noetic", "dashing", "eloquent", "foxy", "galactic", "humble"})

_CONTAINERFILE = """\
# An image that replicates the experiment {name}, and ends with the verdict on it:
# exit code 0 identical or equivalent, 3 different, 4 undecided, 1 some run failed.
# In this folder, `podman build .` makes it, or the same words with docker or buildah.
{pin}
{base}{git}
WORKDIR /experiment
COPY environment environment
ARG PIP_OPTIONS=""
# What executes the experiment: what the package lists, and nothing else.
RUN python3 -m venv /opt/robot-runner \\
 && /opt/robot-runner/bin/pip install --no-cache-dir ${{PIP_OPTIONS}}{alone}{links} \\
    -r environment/requirements.txt
{comparison}COPY . original
VOLUME /results
ENTRYPOINT ["{program}"]
CMD ["replicate", "original", "--to", "/results/replication", "--environment", "{environment}", "--yes"]
"""
#: Revisions are repositories in the package. The official image of Python has no git.
_GIT = """
# The commits that were compared are cloned by git.
RUN command -v git || (apt-get update && apt-get install -y --no-install-recommends git \\
 && rm -rf /var/lib/apt/lists/*)"""
#: Separate from the environment of the experiment, so that no version there changes.
_COMPARISON = """\
# What compares the results stands apart, so that it changes no version of what executes the experiment.
RUN python3 -m venv /opt/comparison \\
 && /opt/comparison/bin/pip install --no-cache-dir ${{PIP_OPTIONS}}{links} \\
    'robot-runner[analysis]=={version}'
"""
_PINNED = "# The base image is pinned by the digest that was given when the package was made."
_NOT_PINNED = """\
# No digest of the base image was known when the package was made, so that it may change under its name.
# `--build-arg BASE=NAME@sha256:...` pins it; `robot-runner pack --base-image NAME@sha256:...` does so for everyone."""
_PYTHON_IMAGE = "docker.io/library/python:{python}-slim"
_ROS_IMAGE = "docker.io/library/ros:{distro}-ros-base"
_PYTHON_BASE = """\
ARG BASE={image}
FROM ${{BASE}}"""
_ROS_BASE = """\
# ROS {version}, distribution {distro}; --network=host lets the container see the robot.
ARG BASE={image}
FROM ${{BASE}}
RUN apt-get update && apt-get install -y --no-install-recommends python3-pip python3-venv \\
 && rm -rf /var/lib/apt/lists/*"""
_NEWER_PYTHON = """
# The Python of {distro} is older than Robot Runner's: another one is put beside it. What ROS compiled
# for its own Python (rclpy) cannot be imported there: reach the robot over rosbridge or DDS.
RUN python3 -m pip install uv && uv python install {python} \\
 && ln -s "$(uv python find {python})" /usr/local/bin/python3"""


def as_base(text: str) -> str:
    """Return the name of a base image unchanged.

    Raises:
        PackageError: the text is not the name of an image.

    Example:
        >>> as_base("docker.io/library/python:3.12-slim")
        'docker.io/library/python:3.12-slim'
    """
    if not _IMAGE.fullmatch(text):
        fix = "Give NAME:TAG@sha256:DIGITS, as `podman image inspect --format '{{.Digest}}'` and the like tell it."
        raise PackageError(f"{text!r} is not an image", where="--base-image", fix=fix)
    return text


def is_pinned(image: str) -> bool:
    """Return whether an image's name has a digest, so that the image cannot change."""
    return "@sha256:" in image


def containerfile(
    manifest: Mapping[str, Any],
    *,
    has_wheels: bool,
    demands_hashes: bool = False,
    has_comparison: bool = False,
    image: str | None = None,
) -> str:
    """Return the text of a Containerfile (Docker, Podman, Buildah) of an image that replicates the experiment.

    Args:
        manifest: the experiment's.
        has_wheels: whether the package has wheels.
        demands_hashes: whether the requirements have hashes of all packages: then no dependencies are added.
        has_comparison: whether the experiment's packages include those for the comparison, so that one environment is
            enough.
        image: the base image; None for the official one of the experiment's Python or ROS.
    """
    ros, software = manifest.get("ros") or {}, manifest.get("software") or {}
    is_ros = bool(_word(ros.get("distro"))) and not str(manifest.get("robot") or "").startswith("simulated")
    facts = {
        "python": ".".join(_word(software.get("python"), "3.11").split(".")[:2]),
        "distro": _word(ros.get("distro")),
        "version": _word(ros.get("version")),
    }
    facts["image"] = image or (_ROS_IMAGE if is_ros else _PYTHON_IMAGE).format(**facts)
    base = _ROS_BASE if is_ros else _PYTHON_BASE
    if is_ros and facts["distro"] in _ROS_WITH_OLD_PYTHON:
        base += _NEWER_PYTHON
    links = " --find-links environment/wheels" if has_wheels else ""
    apart = _COMPARISON.format(links=links, version=_word(software.get("robot_runner"), "0"))
    return _CONTAINERFILE.format(
        name=one_line(str(manifest.get("experiment_name", "experiment"))),
        pin=_PINNED if is_pinned(str(facts["image"])) else _NOT_PINNED,
        base=base.format(**facts),
        git=_GIT if manifest.get("revisions") else "",
        alone=" --no-deps" if demands_hashes else "",
        links=links,
        comparison="" if has_comparison else apart,
        program=f"/opt/{'robot-runner' if has_comparison else 'comparison'}/bin/robot-runner",
        environment="here" if has_comparison else "/opt/robot-runner",
    )


def _word(said: object, otherwise: str = "") -> str:
    """Return what a manifest says where it is one word: a line feed in it would be an instruction of its own."""
    text = str(said or "")
    return text if _WORD.fullmatch(text) else otherwise


def image_name(experiment: str) -> str:
    """Return a name for the image.

    Example:
        >>> image_name("Energy of Tasks")
        'energy-of-tasks'
    """
    return "-".join(re.findall(r"[a-z0-9]+", experiment.casefold())) or "experiment"


def container_commands(experiment: str, folder: str) -> tuple[str, ...]:
    """Return the commands that build the image from an unpacked package, and replicate in it."""
    image = image_name(experiment)
    results = f'"$HOME/{image}"'  # not in the package's folder, which must not change
    return (f"podman build -t {image} {folder}", f"mkdir -p {results} && podman run --rm -v {results}:/results {image}")
