"""A node that answers as a simulator does by its documented services, and what it may do wrong."""

from __future__ import annotations

import math
import threading
import time
from contextlib import ExitStack

__all__ = ["FaithfulSimulator"]

_TICK = 0.01


class FaithfulSimulator:
    """Says its time and where its robot stands a hundred times a second, from a thread, and offers the services.

    Args:
        link: to the graph; stays the caller's.
        simulator: whose services it offers, by the name in a config.
        pace: simulated seconds a real second.
        faults: of `keeps pose`, `keeps time`, `time back`, `refuses`, `mute`.

    Attributes:
        x: where the robot is, m.
        time: the simulated time, s.
        is_paused: whether it stands still.
        told: which services were called, in order.
    """

    def __init__(self, link, simulator, *, pace=1.0, faults=()):
        self._link = link
        self._pace = pace
        self._faults = set(faults)
        self._closing = ExitStack()
        self.x, self.yaw, self.time = 1.5, 0.4, 100.0
        self.is_paused = False
        self.told = []
        for service, kind, answer in getattr(self, f"_{simulator}")():
            self._closing.callback(link.offer(service, kind, answer).close)
        self._is_over = threading.Event()
        self._thread = threading.Thread(target=self._live, daemon=True)
        self._thread.start()

    def close(self):
        self._is_over.set()
        self._thread.join()
        self._closing.close()

    def _live(self):
        before = time.monotonic()
        while not self._is_over.wait(_TICK):
            now = time.monotonic()
            if not self.is_paused:
                self.time += (now - before) * self._pace
                self._say()
            before = now

    def _say(self):
        whole = int(self.time)
        stamp = {"sec": whole, "nanosec": int((self.time - whole) * 1e9)}
        self._link.publish("/clock", "rosgraph_msgs/Clock", {"clock": stamp})
        if "mute" not in self._faults:
            turned = {"z": math.sin(self.yaw / 2), "w": math.cos(self.yaw / 2)}
            pose = {"position": {"x": self.x}, "orientation": turned}
            self._link.publish("odom", "nav_msgs/Odometry", {"header": {"stamp": stamp}, "pose": {"pose": pose}})

    def reset(self, *, pose=True, time=False):
        self.told.append("reset")
        if pose and "keeps pose" not in self._faults:
            self.x = self.yaw = 0.0
        if (time and "keeps time" not in self._faults) or "time back" in self._faults:
            self.time = 0.0

    def pause(self, is_paused):
        self.told.append("pause" if is_paused else "unpause")
        self.is_paused = is_paused

    def place(self, pose):
        self.told.append("place")
        self.x = pose["position"]["x"]
        self.yaw = 2 * math.atan2(pose["orientation"]["z"], pose["orientation"]["w"])

    # The services of each simulator, as it documents them.

    def _gazebo_classic_ros2(self):
        def done(act):
            return lambda request: act() or {}

        def place(request):
            self.place(request["state"]["pose"])
            return {"success": request["state"]["name"] == "burger"}

        return [
            ("/reset_world", "std_srvs/Empty", done(self.reset)),
            ("/reset_simulation", "std_srvs/Empty", done(lambda: self.reset(time=True))),
            ("/pause_physics", "std_srvs/Empty", done(lambda: self.pause(True))),
            ("/unpause_physics", "std_srvs/Empty", done(lambda: self.pause(False))),
            ("/demo/set_entity_state", "gazebo_msgs/SetEntityState", place),
        ]

    def _gz(self):
        def control(request):
            wanted = request["world_control"]
            if wanted["reset"]["all"] or wanted["reset"]["model_only"]:
                self.reset(time=wanted["reset"]["all"])
            else:
                self.pause(wanted["pause"])
            return {"success": "refuses" not in self._faults}

        def place(request):
            self.place(request["pose"])
            return {"success": request["entity"]["name"] == "burger"}

        return [
            ("/world/maze/control", "ros_gz_interfaces/ControlWorld", control),
            ("/world/maze/set_pose", "ros_gz_interfaces/SetEntityPose", place),
        ]

    def _isaac(self):
        def result():
            refused = "refuses" in self._faults
            return {"result": {"result": 3 if refused else 1, "error_message": "not now" if refused else ""}}

        def reset(request):
            self.reset(time=request["scope"] in {0, 255} or bool(request["scope"] & 1))
            return result()

        def state(request):
            self.pause(request["state"]["state"] == 2)
            return result()

        return [
            ("/reset_simulation", "simulation_interfaces/ResetSimulation", reset),
            ("/set_simulation_state", "simulation_interfaces/SetSimulationState", state),
        ]

    def _webots(self):
        def reset(request):
            self.reset(time=True)
            return {"value": request["ask"]}

        def mode(request):
            self.pause(request["value"] == 0)
            return {"success": True}

        return [
            ("/supervisor/simulation_reset", "webots_ros/get_bool", reset),
            ("/supervisor/simulation_set_mode", "webots_ros/set_int", mode),
        ]
