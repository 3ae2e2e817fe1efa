"""A goal of any action as the mission, with real action servers on the embedded robot."""

from __future__ import annotations

import math
import threading
from contextlib import closing
from typing import TYPE_CHECKING, Any

import pytest
from tests.ros.missions.drive_action import ACTION, ACTION_TYPE, goal_at, offered
from tests.waiting import PATIENCE, wait_until

from robot_runner.core.config.preparation import prepare
from robot_runner.core.errors import LinkError, PluginError
from robot_runner.core.events.context import SystemClock
from robot_runner.core.links.connect import connect_robot
from robot_runner.core.links.goals import ActionAborted, ActionCanceled, GoalStatus
from robot_runner.plugins import Circumstances, Measure, treatment
from robot_runner.plugins.systems import ActionMission, Together
from robot_runner.ros.link_opening import open_rosbridge_link
from robot_runner.ros.missions.goal_measures import FeedbackMeasures
from robot_runner.ros.watchdog import velocity_of
from robot_runner.testing import (
    FakeAction,
    FakeClock,
    FakeLinks,
    FakeRobotLink,
    RosbridgeServer,
    SystemContract,
    make_context,
    rehearse,
)

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from robot_runner.core.events.context import RobotRunnerContext

_RECOVERIES = ("last", "number_of_recoveries")


def _mission(x: Any = 0.5, **more: Any) -> ActionMission:
    return ActionMission(ACTION, ACTION_TYPE, goal_at(x), **more)


class TestActionMission(SystemContract):
    """Half a metre ahead, by an action server."""

    breaking_points = 4
    goes_on_without_its_process = False  # on a real graph: tests/process/test_missions_on_real_graphs.py

    def make_plugin(self) -> ActionMission:
        recoveries = Measure("Recoveries", "1", "How often the robot recovered.")
        return _mission(feedback={recoveries: _RECOVERIES}, odometry="odom", scan="scan", stop_topic="cmd_vel")

    def make_context(self, folder: Path, plugin: Any, *, run_seed: int = 1) -> RobotRunnerContext:
        context = super().make_context(folder, plugin, run_seed=run_seed)
        offered(context)
        return context


@pytest.fixture
def contexts(tmp_path: Path) -> Iterator[Any]:
    """Return what makes the context of a run; it is closed afterwards."""
    made: list[RobotRunnerContext] = []

    def make(plugin: Any, **more: Any) -> RobotRunnerContext:
        made.append(make_context(tmp_path / str(len(made)), plugin, **more))
        return made[-1]

    yield make
    for context in made:
        context.resources.close()


def test_fields_of_the_goal_are_bound_to_treatments_and_what_comes_back_is_measured(contexts: Any) -> None:
    mission = _mission(
        treatment("Ahead"),
        feedback={
            Measure("Left", "m", "The least distance that was left."): ("minimum", "distance_remaining"),
            "FirstLeft": ("first", "distance_remaining"),
            "Recoveries": _RECOVERIES,
            "Told": "count",
        },
        odometry="odom",
        scan="scan",
    )
    for ahead in (0.3, 0.6):
        context = contexts(mission, combination={"Ahead": ahead})
        server = offered(context)
        measured = rehearse(context, mission)
        assert server.goals == [ahead]
        assert measured["Success"] is True
        assert measured["Outcome"] == "succeeded"
        assert measured["Duration"] == pytest.approx(ahead / 0.2, abs=0.7)
        assert measured["PathLength"] == pytest.approx(ahead, abs=0.05)
        assert measured["FirstLeft"] == pytest.approx(ahead, abs=0.02)
        assert measured["Left"] < 0.03
        assert measured["Recoveries"] == 2
        assert measured["Told"] > 10
        assert 1.0 < measured["ClosestObstacle"] < 1.6  # the pillar, or the wall behind


@pytest.mark.parametrize(
    ("server", "timeout_s", "outcome", "said"),
    [
        ({"aborts_at": 0.1}, 30.0, "aborted", "the goal was aborted"),
        ({"accept": lambda _: False}, 30.0, "rejected", "reject"),
        ({}, 1.0, "timed out", "was not over within 1 s, and was cancelled"),
    ],
)
def test_a_goal_that_is_not_reached_fails_the_run_or_is_a_measure(
    contexts: Any, server: dict[str, Any], timeout_s: float, outcome: str, said: str
) -> None:
    failing = _mission(timeout_s=timeout_s)
    context = contexts(failing)
    offered(context, **server)
    with pytest.raises(LinkError, match=said):
        rehearse(context, failing)
    measuring = _mission(timeout_s=timeout_s, failure="measure", odometry="odom", result={"ErrorCode": "error_code"})
    context = contexts(measuring)
    offered(context, **server)
    measured = rehearse(context, measuring)
    assert measured["Success"] is False
    assert measured["Outcome"] == outcome
    assert measured["PathLength"] < 0.4
    assert measured["ErrorCode"] == {"aborted": 208}.get(outcome)


