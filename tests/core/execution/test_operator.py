"""What a person does and answers before runs: which steps are due, where answers go, also after a restart."""

from __future__ import annotations

import os
import re
import signal
import threading
import time
from contextlib import closing
from dataclasses import replace
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest
from tests.conftest import written_config
from tests.core.execution.conftest import Executed, RecordingObserver
from tests.long_cases import long_but

from robot_runner.cli.excluding import exclude_runs
from robot_runner.cli.screens.progress import Progress
from robot_runner.core.config.operator_steps import OperatorStep
from robot_runner.core.config.preparation import prepare_or_refuse
from robot_runner.core.errors import ExecutionError, StorageError
from robot_runner.core.execution.experiment_status import read_status
from robot_runner.core.execution.notices import (
    AnswersRefused,
    AttemptFinished,
    AttemptStarted,
    Paused,
    UserHasContinued,
    WaitingForUser,
)
from robot_runner.core.execution.operator import Operator
from robot_runner.core.execution.orchestrator import execute_experiment
from robot_runner.core.execution.resumption import Resumption, TableChoice
from robot_runner.core.storage.journal import Journal
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.lock import leave_request, send_continue
from robot_runner.replication.explanation import explain_run

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from pathlib import Path

    from robot_runner.core.execution.notices import Notice
    from robot_runner.core.execution.poll_loop import Steps

VOLTAGE = 'Question("voltage", float, unit="V", low=9, high=13)'
TABLE = """\
    def create_run_table(self):
        return RunTableModel([Factor("Task", ["Video", "Network"])], repetitions=2, data_columns=["Energy"])
"""


class Person(RecordingObserver):
    """Somebody who answers as soon as they are asked: at the keyboard, or from another terminal."""

    refresh_interval = 0.01

    def __init__(self, answer: Callable[[WaitingForUser], str | Mapping[str, str] | None]) -> None:
        super().__init__()
        self._answer = answer
        self._reader, self._keyboard = os.pipe()
        self.user_input = self._reader
        self._control: Path | None = None
        self._said: Mapping[str, str] | None = None

    def notice(self, notice: Notice) -> None:
        super().notice(notice)
        if isinstance(notice, WaitingForUser):
            self._control = notice.folder / ".control"
        if isinstance(notice, WaitingForUser | AnswersRefused):
            said = self._answer(notice) if isinstance(notice, WaitingForUser) or self._said is not None else None
            if isinstance(said, str):
                os.write(self._keyboard, said.encode())
            else:
                self._said = said

    def refresh(self) -> None:
        if self._said is not None and self._control is not None and not self._control.exists():
            send_continue(self._control, self._said)

    def close(self) -> None:
        os.close(self._reader)
        os.close(self._keyboard)

    @property
    def asked(self) -> list[tuple[str, str]]:
        """Return the step and the run of each time that somebody was asked."""
        return [(each.step, each.run_id) for each in self.notices if isinstance(each, WaitingForUser)]


@pytest.fixture
def execute(tmp_path: Path) -> Iterator[Callable[..., tuple[Executed, Person]]]:
    """Return what executes a config with a person who answers."""
    people: list[Person] = []

    def execute_with(
        body: str, answer: Any = "\n", resumption: Resumption | None = None, **settings: Any
    ) -> tuple[Executed, Person]:
        config = written_config(tmp_path, body, **{"table": TABLE, **settings})
        people.append(Person(answer if callable(answer) else lambda _: answer))
        # Where a run is executed makes a difference to none of them, and a process for each is most of their time.
        chosen = {} if {"run_process", "workers"} & {*re.findall(r"\w+", body)} else {"run_process": "in_process"}
        finished = execute_experiment(prepare_or_refuse(config, chosen), people[-1], resumption=resumption)
        return Executed(config, finished, people[-1].notices), people[-1]

    yield execute_with
    for person in people:
        person.close()


def steps(*words: str) -> str:
    return f"operator_steps = [{', '.join(words)}]"


@pytest.mark.long
@pytest.mark.parametrize(
    ("rule", "runs"),
    [
        ("", "r_1 r_2 r_3 r_4"),
        (", every=3", "r_1 r_4"),
        (', when_changes="Task"', "r_1 r_2 r_3 r_4"),
        (", first=True", "r_1"),
        (', before={"Task": "Network"}', "r_2 r_4"),
        (', before={"Task": ["Network", "Video"]}', "r_1 r_2 r_3 r_4"),
        (", before=lambda run: run['Task'] == 'Video', first=True", "r_1"),
        (", before=lambda run: run['Task'] == 'Network', every=2", "r_2 r_4"),
    ],
)
def test_a_step_is_asked_for_before_the_runs_that_it_is_due_for(execute: Callable, rule: str, runs: str) -> None:
    executed, person = execute(steps(f'OperatorStep("swap the battery"{rule})'))
    assert person.asked == [("swap the battery", run) for run in runs.split()]
    assert executed.finished.done_count == 4


TEN = TABLE.replace("repetitions=2", 'repetitions=5, blocks="Task"')


