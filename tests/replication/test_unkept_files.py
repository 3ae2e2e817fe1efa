"""Packing names files that the config's code reads and that the package lacks, as nobody else could execute it."""

from __future__ import annotations

import shutil
from typing import TYPE_CHECKING

import pytest

from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.replication.packing import pack
from robot_runner.replication.sealing import Packing
from robot_runner.replication.unkept_files import unkept_files

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
