"""The whole way: an experiment file, the orchestrator, the profiler, a serial port, the firmware, a known current."""

from __future__ import annotations

import csv
import json

import pytest
from tests.firmware.measuring import VOLTS

from robot_runner.cli.main import main

CONFIG = """\
from pathlib import Path
import time
from robot_runner import *
from robot_runner.plugins.profilers import Ina219


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "metered"
    results_output_path = Path({folder!r})
    operation_type = OperationType.AUTO
    plugins = [Ina219(port={port!r})]

    def launch_mission(self, context):
        context.clock.sleep(2.0)

    def create_run_table(self):
        return RunTableModel([Factor("Load", ["same"])], repetitions=2, data_columns=["Energy", "MeanPower"])
"""


@pytest.mark.long
@pytest.mark.filterwarnings("ignore:.*multi-threaded:DeprecationWarning")
def test_an_experiment_fills_its_run_table_from_the_meter(free_board, tmp_path, capsys):
    config = tmp_path / "config.py"
    with free_board(load="0:0.8", volts=VOLTS, pace=1, openings=3) as meter:
        config.write_text(CONFIG.format(folder=str(tmp_path), port=meter.port))
        code = main(["run", str(config)])
    said = capsys.readouterr()
    assert code == 0, said
    with (tmp_path / "metered" / "run_table.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [float(row["MeanPower"]) for row in rows] == pytest.approx([0.8 * VOLTS] * 2, rel=0.005)
    raw = [tmp_path / "metered" / "runs" / row["run_id"] / "Ina219" / "quality.json" for row in rows]
    windows = [json.loads(path.read_text())["window"] for path in raw]
    seconds = [window["end"] - window["start"] for window in windows]  # 2 s, and more where the machine is busy
    assert min(seconds) >= 2.0
    assert [float(row["Energy"]) for row in rows] == pytest.approx([0.8 * VOLTS * each for each in seconds], rel=0.01)


@pytest.mark.filterwarnings("ignore:.*multi-threaded:DeprecationWarning")
def test_a_meter_that_is_not_plugged_in_refuses_the_experiment(tmp_path, capsys):
    config = tmp_path / "config.py"
    config.write_text(CONFIG.format(folder=str(tmp_path), port="/dev/no-such-port"))
    assert main(["run", str(config)]) == 2
    assert "there is no serial port '/dev/no-such-port'" in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "metered").exists()
