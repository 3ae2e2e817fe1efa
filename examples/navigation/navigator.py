"""A small navigation stack: the action server `navigate_to_pose`, as Nav2 offers it, for a robot with a laser scanner.

    python navigator.py --robot dds:domain=7 --planner astar

It prints "ready" once goals can be sent, and goes on until it is ended.
"""

from __future__ import annotations

import argparse
import math
import signal
import sys
import threading

from planners import PLANNERS, Place

from robot_runner.plugins import ActionAborted, ActionCanceled, open_robot

#: How often the robot is steered, 1/s, how fast it drives, m/s, and turns, rad/s.
RATE, SPEED, TURN_RATE = 10.0, 0.2, 1.5
#: How near the goal is near enough, m.
NEAR = 0.08
#: How long it looks for a way on before it turns on the spot to see more, s, and how often before it gives up.
PATIENCE, MOST_RECOVERIES = 1.0, 3
TWIST = "geometry_msgs/Twist"


class Navigator:
    """Knows where the robot is and what is around it, and brings it to a goal."""

    def __init__(self, link, clock, planner):
        self.link, self.clock = link, clock
        self.new_planner = PLANNERS[planner]
        self.place, self.scan = None, None
        link.subscribe("odom", "nav_msgs/Odometry", self.take_odometry)
        link.subscribe("scan", "sensor_msgs/LaserScan", self.take_scan)

    def take_odometry(self, message):
        pose = message["pose"]["pose"]
        turn = pose["orientation"]
        heading = 2 * math.atan2(turn["z"], turn["w"])
        self.place = Place(pose["position"]["x"], pose["position"]["y"], heading)

    def take_scan(self, message):
        self.scan = message

    def obstacles(self, reach=2.0):
        """Return the points that the last scan shows, in the frame of the odometry."""
        here, scan = self.place, self.scan
        if here is None or scan is None:
            return []
        angles = (scan["angle_min"] + number * scan["angle_increment"] for number in range(len(scan["ranges"])))
        return [
            (here.x + far * math.cos(here.heading + angle), here.y + far * math.sin(here.heading + angle))
            for angle, far in zip(angles, scan["ranges"], strict=True)
            if scan["range_min"] <= far <= min(reach, scan["range_max"])
        ]

    def drive(self, speed, rate):
        self.link.publish("cmd_vel", TWIST, {"linear": {"x": speed}, "angular": {"z": rate}})

    def navigate(self, execution):
        """Execute one goal of the action."""
        position = execution.goal["pose"]["pose"]["position"]
        goal, planner = Place(position["x"], position["y"]), self.new_planner()
        begun, stuck_since, recoveries = self.clock.now(), None, 0
        try:
            while self.place is None or self.place.to(goal) > NEAR:
                if execution.is_cancel_requested:
                    raise ActionCanceled
                point = None
                if self.place is not None and self.scan is not None:
                    point = planner.next_point(self.place, goal, self.obstacles())
                if point is not None:
                    stuck_since = None
                    self.steer_for(point)
                elif stuck_since is None:
                    stuck_since = self.clock.now()
                    self.drive(0.0, 0.0)
                elif self.clock.now() - stuck_since > PATIENCE:
                    recoveries, stuck_since = recoveries + 1, None
                    if recoveries > MOST_RECOVERIES:
                        raise ActionAborted("no way to the goal is known")
                    self.turn_away(execution)
                execution.feedback(self.progress(goal, begun, recoveries))
                self.clock.sleep(1 / RATE)
        finally:
            self.drive(0.0, 0.0)
        return {}

    def steer_for(self, point):
        off = math.remainder(math.atan2(point.y - self.place.y, point.x - self.place.x) - self.place.heading, math.tau)
        rate = max(-TURN_RATE, min(TURN_RATE, 2 * off))
        self.drive(SPEED * max(0.0, math.cos(off)) ** 2 if abs(off) < math.pi / 3 else 0.0, rate)

    def turn_away(self, execution):
        """Turn on the spot for a second, to see something else."""
        end = self.clock.now() + 1.0
        while self.clock.now() < end and not execution.is_cancel_requested:
            self.drive(0.0, TURN_RATE)
            self.clock.sleep(1 / RATE)

    def progress(self, goal, begun, recoveries):
        left = math.inf if self.place is None else self.place.to(goal)
        seconds, rest = divmod(self.clock.now() - begun, 1.0)
        return {
            "distance_remaining": min(left, 1e6),
            "number_of_recoveries": recoveries,
            "navigation_time": {"sec": int(seconds), "nanosec": int(rest * 1e9)},
        }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robot", default="dds", help="as in a config: ros1, ros2, dds:domain=7")
    parser.add_argument("--planner", choices=sorted(PLANNERS), default="astar")
    words = parser.parse_args()
    is_over = threading.Event()

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: is_over.set())
    with open_robot(words.robot) as (link, clock):
        navigator = Navigator(link, clock, words.planner)
        link.offer_action("navigate_to_pose", "nav2_msgs/NavigateToPose", navigator.navigate)
        print("ready", flush=True)
        is_over.wait()
    return 0


if __name__ == "__main__":
    sys.exit(main())
