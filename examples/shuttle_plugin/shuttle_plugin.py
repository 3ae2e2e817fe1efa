from typing import Any

from robot_runner.plugins import Circumstances, Finding, LinkError, Measure, RobotRunnerContext, System, connect_robot

TWIST, ODOMETRY = "geometry_msgs/Twist", "nav_msgs/Odometry"


class Shuttle(System):
    """Drives a robot straight ahead and back again."""

    measures = (Measure("Reach", "m", "How far the robot was away from where it began, by odometry."),)
    needs = "A robot that subscribes velocity commands and publishes its odometry."

    def __init__(
        self, *, distance: float = 0.5, speed: float = 0.1, namespace: str = "", name: str | None = None
    ) -> None:
        super().__init__(name=name)
        self.distance, self.speed, self.namespace = distance, speed, namespace

    def check(self, circumstances: Circumstances) -> list[Finding]:
        return [] if circumstances.robot else [Finding.error(self.name, "no robot is named", "Say robot = 'ros1'.")]

    def start_run(self, context: RobotRunnerContext) -> None:
        self.link, self.x, self.is_located = connect_robot(context, namespace=self.namespace), 0.0, False
        self.link.subscribe("odom", ODOMETRY, self.locate)

    def locate(self, message: Any) -> None:
        self.x, self.is_located = message["pose"]["pose"]["position"]["x"], True

    def launch_mission(self, context: RobotRunnerContext) -> None:
        context.clock.sleep(1.0)
        if not self.is_located:
            raise LinkError("no odometry came within 1 s", where=self.name, fix="Start the robot's drivers.")
        begin = self.x
        self.drive(context, self.speed, begin + self.distance)
        context.publish("Reach", abs(self.x - begin))
        self.drive(context, -self.speed, begin)

    def drive(self, context: RobotRunnerContext, speed: float, goal: float) -> None:
        end = context.clock.now() + 3 * self.distance / abs(speed)
        while (goal - self.x) * speed > 0 and context.clock.now() < end:
            self.link.publish("cmd_vel", TWIST, {"linear": {"x": speed}})
            context.clock.sleep(0.05)
        self.make_safe(context)

    def make_safe(self, context: RobotRunnerContext) -> None:
        connect_robot(context, namespace=self.namespace).publish("cmd_vel", TWIST, {})
