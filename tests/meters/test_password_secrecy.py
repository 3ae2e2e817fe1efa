"""A whole experiment with a meter that wants a password, after which nothing on disk and no screen holds it."""

from __future__ import annotations

import pytest
from tests.meters.fake_plugs import FakePlug, PlugOnHttp

PASSWORD = "s3cret&more"  # noqa: S105 - of the tests' own server

CONFIG = """\
from pathlib import Path

from robot_runner import ExperimentConfig, Factor, RunTableModel
from robot_runner.plugins.profilers import SmartPlug


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "plugged"
    results_output_path = Path("results")
    time_between_runs_in_ms = 0
    plugins = [SmartPlug({kind!r}, url={url!r}, password_env="PLUG_PASSWORD", rate_hz=5)]

    def create_run_table(self):
        return RunTableModel([Factor("load", ["low"])])

    def launch_mission(self, context):
        context.clock.sleep(2.0)
"""


@pytest.mark.parametrize("kind", ["tasmota", "shelly1", "shelly2"])
@pytest.mark.parametrize("password", [pytest.param(PASSWORD, marks=pytest.mark.long), "wrong s3cret"])
def test_no_record_of_an_experiment_holds_the_password(tmp_path, monkeypatch, robot_runner, kind, password):
    monkeypatch.setenv("PLUG_PASSWORD", password)
    plug = PlugOnHttp(FakePlug(), password=PASSWORD)
    (tmp_path / "config.py").write_text(CONFIG.format(kind=kind, url=plug.url))
    try:
        answers = [robot_runner("check", "config.py"), robot_runner("config.py")]
    finally:
        plug.stop()
    is_good = password == PASSWORD
    assert [answer.code == 0 for answer in answers] == [is_good, is_good], answers
    if is_good:
        table = (tmp_path / "results" / "plugged" / "run_table.csv").read_text()
        assert "42.5" in table
    written = [path for path in tmp_path.rglob("*") if path.is_file() and b"s3cret" in path.read_bytes()]
    assert written == []
    assert not [answer for answer in answers if "s3cret" in answer.out + answer.err]