@pytest.mark.long
@pytest.mark.parametrize(
    ("rule", "runs"),
    [
        ("every=4", ["r_1", "r_5", "r_9"]),
        ('when_changes="Task"', ["r_1", "r_6"]),
        ("first=True", ["r_1"]),
        ('before={"Task": "Network"}, every=2', ["r_6", "r_8", "r_10"]),
    ],
)
def test_steps_are_asked_for_at_the_same_runs_however_many_places_there_are(
    execute: Callable, rule: str, runs: list[str]
) -> None:
    body = "workers = 3\n" + steps(f'OperatorStep("swap the battery", {rule}, ask=[{VOLTAGE}])')
    executed, person = execute(body, "12\n", table=TEN)
    assert [run for _, run in person.asked] == runs
    assert [row["run_id"] for row in executed.table if row["voltage"]] == runs


class PausingPerson(Person):
    """Somebody who wants a pause when they are asked for a step, and does it once a run has ended elsewhere."""

    def __init__(self) -> None:
        super().__init__(lambda _: None)
        self._looks = 0

    def notice(self, notice: Notice) -> None:
        super().notice(notice)
        if isinstance(notice, WaitingForUser):
            leave_request(notice.folder / ".pause")
        elif isinstance(notice, Paused):
            (notice.folder / ".pause").unlink()

    def refresh(self) -> None:
        self._looks += any(isinstance(each, AttemptFinished) for each in self.notices)
        if self._looks == 20:  # the run that follows would have begun its pause by then
            os.write(self._keyboard, b"\n")


@pytest.mark.long
def test_a_pause_begins_once_nobody_is_asked_for_a_step_elsewhere_any_more(tmp_path: Path) -> None:
    body = "workers = 2\nclaims = []\n" + steps(
        'OperatorStep("swap the battery", before={"Task": "Network"}, first=True)'
    )
    config = written_config(tmp_path, body, table=TABLE)
    with closing(PausingPerson()) as person:
        finished = execute_experiment(prepare_or_refuse(config), person)
    told = [
        kind for each in person.notices for kind in (WaitingForUser, UserHasContinued, Paused) if type(each) is kind
    ]
    assert told == [WaitingForUser, UserHasContinued, Paused], "ENTER would have been for either"
    assert finished.done_count == 4
    executed = Executed(config, finished, person.notices)
    kinds = [each["kind"] for each in executed.journal("operator_step", "paused", "attempt_started")]
    assert kinds[:3] == ["attempt_started", "operator_step", "paused"], "the run of the step is paused before, too"


class PersonWhoIsAway(Person):
    """Somebody who wants a pause while they are asked first, says then that it is done, and goes on some time later."""

    def __init__(self) -> None:
        super().__init__(lambda asked: "\n" if asked.run_id != "r_1" else None)
        self._looks = 0

    def refresh(self) -> None:
        folder = next((each.folder for each in self.notices if isinstance(each, WaitingForUser)), None)
        self._looks += folder is not None
        if self._looks == 30:  # the next run is in line by then
            leave_request(folder / ".pause")
            os.write(self._keyboard, b"\n")
        elif self._looks == 80:  # it would have been asked about by then
            (folder / ".pause").unlink(missing_ok=True)


@pytest.mark.long
def test_nobody_is_asked_for_a_step_while_the_study_is_paused(tmp_path: Path) -> None:
    config = written_config(tmp_path, "workers = 2\nclaims = []\n" + steps('OperatorStep("place it")'), table=TABLE)
    with closing(PersonWhoIsAway()) as person:
        finished = execute_experiment(prepare_or_refuse(config), person)
    assert finished.done_count == 4
    told = Executed(config, finished, person.notices).journal("paused", "waiting", "continued")
    kinds = [each["kind"] for each in told]
    assert kinds[:4] == ["waiting", "continued", "paused", "continued"], "ENTER would have been for either"
    assert told[3]["after"] == "pause"


class Preparing:
    """The operator alone, with runs that are prepared step by step, as runs at several places are.

    `is_prompt`: whether each question is answered in the moment in which it can be seen.
    """

    def __init__(self, folder: Path, *steps: OperatorStep, is_prompt: bool = False) -> None:
        self.records: list[dict[str, Any]] = []
        self.is_prompt = is_prompt
        progress = SimpleNamespace(
            look_after_lock=lambda: None,
            task_of=lambda run: SimpleNamespace(combination={}, repetition=1),
            note=self.note,
            runs_left=lambda _: 1,
            run_count=9,
            time_left=None,
        )
        experiment = SimpleNamespace(
            parameters=SimpleNamespace(operator_steps=steps), folder=ExperimentFolder(folder), columns=None
        )
        self.operator = Operator(
            SimpleNamespace(
                experiment=experiment,
                progress=progress,
                observer=SimpleNamespace(user_input=None),
                notify=lambda _: None,
                is_interrupted=False,
                is_ending=False,
            )
        )
        self.folder = folder

    def note(self, kind: str, **facts: Any) -> None:
        self.records.append({"kind": kind, **facts})
        if kind == "waiting" and self.is_prompt:
            send_continue(self.folder / ".control", {}, asked=(facts["next_run"], facts["step"]))

    def goes_on(self, prepared: Steps[bool]) -> bool:
        """Go on with preparing a run until it waits; return whether it still does."""
        return next(prepared, None) is not None

    def prepare(self, number: int) -> Steps[bool]:
        return self.operator.prepare(
            SimpleNamespace(run_id=f"r_{number}", number=number), "alice" if number % 2 else "bob"
        )

    def begin(self, number: int) -> None:
        self.records.append({"kind": "attempt_started", "run": f"r_{number}", "attempt": 1})
        self.operator.hand_over(SimpleNamespace(run_id=f"r_{number}", measures={}), lambda *_: None)

    @property
    def done_before(self) -> list[str]:
        return [each["run"] for each in self.records if each["kind"] == "operator_step"]

    def answer(self, prepared: Steps[bool], number: int, step: str) -> None:
        """Say that a step is done, and prepare its run to the end."""
        send_continue(self.folder / ".control", {}, asked=(f"r_{number}", step))
        assert not self.goes_on(prepared)


