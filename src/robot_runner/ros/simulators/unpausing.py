"""Lets a simulator go on from a process of its own: for the orchestrator, which may start no threads, and after it."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Sequence
from contextlib import closing, suppress
from typing import TYPE_CHECKING, Any

from robot_runner.core.errors import LinkError, RobotRunnerError
from robot_runner.core.events.context import SystemClock
from robot_runner.core.links.connect import resolved_robot
from robot_runner.core.links.graph_names import full_name, namespace_prefix
from robot_runner.ros.graph_links import GRAPH_LINKS

if TYPE_CHECKING:
    from robot_runner.ros.simulators.simulator_dialects import Demand

#: How long a client library may take to be imported and to find the simulator, s.
_CONNECTING = 20.0
_REFUSED = 3
#: How long a guardian may take to end, s.
_ENDING = 5.0
_GUARD = "guard"


#: Our guardians, by the robot and the namespace: a plugin with bound parameters is made anew for each run.
_guardians: dict[tuple[str, str], subprocess.Popen[str]] = {}


def guard_pauses(robot: str, namespace: str, unpause: Demand, timeout: float, *, signs: Sequence[str] = ()) -> None:
    """Have a process wait for the end of this one, and let the simulator go on where that comes unasked.

    It reads from a pipe, which the processes of a run hold as well: it acts once all of them are gone. Another call
    tells it another service. What it is told is what `unpause_from_elsewhere` takes.
    """
    told = json.dumps(_told(robot, namespace, unpause, timeout, signs))
    guardian = _guardians.get((robot, namespace))
    if guardian is None or guardian.poll() is not None:
        guardian = _guardians[robot, namespace] = subprocess.Popen(  # noqa: S603 - our own module
            [sys.executable, "-P", "-m", __name__, _GUARD],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            text=True,
            start_new_session=True,  # what a terminal interrupts is not its end
        )
    _tell(guardian, told)


def guard_pauses_no_more(robot: str, namespace: str) -> None:
    """End the guardian of a simulator, which was left going on."""
    guardian = _guardians.pop((robot, namespace), None)
    if guardian is not None:
        _tell(guardian, json.dumps(None))
        with suppress(BrokenPipeError, subprocess.TimeoutExpired):  # it will end, now that it was told
            guardian.communicate(timeout=_ENDING)


def _tell(guardian: subprocess.Popen[str], line: str) -> None:
    assert guardian.stdin is not None  # noqa: S101 - it is a pipe
    with suppress(BrokenPipeError):  # it was killed: the next run starts another
        guardian.stdin.write(f"{line}\n")
        guardian.stdin.flush()


def unpause_from_elsewhere(
    robot: str, namespace: str, unpause: Demand, timeout: float, *, signs: Sequence[str] = ()
) -> None:
    """Call the service that lets a simulator go on, in a process that ends with it.

    Args:
        robot: how its graph is reached, as a config names it.
        namespace: of the robot.
        unpause: the service.
        timeout: how long it may take to answer, s.
        signs: topics that it publishes, where it may have ended: one that is not there is not left paused.

    Raises:
        LinkError: it was not called; it says why.
    """
    told = _told(robot, namespace, unpause, timeout, signs)
    command = [sys.executable, "-P", "-m", __name__, json.dumps(told)]
    try:
        done = subprocess.run(  # noqa: S603 - our own module
            command, capture_output=True, text=True, timeout=_CONNECTING + timeout, check=False
        )
        reason = done.stderr.strip().splitlines()[-1:] or [f"exit code {done.returncode}"]
        code = done.returncode
    except subprocess.TimeoutExpired:
        reason, code = [f"no answer within {_CONNECTING + timeout:g} s"], _REFUSED
    if code != 0:
        raise LinkError(
            f"the simulator could not be told to go on: {reason[0]}",
            where=f"robot {robot!r}",
            fix=f"Let it go on by hand: call {unpause.services[0]} ({unpause.service_type}).",
        )


def _told(robot: str, namespace: str, unpause: Demand, timeout: float, signs: Sequence[str]) -> dict[str, Any]:
    return {
        "robot": robot,
        "namespace": namespace,
        "services": unpause.services,
        "service_type": unpause.service_type,
        "request": dict(unpause.request),
        "timeout": timeout,
        "signs": list(signs),
    }


def _guard() -> int:
    """Wait for the end of what is told on standard input, and let the simulator go on; end at once where null is told.

    Another process may hold the pipe for longer than whoever says null waits.
    """
    told = None
    for line in sys.stdin:
        if line.endswith("\n"):  # who writes may be killed in the middle of a line
            told = json.loads(line)
            if told is None:
                break
    return 0 if told is None else _let_go_on(told)


def _let_go_on(given: dict[str, Any]) -> int:
    from robot_runner.ros.simulators.simulator_dialects import Demand  # noqa: PLC0415  # only in that process

    _, name = resolved_robot(given["robot"])
    namespace = f"{namespace_prefix(name.namespace)}{namespace_prefix(given['namespace'])}"
    demand = Demand(tuple(given["services"]), given["service_type"], given["request"], lambda _: "")
    try:
        with closing(GRAPH_LINKS[name.link].open(name, SystemClock(), namespace)) as link:
            try:
                demand.meet(link, namespace=namespace, timeout=given["timeout"])
            except LinkError:
                if not given["signs"] or any(link.publishers(full_name(namespace, each)) for each in given["signs"]):
                    raise
    except RobotRunnerError as error:
        sys.stderr.write(f"{error.problem}\n")
        return _REFUSED
    return 0


if __name__ == "__main__":
    sys.exit(_guard() if sys.argv[1] == _GUARD else _let_go_on(json.loads(sys.argv[1])))