def test_the_duration_begins_with_the_goal_s_acceptance(contexts: Any) -> None:
    mission = _mission(0.2, failure="measure")
    context = contexts(mission)

    def accept(_: Any) -> bool:
        context.clock.sleep(3.0)
        return True

    offered(context, accept=accept)
    assert rehearse(context, mission)["Duration"] < 2.5
    context = contexts(mission)
    offered(context, accept=lambda _: False)
    assert rehearse(context, mission)["Duration"] is None


@pytest.mark.parametrize(
    ("sequence", "is_aborted", "second"), [([7, 8], False, 8), ([7, 8], True, 8), ([], True, None)]
)
def test_an_element_that_the_result_of_an_aborted_goal_lacks_is_missing_and_fails_no_run(
    contexts: Any, sequence: list[int], is_aborted: bool, second: int | None
) -> None:
    context, mission = _counted(contexts, sequence, is_aborted=is_aborted)
    measured = rehearse(context, mission)
    assert (measured["Success"], measured["Second"]) == (not is_aborted, second)


def test_an_element_that_the_result_of_a_reached_goal_lacks_fails_the_run(contexts: Any) -> None:
    context, mission = _counted(contexts, [7], is_aborted=False)
    with pytest.raises(LinkError, match=r"no field 'sequence\.1'"):
        rehearse(context, mission)


def _counted(contexts: Any, sequence: list[int], *, is_aborted: bool) -> tuple[Any, ActionMission]:
    action_type = "example_interfaces/Fibonacci"
    mission = ActionMission("count", action_type, result={"Second": "sequence.1"}, failure="measure")

    def execute(_: Any) -> dict[str, Any]:
        if is_aborted:
            raise ActionAborted(result={"sequence": sequence})
        return {"sequence": sequence}

    context = contexts(mission)
    connect_robot(context).offer_action("count", action_type, execute)
    return context, mission


def test_feedback_that_is_no_number_yet_is_left_out_of_its_mean() -> None:
    kinds = ("first", "minimum", "maximum", "mean")
    feedback = FeedbackMeasures({kind.title(): (kind, "left") for kind in kinds}, where="Go")
    feedback.take({"left": math.inf})
    assert set(feedback.values().values()) == {None}
    for left in (math.nan, 3.0, 1.0):
        feedback.take({"left": left})
    assert feedback.values() == {"First": None, "Minimum": 1.0, "Maximum": 3.0, "Mean": 2.0}


def test_a_server_that_is_missing_or_has_another_type_fails_the_run_in_its_deadline(contexts: Any) -> None:
    context = contexts(mission := _mission(failure="measure", connect_timeout_s=1.0))
    with pytest.raises(LinkError, match="there is no action '/navigate_to_pose'"):
        rehearse(context, mission)
    other = ActionMission(ACTION, "example_interfaces/Fibonacci", {"order": 3}, connect_timeout_s=1.0)
    context = contexts(other)
    offered(context)
    with pytest.raises(LinkError, match="of the type nav2_msgs/NavigateToPose"):
        rehearse(context, other)
    wrong = ActionMission(ACTION, ACTION_TYPE, {"poses": []})
    context = contexts(wrong)
    offered(context)
    with pytest.raises(LinkError, match="'poses'"):
        rehearse(context, wrong)


def test_a_goal_that_goes_on_after_it_was_cancelled_fails_the_run_whatever_the_policy(contexts: Any) -> None:
    stubborn = _mission(9.0, timeout_s=0.5, cancel_timeout_s=0.3, failure="measure")
    context = contexts(stubborn)
    offered(context, obeys=False)
    with pytest.raises(LinkError, match="does not end within"):
        rehearse(context, stubborn)


def test_what_ends_the_mission_cancels_the_goal_and_does_not_leave_it_to_the_closing_events(contexts: Any) -> None:
    mission = _mission(3.0)
    context = contexts(mission)
    server = offered(context)
    mission.start_run(context)
    context.clock.call_every(1.0, lambda: _raise(LookupError("the operator went home")))
    with pytest.raises(LookupError, match="went home"):
        mission.launch_mission(context)
    assert server.cancelled == 1


def _raise(error: Exception) -> None:
    raise error


