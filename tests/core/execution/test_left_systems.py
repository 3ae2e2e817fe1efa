"""Who comes after a kill makes systems safe with what the killed run has written, whatever has changed since."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from contextlib import closing, contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest
from tests.core.execution.conftest import RecordingObserver
from tests.core.execution.lamp import HEAD, TABLE, made_safe

from robot_runner.cli.main import main
from robot_runner.core.config import plugin_checks, preparation
from robot_runner.core.config.preparation import prepare, prepare_or_refuse
from robot_runner.core.entry_points import EntryPoint
from robot_runner.core.errors import ExecutionError, Finding, LinkError, RobotRunnerError
from robot_runner.core.execution import left_systems, standby, systems_state
from robot_runner.core.execution.going_on import goes_on
from robot_runner.core.execution.left_systems import (
    may_be_moving,
    robots_left,
    see_to_it_first,
    see_to_what_is_left,
    see_to_what_others_left,
)
from robot_runner.core.execution.orchestrator import execute_experiment
from robot_runner.core.execution.standby import Standby
from robot_runner.core.execution.systems_state import SystemsFile, left_copies
from robot_runner.core.execution.task import RunTask
from robot_runner.core.execution.worker import described_task
from robot_runner.core.links import commanded_topics
from robot_runner.core.links.commanded_topics import CANCELLING, Commanded
from robot_runner.core.storage.claim_locks import HeldClaims
from robot_runner.core.storage.guarded_files import make_experiment_folder
from robot_runner.core.storage.journal import Journal
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.notebook.from_python import run_experiment

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from robot_runner.core.config.experiment import Experiment

pytestmark = pytest.mark.filterwarnings("ignore:.*multi-threaded:DeprecationWarning")


@pytest.fixture(autouse=True)
def _own_state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Have no test find what another has left."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))


@pytest.fixture
def experiment(write_config: Callable[..., Path]) -> Experiment:
    experiment = prepare_or_refuse(write_config("", head=HEAD, table=TABLE))
    experiment.folder.root.parent.mkdir()
    make_experiment_folder(experiment.folder.root)
    return experiment


def of_velocities(experiment: Experiment, robot: object, monkeypatch: pytest.MonkeyPatch) -> SystemsFile:
    """Return the file of a run that has commanded a velocity of this robot, which is waited for shortly."""
    monkeypatch.setattr(standby, "connect_robot", lambda _context: robot)
    monkeypatch.setattr(commanded_topics, "_TELLING", 0.1)
    monkeypatch.setattr(commanded_topics, "_REACHING", 0.2)
    file = SystemsFile(experiment.folder)
    file.begin("rosbridge://127.0.0.1:1", left(experiment))
    file.add_commanded(Commanded("/cmd_vel", "geometry_msgs/TwistStamped"))
    return file


def left(experiment: Experiment, **changed: Any) -> dict[str, Any]:
    task = RunTask("r_2", 2, 2, 1, {"Room": "hall"}, 1, 7, 8, slot=3)
    return described_task(experiment, task) | changed


EXECUTING = """
import sys
from pathlib import Path
from robot_runner.core.storage.lock import ExperimentLock
with ExperimentLock(Path(sys.argv[1])):
    print("held", flush=True)
    sys.stdin.read()
"""


@contextmanager
def executed(experiment: Experiment) -> Iterator[None]:
    """Have another process hold the experiment's lock."""
    words = [sys.executable, "-c", EXECUTING, str(experiment.folder.lock)]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as executing:
        assert executing.stdout is not None
        assert executing.stdout.readline() == "held\n"
        yield
        executing.kill()


def test_systems_are_made_safe_with_the_treatments_of_the_run_that_was_killed_and_once(experiment: Experiment) -> None:
    SystemsFile(experiment.folder.at_slot(3)).begin(None, left(experiment))
    (said,) = may_be_moving(experiment.folder)
    assert "THE ROBOT MAY BE MOVING: an earlier execution was killed in r_2" in said.problem
    (found,) = see_to_what_is_left(experiment)
    assert found.where == "r_2"
    assert made_safe(experiment) == "hall hall r_2 None"
    assert see_to_what_is_left(experiment) == []
    assert may_be_moving(experiment.folder) == []


