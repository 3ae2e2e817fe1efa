"""Claims of real robots that callbacks command by themselves (`open_robot`), which nobody has claimed beforehand.

Runs, experiments and users are kept from each other's robots by the locks of `claim_locks`. A claim is taken before the
first velocity is commanded, or the first goal sent: who only looks at a robot, a camera or a world is in nobody's way.
Nor is a notebook or a program of one's own: outside of an experiment, nothing is claimed.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

from robot_runner.core.errors import ExecutionError, Finding, LinkError
from robot_runner.core.links.graph_names import namespace_prefix
from robot_runner.core.storage.claim_locks import HeldClaims


class RobotClaims:
    """Takes the claims of robots for an experiment in this process, or for one run of it. A context manager.

    Args:
        experiment: its name, for those that are refused.
        folder: its folder, likewise.
        claimed: returns what was claimed beforehand: these robots are not in its way.
        declared: what the config says of its own callbacks (`claims`), for the advice.
        goes_on: as for `HeldClaims`.
        tell: takes a finding where others cannot be kept out.
        is_run: whether a claim is held until this ends, as a robot may be left in any state; else until the links that
            command the robot are closed.
    """

    def __init__(
        self,
        experiment: str,
        folder: Path,
        *,
        claimed: Callable[[], Collection[str]],
        declared: Sequence[str],
        goes_on: Callable[[Path], bool],
        tell: Callable[[Finding], object],
        is_run: bool = False,
    ) -> None:
        self._experiment = experiment
        self._folder = folder
        self._claimed = claimed
        self._declared = declared
        self._goes_on = goes_on
        self._tell = tell
        self._is_run = is_run
        self._outer: RobotClaims | None = None
        self._held: dict[str, ExitStack] = {}
        self._taking = threading.RLock()

    def __enter__(self) -> None:
        global _of_process
        self._outer, _of_process = _of_process, self

    def __exit__(self, *raised: object) -> None:
        global _of_process  # noqa: PLW0603 - as a process executes one run at a time: `open_robot` has no context
        _of_process = self._outer
        _links[:] = [each for each in _links if each.holder is not self]  # a callback may have left one open
        self._let_go(())

    @property
    def held(self) -> frozenset[str]:
        """The claims that are held now, those of the process that has forked this one included."""
        return frozenset(self._held).union(_inherited if self._outer is None else self._outer.held)

    def take(self, claim: str, links: Collection[_Link], robot: str) -> None:
        """Hold the claim of a robot that these links command, unless one is held that includes it.

        Raises:
            LinkError: another run, experiment or user has it.
        """
        with self._taking:
            known = frozenset(robots_of_callbacks()).union(self._claimed())
            if not is_included(claim, known):
                holding = HeldClaims([claim], self._experiment, self._folder, None, self._goes_on, known)
                held = ExitStack()
                try:
                    held.enter_context(holding)
                except ExecutionError as error:
                    raise self._refusal(claim, robot, error) from error
                self._held[claim] = held
                for finding in holding.findings:
                    self._tell(finding)
            for each in links:
                each.needs.update(own for own in self._held if is_included(claim, [own]))

    def let_go_of_closed(self) -> None:
        """Release what no open link needs any more; a run releases nothing before it ends."""
        if not self._is_run:
            self._let_go({claim for each in [*_links] for claim in each.needs})

    def _let_go(self, needed: Collection[str]) -> None:
        with self._taking, ExitStack() as closing:
            for claim in [each for each in self._held if each not in needed]:
                closing.push(self._held.pop(claim))

    def _refusal(self, claim: str, robot: str, error: ExecutionError) -> LinkError:
        problem = "; ".join(finding.problem for finding in error.findings)
        fix = f"Name it in the config: claims = {[*self._declared, claim]!r}. Then its runs wait for each other, and "
        fix += "the experiment is refused, or waits (`run --wait`), as long as another one has the robot."
        if not problem.startswith(f"{claim} is in use"):
            fix += " If it is another robot of that graph, name it by its namespace."
        return LinkError(problem, where=f"open_robot({robot!r})", fix=fix)


@dataclass(slots=True, eq=False)
class _Link:
    """A link of `open_robot`: the robot as it was named, its graph and namespace, and the claims that it needs."""

    holder: RobotClaims
    robot: str
    graph: str
    claim: str
    namespace: str
    needs: set[str] = field(default_factory=set)


def is_included(claim: str, claims: Iterable[str]) -> bool:
    """Return whether one of the claims is the same, or about the whole graph of that robot.

    Example:
        >>> [is_included(each, ["robot:domain 0/alice"]) for each in ("robot:domain 0", "robot:domain 0/alice/arm")]
        [False, True]
    """
    return any(claim == each or claim.startswith(f"{each}/") for each in claims)


_of_process: RobotClaims | None = None
#: Those of the orchestrator, in a fresh interpreter.
_inherited: set[str] = set()
#: The links of `open_robot` that are open in this process.
_links: list[_Link] = []
os.register_at_fork(after_in_child=_links.clear)


def robots_of_callbacks() -> list[str]:
    """Return the claims that callbacks hold in this process now, for a fresh interpreter to inherit."""
    return [] if _of_process is None else sorted(_of_process.held)


def inherit_robots(claims: Iterable[str]) -> None:
    """Remember the claims that the process holds which this one was started by."""
    _inherited.update(claims)


@contextmanager
def claiming_if_commanded(robot: str, graph: str, identifier: str, namespace: str) -> Iterator[None]:
    """Have `claim_commanded` claim what is commanded over a link to a robot, which is opened and closed in the block.

    Args:
        robot: as it was named.
        graph: how its graph is reached, as in `Commanded`.
        identifier: what identifies its graph, however it is reached.
        namespace: the robot's; empty for a link to the whole graph.
    """
    if _of_process is None:  # outside of an experiment
        yield
        return
    link = _Link(_of_process, robot, graph, f"robot:{identifier}", namespace_prefix(namespace))
    _links.append(link)
    try:
        yield
    finally:
        with suppress(ValueError):  # closed after its run, or the experiment, has ended
            _links.remove(link)
        link.holder.let_go_of_closed()


def claim_commanded(topic: str, graph: str) -> None:
    """Claim the robot that is about to be commanded on a topic or by an action, if by a link of `open_robot`.

    Of a link to a whole graph, it is the one in whose namespace the topic is; so it is where an absolute name leads out
    of the namespaces of all links.

    Raises:
        LinkError: another run, experiment or user has it.
    """
    on_graph, namespace = [each for each in [*_links] if each.graph == graph], topic.rpartition("/")[0]
    within = [each for each in on_graph if topic.startswith(f"{each.namespace}/")]
    if links := within or (on_graph if namespace else []):
        nearest = max(links, key=lambda link: len(link.namespace))
        claim = f"{nearest.claim}{(within and nearest.namespace) or namespace}"
        nearest.holder.take(claim, links, nearest.robot)
