"""What software under test reads is known as far as it can be, and is found again where the experiment is repeated."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest
from tests.packaged_inputs import only_in_a_package

from robot_runner.core.design.revision import Revision
from robot_runner.core.errors import PluginError
from robot_runner.core.storage.input_files import kept_contents
from robot_runner.plugins import Circumstances
from robot_runner.plugins.systems import ComposeProject, Program, RosLaunch, RosNode

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from robot_runner.subjects.subject import Subject

COMPOSE = """\
services:
  planner:
    build:
      context: ./planner
      dockerfile: Dockerfile.arm
    env_file: planner.env   # not.read.env
    volumes: ["./nav.yaml:/etc/nav.yaml:ro", "./results:/results"]
  map:
    build: map
    volumes:
      - ./maps:/maps:ro
"""
FILES = {
    "compose.yaml": COMPOSE,
    "planner.env": "SPEED=1\n",
    "not.read.env": "",
    "nav.yaml": "map: maps/hall.yaml\n",
    "maps/hall.yaml": "image: hall.pgm\n",
    "maps/hall.pgm": "P5",
    "results/log.txt": "written by a container",
    "planner/Dockerfile.arm": "FROM debian\nCOPY --from=base /x /x\nCOPY --chown=me src/*.py \\\n  setup.cfg /app/\n",
    "planner/src/plan.py": "",
    "planner/setup.cfg": "",
    "planner/notes.txt": "",
    "map/Dockerfile": "FROM debian\nADD . /map\n",
    "map/server.py": "",
    "map/.git/config": "",
    "map/experiments/old/manifest.json": "{}",
    "map/experiments/old/run_table.csv": "",
    "launch/bringup.launch.py": 'here / ".." / "nav.yaml"; include("$(dirname)/planner.launch")',
    "launch/planner.launch": '<launch><node name="planner" args="$(dirname)/bringup.launch.py"/></launch>',
    "plan.py": "print(open('hall.csv').read())",
    "drive.py": "import os, wheels\nfrom lab.robot import Robot\nimport plan as p\n",
    "wheels.py": "import drive\n",
    "lab/__init__.py": "",
    "lab/robot.py": "",
    "planner.sh": "#!/bin/sh\nexec cat hall.csv\n",
    "hall.csv": "a map",
    "env.sh": "export HALL=large\n",
}


@pytest.fixture
def study(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the folder of a config, which is the current one."""
    for name, text in FILES.items():
        path = tmp_path / "study" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    (tmp_path / "study/planner.sh").chmod(0o755)
    monkeypatch.chdir(tmp_path / "study")
    return tmp_path / "study"


def _kept(subject: Subject, study: Path) -> Mapping[str, bytes]:
    """Return what is kept of what a subject reads, by its place in the folder of configs."""
    found = kept_contents(list(subject.input_files()), study, study.parent / "config")
    return {place.relative_to(study.parent / "config").as_posix(): content for place, content in found.items()}


def _names(subject: Subject, study: Path) -> set[str]:
    return {*_kept(subject, study)} - {"input_files.json"}


SOME = {"nav.yaml", "maps/hall.yaml", "maps/hall.pgm"}


@pytest.mark.parametrize(
    ("subject", "names"),
    [
        (Program(["python3", "-u", "plan.py", "hall.csv"]), {"plan.py"}),
        (
            Program(["python3", "drive.py"]),
            {"drive.py", "wheels.py", "plan.py", "lab/__init__.py", "lab/robot.py"},
        ),
        (Program(["./planner.sh"], reads=["hall.csv", "maps"]), {"planner.sh", *SOME - {"nav.yaml"}, "hall.csv"}),
        (Program(["sh", "-c", "exec sleep 9"], setup="env.sh"), {"env.sh"}),
        (Program(["/bin/sh", "/usr/bin/env"], host="pi@robot", reads=["hall.csv"]), set()),
        (RosNode("nav", "planner", parameters_file="nav.yaml", ros=2), SOME),
        (RosNode("nav", "planner", parameters_file=["maps/hall.yaml"], ros=1), SOME - {"nav.yaml"}),
        (RosNode("nav", "planner", parameters_file="nav.yaml", ros=2, host="pi@robot"), set()),
        (RosLaunch("nav", "nav.launch.py", arguments={"params": "nav.yaml", "map": "", "speed": 1}, ros=2), SOME),
        (
            RosLaunch("launch/bringup.launch.py", ros=2),
            {"launch/bringup.launch.py", "launch/planner.launch", *SOME},
        ),
    ],
)
def test_files_that_a_subject_is_started_with_and_those_that_they_name_are_kept(
    study: Path, subject: Subject, names: set[str]
) -> None:
    assert _names(subject, study) == names


