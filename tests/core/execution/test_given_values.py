"""What a config takes from outside is recorded with each execution, and a later one is compared with it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from typing import TYPE_CHECKING, Any

import pytest
from tests.conftest import written_config
from tests.long_cases import soak_but

from robot_runner.core.config.preparation import prepare_or_refuse
from robot_runner.core.errors import ExecutionError
from robot_runner.core.execution.given_values import LEFT_OUT, given_elsewhere, given_values
from robot_runner.core.execution.notices import SilentObserver
from robot_runner.core.execution.orchestrator import execute_experiment
from robot_runner.core.execution.resumption import Resumption, config_changes

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


METER = """\
import os
import random
import tempfile
import time
from datetime import date
from pathlib import Path
from robot_runner import *
from robot_runner.plugins import Measure, Profiler


class Meter(Profiler):
    measures = (Measure("V", "V", "What a voltmeter shows."),)

    def __init__(self, *, gain=1.0, limits=(), wifi_password="", told=None, name=None):
        super().__init__(name=name)
        self.gain = gain

    def populate_run_data(self, context):
        context.publish("V", self.gain)


HERE = Path(__file__).parent


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "trial"
    results_output_path = Path("results")
    run_process = RunProcess.IN_PROCESS
"""
TABLE = """\
    def create_run_table(self):
        return RunTableModel([Factor("Task", [1, 2])])
