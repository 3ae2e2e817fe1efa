"""Unpauses a simulator from a separate process: for the orchestrator, which must start no threads, or after its end."""

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

#: The timeout for importing a client library and finding the simulator, s.
_CONNECTING = 20.0
_REFUSED = 3
#: How long a guardian may take to end, s.
_ENDING = 5.0
_GUARD = "guard"


#: Our guardians, by robot and namespace; global, as a plugin with bound parameters is built again for each run.
_guardians: dict[tuple[str, str], subprocess.Popen[str]] = {}


def guard_pauses(robot: str, namespace: str, unpause: Demand, timeout: float, *, signs: Sequence[str] = ()) -> None:
    """Start a guardian process that unpauses the simulator if this process dies.

    The guardian reads from a pipe, which the processes of a run have open as well: it acts once all of them are gone.
    Another call replaces the service. The arguments are those of `unpause_from_elsewhere`.
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
            start_new_session=True,  # Ctrl-C in a terminal must not end it
        )
    _tell(guardian, told)


def guard_pauses_no_more(robot: str, namespace: str) -> None:
    """End the guardian of a simulator, which is not paused."""
    if (guardian := _guardians.pop((robot, namespace), None)) is not None:
        _tell(guardian, json.dumps(None))
        with suppress(BrokenPipeError, subprocess.TimeoutExpired):  # the guardian will end, as it has been told to
            guardian.communicate(timeout=_ENDING)


def _tell(guardian: subprocess.Popen[str], line: str) -> None:
    assert guardian.stdin is not None  # noqa: S101 - it is a pipe
    with suppress(BrokenPipeError):  # it was killed: the next run starts another
        guardian.stdin.write(f"{line}\n")
        guardian.stdin.flush()


def unpause_from_elsewhere(
    robot: str, namespace: str, unpause: Demand, timeout: float, *, signs: Sequence[str] = ()
) -> None:
    """Call the service that unpauses a simulator, in a process that ends afterwards; `timeout` is for its answer, s.

    The graph of the robot is reached as a config names it. `signs` are topics of the simulator, where it may have
    ended: without them, there is nothing to unpause.

    Raises:
        LinkError: the service was not called; the message says why.
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
        fix = f"Let it go on by hand: call {unpause.services[0]} ({unpause.service_type})."
        raise LinkError(f"the simulator could not be told to go on: {reason[0]}", where=f"robot {robot!r}", fix=fix)


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
    """Wait for the end of standard input, then unpause the simulator; return at once after a line `null`.

    Closing the pipe is not enough to end the guardian, as other processes may have it open.
    """
    told = None
    for line in sys.stdin:
        if line.endswith("\n"):  # the writer may be killed in the middle of a line
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
