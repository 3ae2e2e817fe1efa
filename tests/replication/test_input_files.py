"""Rooms, models and bags that a config names go into the package, and an experiment is repeated by them alone."""

from __future__ import annotations

import csv
import hashlib
import shutil
import zipfile
from typing import TYPE_CHECKING, Any

import pytest
from tests.ros.recordings import scans_of_ros2
from tests.simulator.test_modelled_robot import ROVER

from robot_runner.core.errors import StorageError
from robot_runner.core.links.robot_name import RobotName
from robot_runner.core.storage import input_files
from robot_runner.core.storage.input_files import (
    INDEX,
    InputFile,
    copy_kept,
    input_changes,
    input_file,
    kept_contents,
    kept_copies,
    read_index,
)
from robot_runner.plugins.systems import PlayBag
from robot_runner.replication.differences import missing_modules
from robot_runner.replication.environment import imported_names
from robot_runner.ros.graph_links import GRAPH_LINKS
from robot_runner.ros.type_catalogue import TypeCatalogue

if TYPE_CHECKING:
    from pathlib import Path

_CONFIG = """\
from pathlib import Path

from robot_runner import ExperimentConfig, Factor, RunTableModel
from robot_runner.plugins import InputFile, Measure, System, connect_robot, treatment
from robot_runner.plugins.systems import SimulatedWorld
from robot_runner.ros.recorded_bag import RecordedBag

BAG = Path("{bag}")


class Look(System):
    measures = (Measure("Ahead", "m", "How far it is."), Measure("Messages", "1", "In the bag."))

    def input_files(self):
        yield InputFile(BAG)

    def launch_mission(self, context):
        link = connect_robot(context)
        link.publish("cmd_vel", "geometry_msgs/Twist", {{"linear": {{"x": 0.2}}}})
        context.clock.sleep(1.0)
        self.ahead = link.wait_for("scan", "sensor_msgs/LaserScan", timeout=2.0)["ranges"][0]

    def populate_run_data(self, context):
        context.publish("Ahead", self.ahead)
        with RecordedBag(BAG) as bag:
            context.publish("Messages", bag.count)


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "trial"
    results_output_path = "results"
    robot = "simulated:room={room}"
    licence = "CC0-1.0"
    plugins = [SimulatedWorld(model=treatment("Model"), folder=Path(__file__).parent), Look()]

    def create_run_table(self):
        models = ["{model}", "models/near.xml"]
        return RunTableModel([Factor("Model", models)], data_columns=["Ahead", "Messages"])
"""
_MESH = '<asset><mesh name="block" file="block.obj"/></asset>'
_TETRAHEDRON = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


@pytest.fixture
def study(tmp_path: Path) -> Path:
    """Return the folder of a config with one model below it, and another one and a bag elsewhere."""
    lab, study = tmp_path / "lab", tmp_path / "study"
    for folder in (lab / "rover/meshes", lab / "rover/parts", study / "models"):
        folder.mkdir(parents=True)
    scans_of_ros2(lab / "hall", count=3)
    (study / "models/near.xml").write_text(ROVER.replace('pos="2 0 0.5"', 'pos="1 0 0.5"'))
    (lab / "rover/meshes/block.obj").write_text(_TETRAHEDRON)
    (lab / "rover/parts/wall.xml").write_text(
        '<mujocoinclude><worldbody><geom type="mesh" mesh="block" pos="3 -0.3 0"/></worldbody></mujocoinclude>'
    )
    far = ROVER.replace("<worldbody>", f'<compiler meshdir="meshes"/>{_MESH}<worldbody>', 1)
    far = far.replace("</mujoco>", '<include file="parts/wall.xml"/></mujoco>')
    (lab / "rover/rover.xml").write_text(far)
    (lab / "room.toml").write_text("[[cylinder]]\nat = [-1.0, 0.0]\nradius = 0.1\n")
    config = _CONFIG.format(bag=lab / "hall", room="../lab/room.toml", model=lab / "rover/rover.xml")
    (study / "study.py").write_text(config)
    return study


def _values(table: Path) -> list[tuple[str, ...]]:
    with table.open() as file:
        return [(row["Model"], row["Ahead"], row["Messages"]) for row in csv.DictReader(file)]