"""


@pytest.fixture
def of_meter(write_config: Callable[..., Path]) -> Callable[..., Path]:
    """Return what writes a config whose meter is made with these arguments."""

    def write(arguments: str, body: str = "") -> Path:
        return write_config(f"{body}\nplugins = [Meter({arguments})]", head=METER, table=TABLE)

    return write


def start(config: Path, **asked: Any) -> Any:
    return execute_experiment(prepare_or_refuse(config), SilentObserver(), resumption=Resumption(**asked))


def manifest_of(config: Path) -> dict[str, Any]:
    manifest: dict[str, Any] = json.loads((config.parent / "results" / "trial" / "manifest.json").read_text("utf-8"))
    return manifest


def given(config: Path) -> dict[str, Any]:
    return given_values(prepare_or_refuse(config))


@pytest.mark.long
def test_a_value_of_a_plugin_from_the_environment_that_changes_is_told_like_a_changed_config(
    of_meter: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    config = of_meter('gain=float(os.environ["GAIN"])')
    monkeypatch.setenv("GAIN", "1")
    start(config, only=("r_1",))
    assert not config_changes(prepare_or_refuse(config))
    monkeypatch.setenv("GAIN", "5")
    with pytest.raises(ExecutionError) as refused:
        start(config)
    (finding,) = refused.value.findings
    assert finding.where == f"{config}, Meter.gain"
    assert finding.problem.startswith("the value was 1.0 and is 5.0, and comes from outside the file")
    assert "--accept-changes" in finding.fix
    start(config, accept_changes=True)
    first, second = manifest_of(config)["executions"]
    assert (first["given"]["Meter.gain"], second["given"]["Meter.gain"]) == (1.0, 5.0)
    assert second["changed_values"] == {"Meter.gain": {"was": 1.0, "is": 5.0}}
    assert start(config).done_count == 2  # it was accepted, and is told once


def test_a_value_that_equals_the_small_process_id_of_a_container_is_recorded(
    of_meter: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    experiment = prepare_or_refuse(of_meter("gain=1, limits=(1.0, 60)"))
    for process in (1, 60):
        monkeypatch.setattr(os, "getpid", lambda own=process: own)
        values = given_values(experiment)
        assert (values["Meter.gain"], values["Meter.limits"]) == (1, [1.0, 60])


@pytest.mark.parametrize(
    ("body", "name"),
    [
        ('robot = os.environ.get("OF_TEST")', "robot"),
        ('attempts = int(os.environ["OF_TEST_N"])', "attempts"),
        ('task_s = float(os.environ["OF_TEST_N"])', "task_s"),
        ('def __init__(self): self.levels = [1, int(os.environ["OF_TEST_N"])]', "levels"),
        (
            'gates = [Gate(port_open(1, host="localhost"), timeout_s=int(os.environ["OF_TEST_N"]))]',
            "gates[0].timeout_s",
        ),
    ],
)
def test_static_parameters_and_attributes_from_the_environment_are_compared(
    write_config: Callable[..., Path], monkeypatch: pytest.MonkeyPatch, body: str, name: str
) -> None:
    config = write_config(body, head=METER)
    monkeypatch.setenv("OF_TEST_N", "1")
    before = given(config)
    monkeypatch.setenv("OF_TEST_N", "2")
    monkeypatch.setenv("OF_TEST", "simulated")
    after = given(config)
    assert {each for each in {*before, *after} if before.get(each) != after.get(each)} == {name}


def test_what_differs_by_itself_is_no_change(
    of_meter: Callable[..., Path], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))  # where mkdtemp leaves what it makes
    config = of_meter(
        "gain=random.random(), told=[object(), time.time(), tempfile.mkdtemp(), str(date.today()), os.getpid(), print]",
        "seed = random.randrange(1 << 60)\nbegan = time.monotonic()",
    )
    start(config, only=("r_1",))
    assert start(config).done_count == 2


def test_numbers_are_recorded_on_a_board_whose_clock_was_not_set_yet(of_meter: Callable[..., Path]) -> None:
    """It begins at 1970, and whatever is small would pass for the present moment."""
    config = of_meter("gain=2.5, told=[3, time.time()]")
    began, since = time.monotonic(), time.monotonic
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(time, "time", lambda: since() - began + 40.0)
        assert given(config)["Meter.gain"] == 2.5
        start(config, only=("r_1",))
    assert start(config).done_count == 2, "a moment differs by itself"


def test_when_and_where_a_config_is_loaded_is_no_value_of_it(
    of_meter: Callable[..., Path], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    config = of_meter(
        'told=[time.strftime("%H:%M:%S"), platform.node()]', "import os, platform\nbegun_in = os.getcwd()"
    )
    assert given(config).items() >= {"begun_in": LEFT_OUT, "Meter.told": LEFT_OUT}.items()
    monkeypatch.chdir(tmp_path)
    assert given(config)["begun_in"] == LEFT_OUT


def test_the_order_of_a_set_which_is_another_in_each_process_is_no_change(of_meter: Callable[..., Path]) -> None:
    config = of_meter("told=['scan', 'odom', frozenset({'a', 'b'})]")
    start(config, only=("r_1",))
    path, manifest = config.parent / "results" / "trial" / "manifest.json", manifest_of(config)
    manifest["executions"][0]["given"]["Meter.told[2]"].reverse()
    path.write_text(json.dumps(manifest), "utf-8")
    assert not config_changes(prepare_or_refuse(config))


def test_a_list_that_is_in_another_order_is_told_and_refuses_nothing(
    of_meter: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    # As one that is made of a set is in each process, and one from outside may be.
    config = of_meter("", 'ROUTE = sorted(["dock", "lab"], reverse="TURNED" in os.environ)')
    start(config, only=("r_1",))
    original = manifest_of(config)
    monkeypatch.setenv("TURNED", "yes")
    assert given_elsewhere(prepare_or_refuse(config), original, ()) == ["ROUTE (['dock', 'lab'], here ['lab', 'dock'])"]
    (told,) = [each for each in start(config).findings if "ROUTE" in each.problem]
    assert told.problem == "the order of ROUTE was ['dock', 'lab'], and is ['lab', 'dock'] now"
    assert not told.is_error
    assert manifest_of(config)["executions"][-1]["changed_values"].keys() == {"ROUTE"}


def test_what_is_large_is_told_by_its_checksum_and_what_cannot_be_looked_at_is_left_out(
    of_meter: Callable[..., Path],
) -> None:
    class_of_stranger = 'type("Odd", (dict,), {"items": lambda self: 1 / 0})()'
    config = of_meter(f"limits=[(x, x + 1) for x in range(1000)]), Meter(name='second', told={class_of_stranger}")
    values = given(config)
    assert values["second"] == LEFT_OUT
    assert values["Meter.limits"].startswith("SHA-256 ")
    assert len(values) < 20


def test_a_plugin_that_is_there_no_more_is_told(of_meter: Callable[..., Path], monkeypatch: pytest.MonkeyPatch) -> None:
    config = of_meter(')] + [Meter(name="second")] * ("OF_TEST" in os.environ) + [Meter(name="third"')
    monkeypatch.setenv("OF_TEST", "1")
    before = given(config)
    monkeypatch.delenv("OF_TEST")
    assert before.keys() - given(config).keys() == {"second", "second.name"}


def test_a_folder_of_results_and_its_config_may_lie_elsewhere(of_meter: Callable[..., Path], tmp_path: Path) -> None:
    config = of_meter('told={"room": HERE / "lab.toml", "url": f"file://{HERE}/lab.toml"}')
    before = given(config)
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    config = config.rename(elsewhere / config.name)
    assert given(config) == before
    assert before["Meter.told['room']"] == "./lab.toml"


def test_secrets_are_not_recorded(of_meter: Callable[..., Path], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LAB_TOKEN", "open-sesame")
    monkeypatch.setenv("OF_TEST", "rtsp://ada:lovelace@10.0.0.7/stream")
    config = of_meter(
        'wifi_password="swordfish", told=["Bearer " + os.environ["LAB_TOKEN"], {"api_key": "abcdefgh"}]',
        'url = os.environ["OF_TEST"]; of_camera = "rtsp://10.0.0.8/user=ada&password=lovelace&channel=1"',
    )
    start(config)
    text = (config.parent / "results" / "trial" / "manifest.json").read_text("utf-8")
    assert "Meter.wifi_password" in text
    assert not any(secret in text for secret in ("swordfish", "open-sesame", "abcdefgh", "lovelace"))
    assert manifest_of(config)["executions"][0]["given"]["url"] == "rtsp://REDACTED@10.0.0.7/stream"
    of_camera = manifest_of(config)["executions"][0]["given"]["of_camera"]
    assert of_camera == "rtsp://10.0.0.8/user=ada&password=REDACTED&channel=1"


def test_an_experiment_of_an_older_version_that_recorded_nothing_goes_on(
    of_meter: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    config = of_meter('gain=float(os.environ.get("GAIN", 1))')
    start(config, only=("r_1",))
    path, manifest = config.parent / "results" / "trial" / "manifest.json", manifest_of(config)
    del manifest["executions"][0]["given"]
    path.write_text(json.dumps(manifest), "utf-8")
    monkeypatch.setenv("GAIN", "5")
    assert start(config).done_count == 2


def test_what_is_set_from_outside_is_told_once(of_meter: Callable[..., Path]) -> None:
    config = of_meter("")
    start(config, only=("r_1",))
    (finding,) = config_changes(prepare_or_refuse(config, {"grace_in_s": "5"}))
    assert finding.where == "--set grace_in_s"


def test_gates_that_are_set_or_left_out_are_told_once_and_not_by_all_of_their_parts(
    of_meter: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    gates = 'gates = [Gate(load_below(each), timeout_s=60.0) for each in map(float, os.environ["LOADS"].split())]'
    monkeypatch.setenv("LOADS", "1000 2000")
    config = of_meter("", f"from robot_runner import load_below\n{gates}")
    start(config, only=("r_1",))
    (finding,) = config_changes(prepare_or_refuse(config, {"gates": "none"}))
    assert finding.where == "--set gates"
    monkeypatch.setenv("LOADS", "1000")
    (finding,) = config_changes(prepare_or_refuse(config))
    assert finding.where == f"{config}, gates[1]"
    assert finding.problem.startswith("the value was 'Gate' and is not given")


def test_a_replication_is_told_what_the_original_was_given_otherwise_but_for_places_and_what_is_set(
    of_meter: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("GAIN", "1")
    config = of_meter(
        'gain=float(os.environ["GAIN"]), limits=(random.random(),), told=Path(os.environ["GAIN"], "lab/a.toml")'
    )
    start(config)
    monkeypatch.setenv("GAIN", "5")
    experiment = prepare_or_refuse(config)
    assert given_elsewhere(experiment, manifest_of(config), ()) == ["Meter.gain (1.0, here 5.0)"]
    assert given_elsewhere(experiment, manifest_of(config), {"Meter.gain"}) == []
    assert given_elsewhere(experiment, {"executions": [{}]}, ()) == []


def test_constants_of_a_module_that_is_found_by_a_relative_path_are_recorded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for folder in ("study", "shared"):
        (tmp_path / folder).mkdir()
    (tmp_path / "shared" / "levels_shared.py").write_text('import os\nLEVEL = os.environ["OF_TEST_N"]\n', "utf-8")
    config = written_config(
        tmp_path / "study", head='import sys\nsys.path.insert(0, "../shared")\nimport levels_shared\n' + METER
    )
    monkeypatch.chdir(tmp_path / "study")
    monkeypatch.setattr(sys, "path", [*sys.path])
    found = []
    for value in ("1", "2"):
        monkeypatch.setenv("OF_TEST_N", value)
        monkeypatch.delitem(sys.modules, "levels_shared", raising=False)
        found.append(given(config).get("levels_shared.py: LEVEL"))
    assert found == ["1", "2"]


OF_SCRIPT = """\
import os
from pathlib import Path
from robot_runner import *

