"""Scripted devices: a computer's utilisation, a serial line, and an ideal robot."""

from __future__ import annotations

import math
from bisect import insort
from collections.abc import Callable, Iterable
from dataclasses import replace

from robot_runner.core.errors import LinkError
from robot_runner.core.events.context import Clock
from robot_runner.core.links.graph_names import full_name
from robot_runner.core.links.robot import Message, Qos
from robot_runner.measuring.host import UtilisationSample
from robot_runner.measuring.serial_line import Chunk
from robot_runner.ros.shapes import plain_type, stamp_of
from robot_runner.ros.watchdog import velocity_of
from robot_runner.testing.fake_robot import Answer, FakeRobotLink
from robot_runner.testing.fake_run import FakeClock

# A computer with scripted utilisation.

#: A constant percentage, or a function of the time on the run's clock.
Utilisation = float | Callable[[float], float]


class _Sampler:
    def __init__(self, link: FakeHostLink, clock: Clock, rate: float) -> None:
        self._link = link
        self._clock = clock
        self._rate = rate
        self._begun = clock.now()
        self._samples: list[UtilisationSample] | None = None

    def stop(self) -> list[UtilisationSample]:
        if self._samples is None:
            count = math.floor((self._clock.now() - self._begun) * self._rate + 1e-9)
            times = (self._begun + number / self._rate for number in range(count + 1))
            self._samples = [self._link.sample_at(time) for time in times if not self._link.misses(time)]
            if self._samples:  # CPU utilisation is that since the sample before
                self._samples[0] = replace(self._samples[0], cpu=None)
        return self._samples


class FakeHostLink:
    """A `HostLink` to a computer with scripted utilisation; the first sample has no CPU, as that of a real one.

    Args:
        clock: the run's.
        cpu: CPU utilisation in percent, a number or a function of time.
        memory: memory utilisation in percent, a number or a function of time.
        misses: returns whether the sample of a time is missing.
        is_simulated: whether it claims to be a simulated computer.

    Attributes:
        is_closed: whether it was closed.
        is_simulated: as given.

    Example:
        >>> from robot_runner.testing import FakeClock, FakeHostLink
        >>> clock = FakeClock()
        >>> sampler = FakeHostLink(clock, cpu=20.0, memory=25.0).sample_utilisation(2)
        >>> clock.sleep(1.0)
        >>> [sample.time for sample in sampler.stop()]
        [0.0, 0.5, 1.0]
    """

    def __init__(
        self,
        clock: Clock,
        *,
        cpu: Utilisation = 10.0,
        memory: Utilisation = 25.0,
        misses: Callable[[float], bool] = lambda _: False,
        is_simulated: bool = False,
    ) -> None:
        self.is_closed = False
        self.misses = misses
        self._clock = clock
        self._cpu = cpu
        self._memory = memory
        self.is_simulated = is_simulated

    def sample_utilisation(self, rate: float) -> _Sampler:
        """Begin to sample; a `LinkError` says that the link was closed."""
        if self.is_closed:
            raise LinkError("the link was closed", where="FakeHostLink", fix="Use it before the run ends.")
        return _Sampler(self, self._clock, rate)

    def sample_at(self, time: float) -> UtilisationSample:
        """Return the sample of a time on the run's clock."""
        return UtilisationSample(time, _value(self._cpu, time), _value(self._memory, time))

    def close(self) -> None:
        """Close the link; closing twice does nothing."""
        self.is_closed = True


def _value(utilisation: Utilisation, time: float) -> float:
    return utilisation(time) if callable(utilisation) else utilisation


class FakeSerialLine:
    """A `SerialLine` on which scripted bytes arrive at their times.

    Args:
        clock: the run's.
        chunks: the bytes that arrive, with times on the clock.
        answer: returns the device's immediate reply to sent bytes; `b""` for none.
        lost_at: when the line is lost, s; reading raises once the bytes from before are drained.
        is_simulated: whether it claims that its device is simulated.

    Attributes:
        written: the bytes that were sent to the device.
        is_closed: whether it was closed.
        is_simulated: as given.

    Example:
        >>> from robot_runner.testing import Chunk, FakeClock, FakeSerialLine
        >>> clock = FakeClock()
        >>> line = FakeSerialLine(clock, [Chunk(1.0, b"hello")])
        >>> line.drain()
        []
        >>> clock.sleep(1.0)
        >>> line.drain()
        [Chunk(received_at=1.0, data=b'hello')]
    """

    def __init__(
        self,
        clock: Clock,
        chunks: Iterable[Chunk] = (),
        *,
        answer: Callable[[bytes], bytes] = lambda _: b"",
        lost_at: float | None = None,
        is_simulated: bool = False,
    ) -> None:
        self.written = bytearray()
        self.is_closed = False
        self._clock = clock
        self._coming = sorted(chunks, key=lambda chunk: chunk.received_at)
        self._answer = answer
        self._lost_at = lost_at
        self.is_simulated = is_simulated

    def drain(self) -> list[Chunk]:
        """Return the chunks that have arrived since the last call; a `LinkError` if closed, or lost and drained."""
        now = self._clock.now() if self._lost_at is None else min(self._clock.now(), self._lost_at)
        arrived = [chunk for chunk in self._coming if chunk.received_at <= now]
        if self.is_closed or not arrived:
            self._check()
        self._coming = self._coming[len(arrived) :]
        return arrived

    def write(self, data: bytes) -> None:
        """Record the sent bytes, and let the device answer; a `LinkError` says that the line was closed or lost."""
        self._check()
        self.written += data
        if reply := self._answer(bytes(data)):
            insort(self._coming, Chunk(self._clock.now(), reply), key=lambda chunk: chunk.received_at)

    def close(self) -> None:
        """Close the line; closing twice does nothing."""
        self.is_closed = True

    def _check(self) -> None:
        is_lost = self._lost_at is not None and self._clock.now() >= self._lost_at
        if self.is_closed or is_lost:
            problem = "the line was closed" if self.is_closed else "the device was unplugged"
            raise LinkError(problem, where="FakeSerialLine", fix="Plug it in again.")


