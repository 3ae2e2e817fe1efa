from __future__ import annotations

import csv
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from tests.conftest import HEAD

from robot_runner.core.config.preparation import prepare_or_refuse
from robot_runner.core.design.factor import Factor
from robot_runner.core.design.run_table_model import RunTableModel
from robot_runner.core.errors import ExecutionError, Finding, StorageError
from robot_runner.core.execution import manifest_content
from robot_runner.core.execution.notices import SilentObserver
from robot_runner.core.execution.orchestrator import execute_experiment
from robot_runner.core.execution.resumption import Resumption, TableChoice, config_changes, table_differences
from robot_runner.core.storage.guarded_files import replace
from robot_runner.core.storage.journal import read_journal
from robot_runner.core.storage.run_table_rows import RunTableRows
from robot_runner.core.storage.table_columns import TableLayout

Execute = Callable[..., Any]
Write = Callable[..., Path]

COUNTING = """
run_process = RunProcess.IN_PROCESS

def populate_run_data(self, context):
    return {"Energy": context.attempt}
"""


def resume(config: Path, **asked: Any) -> list[dict[str, str]]:
    experiment = prepare_or_refuse(config)
    execute_experiment(experiment, SilentObserver(), resumption=Resumption(**asked))
    return read(experiment.folder.run_table)


def resumed_findings(config: Path) -> tuple[Finding, ...]:
    return execute_experiment(prepare_or_refuse(config), SilentObserver()).findings


