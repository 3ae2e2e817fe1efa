"""What the host of the repository, the package index and the readers of the project find: it must not fall behind."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))
TARGETS = re.findall(r"^([a-z-]+):.*##", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
PYTHONS = re.findall(r"^Programming Language :: Python :: (3\.\d+)$", "\n".join(PROJECT["classifiers"]), re.MULTILINE)
# A commit with its version beside it, or the branch that the authors of the action name for it.
PINNED = re.compile(r"uses: (\./\S+|[\w./-]+@[0-9a-f]{40} # v[\d.]+|pypa/gh-action-pypi-publish@release/v1 #.*)$")

each_workflow = pytest.mark.parametrize("workflow", WORKFLOWS, ids=lambda path: path.name)


def _jobs(workflow: Path) -> dict[str, dict]:
    return yaml.safe_load(workflow.read_text(encoding="utf-8"))["jobs"]


def test_workflows_are_found() -> None:
    assert {path.stem for path in WORKFLOWS} == {"ci", "newest", "release"}


@each_workflow
def test_workflows_execute_the_make_targets_of_a_person(workflow: Path) -> None:
    commands = [step["run"] for job in _jobs(workflow).values() for step in job.get("steps", []) if "run" in step]
    called = [re.fullmatch(r"(?:sudo )?make ([a-z-]+)(?: TESTS=all)?", command) for command in commands]
    assert [command for command, match in zip(commands, called, strict=True) if match is None] == []
    assert {match[1] for match in called if match} <= set(TARGETS)


@each_workflow
def test_actions_are_pinned(workflow: Path) -> None:
    lines = [line.strip() for line in workflow.read_text(encoding="utf-8").splitlines() if "uses:" in line]
    assert [line for line in lines if not PINNED.search(line)] == []


@each_workflow
def test_workflows_may_only_read_except_where_they_publish(workflow: Path) -> None:
    assert yaml.safe_load(workflow.read_text(encoding="utf-8"))["permissions"] == {"contents": "read"}
    extended = {name: job["permissions"] for name, job in _jobs(workflow).items() if "permissions" in job}
    assert extended == ({"publish": {"id-token": "write"}} if workflow.stem == "release" else {})


def test_every_python_that_is_promised_is_tested() -> None:
    ci, _, release = WORKFLOWS
    assert _jobs(ci)["test"]["strategy"]["matrix"]["python"] == PYTHONS
    assert PROJECT["requires-python"] == f">={PYTHONS[0]}"
    assert _jobs(release)["ci"]["uses"] == f"./{ci.relative_to(ROOT).as_posix()}"
    assert (_jobs(release)["build"]["needs"], _jobs(release)["publish"]["needs"]) == ("ci", "build")


def test_the_extra_all_is_everything_that_users_can_choose() -> None:
    extras = PROJECT["optional-dependencies"]
    chosen, new = {"dev"}, {"all"}
    while new:
        chosen |= new
        named = re.findall(r"robot-runner\[([a-z,]+)\]", " ".join(word for extra in new for word in extras[extra]))
        new = {extra for words in named for extra in words.split(",")} - chosen
    assert chosen == set(extras)


@pytest.mark.parametrize("name", [".readthedocs.yaml", ".github/dependabot.yml", ".github/ISSUE_TEMPLATE/bug.yml"])
def test_the_settings_of_hosts_can_be_read(name: str) -> None:
    assert isinstance(yaml.safe_load((ROOT / name).read_text(encoding="utf-8")), dict)


def test_the_development_container_sets_itself_up() -> None:
    settings = json.loads((ROOT / ".devcontainer" / "devcontainer.json").read_text(encoding="utf-8"))
    assert settings["postCreateCommand"] == "sudo make system-packages && sh scripts/set_up.sh test"


def test_the_documentation_is_built_by_the_same_target_everywhere() -> None:
    assert yaml.safe_load((ROOT / ".readthedocs.yaml").read_text())["build"]["commands"][0] == "make docs"


@pytest.mark.parametrize(
    "name",
    ["SECURITY.md", "CODE_OF_CONDUCT.md", "CONTRIBUTING.md", ".github/pull_request_template.md", "LICENSE"],
)
def test_the_project_says_how_to_deal_with_it(name: str) -> None:
    assert (ROOT / name).is_file()


def test_the_changelog_has_a_place_for_what_comes() -> None:
    changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert re.findall(r"^## \[(.*?)\]", changelog, re.MULTILINE)[0] == "Unreleased"


@pytest.mark.long
def test_the_wheel_tells_type_checkers_of_its_types(tmp_path: Path) -> None:
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(tmp_path)]
    subprocess.run(build, cwd=ROOT, check=True, capture_output=True, timeout=100)
    (wheel,) = tmp_path.glob(f"robot_runner-{PROJECT['version']}-*.whl")
    with zipfile.ZipFile(wheel) as file:
        names = file.namelist()
    assert "robot_runner/py.typed" in names
    assert [name for name in names if not name.startswith("robot_runner")] == []