def test_of_a_compose_file_what_it_names_mounts_and_builds_from_is_kept(study: Path) -> None:
    kept = _names(ComposeProject("compose.yaml"), study)
    assert kept == {
        "compose.yaml",
        "planner.env",
        *SOME,
        *("planner/Dockerfile.arm", "planner/src/plan.py", "planner/setup.cfg", "map/Dockerfile", "map/server.py"),
    }
    assert _names(ComposeProject("compose.yaml", folder=study), study) == kept


def test_what_a_build_leaves_out_of_its_folder_is_not_kept(study: Path) -> None:
    for name in ("bags/hall.mcap", "bags/small.mcap", "src/build/x.o", "src/server.cpp", "log1.txt", "notes/log.txt"):
        (study / "map" / name).parent.mkdir(parents=True, exist_ok=True)
        (study / "map" / name).write_text("")
    (study / "map/.dockerignore").write_text(
        "# large\n/bags/\n!bags/small.mcap\n**/build\nlog?.txt\n*.md\n[\nserver.p*\n"
    )
    kept = {name for name in _names(ComposeProject("compose.yaml"), study) if name.startswith("map/")}
    assert kept == {
        *("map/Dockerfile", "map/.dockerignore", "map/bags/small.mcap", "map/src/server.cpp", "map/notes/log.txt")
    }


def test_what_is_in_the_work_tree_of_a_revision_is_no_file_of_its_own(study: Path) -> None:
    revision = Revision(str(study), "v1.0")
    revision.prepare(commit="0" * 40, path=str(study))
    for subject in (
        Program(["./planner.sh"], folder=revision, reads=["hall.csv"]),
        RosLaunch(revision, "launch/bringup.launch.py", ros=2),  # type: ignore[arg-type]
        ComposeProject(revision),
        RosNode("nav", "planner", parameters_file=[[revision, "/nav.yaml"]], ros=2),
    ):
        assert _names(subject, study) == set()
    assert _names(Program(["./planner.sh"], folder=revision, reads=[study / "hall.csv"]), study) == {"hall.csv"}


@pytest.mark.parametrize("folder", [None, "study"])
def test_on_another_machine_the_copies_are_what_is_started(
    study: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, folder: str | None
) -> None:
    monkeypatch.chdir(study if folder is None else tmp_path)

    def subjects() -> list[Any]:
        return [
            Program(["./planner.sh", "--map=hall.csv", "planner"], folder=folder, reads=["hall.csv"], setup="env.sh"),
            RosLaunch("nav", "nav.launch.py", arguments={"params": "nav.yaml"}, ros=2, folder=folder),
        ]

    inputs = [each for subject in subjects() for each in subject.input_files()]
    with only_in_a_package(inputs, study, study.parent / "elsewhere", monkeypatch) as working:
        program, launch = subjects()
        words = program.surroundings.wrapped(program.words())
        *_, command, option, name = words
        assert command.startswith(str(working))
        assert name == "planner"  # a word that is no path
        assert option.startswith(f"--map={working}")
        assert not list(program.surroundings.findings("plugin Program"))
        assert not list(program.program_findings("plugin Program"))
        if folder is not None:  # what it opens by a relative path is found where its folder is named
            answer = program.surroundings.ask(["sh", "-c", '"$0"; echo " $HALL"', "./planner.sh"])
            assert (answer.code, answer.said) == (0, "a map large\n")
        (parameters,) = [each for each in launch.surroundings.wrapped(launch.words()) if each.startswith("params:=")]
        assert parameters.startswith(f"params:={working}")
        assert {*subjects()[0].input_files()}  # what is repeated can be packed again


def test_what_it_is_said_to_read_and_is_not_there_is_told_before_anything_is_executed(
    study: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(study)
    around = Circumstances(robot=None)
    (told,) = Program(["sh", "planner.sh"], reads=["hal.csv", "maps", "hall.csv"]).check(around)
    assert told.problem == "it is to read 'hal.csv', which is not there: a package lacks it"
    assert not told.is_error, "before_experiment may make it"
    assert list(Program(["sh"], folder="maps", reads=["hall.yaml", study / "hall.csv"]).check(around)) == []


def test_a_single_text_is_no_list_of_files() -> None:
    with pytest.raises(PluginError, match=r"reads is 'hall.csv'"):
        Program(["planner"], reads="hall.csv")


def test_an_argument_that_is_longer_than_any_name_of_a_file_is_no_file() -> None:
    launch = RosLaunch("nav", "nav.launch.py", arguments={"params": f'{{"a": "{"b" * 300}"}}'}, ros=2)
    assert list(launch.input_files()) == []