def test_an_answer_in_the_moment_of_the_question_is_taken_and_one_from_before_is_not(tmp_path: Path) -> None:
    """It was removed as one from before: who had given it was told that the experiment goes on."""
    for is_prompt in (True, False):
        send_continue(tmp_path / ".control", {}, asked=("r_1", "swap"))
        at = Preparing(tmp_path, OperatorStep("swap", first=True), is_prompt=is_prompt)
        prepared = at.prepare(1)
        assert at.goes_on(prepared), "it listens once"
        assert at.goes_on(prepared) is not is_prompt


def test_a_run_that_has_been_prepared_counts_though_it_has_not_begun(tmp_path: Path) -> None:
    at = Preparing(tmp_path, OperatorStep("swap", every=2))
    first, second = at.prepare(1), at.prepare(2)
    assert at.goes_on(first)
    assert at.goes_on(second), "it waits until the battery is swapped, and is not asked for another one"
    assert [(each["next_run"], each["place"]) for each in at.records if each["kind"] == "waiting"] == [("r_1", "alice")]
    at.answer(first, 1, "swap")
    assert not at.goes_on(second)
    at.begin(1)
    third = at.prepare(3)  # while the second one rests
    assert at.goes_on(third)
    at.answer(third, 3, "swap")
    for number in (2, 3):
        at.begin(number)
    assert not at.goes_on(at.prepare(4))
    assert at.done_before == ["r_1", "r_3"]
    at.begin(4)
    for after in (at, resumed(at)):
        assert after.goes_on(after.prepare(5)), "two runs have begun since: the second was prepared before"


def test_a_run_waits_for_the_step_that_came_before_it_and_not_for_one_that_comes_after(tmp_path: Path) -> None:
    at = Preparing(tmp_path, OperatorStep("swap", every=1, before=lambda run: True), OperatorStep("look", first=True))
    first, second, third = at.prepare(1), at.prepare(2), at.prepare(3)
    assert all(map(at.goes_on, (first, second, third)))
    send_continue(tmp_path / ".control", {}, asked=("r_1", "swap"))
    assert at.goes_on(first), "the other step comes before it, too"
    at.answer(first, 1, "look")
    assert at.goes_on(third), "people are asked in the order of the runs"
    assert at.goes_on(second)
    at.answer(second, 2, "swap")
    assert at.goes_on(third)
    at.answer(third, 3, "swap")
    assert at.done_before == ["r_1", "r_1", "r_2", "r_3"]


def resumed(at: Preparing) -> Preparing:
    """Return the operator of a session that knows what is in the journal."""
    with Journal(ExperimentFolder(at.folder).journal) as journal:
        for record in at.records:
            if record["kind"] in {"operator_step", "attempt_started"}:
                facts = {name: value for name, value in record.items() if name not in {"kind", "flush"}}
                journal.append(record["kind"], **facts)
    return Preparing(at.folder, OperatorStep("swap", every=2))


def test_a_step_for_a_changed_treatment_is_left_out_while_it_stays(execute: Callable) -> None:
    table = TABLE.replace("repetitions=2", 'repetitions=2, blocks="Task"')
    _, person = execute(steps('OperatorStep("mount the camera", when_changes=["Task"])'), table=table)
    assert person.asked == [("mount the camera", "r_1"), ("mount the camera", "r_3")]


def test_the_person_is_shown_the_next_run_what_is_left_and_how_long_it_takes(execute: Callable) -> None:
    body = steps('OperatorStep("place the robot")') + "\ndef launch_mission(self, context): context.clock.sleep(0.1)"
    executed, _ = execute(body)
    first, second, *_ = [each for each in executed.notices if isinstance(each, WaitingForUser)]
    assert (first.combination["Task"], first.repetition, first.runs_left) == ("Video", 1, 4)
    assert (second.combination["Task"], second.runs_left) == ("Network", 3)
    assert 0.3 < second.left.after(0.0) < 30
    assert isinstance(executed.notices[1], WaitingForUser), "before anything of the first run"


