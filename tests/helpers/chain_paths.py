"""Trajectories of points on the links of a mechanism, in interval arithmetic, from joints as users give them.

Numbers of float64 count as exact; axes and quaternions are
normalized exactly. A point is carried from its link down to the world, joint by joint:

    x ↦ b + B·(slide(t) + Rot(angle(t)·axis)·x),     b, B the origin of the joint in the frame of its parent.

On an interval of time, all are polynomials in s = (t − middle)/half, whose constant coefficient carries the rest.
"""

from __future__ import annotations

from typing import NamedTuple

from flint import arb, arb_poly
from laws.trajectories import Trajectory, Vector, add, cross, dot, exact, precise, scaled, short, sine_and_cosine
from laws.turning import rotated, shortest_rotation_vector


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


def _turned(axis: Vector, angle: arb_poly, points: list[Vector]) -> list[Vector]:
    sine, cosine = sine_and_cosine(angle)
    found = []
    for x in points:
        along, across = dot(axis, x), cross(axis, x)
        found.append([short(x[i] * cosine + across[i] * sine + (along * axis[i]) * (1 - cosine)) for i in range(3)])
    return found


def _unit(values) -> Vector:
    v = exact(values)
    return scaled(1 / dot(v, v).sqrt(), v)


@precise
def chain(local, joints: list[ChainJoint]) -> Trajectory:
    """Points of a link, in its own frame, with the joints between the root and the link, the root's first."""
    local = [exact(point) for point in local]

    def points(t: arb_poly) -> list[Vector]:
        found = [[arb_poly([x]) for x in point] for point in local]
        for joint in reversed(joints):
            found = _carried(joint, found, t)
        return found

    return points


def _carried(joint: ChainJoint, points: list[Vector], t: arb_poly) -> list[Vector]:
    slide = None
    if joint.kind == "revolute":
        points = _turned(_unit(joint.axis), _polynomial(joint, None, t), points)
    elif joint.kind == "prismatic":
        slide = [short(a * _polynomial(joint, None, t)) for a in _unit(joint.axis)]
    elif joint.kind == "free":
        slide = [_polynomial(joint, k, t) for k in range(3)]
        start, end = (exact(q[3:]) for q in (joint.ends if joint.q is None else (joint.q[0], joint.q[0])))
        points = [rotated(start, x) for x in points]
        omega = shortest_rotation_vector(start, end)
        turn = dot(omega, omega).sqrt()
        if turn > 0:
            points = _turned(scaled(1 / turn, omega), turn * t, points)
    if slide is not None:
        points = [add(slide, x) for x in points]
    place, turn = exact(joint.origin[:3]), exact(joint.origin[3:])
    return [add(place, rotated(turn, x)) for x in points]
