"""The rules for actions of every robot link, as tests that the contracts of links inherit."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar

from robot_runner.core.errors import LinkError
from robot_runner.core.events.early_end import fails_run
from robot_runner.core.links.goals import ActionAborted, ActionCanceled, GoalStatus
from robot_runner.core.links.robot import Goal, GoalExecution, Message, RobotLink
from robot_runner.testing.plugin_contract import require

#: The timeout, on a busy machine, for operations that take milliseconds, s.
PATIENCE = 20.0
#: By how much an operation may exceed its deadline, s, and how often it is tried, since a busy machine may be late.
_SLACK, _ATTEMPTS = 3.0, 3
_FIBONACCI, _STRING = "example_interfaces/Fibonacci", "std_msgs/String"
#: How long a step of an execution takes, s.
_STEP = 0.05
#: More steps than any test awaits.
_FOR_EVER = 100_000


def refusal(attempt: Callable[[], object]) -> LinkError:
    """Return the `LinkError` that the attempt raises; fail the test if it raises none."""
    try:
        attempt()
    except LinkError as error:
        require(error.problem and error.where, f"{error!r} does not say what is wrong and where")
        return error
    raise AssertionError("the attempt was not refused")


def punctual_refusal(attempt: Callable[[], object], *, timeout: float) -> LinkError:
    """Return the `LinkError` of an attempt; fail the test if no attempt raises it soon after its `timeout`, s."""
    for _ in range(_ATTEMPTS):
        begun = time.monotonic()
        error = refusal(attempt)
        if time.monotonic() - begun < timeout + _SLACK:
            return error
    raise AssertionError(f"the attempt took too long: more than {_SLACK:g} s after its deadline")


@contextmanager
def faults_told() -> Iterator[list[str]]:
    """Yield the faults that are reported to the run, each after its place."""
    told: list[str] = []
    with fails_run(lambda fault, where: told.append(f"{where}: {fault}")):
        yield told


class ActionContract:
    """The rules for actions of a link. Of two links to one graph, one offers the action, the other sends goals.

    Attributes:
        action_type: of the tests' action: an order, and a sequence as result and feedback.
        other_action_type: a type that no action of the tests has, but whose definition is known here.
        can_reject: whether an action that is offered over the link can reject a goal. A rosbridge of ROS 2 accepts all
            goals by itself; there the goal is aborted instead.
    """

    action_type: ClassVar[str] = _FIBONACCI
    other_action_type: ClassVar[str] = "nav2_msgs/NavigateToPose"
    can_reject: ClassVar[bool] = True

    if TYPE_CHECKING:
        # Defined by the contract that inherits these tests.
        make_link: Callable[..., RobotLink]
        pass_time: Callable[[float], None]
        opened: Callable[..., AbstractContextManager[RobotLink]]
        until: Callable[..., None]
        discovery: ClassVar[float]

    def counted(self, execution: GoalExecution) -> Message:
        """Execute a goal as in the tutorial of ROS: step by step, with feedback after each."""
        sequence = [0, 1]
        for _ in range(execution.goal["order"] - 1):
            if execution.is_cancel_requested:
                raise ActionCanceled("as asked", {"sequence": sequence})
            sequence.append(sequence[-1] + sequence[-2] if len(sequence) < 40 else 0)  # noqa: PLR2004  # an int32
            execution.feedback({"sequence": sequence[-2:]})
            self.pass_time(_STEP)
        return {"sequence": sequence}

    def test_a_goal_is_executed_with_feedback_and_a_result(self) -> None:
        """Check that the client gets the result and the feedback of its goal, with every field."""
        told: list[Message] = []
        with self.opened() as robot, self.opened() as link:
            offer = robot.offer_action("count", self.action_type, self.counted)
            goal = link.send_goal("count", self.action_type, {"order": 6}, on_feedback=told.append, timeout=PATIENCE)
            require(goal.status in set(GoalStatus), f"the status is {goal.status!r}")
            begun = time.monotonic()
            result = goal.result(timeout=2 * PATIENCE)
            require(time.monotonic() - begun < PATIENCE, "`result` waits on although the goal is over")
            require(result.status is GoalStatus.SUCCEEDED and result.has_succeeded, f"the goal is {result.status}")
            require(result.result == {"sequence": [0, 1, 1, 2, 3, 5, 8]}, f"the result is {result.result}")
            require(goal.status is GoalStatus.SUCCEEDED, f"a goal that succeeded is {goal.status}")
            require({"sequence": [5, 8]} in told, f"the feedback is {told}")
            require(goal.result(timeout=0.1) == result, "the result is told once only")
            goal.cancel()  # does nothing, as the goal is over
            offer.close()
            offer.close()

    def test_a_goal_ends_while_a_callback_of_a_topic_is_at_work(self) -> None:
        """Check that its end waits for no callback, by which its duration would be longer."""
        if not hasattr(self, "discovery"):  # callbacks of the embedded robot are called while its clock is slept on
            return
        began, released = threading.Event(), threading.Event()

        def work(_: Message) -> None:
            began.set()
            released.wait(2 * PATIENCE)

        with self.opened() as robot, self.opened() as link:

            def has_begun() -> bool:
                robot.publish("chatter", _STRING, {"data": "a"})
                return began.is_set()

            robot.offer_action("count", self.action_type, self.counted)
            self.until(lambda: "/count" in link.actions(), "the action is not found", timeout=self.discovery)
            link.subscribe("chatter", _STRING, work)
            self.until(has_begun, "nothing is received", timeout=self.discovery)
            told: list[Message] = []
            goal = link.send_goal("count", self.action_type, {"order": 5}, on_feedback=told.append)
            status = goal.result(timeout=PATIENCE).status
            released.set()
            require(status is GoalStatus.SUCCEEDED, f"the goal is {status}")
            require(len(told) == 4, f"feedback came {len(told)} times")  # noqa: PLR2004 - as of the order

    def test_actions_are_listed_by_full_names_with_their_types(self) -> None:
        """Check that an offered action is listed until it is closed."""
        with self.opened() as robot, self.opened("alice") as link:
            offer = robot.offer_action("count", self.action_type, self.counted)
            self.until(lambda: link.actions().get("/count") == self.action_type, f"the actions are {link.actions()}")
            require(link.send_goal("/count", self.action_type, {"order": 1}, timeout=PATIENCE), "no goal")
            offer.close()
            self.until(lambda: "/count" not in link.actions(), "an action that is not offered any more is listed")

    def test_a_goal_is_cancelled(self) -> None:
        """Check that a cancelled goal soon ends as cancelled, with the result of its server."""
        with self.opened() as robot, self.opened() as link:
            robot.offer_action("count", self.action_type, self.counted)
            goal = self.begun(link)
            goal.cancel(timeout=PATIENCE)
            result = goal.result(timeout=1.0)
            require(result.status is GoalStatus.CANCELED, f"a cancelled goal is {result.status}")
            require(result.result["sequence"][:2] == [0, 1], f"its result is {result.result}")
            require(not result.has_succeeded, "a cancelled goal has succeeded")

    def test_a_goal_that_its_server_gives_up_is_aborted(self) -> None:
        """Check that the client gets the aborted status, and the result that the server filled in."""

        def execute(execution: GoalExecution) -> Message:
            raise ActionAborted("no way", {"sequence": [execution.goal["order"]]})

        with self.opened() as robot, self.opened() as link:
            robot.offer_action("count", self.action_type, execute)
            result = link.send_goal("count", self.action_type, {"order": 7}, timeout=PATIENCE).result(timeout=PATIENCE)
            require(result.status is GoalStatus.ABORTED, f"the goal is {result.status}")
            require(result.result == {"sequence": [7]}, f"the result is {result.result}")
            require(result.text in {"", "no way"}, f"the text is {result.text!r}")

    def test_an_action_server_that_fails_aborts_the_goal_and_fails_the_run(self) -> None:
        """Check that an exception in the execution is reported to both sides, once."""

        def execute(execution: GoalExecution) -> Message:
            raise ValueError(f"a fault at {execution.goal['order']}")

        with faults_told() as told, self.opened() as robot, self.opened() as link:
            robot.offer_action("count", self.action_type, execute)
            result = link.send_goal("count", self.action_type, {"order": 7}, timeout=PATIENCE).result(timeout=PATIENCE)
            require(result.status is GoalStatus.ABORTED, f"the goal is {result.status}")
        require(told == ["the action of /count: a fault at 7"], f"the run was told {told}")

    def test_a_goal_that_is_rejected_is_refused(self) -> None:
        """Check that the error says that the server has rejected the goal."""
        with self.opened() as robot, self.opened() as link:
            robot.offer_action("count", self.action_type, self.counted, accept=lambda goal: goal["order"] > 0)
            link.send_goal("count", self.action_type, {"order": 1}, timeout=PATIENCE).result(timeout=PATIENCE)
            send = partial(link.send_goal, "count", self.action_type, {"order": -1}, timeout=3.0)
            if not self.can_reject:
                require(send().result(timeout=PATIENCE).status is GoalStatus.ABORTED, "the goal is not aborted")
                return
            error = punctual_refusal(send, timeout=3.0)
            require("/count" in error.where, f"the action is not named: {error}")
            require("reject" in error.problem, f"the cause is not named: {error}")

    def test_an_action_that_is_not_there_is_refused_in_time(self) -> None:
        """Check that the error names the nearest action, or the true type, within the deadline."""
        with self.opened() as robot, self.opened() as link:
            robot.offer_action("count", self.action_type, self.counted)
            self.until(lambda: "/count" in link.actions(), "the action is not found")
            error = punctual_refusal(lambda: link.send_goal("coumt", self.action_type, timeout=1.0), timeout=1.0)
            require("coumt" in f"{error.where} {error.problem}", f"the action is not named: {error}")
            require("/count" in error.fix, f"the nearest is not named: {error}")
            error = refusal(lambda: link.send_goal("count", self.other_action_type, timeout=1.0))
            require(self.action_type in f"{error.problem} {error.fix}", f"the true type is not named: {error}")
            refusal(lambda: link.send_goal("count", "example_interfaces/Fibonaci", timeout=1.0))
            error = refusal(lambda: link.send_goal("count", self.action_type, {"odrer": 1}))
            require("odrer" in error.problem and "'order'" in error.fix, f"the field is not named: {error}")

    def test_an_action_is_offered_once(self) -> None:
        """Check that a second server with the same name is refused."""
        with self.opened() as robot, self.opened() as link:
            robot.offer_action("count", self.action_type, self.counted)
            self.until(lambda: "/count" in link.actions(), "the action is not found")
            error = refusal(lambda: link.offer_action("count", self.action_type, self.counted))
            require("/count" in f"{error.where} {error.problem}", f"the action is not named: {error}")

    def test_a_goal_that_is_not_over_in_time_goes_on(self) -> None:
        """Check that `result` ends at its deadline, and can be called again."""
        with self.opened() as robot, self.opened() as link:
            robot.offer_action("count", self.action_type, self.counted)
            goal = link.send_goal("count", self.action_type, {"order": 12}, timeout=PATIENCE)
            error = refusal(lambda: goal.result(timeout=0.2))
            require("0.2 s" in error.problem and "/count" in error.where, f"the deadline is not named: {error}")
            require(goal.result(timeout=PATIENCE).has_succeeded, "the goal did not go on")

    def test_a_cancel_that_is_not_confirmed_is_an_error_in_time(self) -> None:
        """Check that it is an error if the server does not end the goal."""
        released: list[bool] = []

        def execute(execution: GoalExecution) -> Message:
            while not released:
                self.pass_time(_STEP)
            return {"sequence": [execution.goal["order"]]}

        with self.opened() as robot, self.opened() as link:
            robot.offer_action("count", self.action_type, execute)
            goal = link.send_goal("count", self.action_type, {"order": 3}, timeout=PATIENCE)
            try:
                error = punctual_refusal(partial(goal.cancel, timeout=0.5), timeout=0.5)
                require("0.5 s" in error.problem, f"the deadline is not named: {error}")
            finally:
                released.append(True)
            goal.result(timeout=PATIENCE)

    def test_a_fault_of_a_feedback_callback_fails_the_run_at_once(self) -> None:
        """Check that it is reported during the execution, once, and that the goal goes on."""

        def hear(message: Message) -> None:
            raise ValueError(f"a fault at {len(message)}")

        with faults_told() as told, self.opened() as robot, self.opened() as link:
            robot.offer_action("count", self.action_type, self.counted)
            goal = link.send_goal("count", self.action_type, {"order": 8}, on_feedback=hear, timeout=PATIENCE)
            self.until(lambda: told, "the run was not told")
            require(goal.result(timeout=PATIENCE).has_succeeded, "the goal did not go on")
        require(told == ["the callback of /count: a fault at 1"], f"the run was told {told}")

    def test_two_goals_are_kept_apart(self) -> None:
        """Check that each goal has its own feedback and result."""
        with self.opened() as robot, self.opened() as link:
            robot.offer_action("count", self.action_type, self.counted)
            told: tuple[list[Any], list[Any]] = ([], [])
            goals = [
                link.send_goal("count", self.action_type, {"order": order}, on_feedback=hear.append, timeout=PATIENCE)
                for order, hear in zip((4, 9), told, strict=True)
            ]
            results = [goal.result(timeout=PATIENCE).result["sequence"] for goal in goals]
            require([len(sequence) for sequence in results] == [5, 10], f"the results are {results}")
            require({"sequence": [21, 34]} in told[1] and {"sequence": [21, 34]} not in told[0], f"feedback is {told}")

    def test_a_closed_link_leaves_no_goal_behind(self) -> None:
        """Check that closing a link cancels its goals that are not over, and ends those of its offers."""
        ended: list[str] = []

        def execute(execution: GoalExecution) -> Message:
            try:
                return self.counted(execution)
            except ActionCanceled:
                ended.append("cancelled")
                raise

        with self.opened() as robot:
            robot.offer_action("count", self.action_type, execute)
            link = self.make_link()
            try:
                self.begun(link)
            finally:
                link.close()
            require(ended == ["cancelled"], f"the goal of a link that was closed is not over: {ended}")
            refusal(lambda: link.send_goal("count", self.action_type))
            with self.opened() as other:
                goal = self.begun(other)
                robot.close()
                with suppress(LinkError):  # whose result is told, or is an error
                    has_succeeded = goal.result(timeout=PATIENCE).status is GoalStatus.SUCCEEDED
                    require(not has_succeeded, "a goal whose server left succeeded")

    def begun(self, link: RobotLink) -> Goal:
        """Send a long goal, and wait until its execution has begun."""
        told: list[Message] = []
        goal = link.send_goal(
            "count", self.action_type, {"order": _FOR_EVER}, on_feedback=told.append, timeout=PATIENCE
        )
        self.until(lambda: told, "no feedback comes", timeout=PATIENCE)
        return goal
