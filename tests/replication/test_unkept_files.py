"""Packing names files that the config's code reads and that the package lacks, as nobody else could execute it."""

from __future__ import annotations

import shutil
from importlib.metadata import version
from typing import TYPE_CHECKING

import pytest

from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.replication.environment import record_environment
from robot_runner.replication.packing import pack
from robot_runner.replication.sealing import Packing
from robot_runner.replication.unkept_files import unkept_files, unkept_modules

if TYPE_CHECKING:
    from pathlib import Path

_CODE = """\
import json
import os.path as osp
from pathlib import Path

import pandas as pd

HERE = Path(__file__).resolve().parent
ROOT = Path(osp.dirname(osp.realpath(__file__)))
WAY = HERE / "way.csv"


class RunnerConfig:
    room = ROOT / "rooms" / "lab.yaml"

    def start_run(self, context):
        {line}
"""


def _named_of(folder: Path, line: str, stored: tuple[str, ...] = ()) -> list[str]:
    (folder / "config").mkdir()
    (folder / "config/study.py").write_text(_CODE.format(line=line), encoding="utf-8")
    return [
        f"{finding.where}: {finding.problem.split(',')[0]}"
        for finding in unkept_files(ExperimentFolder(folder), ["config/study.py", *stored])
    ]


@pytest.mark.parametrize(
    ("line", "name"),
    [
        ('open(HERE / "data" / "speeds.csv")', "data/speeds.csv"),
        ('json.loads((HERE / "more.json").read_text())', "more.json"),
        ('WAY.open("rb")', "way.csv"),
        ('yaml.safe_load(open(self.room, "r", encoding="utf-8"))', "rooms/lab.yaml"),
        ('pd.read_csv(osp.join(osp.dirname(__file__), "table.csv"))', "table.csv"),
        ('np.load("array.npy")', "array.npy"),
        ('Image.open(HERE.parent.joinpath("floor.png"))', "floor.png"),
        ('open("/home/ada/goals.csv")', "/home/ada/goals.csv"),
        ('resources.files("lab.inner").joinpath("t.txt").read_text()', "t.txt"),
        ('sorted((HERE / "maps").glob("*.pgm"))', "maps"),
        ('subprocess.run([str(HERE / "tools" / "plan.sh"), "-o", "plan.csv"], check=True)', "tools/plan.sh"),
        ('Popen([sys.executable, HERE / "drive.py"])', "drive.py"),
        ('os.listdir(osp.join(ROOT, "worlds", "small"))', "worlds/small"),
    ],
)
def test_a_file_that_the_code_reads_is_named_with_its_line(tmp_path: Path, line: str, name: str) -> None:
    assert _named_of(tmp_path, line) == [f"config/study.py:16: the config needs {name}"]
    assert "input_files" in next(iter(unkept_files(ExperimentFolder(tmp_path), ()))).fix


@pytest.mark.parametrize(
    "line",
    [
        'open(context.run_folder / "samples.csv")',
        'open("out.csv", "w"); open("out.csv")',
        'WAY.write_text("1"); pd.read_csv(WAY)',
        'subprocess.run(["planner", "-o", "plan.csv"]); open("plan.csv")',
        'open("/proc/cpu.info"); open("/sys/class/thermal.txt")',
        "open(self.file_of(context))",
        'sep.join(["a.csv", "b.csv"]); json.load(open(f"{self.room}.json"))',
        'open(HERE / "kept.csv")',
        '(HERE / "elsewhere").iterdir(); context.run_folder.glob("*.csv"); os.listdir("."); HERE.rglob("*.py")',
    ],
)
def test_what_a_run_makes_the_system_has_or_the_package_holds_is_not_named(tmp_path: Path, line: str) -> None:
    assert _named_of(tmp_path, line, stored=("config/elsewhere/kept.csv",)) == []


def test_a_file_that_does_not_parse_says_nothing(tmp_path: Path) -> None:
    (tmp_path / "config").mkdir()
    (tmp_path / "config/broken.py").write_text("def")
    assert list(unkept_files(ExperimentFolder(tmp_path), ())) == []


@pytest.mark.long
def test_packing_warns_of_it(experiment: Path, tmp_path: Path) -> None:
    study = tmp_path / "study"
    shutil.copytree(experiment, study)
    with (study / "config/packed_paces.py").open("a") as file:
        file.write('from pathlib import Path\nDISTANCES = (Path(__file__).parent / "distances.csv").read_text()\n')
    found = pack(study, tmp_path / "study.zip", Packing(with_wheels=False)).findings
    assert "the config needs distances.csv, which is not in the package" in str(found)


def _modules_named(folder: Path, code: str, packages: dict[str, str], **manifest: object) -> list[str]:
    config = folder / "config"
    config.mkdir(exist_ok=True)
    (config / "study.py").write_text(code, encoding="utf-8")
    facts = {"software": {"robot_runner": version("robot-runner"), "packages": packages}, **manifest}
    found = unkept_modules(ExperimentFolder(folder), record_environment(facts, config))
    return [finding.problem for finding in found]


def test_a_module_of_a_sourced_workspace_that_no_recorded_package_brings_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = tmp_path / "ws/install/lab_arm/lib/python3/site-packages"
    (place / "lab_arm_of_ours").mkdir(parents=True)
    (place / "lab_arm_of_ours/__init__.py").touch()
    (place / "lab_arm_of_ours-0.3.0-py3.11.egg-info").mkdir()
    monkeypatch.syspath_prepend(place)
    (told,) = _modules_named(tmp_path, "import json\nimport rich\nfrom lab_arm_of_ours import Arm\n", {"rich": "1.0"})
    assert told.startswith(f"the config imports lab_arm_of_ours, from {place / 'lab_arm_of_ours'}, which no package")


def test_modules_beside_the_config_of_recorded_packages_or_of_the_distribution_of_ros_are_not_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "ros/rclpy_of_ros").mkdir(parents=True)
    (tmp_path / "ros/rclpy_of_ros/__init__.py").touch()
    (tmp_path / "config/src").mkdir(parents=True)
    (tmp_path / "config/src/beside.py").touch()
    monkeypatch.syspath_prepend(tmp_path / "ros")
    monkeypatch.setattr("robot_runner.replication.unkept_files._ROS", tmp_path / "ros")
    code = "import beside, yaml, robot_runner, rclpy_of_ros\ntry:\n    import cupy_of_nobody\nexcept ImportError: ...\n"
    assert _modules_named(tmp_path, code, {"PyYAML": "6"}, ros={"version": 2}) == []
    (told,) = _modules_named(tmp_path, code, {"PyYAML": "6"})
    assert "rclpy_of_ros" in told


def test_of_an_environment_that_is_elsewhere_nothing_is_said_of_modules_that_are_not_here(tmp_path: Path) -> None:
    code = "import of_another_machine\n"
    (told,) = _modules_named(tmp_path, code, {})
    assert told.startswith("the config imports of_another_machine, which no package")
    recorded = record_environment({"software": {"robot_runner": "0.0.7"}}, tmp_path / "config")
    assert list(unkept_modules(ExperimentFolder(tmp_path), recorded)) == []
