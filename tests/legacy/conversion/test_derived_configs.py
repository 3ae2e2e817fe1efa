"""A config that derives from a config in another file is converted with it, and does what it did before."""

from __future__ import annotations

import re
import resource
from typing import TYPE_CHECKING

import pytest
from tests.legacy.conversion.test_converting import measures_of
from tests.legacy.earlier_configs import ROBOT, RUNNER, SHORT_TABLE

from robot_runner.cli.main import main
from robot_runner.core.errors import ConfigError
from robot_runner.legacy.conversion.bases import load_apart
from robot_runner.legacy.conversion.converting import convert

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from tests.legacy.earlier_configs import Executed

METHODS = """
def before_run(self):
    self.extra = 5

def interact(self, context: RunnerContext) -> None:
    output.console_log(f"{self.name}: run {context.run_nr}")
    self.size = context.execute_run["size"]

def populate_run_data(self, context: RunnerContext):
    return {"seconds": self.extra + self.size}
"""
BASE = RUNNER.replace(
    "from pathlib", "from ProgressManager.Output.OutputProcedure import OutputProcedure as output\nfrom pathlib"
)


@pytest.fixture(autouse=True)
def _apart() -> Iterator[None]:
    """Forget the modules of one test before the next one has others of the same names."""
    with load_apart():
        yield


@pytest.fixture
def study(config: Callable[..., Path], write: Callable[..., Path]) -> Path:
    """Return a config two folders below the one that it derives from, by everything that one has."""
    config(METHODS, head=BASE, name="BaseOfStudy.py")
    return write(
        """
        import os, sys
        sys.path.append(os.path.dirname(os.path.dirname(os.path.dirname(__file__))))
        from BaseOfStudy import *

        class RunnerConfig(RunnerConfig):
            name = "derived"

            def create_run_table_model(self) -> RunTableModel:
                self.run_table_model = RunTableModel(
                    factors=[FactorModel("size", [1, 2]), FactorModel("cache", ["on", "off"])],
                    exclude_combinations=[{"off", 2}],
                    data_columns=["seconds"],
                )
                return self.run_table_model

            def interact(self, context: RunnerContext):
                super().interact(context)
                output.console_log(context.run_dir)
                self.size += 100
        """,
        "studies/one/E1.py",
    )


def same_rows(old: Path, new: Path, execute: Callable[..., Executed], columns: list[str]) -> list[list[str]]:
    """Execute both; the modules of one are not there for the other."""
    with load_apart():
        rows = measures_of(new, columns)
    with load_apart():
        assert rows == [[row[name] for name in columns] for row in execute(old).table]
    return rows


@pytest.mark.long
def test_a_config_and_the_one_that_it_derives_from_are_converted_together(
    study: Path, execute: Callable[..., Executed], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["convert", str(study)]) == 0
    new, base = study.with_name("E1_converted.py"), study.parents[2] / "BaseOfStudy_converted.py"
    text = new.read_text()
    assert "from BaseOfStudy_converted import *" in text
    assert "from robot_runner import Factor, RobotRunnerContext, RunTableModel\n" in text
    assert "class RobotRunnerConfig(RobotRunnerConfig):" in text
    assert "super().launch_mission(context)" in text
    assert "class RobotRunnerConfig(ExperimentConfig):" in base.read_text()
    assert same_rows(study, new, execute, ["size", "cache", "seconds"]) == [
        ["1", "on", "106"],
        ["1", "off", "106"],
        ["2", "on", "107"],
    ]
    assert "it plans the same 3 runs" in capsys.readouterr().out.replace("\n", " ")


def test_an_old_config_goes_on_beside_its_conversion(study: Path) -> None:
    with load_apart():
        assert main(["convert", str(study), "--out", str(study.with_name("new.py"))]) == 0
    assert {each.name for each in study.parent.glob("*.py")} == {"E1.py", "new.py", "BaseOfStudy_converted.py"}
    with load_apart():
        assert main(["check", str(study)]) == 0


def test_what_becomes_of_a_config_that_was_executed_is_executed_under_another_name(
    config: Callable[..., Path], execute: Callable[..., Executed], capsys: pytest.CaptureFixture[str]
) -> None:
    path = config()
    assert main(["convert", str(path)]) == 0
    assert "--set" not in capsys.readouterr().out
    execute(path)
    assert main(["convert", str(path)]) == 0
    told = " ".join(capsys.readouterr().out.split())
    name = re.search(r"config_converted\.py --set experiment_name=(\w+)", told)
    assert name is not None
    with load_apart():
        assert main(["run", str(path.with_name("config_converted.py")), "--set", f"experiment_name={name[1]}"]) == 0


