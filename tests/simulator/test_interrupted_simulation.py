"""A run may be interrupted at any instruction: the simulation in it goes on as if that had not happened."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from tests.instructions import Instructions

import robot_runner.simulator
from robot_runner.core.events.early_end import RunInterrupted
from robot_runner.core.execution.interruption import InterruptGate
from robot_runner.meters.ina219.line_meter import SharedLine
from robot_runner.simulator.simulated_devices import SimulatedSerialLine
from robot_runner.simulator.simulated_turtlebot3 import Simulation

_SIMULATOR = str(Path(robot_runner.simulator.__file__).parent)
_SECONDS = 0.3
_MOMENTS = 30


def _driven(at: int | None) -> tuple[dict[str, Any], int]:
    """Return what is known of a robot in the end, and how many instructions were counted.

    It drives, is measured and listened to; at an instruction, if any, the run is interrupted, and goes on a while.
    """
    simulation = Simulation(seed=1)
    robot = simulation.turtlebot3()
    stamps: list[int] = []
    robot.topics["odom"].listen(lambda _message: stamps.append(simulation.clock.now_ns))
    line = SharedLine(SimulatedSerialLine(simulation))
    simulation.clock.call_every(0.05, lambda: line.since(0))
    robot.drive(0.2, 0.3)
    simulation.clock.sleep(0.95)  # the battery is looked at each second
    gate = InterruptGate()
    gate.arm()
    with Instructions(_SIMULATOR, at=at, act=lambda _frame: gate.request()) as counted:
        try:
            simulation.clock.sleep(_SECONDS)
        except RunInterrupted:
            assert at is not None
        else:
            assert at is None or counted.count < at
    simulation.clock.sleep(2.0 - simulation.clock.now())
    known = {
        "pose": robot.pose,
        "energy": robot.energy,
        "odometry": robot.topics["odom"].latest()["pose"]["pose"],
        "samples": b"".join(chunk.data for chunk in line.since(0)),
        "stamps": stamps,
    }
    simulation.close()
    return known, counted.count


@pytest.mark.long
def test_a_simulation_that_was_interrupted_anywhere_goes_on_as_if_it_had_not_been() -> None:
    expected, count = _driven(None)
    stamps = expected.pop("stamps")
    for at in range(count // _MOMENTS // 2, count, count // _MOMENTS):
        known, _ = _driven(at)
        told = known.pop("stamps")
        assert known == expected, at
        # A message that was about to be told when the run was interrupted may not have come.
        assert set(told) <= set(stamps), at
        assert len(told) >= len(stamps) - 1, at
