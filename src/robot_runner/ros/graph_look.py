"""Check before anything is executed whether a robot's graph has what plugins need.

The check has a process of its own, because the libraries of ROS and DDS start threads, which the process that forks
runs must not have. It publishes, calls and moves nothing.
"""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import asdict, replace
from typing import Any

from robot_runner.core.errors import Finding, LinkError, Severity, nearest
from robot_runner.core.events.context import SystemClock
from robot_runner.core.links.graph_names import GraphNeed, GraphPart
from robot_runner.core.links.robot import GraphListing, RobotLink
from robot_runner.core.links.robot_name import RobotName
from robot_runner.core.words import enumerated
from robot_runner.ros.graph_link import GraphLink
from robot_runner.ros.graph_links import GRAPH_LINKS, clock_fix
from robot_runner.ros.graph_transport import LONGEST_DISCOVERY
from robot_runner.ros.parameter_access import ServerParameters, parameters_of
from robot_runner.ros.parameter_values import from_json
from robot_runner.ros.robot_system import misfits
from robot_runner.ros.shapes import plain_type
from robot_runner.ros.sole_control import (
    is_told,
    named,
    rival_findings,
    sole_publisher_findings,
    subscriber_type_findings,
)

#: The timeout of the whole check, s: on a laptop, importing a client library and joining the graph takes one or two.
_SECONDS = 11.0
#: The timeout for leaving the graph after that, s: Fast DDS leaves its shared memory behind when it is killed.
_LEAVING = 2.0
#: How long discovery may take, s; a ROS 1 master and a rosbridge know their graph at once.
_DISCOVERY = {"ros2": LONGEST_DISCOVERY, "dds": 1.0}
_PERIOD = 0.1
#: Topics of client libraries and of the rosbridge, which are on a graph without any robot.
_INFRASTRUCTURE = frozenset(
    {"/rosout", "/rosout_agg", "/parameter_events", "/client_count", "/connected_clients", "/clock"}
)
_LISTED = 5
#: The timeout for a node's answer about its parameters, s; a check may ask many nodes.
_PARAMETER_SECONDS = 1.5
_SERVICES = frozenset({GraphPart.SERVICE, GraphPart.PARAMETERS})
#: Prefixes of services that are on a graph without any robot: the rosbridge's, and those of this check.
_BRIDGE = ("/rosapi", "/rosbridge", "/robot_runner")
_ROBOT = "robot"