def test_an_answer_is_a_measure_of_its_run_and_a_note_stays_in_the_journal(execute: Callable) -> None:
    body = f"""
    {steps(f'OperatorStep("swap the battery", ask=[{VOLTAGE}, Question("remark", note=True, optional=True)])')}
    def populate_run_data(self, context):
        return {{"Energy": context.measures["voltage"] * 2}}
    """
    answers = {"r_1": "11.5\n\n", "r_2": "11.25\nit slipped\n", "r_3": "11\n\n", "r_4": "10.5\n\n"}
    executed, _ = execute(body, lambda waiting: answers[waiting.run_id])
    assert [row["voltage"] for row in executed.table] == ["11.5", "11.25", "11.0", "10.5"]
    assert [row["Energy"] for row in executed.table] == ["23.0", "22.5", "22.0", "21.0"]
    ends = executed.journal("attempt_finished")
    assert ends[0]["measures"]["voltage"] == {"value": 11.5, "owner": "operator", "origin": "entered by hand"}
    assert ends[0]["measures"]["Energy"]["origin"] == "measured", "what is computed from an answer was not entered"
    assert executed.journal("operator_step")[1]["notes"] == {"remark": "it slipped"}
    schema = (executed.folder / "run_table.schema.json").read_text(encoding="utf-8")
    assert '"V"' in schema
    assert '"entered by hand"' in schema
    explained = explain_run(executed.folder, "r_2", ["voltage"])
    assert ("Done before", "swap the battery (remark: it slipped)") in explained.facts
    assert ("From", "a person, who was asked before the run") in explained.values[0].facts


@pytest.mark.parametrize("run_process", long_but(["fork", "in_process"], ["fork", "spawn", "in_process"]))
def test_every_kind_of_process_knows_the_answers(execute: Callable, run_process: str) -> None:
    body = f"""
    run_process = RunProcess.{run_process.upper()}
    {steps(f'OperatorStep("swap the battery", ask=[{VOLTAGE}])')}
    def populate_run_data(self, context): return {{"Energy": context.measures["voltage"]}}
    """
    executed, _ = execute(body, "11.5\n", Resumption(only=("r_1",)))
    assert (executed.table[0]["voltage"], executed.table[0]["Energy"]) == ("11.5", "11.5")


def test_a_bad_answer_is_asked_for_again_with_the_reason(execute: Callable) -> None:
    place = 'Question("place", choices=["dock A", "dock B"])'
    body = steps(f'OperatorStep("measure", first=True, ask=[{VOLTAGE}, {place}])')
    executed, _ = execute(body, "much\n8\n14\nnan\n\n12\ndok a\nDOCK a\n", Resumption(only=("r_1",)))
    refused = [str(each.findings[0]) for each in executed.notices if isinstance(each, AnswersRefused)]
    limits = "Enter a number from 9 to 13 (in V)."
    assert refused == [
        f"voltage: 'much' is not a number → {limits}",
        f"voltage: 8 is below 9 V → {limits}",
        f"voltage: 14 is above 13 V → {limits}",
        f"voltage: 'nan' is not finite → {limits}",
        f"voltage: nothing was entered → {limits}",
        "place: 'dok a' is none of the choices → Did you mean 'dock A'?",
    ]
    assert (executed.table[0]["voltage"], executed.table[0]["place"]) == ("12.0", "dock A")


def test_answers_from_another_terminal_are_validated_here_too(execute: Callable) -> None:
    answers = iter([{"voltage": "99", "volts": "1"}, {"voltage": "12", "name": "Ada"}])
    body = steps(f'OperatorStep("measure", ask=[{VOLTAGE}, Question("name")])')
    executed, _ = execute(body, lambda _: next(answers), Resumption(only=("r_1",)))
    refused = next(each.findings for each in executed.notices if isinstance(each, AnswersRefused))
    assert [finding.problem for finding in refused] == [
        "99 is above 13 V",
        "no question asks for this",
        "the question is not answered",
    ]
    assert (executed.table[0]["voltage"], executed.table[0]["name"]) == ("12.0", "Ada")


def test_who_confirms_the_first_of_two_steps_twice_has_not_done_the_second(execute: Callable) -> None:
    left: list[bool] = []

    def confirm(waiting: WaitingForUser) -> str:
        control = waiting.folder / ".control"
        if waiting.step == "swap the battery":
            return "\n"
        send_continue(control, asked=(waiting.run_id, "swap the battery"))

        def confirm_the_second() -> None:
            left.append(control.exists())
            send_continue(control, asked=(waiting.run_id, waiting.step))

        threading.Timer(1.0, confirm_the_second).start()
        return ""

    body = steps('OperatorStep("swap the battery", first=True)', 'OperatorStep("close the door", first=True)')
    executed, _ = execute(body, confirm)
    assert left == [True]
    assert executed.finished.done_count == 4


def test_another_attempt_needs_what_each_attempt_needs_and_keeps_the_answers(execute: Callable) -> None:
    body = f"""
    attempts = 2
    {steps('OperatorStep("place the robot")', f'OperatorStep("swap the battery", every=2, ask=[{VOLTAGE}])')}
    def launch_mission(self, context): assert context.attempt == 2 or context.run_id != "r_1"
    """
    answers = {"place the robot": "\n", "swap the battery": "12\n"}
    executed, person = execute(body, lambda waiting: answers[waiting.step], Resumption(only=("r_1", "r_2")))
    place, swap = "place the robot", "swap the battery"
    assert person.asked == [(place, "r_1"), (swap, "r_1"), (place, "r_1"), (place, "r_2")]
    assert [row["voltage"] for row in executed.table][:2] == ["12.0", ""]
    assert not any("voltage has no value" in str(finding) for finding in executed.finished.findings)