def test_what_a_base_cannot_keep_is_found_in_the_file_of_the_base(
    config: Callable[..., Path], write: Callable[..., Path]
) -> None:
    methods = METHODS.replace("self.size =", "context.execute_run['other'] = 1; self.size =")
    base = config(methods, head=BASE, table="", name="BaseOfStudy.py")
    derived = write(
        """
        from BaseOfStudy import *

        class RunnerConfig(RunnerConfig):
            def create_run_table_model(self) -> RunTableModel:
                return RunTableModel(factors=[FactorModel("size", [1, 2])], data_columns=["seconds"])
        """,
        "E2.py",
    )
    with pytest.raises(ConfigError, match="this writes into the row of the run table") as caught:
        convert(derived)
    place, _, line = caught.value.findings[0].where.rpartition(":")
    assert place == str(base)
    assert "'other'" in base.read_text().splitlines()[int(line) - 1]


@pytest.mark.long
def test_a_chain_of_three_files_is_written_to_one_folder(
    study: Path, write: Callable[..., Path], execute: Callable[..., Executed], tmp_path: Path
) -> None:
    last = write(
        """
        import sys
        from pathlib import Path
        sys.path.append(str(Path(__file__).parent / "studies"))
        from one.E1 import RunnerConfig as Middle, RunnerContext, output

        class RunnerConfig(Middle):
            name = "last"

            def __init__(self):
                super().__init__()
                self.more = 1000

            def populate_run_data(self, context: RunnerContext):
                output.console_log(f"{Middle.name}")
                return {"seconds": Middle.populate_run_data(self, context)["seconds"] + self.more}
        """,
        "E1.py",
    )
    assert main(["convert", str(last), "--out", str(tmp_path / "new")]) == 2, "there is no such folder"
    (tmp_path / "new").mkdir()
    assert main(["convert", str(last), "--out", str(tmp_path / "new")]) == 0
    new = tmp_path / "new" / "E1.py"
    assert {each.name for each in new.parent.glob("*.py")} == {"E1.py", "E1_base.py", "BaseOfStudy.py"}
    assert "from E1_base import RobotRunnerConfig as Middle\n" in new.read_text()
    assert "Middle.experiment_name" in new.read_text()
    assert [row[0] for row in same_rows(last, new, execute, ["seconds", "size"])] == ["1106", "1106", "1107"]


@pytest.mark.long
def test_bases_in_a_package_may_import_each_other_relative_to_it(
    config: Callable[..., Path], write: Callable[..., Path], execute: Callable[..., Executed]
) -> None:
    config(METHODS, head=BASE, name="lab/base.py", table=SHORT_TABLE)
    write("", "lab/__init__.py")
    write("", "lab/patrols/__init__.py")
    write("BONUS = 30", "lab/bonus.py")
    write(
        """
        from ..base import RunnerConfig as Base, RunnerContext
        from ..bonus import BONUS
        from .. import base

        class RunnerConfig(Base):
            def interact(self, context: RunnerContext):
                base.RunnerConfig.interact(self, context)
                self.size += BONUS
        """,
        "lab/patrols/long.py",
    )
    old = write("from lab.patrols.long import RunnerConfig as Long\n\nclass RunnerConfig(Long):\n    name = 'patrol'\n")
    assert main(["convert", str(old)]) == 0
    middle = (old.parent / "lab/patrols/long_converted.py").read_text()
    assert "from lab.base_converted import RobotRunnerConfig as Base\n" in middle
    assert "from ..bonus import BONUS\n" in middle
    rows = same_rows(old, old.with_name("config_converted.py"), execute, ["size", "seconds"])
    assert rows[0] == ["10", "45"]


@pytest.mark.long
@pytest.mark.parametrize(
    ("imported", "parent", "before"),
    [
        ("from lab.more import *", "RunnerConfig", "Common"),
        pytest.param(
            "from lab.more import Common as C, RunnerConfig, RunnerContext",
            "RunnerConfig",
            "C",
            marks=pytest.mark.soak,
        ),
        ("import BaseOfStudy as base\nRunnerContext = object", "base.Common", "base.Common"),
        pytest.param("from lab.more import *\nParent = RunnerConfig", "Parent", "Parent", marks=pytest.mark.soak),
    ],
)
def test_a_method_that_is_called_by_the_name_of_a_class_is_renamed_however_the_class_is_reached(
    config: Callable[..., Path],
    write: Callable[..., Path],
    execute: Callable[..., Executed],
    imported: str,
    parent: str,
    before: str,
) -> None:
    head = BASE.replace("class RunnerConfig", "class Common")
    config(METHODS, head=head, name="BaseOfStudy.py", table=SHORT_TABLE)
    write("from BaseOfStudy import *\n\nclass RunnerConfig(Common):\n    name = 'more'\n", "lab/more.py")
    old = write(
        f"{imported}\n\nclass RunnerConfig({parent}):\n    def interact(self, context: RunnerContext):\n"
        f"        {before}.interact(self, context)\n        self.size += 100\n"
    )
    assert main(["convert", str(old)]) == 0
    assert same_rows(old, old.with_name("config_converted.py"), execute, ["size", "seconds"])[0] == ["10", "115"]


