"""What each joint of a tree does in a motion: polynomials of time, and where they put the links.

The frame of a link stands in that of its parent at

    Trans(b) · Rot(B) · Trans(slide(t)) · Rot(angle(t) · axis) · Rot(after),

(b, B) the origin of the joint; a revolute joint has an angle, a prismatic one a slide along its axis, a free one both.
Arrays have the worlds last, as [3, W] and [4, W], so that all steps run over contiguous numbers.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ccd_warp._joints import JointTree
from ccd_warp._rotations import normalized, norms, rotation_vectors, scaled

Array = NDArray[np.float64]
EPS = 2.0**-52
# Errors of rotations in radians, twice those of their quaternions: one of unit length, normalised to 2 eps; a product
# of two, of which each component is a sum of four terms, rounded three times; the sine and cosine of half an angle,
# times an axis to 2 eps; the norm taken out of a link's. A joint's frame that is not turned has none of the first two.
UNIT_ERROR, PRODUCT_ERROR, ANGLE_ERROR, NORM_ERROR = 4.0 * EPS, 6.0 * EPS, 8.0 * EPS, 4.0 * EPS
# A polynomial of degree 1 and 3, relative to the sum of the magnitudes of its coefficients: two roundings a degree, and
# that of q1 − q0. The angle between the quaternions of a free joint is itself to 4 eps.
POLYNOMIAL_ERROR = {2: 2.0 * EPS, 4: 4.0 * EPS}
_FREE_ERROR = 4.0 * EPS
_ROTATION_ERROR = 10.0 * EPS  # of a vector turned by a quaternion, and of a sum of it, relative


class JointCourse(NamedTuple):
    """A joint in a motion of W worlds; what it does not do is None.

    Attributes:
        parent: The link that carries the joint; -1 of the root, which stays at the world's origin.
        place: b, shape [3, 1].
        turn: B, a unit quaternion, shape [4, 1].
        axis: Of the angle, a unit vector, shape [3, 1], or [3, W].
        angle: Coefficients by powers of time, shape [2, W], or [4, W] of a cubic.
        slide: The same, shape [2, 3, W] or [4, 3, W].
        after: The rotation of a free joint at t = 0, shape [4, W].
    """

    parent: int
    place: Array
    turn: Array
    axis: Array | None = None
    angle: Array | None = None
    slide: Array | None = None
    after: Array | None = None


def courses_of(tree: JointTree, coefficients: Array, ends: Array | None) -> list[JointCourse]:
    """What the joints of a tree do, one course a link.

    Args:
        tree: The joints.
        coefficients: Of the coordinates by powers of time, shape [2 or 4, W, n]; for the quaternions of free joints
            the first one is that at t = 0.
        ends: The coordinates at t = 1, of which the quaternions of free joints are taken; None where they stay.
    """
    courses = []
    for link in range(len(tree.links)):
        if tree.joint_of[link] < 0:
            courses.append(JointCourse(-1, np.zeros((3, 1)), np.array([[0.0], [0.0], [0.0], [1.0]])))
            continue
        joint = tree.joints[tree.joint_of[link]]
        origin = np.array([joint.origin])
        place, turn = origin[:, :3].T, normalized(scaled(origin[:, 3:])).T
        columns = tree.columns[tree.joint_of[link]]
        own = np.ascontiguousarray(coefficients[:, :, columns].transpose(0, 2, 1))
        course = JointCourse(tree.parent_of(link), place, turn)
        if joint.kind == "free":
            course = _free(course, own, None if ends is None else ends[:, columns])
        elif joint.axis is not None:
            axis = np.array([joint.axis])
            axis = np.ldexp(axis, -np.frexp(np.abs(axis).max())[1])  # so that no square overflows or vanishes
            axis = (axis / norms(axis)[:, None]).T
            if joint.kind == "prismatic":
                course = course._replace(slide=own * axis)
            else:
                course = course._replace(axis=axis, angle=own[:, 0])
        courses.append(course)
    return courses


def _free(course: JointCourse, own: Array, ends: Array | None) -> JointCourse:
    """A free joint: its place as any coordinates, and a turn at constant speed between its quaternions."""
    start = scaled(np.ascontiguousarray(own[0, 3:].T))
    course = course._replace(slide=np.ascontiguousarray(own[:, :3]), after=np.ascontiguousarray(normalized(start).T))
    if ends is None:
        return course
    omega = rotation_vectors(start, scaled(ends[:, 3:]))
    turns = norms(omega)
    axis = omega / np.where(turns > 0.0, turns, 1.0)[:, None]
    axis[turns == 0.0] = [0.0, 0.0, 1.0]
    return course._replace(axis=np.ascontiguousarray(axis.T), angle=np.stack([np.zeros_like(turns), turns]))


def cross(a: Array, b: Array) -> Array:
    """Vector products, shape [3, W]; large arrays in an eighth of the time of a formula, whose sums take new memory."""
    (x, y, z), (u, v, w) = a, b
    found = np.empty((3, *np.broadcast_shapes(x.shape, u.shape)))
    part = np.empty(found.shape[1:])
    for k, (p, q, r, s) in enumerate(((y, w, z, v), (z, u, x, w), (x, v, y, u))):
        np.multiply(p, q, out=found[k])
        found[k] -= np.multiply(r, s, out=part)
    return found


def length(a: Array) -> Array:
    """Lengths of vectors, shape [W]; those below 1e-154 may be 0."""
    x, y, z = a  # summed in the same order for any number of worlds
    root: Array = np.sqrt(x * x + y * y + z * z)
    return root


def rotated(q: Array, v: Array) -> Array:
    """Vectors turned by unit quaternions, shape [3, W]."""
    twice = 2.0 * cross(q[:3], v)
    return v + q[3] * twice + cross(q[:3], twice)


def product(a: Array, b: Array) -> Array:
    """Quaternions of the rotations b followed by a, shape [4, W]."""
    vector = a[3] * b[:3] + b[3] * a[:3] + cross(a[:3], b[:3])
    scalar = a[3] * b[3] - (a[0] * b[0] + a[1] * b[1] + a[2] * b[2])
    return np.concatenate([vector, np.broadcast_to(scalar, vector.shape[1:])[None]])


def value(coefficients: Array, t: Array) -> Array:
    """A polynomial at times of the worlds."""
    total = coefficients[-1]
    for coefficient in coefficients[-2::-1]:
        total = total * t + coefficient
    return total


def slope(coefficients: Array, t: Array) -> Array:
    """The derivative of a polynomial at times of the worlds."""
    total = (len(coefficients) - 1) * coefficients[-1]
    for k in range(len(coefficients) - 2, 0, -1):
        total = total * t + k * coefficients[k]
    return total


def turning(course: JointCourse, t: Array) -> Array:
    """The quaternion of the angle of a joint that turns, shape [4, W]."""
    assert course.angle is not None and course.axis is not None
    half = 0.5 * value(course.angle, t)
    return np.concatenate([np.sin(half) * course.axis, np.cos(half)[None]])


class Step(NamedTuple):
    """A link in the frame of its parent's place, in the directions of the world.

    Attributes:
        offset: From the parent's origin to its own, shape [3, W].
        frame: The rotation of the joint's frame, shape [4, W].
        rotation: The rotation of the link.
    """

    offset: Array
    frame: Array
    rotation: Array


def step(course: JointCourse, parent_rotation: Array, t: Array) -> Step:
    """Where a joint puts its link at times of the worlds, shape [W]."""
    offset = course.place
    if course.slide is not None:
        offset = offset + rotated(course.turn, value(course.slide, t))
    frame = rotation = product(parent_rotation, course.turn)
    if course.angle is not None:
        rotation = product(rotation, turning(course, t))
    if course.after is not None:
        rotation = product(rotation, course.after)
    rotation = rotation / np.sqrt((rotation * rotation).sum(axis=0))
    return Step(rotated(parent_rotation, offset), frame, rotation)


def poses(courses: list[JointCourse], order: list[int], t: Array) -> tuple[list[Array], list[Array]]:
    """Positions [3, W] and unit quaternions [4, W] of all links at times of the worlds, shape [W]."""
    positions: list[Array] = [np.empty(0)] * len(courses)
    rotations = list(positions)
    for link in order:
        course = courses[link]
        if course.parent < 0:
            positions[link] = np.zeros((3, len(t)))
            rotations[link] = np.broadcast_to(course.turn, (4, len(t)))
            continue
        moved = step(course, rotations[course.parent], t)
        positions[link], rotations[link] = positions[course.parent] + moved.offset, moved.rotation
    return positions, rotations


def turn_error(course: JointCourse) -> Array | float:
    """By how much rounding turns a link against its parent at most, in radians: one a world."""
    error: Any = NORM_ERROR
    if course.turn[:3].any():
        error += UNIT_ERROR + PRODUCT_ERROR
    if course.angle is not None:
        size = np.abs(course.angle).sum(axis=0)
        error = error + ANGLE_ERROR + PRODUCT_ERROR + POLYNOMIAL_ERROR[len(course.angle)] * size
        if course.after is not None:
            error = error + _FREE_ERROR * size
    if course.after is not None:
        error = error + (UNIT_ERROR + PRODUCT_ERROR)
    return error


def offset_error(course: JointCourse, reach: Array) -> Array:
    """By how much rounding moves a link in its parent's frame at most, whose origin is within a reach."""
    error: Array = _ROTATION_ERROR * reach
    if course.slide is not None:
        size = np.sqrt((np.abs(course.slide).sum(axis=0) ** 2).sum(axis=0))
        error = error + (_ROTATION_ERROR + 2.0 * EPS + POLYNOMIAL_ERROR[len(course.slide)]) * size
    return error