def test_a_session_that_goes_on_asks_only_for_what_the_run_to_come_needs(execute: Callable) -> None:
    body = steps(
        f'OperatorStep("swap the battery", every=3, ask=[{VOLTAGE}])',
        'OperatorStep("place the robot")',
        'OperatorStep("level the floor", first=True)',
        'OperatorStep("mount the camera", when_changes="Task")',
    )
    table = TABLE.replace("repetitions=2", 'repetitions=2, blocks="Task"')
    answer = lambda waiting: "12\n" if waiting.questions else "\n"  # noqa: E731
    _, first = execute(body, answer, Resumption(only=("r_1",)), table=table)
    swap, place, floor, camera = "swap the battery", "place the robot", "level the floor", "mount the camera"
    assert [step for step, _ in first.asked] == [swap, place, floor, camera]
    executed, second = execute(body, answer, table=table)
    assert second.asked == [(place, "r_2"), (place, "r_3"), (camera, "r_3"), (swap, "r_4"), (place, "r_4")]
    assert [row["voltage"] for row in executed.table] == ["12.0", "", "", "12.0"]


@pytest.mark.long
def test_an_answer_about_a_run_that_did_not_come_to_its_end_is_kept(execute: Callable, tmp_path: Path) -> None:
    body = steps(f'OperatorStep("swap the battery", every=9, ask=[{VOLTAGE}])')
    body += """
def before_run(self, context):
    import os, signal
    if not (Path(__file__).parent / "again").exists(): os.kill(os.getpid(), signal.SIGINT)
    """
    interrupted, _ = execute(body, "12.5\n")
    assert interrupted.finished.interrupted
    (tmp_path / "again").touch()
    executed, person = execute(body, "9\n")
    assert person.asked == []
    assert executed.table[0]["voltage"] == "12.5"
    again, asked = execute(body, "9\n", Resumption(redo=("r_1",), only=("r_1",)))
    assert asked.asked == []
    assert again.table[0]["voltage"] == "", "a run that is executed again is another run"


def test_an_interruption_ends_the_waiting_and_nothing_is_executed(execute: Callable) -> None:
    body = steps('OperatorStep("wait")', 'OperatorStep("and again")')
    executed, _ = execute(body, lambda _: os.kill(os.getpid(), signal.SIGINT))
    assert executed.finished.interrupted
    assert not any(isinstance(notice, AttemptStarted) for notice in executed.notices)
    assert executed.journal("operator_step") == []


def test_who_has_done_a_step_is_not_asked_again_whether_the_run_may_start(execute: Callable) -> None:
    body = "operation_type = OperationType.SEMI\n" + steps('OperatorStep("swap the battery", every=2)')
    _, person = execute(body)
    assert person.asked == [("swap the battery", "r_1"), ("", "r_2"), ("swap the battery", "r_3"), ("", "r_4")]


def test_in_semi_no_attempt_starts_before_somebody_has_said_so(execute: Callable) -> None:
    body = """
operation_type = OperationType.SEMI
attempts = 2
def launch_mission(self, context): assert context.attempt == 2 or context.run_id == "r_3"
"""
    table = TABLE.replace("repetitions=2", "repetitions=3")
    swap = 'OperatorStep("place the robot", before={"Task": "Network"})'
    chosen = Resumption(only=("r_1", "r_2", "r_3"))
    _, person = execute(body + steps(swap), lambda _: "\n", chosen, table=table)
    place = "place the robot"
    assert person.asked == [("", "r_1"), ("", "r_1"), (place, "r_2"), (place, "r_2"), ("", "r_3")]


def test_a_factor_that_a_person_applies_counts_as_read(execute: Callable) -> None:
    mission = "\ndef launch_mission(self): pass"
    executed, _ = execute(steps('OperatorStep("mount it", when_changes="Task")') + mission)
    assert executed.journal("attempt_finished")[0]["readers"] == {"Task": ["operator"]}
    assert not any("no callback and no plugin looked at Task" in str(each) for each in executed.finished.findings)


def test_a_condition_that_raises_later_names_step_and_run(execute: Callable) -> None:
    body = """
    tried = 0
    def due(combination, seen=[]):
        seen.append(1)
        return 1 / (len(seen) < 6)
    """ + steps('OperatorStep("mount it", before=due)')
    with pytest.raises(ExecutionError) as ended:
        execute(body)
    assert ended.value.where == "operator step 'mount it', r_2"
    assert "before raised ZeroDivisionError" in ended.value.problem


