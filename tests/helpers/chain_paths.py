"""Trajectories of points on the links of a mechanism, in interval arithmetic, from joints as users give them.

A path of this kind goes wherever those of `arc_paths` go. Numbers of float64 count as exact; axes and quaternions are
normalized exactly. A point is carried from its link down to the world, joint by joint:

    x ↦ b + B·(slide(t) + Rot(angle(t)·axis)·x),     b, B the origin of the joint in the frame of its parent.

On an interval of time, all are polynomials in s = (t − middle)/half, whose constant coefficient carries the rest.
"""

from __future__ import annotations

from typing import NamedTuple

from arc_paths import TERMS, UNIT, Basis, Vector, _rotation, add, cross, dot, scaled, short, shortest_rotation_vector
from arc_paths import vector as exact
from flint import arb, arb_poly


class ChainJoint(NamedTuple):
    """A joint between a link and the one that carries it.

    Attributes:
        kind: "revolute", "prismatic", "fixed" or "free".
        origin: Position and quaternion (x, y, z, w) in the frame of the parent, of any length.
        axis: Of any length.
        q: Coordinates by powers of time; None for those of a straight way between `ends`. Shape [4] or [4, 7].
        ends: Coordinates at both ends, shape [2] or [2, 7].
    """

    kind: str
    origin: object
    axis: object = (0.0, 0.0, 1.0)
    q: object = None
    ends: object = None


def _polynomial(joint: ChainJoint, k: int | None, t: arb_poly) -> arb_poly:
    """A coordinate as a polynomial in s."""
    at = (lambda row: row) if k is None else (lambda row: row[k])
    if joint.ends is not None:
        start, end = (arb(float(at(q))) for q in joint.ends)
        return start + (end - start) * t
    return arb_poly([arb(float(at(row))) for row in joint.q])(t)


def _sine_and_cosine(angle: arb_poly) -> tuple[arb_poly, arb_poly]:
    sine, cosine = angle[0].sin_cos()
    part = angle - angle[0]
    most = part(UNIT).abs_upper()
    sines, cosines = arb_poly([sine]), arb_poly([cosine])
    power, size = arb_poly([1]), arb(1)
    for k in range(1, TERMS):
        power, size = short(power * part) * (arb(1) / k), size * most / k
        sines += power * (sine, cosine, -sine, -cosine)[k % 4]
        cosines += power * (cosine, -sine, -cosine, sine)[k % 4]
    rest = UNIT * (size * most / TERMS)  # by Taylor's theorem
    return sines + rest, cosines + rest


def _turned(axis: Vector, angle: arb_poly, points: list[Vector]) -> list[Vector]:
    sine, cosine = _sine_and_cosine(angle)
    found = []
    for x in points:
        along, across = dot(axis, x), cross(axis, x)
        found.append([short(x[i] * cosine + across[i] * sine + (along * axis[i]) * (1 - cosine)) for i in range(3)])
    return found


def _unit(values) -> Vector:
    v = exact(values)
    return scaled(1 / dot(v, v).sqrt(), v)


class ChainPath:
    """Points of a link.

    Args:
        local: Points in the frame of the link, shape [points, 3].
        joints: Those between the root and the link, the root's first.
    """

    omega = exact([0, 0, 0])  # there is no frame in which it turns at constant speed

    def __init__(self, local, joints: list[ChainJoint]):
        self._local = [exact(point) for point in local]
        self._joints = joints
        # How far the joints turn at most, in sum, which sets the intervals that are looked at.
        self.theta = sum((self._turn_of(joint) for joint in joints), arb(0))

    def _turn_of(self, joint: ChainJoint) -> arb:
        if joint.kind == "fixed" or joint.kind == "prismatic":
            return arb(0)
        if joint.kind == "free":
            turn = shortest_rotation_vector(*(exact(q[3:]) for q in joint.ends)) if joint.q is None else exact([0] * 3)
            return dot(turn, turn).sqrt()
        if joint.ends is not None:
            return abs(arb(float(joint.ends[1])) - arb(float(joint.ends[0])))
        return sum((k * abs(arb(float(c))) for k, c in enumerate(joint.q)), arb(0))

    def points(self, basis: Basis) -> list[Vector]:
        """The positions as polynomials."""
        found = [[arb_poly([x]) for x in point] for point in self._local]
        for joint in reversed(self._joints):
            found = self._carried(joint, found, basis.t)
        return found

    def _carried(self, joint: ChainJoint, points: list[Vector], t: arb_poly) -> list[Vector]:
        slide = None
        if joint.kind == "revolute":
            points = _turned(_unit(joint.axis), _polynomial(joint, None, t), points)
        elif joint.kind == "prismatic":
            slide = [short(a * _polynomial(joint, None, t)) for a in _unit(joint.axis)]
        elif joint.kind == "free":
            slide = [_polynomial(joint, k, t) for k in range(3)]
            start, end = (q[3:] for q in (joint.ends if joint.q is None else (joint.q[0], joint.q[0])))
            points = [_rotation(exact(start))(x) for x in points]
            omega = shortest_rotation_vector(exact(start), exact(end))
            turn = dot(omega, omega).sqrt()
            if turn > 0:
                points = _turned(scaled(1 / turn, omega), turn * t, points)
        if slide is not None:
            points = [add(slide, x) for x in points]
        place, turned = exact(joint.origin[:3]), _rotation(exact(joint.origin[3:]))
        return [[a + b for a, b in zip(place, turned(x), strict=True)] for x in points]
