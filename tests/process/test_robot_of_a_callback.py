"""A robot that a callback reaches by itself, as the config does not name it: whatever dies, it stands still."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import pytest
from tests.conftest import HEAD, TABLE
from tests.process.conftest import kill_together
from tests.process.graph_simulation import simulated_robot, witness
from tests.process.test_real_graphs import DOOMED, until_it_drives
from tests.ros.dds_domain import claim_domain
from tests.ros.real_graph import over, over_pairs
from tests.ros.ros1_master import RUDE

if TYPE_CHECKING:
    from pathlib import Path

pytestmark = [*map(pytest.mark.filterwarnings, RUDE)]

Start = Callable[..., Any]

BODY = """\
    robot = {own!r}

    def launch_mission(self, context):
        with open_robot({elsewhere!r}) as (link, clock):
            while not (HERE / "enough").exists():
                link.publish("/ida/cmd_vel", "geometry_msgs/Twist", {{"linear": {{"x": 0.2}}}})
                clock.sleep(0.05)
"""


def written(write_config: Callable[..., Path], own: str | None, elsewhere: str) -> Path:
    imports = "import open_robot\n\nHERE = Path(__file__).parent"
    head = HEAD.replace("import *\n", f"import *\nfrom robot_runner.plugins {imports}\n", 1)
    table = TABLE.replace("repetitions=2", "repetitions=1").replace('["Video", "Network"]', "[1]")
    return write_config(BODY.format(own=own, elsewhere=elsewhere), head=head, table=table.replace('["Energy"]', "[]"))


#: The robot that the config names, and who is killed.
CASES = [
    (None, "the run and its keeper"),
    ("simulated", "the run and the orchestrator"),
    ("another one", "the run"),
]


@pytest.mark.long
@over_pairs("case", CASES, "dds", "ros1", "ros2")
def test_it_stands_still_whoever_is_killed_with_its_run(
    graph: str, start: Start, write_config: Callable[..., Path], case: tuple[str | None, str]
) -> None:
    """The process that stands by looked for its topic on the graph of the run's own robot, if there was one at all."""
    own, doomed = case
    config = written(write_config, f"dds:domain={claim_domain()}" if own == "another one" else own, graph)
    with simulated_robot(graph, "--namespace", "/ida", "--no-watchdog"), witness(graph, "/ida") as looking:
        experiment = start(config=config)
        until_it_drives(graph, looking, since=0.0)
        pids, killed = DOOMED[doomed](experiment), time.time()
        kill_together(pids)
        looking.sees_standstill(since=killed)
        if experiment.process.pid in pids:
            experiment.end()
        else:
            assert experiment.end() == 1
            said = "the run died before it had made the robot safe; the process that stood by for this did it"
            assert said in " ".join(experiment.output.split())
            assert "as far as it could" not in experiment.output
        assert experiment.nobody_is_left()


@pytest.mark.long
@over("dds", soak=["ros1", "ros2"])
def test_where_all_three_are_killed_the_next_execution_stops_it_before_anything_else(
    graph: str, start: Start, write_config: Callable[..., Path]
) -> None:
    config = written(write_config, None, graph)
    with simulated_robot(graph, "--namespace", "/ida", "--no-watchdog"), witness(graph, "/ida") as looking:
        experiment = start(config=config)
        until_it_drives(graph, looking, since=0.0)
        kill_together(DOOMED["all three"](experiment))
        experiment.end()
        assert experiment.nobody_is_left()
        looking.sees(0.19, since=time.time())
        (config.parent / "enough").touch()
        restarted, again = time.time(), start(config=config)
        assert again.end() == 0, again.output
        assert (
            f"killed in r_1 ({graph}), and no process was left to make its systems safe; that was done now"
            in " ".join(again.output.split())
        )
        looking.sees_standstill(since=restarted)