@pytest.mark.long
def test_an_experiment_is_repeated_without_the_files_that_it_named(
    study: Path, robot_runner: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(study)
    answer = robot_runner("run", "study.py")
    assert answer.code == 0, answer.out + answer.err
    original = _values(study / "results/trial/run_table.csv")
    assert original[0][1] != original[1][1]
    assert {row[2] for row in original} == {"3"}
    answer = robot_runner("pack", "results/trial", "--no-wheels", "--to", tmp_path / "trial.zip")
    assert answer.code == 0, answer.out + answer.err
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    shutil.move(tmp_path / "trial.zip", elsewhere)
    monkeypatch.chdir(elsewhere)
    shutil.rmtree(study)
    shutil.rmtree(tmp_path / "lab")
    answer = robot_runner(
        "replicate", "trial.zip", "--to", "again", "--yes", "--environment", "here", "--without-verdict"
    )
    assert answer.code == 0, answer.out + answer.err
    assert sorted(_values(elsewhere / "again/trial/run_table.csv")) == sorted(original)
    # What was repeated can be packed and repeated as well.
    kept = {each["named"]: each["kept"] for each in read_index(elsewhere / "again/trial/config")}
    assert len(kept) == 4
    assert None not in kept.values()
    assert input_file(study / "nothing.toml") == study / "nothing.toml"


@pytest.mark.long
def test_what_is_too_large_is_left_out_with_its_size_and_checksum(
    study: Path, robot_runner: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(study)
    monkeypatch.setattr(input_files, "_LARGEST", 4000)
    with (study / "models/near.xml").open("a") as file:
        file.write(f"<!-- {'far and near' * 400} -->\n")
    assert robot_runner("run", "study.py").code == 0
    said = robot_runner("pack", "results/trial", "--no-wheels", "--to", tmp_path / "trial.zip")
    content = (study / "models/near.xml").read_bytes()
    told = f"{len(content):,} bytes, SHA-256 {hashlib.sha256(content).hexdigest()}"
    for answer in (said, robot_runner("verify", tmp_path / "trial.zip")):
        assert answer.code == 0
        shown = "".join((answer.out + answer.err).split())
        assert "near.xml" in shown
        assert "".join(told.split()) in shown
    shutil.rmtree(study / "models")
    answer = robot_runner(
        "replicate", tmp_path / "trial.zip", "--to", tmp_path / "again", "--yes", "--environment", "here"
    )
    assert answer.code == 2
    shown = "".join((answer.out + answer.err).split())
    assert "thereisnocopyofit,anditisnothere:" in shown
    # Others than before are no silent part of the same experiment.
    (tmp_path / "lab/room.toml").write_text("[[cylinder]]\nat = [-1.2, 0.0]\nradius = 0.1\n")
    (study / "models").mkdir()
    (study / "models/near.xml").write_bytes(content)
    answer = robot_runner("run", "study.py")
    assert answer.code == 2
    assert "the file is another one than the runs before have read" in answer.err


_SUBJECT = """\
from pathlib import Path

from robot_runner import ExperimentConfig, Factor, RunTableModel, treatment
from robot_runner.plugins import InputFile
from robot_runner.plugins.systems import Program

GOALS = Path(__file__).parent / "goals.csv"


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "trial"
    results_output_path = "results"
    licence = "CC0-1.0"
    plugins = [Program(["./plan.sh", treatment("Map")], folder="nav", reads=["maps"], exit_codes=[0], name="Planner")]

    def launch_mission(self, context):
        self.plugins[0].wait(context, timeout_s=20)

    def input_files(self):
        yield InputFile(GOALS)

    def populate_run_data(self, context):
        return {"Places": int(GOALS.read_text()) + int((context.run_folder / "Planner/stdout.txt").read_text())}

    def create_run_table(self):
        return RunTableModel([Factor("Map", ["maps/hall.csv", "maps/lab.csv"])], data_columns=["Places"])
"""


@pytest.mark.long
@pytest.mark.parametrize("place", ["nav", "."])
def test_a_program_of_the_users_own_is_repeated_with_what_it_reads_and_may_write_beside_it(
    place: str, robot_runner: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    study, elsewhere = tmp_path / "Studie über Pläne", tmp_path / "elsewhere"
    for folder in (study / place / "maps", elsewhere):
        folder.mkdir(parents=True)
    (study / place / "plan.sh").write_text('#!/bin/sh\nwc -l <"$1"; echo planned >>log.txt\n')
    (study / place / "plan.sh").chmod(0o755)
    (study / place / "maps/hall.csv").write_text("a\nb\n")
    (study / place / "maps/lab.csv").write_text("a\nb\nc\n")
    (study / "goals.csv").write_text("3")
    (study / "study.py").write_text(_SUBJECT.replace("nav", place))
    monkeypatch.chdir(study)
    answer = robot_runner("run", "study.py")
    assert answer.code == 0, answer.out + answer.err
    answer = robot_runner("pack", "--no-wheels", "--no-hashes", "--to", elsewhere / "trial.zip")
    assert answer.code == 0, answer.out + answer.err
    assert robot_runner("run", "study.py").code == 0  # what it has written is no change of what it reads
    monkeypatch.chdir(elsewhere)
    shutil.rmtree(study)
    for _ in range(2):  # the second one verifies once more what was unpacked
        answer = robot_runner("replicate", "trial.zip", "--yes", "--environment", "here")
        assert answer.code == 0, answer.out + answer.err
        assert "The results are identical" in answer.out
    written = [path.read_text() for path in elsewhere.rglob("log.txt")]
    assert [text for text in written if "planned" in text] == ["planned\n" * 2]


_OF_A_CALLBACK = """
import subprocess
from pathlib import Path

from robot_runner import ExperimentConfig, Factor, RunTableModel
from robot_runner.plugins import InputFile

PROGRAM = Path(__file__).parent / "tools/plan.sh"


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "trial"
    results_output_path = "results"
    licence = "CC0-1.0"

    def input_files(self):
        return [InputFile(PROGRAM)]

    def populate_run_data(self, context):
        done = subprocess.run([PROGRAM, context.combination["Map"]], capture_output=True, text=True, check=True)
        return {"Places": int(done.stdout)}

    def create_run_table(self):
        return RunTableModel([Factor("Map", ["3", "5"])], data_columns=["Places"])
"""


@pytest.mark.long
def test_a_program_beside_the_config_that_a_callback_executes_can_be_executed_again(
    robot_runner: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    study, elsewhere = tmp_path / "study", tmp_path / "elsewhere"
    for folder in (study / "tools", elsewhere):
        folder.mkdir(parents=True)
    (study / "tools/plan.sh").write_text('#!/bin/sh\necho "$1"\n')
    (study / "tools/plan.sh").chmod(0o755)
    (study / "study.py").write_text(_OF_A_CALLBACK)
    monkeypatch.chdir(study)
    assert robot_runner("run", "study.py").code == 0
    answer = robot_runner("pack", "--no-wheels", "--no-hashes", "--to", elsewhere / "trial.zip")
    assert answer.code == 0, answer.out + answer.err
    shutil.move(study / "results/trial", elsewhere / "folder")
    monkeypatch.chdir(elsewhere)
    shutil.rmtree(study)
    with zipfile.ZipFile("trial.zip") as archive:
        modes = {each.filename: each.external_attr >> 16 for each in archive.infolist()}
    assert (modes["config/tools/plan.sh"], modes["config/study.py"]) == (0o100755, 0o100644)
    for original in ("trial.zip", "folder"):
        answer = robot_runner("replicate", original, "--to", f"of_{original}", "--yes", "--environment", "here")
        assert answer.code == 0, answer.out + answer.err
        assert "The results are identical" in answer.out


_OF_PATHS = """
from pathlib import Path

from robot_runner import ExperimentConfig, Factor, RunTableModel
from robot_runner.plugins import InputFile

MAPS = Path(__file__).parent / "maps"


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "trial"
    results_output_path = "results"
    licence = "CC0-1.0"

    def input_files(self):
        return [InputFile(MAPS)]

    def populate_run_data(self, context):
        return {"Places": len(context.combination["Map"].read_text())}

    def create_run_table(self):
        return RunTableModel([Factor("Map", [MAPS / "hall.csv", MAPS / "lab.csv"])], data_columns=["Places"])
"""


@pytest.mark.long
def test_treatments_that_are_paths_beside_the_config_are_those_beside_the_copy_of_it(
    robot_runner: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    study, elsewhere = tmp_path / "study", tmp_path / "elsewhere"
    for folder in (study / "maps", elsewhere):
        folder.mkdir(parents=True)
    (study / "maps/hall.csv").write_text("a")
    (study / "maps/lab.csv").write_text("a,b")
    (study / "study.py").write_text(_OF_PATHS)
    monkeypatch.chdir(study)
    assert robot_runner("run", "study.py").code == 0
    answer = robot_runner("pack", "--no-wheels", "--no-hashes", "--to", elsewhere / "trial.zip")
    assert answer.code == 0, answer.out + answer.err
    monkeypatch.chdir(elsewhere)
    shutil.rmtree(study)
    answer = robot_runner("replicate", "trial.zip", "--yes", "--environment", "here")
    assert answer.code == 0, answer.out + answer.err
    assert "The results are identical: every value of 2 runs" in answer.out
    assert "other runs" not in answer.out + answer.err


def test_what_a_script_under_test_imports_is_not_asked_of_the_python_that_executes_the_experiment(
    tmp_path: Path,
) -> None:
    (tmp_path / "study").mkdir()
    (tmp_path / "study/drive.py").write_text("import rclpy_of_another_python\n")
    config = tmp_path / "package/config"
    for place, content in kept_contents([InputFile(tmp_path / "study/drive.py")], tmp_path / "study", config).items():
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_bytes(content)
    (config / "study.py").write_text("import numpy_of_ours\n")
    assert imported_names(config) == {"numpy_of_ours"}
    copy_kept(config, tmp_path / "working")
    with kept_copies(config, tmp_path / "working"):
        (finding,) = missing_modules(tmp_path / "package", {})
    assert "the config imports numpy_of_ours" in finding.problem


@pytest.mark.parametrize("named", ["dig_msgs-main", "dig_msgs-main/msg", "dig_msgs-main/msg/Dig.msg"])
def test_definitions_keep_their_package_wherever_a_copy_of_them_lies(tmp_path: Path, named: str) -> None:
    (tmp_path / "ws/dig_msgs-main/msg").mkdir(parents=True)
    (tmp_path / "ws/dig_msgs-main/msg/Dig.msg").write_text("float64 depth\n")
    (tmp_path / "ws/dig_msgs-main/package.xml").write_text("<package><name>dig_msgs</name></package>")
    (tmp_path / "study").mkdir()
    name = RobotName.parse(f"dds:types={tmp_path}/ws/{named}")
    inputs = list(GRAPH_LINKS[name.link].input_files(name))
    for place, content in kept_contents(inputs, tmp_path / "study", tmp_path / "kept").items():
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_bytes(content)
    shutil.rmtree(tmp_path / "ws")
    with kept_copies(tmp_path / "kept"):
        (found,) = GRAPH_LINKS[name.link].input_files(name)
        assert TypeCatalogue.of(2, extra=(input_file(found.path),)).shape("dig_msgs/Dig").names == ("depth",)


def test_bags_and_definitions_are_named_and_a_damaged_index_is_refused(tmp_path: Path) -> None:
    assert [each.path.name for each in PlayBag(tmp_path / "hall.mcap").input_files()] == ["hall.mcap"]
    (tmp_path / "dig_msgs/msg").mkdir(parents=True)
    (tmp_path / "dig_msgs/msg/Dig.msg").write_text("float64 depth\n")
    for robot in (f"dds:types={tmp_path}/dig_msgs", f"rosbridge://127.0.0.1:9090?types={tmp_path}/dig_msgs"):
        name = RobotName.parse(robot)
        (found,) = GRAPH_LINKS[name.link].input_files(name)
        assert (found.path.name, [each.name for each in found.others]) == ("dig_msgs", ["Dig.msg"])
    entry = '{"named": "a", "at": "/a", "below": null, "others": [], "kept": "../../a", "size": 1, "sha256": null}'
    for text in ('{"inputs": 3}', f'{{"inputs": [{entry}]}}'):
        (tmp_path / INDEX).write_text(text)
        with kept_copies(tmp_path), pytest.raises(StorageError, match="damaged"):
            input_file(tmp_path / "a")


def test_of_several_files_that_belong_together_those_that_changed_are_named(tmp_path: Path) -> None:
    study, kept = tmp_path / "study", tmp_path / "results/config"
    maps = study / "maps"
    maps.mkdir(parents=True)
    for name in ("hall.csv", "lab.csv", "yard.csv"):
        (maps / name).write_text("1\n")
    (study / "plan.py").write_text("import grid\n")
    (study / "grid.py").write_text("SIZE = 3\n")
    (study / "goals.csv").write_text("2\n")
    inputs = [InputFile(maps), InputFile(study / "plan.py", (study / "grid.py",)), InputFile(study / "goals.csv")]
    for place, content in kept_contents(inputs, study, kept).items():
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_bytes(content)
    assert list(input_changes(inputs, kept)) == []
    (maps / "hall.csv").write_text("2\n")
    (maps / "plan.txt").write_text("written by the program\n")
    (maps / "yard.csv").unlink()
    (study / "grid.py").write_text("SIZE = 4\n")
    (study / "goals.csv").write_text("3\n")
    assert {finding.where: finding.problem for finding in input_changes(inputs, kept)} == {
        str(maps): "maps/hall.csv is another one than the runs before have read, maps/plan.txt is new since the runs "
        "before, maps/yard.csv, which the runs before have read, is not there",
        str(study / "plan.py"): "grid.py is another one than the runs before have read",
        str(study / "goals.csv"): "the file is another one than the runs before have read",
    }
