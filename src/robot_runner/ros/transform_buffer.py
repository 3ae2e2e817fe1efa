"""The tree of coordinate frames that a robot publishes on `/tf` and `/tf_static`, kept for some time and looked up."""

from __future__ import annotations

import bisect
import math
import threading
from collections.abc import Sequence
from contextlib import ExitStack, suppress

from robot_runner.core.errors import Finding, LinkError, did_you_mean
from robot_runner.core.events.context import Clock
from robot_runner.core.links.robot import Message, Qos, Subscriber
from robot_runner.core.words import enumerated
from robot_runner.ros.transforms import IDENTITY, Transform, between

_TYPE = "tf2_msgs/TFMessage"
_WHERE = "tf"
#: How far a stamp may lie before the last one of its frame, s: messages of two nodes overtake each other by tenths; a
#: clock that was reset goes back by more.
_OVERTAKEN = 1.0
#: A quaternion whose length is further from 1 than this is none (tf2 takes 1e-6 in doubles; some nodes send floats).
_UNIT = 1e-3
#: How often a transform is looked for that is awaited, s.
_LOOK = 0.02


class _Branch:
    """What is known of one frame: its parent, and where it was in it."""

    def __init__(self, parent: str, *, is_static: bool) -> None:
        self.parent = parent
        self.is_static = is_static
        self.times: list[float] = []
        self.transforms: list[Transform] = []

    def add(self, time: float, transform: Transform, horizon: float) -> None:
        """Keep a transform, in the order of times; those older than the horizon go."""
        if self.is_static:
            self.times, self.transforms = [time], [transform]
            return
        place = bisect.bisect_left(self.times, time)
        if place < len(self.times) and self.times[place] == time:
            self.transforms[place] = transform
        else:
            self.times.insert(place, time)
            self.transforms.insert(place, transform)
        old = bisect.bisect_left(self.times, self.times[-1] - horizon)
        del self.times[:old], self.transforms[:old]

    def at(self, time: float, frame: str) -> Transform:
        """Return where the frame is in its parent at a time between its first and last transform, interpolated."""
        if self.is_static:
            return self.transforms[0]
        first, last = self.times[0], self.times[-1]
        if not first <= time <= last:
            problem = f"{frame!r} in {self.parent!r} is known from {first:.3f} to {last:.3f} s"
            off = f"{first - time:.3f} s before" if time < first else f"{time - last:.3f} s after"
            fix = "Ask for a time within it, for the last common one (time=None), or wait: wait_for."
            raise LinkError(f"{problem}, and {time:.3f} s is {off} that", where=_WHERE, fix=fix)
        place = bisect.bisect_left(self.times, time)
        if self.times[place] == time:
            return self.transforms[place]
        begin, end = self.times[place - 1], self.times[place]
        return between(self.transforms[place - 1], self.transforms[place], (time - begin) / (end - begin))


