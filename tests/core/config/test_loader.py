from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from robot_runner.core.config.loader import load_config
from robot_runner.core.config.preparation import prepare
from robot_runner.core.errors import ConfigError, Finding

Write = Callable[..., Path]


def refused(path: Path, **overrides: str) -> tuple[Finding, ...]:
    with pytest.raises(ConfigError) as error:
        load_config(path, overrides)
    assert all(finding.fix for finding in error.value.findings)
    return error.value.findings


def refused_line(write_config: Write, line: str) -> Finding:
    """Return the finding on a line at the beginning of an otherwise valid config."""
    (finding,) = refused(write_config(head=f"{line}\nclass RobotRunnerConfig:\n    pass\n"))
    return finding


def test_a_file_that_is_not_there_is_refused_with_the_nearest_name(write_config: Write) -> None:
    path = write_config()
    (finding,) = refused(path.with_name("confg.py"))
    assert finding.problem == "there is no such file"
    assert "config.py" in finding.fix


def test_a_folder_is_refused(tmp_path: Path) -> None:
    (found,) = refused(tmp_path)
    assert found.problem == "the path names a folder, not a config file"
    assert found.fix == "Name the config file that results are made by, which ends in .py; imported results have none."
    (tmp_path / "study.py").touch()
    assert refused(tmp_path)[0].fix == "Name the config file in it: study.py."


def test_a_pipe_is_refused_instead_of_waiting_for_what_nobody_writes(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "study.py")
    (found,) = refused(tmp_path / "study.py")
    assert found.problem == "the path names no regular file"


def test_a_file_that_is_not_python_is_refused_with_the_line(tmp_path: Path) -> None:
    path = tmp_path / "config.py"
    path.write_text("x = 1\nclass RobotRunnerConfig\n    pass\n")
    (finding,) = refused(path)
    assert finding.where.endswith("config.py:2")
    assert "class RobotRunnerConfig" in finding.problem


@pytest.mark.parametrize("content", [b"\xff\xfe\x00", b"a\0b"])
def test_bytes_that_are_no_source_are_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "config.py"
    path.write_bytes(content)
    assert "the file is not" in refused(path)[0].problem


def test_a_file_without_a_config_class_is_refused_with_the_class_that_was_meant(tmp_path: Path) -> None:
    path = tmp_path / "config.py"
    path.write_text("class RobotRunerConfig:\n    pass\n")
    (finding,) = refused(path)
    assert finding.fix == "Rename the class RobotRunerConfig to RobotRunnerConfig."


def test_a_class_derived_from_ours_may_have_any_name(write_config: Write) -> None:
    path = write_config(
        head="from robot_runner import *\nclass Mine(ExperimentConfig):\n    experiment_name = 'mine'\n"
    )
    assert load_config(path).source.class_name == "Mine"


def test_two_config_classes_are_one_too_many(tmp_path: Path) -> None:
    path = tmp_path / "config.py"
    path.write_text(
        "from robot_runner import ExperimentConfig\nclass A(ExperimentConfig): pass\nclass B(ExperimentConfig): pass\n"
    )
    assert "A, B" in refused(path)[0].problem


def test_what_the_file_raises_is_a_finding_with_the_line_of_the_file(write_config: Write) -> None:
    path = write_config(head="import json\njson.loads('nonsense')\nclass RobotRunnerConfig:\n    pass\n")
    (finding,) = refused(path)
    assert finding.where == f"{path}:2"
    assert "JSONDecodeError" in finding.problem


def test_a_config_that_exits_while_it_is_loaded_does_not_take_us_with_it(write_config: Write) -> None:
    assert "SystemExit" in refused_line(write_config, "import sys\nsys.exit(0)").problem


