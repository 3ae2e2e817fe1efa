"""The page with which a package greets whoever opens it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from robot_runner.core.errors import Finding
from robot_runner.replication.contents import CONTAINERFILE, CRATE, DATA_PACKAGE, ENVIRONMENT, REQUIREMENTS, SUMS

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from typing import Self

    from robot_runner.core.config.experiment import Author
    from robot_runner.replication.contents import LeftOut

__all__ = ["About", "container_commands", "containerfile", "image_name", "readme"]


# Who made an experiment, under which terms it may be used, and how it is cited.


@dataclass(frozen=True, slots=True)
class About:
    """What others have to know before they use a package.

    Attributes:
        name: the experiment's.
        authors: each a mapping with `name`, `orcid`, `affiliation`, `affiliation_url`.
        licence: an SPDX identifier or a URL.
        date: when the experiment ended last, or began where it did not end (UTC).

    Example:
        >>> about = About("naps", ({"name": "Ada Lovelace"},), "CC-BY-4.0", None, "2026-01-31T12:00:00Z")
        >>> about.licence_url
        'https://spdx.org/licenses/CC-BY-4.0'
    """

    name: str
    authors: tuple[Mapping[str, str | None], ...]
    licence: str | None
    citation: str | None
    date: str

    @classmethod
    def of_manifest(
        cls,
        manifest: Mapping[str, Any],
        *,
        authors: Sequence[Author] = (),
        licence: str | None = None,
        citation: str | None = None,
    ) -> Self:
        """Return what the manifest says, which took it from the config; what is given here counts instead."""
        last = (manifest.get("executions") or [{}])[-1]
        return cls(
            str(manifest.get("experiment_name", "experiment")),
            tuple(author.as_mapping() for author in authors) or tuple(manifest.get("authors") or ()),
            licence or manifest.get("licence"),
            citation or manifest.get("citation"),
            str(last.get("finished_at") or last.get("started_at") or "1980-01-01T00:00:00Z"),
        )

    @property
    def licence_url(self) -> str | None:
        """A page about the licence."""
        if self.licence is None or self.licence.startswith(("http://", "https://")):
            return self.licence
        return f"https://spdx.org/licenses/{self.licence}"

    @property
    def authors_in_words(self) -> str:
        """The authors in one line."""
        return "; ".join(
            f"{each['name']} (https://orcid.org/{each['orcid']})" if each.get("orcid") else str(each["name"])
            for each in self.authors
        )

    def findings(self) -> Iterator[Finding]:
        """Yield what others will miss, each with what to write into the config or say to the command."""
        if not self.authors:
            yield Finding.warning(
                "authors", "nobody is named", "Give authors=[Author(...)] in the config, or --author."
            )
        for each in self.authors:
            missing = [part for part in ("orcid", "affiliation", "affiliation_url") if not each.get(part)]
            if missing:
                problem = f"{each['name']} has no {', '.join(missing)}, which RO-Crate recommends"
                yield Finding.warning("authors", problem, "Give it in Author(...), or to --author.")
        if not self.licence:
            problem = "without a licence nobody may use the results"
            yield Finding.warning("licence", problem, 'Give licence="CC-BY-4.0" in the config, or --licence.')
        if not self.citation:
            yield Finding.warning(
                "citation", "nothing says what to cite", "Give citation in the config, or --citation."
            )


# The recipe of a container image that holds the experiment and all that it needs.

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


_FILES = (
    ("run_table.csv", "all runs, with their treatments and measures; `run_table.schema.json` says what each column is"),
    ("runs/", "the raw data and the log of each run"),
    ("config/", "the config and the local modules that it imports, as executed"),
    ("report/", "the report, with its tables and figures"),
    ("manifest.json", "the circumstances: host, versions, seed, what was set by hand"),
    ("journal.jsonl", "everything that happened, in order"),
    (REQUIREMENTS, "the Python packages that the experiment needs"),
    (ENVIRONMENT, "everything that was installed; host; ROS"),
    (CONTAINERFILE, "the recipe of a container image"),
    (DATA_PACKAGE, "describes the run table (Frictionless Data Package)"),
    (CRATE, "describes everything (RO-Crate)"),
    (SUMS, "the SHA-256 of each file: `sha256sum -c SHA256SUMS` checks them without any tool of ours"),
)


def readme(about: About, manifest: Mapping[str, Any], names: Sequence[str], left_out: Sequence[LeftOut]) -> str:
    """Return the text, in Markdown.

    Args:
        about: who made the experiment, and under which terms.
        manifest: the experiment's.
        names: the files of the package.
        left_out: what is not in it.
    """
    return "\n".join(_readme_lines(about, manifest, names, left_out)) + "\n"


def _readme_lines(
    about: About, manifest: Mapping[str, Any], names: Sequence[str], left_out: Sequence[LeftOut]
) -> Iterator[str]:
    software = manifest.get("software", {})
    yield f"# {about.name}"
    yield ""
    yield f"A replication package of an experiment executed with Robot Runner {software.get('robot_runner', '')}."
    yield ""
    for what, text in (("Authors", about.authors_in_words), ("Licence", about.licence), ("Cite", about.citation)):
        if text:
            yield f"- {what}: {text}"
    yield f"- Robot: {manifest.get('robot') or 'none, or as the config says'}"
    yield f"- Seed: {manifest.get('seed')}"
    yield ""
    yield "## Replicate it"
    yield ""
    yield "Nothing of the package is executed before it has been verified and you have said yes."
    yield ""
    yield "```console"
    yield "$ robot-runner verify PACKAGE.zip"
    yield "$ robot-runner replicate PACKAGE.zip --environment venv"
    yield "```"
    yield ""
    yield "`PACKAGE.zip` is this package, or the folder it was unpacked to. The last command makes the environment,"
    yield "executes the same runs in the same order from the same seed, and says whether the results agree."
    yield ""
    yield "Or in a container:"
    yield ""
    yield "```console"
    yield from (f"$ {command}" for command in container_commands(about.name, "."))
    yield "```"
    yield ""
    yield "## What is in it"
    yield ""
    yield "| file | holds |"
    yield "|---|---|"
    present = set(names) | {f"{name.partition('/')[0]}/" for name in names} | {CRATE, SUMS}
    yield from (f"| `{name}` | {holds} |" for name, holds in _FILES if name in present)
    if left_out:
        yield ""
        yield "## What is not in it"
        yield ""
        yield from (f"- `{each.name}`: {each.why}" for each in left_out)
