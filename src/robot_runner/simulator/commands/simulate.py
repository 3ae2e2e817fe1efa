"""Offer the embedded robot on a ROS graph, as if it were a real one.

Whatever runs on the graph (an experiment with robot = 'ros1' or 'dds', rviz, your own nodes) finds a TurtleBot3 Burger
there: its topics, the services of its tasks, its watchdog. Its power meter is opened as a serial port. A line "ready"
is printed once all of it is there; Ctrl-C or SIGTERM ends it.
"""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path

from robot_runner.cli.console import output
from robot_runner.cli.parser import Parser, UsageError
from robot_runner.core.errors import LinkError, did_you_mean
from robot_runner.core.execution.interruption import stop_signals_handled
from robot_runner.core.links.connect import SIMULATED, link_findings
from robot_runner.core.words import counted, shown_duration

_ROBOTS = ("turtlebot3",)
_MODEL = ".xml"
_CONVERT = (
    "MuJoCo reads it and saves it as MJCF, to which actuators are to be added: "
    """python -c "import mujoco as m; m.mj_saveLastXML('robot.xml', m.MjModel.from_xml_path('robot.urdf'))"."""
)


def add_arguments(parser: Parser) -> None:
    """Add the command's arguments."""
    parser.add_argument("robot", metavar="ROBOT", help="the robot to offer: turtlebot3, or an MJCF file (robot.xml)")
    parser.add_argument(
        "--link",
        metavar="LINK",
        required=True,
        help="the graph: ros1, ros2, dds or a rosbridge, as robot names it in a config: dds:domain=7, rosbridge://robot",
    )
    parser.add_argument("--namespace", metavar="NAME", default="", help="the namespace of the robot, such as /alice")
    parser.add_argument("--seed", metavar="N", type=int, default=1, help="the seed of its noise; 1 if it is left out")
    parser.add_argument(
        "--room",
        metavar="FILE",
        type=Path,
        help="the room it lives in: a TOML file with walls, boxes, cylinders; a room of 5.5 m x 4 m if it is left out",
    )
    parser.add_argument(
        "--use-sim-time",
        action="store_true",
        help="publish the simulation's time on /clock and stamp messages with it; nodes need use_sim_time",
    )
    parser.add_argument(
        "--real-time-factor",
        metavar="N",
        type=float,
        default=1.0,
        help="simulated seconds a real second; 1 if it is left out, and another needs --use-sim-time",
    )
    parser.add_argument(
        "--camera",
        action="store_true",
        help="have its camera's topics, whose pictures are rendered while a node subscribes; needs EGL or OSMesa",
    )
    parser.add_argument(
        "--no-watchdog",
        action="store_true",
        help="have no watchdog, as a robot on which ours was not installed: it carries out its last command for ever",
    )


def execute(arguments: Namespace) -> int:
    """Offer the robot on the graph until the command is stopped."""
    model = Path(arguments.robot) if arguments.robot.endswith(_MODEL) else None
    if model is None and arguments.robot not in _ROBOTS:
        is_urdf = arguments.robot.endswith(".urdf")
        fix = _CONVERT if is_urdf else f"{did_you_mean(arguments.robot, _ROBOTS)} An MJCF file ends in {_MODEL}."
        raise UsageError(f"there is no simulated {arguments.robot!r}", where="robot-runner simulate", fix=fix)
    LinkError.refuse(link_findings(SIMULATED))
    from robot_runner.simulator.graph_robot import SimulatedPlace  # noqa: PLC0415 - an extra
    from robot_runner.simulator.graph_simulation import check_pace, on_graph  # noqa: PLC0415

    place = SimulatedPlace(
        link=arguments.link,
        namespace=arguments.namespace,
        seed=arguments.seed,
        real_time_factor=arguments.real_time_factor,
        is_clock=arguments.use_sim_time,
        has_watchdog=not arguments.no_watchdog,
        room=arguments.room,
        model=model,
        has_camera=arguments.camera,
    )
    check_pace(place)
    console = output()
    signals: list[int] = []  # to end, noted instead of breaking off what is being done
    with stop_signals_handled(lambda number, _: signals.append(number)), on_graph(place) as simulation:
        for namespace, robot in simulation.robots.items():
            console.print(f"simulated {arguments.robot} on {arguments.link}, namespace {namespace or '/'}")
            if robot.meter is not None:
                console.print(f"power meter: {robot.meter.port}")
        console.print("ready")
        console.file.flush()
        simulation.live(is_over=lambda: bool(signals))
    console.print(f"ended after {shown_duration(simulation.now)} of the robot's time")
    if simulation.lags:
        lags = counted(simulation.lags, "time")
        console.print(f"the simulated robot could not keep its pace {lags}: this machine is too busy")
    return 0
