"""Actions on a simulation: goals are executed during sleeps on its clock, always at the same simulated times."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from functools import partial
from typing import ClassVar

from robot_runner.core.errors import GoalRejectedError
from robot_runner.core.links.goals import ActionResult, GoalStatus
from robot_runner.core.links.robot import Message
from robot_runner.ros.action_calls import missing_action
from robot_runner.ros.action_server import ActionTypes, Execution, GoalServer
from robot_runner.ros.graph_transport import GraphTypes, already_offered
from robot_runner.ros.ros2_actions import ros2_action_types
from robot_runner.ros.sent_goal import SentGoal
from robot_runner.simulator.simulated_clock import ClockWorker, SimulatedClock


class SimulatedActions:
    """The actions of a simulation, for all its links: those that are offered, by full name."""

    def __init__(self, clock: SimulatedClock, offered: dict[str, SimulatedAction], types: GraphTypes) -> None:
        self._clock = clock
        self._offered = offered
        self._types = types

    def types(self, action_type: str) -> ActionTypes:
        """Return the message types of an action."""
        return ros2_action_types(self._types, action_type)

    def actions(self) -> dict[str, str]:
        """Return the type of each offered action, by full name."""
        return {name: served.action_type for name, served in sorted(self._offered.items())}

    def client(self, action: str, action_type: str, timeout: float) -> _Client:
        """Return a client of an action, without waiting for it: no node could offer it during the wait."""
        del timeout
        served = self._offered.get(action)
        if served is None or served.action_type != action_type:
            raise missing_action(action, action_type, self.actions())
        return _Client(self._offered, served)

    def serve(self, action: str, action_type: str, server: GoalServer) -> SimulatedAction:
        """Offer an action whose goals a server of this link executes."""
        if action in self._offered:
            raise already_offered(action, "the simulation", what="action")
        served = self._offered[action] = SimulatedAction(self._clock, self._offered, action_type, server)
        return served


class SimulatedAction:
    """An action that is offered on a simulation until it is closed."""

    def __init__(
        self, clock: SimulatedClock, offered: dict[str, SimulatedAction], action_type: str, server: GoalServer
    ) -> None:
        self.action_type = action_type
        self.server = server
        self.senders: dict[str, SentGoal] = {}
        self._clock = clock
        self._offered = offered
        self._workers: list[ClockWorker] = []
        server.start = lambda work: self._workers.append(clock.work(work))
        server.connect(self)

    def close(self) -> None:
        """End the offer; goals that still execute are stopped in their sleep."""
        if self._offered.get(self.server.action) is self:
            del self._offered[self.server.action]
        for execution in self.server.executions:
            self.server.cancel(execution)
        for worker in self._workers:
            worker.stop()
        self.server.close()

    def tell_feedback(self, execution: Execution, message: Message) -> None:
        """Pass on feedback at the current time: the sender of the goal gets it during its sleep."""
        if (sender := self.senders.get(execution.key)) is not None:
            self._clock.after(0.0, partial(sender.take_feedback, message))

    def tell_status(self, executions: Sequence[Execution]) -> None:
        """Pass on the states of goals."""
        for execution in executions:
            if execution.key in self.senders and not execution.status.is_over:
                self.senders[execution.key].note(execution.status)

    def tell_result(self, execution: Execution, result: ActionResult) -> None:
        """Pass on the result of a goal, after its feedback."""
        if (sender := self.senders.pop(execution.key, None)) is not None:
            self._clock.after(0.0, partial(sender.finish, result))


class _Client:
    cancels_at_once: ClassVar[bool] = False
    _numbers = itertools.count(1)

    def __init__(self, offered: dict[str, SimulatedAction], served: SimulatedAction) -> None:
        self._offered = offered
        self._served = served
        self._action = served.server.action

    def send(self, goal: Message, sent: SentGoal, timeout: float) -> None:
        del timeout
        sent.key = str(next(self._numbers))
        self._served.senders[sent.key] = sent
        execution = self._served.server.accept(sent.key, goal)
        if execution is None:
            del self._served.senders[sent.key]
            sent.note(GoalStatus.REJECTED)
            fix = "Send a goal that it takes, or look whether it is busy."
            raise GoalRejectedError("the action server rejects the goal", where=self._action, fix=fix)
        sent.note(execution.status)

    def cancel(self, sent: SentGoal, timeout: float) -> None:
        del timeout
        if (execution := self._served.server.find(sent.key)) is not None:
            self._served.server.cancel(execution)

    def is_served(self) -> bool:
        return self._offered.get(self._action) is self._served

    def close(self) -> None:
        """Do nothing, as the client holds no resources."""