HERE = Path(__file__).parent
LEVELS = [1, 2]


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "trial"
    results_output_path = Path("results")
    attempts = int(os.environ["OF_TEST_N"])
    limits = {"low": 1}

    def create_run_table(self):
        return RunTableModel([Factor("Task", LEVELS)])


if __name__ == "__main__":
    run_experiment(RobotRunnerConfig, only=["r_1"])
"""


@pytest.mark.long
@pytest.mark.parametrize("is_script_first", soak_but([True], [True, False]))
def test_a_script_that_executes_its_own_class_and_the_command_go_on_with_each_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, is_script_first: bool
) -> None:
    config = tmp_path / "study.py"
    config.write_text(OF_SCRIPT, "utf-8")
    monkeypatch.setenv("OF_TEST_N", "1")
    script = [sys.executable, str(config)]
    command = [sys.executable, "-m", "robot_runner", str(config), "--plain"]
    first, second = (script, command) if is_script_first else ([*command, "--only", "r_1"], [*script])
    subprocess.run(first, check=True, capture_output=True, timeout=60)
    experiment = prepare_or_refuse(config)
    assert not config_changes(experiment)
    assert given_elsewhere(experiment, manifest_of(config), ()) == []
    monkeypatch.setenv("OF_TEST_N", "2")
    (changed,) = config_changes(prepare_or_refuse(config))
    assert changed.where.endswith(", attempts")
    monkeypatch.setenv("OF_TEST_N", "1")
    subprocess.run(second, check=True, capture_output=True, timeout=60)
    assert len(manifest_of(config)["executions"]) == 2
