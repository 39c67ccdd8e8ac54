"""Certified slices of a motion of joints: each link on a path of `BodyPaths`, and how far it may be from there.

In a slice, from s = 0 to 1, a link T(s) has a path P(s) with the same poses at both ends: a screw, with the constant
twist ξ, in a frame that moves on with a constant velocity w. With V the link's twist (`_joint_bounds`), a point is as
far from its place on the path as g(s) = P(0) P(s)⁻¹ T(s) X from x₀ = g(0), and

    |g″| ≤ |A(x)| + |ε| |E(x)|,     A = V′ − [ξ, E],     E = V − ξ,     ε and n the angular parts of E and ξ,

where V and ξ are those seen from the moving frame, and [ξ, E](x) = n × E(x) − ε × ξ(x). As g is x₀ at both ends,
|g − x₀| ≤ M₀/8 + M₁/24 where |g″(s)| ≤ M₀ + M₁ |2s − 1| (the solutions for a constant, and for |2s − 1|). In the middle
of the slice V′ is computed and E hardly more than rounding; M₁ is what they may change by to the ends. The bound falls
as the square of the slice, with V′: it is 0 but for rounding for one joint at constant speed, and for joints that make
a screw. The frame's velocity w cancels what of V′ is across ω, so that it is 0 for a free joint, too, whose body turns
while its origin moves straight, and smaller for all others.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ccd_warp._body_paths import BodyPaths
from ccd_warp._joint_bounds import Motion, Window, motions
from ccd_warp._joint_courses import EPS, Array, JointCourse, cross, length, poses, product, rotated

_UP = 1.0 + 4096.0 * EPS  # rounding of a bound itself
_PATH_ERROR = 64.0 * EPS  # of the fields of a path, relative to what moves


def slices(
    courses: list[JointCourse], order: list[int], rows: list[int], window: Window, reach: Array, centre: Array
) -> tuple[BodyPaths, Array]:
    """The paths of links in a slice, as if it were a step from 0 to 1, and how far their points may be from there.

    Args:
        courses: What the joints do.
        order: Links after those that carry them.
        rows: The links that are asked for.
        window: The slice, of each world.
        reach: How far the points of each are from the centre at most, shape [L].
        centre: In the frame of each link, shape [L, 3].

    Returns:
        Paths of N = W·L bodies, those of a world after another's, and the lengths, shape [N].
    """
    num_worlds, each = len(window.begin), len(rows)
    with np.errstate(all="ignore"):
        found = motions(courses, order, window)
        links = Motion(*(_joined([x[k] for k in rows]) for x in zip(*found, strict=True)))
        (p0, q0), (p1, q1) = (
            [_joined([x[k] for k in rows]) for x in poses(courses, order, t)] for t in (window.begin, window.end)
        )
        arms, radius = rotated(links.rotation, np.tile(centre.T, num_worlds)), np.tile(reach, num_worlds)
        frame = _frame(links, arms, radius)
        path = _screw(q0, q1, p0, p1 - p0 - frame)
        length_of = np.where(window.duration > 0.0, window.duration, 1.0)
        share = np.where(window.duration > 0.0, (window.middle - window.begin) / length_of, 0.5)
        bound = _excess(links, path, frame, arms, radius, np.repeat(share, each), np.repeat(window.half, each))
    fields = (q0, path.omega, np.zeros_like(p0), p0, path.velocity + frame, path.turning)
    return BodyPaths(*(np.ascontiguousarray(x.T) for x in fields)), bound


def _joined(arrays: list[Array]) -> Array:
    """The numbers of several links, shape [..., W] each, as those of W·L bodies."""
    joined: Array = np.stack(arrays, axis=-1).reshape(*arrays[0].shape[:-1], -1)
    return joined


class Screw(NamedTuple):
    """A screw as `BodyPaths` has it, shape [3, N] each.

    Attributes:
        omega: Its rotation vector.
        velocity: The displacement along it.
        turning: The velocity of the body's origin across it at the begin.
        start: The place of the body's origin at the begin.
    """

    omega: Array
    velocity: Array
    turning: Array
    start: Array


def _screw(q0: Array, q1: Array, start: Array, d: Array) -> Screw:
    """The screw between rotations, [4, N], by a displacement, [3, N]; ω is off by 16 eps, however small it is."""
    between = product(q1, np.concatenate([-q0[:3], q0[3:]]))
    sine = length(between[:3])
    axis = between[:3] / np.where(sine > 0.0, sine, 1.0)
    angle = 2.0 * np.arctan2(sine, np.abs(between[3])) * np.where(between[3] < 0.0, -1.0, 1.0)
    omega, half = angle * axis, 0.5 * angle
    along = np.where(sine > 0.0, axis * (axis * d).sum(axis=0), d)
    across = d - along
    ratio = np.where(half != 0.0, half / np.tan(np.where(half != 0.0, half, 1.0)), 1.0)
    return Screw(omega, along, ratio * across - 0.5 * cross(omega, across), start)


def _frame(links: Motion, arms: Array, radius: Array) -> Array:
    """w, which cancels V′ across ω at the centres of links; no larger than twice their velocities."""
    bend = links.bend + cross(links.alpha, arms)
    squared = (links.omega * links.omega).sum(axis=0)
    frame = cross(links.omega, bend) / np.where(squared > 0.0, squared, 1.0)
    most = 2.0 * (length(links.velocity + cross(links.omega, arms)) + length(links.omega) * radius)
    size = length(frame)
    factor = np.where(size <= most, 1.0, most / np.where(size > 0.0, size, 1.0))
    frame = factor * frame
    return np.where(np.isfinite(frame).all(axis=0), frame, 0.0)


def _excess(links: Motion, path: Screw, frame: Array, arms: Array, radius: Array, share: Array, half: Array) -> Array:
    """How far points may be from their paths, which are seen from the moving frame."""
    n, velocity, turning = path.omega, path.velocity, path.turning
    theta = length(n)
    divisor = np.where(theta > 0.0, theta, 1.0)
    first = np.where(theta > 0.0, np.sin(theta * share) / divisor, share)
    second = np.where(theta > 0.0, np.sin(0.5 * theta * share) / divisor, 0.5 * share)
    second = 2.0 * second * second
    bent = cross(n, turning)
    origin = path.start + share * (velocity + frame) + first * turning + second * bent
    speed = velocity + turning + first * bent + second * cross(n, bent)  # of the path's own origin, in the middle
    # at the centre, in the middle
    arm = length(arms)
    apart = links.position - origin
    miss = links.velocity - frame - speed - cross(n, apart)
    miss = miss + cross(links.omega - n, arms)
    velocity_c = links.velocity + cross(links.omega, arms)
    bend_c = links.bend + cross(links.alpha, arms)
    # bounds at the centre
    relative = 4.0 * links.relative + 8.0 * links.turned
    size_w, size_n = length(frame), length(n)
    most_velocity = links.most_velocity + links.most_omega * arm
    most_bend = links.most_bend + links.most_alpha * arm
    change = links.most_change + links.most_jerk * arm
    accelerated = most_bend + links.most_omega * most_velocity  # |x″|
    most_here = length(velocity_c - frame) + half * accelerated
    most_there = length(velocity_c + frame) + half * accelerated
    # rounding of what was computed in the middle
    moving = 2.0 * links.moved * (links.most_alpha + links.most_omega**2)
    lengths = length(links.position) + length(velocity) + length(turning) + size_w
    of_bend = relative * (most_bend + links.most_omega * size_w) + moving
    of_miss = relative * most_velocity + _PATH_ERROR * (most_velocity + lengths * (1.0 + size_n) * size_n + size_w)
    of_miss = of_miss + links.moved * (links.most_omega + size_n) + _PATH_ERROR * (length(velocity) + length(turning))
    # each bound as a part in the middle and what it may grow by to the ends
    bend_0, bend_1 = (
        length(bend_c + cross(links.omega, frame)) + of_bend,
        half * (change + links.most_alpha * most_there),
    )
    most = most_bend + links.most_omega * size_w
    bend_0, bend_1 = np.minimum(bend_0, most), np.minimum(bend_1, most)
    alpha_0 = np.minimum(length(links.alpha) * (1.0 + _PATH_ERROR) + relative * links.most_alpha, links.most_alpha)
    alpha_1 = np.minimum(half * links.most_jerk, links.most_alpha)
    spin_0, spin_1 = length(links.omega - n) + relative * links.most_omega, half * links.most_alpha
    miss_0, miss_1 = length(miss) + of_miss, half * (bend_0 + bend_1 + (spin_0 + spin_1) * most_here)
    miss_all, spin_all = miss_0 + miss_1, spin_0 + spin_1
    screw = most_here + 2.0 * miss_all + spin_all * radius
    middle = bend_0 + size_n * miss_0 + spin_0 * screw + (alpha_0 + size_n * spin_0) * radius
    growth = bend_1 + size_n * miss_1 + spin_1 * screw + (alpha_1 + size_n * spin_1) * radius
    # the middle may be off half of the slice by rounding, and by all of it where the slice is a few floats
    off = 2.0 * (half - 0.5)
    of_slice = (middle + off * growth) / 8.0 + growth / 24.0
    # rounding of the poses at the ends, and of the fields that lead from one to the other
    reach = radius + arm
    ends = links.moved + links.turned * reach + (16.0 + 4.0 * size_n) * EPS * reach
    ends = ends + _PATH_ERROR * (length(velocity) + length(turning) * (1.0 + size_n) + size_w)
    bound: Array = (of_slice + ends) * _UP
    return bound
