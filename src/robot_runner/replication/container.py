"""The recipe of a container image that holds the experiment and all that it needs."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

__all__ = ["container_commands", "containerfile", "image_name"]

#: The Python of each ROS distribution (REP 3, REP 2000): those older than ours get a Python of their own.
_ROS_WITH_OLD_PYTHON = frozenset({"kinetic", "melodic", "noetic", "dashing", "eloquent", "foxy", "galactic", "humble"})


def containerfile(manifest: Mapping[str, Any], *, has_wheels: bool) -> str:
    """Return the text of a Containerfile (Docker, Podman, Buildah)."""
    return "\n".join(_lines(manifest, has_wheels=has_wheels)) + "\n"


def image_name(experiment: str) -> str:
    """Return a name for the image.

    Example:
        >>> image_name("Energy of Tasks")
        'energy-of-tasks'
    """
    kept = "".join(letter if letter.isascii() and letter.isalnum() else "-" for letter in experiment.casefold())
    return "-".join(part for part in kept.split("-") if part) or "experiment"


def container_commands(experiment: str, folder: str) -> tuple[str, ...]:
    """Return the commands that build the image from an unpacked package and replicate in it."""
    image = image_name(experiment)
    results = f'"$HOME/{image}"'  # not in the package's folder, which has to stay as it is
    return (
        f"podman build -t {image} {folder}",
        f"mkdir -p {results} && podman run --rm -v {results}:/results {image}",
    )


def _lines(manifest: Mapping[str, Any], *, has_wheels: bool) -> Iterator[str]:
    name = manifest.get("experiment_name", "experiment")
    yield f"# An image that replicates the experiment {name}."
    yield "# In this folder, `podman build .` makes it, or the same words with docker or buildah."
    yield from _base(manifest)
    yield "WORKDIR /experiment"
    yield "COPY environment environment"
    links = " --find-links environment/wheels" if has_wheels else ""
    yield 'ARG PIP_OPTIONS=""'
    yield "RUN python3 -m venv /opt/robot-runner \\"
    yield f" && /opt/robot-runner/bin/pip install --no-cache-dir ${{PIP_OPTIONS}}{links} \\"
    yield "    -r environment/requirements.txt"
    yield "COPY . original"
    yield "VOLUME /results"
    yield 'ENTRYPOINT ["/opt/robot-runner/bin/robot-runner"]'
    yield 'CMD ["replicate", "original", "--to", "/results/replication", "--yes"]'


def _base(manifest: Mapping[str, Any]) -> Iterator[str]:
    python = ".".join(str(manifest.get("software", {}).get("python") or "3.11").split(".")[:2])
    ros = manifest.get("ros") or {}
    distro = ros.get("distro")
    is_simulated = str(manifest.get("robot") or "").startswith("simulated")
    if not distro or is_simulated:
        yield f"ARG BASE=docker.io/library/python:{python}-slim"
        yield "FROM ${BASE}"
        return
    yield f"# ROS {ros.get('version')}, distribution {distro}; --network=host lets the container see the robot."
    yield f"ARG BASE=docker.io/library/ros:{distro}-ros-base"
    yield "FROM ${BASE}"
    yield "RUN apt-get update && apt-get install -y --no-install-recommends python3-pip python3-venv \\"
    yield " && rm -rf /var/lib/apt/lists/*"
    if distro in _ROS_WITH_OLD_PYTHON:
        yield f"# The Python of {distro} is older than Robot Runner's: another one is put beside it. What ROS compiled"
        yield "# for its own Python (rclpy) cannot be imported there: reach the robot over rosbridge or DDS."
        yield f"RUN python3 -m pip install uv && uv python install {python} \\"
        yield f' && ln -s "$(uv python find {python})" /usr/local/bin/python3'