CHECKED = """
    def check(self, circumstances):
        told = [path.read_text() for path in [HERE / "made_safe"] if path.exists()]
        (HERE / "at_check").write_text(str(told))
        return ()

class RobotRunnerConfig(ExperimentConfig):
"""


@pytest.mark.parametrize(
    "execute",
    [lambda config: main(["run", str(config)]), run_experiment],
    ids=["run", "run_experiment"],
)
def test_what_is_left_is_seen_to_before_plugins_and_the_robots_graph_are_looked_at(
    write_config: Callable[..., Path], execute: Callable[[Path], object]
) -> None:
    head = HEAD.replace("\nclass RobotRunnerConfig(ExperimentConfig):\n", CHECKED)
    experiment = prepare_or_refuse(write_config("", head=head, table=TABLE))
    make_experiment_folder(experiment.folder.root)
    SystemsFile(experiment.folder.at_slot(3)).begin(None, left(experiment))
    execute(experiment.config_path)
    assert experiment.config_path.with_name("at_check").read_text() == "['hall hall r_2 None']"


def test_what_could_not_be_made_safe_first_is_told_at_once_and_nothing_is_executed(
    experiment: Experiment, write_config: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    SystemsFile(experiment.folder).begin(None, left(experiment), ["Lamp"])
    config = write_config("", head=HEAD.replace(HEAD.splitlines()[-1].strip(), "plugins = []"), table=TABLE)
    with monkeypatch.context() as patched:
        patched.setattr(preparation, "_check_machine", lambda *_: pytest.fail("a person waits for the alarm"))
        prepared = prepare(config, first=see_to_it_first)
    assert prepared.experiment is None
    assert "THE ROBOT MAY BE MOVING" in prepared.findings[0].problem
    assert prepare(config, first=see_to_it_first).experiment is not None


def test_who_interrupts_what_is_seen_to_first_is_told_what_was_done(
    experiment: Experiment, monkeypatch: pytest.MonkeyPatch
) -> None:
    SystemsFile(experiment.folder).begin(None, left(experiment))

    def interrupt(*_: object) -> list[Finding]:
        signal.raise_signal(signal.SIGINT)
        return []

    monkeypatch.setattr(left_systems, "see_to_what_others_left", interrupt)
    done, interrupted = see_to_it_first(experiment)
    assert "that was done now" in done.problem
    assert interrupted.is_error
    assert made_safe(experiment)


@pytest.mark.parametrize("refusing", ["HeldClaims", "ExperimentLock"])
def test_who_interrupts_while_others_have_what_is_claimed_ends_the_program(
    experiment: Experiment, monkeypatch: pytest.MonkeyPatch, refusing: str
) -> None:
    SystemsFile(experiment.folder).begin(None, left(experiment))

    def interrupt_and_refuse(*_: object) -> None:
        signal.raise_signal(signal.SIGINT)
        raise ExecutionError("in use by others")

    monkeypatch.setattr(left_systems, refusing, interrupt_and_refuse)
    (interrupted,) = see_to_it_first(experiment)
    assert interrupted.is_error
    assert not made_safe(experiment)


def test_what_is_left_is_not_seen_to_first_while_another_process_executes_the_experiment(
    experiment: Experiment,
) -> None:
    SystemsFile(experiment.folder).begin(None, left(experiment))
    with executed(experiment):
        assert see_to_it_first(experiment) == []
    assert made_safe(experiment) == ""
    assert len(see_to_it_first(experiment)) == 1
    assert made_safe(experiment)


@pytest.mark.parametrize(
    "changed",
    [{"combination": {"Room": [True, "attic"]}}, {"more": 1}],
    ids=["a treatment that the config has no more", "a run of another version"],
)
def test_systems_are_made_safe_of_a_run_that_the_config_does_not_know_any_more(
    experiment: Experiment, changed: dict[str, Any]
) -> None:
    SystemsFile(experiment.folder).begin(None, left(experiment, **changed))
    assert len(see_to_what_is_left(experiment)) == 1
    room = changed.get("combination", {"Room": [True, "hall"]})["Room"][1]
    assert made_safe(experiment) == f"{room} {room} r_2 None"


@pytest.mark.parametrize("becomes", ["plugins = []", "plugins = [Lamp(room='hall')]; plugins[0].name = 'Light'"])
def test_a_system_that_the_config_has_no_more_is_not_said_to_have_been_made_safe(
    experiment: Experiment, write_config: Callable[..., Path], becomes: str
) -> None:
    SystemsFile(experiment.folder).begin(None, left(experiment), ["Lamp"])
    head = HEAD.replace(HEAD.splitlines()[-1].strip(), becomes)
    changed = prepare_or_refuse(write_config("", head=head, table=TABLE))
    with pytest.raises(ExecutionError, match=r"THE ROBOT MAY BE MOVING: .* the config has no Lamp any more"):
        see_to_what_is_left(changed)
    assert see_to_what_is_left(changed) == []


def test_what_was_done_about_a_robot_is_told_where_the_execution_is_refused_then(
    write_config: Callable[..., Path],
) -> None:
    experiment = prepare_or_refuse(write_config("", head=HEAD, table=TABLE))
    execute_experiment(experiment, RecordingObserver())
    SystemsFile(experiment.folder).begin(None, left(experiment))
    changed = prepare_or_refuse(write_config("attempts = 2", head=HEAD, table=TABLE))
    with pytest.raises(RobotRunnerError) as caught:
        execute_experiment(changed, RecordingObserver())
    assert made_safe(experiment) == "hall hall r_2 None"
    *refusals, told = caught.value.findings
    assert all(each.is_error for each in refusals)
    assert told.problem.endswith("no process was left to make its systems safe; that was done now")


def test_of_several_robots_those_that_were_made_safe_are_told_beside_one_that_could_not_be(
    experiment: Experiment,
) -> None:
    SystemsFile(experiment.folder).begin(None, left(experiment))
    SystemsFile(experiment.folder.at_slot(2)).begin(None, left(experiment, run_id="r_1", combination=None))
    with pytest.raises(ExecutionError, match=r"THE ROBOT MAY BE MOVING: .* r_1") as caught:
        see_to_what_is_left(experiment)
    assert [each.where for each in caught.value.findings] == ["r_1", "r_2"]


def began(experiment: Experiment, seed: int = 1) -> None:
    with closing(Journal(experiment.folder.journal)) as journal:
        journal.append("experiment_started", flush=True, seed=seed)


def test_a_copy_that_was_made_while_a_run_was_in_flight_leaves_its_systems_to_the_original(
    experiment: Experiment,
) -> None:
    began(experiment)
    SystemsFile(experiment.folder).begin(None, left(experiment))
    root = experiment.folder.root
    backup = shutil.copytree(root, root.with_name("backup"))
    assert may_be_moving(ExperimentFolder(backup)) == []
    assert see_to_what_is_left(replace(experiment, folder=ExperimentFolder(backup))) == []
    assert len(may_be_moving(experiment.folder)) == 1


@pytest.mark.parametrize("move", [shutil.copytree, os.rename], ids=["to another disk", "beside it"])
def test_an_experiment_that_was_moved_since_it_was_killed_still_tells_what_it_left(
    experiment: Experiment, move: Callable[[Path, Path], object]
) -> None:
    began(experiment)
    SystemsFile(experiment.folder).begin(None, left(experiment))
    root = experiment.folder.root
    moved = root.with_name("moved")
    move(root, moved)
    shutil.rmtree(root, ignore_errors=True)
    make_experiment_folder(root)
    began(experiment, seed=2)  # anew
    assert len(may_be_moving(ExperimentFolder(moved))) == 1


class Deserted:
    """A graph on which nobody subscribes to what the robot was commanded by."""

    def publish(self, topic: str, message_type: str, message: object) -> None:
        pass

    def subscribers(self, topic: str) -> list[object]:
        return []


def test_of_a_robot_that_is_not_there_any_more_it_is_told_that_nobody_took_the_command(
    experiment: Experiment, monkeypatch: pytest.MonkeyPatch
) -> None:
    of_velocities(experiment, Deserted(), monkeypatch)
    (found,) = see_to_what_is_left(experiment)
    assert found.problem.endswith("was done now, as far as it could be: nobody subscribes to /cmd_vel any more")


def test_goals_that_a_killed_run_has_sent_are_cancelled_and_a_server_that_hangs_delays_no_system(
    experiment: Experiment, monkeypatch: pytest.MonkeyPatch
) -> None:
    cancelled = experiment.config_path.with_name("cancelled")

    def hang(link: object, action: str) -> None:
        deadline = time.monotonic() + 20
        while not (found := made_safe(experiment)) and time.monotonic() < deadline:
            time.sleep(0.01)
        cancelled.write_text(f"{action} {bool(found)}")
        raise LinkError("the action server does not answer", where=action)

    monkeypatch.setattr(standby, "keep_cancelling_goals", hang)
    monkeypatch.setattr(standby, "RETRYING", 0.0)
    file = of_velocities(experiment, Deserted(), monkeypatch)
    file.add_commanded(Commanded("/navigate_to_pose", CANCELLING))
    with pytest.raises(ExecutionError, match="the action server does not answer"):
        see_to_what_is_left(experiment)
    assert cancelled.read_text() == "/navigate_to_pose True"


def test_nothing_but_a_velocity_is_commanded_whatever_somebody_has_written_into_that_file(
    experiment: Experiment, monkeypatch: pytest.MonkeyPatch
) -> None:
    published = experiment.config_path.with_name("published")

    class Drone(Deserted):
        def publish(self, topic: str, message_type: str, message: object) -> None:
            with published.open("a") as file:
                file.write(f"{topic} {message_type}\n")

    file = of_velocities(experiment, Drone(), monkeypatch)
    file.add_commanded(Commanded("/takeoff", "std_msgs/Empty"))
    file.add_commanded(Commanded("/takeoff std_msgs/Empty\n/land", "geometry_msgs/Twist"))
    file.add_commanded(Commanded("\udc80", "geometry_msgs/Twist"))
    see_to_what_is_left(experiment)
    assert set(published.read_text().splitlines()) == {"/cmd_vel geometry_msgs/TwistStamped"}


USED = """
import sys
import time
from pathlib import Path
from robot_runner.core.storage.claim_locks import HeldClaims
with HeldClaims([sys.argv[1]], "theirs", Path("theirs")):
    print("held", flush=True)
    sys.stdin.read()
"""


def test_a_robot_that_another_experiment_uses_by_now_is_not_commanded(experiment: Experiment) -> None:
    SystemsFile(experiment.folder).begin("rosbridge://127.0.0.1:1", left(experiment))
    claim = "robot:rosbridge localhost:1"
    words = [sys.executable, "-c", USED, claim]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as theirs:
        assert theirs.stdout is not None
        assert theirs.stdout.readline() == "held\n"
        (found,) = see_to_what_is_left(experiment)
        theirs.communicate()
    assert not found.is_error
    assert f"nothing was done now: {claim} is in use by the experiment 'theirs'" in found.problem
    assert made_safe(experiment) == ""
    assert see_to_what_is_left(experiment) == []


@pytest.mark.parametrize("robot", ["rosbridge://127.0.0.1:1/alice", "rosbridge://localhost:1"])
def test_this_execution_goes_on_holding_its_robot_once_that_was_made_safe(
    write_config: Callable[..., Path], monkeypatch: pytest.MonkeyPatch, robot: str
) -> None:
    monkeypatch.setattr(standby, "connect_robot", lambda _context: Deserted())
    body = '    robot = "rosbridge://localhost:1"\n'
    experiment = prepare_or_refuse(write_config(body, head=HEAD, table=TABLE), looks_at_graph=False)
    experiment.folder.root.parent.mkdir()
    make_experiment_folder(experiment.folder.root)
    SystemsFile(experiment.folder).begin(robot, left(experiment))
    claim = "robot:rosbridge localhost:1"
    with HeldClaims([claim], "trial", experiment.folder.root):
        (found,) = see_to_what_is_left(experiment)
        refused = subprocess.run(
            [sys.executable, "-c", USED, claim], check=False, input="", capture_output=True, text=True
        )
    assert found.problem.endswith("that was done now")
    assert made_safe(experiment) == f"hall hall r_2 {robot}"
    assert f"{claim} is in use by the experiment 'trial'" in refused.stderr


def test_systems_of_another_experiment_are_left_to_its_next_execution_and_its_robot_is_told_to_stand_still(
    experiment: Experiment, monkeypatch: pytest.MonkeyPatch
) -> None:
    heard = experiment.config_path.with_name("heard")

    class Robot(Deserted):
        def publish(self, topic: str, message_type: str, message: object) -> None:
            heard.write_text(topic)

    file = of_velocities(experiment, Robot(), monkeypatch)
    file.begin("rosbridge://127.0.0.1:1", left(experiment), ["Lamp"])
    file.add_commanded(Commanded("/cmd_vel", "geometry_msgs/TwistStamped"))
    other = replace(experiment, folder=ExperimentFolder(experiment.folder.root.parent / "other"))
    claims = CLAIMED
    (found,) = see_to_what_others_left(other, [experiment.folder.root], claims)
    assert heard.read_text() == "/cmd_vel"
    assert made_safe(experiment) == ""
    assert "its robot was told to stand still now" in found.problem
    assert found.fix == "Check where it stands, and start that experiment again, which makes Lamp safe."
    assert see_to_what_others_left(other, [experiment.folder.root], claims) == [], "it is told once"
    assert len(may_be_moving(experiment.folder)) == 1
    assert len(see_to_what_is_left(experiment)) == 1
    assert made_safe(experiment) == "hall hall r_2 rosbridge://127.0.0.1:1"


CLAIMED = ["robot:rosbridge localhost:1"]


def test_what_an_experiment_that_is_being_executed_commands_is_not_stopped_by_who_claims_what_it_had_before(
    experiment: Experiment, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A run of it had reached this robot by a callback; by now it drives another robot of the same graph."""
    monkeypatch.setattr(Standby, "begin", lambda *_: pytest.fail("the robot of a run in flight was stopped"))
    file = SystemsFile(experiment.folder)
    file.begin("dds:domain=7", left(experiment))
    file.add_commanded(Commanded("/carol/cmd_vel", "geometry_msgs/Twist"))
    other = replace(experiment, folder=ExperimentFolder(experiment.folder.root.parent / "other"))
    with executed(experiment):
        assert see_to_what_others_left(other, [experiment.folder.root], ["robot:domain 7/bob"]) == []
    assert len(may_be_moving(experiment.folder)) == 1, "its own next execution is still to see to it"


def test_of_a_killed_experiment_whose_folder_is_gone_the_robot_is_stopped_once_and_its_systems_are_named(
    experiment: Experiment, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = of_velocities(experiment, Deserted(), monkeypatch)
    file.begin("rosbridge://127.0.0.1:1", left(experiment), ["Lamp"])
    file.add_commanded(Commanded("/cmd_vel", "geometry_msgs/TwistStamped"))
    assert robots_left([experiment.folder.root]) == []
    shutil.rmtree(experiment.folder.root)
    (said,) = robots_left([experiment.folder.root])
    assert "THE ROBOT MAY BE MOVING: an earlier execution was killed in r_2 (rosbridge://127.0.0.1:1)" in said.problem
    assert see_to_what_others_left(experiment, [], ["robot:rosbridge localhost:2"]) == [], "that is another robot"
    (found,) = see_to_what_others_left(experiment, [], CLAIMED)
    assert "its robot was told to stand still now" in found.problem
    assert found.fix == "Check where it stands, and see to Lamp by hand: the experiment's folder is gone."
    assert see_to_what_others_left(experiment, [], CLAIMED) == robots_left() == []
    assert not experiment.folder.root.exists(), "nothing is written where somebody has removed it"


@pytest.mark.parametrize("folder", ["/" + 300 * "x", "/a\0b"], ids=["as of a share that is dead", "of another kind"])
def test_of_a_folder_that_cannot_be_looked_at_the_robot_is_stopped_as_of_one_that_is_gone(
    experiment: Experiment, monkeypatch: pytest.MonkeyPatch, folder: str
) -> None:
    of_velocities(experiment, Deserted(), monkeypatch)
    (copy,) = left_copies()
    first, *others = copy.path.read_text().splitlines()
    copy.path.write_text("\n".join([json.dumps(json.loads(first) | {"folder": folder}), *others]))
    assert len(robots_left()) == 1
    (found,) = see_to_what_others_left(experiment, [], CLAIMED)
    assert "its robot was told to stand still now" in found.problem
    assert robots_left() == []


def test_an_experiment_that_was_moved_and_made_safe_has_left_nothing_where_it_was(
    experiment: Experiment, monkeypatch: pytest.MonkeyPatch
) -> None:
    of_velocities(experiment, Deserted(), monkeypatch)
    moved = ExperimentFolder(experiment.folder.root.rename(experiment.folder.root.with_name("moved")))
    (found,) = see_to_what_is_left(replace(experiment, folder=moved))
    assert "that was done now" in found.problem
    assert robots_left() == []


@pytest.mark.parametrize(
    ("is_commanded", "told"),
    [
        (True, "was told to stand still now, as far as it could be: nobody subscribes to /cmd_vel any more"),
        (False, "no command of it is known, so that the robot was told nothing now"),
    ],
    ids=["nobody hears", "no command is known"],
)
def test_of_a_robot_of_another_experiment_it_is_not_said_that_it_was_told_what_it_was_not(
    experiment: Experiment, monkeypatch: pytest.MonkeyPatch, is_commanded: bool, told: str
) -> None:
    file = of_velocities(experiment, Deserted(), monkeypatch)
    if not is_commanded:
        file.begin("rosbridge://127.0.0.1:1", left(experiment))
    other = replace(experiment, folder=ExperimentFolder(experiment.folder.root.parent / "other"))
    (found,) = see_to_what_others_left(other, [experiment.folder.root], CLAIMED)
    assert found.problem.endswith(told)
    assert may_be_moving(experiment.folder) == []


@pytest.mark.parametrize("systems", [[], ["Lamp"]])
def test_a_robot_of_another_experiment_that_cannot_be_stopped_refuses_this_one_once(
    experiment: Experiment, monkeypatch: pytest.MonkeyPatch, systems: list[str]
) -> None:
    def out_of_reach(_context: object) -> None:
        raise RuntimeError("rospy is not installed here")

    monkeypatch.setattr(standby, "connect_robot", out_of_reach)
    file = SystemsFile(experiment.folder)
    file.begin("rosbridge://127.0.0.1:1", left(experiment), systems)
    file.add_commanded(Commanded("/cmd_vel", "geometry_msgs/Twist"))
    other = replace(experiment, folder=ExperimentFolder(experiment.folder.root.parent / "other"))
    with pytest.raises(ExecutionError, match="cannot be told to stand still now: RuntimeError: rospy is not installed"):
        see_to_what_others_left(other, [experiment.folder.root], CLAIMED)
    assert see_to_what_others_left(other, [experiment.folder.root], CLAIMED) == []
    assert len(may_be_moving(experiment.folder)) == len(systems), "what else is to be made safe"


def test_where_all_are_killed_as_the_robot_of_another_experiment_is_stopped_its_systems_are_not_forgotten(
    experiment: Experiment, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = of_velocities(experiment, Deserted(), monkeypatch)
    file.begin("rosbridge://127.0.0.1:1", left(experiment), ["Lamp"])
    kept: list[bool] = []
    wait = Standby.wait

    def look(self: Standby) -> None:
        wait(self)
        kept.append(file.left() is not None)

    monkeypatch.setattr(Standby, "wait", look)
    other = replace(experiment, folder=ExperimentFolder(experiment.folder.root.parent / "other"))
    see_to_what_others_left(other, [experiment.folder.root], CLAIMED)
    assert kept == [True]


@pytest.mark.parametrize("name", ["x" * 5000, "\0", "\ud800"], ids=["refused by the system", "a zero", "no text"])
def test_where_the_folder_of_an_earlier_experiment_cannot_be_looked_at_that_is_told_and_this_one_goes_on(
    experiment: Experiment, name: str
) -> None:
    root = experiment.folder.root.parent / name  # as on a share that does not answer any more
    assert not goes_on(root)
    told = [each.problem for each in see_to_what_others_left(experiment, [root], CLAIMED)]
    reason = "File name too long"
    assert told == (
        [f"whether a killed execution has left something there is not known: {reason}"] if "x" in name else []
    )


@pytest.mark.parametrize("claims", [["robot:domain 7"], ["serial:/dev/ttyUSB0"], []])
def test_a_robot_of_another_experiment_that_is_not_claimed_is_left_alone(
    experiment: Experiment, claims: list[str]
) -> None:
    SystemsFile(experiment.folder).begin("rosbridge://127.0.0.1:1", left(experiment))
    gone = experiment.folder.root.parent / "gone"
    assert see_to_what_others_left(experiment, [experiment.folder.root, gone], claims) == []
    assert len(may_be_moving(experiment.folder)) == 1


@pytest.mark.skipif(sys.platform != "linux", reason="other systems do not tell what a process was started with")
@pytest.mark.parametrize("is_ours", [False, True], ids=["a robot that is not claimed", "a robot that is claimed"])
def test_what_a_killed_experiment_left_is_ended_only_where_the_robot_that_it_may_drive_can_be_stopped(
    experiment: Experiment, monkeypatch: pytest.MonkeyPatch, is_ours: bool
) -> None:
    began(experiment)
    of_velocities(experiment, Deserted(), monkeypatch)
    marked = os.environ | {"ROBOT_RUNNER_RUN_OF": str(experiment.folder.root.resolve())}
    other = replace(experiment, folder=ExperimentFolder(experiment.folder.root.parent / "other"))
    claims = CLAIMED if is_ours else ["host:pi"]
    with subprocess.Popen(["sleep", "3600"], env=marked) as planner:
        try:
            if is_ours:
                assert len(see_to_what_others_left(other, [experiment.folder.root], claims)) == 2
                assert planner.wait() == -signal.SIGKILL
            else:
                told = rf"process {planner.pid} .* may drive a robot \(rosbridge://127.0.0.1:1\)"
                with pytest.raises(ExecutionError, match=told):
                    see_to_what_others_left(other, [experiment.folder.root], claims)
                assert planner.poll() is None
        finally:
            planner.kill()


def test_of_a_robot_whose_commands_are_not_known_it_is_not_said_that_it_was_made_safe(
    write_config: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(standby, "connect_robot", lambda _context: Deserted())
    head = HEAD.replace("    plugins = [", "    none = [")
    experiment = prepare_or_refuse(write_config("", head=head, table=TABLE))
    experiment.folder.root.parent.mkdir()
    make_experiment_folder(experiment.folder.root)
    task = described_task(experiment, RunTask("r_2", 2, 2, 1, {"Room": "hall"}, 1, 7, 8))
    SystemsFile(experiment.folder).begin("rosbridge://127.0.0.1:1", task)
    (found,) = see_to_what_is_left(experiment)
    assert found.problem.endswith("no command of it is known, so that the robot was told nothing now")


@pytest.mark.parametrize(
    "content",
    ["", "{", "[]\n", '{"robot": 7, "task": {"run_id": "r_2"}}\n', '{"robot": null, "task": {}}\n', '{"a":' * 10_000],
)
def test_what_no_run_has_written_in_the_place_of_that_file_is_passed_over(experiment: Experiment, content: str) -> None:
    experiment.folder.to_make_safe.write_text(content)
    assert may_be_moving(experiment.folder) == []
    assert see_to_what_is_left(experiment) == []


@pytest.mark.parametrize("combination", [None, 7, {"Room": 7}, {"Room": []}])
def test_of_a_run_whose_treatments_are_not_told_it_is_told_where_it_cannot_be_made_safe(
    experiment: Experiment, combination: Any
) -> None:
    SystemsFile(experiment.folder).begin(None, left(experiment, combination=combination))
    with pytest.raises(ExecutionError, match="THE ROBOT MAY BE MOVING: an earlier execution was killed in r_2"):
        see_to_what_is_left(experiment)
    assert see_to_what_is_left(experiment) == []


def test_a_line_that_was_written_by_half_takes_no_other_with_it(experiment: Experiment) -> None:
    file = SystemsFile(experiment.folder)
    file.begin("dds://alice", left(experiment))
    file.add_commanded(Commanded("/alice/cmd_vel", "geometry_msgs/Twist"))
    with experiment.folder.to_make_safe.open("a") as half:
        half.write('{"topic": "/al')
    found = file.left()
    assert found is not None
    assert (found.robot, found.commanded) == ("dds://alice", (Commanded("/alice/cmd_vel", "geometry_msgs/Twist"),))


def test_a_commanded_topic_is_on_the_disk_before_anything_is_commanded_there(
    experiment: Experiment, monkeypatch: pytest.MonkeyPatch
) -> None:
    flushed: list[str] = []
    path = experiment.folder.to_make_safe
    monkeypatch.setattr(os, "fsync", lambda _descriptor: flushed.append(path.read_text()))
    file = SystemsFile(experiment.folder)
    file.begin("dds://alice", left(experiment))
    file.add_commanded(Commanded("/alice/cmd_vel", "geometry_msgs/Twist"))
    assert flushed[-1] == path.read_text()
    assert "/alice/cmd_vel" in flushed[-1]


def test_a_package_that_fails_to_end_what_it_has_left_is_named_and_systems_are_made_safe_all_the_same(
    experiment: Experiment, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise RuntimeError("the belt is stuck")

    belt = EntryPoint("belt", "robot_runner.left_behind", "lab:belt", lambda: ("lab", "1"))
    monkeypatch.setattr(EntryPoint, "load", lambda _self: fail)
    monkeypatch.setattr(plugin_checks, "entry_points", lambda _group: [belt])
    SystemsFile(experiment.folder).begin(None, left(experiment))
    with pytest.raises(ExecutionError, match=r"ending what was left raised RuntimeError: the belt is stuck") as caught:
        see_to_what_is_left(experiment)
    assert "lab:belt" in caught.value.findings[0].where
    assert made_safe(experiment) == "hall hall r_2 None"


def test_a_copy_that_is_left_without_its_file_is_removed_and_where_there_is_neither_nothing_is_opened(
    experiment: Experiment, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = SystemsFile(experiment.folder)
    file.begin("rosbridge://127.0.0.1:1", left(experiment))
    experiment.folder.to_make_safe.unlink()  # as on a disk that was full as it was to be written
    assert len(left_copies()) == 1
    file.remove()
    assert left_copies() == []
    for opening in ("read_text", "remove"):
        monkeypatch.delattr(systems_state, opening)
    file.remove()