def test_make_safe_cancels_goals_also_where_the_wheels_cannot_be_stopped(contexts: Any, monkeypatch: Any) -> None:
    mission = ActionMission(ACTION, ACTION_TYPE, stop_topic="cmd_vel")
    link = FakeRobotLink(FakeClock())
    link.offer(f"{ACTION}/_action/cancel_goal", "action_msgs/CancelGoal", lambda _: {"return_code": 0})

    def publish(topic: str, *_: Any) -> None:
        raise LinkError("somebody subscribes it as another type", where=topic)

    monkeypatch.setattr(link, "publish", publish)
    with pytest.raises(LinkError, match="as another type"):
        mission.make_safe(contexts(mission, robot="dds", links=FakeLinks(robot=link)))
    assert [each.service for each in link.calls] == [f"/{ACTION}/_action/cancel_goal"]


@pytest.mark.long
@pytest.mark.parametrize("generation", [1, 2])
def test_make_safe_cancels_through_a_rosbridge_a_goal_that_another_process_sent(contexts: Any, generation: int) -> None:
    mission = ActionMission("tally", "actionlib/Test" if generation == 1 else "example_interfaces/Fibonacci")
    asked = threading.Event()

    def execute(execution: Any) -> dict[str, Any]:
        wait_until(lambda: execution.is_cancel_requested)
        asked.set()
        raise ActionCanceled

    with (
        closing(RosbridgeServer(generation=generation)) as server,
        closing(open_rosbridge_link(server.url, SystemClock())) as robot,
        closing(open_rosbridge_link(server.url, SystemClock())) as sender,
        closing(open_rosbridge_link(server.url, SystemClock())) as standing_by,
    ):
        robot.offer_action(mission.action, mission.action_type, execute)
        goal = sender.send_goal(mission.action, mission.action_type, {})
        mission.make_safe(contexts(mission, robot=server.url, links=FakeLinks(robot=standing_by)))
        assert asked.wait(PATIENCE)
        assert goal.result(timeout=PATIENCE).status is GoalStatus.CANCELED


@pytest.mark.long
def test_a_goal_whose_connection_is_lost_ends_the_mission_at_once_and_did_not_time_out(contexts: Any) -> None:
    mission = ActionMission("dig", "example_interfaces/Fibonacci", timeout_s=PATIENCE, failure="measure")
    with (
        closing(RosbridgeServer(generation=2)) as server,
        closing(open_rosbridge_link(server.url, SystemClock())) as robot,
        closing(open_rosbridge_link(server.url, SystemClock())) as link,
    ):

        def execute(execution: Any) -> dict[str, Any]:
            wait_until(lambda: mission._accepted_at is not None)
            (goal,) = server.actions.offered["/dig"].goals.values()
            goal.sender.close()  # the connection of the goal alone
            wait_until(lambda: execution.is_cancel_requested)
            raise ActionCanceled

        robot.offer_action(mission.action, mission.action_type, execute)
        context = contexts(mission, robot=server.url, links=FakeLinks(robot=link), clock=SystemClock())
        with pytest.raises(LinkError, match="the connection is lost"):
            rehearse(context, mission)


@pytest.mark.parametrize(("feedback", "asked"), [([{"sequence": [1]}] * 20, 1), ([], 10)])
def test_whether_the_server_of_a_goal_is_there_is_not_asked_while_feedback_comes(
    contexts: Any, monkeypatch: pytest.MonkeyPatch, feedback: list[Any], asked: int
) -> None:
    mission = ActionMission("dig", "example_interfaces/Fibonacci", failure="measure")
    clock = FakeClock()
    robot = FakeRobotLink(clock, actions={"dig": FakeAction({"sequence": []}, seconds=9.5, feedback=feedback)})
    questions, actions = [], robot.actions
    monkeypatch.setattr(robot, "actions", lambda: questions.append(clock.now()) or actions())
    context = contexts(mission, robot="ros2", links=FakeLinks(robot=robot), clock=clock)
    assert rehearse(context, mission)["Outcome"] == "succeeded"
    assert len(questions) == asked