def test_a_record_of_a_step_that_somebody_has_damaged_is_named(tmp_path: Path) -> None:
    at = Preparing(tmp_path, OperatorStep("swap", every=2))
    at.records.append({"kind": "operator_step", "run": "r_1", "step": "swap", "treatments": {}, "ahead": 7})
    at.records[-1] |= {"answers": {}, "notes": {}}
    later = resumed(at)
    with pytest.raises(StorageError, match="ahead"):
        next(later.prepare(2))


# Steps after runs.

TRUST = 'OperatorStep("fill in the questionnaire", after=True, ask=[Question("trust", int, low=1, high=5)])'
ENERGY = "def populate_run_data(self, context): return {'Energy': 1.5}\n"


@pytest.mark.parametrize(
    ("rule", "runs"),
    [
        ("True", "r_1 r_2 r_3 r_4"),
        ('{"Task": "Network"}', "r_2 r_4"),
        ("lambda run: run['Task'] == 'Video'", "r_1 r_3"),
    ],
)
def test_a_step_after_runs_is_asked_for_once_each_is_done_and_before_the_next(
    execute: Callable, rule: str, runs: str
) -> None:
    executed, person = execute(ENERGY + steps(TRUST.replace("True", rule)), "4\n")
    assert person.asked == [("fill in the questionnaire", run) for run in runs.split()]
    assert [row["trust"] for row in executed.table] == [
        "4" if row["run_id"] in runs.split() else "" for row in executed.table
    ]
    assert {row["Energy"] for row in executed.table} == {"1.5"}
    told = [
        (type(each), each.run_id if isinstance(each, WaitingForUser) else each.task.run_id)
        for each in person.notices
        if isinstance(each, AttemptStarted | AttemptFinished | WaitingForUser)
    ]
    for run in runs.split():
        asked = told.index((WaitingForUser, run))
        assert told[asked - 1] == (AttemptFinished, run)
        assert told[asked + 1 :][:1] in ([], [(AttemptStarted, f"r_{int(run[2:]) + 1}")])
    assert not any("trust has no value" in str(finding) for finding in executed.finished.findings)


def test_an_answer_after_a_run_is_a_measure_of_it_entered_by_hand_and_a_note_stays_in_the_journal(
    execute: Callable,
) -> None:
    remark = 'Question("remark", note=True, optional=True)'
    body = steps(TRUST.replace("ask=[", f"ask=[{remark}, "), 'OperatorStep("lift the robot", after={"Task": "Video"})')
    executed, _ = execute(
        ENERGY + body, lambda waiting: {"trust": "3", "remark": "it hummed"} if waiting.questions else "\n"
    )
    end = executed.journal("attempt_finished")[1]
    assert end["is_amended"]
    assert end["measures"]["trust"] == {"value": 3, "owner": "operator", "origin": "entered by hand"}
    assert end["measures"]["Energy"]["value"] == 1.5
    first = executed.journal("operator_step")[0]
    assert (first["is_after"], first["answers"], first["notes"]) == (True, {"trust": 3}, {"remark": "it hummed"})
    explained = explain_run(executed.folder, "r_1", ["trust"])
    assert ("Done after", "fill in the questionnaire (remark: it hummed)") in explained.facts
    assert ("Done after", "lift the robot") in explained.facts
    assert ("From", "a person, who was asked after the run") in explained.values[0].facts
    screen = Progress(time.monotonic)
    for notice in executed.notices:
        screen.take(notice)
    assert list(screen.origins["entered by hand"]) == ["trust"], "the end of the session tells of it"


def test_the_score_of_a_scale_is_a_measure_of_the_run_with_its_answers_beside_it_and_of_the_next_session(
    execute: Callable,
) -> None:
    scale = (
        'Scale("Workload", {"mental": "Mental demand", "calm": "How calm were you?"}, low=0, high=20, reverse=["calm"])'
    )
    body = ENERGY + steps(f'OperatorStep("fill in the questionnaire", after=True, ask=[{scale}])')

    def leave(waiting: WaitingForUser) -> str | None:
        return os.kill(os.getpid(), signal.SIGINT) if waiting.run_id == "r_2" else "15\n21\n6\n"

    interrupted, person = execute(body, leave)
    (refused,) = [each for each in person.notices if isinstance(each, AnswersRefused)]
    assert [each.problem for each in refused.findings] == ["21 is above 20"]
    assert [row["Workload"] for row in interrupted.table] == ["14.5", "", "", ""]
    executed, _ = execute(body, lambda _: {"mental": "7", "calm": "20"})
    assert [(row["mental"], row["calm"], row["Workload"]) for row in executed.table] == [
        ("15", "6", "14.5"),
        *(("7", "20", "3.5") for _ in range(3)),
    ]
    asked = next(each.questions for each in person.notices if isinstance(each, WaitingForUser))
    assert [question.asked for question in asked] == ["Mental demand (0 to 20)", "How calm were you? (0 to 20)"]


def test_a_score_of_before_a_run_is_known_to_its_callbacks(execute: Callable) -> None:
    body = """
def populate_run_data(self, context):
    return {"Energy": context.measures["Mood"]}
"""
    scale = 'Scale("Mood", ["glad", "tired"], low=1, high=5, reverse=["tired"], note=True)'
    executed, _ = execute(body + steps(f'OperatorStep("ask how they are", ask=[{scale}])'), "5\n2\n")
    assert {(row["Energy"], row["Mood"], row.get("glad")) for row in executed.table} == {("4.5", "4.5", None)}
    assert executed.journal("operator_step")[0]["notes"] == {"glad": 5, "tired": 2}