class TransformBuffer:
    """Keeps transforms between coordinate frames, and returns the pose of one in another at a time.

    What cannot be true is left out and reported in `findings`, each once: frames that would be their own ancestors, a
    frame with two parents, a rotation that is not a unit quaternion. Where a frame's stamps jump back by more than a
    second, as on the reset of a simulation, everything but static transforms is dropped.

    Args:
        horizon: how long transforms are kept, s of the stamps.

    Attributes:
        findings: what was wrong with the received transforms.

    Example:
        >>> buffer = TransformBuffer()
        >>> buffer.add("map", "base", 1.0, (1.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
        >>> buffer.add("map", "base", 2.0, (2.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
        >>> buffer.look_up("map", "base", 1.5).translation
        (1.5, 0.0, 0.0)
    """

    def __init__(self, *, horizon: float = 10.0) -> None:
        if not (math.isfinite(horizon) and horizon > 0):
            raise LinkError(f"horizon is {horizon!r}", where=_WHERE, fix="Give a number of seconds above 0.")
        self.findings: list[Finding] = []
        self._horizon = horizon
        self._branches: dict[str, _Branch] = {}
        self._lock = threading.Lock()

    def subscribe(self, link: Subscriber, opened: ExitStack, *, topic: str = "/tf") -> None:
        """Keep the transforms that a robot publishes from now on, until `opened` is closed.

        Args:
            link: to the robot.
            opened: ends the subscriptions when it is closed.
            topic: of the transforms; static ones are on the same with `_static` behind it. `tf` is that of the
                robot's namespace, as of several robots with frames of the same names.

        Raises:
            LinkError: the link knows no type of transforms, or the topics carry another.
        """
        for name, qos in ((f"{topic}_static", Qos.TRANSIENT_LOCAL), (topic, None)):
            is_static = qos is not None

            def take(message: Message, *, is_static: bool = is_static) -> None:
                self.take(message, is_static=is_static)

            opened.callback(link.subscribe(name, _TYPE, take, qos=qos, is_prompt=True).close)

    def take(self, message: Message, *, is_static: bool = False) -> None:
        """Keep the transforms of a tf2_msgs/TFMessage."""
        for each in message["transforms"]:
            stamp, transform = each["header"]["stamp"], each["transform"]
            moved, turned = transform["translation"], transform["rotation"]
            self.add(
                each["header"]["frame_id"],
                each["child_frame_id"],
                stamp["sec"] + stamp["nanosec"] / 1e9,
                (moved["x"], moved["y"], moved["z"]),
                (turned["x"], turned["y"], turned["z"], turned["w"]),
                is_static=is_static,
            )

    def add(
        self,
        parent: str,
        child: str,
        time: float,
        translation: tuple[float, float, float],
        rotation: tuple[float, float, float, float],
        *,
        is_static: bool = False,
    ) -> None:
        """Keep where a frame is in its parent at a time.

        Args:
            parent: name of the frame that it is in.
            child: name of the frame.
            time: s.
            translation: of the child's origin, m.
            rotation: of the child's axes, a quaternion x, y, z, w.
            is_static: whether it always holds.
        """
        parent, child = parent.lstrip("/"), child.lstrip("/")  # tf of ROS 1 began names with a slash
        length = math.hypot(*rotation)
        with self._lock:
            if not parent or not child or not all(map(math.isfinite, (time, *translation, *rotation))):
                self._doubt(f"a transform from {child!r} to {parent!r} has no name or no numbers: it is left out")
                return
            if abs(length - 1.0) > _UNIT:
                self._doubt(f"the rotation of {child!r} in {parent!r} is not a unit quaternion: it is left out")
                return
            if child == parent or child in self._ancestors(parent):
                self._doubt(f"{child!r} would be its own ancestor, as a child of {parent!r}: that is left out")
                return
            x, y, z, w = rotation
            turned = (x / length, y / length, z / length, w / length)
            branch = self._branch(parent, child, time, is_static=is_static)
            branch.add(time, Transform(translation, turned), self._horizon)

    @property
    def frames(self) -> Sequence[str]:
        """The names of all frames, sorted."""
        with self._lock:
            return sorted({*self._branches, *(branch.parent for branch in self._branches.values())})

    def look_up(self, target: str, source: str, time: float | None = None) -> Transform:
        """Return the transform that takes coordinates in `source` to coordinates in `target`: where source is in it.

        Args:
            target: name of a frame.
            source: name of a frame.
            time: for which it is wanted, s; None for the last at which all frames on the way are known.

        Raises:
            LinkError: there is no such frame, they are not connected, or the time is outside of what is known.
        """
        target, source = target.lstrip("/"), source.lstrip("/")
        known = self.frames
        for frame in (target, source):
            if frame not in known:
                raise _unknown(frame, known)
        with self._lock:
            up, down = self._way(source, target)
            moving = [frame for frame in (*up, *down) if not self._branches[frame].is_static]
            if time is None and moving:
                time = min(self._branches[frame].times[-1] for frame in moving)
            to_common = self._composed(up, time)
            from_target = self._composed(down, time)
        found = from_target.inverse().after(to_common)
        return Transform(found.translation, found.rotation, time if moving else None)

    def between(self, target: str, source: str) -> Sequence[str]:
        """Return the frames whose places in their parents make up where `source` is in `target`.

        Raises:
            LinkError: they are not connected.
        """
        with self._lock:
            up, down = self._way(source.lstrip("/"), target.lstrip("/"))
        return [*up, *down]

    def can_look_up(self, target: str, source: str, time: float | None = None) -> bool:
        """Whether `look_up` would return a transform."""
        with suppress(LinkError):
            return bool(self.look_up(target, source, time))
        return False

    def wait_for(
        self, target: str, source: str, clock: Clock, time: float | None = None, *, timeout: float = 5.0
    ) -> Transform:
        """Return a transform as soon as it can be looked up.

        Args:
            target: as of `look_up`.
            source: likewise.
            clock: the run's, which is slept on meanwhile.
            time: as of `look_up`.
            timeout: how long it may take, s of the clock.

        Raises:
            LinkError: as `look_up`, after that time.
        """
        deadline = clock.now() + timeout
        while True:
            try:
                return self.look_up(target, source, time)
            except LinkError as error:
                if clock.now() >= deadline:
                    problem = f"{error.problem}, {timeout:g} s after it was asked for"
                    raise LinkError(problem, where=error.where, fix=error.fix) from error
            clock.sleep(_LOOK)

    def _branch(self, parent: str, child: str, time: float, *, is_static: bool) -> _Branch:
        """Return what is known of a frame, as far as it still holds."""
        branch = self._branches.get(child)
        if branch is not None and not is_static and branch.times[-1] - time > _OVERTAKEN and not branch.is_static:
            back = f"from {branch.times[-1]:.3f} to {time:.3f} s"
            self._doubt(f"the stamps of {child!r} jump back {back}: all is forgotten")
            self._branches = {frame: each for frame, each in self._branches.items() if each.is_static}
            branch = None
        if branch is not None and branch.parent != parent:
            self._doubt(f"{child!r} has two parents, {branch.parent!r} and {parent!r}: the last one published holds")
            branch = None
        if branch is None or branch.is_static != is_static:
            branch = self._branches[child] = _Branch(parent, is_static=is_static)
        return branch

    def _ancestors(self, frame: str) -> list[str]:
        """Return the frames above one, the nearest first."""
        found = []
        while frame in self._branches:
            frame = self._branches[frame].parent
            found.append(frame)
        return found

    def _way(self, source: str, target: str) -> tuple[list[str], list[str]]:
        """Return the frames from source, and those from target, up to the nearest that both are below, exclusive."""
        above_source, above_target = [source, *self._ancestors(source)], [target, *self._ancestors(target)]
        common = next((frame for frame in above_source if frame in above_target), None)
        if common is None:
            one, other = above_source[-1], above_target[-1]
            below = f"the one is below {one!r}, the other below {other!r}"
            problem = f"{source!r} and {target!r} are not connected: {below}"
            fix = f"Start the node that tells where {one!r} is in {other!r}, such as a localisation."
            raise LinkError(problem, where=_WHERE, fix=fix)
        return above_source[: above_source.index(common)], above_target[: above_target.index(common)]

    def _composed(self, frames: Sequence[str], time: float | None) -> Transform:
        """Return the transform from the first of these frames, each the next one's child, to the parent of the last."""
        found = IDENTITY
        for frame in frames:
            found = self._branches[frame].at(0.0 if time is None else time, frame).after(found)
        return found

    def _doubt(self, problem: str) -> None:
        known = {finding.problem.partition(" jump back")[0] for finding in self.findings}
        if problem.partition(" jump back")[0] not in known:
            fix = "Find out who publishes it: ros2 run tf2_tools view_frames, or rosrun tf2_tools view_frames.py."
            self.findings.append(Finding.warning(_WHERE, problem, fix))


def _unknown(frame: str, known: Sequence[str]) -> LinkError:
    there = f"frames are {enumerated(known)}" if known else "no frame has been published yet"
    told = f"Check what is published on /tf and /tf_static, or in the robot's namespace: {there}."
    return LinkError(f"there is no frame {frame!r}", where=_WHERE, fix=did_you_mean(frame, known, told))