@pytest.mark.parametrize("file", ["drivers.py", "drivers/__init__.py", "drivers/robots/arm.py"])
def test_a_module_in_a_folder_above_the_config_is_told_with_this_folder(tmp_path: Path, file: str) -> None:
    module = tmp_path / file
    module.parent.mkdir(parents=True, exist_ok=True)
    module.touch()
    path = tmp_path / "studies" / "config.py"
    path.parent.mkdir()
    path.write_text("import drivers\nclass RobotRunnerConfig:\n    pass\n")
    assert refused(path)[0].fix == (
        f"Python does not search {tmp_path}, which has a 'drivers'. If it is meant, write PYTHONPATH={tmp_path} "
        "before the command; otherwise install the package that brings 'drivers'."
    )


def test_a_module_that_its_package_does_not_have_is_told_with_the_folder_of_the_package(write_config: Write) -> None:
    assert refused_line(write_config, "import json.decodr").fix == (
        f"'json' is in {Path(json.__file__).parent}, which has no 'decodr': "
        "correct the name, or get the version that has it."
    )


def test_a_folder_without_python_above_the_config_is_not_taken_for_a_missing_package(tmp_path: Path) -> None:
    (tmp_path / "no_such_package").mkdir()
    path = tmp_path / "studies" / "config.py"
    path.parent.mkdir()
    path.write_text("import no_such_package\nclass RobotRunnerConfig:\n    pass\n")
    assert refused(path)[0].fix == "Install the package that brings 'no_such_package', or correct the name."


@pytest.mark.parametrize(
    ("line", "fix"),
    [
        ("import os; os.environ['NO_NAME']", "Set it in the environment: export NO_NAME=... before the command."),
        ("{}['NO_SUCH_NAME']", "Correct this line."),
        ("import no_package", "Install the package that brings 'no_package', or correct the name."),
        ("import robotrunner", "Did you mean 'robot_runner'?"),
        ("import robot_runner.profilers", "Did you mean 'robot_runner.plugins.profilers'?"),
        (
            "from robot_runner.plugins import PsUtil",
            "It is elsewhere: from robot_runner.plugins.profilers import PsUtil",
        ),
        ("from robot_runner import Psutil", "Correct this line."),
        ("from robot_runner.plugins.profilers import PsUtill", "Did you mean 'PsUtil'?"),
        ("from robot_runner.plugins import Factor", "It is elsewhere: from robot_runner import Factor"),
        ("from pathlib import Pth", "Did you mean 'Path'?"),
        ("raise ImportError(\"cannot import name 'x' from 'no.such'\")", "Correct this line."),
        ("x = Factor('Task', [1])", "Import it: from robot_runner import Factor"),
        ("x = PsUtil()", "Import it: from robot_runner.plugins.profilers import PsUtil"),
        ("x = time.time()", "Import it: import time"),
        ("x = Callable", "Import it: from collections.abc import Callable"),
        ("x = Any", "Import it: from typing import Any"),
        ("x = Path('results')", "Import it: from pathlib import Path"),
        ("x = dataclass", "Import it: from dataclasses import dataclass"),
        ("x = Enum", "Import it: from enum import Enum"),
        ("x = np.pi", "Import it: import numpy as np"),
        ("x = plt.figure()", "Import it: import matplotlib.pyplot as plt"),
        ("shuffle = true", "Did you mean 'True'?"),
        ("pritn(1)", "Did you mean 'print'?"),
        ("x = later", "Define it, import it, or correct the name."),
        ("x = speed", "Define it, import it, or correct the name."),
        ("speeds = [0.1]\nx = sppeds[0]", "Did you mean 'speeds'?"),
        ("x = qqqqq", "Define it, import it, or correct the name."),
    ],
)
def test_a_line_that_raises_is_told_with_the_import_or_the_name_that_mends_it(
    write_config: Write, line: str, fix: str
) -> None:
    assert refused_line(write_config, line).fix == fix


def test_a_neighbour_that_is_called_like_a_module_of_pythons_is_to_be_renamed(
    write_config: Write, tmp_path: Path
) -> None:
    (tmp_path / "queue.py").write_text("orders = []\n")
    finding = refused_line(write_config, "from queue import orders")
    assert finding.fix == f"Rename {tmp_path / 'queue.py'}: Python's own module of that name was imported instead."