def read(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")


@pytest.mark.long
def test_done_runs_can_be_executed_again_and_keep_what_they_left(execute: Execute) -> None:
    executed = execute(COUNTING + "\ndef launch_mission(self, context): print('attempt', context.attempt)")
    table = resume(executed.config, redo=("r_2", "r_4"))
    assert [row["Energy"] for row in table] == ["1", "2", "1", "2"]
    kept = executed.folder / "earlier_attempts" / "r_2" / "1" / "log.txt"
    assert kept.read_text(encoding="utf-8") == "attempt 1\n"


@pytest.mark.parametrize(
    ("warm_up", "asked", "executed"),
    [
        ("2", {"first": ("r_6",)}, "w_1 w_2 r_6 r_1 r_2 r_3 r_4 r_5"),
        ("2", {"only": ("Task=Idle",)}, "w_1 w_2 r_5 r_6"),
        ("2", {"only": ("r_4",), "skip": ("w_2",)}, "w_1 r_4"),
        ("WarmUp(1, per='Task')", {"first": ("r_4",)}, "w_2 r_4 w_1 r_1 r_2 r_3 w_3 r_5 r_6"),
        ("WarmUp(1, per='Task')", {"first": ("w_3",), "only": ("w_3", "r_4")}, "w_3 w_2 r_4"),
        ("WarmUp(1, per='Task')", {"only": ("w_3",)}, "w_3"),
    ],
)
def test_chosen_runs_warm_up_first_where_they_have_not_yet(
    write_config: Write, warm_up: str, asked: dict[str, tuple[str, ...]], executed: str
) -> None:
    table = f"""\
    def create_run_table(self):
        tasks = Factor("Task", ["Video", "Network", "Idle"])
        return RunTableModel([tasks], repetitions=2, blocks="Task", warm_up={warm_up})
"""
    path = write_config("run_process = RunProcess.IN_PROCESS\n", table=table)
    execute_experiment(prepare_or_refuse(path), SilentObserver(), resumption=Resumption(**asked))
    began = read_journal(path.parent / "results" / "trial" / "journal.jsonl", kinds={"attempt_started"})
    assert " ".join(each["run"] for each in began) == executed


def test_only_the_chosen_runs_are_executed(write_config: Write) -> None:
    table = resume(write_config(COUNTING), only=("r_3",))
    assert [row["status"] for row in table] == ["-", "-", "Done", "-"]


def test_a_run_that_is_not_in_the_table_cannot_be_chosen(write_config: Write) -> None:
    with pytest.raises(ExecutionError) as refused:
        resume(write_config(COUNTING), only=("r_7",), redo=("x",))
    assert [finding.where for finding in refused.value.findings] == ["--redo x", "--only r_7"]


def test_a_changed_config_is_refused_with_the_lines_that_changed(execute: Execute, write_config: Write) -> None:
    execute(COUNTING)
    changed = write_config(COUNTING.replace("context.attempt", "2 * context.attempt"))
    with pytest.raises(ExecutionError) as refused:
        resume(changed)
    (finding,) = refused.value.findings
    assert finding.where.endswith("config.py:12")
    assert 'return {"Energy": context.attempt}' in finding.problem
    assert 'return {"Energy": 2 * context.attempt}' in finding.problem
    assert "--accept-changes" in finding.fix


@pytest.mark.long
def test_values_do_not_come_under_another_unit_than_they_were_taken_in(execute: Execute, write_config: Write) -> None:
    def table(energy: str, speed: str = "m/s") -> str:
        factor = f'Factor("Speed", [1, 2], unit="{speed}")'
        return (
            "    def create_run_table(self):\n"
            f'        return RunTableModel([{factor}], data_columns=[Measure("Energy", "{energy}")], seed=1)\n'
        )

    executed = execute(COUNTING, table=table("J"))
    schema = executed.folder / "run_table.schema.json"
    for other, said in ((table("kJ"), "Energy is in J"), (table("J", "km/h"), "Speed is in m/s")):
        with pytest.raises(ExecutionError, match=said) as refused:
            resume(write_config(COUNTING, table=other), accept_changes=True)
        assert "choose another experiment_name" in refused.value.findings[0].fix
    assert json.loads(schema.read_text(encoding="utf-8"))["fields"][-1]["unit"] == "J"
    write(schema, schema.read_text(encoding="utf-8").replace('"J"', '"kJ"'))  # it was the wrong word
    assert len(resume(write_config(COUNTING, table=table("kJ")), accept_changes=True)) == 2


def test_a_measure_without_a_unit_may_get_one(execute: Execute, write_config: Write) -> None:
    executed = execute(COUNTING)
    table = (
        "    def create_run_table(self):\n        return RunTableModel([Factor('Task', ['Video', 'Network'])], "
        "repetitions=2, data_columns=[Measure('Energy', 'J')], seed=1)\n"
    )
    resume(write_config(COUNTING, table=table), accept_changes=True)
    schema = json.loads((executed.folder / "run_table.schema.json").read_text(encoding="utf-8"))
    assert schema["fields"][-1]["unit"] == "J"


@pytest.mark.long
def test_a_change_of_a_module_from_elsewhere_is_refused_like_one_of_the_config(
    write_config: Write, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    module = tmp_path_factory.mktemp("elsewhere") / "a_gain_from_elsewhere.py"
    write(module, "def gained():\n    return 2\n")
    monkeypatch.syspath_prepend(str(module.parent))
    config = write_config("def populate_run_data(self, context):\n    from a_gain_from_elsewhere import gained\n")
    resume(config, only=("r_1",))
    kept = prepare_or_refuse(config).folder.config / module.name
    assert kept.read_text(encoding="utf-8") == module.read_text(encoding="utf-8")
    write(module, "def gained():\n    return 20\n")
    with pytest.raises(ExecutionError) as refused:
        resume(config)
    (finding,) = refused.value.findings
    assert finding.where == f"{module}:2"


def test_a_change_of_what_is_installed_as_it_stands_is_told(
    write_config: Write, monkeypatch: pytest.MonkeyPatch
) -> None:
    digests = iter(("a1", "b2"))
    monkeypatch.setattr(manifest_content, "editable_code", lambda: {"lab-tools": next(digests)})
    experiment = prepare_or_refuse(write_config(COUNTING))
    manifest = manifest_content.manifest_of(experiment)
    assert manifest_content.changed_circumstances(manifest) == {"code of package lab-tools": {"was": "a1", "is": "b2"}}
    monkeypatch.setattr(manifest_content, "editable_code", dict)  # it is not imported any more
    assert manifest_content.changed_circumstances(manifest) == {}


def test_a_file_that_runs_read_and_that_is_edited_while_they_are_executed_is_told(execute: Execute) -> None:
    body = """
    run_process = RunProcess.IN_PROCESS
    rooms = Path(__file__).with_name("rooms.yaml")
    rooms.write_text("hall")
    def input_files(self): return [InputFile(self.rooms)]
    def launch_mission(self, context): context.run_number == 2 and self.rooms.write_text("kitchen")
    """
    executed = execute(body, head=f"from pathlib import Path\nfrom robot_runner.plugins import InputFile\n{HEAD}")
    rooms = str(executed.config.with_name("rooms.yaml"))
    (told,) = (each for each in executed.finished.findings if each.where == rooms)
    assert told.problem.startswith("changed while the experiment was executed: ")
    assert "What the config writes for each run itself is no input: leave it out" in told.fix


@pytest.mark.long
def test_a_module_that_callbacks_import_and_that_is_edited_meanwhile_is_told(execute: Execute, tmp_path: Path) -> None:
    (tmp_path / "drives_of_this_test.py").write_text("SPEED = 1\n")
    body = """
    def launch_mission(self, context):
        import drives_of_this_test
        if context.run_number == 2: Path(drives_of_this_test.__file__).write_text("SPEED = 2\\n")
        if context.run_number == 3: Path(__file__).write_text("# as loaded when it began")
    """
    executed = execute(body, head=f"from pathlib import Path\n{HEAD}")
    told = [each for each in executed.finished.findings if "changed while" in each.problem]
    assert [each.where for each in told] == [f"{tmp_path / 'drives_of_this_test.py'}:1"]


def test_a_package_that_is_replaced_while_runs_are_executed_is_told_and_kept(
    execute: Execute, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    installed = tmp_path / "site" / "lab_tools-1.0.dist-info"
    installed.mkdir(parents=True)
    monkeypatch.syspath_prepend(str(installed.parent))
    body = f"""
    run_process = RunProcess.IN_PROCESS
    installed = Path({str(installed)!r})
    def launch_mission(self, context):
        if context.run_number == 2: self.installed.rename(self.installed.with_name("lab_tools-2.0.dist-info"))
    """
    executed = execute(body, head=f"from pathlib import Path\n{HEAD}")
    (told,) = (each for each in executed.finished.findings if "lab_tools" in each.problem)
    assert told.problem == "replaced while the experiment was executed: package lab_tools (1.0, now 2.0)"
    manifest = json.loads((executed.folder / "manifest.json").read_text(encoding="utf-8"))
    assert manifest["executions"][0]["changed"] == {"package lab_tools": {"was": "1.0", "is": "2.0"}}
    (again,) = (each for each in resumed_findings(executed.config) if "lab_tools" in each.problem)
    assert "is not what the experiment began with" in again.problem


def test_a_changed_config_can_be_accepted_and_both_are_kept(execute: Execute, write_config: Write) -> None:
    executed = execute(COUNTING)
    resume(write_config(COUNTING.replace("context.attempt", "7")), accept_changes=True)
    assert "7" in (executed.folder / "config" / "config.py").read_text(encoding="utf-8")
    assert "7" not in (executed.folder / "earlier_configs" / "1" / "config.py").read_text(encoding="utf-8")


@pytest.mark.long
@pytest.mark.parametrize("room", [0, 1])
def test_a_disk_without_room_for_a_copy_of_the_config_makes_no_earlier_config_of_a_half_one(
    write_config: Write, monkeypatch: pytest.MonkeyPatch, room: int
) -> None:
    copies = iter(range(10))

    def copy(path: Path, content: bytes, root: Path) -> None:
        if next(copies) == room:
            raise StorageError("the file cannot be written: No space left on device", where=str(path))
        replace(path, content, root)

    config = write_config(COUNTING)
    config.with_name(f"helper_{room}.py").write_text("", encoding="utf-8")
    config.write_text(f"import helper_{room}\n{config.read_text(encoding='utf-8')}", encoding="utf-8")
    with monkeypatch.context() as patched:
        patched.setattr(manifest_content, "replace", copy)
        with pytest.raises(StorageError):
            resume(config)
    resume(config)
    folder = prepare_or_refuse(config).folder
    assert sorted(path.name for path in folder.config.iterdir()) == ["config.py", f"helper_{room}.py"]
    assert not folder.earlier_configs.exists()


@pytest.mark.long
@pytest.mark.parametrize("step", range(3))
def test_a_changed_config_whose_copy_a_kill_interrupted_is_asked_about_again(
    execute: Execute, write_config: Write, monkeypatch: pytest.MonkeyPatch, step: int
) -> None:
    executed = execute(COUNTING)
    changed = write_config(COUNTING.replace("context.attempt", "7"))
    steps = iter(range(10))

    def killed_at(done: Callable[..., Any]) -> Callable[..., Any]:
        def do(*arguments: Any) -> Any:
            if next(steps) == step:
                raise KeyboardInterrupt
            return done(*arguments)

        return do

    with monkeypatch.context() as patched:
        patched.setattr(manifest_content, "replace", killed_at(replace))
        patched.setattr(Path, "rename", killed_at(Path.rename))
        with pytest.raises(KeyboardInterrupt):
            resume(changed, accept_changes=True)
    with pytest.raises(ExecutionError, match="the line was"):
        resume(changed)
    resume(changed, accept_changes=True)
    assert "7" in (executed.folder / "config" / "config.py").read_text(encoding="utf-8")
    (earlier,) = (executed.folder / "earlier_configs").iterdir()
    assert "7" not in (earlier / "config.py").read_text(encoding="utf-8")


@pytest.mark.long
def test_another_config_that_names_the_same_experiment_is_compared_and_a_renamed_one_goes_on(
    execute: Execute, write_config: Write
) -> None:
    executed = execute(COUNTING)
    other = write_config(COUNTING.replace("context.attempt", "7"), name="other.py")
    with pytest.raises(ExecutionError, match=r"other\.py:12: .* and is 'return .\"Energy\": 7.'"):
        resume(other)
    executed.config.rename(other)
    resume(other)
    manifest = json.loads((executed.folder / "manifest.json").read_text(encoding="utf-8"))
    assert (executed.folder / "config" / manifest["config"]["file"]).read_bytes() == other.read_bytes()


@pytest.mark.long
def test_comments_and_blank_lines_are_no_change(execute: Execute, write_config: Write) -> None:
    execute(COUNTING)
    assert len(resume(write_config("# a remark\n\n\n" + COUNTING))) == 4


@pytest.mark.parametrize(
    ("before", "encoding"),
    [("# -*- coding: latin-1 -*-\n", "latin-1"), ("", "utf-8-sig")],
    ids=["declared", "with a byte order mark"],
)
def test_a_config_in_any_encoding_of_python_can_be_resumed_and_is_compared(
    write_config: Write, before: str, encoding: str
) -> None:
    path = write_config("place = 'Café'\nrun_process = RunProcess.IN_PROCESS")
    text = before + path.read_text(encoding="utf-8")
    path.write_text(text, encoding=encoding)
    resume(path)
    path.write_text(f"{text}    # à Genève\n", encoding=encoding)
    assert [row["status"] for row in resume(path)] == ["Done"] * 4
    path.write_text(text.replace("Café", "Musée"), encoding=encoding)
    with pytest.raises(ExecutionError, match="the line was \"place = 'Café'\" and is \"place = 'Musée'\""):
        resume(path)


def test_another_setting_is_a_change(write_config: Write) -> None:
    config = write_config(COUNTING)
    execute_experiment(prepare_or_refuse(config, {"grace_in_s": "5"}), SilentObserver())
    with pytest.raises(ExecutionError) as refused:
        resume(config)
    assert refused.value.findings[0].where == "--set grace_in_s"
    assert "set by --set grace_in_s=5 and is not set" in refused.value.findings[0].problem


def test_another_scheduler_of_a_cluster_is_no_change_and_none_is_one(execute: Execute) -> None:
    executed = execute(COUNTING.replace("IN_PROCESS", "FORK"))
    path = executed.folder / "manifest.json"
    manifest = json.loads(path.read_text(encoding="utf-8"))
    manifest["executions"][-1]["deviations"] = {"cluster": "tcp://10.0.0.1:8786"}
    write(path, json.dumps(manifest))
    assert not config_changes(prepare_or_refuse(executed.config, {"cluster": "tcp://10.0.0.2:41123"}))
    (finding,) = config_changes(prepare_or_refuse(executed.config))
    assert finding.problem.endswith("set by --set cluster=tcp://10.0.0.1:8786 and is not set")


@pytest.mark.long
def test_a_table_that_differs_from_the_plan_is_refused_cell_by_cell(execute: Execute) -> None:
    executed = execute(COUNTING)
    path = executed.folder / "run_table.csv"
    write(path, path.read_text(encoding="utf-8").replace("Video,1", "Network,1"))
    with pytest.raises(ExecutionError) as refused:
        resume(executed.config)
    (finding,) = refused.value.findings
    assert finding.where == f"{path}, run r_1, column 'Task'"
    assert finding.problem == "the table has 'Network', the plan 'Video'"
    assert "Undo the change" in finding.fix
    assert path.exists()


def test_many_runs_that_differ_from_the_plan_alike_are_told_once_and_by_their_names(tmp_path: Path) -> None:
    def model(*tasks: str) -> RunTableModel:
        return RunTableModel([Factor("Task", list(tasks)), Factor("N", list(range(100)))], data_columns=[])

    def named(first: int) -> str:
        return ", ".join(f"r_{number}" for number in range(first, first + 20)) + " and 80 more"

    planned, path = model("a", "c").plan(), tmp_path / "run_table.csv"
    rows = RunTableRows.of_plan(model("a", "b").plan(), TableLayout.of_model(model("a", "b"), ()))
    (changed,) = table_differences(path, planned, rows)
    assert changed.where == f"{path}, each of 100 runs, column 'Task'"
    assert changed.problem == f"the table has 'b', the plan 'c' ({named(101)})"
    (lacking,) = table_differences(path, model("a", "b", "c").plan(), rows)
    assert lacking.where == f"{path}, each of 100 runs"
    assert lacking.problem == f"the table lacks this run of the plan ({named(201)})"


def test_runs_that_differ_from_the_plan_in_several_ways_are_all_named(tmp_path: Path) -> None:
    """As where some treatments were edited by hand."""
    model = RunTableModel([Factor("N", list(range(100)))], data_columns=[])
    edited = list(model.plan())
    for place in range(7):
        edited[place] = edited[place]._replace(combination=edited[99 - place].combination)
    rows = RunTableRows.of_plan(edited, TableLayout.of_model(model, ()))
    found = list(table_differences(tmp_path / "run_table.csv", model.plan(), rows))
    assert [each.where for each in found] == [
        f"{tmp_path / 'run_table.csv'}, run r_{number}, column 'N'" for number in range(1, 8)
    ]


def test_a_changed_value_is_told_whatever_lines_have_changed(
    write_config: Write, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As a variable of the environment that is set to another value, beside a line that looks like it."""
    config = write_config(f"import os\nsample_rate = 1\nrate = int(os.environ['RATE'])\n{COUNTING}")
    monkeypatch.setenv("RATE", "1")
    resume(config)
    monkeypatch.setenv("RATE", "10")
    config.write_text(
        config.read_text(encoding="utf-8").replace("sample_rate = 1", "sample_rate = 100"), encoding="utf-8"
    )
    told = {each.where: each.problem for each in config_changes(prepare_or_refuse(config))}
    assert told[f"{config}, rate"] == "the value was 1 and is 10"


def test_a_plan_that_is_another_in_each_process_is_told_to_be(
    write_config: Write, monkeypatch: pytest.MonkeyPatch
) -> None:
    # As hash() and the order of a set of texts are; what a set yields here cannot be told beforehand.
    table = """
    def create_run_table(self):
        import os
        return RunTableModel([Factor("Task", sorted(["Video", "Network"], reverse="TURNED" in os.environ))])
"""
    config = write_config("run_process = RunProcess.IN_PROCESS", table=table)
    resume(config)
    monkeypatch.setenv("TURNED", "yes")
    with pytest.raises(ExecutionError, match="the table has 'Network', the plan 'Video'") as refused:
        resume(config)
    assert {"Nobody changed the table" in each.fix for each in refused.value.findings} == {True}
    assert len(resume(config, accept_changes=True)) == 2


def test_runs_of_a_table_that_counts_have_its_repetitions_though_the_config_repeats_nothing_any_more(
    write_config: Write,
) -> None:
    table = """\
    def create_run_table(self):
        return RunTableModel([Factor("Task", ["Video"])], repetitions={}, data_columns=["Energy"])
"""
    body = COUNTING.replace("context.attempt", "context.repetition")
    resume(write_config(body, table=table.format(3)), only=("r_1",))
    rows = resume(write_config(body, table=table.format(1)), accept_changes=True)
    assert [(row["Repetition"], row["Energy"]) for row in rows] == [("1", "1"), ("2", "2"), ("3", "3")]
    assert list(rows[0])[-3:] == ["Task", "Repetition", "Energy"]


@pytest.mark.long
def test_a_table_that_differs_can_be_accepted(execute: Execute) -> None:
    executed = execute(COUNTING)
    path = executed.folder / "run_table.csv"
    rows = path.read_text(encoding="utf-8").splitlines()
    write(path, "\n".join(rows[:-1]) + "\n")
    assert len(resume(executed.config, accept_changes=True)) == 3


@pytest.mark.long
def test_a_run_that_a_user_marks_as_to_do_is_executed_again(execute: Execute) -> None:
    executed = execute(COUNTING)
    path = executed.folder / "run_table.csv"
    write(path, path.read_text(encoding="utf-8").replace("r_2,Done", "r_2,-"))
    assert [row["Energy"] for row in resume(executed.config, table=TableChoice.FILE)] == ["1", "2", "1", "1"]


def test_a_hand_written_table_is_the_design(write_config: Write) -> None:
    config = write_config(COUNTING)
    table = config.parent / "results" / "trial" / "run_table.csv"
    write(table, "Weather;Repetition;Task\nsunny;1;Network\nrain;1;Network\nrain;1;Video\n")
    rows = resume(config)
    assert [row["run_id"] for row in rows] == ["r_1", "r_2", "r_3"]
    assert [row["Task"] for row in rows] == ["Network", "Network", "Video"]
    assert [row["Weather"] for row in rows] == ["sunny", "rain", "rain"]
    assert [row["status"] for row in rows] == ["Done"] * 3


def test_a_hand_written_table_stays_the_design_when_it_is_resumed(write_config: Write) -> None:
    config = write_config(COUNTING)
    table = config.parent / "results" / "trial" / "run_table.csv"
    write(table, "run_id,Repetition,Task\nfirst,1,Network\nsecond,1,Network\n")
    resume(config, only=("second",))
    rows = resume(config)
    assert [(row["run_id"], row["status"]) for row in rows] == [("first", "Done"), ("second", "Done")]


def test_everything_that_is_wrong_with_a_hand_written_table_is_said_at_once(write_config: Write) -> None:
    config = write_config(COUNTING)
    table = config.parent / "results" / "trial" / "run_table.csv"
    text = "run_id,status,Repetition,Task\na,maybe,1,Video\na,-,1,Video\nb,-,1\n"
    write(table, text)
    with pytest.raises(StorageError) as refused:
        resume(config)
    assert len(refused.value.findings) >= 3
    assert table.read_text(encoding="utf-8") == text


def test_treatments_keep_their_types_when_resumed(write_config: Write) -> None:
    head = """\
from robot_runner import *
class Tool:
    def __init__(self, name): self.name = name
    def __str__(self): return self.name
TOOLS = [Tool("hammer"), Tool("saw")]
class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "trial"
    results_output_path = "results"
"""
    body = """
def launch_mission(self, context):
    assert any(context.combination["Tool"] is tool for tool in TOOLS)
def populate_run_data(self, context):
    return {"Seen": repr([context.combination[name] for name in ("Int", "Float", "Bool", "None", "Text")])}
"""
    table = """\
    def create_run_table(self):
        return RunTableModel([
            Factor("Tool", TOOLS), Factor("Int", [-3]), Factor("Float", [-0.5]), Factor("Bool", [True]),
            Factor("None", [None]), Factor("Text", ["1"]),
        ], data_columns=["Seen"])
"""
    config = write_config(body, head=head, table=table)
    resume(config, only=("r_1",))
    rows = resume(config)
    assert [row["Seen"] for row in rows] == ["[-3, -0.5, True, None, '1']"] * 2
    assert [row["status"] for row in rows] == ["Done", "Done"]


def test_a_torn_last_line_of_the_journal_is_skipped(execute: Execute) -> None:
    executed = execute(COUNTING)
    journal = executed.folder / "journal.jsonl"
    with journal.open("ab") as file:
        file.write(b'{"kind":"attempt_finished","at":"2026-')
    assert [row["status"] for row in resume(executed.config)] == ["Done"] * 4
    assert b"2026-{" not in journal.read_bytes()


@pytest.mark.long
def test_runs_that_the_table_had_not_yet_are_taken_from_the_journal(execute: Execute) -> None:
    executed = execute(COUNTING)
    journal = executed.folder / "journal.jsonl"
    lines = journal.read_text(encoding="utf-8").splitlines(keepends=True)
    last_write = max(number for number, line in enumerate(lines) if '"table_written"' in line)
    first_write = min(number for number, line in enumerate(lines) if '"table_written"' in line)
    kept = [
        line for number, line in enumerate(lines[:last_write]) if number <= first_write or "table_written" not in line
    ]
    journal.write_text("".join(kept), encoding="utf-8")
    path = executed.folder / "run_table.csv"
    rows = read(path)
    header = ",".join(rows[0])
    blank = [
        ",".join(
            value if name in {"run_id", "Task", "Repetition"} else ("-" if name == "status" else "")
            for name, value in row.items()
        )
        for row in rows
    ]
    write(path, "\n".join([header, *blank]) + "\n")
    assert [row["Energy"] for row in resume(executed.config)] == ["1"] * 4


def test_the_manifest_tells_every_execution(execute: Execute) -> None:
    import json

    executed = execute(COUNTING)
    resume(executed.config)
    manifest = json.loads((executed.folder / "manifest.json").read_text(encoding="utf-8"))
    assert len(manifest["executions"]) == 2
    assert all(execution["finished_at"] for execution in manifest["executions"])


def test_what_changed_of_machine_and_software_since_the_first_execution_is_told(
    execute: Execute, monkeypatch: pytest.MonkeyPatch
) -> None:
    executed = execute(COUNTING)
    path = executed.folder / "manifest.json"
    manifest = json.loads(path.read_text(encoding="utf-8"))
    packages = manifest["software"]["packages"] | {"numpy": "1.0", "gone": "2.1"}
    manifest["software"] |= {"packages": packages, "system_packages": {"libc6": "1"}}
    ros = {"distro": "jazzy", "middleware": None, "packages": {"nav2": "1.3"}}
    path.write_text(json.dumps(manifest | {"ros": ros}), encoding="utf-8")
    other = {"distro": "jazzy", "middleware": "rmw_zenoh_cpp", "packages": {"nav2": "1.4"}}
    monkeypatch.setattr(manifest_content, "described_circumstances", lambda: {"ros": other})
    monkeypatch.setattr(manifest_content, "describe_host", lambda: {**manifest["host"], "processor": "another", "x": 1})
    now = packages | {"numpy": "2.0", "gone": None, "come": "1"}
    monkeypatch.setattr(manifest_content, "describe_software", lambda: manifest["software"] | {"packages": now})
    monkeypatch.setattr(manifest_content, "installed_packages", lambda: now)
    monkeypatch.setattr(manifest_content, "installed_system_packages", lambda: {"libc6": "1"})
    experiment = prepare_or_refuse(executed.config)
    finished = execute_experiment(experiment, SilentObserver())
    (finding,) = (each for each in finished.findings if "machine" in each.problem)
    assert "processor" in finding.problem
    assert "package numpy (1.0, now 2.0), package gone (2.1, now absent)" in finding.problem
    first, second = json.loads(path.read_text(encoding="utf-8"))["executions"]
    assert "changed" not in first
    assert second["changed"] == {
        "processor": {"was": manifest["host"]["processor"], "is": "another"},
        "package numpy": {"was": "1.0", "is": "2.0"},
        "package gone": {"was": "2.1", "is": None},
        "ros middleware": {"was": "none", "is": "rmw_zenoh_cpp"},
        "ros package nav2": {"was": "1.3", "is": "1.4"},
    }


@pytest.mark.long
def test_the_same_machine_and_software_are_told_as_such(execute: Execute) -> None:
    executed = execute(COUNTING)
    finished = execute_experiment(prepare_or_refuse(executed.config), SilentObserver())
    assert finished.findings == ()
    manifest = json.loads((executed.folder / "manifest.json").read_text(encoding="utf-8"))
    assert manifest["executions"][1]["changed"] == {}


@pytest.mark.parametrize("stamp", ["started_at", "finished_at"])
def test_a_clock_that_was_set_back_between_two_executions_is_told(execute: Execute, stamp: str) -> None:
    executed = execute(COUNTING)
    path = executed.folder / "manifest.json"
    manifest = json.loads(path.read_text(encoding="utf-8"))
    manifest["executions"][0][stamp] = "2099-01-01T00:00:00.000Z"
    path.write_text(json.dumps(manifest), encoding="utf-8")
    finished = execute_experiment(prepare_or_refuse(executed.config), SilentObserver())
    (finding,) = finished.findings
    assert finding.problem.endswith(", and the experiment was executed at 2099-01-01T00:00:00.000Z already")
    assert not finding.is_error


def test_a_folder_that_holds_something_else_is_refused(write_config: Write) -> None:
    config = write_config(COUNTING)
    write(config.parent / "results" / "trial" / "manifest.json", '{"format": 1}')
    with pytest.raises(ExecutionError, match="the manifest in this folder was not written by Robot Runner"):
        resume(config)


def test_a_newer_format_is_refused(write_config: Write) -> None:
    config = write_config(COUNTING)
    write(config.parent / "results" / "trial" / "manifest.json", '{"format": 99}')
    with pytest.raises(StorageError, match="newer"):
        resume(config)


@pytest.mark.long
def test_a_table_that_is_as_the_journal_knows_it_is_not_written_again(execute: Execute) -> None:
    executed = execute(COUNTING)
    before = (executed.folder / "run_table.csv").stat()
    journal = (executed.folder / "journal.jsonl").read_text(encoding="utf-8")
    assert [row["status"] for row in resume(executed.config)] == ["Done"] * 4
    assert (executed.folder / "run_table.csv").stat().st_mtime_ns == before.st_mtime_ns
    added = (executed.folder / "journal.jsonl").read_text(encoding="utf-8").removeprefix(journal)
    assert "table_written" not in added


@pytest.mark.long
def test_columns_in_another_order_are_put_right_when_an_experiment_goes_on(execute: Execute) -> None:
    executed = execute(COUNTING)
    path = executed.folder / "run_table.csv"
    written = path.read_text(encoding="utf-8")
    rows = [[line[-1], *line[:-1]] for line in csv.reader(written.splitlines())]
    write(path, "".join(f"{','.join(row)}\n" for row in rows))
    resume(executed.config)
    assert path.read_text(encoding="utf-8") == written


@pytest.mark.long
@pytest.mark.parametrize("has_schema", [True, False])
def test_the_origins_of_measures_are_known_after_resuming(execute: Execute, has_schema: bool) -> None:
    executed = execute(COUNTING)
    schema = executed.folder / "run_table.schema.json"
    before = json.loads(schema.read_text(encoding="utf-8"))
    if not has_schema:
        schema.unlink()
    resume(executed.config, redo=("r_1",))
    after = json.loads(schema.read_text(encoding="utf-8"))
    assert [field["robot_runner:origin"] for field in after["fields"]] == [
        field["robot_runner:origin"] for field in before["fields"]
    ]
    assert {field["name"]: field["robot_runner:origin"] for field in after["fields"]}["Energy"] == "measured"
