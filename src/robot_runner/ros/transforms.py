"""Rigid transforms between coordinate frames: composed, turned round, and interpolated between two times.

Rotations are unit quaternions (x, y, z, w), as in geometry_msgs. Written without NumPy, so that a look-up on a robot's
own computer takes no more than Python.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeAlias

Vector: TypeAlias = tuple[float, float, float]
#: x, y, z, w.
Quaternion: TypeAlias = tuple[float, float, float, float]

#: Nearer than this, the cosine of half the angle, slerp divides by next to nothing; the chord is as good there.
_NEARLY_ONE = 1.0 - 1e-9


@dataclass(frozen=True, slots=True)
class Transform:
    """Takes coordinates of one frame to those of another: turned by `rotation`, then moved by `translation`.

    Attributes:
        translation: m.
        rotation: a unit quaternion x, y, z, w.
        time: for which it holds, s since the epoch (of a simulation: since its beginning); None where it always does.

    Example:
        >>> quarter = Transform((1.0, 0.0, 0.0), (0.0, 0.0, 0.5**0.5, 0.5**0.5))
        >>> [round(each, 6) for each in quarter.apply((2.0, 0.0, 0.0))]
        [1.0, 2.0, 0.0]
    """

    translation: Vector
    rotation: Quaternion
    time: float | None = None

    @property
    def distance(self) -> float:
        """How far the origins of the frames are from each other, m."""
        return math.hypot(*self.translation)

    @property
    def yaw(self) -> float:
        """The angle about the z axis, rad from -pi to pi."""
        return yaw_of(*self.rotation)

    def apply(self, point: Vector) -> Vector:
        """Return the coordinates of a point of one frame in the other."""
        return _sum(_turned(self.rotation, point), self.translation)

    def after(self, first: Transform) -> Transform:
        """Return the composition: `first`, then this; it has this transform's time."""
        rotation = _normalised(_product(self.rotation, first.rotation))
        return Transform(self.apply(first.translation), rotation, self.time)

    def inverse(self) -> Transform:
        """Return the inverse transform."""
        x, y, z, w = self.rotation
        back = (-x, -y, -z, w)
        x, y, z = _turned(back, self.translation)
        return Transform((-x, -y, -z), back, self.time)


IDENTITY = Transform((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))


def yaw_of(x: float, y: float, z: float, w: float) -> float:
    """Return the angle of a rotation about the z axis, rad from -pi to pi; NaN where the quaternion is zero.

    Its length is of no matter: not every node normalises what it publishes. ROS REP 103 has x forward, y left, z up.

    Example:
        >>> round(yaw_of(0.0, 0.0, 2.0, 2.0), 6), yaw_of(0.0, 0.0, 0.0, 0.0)
        (1.570796, nan)
    """
    square = x * x + y * y + z * z + w * w
    return math.atan2(2.0 * (w * z + x * y), square - 2.0 * (y * y + z * z)) if square else math.nan


def between(first: Transform, second: Transform, share: float) -> Transform:
    """Return the transform at this share, 0 to 1, of the way from one to another.

    Translations go straight; rotations turn at a constant rate the shorter way (slerp: Shoemake, SIGGRAPH 1985).
    """
    moved = [one + share * (other - one) for one, other in zip(first.translation, second.translation, strict=True)]
    return Transform((moved[0], moved[1], moved[2]), _slerp(first.rotation, second.rotation, share))


def _slerp(one: Quaternion, other: Quaternion, share: float) -> Quaternion:
    cosine = sum(a * b for a, b in zip(one, other, strict=True))
    sign = -1.0 if cosine < 0.0 else 1.0  # a quaternion and its opposite are the same rotation
    if abs(cosine) > _NEARLY_ONE:
        left, right = 1.0 - share, share * sign
    else:
        angle = math.acos(abs(cosine))
        left = math.sin((1.0 - share) * angle) / math.sin(angle)
        right = sign * math.sin(share * angle) / math.sin(angle)
    x, y, z, w = (left * a + right * b for a, b in zip(one, other, strict=True))
    return _normalised((x, y, z, w))


def _product(one: Quaternion, other: Quaternion) -> Quaternion:
    ax, ay, az, aw = one
    bx, by, bz, bw = other
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )


def _turned(rotation: Quaternion, point: Vector) -> Vector:
    x, y, z, w = rotation
    back = (-x, -y, -z, w)
    turned = _product(_product(rotation, (*point, 0.0)), back)
    return turned[0], turned[1], turned[2]


def _sum(one: Vector, other: Vector) -> Vector:
    return one[0] + other[0], one[1] + other[1], one[2] + other[2]


def _normalised(rotation: Quaternion) -> Quaternion:
    length = math.hypot(*rotation)
    x, y, z, w = rotation
    return x / length, y / length, z / length, w / length