class FakeTurtlebot3Link(FakeRobotLink):
    """A link to an ideal robot: it moves exactly as `cmd_vel` says, and publishes `odom` 30 times a second.

    The services of the three tasks answer; `working_on` is the task in progress.

    Attributes:
        x: its position, m.
        y: its position, m.
        heading: its direction, rad.
        odometry_ends_at: when its odometry falls silent, s.
        slip: the share of each movement, from 0 to 1, that is lost.

    Example:
        >>> from robot_runner.testing import FakeClock
        >>> clock = FakeClock()
        >>> robot = FakeTurtlebot3Link(clock)
        >>> robot.publish("cmd_vel", "geometry_msgs/Twist", {"linear": {"x": 0.1}})
        >>> clock.sleep(3.0)
        >>> round(robot.x, 3), robot.stands_still
        (0.3, False)
    """

    def __init__(self, clock: FakeClock, *, slip: float = 0.0, is_simulated: bool = False) -> None:
        super().__init__(clock, services=self._task_services(), is_simulated=is_simulated)
        self.known_topics = {"cmd_vel": "geometry_msgs/Twist", "odom": "nav_msgs/Odometry"}
        self.x = self.y = self.heading = 0.0
        self.slip = slip
        self.odometry_ends_at = math.inf
        self.working_on: str | None = None
        self._speed = self._rate = 0.0
        self._moved_until = clock.now()
        clock.every(1 / 30, self._tell)

    def publish(self, topic: str, message_type: str, message: Message, *, qos: Qos = Qos.DEFAULT) -> None:
        """Record the message; a velocity command is executed until the next."""
        super().publish(topic, message_type, message, qos=qos)
        if full_name("", topic) == "/cmd_vel":
            self._move()
            twist = velocity_of(plain_type(message_type), message)
            self._speed = float(twist.get("linear", {}).get("x", 0.0)) * (1.0 - self.slip)
            self._rate = float(twist.get("angular", {}).get("z", 0.0)) * (1.0 - self.slip)

    def _task_services(self) -> dict[str, Answer]:
        services: dict[str, Answer] = {"task/stop": self._working_on(None)}
        for task in ("computation", "video", "network"):
            services[f"task/{task}/start"] = self._working_on(task)
            services[f"task/{task}/stop"] = self._working_on(None)
        return services

    def _working_on(self, task: str | None) -> Callable[[Message], Message]:
        def answer(request: Message) -> Message:
            del request
            self.working_on = task
            return {"success": True, "message": ""}

        return answer

    def _move(self) -> None:
        """Execute the last command until now: along a circle, or straight on where it does not turn."""
        seconds, self._moved_until = self._clock.now() - self._moved_until, self._clock.now()
        half = self._rate * seconds / 2
        chord = self._speed * seconds * (math.sin(half) / half if half else 1.0)
        self.x += chord * math.cos(self.heading + half)
        self.y += chord * math.sin(self.heading + half)
        self.heading += 2 * half

    def _tell(self) -> None:
        self._move()
        if self._clock.now() < self.odometry_ends_at:
            velocity = {"linear": _vector(x=self._speed), "angular": _vector(z=self._rate)}
            self.deliver("odom", _odometry(self._clock.now(), self.x, self.y, self.heading, velocity))


def _vector(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Message:
    return {"x": x, "y": y, "z": z}


def _odometry(time: float, x: float, y: float, heading: float, velocity: Message) -> Message:
    turn = {"x": 0.0, "y": 0.0, "z": math.sin(heading / 2), "w": math.cos(heading / 2)}
    return {
        "header": {"stamp": stamp_of(round(time * 1e9)), "frame_id": "odom"},
        "child_frame_id": "base_footprint",
        "pose": {"pose": {"position": _vector(x, y), "orientation": turn}, "covariance": [0.0] * 36},
        "twist": {"twist": velocity, "covariance": [0.0] * 36},
    }