ABSTRACT = (
    ROBOT.replace("class RobotRunnerConfig", "class Common").replace("patrol", "common")
    + """
    def prepare(self): self.base = 7

    def drive(self, context: RobotRunnerContext):
        context.run_variation["energy"] = context.run_variation["speed"] * self.base

    def before_experiment(self): raise AssertionError("nobody subscribed this")
"""
)
DERIVED = """
from EventManager.EventSubscriptionController import EventSubscriptionController
from EventManager.Models.RobotRunnerEvents import RobotRunnerEvents
from ConfigValidator.Config.Models.FactorModel import FactorModel
from ConfigValidator.Config.Models.RunTableModel import RunTableModel
from parts import abstract_of_patrol

class RobotRunnerConfig(abstract_of_patrol.Common):
    name = "{name}"

    def __init__(self):
        EventSubscriptionController.subscribe_to_multiple_events([
            (RobotRunnerEvents.BEFORE_RUN, self.prepare),
            (RobotRunnerEvents.LAUNCH_MISSION, self.drive),
        ])

    def create_run_table(self):
        model = RunTableModel(factors=[FactorModel("speed", {speeds})], data_columns=["energy"])
        model.create_experiment_run_table()
        return model.get_experiment_run_table()
"""


@pytest.mark.long
def test_all_configs_of_a_folder_share_the_class_that_they_derive_from(
    write: Callable[..., Path], execute: Callable[..., Executed], tmp_path: Path
) -> None:
    write(ABSTRACT, "parts/abstract_of_patrol.py")
    first = write(DERIVED.format(name="first", speeds=[1, 2]), "first.py")
    second = write(DERIVED.format(name="second", speeds=[3]), "second.py")
    assert main(["convert", str(tmp_path)]) == 0
    base = tmp_path / "parts" / "abstract_of_patrol_converted.py"
    assert "class Common(ExperimentConfig):" in base.read_text()
    assert "def _before_experiment(self)" in base.read_text()
    new = tmp_path / "first_converted.py"
    assert "class RobotRunnerConfig(abstract_of_patrol.Common):" in new.read_text()
    assert "Subscription" not in new.read_text()
    assert same_rows(first, new, execute, ["speed", "energy"]) == [["1", "7"], ["2", "14"]]
    assert same_rows(second, tmp_path / "second_converted.py", execute, ["speed", "energy"]) == [["3", "21"]]


@pytest.mark.long
def test_a_converted_base_is_kept_and_said_so_unless_it_is_to_be_written_anew(
    study: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["convert", str(study)]) == 0
    base = study.parents[2] / "BaseOfStudy_converted.py"
    written = base.read_text()
    base.write_text(written.replace("self.extra = 5", "self.extra = 6"))
    capsys.readouterr()
    assert main(["convert", str(study)]) == 0
    assert "which is there already and is kept" in capsys.readouterr().out.replace("\n", " ")
    assert "self.extra = 6" in base.read_text()
    assert main(["convert", str(study), "--overwrite"]) == 0
    assert base.read_text() == written
    assert main(["convert", str(study), "--out", str(study), "--overwrite"]) == 2, "the old file is never written over"
    assert "EventManager" in (study.parents[2] / "BaseOfStudy.py").read_text()


@pytest.mark.long
def test_a_file_that_is_to_be_written_anew_is_kept_where_the_disk_has_no_room(
    study: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["convert", str(study)]) == 0
    mine = [study.with_name(f"{study.stem}_converted.py"), study.parents[2] / "BaseOfStudy_converted.py"]
    for file in mine:
        file.write_text("mine\n")
    unlimited = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, unlimited[1]))  # as on a full disk
    try:
        assert main(["convert", str(study), "--overwrite"]) == 2
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, unlimited)
    assert "the file cannot be written: File too large" in capsys.readouterr().err
    assert [file.read_text() for file in mine] == ["mine\n"] * 2
    assert main(["convert", str(study), "--overwrite"]) == 0
    assert not [file for file in mine if file.read_text() == "mine\n"]