def test_of_a_run_that_a_person_was_not_asked_about_nothing_else_is_explained(execute: Callable) -> None:
    body = "quality_columns = True\n" + ENERGY + steps(TRUST.replace("after=True", "after={'Task': 'Video'}"))
    executed, _ = execute(body, lambda waiting: "3\n")
    who = {
        (run, name): dict(explain_run(executed.folder, run, [name]).values[0].facts)["From"]
        for run in ("r_1", "r_2")
        for name in ("trust", "trust.quality")
    }
    assert set(who.values()) == {"a person, who was asked after the run", "a person, who was not asked about the run"}
    assert all(who[run, "trust"] == who[run, "trust.quality"] for run in ("r_1", "r_2"))


@pytest.mark.parametrize("is_interrupted", [False, True])
def test_what_makes_a_whole_run_doubtful_makes_answers_after_it_doubtful_and_is_no_reason_where_nobody_was_asked(
    execute: Callable, is_interrupted: bool
) -> None:
    body = """
quality_columns = True
def populate_run_data(self, context):
    context.broker.doubt_run(context.owner, "it was dark", "")
    return {"Energy": 1.5}
"""
    body += steps(TRUST.replace("after=True", "after={'Task': 'Video'}"))
    if is_interrupted:
        execute(body, lambda _: os.kill(os.getpid(), signal.SIGINT))
    executed, _ = execute(body, "3\n")
    told = {row["Task"]: (row["trust"], row["trust.quality"], row["Energy.quality"]) for row in executed.table}
    assert told == {
        "Video": ("3", "doubtful: it was dark", "doubtful: it was dark"),
        "Network": ("", "missing", "doubtful: it was dark"),
    }


def test_what_a_session_did_not_come_to_ask_after_a_run_is_asked_by_the_next(execute: Callable) -> None:
    body = ENERGY + steps(TRUST, 'OperatorStep("lift the robot", after=True)')

    def leave(waiting: WaitingForUser) -> str | None:
        if waiting.run_id == "r_2" and waiting.step == "lift the robot":
            return os.kill(os.getpid(), signal.SIGINT)
        return "5\n" if waiting.questions else "\n"

    interrupted, _ = execute(body, leave)
    assert interrupted.finished.interrupted
    assert [row["status"] for row in interrupted.table] == ["Done", "Done", "-", "-"]
    assert [row["trust"] for row in interrupted.table] == ["5", "5", "", ""]
    (left,) = [each for each in read_status(interrupted.folder).findings if each.where == "r_2"]
    assert left.problem == "still to be done after it: lift the robot"
    assert left in interrupted.finished.findings
    executed, person = execute(body, "2\n")
    questionnaire, lift = "fill in the questionnaire", "lift the robot"
    assert person.asked == [(lift, "r_2"), *((step, run) for run in ("r_3", "r_4") for step in (questionnaire, lift))]
    assert [row["trust"] for row in executed.table] == ["5", "5", "2", "2"]
    _, third = execute(body, "2\n")
    assert third.asked == []
    assert not any("still to be done" in each.problem for each in read_status(executed.folder).findings)


def test_a_step_after_runs_that_has_left_the_config_is_not_promised_to_be_asked_for(execute: Callable) -> None:
    lift = 'OperatorStep("lift the robot", after=True)'

    def leave(waiting: WaitingForUser) -> None:
        os.kill(os.getpid(), signal.SIGINT)

    execute(ENERGY + steps(TRUST, lift), leave)
    executed, _ = execute(ENERGY + steps(lift), "\n", Resumption(accept_changes=True))
    assert executed.finished.done_count == 4
    (left,) = [each for each in read_status(executed.folder).findings if each.where == "r_1"]
    assert left.problem == "was not done after it, and is not a step of the config any more: fill in the questionnaire"
    restored, person = execute(ENERGY + steps(TRUST, lift), "2\n", Resumption(accept_changes=True))
    assert person.asked == [("fill in the questionnaire", "r_1")]
    assert not any("not done after it" in each.problem for each in read_status(restored.folder).findings)


def test_an_answer_after_a_run_leaves_a_value_that_was_corrected_by_hand_since(execute: Callable) -> None:
    body = ENERGY + steps(TRUST)
    interrupted, _ = execute(body, lambda _waiting: os.kill(os.getpid(), signal.SIGINT))
    path = interrupted.folder / "run_table.csv"
    path.write_text(path.read_text().replace(",1.5", ",2.5", 1))
    executed, _ = execute(body, "2\n", Resumption(table=TableChoice.FILE))
    assert [(row["Energy"], row["trust"]) for row in executed.table] == [("2.5", "2"), *[("1.5", "2")] * 3]
    again, _ = execute(body, "2\n")
    assert again.table == executed.table


