"""Reports that are written once for all tests that only read them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from tests.analysis import experiment_folders

from robot_runner.analysis.report.writing import write_report

if TYPE_CHECKING:
    from pathlib import Path

    from robot_runner.analysis.report.writing import WrittenReport

VIDEO, NETWORK = (870.123456789, 872.4, 869.0, 874.2, 871.3), (834.0, 836.1, 833.2, 838.0, 835.5)


@pytest.fixture(scope="session")
def plain_report(tmp_path_factory: pytest.TempPathFactory) -> WrittenReport:
    """Return the report of two tasks as it is written unless told otherwise, with all files."""
    return write_report(experiment_folders.two_tasks(tmp_path_factory.mktemp("plain") / "trial", VIDEO, NETWORK).root)


@pytest.fixture(scope="session")
def lone_page(tmp_path_factory: pytest.TempPathFactory) -> WrittenReport:
    """Return the report of two tasks in a folder of its own, without files of figures."""
    folder = tmp_path_factory.mktemp("lone")
    root = experiment_folders.two_tasks(folder / "trial", VIDEO, NETWORK).root
    return write_report(root, output=folder / "elsewhere" / "deep", figures=())


@pytest.fixture(scope="session")
def sampled_page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the page of an experiment with samples of power and phases of a mission."""
    folder = experiment_folders.two_tasks(tmp_path_factory.mktemp("sampled") / "trial", VIDEO, NETWORK)
    power = [f"{t / 10},{7 + (t > 40) + (t % 3) / 10}" for t in range(100)]
    folder.write_samples("Meter", "samples.csv", "time_s,power_W", lambda place: power)
    phases = ["1,sleep,0.0,4.0", "2,task,4.0,10.0"]
    folder.write_samples("Robot", "phases.csv", "number,phase,start_s,end_s", lambda place: phases)
    way = [f"{t / 10},{t / 100},{t / 500},0.0" for t in range(100)]
    folder.write_samples("Robot", "trajectory.csv", "time_s,x_m,y_m,heading_rad", lambda place: way)
    return write_report(folder.root, figures=()).document
