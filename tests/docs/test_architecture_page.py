"""The page for the next owner names every package that there is, in the order in which they may import each other."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SOURCE = ROOT / "src" / "robot_runner"
ROWS = re.findall(
    r"^\|[^|\n]*\| (`[^|\n]*) \|", (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8"), re.MULTILINE
)
FLOORS = [re.findall(r"`([\w.]+)`", row) for row in ROWS]


def _layers() -> list[list[str]]:
    """The layers of the import contracts, each as the names of its packages below `robot_runner`."""
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"][
        "contracts"
    ]
    layered = [contract for contract in contracts if contract["type"] == "layers"]
    return [
        [(container + "." + name.strip()).removeprefix("robot_runner.") for name in layer.split("|")]
        for contract in layered
        for container in contract["containers"]
        for layer in contract["layers"]
    ]


def test_every_package_has_a_row() -> None:
    packages = {path.parent.name for path in SOURCE.glob("*/__init__.py")} - {"plugins"}  # a door
    named = {name.partition(".")[0] for floor in FLOORS for name in floor}
    assert packages - named == set()


def test_the_rows_stand_in_the_order_that_the_contract_allows() -> None:
    height = {name: -number for number, layer in enumerate(_layers()) for name in layer}
    heights = [[height[name] for name in floor if name in height] for floor in FLOORS]
    stack = [floor for floor in heights if floor]
    assert len(stack) > 5
    assert [max(floor) for floor in stack] == sorted((max(floor) for floor in stack), reverse=True)


def _where_to_look() -> list[tuple[list[Path], list[str]]]:
    """The files of each row that says where to look, and the names to be found in them."""
    rows = re.findall(
        r"^\|[^|\n]*\| (`[^|\n]*\.py`) \| ([^|\n]*) \|$",
        (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8"),
        re.MULTILINE,
    )
    found = []
    for files, words in rows:
        folder, paths = Path(), []
        for name in re.findall(r"`([\w/]+\.py)`", files):
            folder = Path(name).parent if "/" in name else folder
            paths.append(SOURCE / folder / Path(name).name)
        found.append((paths, re.findall(r"`([\w.]+)`", words)))
    return found


def test_what_a_run_passes_stands_where_the_page_says() -> None:
    rows = _where_to_look()
    assert len(rows) > 25
    for paths, names in rows:
        text = "\n".join(path.read_text(encoding="utf-8") for path in paths)
        lacking = [name for name in names if not re.search(rf"\b(def|class) {name.rpartition('.')[2]}\b", text)]
        assert lacking in ([], ["launch_mission"]), (paths, lacking)  # which is a user's


#: Executes a study, and writes when each function of ours is called, in each process of the run.
TRACED = """
import os, sys, time
from robot_runner.cli.main import main

calls = []

def take(frame, event, _):
    if event == "call" and frame.f_code.co_filename.startswith(sys.argv[1]):
        calls.append("\\t".join([f"{time.monotonic_ns():020}", frame.f_code.co_filename, frame.f_code.co_qualname]))

def write():
    sys.setprofile(None)
    with open(f"calls.{os.getpid()}", "w") as file:
        file.write("\\n".join(calls))

def leave(code, leave=os._exit):
    write()
    leave(code)

os._exit = leave
os.register_at_fork(after_in_child=calls.clear)
sys.setprofile(take)
main(["study.py", "--plain"])
write()
"""
STUDY = """
from robot_runner import ExperimentConfig, Factor, RunTableModel

class Study(ExperimentConfig):
    experiment_name = "study"

    def create_run_table(self): return RunTableModel([Factor("speed", [1])], data_columns=["distance"])
    def launch_mission(self, context): context.publish("distance", 2.0)
"""


def _steps() -> list[tuple[list[str], list[str]]]:
    """The files of each step of one run's path, and the functions in them, in order."""
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    path = page.partition("### One run, file by file")[2].partition("Subjects beside this path")[0]
    told = [re.findall(r"`([\w.]+)`", words) for words in re.findall(r"^\|.*\|(.*)\|$", path, re.MULTILINE)[2:]]
    return [(list(map(str, paths)), names) for (paths, _), names in zip(_where_to_look(), told, strict=False)]


@pytest.mark.long
def test_one_run_goes_the_way_that_the_page_tells(tmp_path: Path) -> None:
    (tmp_path / "study.py").write_text(STUDY)
    traced = [sys.executable, "-c", TRACED, str(SOURCE)]
    done = subprocess.run(traced, cwd=tmp_path, capture_output=True, text=True, timeout=100, check=False)
    written = list(tmp_path.glob("calls.*"))
    assert len(written) == 3, done.stderr  # orchestrator, keeper, run
    calls = sorted(line.split("\t") for each in written for line in each.read_text().splitlines())
    floors = _steps()
    assert len(floors) == 10
    for files, names in floors:
        assert len(files) == 2
        for name in names:
            place = next((i for i, (_, *called) in enumerate(calls) if called[0] in files and called[1] == name), None)
            assert place is not None, f"{name} of {files} is not called there"
            calls = calls[place:]
