"""Lets a simulator go on from a process of its own, for the orchestrator, which may start no threads."""

from __future__ import annotations

import json
import subprocess
import sys
from contextlib import closing
from typing import TYPE_CHECKING

from robot_runner.core.errors import LinkError, RobotRunnerError
from robot_runner.core.events.context import SystemClock
from robot_runner.core.links.graph_names import full_name
from robot_runner.core.links.robot import RobotName
from robot_runner.ros.graph_links import GRAPH_LINKS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from robot_runner.ros.simulators.simulator_dialects import Demand

__all__ = ["unpause_from_elsewhere"]

#: How long a client library may take to be imported and to find the simulator, s.
_CONNECTING = 20.0
_REFUSED = 3


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
    told = {
        "robot": robot,
        "namespace": namespace,
        "services": unpause.services,
        "service_type": unpause.service_type,
        "request": dict(unpause.request),
        "timeout": timeout,
        "signs": list(signs),
    }
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


def _main(told: str) -> int:
    from robot_runner.ros.simulators.simulator_dialects import Demand  # noqa: PLC0415  # only in that process

    given = json.loads(told)
    name = RobotName.parse(given["robot"])
    name = name.on_graph if name.address and name.link != "rosbridge" else name
    namespace = given["namespace"] or name.namespace
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
    sys.exit(_main(sys.argv[1]))