def begin_look(name: RobotName, needs: Mapping[str, Sequence[GraphNeed]]) -> Callable[[], list[Finding]]:
    """Begin the check, and return a function that waits for the findings; see `LooksAtGraph`."""
    asked = {
        "robot": {"link": name.link, "options": dict(name.options), "address": name.address},
        "needs": {where: [asdict(need) for need in wanted] for where, wanted in needs.items()},
    }
    deadline = time.monotonic() + _SECONDS
    try:
        looking = subprocess.Popen(
            [sys.executable, "-P", "-m", "robot_runner.ros.graph_look"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )
    except OSError as error:
        reason = f"no process can be started ({error.strerror})"
        return lambda: [_not_looked_at(reason)]
    assert looking.stdin is not None  # noqa: S101 - it is a pipe
    with suppress(BrokenPipeError), looking.stdin as question:
        json.dump(asked, question)
    looking.stdin = None
    return lambda: _answer(looking, deadline)


def _answer(looking: subprocess.Popen[str], deadline: float) -> list[Finding]:
    try:
        answer, _ = looking.communicate(timeout=max(0.0, deadline - time.monotonic()))
    except subprocess.TimeoutExpired:
        looking.terminate()
        try:
            looking.communicate(timeout=_LEAVING)
        except subprocess.TimeoutExpired:
            looking.kill()
            looking.communicate()
        return [_not_looked_at(f"the graph does not answer within {_SECONDS:g} s")]
    try:  # client libraries may print, too
        told: list[dict[str, Any]] = json.loads(answer.splitlines()[-1])
    except (IndexError, ValueError):
        return [_not_looked_at(f"the process that looks ended with exit code {looking.returncode}")]
    return [Finding(Severity(each.pop("severity")), **each) for each in told]


def _not_looked_at(why: str, fix: str = "") -> Finding:
    problem = f"whether the robot is on the graph was not seen: {why}"
    return Finding.warning(_ROBOT, problem, fix or "Look at the graph yourself before you start.")


def look_at(name: RobotName, needs: Mapping[str, Sequence[GraphNeed]]) -> list[Finding]:
    """Join the graph, check it, and leave it.

    A graph that cannot be joined is an error where anything on it is needed. Whatever else cannot be checked is a
    warning that says why.
    """
    try:
        kind = GRAPH_LINKS[name.link]
        follows = kind.follows_graph_clock(name)
        clock = [GraphNeed.published("/clock", "rosgraph_msgs/Clock", fix=clock_fix(name))] if follows else []
        link = kind.open(name, SystemClock())
    except LinkError as error:
        return [error.as_finding() if needs else _not_looked_at(error.problem, error.fix)]
    wanted = {**needs, **({_ROBOT: clock} if clock else {})}
    with closing(link):
        wrong = list(_misfits(link, needs)) if isinstance(link, GraphLink) else []
        try:
            return [*wrong, *_patiently(link, wanted, _DISCOVERY.get(name.link, 0.0))]
        except LinkError as error:
            return [*wrong, _not_looked_at(error.problem, error.fix)]


def _misfits(link: GraphLink, needs: Mapping[str, Sequence[GraphNeed]]) -> Iterator[Finding]:
    for where, wanted in needs.items():
        for need in wanted:
            yield from misfits(link.check_message, need, where)


def _patiently(link: GraphListing, needs: Mapping[str, Sequence[GraphNeed]], seconds: float) -> list[Finding]:
    """Repeat the check until nothing is missing, for as long as discovery may take."""
    deadline = time.monotonic() + seconds
    while True:
        found = list(_findings(link, needs))
        # Also wait for the robot where nothing of it is needed, and its absence is not an error.
        if not any(each.is_error or each.where == _ROBOT for each in found) or time.monotonic() > deadline:
            return found
        time.sleep(_PERIOD)


def _findings(link: GraphListing, needs: Mapping[str, Sequence[GraphNeed]]) -> Iterator[Finding]:
    if not set(link.topics()) - _INFRASTRUCTURE and not _has_offers(link, needs):
        names = list(dict.fromkeys(need.name for wanted in needs.values() for need in wanted))
        shown = [*names[:_LISTED], *([f"{len(names) - _LISTED} more"] if len(names) > _LISTED else [])]
        problem = "no robot is on the graph: no node publishes or subscribes anything there"
        needed = f", and the plugins need {enumerated(shown)}" if names else ""
        fix = "Start the robot's bringup, and see that this machine is on its graph (domain, master, network)."
        yield (Finding.error if names else Finding.warning)(_ROBOT, problem + needed, fix)
        return
    for where, wanted in needs.items():
        for need in wanted:
            yield from need_findings(link, need, where)


def _has_offers(link: GraphListing, needs: Mapping[str, Sequence[GraphNeed]]) -> bool:
    """Whether services or actions are needed and a robot offers any, which may publish nothing yet."""
    wanted = {need.part for each in needs.values() for need in each}
    if GraphPart.ACTION in wanted and link.actions():
        return True
    return bool(wanted & _SERVICES) and any(not service.startswith(_BRIDGE) for service in link.services())


def need_findings(link: GraphListing, need: GraphNeed, where: str) -> Iterator[Finding]:
    """Yield findings on a need that is missing, of another type, or not alone on a graph; names are full.

    Raises:
        LinkError: the graph does not answer.
    """
    need = replace(need, types=tuple(map(plain_type, need.types)))
    match need.part:
        case GraphPart.PUBLISHED:
            yield from _published(link, need, where)
        case GraphPart.SUBSCRIBED:
            yield from _subscribed(link, need, where)
        case GraphPart.SERVICE:
            yield from offer_findings("service", link.services(), need, where)
        case GraphPart.ACTION:
            yield from offer_findings("action", link.actions(), need, where)
        case GraphPart.PARAMETERS:
            yield from _parameters(link, need, where)


def _published(link: GraphListing, need: GraphNeed, where: str) -> Iterator[Finding]:
    publishers = link.publishers(need.name)
    if not publishers:
        yield _missing(f"no node publishes {need.name!r}", link.topics(), need, where)
        return
    told = {each.message_type for each in publishers if is_told(each.message_type)}
    if need.types and told and not told & set(need.types):
        problem = f"{named(publishers)} publishes {need.name!r} as {enumerated(sorted(told))}, not {_wanted(need)}"
        yield Finding.error(where, problem, need.fix or "Correct the topic or its namespace.")
    if need.is_sole:
        yield from sole_publisher_findings(link, need.name, where)


def _subscribed(link: GraphListing, need: GraphNeed, where: str) -> Iterator[Finding]:
    if not link.subscribers(need.name):
        yield _missing(f"no node subscribes {need.name!r}", link.topics(), need, where)
        return
    if need.types:
        yield from subscriber_type_findings(link, need.name, need.types, where)
    if need.is_sole:
        yield from rival_findings(link, need.name, where)


def _parameters(link: GraphListing, need: GraphNeed, where: str) -> Iterator[Finding]:
    if not isinstance(link, RobotLink):
        return
    # `_patiently` asks a node without services again: waiting here for each would take longer than the whole check may.
    is_seen = any(name.startswith(f"{need.name}/") for name in link.services())
    access = parameters_of(link, timeout=_PARAMETER_SECONDS if is_seen else _PERIOD)
    values = {name: from_json(stored) for name, stored in json.loads(need.values).items()}
    try:
        errors = access.objections(need.name, values)
        doubts = access.doubts(need.name, list(values)) if isinstance(access, ServerParameters) else []
    except LinkError as error:
        errors, doubts = [error], []
    for each in errors:
        yield Finding.error(where, f"{each.where}: {each.problem}", f"{need.fix} {each.fix}".strip())
    for problem, fix in doubts:
        yield Finding.warning(where, problem, fix)


def offer_findings(what: str, offered: Mapping[str, str], need: GraphNeed, where: str) -> Iterator[Finding]:
    """Yield a finding where a `service` or an `action` is missing, or of another type; names are full."""
    if need.name not in offered:
        yield _missing(f"there is no {what} {need.name!r}", offered, need, where)
        return
    true = plain_type(offered[need.name])
    if need.types and is_told(true) and true not in need.types:
        problem = f"the {what} {need.name!r} is of the type {true}, not {_wanted(need)}"
        yield Finding.error(where, problem, need.fix or f"End the node that offers it, or correct the {what}'s name.")


def _missing(problem: str, known: Iterable[str], need: GraphNeed, where: str) -> Finding:
    near = nearest(need.name, [name for name in known if name != need.name])
    guess = f"Did you mean {near!r}?" if near else ""
    return Finding.error(where, problem, " ".join(filter(None, [need.fix, guess])) or "Start the node that has it.")


def _wanted(need: GraphNeed) -> str:
    return " or ".join(need.types)


def _main() -> None:
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # leave the graph when the caller has given up
    asked = json.load(sys.stdin)
    needs = {
        where: [GraphNeed(**{**each, "part": GraphPart(each["part"]), "types": tuple(each["types"])}) for each in some]
        for where, some in asked["needs"].items()
    }
    found = look_at(RobotName(**asked["robot"]), needs)
    sys.stdout.write("\n" + json.dumps([{**asdict(each), "severity": each.severity.value} for each in found]) + "\n")


if __name__ == "__main__":
    _main()