def test_bases_of_the_same_name_are_not_taken_for_each_other(
    study: Path, write: Callable[..., Path], capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    other = write(study.read_text().replace("E1", "E2"), "others/two/three/E2.py")
    text = (tmp_path / "BaseOfStudy.py").read_text()
    write(text.replace("self.extra = 5", "self.extra = 6"), "others/BaseOfStudy.py")
    (tmp_path / "new").mkdir()
    assert main(["convert", str(study), str(other), "--out", str(tmp_path / "new")]) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert "there is a file of this name already" in said
    assert "Convert the configs into folders of their own" in said


def test_what_a_base_has_that_has_no_counterpart_is_named_with_its_line(
    study: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    base = study.parents[2] / "BaseOfStudy.py"
    line = "from ProgressManager.Output.CSVOutputManager import CSVOutputManager"
    base.write_text(f"{line}\n{base.read_text()}\n    def after_experiment(self): CSVOutputManager(self.name)\n")
    assert main(["convert", str(study)]) == 2
    said = capsys.readouterr().err.replace("\n", " ")
    assert said.count("error") == 1
    assert "BaseOfStudy.py:1: CSVOutputManager has no counterpart here" in said
    assert not study.with_name("E1_converted.py").exists()


HEAR_OTHER = "EventSubscriptionController.subscribe_to_single_event(RunnerEvents.POPULATE_RUN_DATA, self.other)"


@pytest.mark.long
@pytest.mark.parametrize(
    ("init", "text"),
    [
        ("self.extra = 0", "def before_run(self):"),
        (HEAR_OTHER, ""),
        (
            f"super().__init__(); {HEAR_OTHER}",
            "def populate_run_data(self, context): return {'seconds': 3}",
        ),
    ],
)
def test_what_a_derived_config_hears_otherwise_it_goes_on_to_hear(
    study: Path, execute: Callable[..., Executed], init: str, text: str
) -> None:
    text_before = study.read_text().partition("    def interact")[0]
    study.write_text(
        f"{text_before}\n    def __init__(self): {init}\n\n    def other(self, context): return {{'seconds': 3}}\n"
    )
    assert main(["convert", str(study)]) == 0
    new = study.with_name("E1_converted.py")
    assert text in new.read_text()
    same_rows(study, new, execute, ["size", "cache", "seconds"])


def test_a_callback_that_takes_the_place_of_one_that_it_calls_is_refused(
    study: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    study.write_text(
        study.read_text().replace("def interact(", "def work(").replace("super().interact", "self.interact")
        + "\n    def __init__(self):\n        super().__init__()\n"
        "        EventSubscriptionController.subscribe_to_single_event(RunnerEvents.INTERACT, self.work)\n"
    )
    assert main(["convert", str(study)]) == 2
    assert "work is subscribed in the place of interact, which this class calls" in capsys.readouterr().err.replace(
        "\n", " "
    )


def test_what_is_reached_through_a_module_has_to_be_imported_by_its_name(study: Path) -> None:
    study.write_text(
        study.read_text()
        .replace("from BaseOfStudy import *", "import BaseOfStudy as base\nRunTableModel = RunnerContext = object")
        .replace("RunnerConfig(RunnerConfig)", "RunnerConfig(base.RunnerConfig)")
        .replace("output.", "base.output.")
    )
    study.write_text(study.read_text().split("    def create_run_table_model")[0] + "    seen = base.output\n")
    with pytest.raises(Exception, match=r"output of the earlier tool is used as base\.output"):
        convert(study)


@pytest.mark.long
def test_a_derived_config_that_asks_the_user_starts_its_first_run_by_itself(
    config: Callable[..., Path], write: Callable[..., Path], execute: Callable[..., Executed]
) -> None:
    config("def before_experiment(self): self.count = 40", head=ROBOT, name="base_that_waits.py")
    old = write(
        """
        from base_that_waits import *

        class RobotRunnerConfig(RobotRunnerConfig):
            name = "asking"
            operation_type = OperationType.SEMI

            def __init__(self):
                super().__init__()
                EventSubscriptionController.subscribe_to_multiple_events([
                    (RobotRunnerEvents.CONTINUE, self.swap), (RobotRunnerEvents.POPULATE_RUN_DATA, self.data)])

            def swap(self): self.count += 1

            def data(self, context): return {"energy": self.count}
        """
    )
    assert main(["convert", str(old)]) == 0
    new = old.with_name("config_converted.py")
    assert "super().before_experiment()" in new.read_text()
    assert same_rows(old, new, execute, ["energy"]) == [["40"], ["41"], ["42"], ["43"]]