def cut_off_after_first_end(executed: Executed) -> None:
    """Have the journal and the table be as a kill leaves them right after the end of the first run."""
    journal, lines = executed.folder / "journal.jsonl", []
    for line in journal.read_text().splitlines(keepends=True):
        lines.append(line)
        if line.startswith('{"kind":"attempt_finished"'):
            break
    journal.write_text("".join(lines))
    (executed.folder / "run_table.csv").unlink()


@pytest.mark.parametrize("places", ["", "workers = 2\nclaims = []\n"])
def test_a_kill_between_the_end_of_a_run_and_the_question_loses_no_question(execute: Callable, places: str) -> None:
    executed, _ = execute(places + ENERGY + steps(TRUST), "5\n", Resumption(only=("r_1",)))
    cut_off_after_first_end(executed)
    assert [each.where for each in read_status(executed.folder).findings if "questionnaire" in each.problem] == ["r_1"]
    again, person = execute(places + ENERGY + steps(TRUST), "3\n")
    assert sorted(run for _, run in person.asked) == ["r_1", "r_2", "r_3", "r_4"]
    assert person.asked[0][1] == "r_1"
    assert [row["trust"] for row in again.table] == ["3"] * 4
    assert {row["Energy"] for row in again.table} == {"1.5"}, "what the run had measured is still there"
    assert len(again.journal("attempt_started")) == 4


@pytest.mark.parametrize("becomes", ["executed again", "excluded", "of a step that is no more"])
def test_what_no_longer_matters_is_not_asked_after_a_run(execute: Callable, becomes: str) -> None:
    executed, _ = execute(ENERGY + steps(TRUST), lambda _: os.kill(os.getpid(), signal.SIGINT))
    assert [row["status"] for row in executed.table] == ["Done", "-", "-", "-"]
    resumption = Resumption(only=("r_1", "r_2"), redo=("r_1",) if becomes == "executed again" else ())
    if becomes == "excluded":
        exclude_runs(ExperimentFolder(executed.folder), ["r_1"], "the robot fell")
        resumption = Resumption(only=("r_2",))
    body = ENERGY + (TRUST_ELSE if becomes == "of a step that is no more" else steps(TRUST))
    again, person = execute(body, "3\n", replace(resumption, accept_changes=True))
    runs = [run for _, run in person.asked]
    assert runs == (["r_1", "r_2"] if becomes == "executed again" else ["r_2"])
    assert again.table[0]["trust"] == ("3" if becomes == "executed again" else "")


TRUST_ELSE = steps(TRUST.replace("fill in the questionnaire", "ask them"))


@pytest.mark.long
def test_answers_after_runs_of_several_robots_are_of_the_right_runs_and_a_robot_waits_for_its_own(
    execute: Callable,
) -> None:
    body = "robot = Robots('simulated://alice', 'simulated://bob')\n" + ENERGY + steps(TRUST)
    executed, person = execute(body, lambda waiting: f"{waiting.run_id[2:]}\n")
    assert [row["trust"] for row in executed.table] == ["1", "2", "3", "4"]
    robots = {row["run_id"]: row["Robot"] for row in executed.table}
    asked = [each for each in person.notices if isinstance(each, WaitingForUser)]
    assert {each.run_id: each.place for each in asked} == robots
    for robot in ("alice", "bob"):
        told = [
            type(each)
            for each in person.notices
            if (isinstance(each, AttemptStarted | AttemptFinished) and each.task.place == robot)
            or (isinstance(each, WaitingForUser) and each.place == robot)
        ]
        assert told == [AttemptStarted, AttemptFinished, WaitingForUser] * 2


def test_a_run_that_failed_is_not_asked_about_and_one_that_is_tried_again_once(execute: Callable) -> None:
    body = """
attempts = 2
def launch_mission(self, context):
    if context.attempt == 1 or context.run_id == "r_2": raise RuntimeError("it fell")
"""
    executed, person = execute(body + ENERGY + steps(TRUST), "4\n")
    assert executed.finished.failed == ("r_2",)
    assert [run for _, run in person.asked] == ["r_1", "r_3", "r_4"]


def test_a_function_that_says_after_which_runs_and_raises_does_so_before_the_run(execute: Callable) -> None:
    body = """
looks = []
def asks(run, looks=looks):
    looks.append(run)
    if len(looks) > 5: raise ValueError("not now")
    return True
"""
    with pytest.raises(ExecutionError, match="after raised ValueError: not now") as caught:
        execute(body + ENERGY + steps(TRUST.replace("after=True", "after=asks")), "4\n")
    assert caught.value.where == "operator step 'fill in the questionnaire', r_2"


def test_who_goes_on_knows_the_answer_after_the_run_and_adds_to_it(execute: Callable) -> None:
    body = """
operation_type = OperationType.SEMI
def continue_experiment(self, context):
    context.publish("Energy", 10.0 * context.measures["trust"])
    return True
def before_experiment(self, context): return True
"""
    executed, person = execute(body + steps(TRUST), "4\n")
    assert [run for _, run in person.asked] == ["r_1", "r_2", "r_3", "r_4"]
    assert [row["trust"] for row in executed.table] == ["4"] * 4
    assert [row["Energy"] for row in executed.table] == ["40.0"] * 3 + [""]
