"""Draw what the embedded robot's lidar sees in a room with obstacles: `draw_scan.py docs/images/scan.svg`."""

from __future__ import annotations

import math
import sys
from pathlib import Path

from robot_runner.simulator.room_file import room_of
from robot_runner.simulator.rooms import Cylinder, Obstacle, Pose
from robot_runner.simulator.simulated_turtlebot3 import Simulation

#: The room of docs/simulator-rooms.md, with a second robot.
ROOM = {
    "wall": [
        {"from": [-1.0, 1.5], "to": [4.0, 1.5]},
        {"from": [-1.0, -1.5], "to": [4.0, -1.5], "thickness": 0.2},
    ],
    "box": [{"at": [1.5, 0.3], "size": [0.4, 0.2], "yaw": 0.5}],
    "cylinder": [{"at": [2.5, -0.4], "radius": 0.15}],
    "robot": [{"namespace": "/alice", "at": [0.0, 0.0]}, {"namespace": "/bob", "at": [0.6, -0.8], "yaw": 1.2}],
}
#: Pixels a metre, and the corner of the drawing in the room, m.
_SCALE, _LEFT, _TOP, _WIDTH, _HEIGHT = 150, -1.25, 1.75, 5.5, 3.5
_SCANNER = -0.032  # m before the axle
_STYLE = """
  <style>
    .wall { fill: #9eadc0; } .robot { fill: #1f5f8b; } .ray { stroke: #e0a13c; stroke-width: .6; opacity: .35; }
    .hit { fill: #b3441e; } text { fill: #1c2733; font-size: 14px; }
  </style>"""


def main() -> None:
    """Simulate a scan, and draw it."""
    room = room_of(ROOM, where="draw_scan.py")
    simulation = Simulation(seed=1, room=room)
    scans: list[dict[str, list[float]]] = []
    alice, bob = simulation.turtlebot3("/alice"), simulation.turtlebot3("/bob")
    alice.topics["scan"].listen(scans.append)
    simulation.clock.sleep(0.5)
    parts = [_obstacle(each) for each in room.obstacles]
    parts += [*_rays(alice.pose, scans[-1]["ranges"]), _robot(alice.pose, "alice"), _robot(bob.pose, "bob")]
    label = "A scan of the embedded robot: rays end at walls, a box, a cylinder and another robot."
    size = f"{_WIDTH * _SCALE:.0f} {_HEIGHT * _SCALE:.0f}"
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {size}" font-family="sans-serif" role="img" '
    background = '  <rect width="100%" height="100%" rx="8" fill="#fff"/>'
    lines = [f'{head}aria-label="{label}">{_STYLE}', background, *parts, "</svg>"]
    Path(sys.argv[1]).write_text("\n".join(lines) + "\n", encoding="utf-8")


def _place(x: float, y: float) -> str:
    return f"{(x - _LEFT) * _SCALE:.1f} {(_TOP - y) * _SCALE:.1f}"


def _obstacle(obstacle: Obstacle) -> str:
    if isinstance(obstacle, Cylinder):
        x, y = _place(obstacle.x, obstacle.y).split()
        return f'  <circle class="wall" cx="{x}" cy="{y}" r="{obstacle.radius * _SCALE:.1f}"/>'
    width, height = 2 * obstacle.half_x * _SCALE, 2 * obstacle.half_y * _SCALE
    at = f'transform="translate({_place(obstacle.x, obstacle.y)}) rotate({-math.degrees(obstacle.yaw):.2f})"'
    box = f'x="{-width / 2:.1f}" y="{-height / 2:.1f}" width="{width:.1f}" height="{height:.1f}"'
    return f'  <rect class="wall" {box} {at}/>'


def _robot(pose: Pose, name: str) -> str:
    at = f"translate({_place(pose.x, pose.y)}) rotate({-math.degrees(pose.yaw):.2f})"
    return f'  <path class="robot" d="M6 0 L-15 13 V-13 z" transform="{at}"><title>{name}</title></path>'


def _rays(pose: Pose, ranges: list[float]) -> list[str]:
    x, y = pose.x + _SCANNER * math.cos(pose.yaw), pose.y + _SCANNER * math.sin(pose.yaw)
    hits = [
        (
            x + distance * math.cos(pose.yaw + math.radians(angle)),
            y + distance * math.sin(pose.yaw + math.radians(angle)),
        )
        for angle, distance in enumerate(ranges)
        if math.isfinite(distance)
    ]
    rays = " ".join(f"M{_place(x, y)} L{_place(*hit)}" for hit in hits)
    dots = []
    for hit in hits:
        across, down = _place(*hit).split()
        dots.append(f'  <circle class="hit" cx="{across}" cy="{down}" r="2"/>')
    return [f'  <path class="ray" d="{rays}"/>', *dots]


if __name__ == "__main__":
    main()
