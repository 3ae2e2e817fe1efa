"""The events of an experiment and their order (paper, Fig. 2): the one table that says who hears what where."""

from __future__ import annotations

from enum import Enum

__all__ = ["CLOSED_BY", "EVENTS_BY_CALLBACK", "ORCHESTRATED_EVENTS", "RUN_EVENTS", "RobotRunnerEvents"]


class RobotRunnerEvents(Enum):
    """The key moments of an experiment, in the order in which they come.

    A method of a config or a plugin that is named like an event hears it (`callback_name`).
    """

    BEFORE_EXPERIMENT = "before_experiment"
    BEFORE_RUN = "before_run"
    START_RUN = "start_run"
    START_MEASUREMENT = "start_measurement"
    LAUNCH_MISSION = "launch_mission"
    STOP_MEASUREMENT = "stop_measurement"
    STOP_RUN = "stop_run"
    POPULATE_RUN_DATA = "populate_run_data"
    CONTINUE = "continue"
    AFTER_EXPERIMENT = "after_experiment"

    #: Each member is there once; the enumeration's own would hash its name, in Python, at each look into a dictionary.
    __hash__ = object.__hash__

    @property
    def callback_name(self) -> str:
        """The method that hears this event; `continue` is a word of Python, so its method is `continue_experiment`."""
        return "continue_experiment" if self is RobotRunnerEvents.CONTINUE else self.value

    @property
    def is_closing(self) -> bool:
        """Whether it closes what another event opened, and so reaches its subscribers in reverse order."""
        return self in _CLOSING

    @property
    def belongs_to_run(self) -> bool:
        """Whether there is a run that it is about (and a time-stamp column in the run table)."""
        return self not in {RobotRunnerEvents.BEFORE_EXPERIMENT, RobotRunnerEvents.AFTER_EXPERIMENT}


#: Heard in the run's own process, in this order.
RUN_EVENTS = (
    RobotRunnerEvents.START_RUN,
    RobotRunnerEvents.START_MEASUREMENT,
    RobotRunnerEvents.LAUNCH_MISSION,
    RobotRunnerEvents.STOP_MEASUREMENT,
    RobotRunnerEvents.STOP_RUN,
    RobotRunnerEvents.POPULATE_RUN_DATA,
)

#: Heard in the orchestrating process.
ORCHESTRATED_EVENTS = (
    RobotRunnerEvents.BEFORE_EXPERIMENT,
    RobotRunnerEvents.BEFORE_RUN,
    RobotRunnerEvents.CONTINUE,
    RobotRunnerEvents.AFTER_EXPERIMENT,
)

#: What an opening event starts, the event beside it stops, whatever fails in between.
CLOSED_BY = {
    RobotRunnerEvents.START_RUN: RobotRunnerEvents.STOP_RUN,
    RobotRunnerEvents.START_MEASUREMENT: RobotRunnerEvents.STOP_MEASUREMENT,
}

_CLOSING = frozenset(CLOSED_BY.values())

#: Which event a method hears, by the method's name.
EVENTS_BY_CALLBACK = {event.callback_name: event for event in RobotRunnerEvents}
