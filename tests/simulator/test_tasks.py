"""Tasks: one at a time, and the history of them all."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot_runner.simulator.onboard import NO_TASK, Task, TaskRunner


@pytest.fixture
def runner():
    return TaskRunner(np.random.default_rng(1), deviation=1.0)


def test_there_is_one_task_at_a_time(runner):
    assert runner.start(Task.VIDEO, step=1)
    assert not runner.start(Task.NETWORK, step=2)
    assert runner.running is Task.VIDEO
    assert runner.stop(step=3) is Task.VIDEO
    assert runner.stop(step=4) is None
    assert runner.start(Task.NETWORK, step=5)


def test_the_history_says_what_ran_at_each_step(runner):
    runner.start(Task.VIDEO, step=2)
    runner.stop(step=4)
    runner.start(Task.COMPUTATION, step=5)
    assert runner.numbers(0, 6).tolist() == [NO_TASK, NO_TASK, 1, 1, NO_TASK, 0, 0]
    assert runner.numbers(3, 4).tolist() == [1, NO_TASK]


def test_a_task_started_and_stopped_at_once_never_ran(runner):
    runner.start(Task.VIDEO, step=2)
    runner.stop(step=2)
    assert set(runner.numbers(0, 5).tolist()) == {NO_TASK}


def test_each_task_differs_a_little_from_its_usual_power(runner):
    runner.start(Task.VIDEO, step=1)
    runner.stop(step=2)
    runner.start(Task.VIDEO, step=3)
    gains = runner.gains(0, 3).tolist()
    assert gains[0] == gains[2] == 1.0
    assert gains[1] != gains[3]
    assert gains[1] == pytest.approx(1.0, abs=0.05)


@given(st.lists(st.sampled_from([*Task, None]), max_size=30))
def test_the_history_agrees_with_what_was_running(actions):
    runner = TaskRunner(np.random.default_rng(1), deviation=1.0)
    running = []
    for step, action in enumerate(actions, start=1):
        if action is None:
            runner.stop(step=step)
        else:
            runner.start(action, step=step)
        running.append(NO_TASK if runner.running is None else list(Task).index(runner.running))
    assert runner.numbers(1, len(actions)).tolist() == running