@pytest.mark.parametrize("fault", ["x = 1 / 0", "x = (", "raise KeyError('x')"])
def test_an_error_in_a_neighbour_is_placed_in_it(write_config: Write, tmp_path: Path, fault: str) -> None:
    """The line of the import was to be corrected, where nothing was wrong."""
    helper = tmp_path / "faulty_neighbour.py"
    helper.write_text(f"y = 1\n{fault}\n")
    path = write_config(head="import faulty_neighbour\nclass RobotRunnerConfig:\n    pass\n")
    assert refused(path)[0].where == f"{helper}:2, from {path}:1"


def test_a_neighbour_that_is_imported_in_place_of_pythons_own_is_to_be_renamed(
    write_config: Write, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delitem(sys.modules, "colorsys", raising=False)
    shadow = tmp_path / "colorsys.py"
    shadow.touch()
    for line in ("from colorsys import rgb_to_hsv", "import colorsys; colorsys.rgb_to_hsv"):
        finding = refused_line(write_config, line)
        assert finding.fix == f"Rename {shadow}: it is imported in place of Python's own module of that name."
    monkeypatch.delitem(sys.modules, "colorsys", raising=False)


def test_modules_that_import_each_other_are_told_how_to_part(write_config: Write, tmp_path: Path) -> None:
    (tmp_path / "first_of_two.py").write_text("import second_of_two\nx = 1\n")
    (tmp_path / "second_of_two.py").write_text("from first_of_two import x\n")
    finding = refused_line(write_config, "import first_of_two")
    assert finding.fix == "Move what both modules need into a third, which both import."


@pytest.mark.parametrize(
    ("name", "fix"),
    [
        ("study.ipynb", "Have the notebook execute it by run_experiment, or save its code as study.py."),
        ("study.txt", "Give it a name that ends in .py."),
    ],
)
def test_a_file_of_another_kind_is_refused(write_config: Write, name: str, fix: str) -> None:
    path = write_config(head='{"cells": [], "metadata": {}}\n', table="", name=name)
    (finding,) = refused(path)
    assert (finding.problem, finding.fix) == ("a config is a Python file, and this is none by its name", fix)


def test_neighbours_of_the_config_can_be_imported_and_are_known(write_config: Write, tmp_path: Path) -> None:
    (tmp_path / "neighbour_module.py").write_text("NAME = 'from next door'\n")
    head = "import neighbour_module\nclass RobotRunnerConfig:\n    experiment_name = neighbour_module.NAME\n"
    loaded = load_config(write_config(head=head))
    assert loaded.config.experiment_name == "from next door"
    assert loaded.local_modules == {tmp_path / "neighbour_module.py": Path("neighbour_module.py")}


def test_the_papers_import_lines_activate_plugins(write_config: Write) -> None:
    head = """\
import plugins.systems.BasicTurtlebot3
import plugins.profilers.Ina219
import plugins.profilers.PsUtil
class RobotRunnerConfig:
    meter = plugins.profilers.Ina219.Ina219
"""
    loaded = load_config(write_config(head=head))
    assert [plugin.__name__ for plugin in loaded.activated] == ["BasicTurtlebot3", "Ina219", "PsUtil"]
    assert loaded.config.meter is loaded.activated[1]


def test_the_papers_import_lines_exist_only_while_a_config_is_loaded(write_config: Write) -> None:
    load_config(write_config(head="import plugins.profilers.PsUtil\nclass RobotRunnerConfig:\n    pass\n"))
    assert not [name for name in sys.modules if name == "plugins" or name.startswith("plugins.")]
    with pytest.raises(ModuleNotFoundError):
        __import__("plugins.profilers.PsUtil")


def test_a_plugin_that_is_not_installed_is_refused_with_the_nearest_name(write_config: Write) -> None:
    path = write_config(head="import plugins.profilers.Ina291\nclass RobotRunnerConfig:\n    pass\n")
    (finding,) = refused(path)
    assert finding.where.startswith(f"{path}:1")
    assert finding.fix == "Did you mean 'Ina219'?"


def test_a_users_own_package_named_plugins_comes_first(write_config: Write, tmp_path: Path) -> None:
    (tmp_path / "plugins").mkdir()
    (tmp_path / "plugins" / "__init__.py").write_text("OWN = True\n")
    head = "import plugins\nimport plugins.profilers.PsUtil\nclass RobotRunnerConfig:\n    own = plugins.OWN\n"
    try:
        loaded = load_config(write_config(head=head))
    finally:
        sys.modules.pop("plugins", None)
    assert loaded.config.own
    assert [plugin.__name__ for plugin in loaded.activated] == ["PsUtil"]


def test_explicit_subscriptions_are_recorded(write_config: Write) -> None:
    body = """
        def __init__(self):
            EventSubscriptionController.subscribe_to_multiple_events([
                (RobotRunnerEvents.LAUNCH_MISSION, self.go),
            ])
        def go(self, context): pass
        """
    loaded = load_config(write_config(body))
    assert [callback for _, callback in loaded.subscriptions] == [loaded.config.go]


def test_a_parameter_can_be_set_from_outside_and_is_seen_by_the_constructor(write_config: Write) -> None:
    body = """
        speed = 0.2
        fast = False
        def __init__(self):
            self.seen = (self.robot, self.speed, self.fast)
        """
    loaded = load_config(write_config(body), {"robot": "simulated", "speed": "0.1", "fast": "yes"})
    assert loaded.config.seen == ("simulated", 0.1, True)


def test_an_override_wins_over_what_the_constructor_sets(write_config: Write) -> None:
    body = """
        def __init__(self):
            self.experiment_name = "made here"
        """
    assert load_config(write_config(body), {"experiment_name": "x"}).config.experiment_name == "x"


def test_every_override_that_cannot_be_is_a_finding(write_config: Write) -> None:
    findings = refused(write_config(), robt="simulated", time_between_runs_in_ms="soon", operation_type="manual")
    assert [finding.where for finding in findings] == [
        "--set robt=simulated",
        "--set time_between_runs_in_ms=soon",
        "--set operation_type=manual",
    ]
    assert findings[0].fix == "Did you mean 'robot'?"


@pytest.mark.parametrize(
    ("line", "fix"),
    [
        ("plugins = [BasicTurtlebot3(sped=0.2)]", "Did you mean 'speed'?"),
        ("plugins = [systems.BasicTurtlebot3(sped=0.2)]", "Did you mean 'speed'?"),
        ("plugins = [Robot(sped=0.2)]", "Did you mean 'speed'?"),
        ("plugins = [Robot(sped=treatment('Speed'))]", "Did you mean 'speed'?"),
        ("made = Factor('Task', treatmnts=[1, 2])", "Did you mean 'treatments'?"),
        ("made = int(bse=3)", "Correct this line."),
    ],
)
def test_a_keyword_with_a_slip_names_the_one_that_was_meant(write_config: Write, line: str, fix: str) -> None:
    head = (
        "from robot_runner import *\nfrom robot_runner.plugins import systems, treatment\n"
        "from robot_runner.plugins.systems import BasicTurtlebot3\nRobot = BasicTurtlebot3\n\n\n"
        f"class RobotRunnerConfig(ExperimentConfig):\n    experiment_name = 'slip'\n    {line}\n"
    )
    (finding,) = refused(write_config(head=head))
    assert finding.fix == fix


def test_a_config_is_compiled_as_python_does_without_the_loaders_own_future_statements(write_config: Write) -> None:
    head = "class Own:\n    speed: float\n\n\nclass RobotRunnerConfig:\n    kind = Own.__annotations__['speed']\n"
    loaded = load_config(write_config(head=head))
    assert loaded.config.kind is float


@pytest.mark.parametrize(
    ("name", "line", "fix"),
    [
        ("robot", "os.environ['NO_SUCH_ROBOT']", "Set it in the environment: export NO_SUCH_ROBOT=... "),
        ("plugins", "[1 / 0]", "Correct this line."),
        ("attempts", "self.atempts_of_mine + self.attempts_of_min", "Did you mean 'attempts_of_mine'?"),
    ],
)
def test_what_a_property_raises_in_the_place_of_a_parameter_is_a_finding_with_its_line(
    write_config: Write, name: str, line: str, fix: str
) -> None:
    body = f"attempts_of_mine = 2\n@property\ndef {name}(self):\n    return {line}"
    path = write_config(body, head="import os\nclass RobotRunnerConfig:\n    experiment_name = 'computed'\n")
    (finding,) = refused(path)
    assert finding.where == f"{path}:8"
    assert finding.fix.startswith(fix)


@pytest.mark.parametrize("word", ["no", "No", "false", " 0 "])
def test_a_flag_of_ours_and_one_of_the_users_take_the_same_words(write_config: Write, word: str) -> None:
    config = load_config(write_config("fast = True"), {"probe": word, "fast": word}).config
    assert (config.probe, config.fast) == (False, False)
    (finding,) = refused(write_config("fast = True"), fast="off")
    assert finding.fix == "It must be True or False."


def test_an_enumeration_of_the_users_own_is_set_by_a_name(write_config: Write) -> None:
    path = write_config("level = Level.LOW", head=f"import enum\n{LEVEL}\nclass RobotRunnerConfig:\n    pass\n")
    assert load_config(path, {"level": "high"}).config.level.name == "HIGH"
    assert load_config(path, {"level": "Level.HIGH"}).config.level == 2
    (finding,) = refused(path, level="3")
    assert finding.fix == "It must be one of Level.LOW, Level.HIGH."


LEVEL = "class Level(enum.IntEnum):\n    LOW = 1\n    HIGH = 2\n"


def test_an_attribute_that_no_text_can_set_is_not_said_to_be_missing(write_config: Write) -> None:
    (finding,) = refused(write_config("speeds = [1, 2]"), speeds="3")
    assert finding.problem == "'speeds' is of type list, which cannot be set from outside"
    assert finding.fix == "Set it in the config."


@pytest.mark.parametrize(
    "name", ["hosts", "smoke", "gates", "guards", "operator_steps", "notify", "analysis", "repeat_until"]
)
def test_of_a_parameter_that_no_text_can_write_it_is_said_where_it_belongs(write_config: Write, name: str) -> None:
    (finding,) = refused(write_config(""), **{name: "pi=pi@robot"})
    assert "in the config file" in finding.fix


@pytest.mark.parametrize("head", [b"\xef\xbb\xbf", b"# -*- coding: latin-1 -*-\n"], ids=["mark of Notepad", "declared"])
def test_a_file_is_decoded_as_python_decodes_it(write_config: Write, head: bytes) -> None:
    path = write_config("café = 'é'")
    encoding = "latin-1" if b"latin" in head else "utf-8"
    path.write_bytes(head + path.read_text(encoding="utf-8").encode(encoding))
    assert load_config(path).config.café == "é"
    experiment = prepare(path)
    assert experiment.findings == ()


def test_of_config_classes_that_derive_from_each_other_the_last_one_is_executed(tmp_path: Path) -> None:
    path = tmp_path / "config.py"
    text = "import robot_runner as rr\nclass Lab(rr.ExperimentConfig): pass\nclass Study(Lab): attempts = 3\n"
    path.write_text(text)
    assert load_config(path).source.class_name == "Study"
    path.write_text(f"{text}class Other(Lab): pass\n")
    assert refused(path)[0].problem == "the file has 2 config classes: Study, Other"


def test_a_config_may_have_slots(write_config: Write) -> None:
    assert prepare(write_config("__slots__ = ('arm',)", head=f"{PLAIN}    experiment_name = 'slots'\n")).findings == ()


PLAIN = "from robot_runner import *\n\n\nclass RobotRunnerConfig:\n"