@pytest.mark.long
def test_a_goal_goes_on_though_rosapi_hangs(contexts: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    mission = ActionMission("dig", "example_interfaces/Fibonacci", timeout_s=PATIENCE)
    with (
        closing(RosbridgeServer(generation=2)) as server,
        closing(open_rosbridge_link(server.url, SystemClock())) as robot,
        closing(open_rosbridge_link(server.url, SystemClock())) as link,
    ):
        begun, answered, actions = [], [], link.actions

        def execute(_: Any) -> dict[str, Any]:
            wait_until(lambda: answered)
            server._rosapi.hangs = True
            wait_until(lambda: len(begun) > len(answered) + 1)  # asked in vain, and once more
            server._rosapi.hangs = False
            return {"sequence": [1]}

        def asked() -> Any:
            begun.append(None)
            listed = actions()
            answered.append(None)
            return listed

        robot.offer_action(mission.action, mission.action_type, execute)
        monkeypatch.setattr(link, "actions", asked)
        context = contexts(mission, robot=server.url, links=FakeLinks(robot=link), clock=SystemClock())
        assert rehearse(context, mission)["Outcome"] == "succeeded"


@pytest.mark.parametrize("twist", ["geometry_msgs/Twist", "geometry_msgs/TwistStamped"])
def test_a_robot_is_stopped_on_its_stop_topic_at_once_though_rosapi_hangs(
    contexts: Any, monkeypatch: pytest.MonkeyPatch, twist: str
) -> None:
    mission = ActionMission("dig", "example_interfaces/Fibonacci", stop_topic="dig/cmd_vel")
    answers, heard = threading.Event(), []
    with (
        closing(RosbridgeServer(generation=2)) as server,
        closing(open_rosbridge_link(server.url, SystemClock())) as robot,
        closing(open_rosbridge_link(server.url, SystemClock())) as link,
    ):
        robot.subscribe("dig/cmd_vel", twist, lambda message: heard.append(velocity_of(twist, message)["linear"]["x"]))
        wait_until(lambda: link.subscribers("dig/cmd_vel"))
        context = contexts(mission, robot=server.url, links=FakeLinks(robot=link), clock=SystemClock())
        mission.start_run(context)
        for question in ("subscribers", "actions"):
            monkeypatch.setattr(link, question, lambda *_: answers.wait(PATIENCE) and {})
        stopping = threading.Thread(target=mission.make_safe, args=(context,))
        stopping.start()
        try:
            wait_until(lambda: heard)
        finally:
            answers.set()
            stopping.join(PATIENCE)
            mission.stop_run(context)
    assert set(heard) == {0.0}


def test_two_robots_reach_their_goals_at_the_same_time(contexts: Any) -> None:
    pair = Together(*(_mission(0.6, name=name, namespace=f"/{name}") for name in ("alice", "bob")))
    context = contexts(pair)
    for name in ("alice", "bob"):
        offered(context, namespace=f"/{name}")
    measured = rehearse(context, pair)
    assert measured["alice.Outcome"] == measured["bob.Outcome"] == "succeeded"
    assert context.window.end - context.window.start == pytest.approx(measured["alice.Duration"], abs=0.5)
    one_robot = Together(_mission(name="alice"), _mission(name="bob"))
    found = list(one_robot.check(Circumstances(robot="simulated")))
    assert "alice and bob command the same robot" in found[0].problem


@pytest.mark.parametrize(
    ("given", "complaint"),
    [
        ({"failure": "mesure"}, "failure is 'mesure'"),
        ({"timeout_s": 0}, "timeout_s is 0"),
        ({"goal": [1.0]}, r"goal is \[1\.0\]"),
        ({"result": {"Error": 3}}, "which is not a field"),
        ({"feedback": {"Recoveries": "last"}}, r"feedback\['Recoveries'\] is 'last'"),
        ({"feedback": {"Recoveries": ("newest", "x")}}, "asks for 'newest' of 'x'"),
        ({"result": {"Duration": "total"}}, "two of its measures are named 'Duration'"),
    ],
)
def test_a_parameter_that_cannot_be_is_refused(given: dict[str, Any], complaint: str) -> None:
    with pytest.raises(PluginError, match=complaint):
        ActionMission(ACTION, ACTION_TYPE, **given)


def test_on_the_embedded_robot_a_wrong_goal_or_message_is_found_before_any_run(write_config: Any) -> None:
    head = """\
from robot_runner import *
from robot_runner.plugins import treatment
from robot_runner.plugins.systems import ActionMission, TopicMission


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "trial"
    robot = "simulated"
"""
    goal = "{'pose': {'pose': {'position': {'x': treatment('Task')}}}}"
    body = f"""
        plugins = [
            ActionMission("navigate_to_pose", "nav2_msgs/NavigateToPose", {goal}),
            TopicMission("cmd_vel", "geometry_msgs/Twist", {{"linar": {{}}}}, until=1.0),
        ]
    """
    first, second, message = (str(each) for each in prepare(write_config(body, head=head)).findings if each.is_error)
    assert "field 'pose.pose.position.x' is 'Video'" in first
    assert "field 'pose.pose.position.x' is 'Network'" in second
    assert "the message has no field 'linar' → Did you mean 'linear'?" in message
